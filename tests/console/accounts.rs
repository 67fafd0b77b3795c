//! Passwords, cookies, sessions: who gets in.

use super::*;

/// Threat 12: stolen or guessed password.
#[test]
fn the_sixth_wrong_password_is_429_and_every_try_is_a_row() {
    let vehicle = start();
    let nobody = Browser::new(vehicle.address);
    let statuses: Vec<u16> = (0..6)
        .map(|_| {
            nobody
                .post(
                    "/api/login",
                    &json!({ "user": "admin", "password": "wrong password" }),
                )
                .status
        })
        .collect();
    assert_eq!(statuses, [401, 401, 401, 401, 401, 429]);
    let right = nobody.post(
        "/api/login",
        &json!({ "user": "admin", "password": PASSWORD }),
    );
    assert_eq!(right.status, 429, "not even with the right one");
    let seen = rows(&vehicle, Log::Intrusions);
    assert_eq!(
        seen.iter()
            .filter(|r| *r == "admin: wrong user or password")
            .count(),
        5
    );
    assert_eq!(
        seen.iter()
            .filter(|r| *r == "admin: too many tries")
            .count(),
        2
    );
}

/// Threat 12: names cannot be found by the time a refusal takes.
#[test]
fn an_unknown_user_takes_as_long_as_a_known_one() {
    let (mut known, mut unknown) = (Vec::new(), Vec::new());
    let clock = Clock::start(1.0);
    for _ in 0..2 {
        let vehicle = start();
        let browser = Browser::new(vehicle.address);
        for user in ["admin", "nobody", "admin", "nobody"] {
            let begun = clock.now();
            browser.post(
                "/api/login",
                &json!({ "user": user, "password": "wrong password" }),
            );
            let took = clock.now().since(begun).as_secs_f64();
            if user == "admin" {
                known.push(took);
            } else {
                unknown.push(took);
            }
        }
    }
    // The quickest of each: this machine may be busy.
    let quickest = |t: &[f64]| t.iter().copied().fold(f64::INFINITY, f64::min);
    let (a, b) = (quickest(&known), quickest(&unknown));
    println!(
        "FIGURES\npassword refused: known user {:.0} ms, unknown {:.0} ms\nEND",
        a * 1e3,
        b * 1e3
    );
    assert!(a / b < 2.0 && b / a < 2.0, "{a} s and {b} s");
}

#[test]
fn the_cookie_and_the_headers_are_as_they_must_be() {
    let vehicle = start();
    let nobody = Browser::new(vehicle.address);
    let answer = nobody.post(
        "/api/login",
        &json!({ "user": "viewer", "password": PASSWORD }),
    );
    let cookie = &answer.headers["set-cookie"];
    assert!(
        cookie.contains("; HttpOnly")
            && cookie.contains("; SameSite=Strict")
            && cookie.contains("; Path=/"),
        "{cookie}"
    );
    let page = nobody.get("/");
    assert!(page.headers["content-security-policy"].starts_with("default-src 'self'"));
    assert_eq!(page.headers["x-content-type-options"], "nosniff");
    assert_eq!(page.headers["referrer-policy"], "no-referrer");
    assert!(!page.headers.contains_key("access-control-allow-origin"));
    let refused = nobody.get("/api/session");
    assert_eq!(refused.headers["content-type"], "application/problem+json");
}

#[test]
fn bad_bodies_are_refused_and_logout_ends_the_session() {
    let vehicle = start();
    let mut browser = Browser::new(vehicle.address);
    let post = |body: &[u8], kind: &str| {
        let text = format!(
            "POST /api/login HTTP/1.1\r\nHost: {0}\r\nOrigin: http://{0}\r\nContent-Type: {kind}\r\nContent-Length: {1}\r\nConnection: close\r\n\r\n",
            vehicle.address,
            body.len()
        );
        raw_request(vehicle.address, &text, body).map(|a| a.status)
    };
    assert_eq!(post(b"{\"user\": ", "application/json").unwrap(), 400);
    assert_eq!(
        post(
            b"{\"user\": \"a\", \"password\": \"b\", \"more\": 1}",
            "application/json"
        )
        .unwrap(),
        400
    );
    assert_eq!(
        post(b"user=a", "application/x-www-form-urlencoded").unwrap(),
        415
    );
    assert_eq!(post(&vec![b' '; 70_000], "application/json").unwrap(), 413);
    browser = Browser::logged_in(browser.to, "viewer");
    assert_eq!(browser.get("/api/session").json()["role"], "viewer");
    let mut page = browser.page();
    assert_eq!(browser.post("/api/logout", &json!({})).status, 200);
    assert_eq!(browser.get("/api/session").status, 401);
    assert!(page.pump(2 * SECOND, |p| p.closed.is_some()));
    assert_eq!(page.closed, Some(4001), "its page is closed too");
}

#[test]
fn a_changed_role_ends_the_sessions_and_a_removed_user_cannot_log_in() {
    let vehicle = start();
    let admin = Browser::logged_in(vehicle.address, "admin");
    let pilot = Browser::logged_in(vehicle.address, "pilot");
    assert_eq!(
        admin
            .post("/api/users", &json!({ "name": "pilot", "role": "viewer" }))
            .status,
        200
    );
    assert_eq!(pilot.get("/api/session").status, 401);
    let again = Browser::logged_in(vehicle.address, "pilot");
    assert_eq!(again.get("/api/session").json()["role"], "viewer");
    assert_eq!(
        admin
            .post("/api/users", &json!({ "name": "new", "password": "short" }))
            .status,
        422
    );
    assert_eq!(
        admin
            .post(
                "/api/users",
                &json!({ "name": "<b>", "password": PASSWORD })
            )
            .status,
        422
    );
    assert_eq!(
        admin
            .post("/api/users/remove", &json!({ "name": "pilot" }))
            .status,
        200
    );
    let refused = Browser::new(vehicle.address).post(
        "/api/login",
        &json!({ "user": "pilot", "password": PASSWORD }),
    );
    assert_eq!(refused.status, 401);
    let log = rows(&vehicle, Log::Actions);
    assert!(
        log.contains(&"admin: set user pilot, role viewer".to_owned()),
        "{log:?}"
    );
    assert!(
        log.contains(&"admin: removed user pilot".to_owned()),
        "{log:?}"
    );
}

/// What `kestrel passwd` does beside a running program.
#[test]
fn a_password_or_role_changed_by_another_program_ends_the_open_sessions_of_that_user_only() {
    let vehicle = start();
    let other = Browser::logged_in(vehicle.address, "pilot2");
    let mut page = other.page();
    let books = Books::open(Some(&vehicle.folder.join(FILE))).unwrap();
    let hash = bridge::web::password::hash("another long secret").unwrap();
    for change in ["password", "role", "removal"] {
        let pilot = Browser::logged_in(vehicle.address, "pilot");
        let mut open = pilot.page();
        match change {
            "password" => {
                let same = bridge::web::password::hash(PASSWORD).unwrap();
                books
                    .set_user("pilot", Some(&hash), None, None, None)
                    .and_then(|_| books.set_user("pilot", Some(&same), None, None, None))
                    .unwrap();
            }
            "role" => {
                books
                    .set_user("pilot", None, Some(Role::Viewer), None, None)
                    .unwrap();
            }
            _ => {
                books.remove_user("pilot").unwrap();
            }
        }
        page.beat();
        assert!(open.pump(3 * SECOND, |p| p.closed.is_some()), "{change}");
        assert_eq!(open.closed, Some(4001), "{change}");
        assert_eq!(pilot.get("/api/session").status, 401, "{change}");
    }
    page.pump(Duration::from_millis(300), |_| false);
    assert_eq!((page.closed, other.get("/api/session").status), (None, 200));
}

#[test]
fn the_link_of_the_terminal_opens_one_browser_and_the_setup_code_makes_one_administrator() {
    let vehicle = start_with(&[], true, &[]);
    vehicle.until("a link", SECOND, |s| !s.told.is_empty());
    let key = |n: usize| {
        let told = &vehicle.shown().told[n];
        told.split("#enter=").nth(1).unwrap().to_owned()
    };
    let nobody = Browser::new(vehicle.address);
    let enter = |key: &str| nobody.post("/api/enter", &json!({ "key": key })).status;
    assert_eq!(enter(&"0".repeat(32)), 401);
    assert_eq!(enter(&key(0)), 200);
    assert_eq!(enter(&key(0)), 401, "only once");
    vehicle.until("the next link", SECOND, |s| s.told.len() == 2);
    assert_eq!(enter(&key(1)), 200);

    let vehicle = start_with(&[], false, &[]);
    vehicle.until("a code", SECOND, |s| !s.told.is_empty());
    let code = vehicle.shown().told[0].split("#setup=").nth(1).unwrap()[..32].to_owned();
    let nobody = Browser::new(vehicle.address);
    let setup = |code: &str, user: &str| {
        nobody
            .post(
                "/api/setup",
                &json!({ "code": code, "user": user, "password": PASSWORD }),
            )
            .status
    };
    assert_eq!(setup(&"0".repeat(32), "eve"), 401);
    assert_eq!(setup(&code, "ana"), 200);
    assert_eq!(setup(&code, "eve"), 401, "only once");
    assert_eq!(
        Browser::logged_in(vehicle.address, "ana")
            .get("/api/users")
            .status,
        200
    );
}

#[test]
fn others_reach_the_console_only_when_somebody_has_a_password() {
    let room = sim::Room::named("office").unwrap();
    let links = bridge::io::net::Links::open(&[]).unwrap();
    let config = ConsoleConfig {
        listen: SocketAddr::from(([0, 0, 0, 0], 0)),
        is_default: false,
        state_dir: None,
        has_link: false,
        names: Vec::new(),
        vehicle: String::new(),
        us: Address {
            system: 1,
            component: 1,
        },
        plan: std::sync::Arc::clone(room.floor_plan()),
        settings: bridge::settings::Settings::default(),
        camera: None,
    };
    let refused = Console::start(config, links.joint())
        .err()
        .unwrap()
        .to_string();
    assert!(refused.contains("kestrel passwd"), "{refused}");
}
