//! In and out: log-in, the link and the code of the terminal, one's own password.

use super::super::console::{Entry, Server};
use super::super::gate::{Arrival, Caller};
use super::super::ledger::{Account, Note};
use super::super::password;
use super::super::role::Role;
use super::super::sessions::{Entrant, Session, SessionId};
use super::{Body, Reply, body, json, no, plain_name, unavailable};
use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::Response;
use serde::Deserialize;
use std::sync::Arc;

impl From<Account> for Entrant {
    fn from(account: Account) -> Self {
        Self {
            user: account.name.clone(),
            role: account.role,
            account: Some((account.name, account.changed_us)),
            stays: false,
        }
    }
}

/// What a page must know of its session: aboard the vehicle, off the drone the vehicles that are its user's.
fn described(session: &Session, server: &Server) -> serde_json::Value {
    let vehicle = server.aboard.as_ref().map(|a| {
        serde_json::json!({ "system": a.us.system, "component": a.us.component, "name": a.name })
    });
    let vehicles = server.fleet.as_ref().map(|f| f.names_of(&session.user));
    serde_json::json!({
        "user": session.user,
        "role": session.role.name(),
        "system": session.system,
        "vehicle": vehicle,
        "vehicles": vehicles,
        "camera": server.aboard.as_ref().map(|a| a.camera.is_some()),
        "version": env!("CARGO_PKG_VERSION"),
    })
}

/// A new session with its cookie.
fn welcome(server: &Server, arrival: Arrival, who: Entrant, what: &'static str) -> Reply {
    let id = SessionId(password::random().map_err(unavailable)?);
    let session = server.begin(id, who);
    server.ledger.note(Note::Login {
        user: session.user.clone(),
        from: arrival.peer.ip().to_string(),
        what,
    });
    let mut response = json(&described(&session, server));
    let cookie = format!(
        "{}={}; HttpOnly; SameSite=Strict; Path=/{}",
        Server::cookie_name(arrival),
        id.to_hex(),
        if arrival.is_tls { "; Secure" } else { "" }
    );
    let cookie = HeaderValue::from_str(&cookie).map_err(unavailable)?;
    response.headers_mut().insert(header::SET_COOKIE, cookie);
    Ok(response)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Login {
    user: String,
    password: String,
}

pub(in crate::web) async fn login(
    State(server): State<Arc<Server>>,
    Extension(arrival): Extension<Arrival>,
    given: Body,
) -> Reply {
    let given: Login = body(given)?;
    if !server.may_try(arrival.peer.ip()) {
        server.intrusion(&given.user, arrival, "too many tries");
        return Err(no(
            StatusCode::TOO_MANY_REQUESTS,
            "too many tries: wait a minute",
        ));
    }
    let name = given.user.clone();
    let kept = server
        .ledger
        .ask(move |books| books.account(&name))
        .await
        .map_err(unavailable)?;
    let hash = kept.as_ref().map(|account| account.hash.clone());
    let is_right = server.compare(given.password, hash).await?;
    match kept {
        Some(account) if is_right => {
            server.forgive(arrival.peer.ip());
            welcome(&server, arrival, account.into(), "login")
        }
        _ => {
            server.intrusion(&given.user, arrival, "wrong user or password");
            Err(no(
                StatusCode::UNAUTHORIZED,
                "wrong user or password; the attempt was written down",
            ))
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    key: String,
}

pub(in crate::web) async fn enter(
    State(server): State<Arc<Server>>,
    Extension(arrival): Extension<Arrival>,
    given: Body,
) -> Reply {
    let given: Key = body(given)?;
    if !arrival.peer.ip().to_canonical().is_loopback() || !server.may_try(arrival.peer.ip()) {
        return Err(no(
            StatusCode::TOO_MANY_REQUESTS,
            "too many tries: wait a minute",
        ));
    }
    if !server.use_link(&given.key) {
        server.intrusion("", arrival, "a used or wrong link");
        return Err(no(
            StatusCode::UNAUTHORIZED,
            "this link was used already: take the newest one on the terminal",
        ));
    }
    server.forgive(arrival.peer.ip());
    let you = Entrant {
        user: "you".to_owned(),
        role: Role::Admin,
        account: None,
        stays: true,
    };
    welcome(&server, arrival, you, "link")
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Setup {
    code: String,
    user: String,
    password: String,
}

pub(in crate::web) async fn setup(
    State(server): State<Arc<Server>>,
    Extension(arrival): Extension<Arrival>,
    given: Body,
) -> Reply {
    let given: Setup = body(given)?;
    if !server.may_try(arrival.peer.ip()) {
        return Err(no(
            StatusCode::TOO_MANY_REQUESTS,
            "too many tries: wait a minute",
        ));
    }
    if !server.is_setup_code(&given.code) {
        server.intrusion(&given.user, arrival, "wrong setup code");
        return Err(no(
            StatusCode::UNAUTHORIZED,
            "this is not the code on the terminal",
        ));
    }
    let user = plain_name(&given.user)?;
    let hash = server.hash(given.password).await?;
    let made = server
        .ledger
        .ask(move |books| {
            books.set_user(&user, Some(&hash), Some(Role::Admin), None, None)?;
            // Whoever sets the console up has what is there.
            for vehicle in books.roster()?.vehicles.keys() {
                books.assign(&user, vehicle, true)?;
            }
            books.account(&user)
        })
        .await
        .map_err(unavailable)?
        .ok_or_else(|| unavailable("the account was not kept"))?;
    if let Some(fleet) = &server.fleet {
        fleet.reload(&server).await;
    }
    server.set_entry(Entry::Password);
    server.forgive(arrival.peer.ip());
    welcome(&server, arrival, made.into(), "setup")
}

pub(in crate::web) async fn logout(
    State(server): State<Arc<Server>>,
    Extension(arrival): Extension<Arrival>,
    Extension(caller): Extension<Caller>,
) -> Response {
    server.end(caller.id);
    server.ledger.note(Note::Login {
        user: caller.session.user,
        from: arrival.peer.ip().to_string(),
        what: "logout",
    });
    let mut response = json(&serde_json::json!({}));
    let cookie = format!(
        "{}=; Max-Age=0; HttpOnly; SameSite=Strict; Path=/{}",
        Server::cookie_name(arrival),
        if arrival.is_tls { "; Secure" } else { "" }
    );
    if let Ok(cookie) = HeaderValue::from_str(&cookie) {
        response.headers_mut().insert(header::SET_COOKIE, cookie);
    }
    response
}

pub(in crate::web) async fn session(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
) -> Response {
    json(&described(&caller.session, &server))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OwnPassword {
    old: String,
    new: String,
}

pub(in crate::web) async fn own_password(
    State(server): State<Arc<Server>>,
    Extension(arrival): Extension<Arrival>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: OwnPassword = body(given)?;
    if !server.may_try(arrival.peer.ip()) {
        return Err(no(
            StatusCode::TOO_MANY_REQUESTS,
            "too many tries: wait a minute",
        ));
    }
    let user = caller.session.user;
    let name = user.clone();
    let kept = server
        .ledger
        .ask(move |books| books.account(&name))
        .await
        .map_err(unavailable)?;
    let hash = kept.map(|account| account.hash);
    if !server.compare(given.old, hash).await? {
        server.intrusion(&user, arrival, "wrong old password");
        return Err(no(
            StatusCode::UNAUTHORIZED,
            "the old password is not right",
        ));
    }
    let hash = server.hash(given.new).await?;
    let name = user.clone();
    let changed = server
        .ledger
        .ask(move |books| {
            books.set_user(&name, Some(&hash), None, None, None)?;
            books.account(&name)
        })
        .await
        .map_err(unavailable)?
        .ok_or_else(|| no(StatusCode::NOT_FOUND, "this account is gone"))?;
    server.end_of(&user);
    welcome(&server, arrival, changed.into(), "password")
}
