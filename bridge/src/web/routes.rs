//! The table of all routes, and what each does. What is not here (and no file of the page) does not exist.

use super::console::{Entry, Server};
use super::gate::{Arrival, Caller, Refused, problem};
use super::ledger::{Log, Note};
use super::password;
use super::role::Role;
use super::sessions::{Session, SessionId};
use super::{gate, pages, signal, socket};
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{MethodRouter, get, post};
use axum::{Extension, Router};
use serde::Deserialize;
use std::sync::Arc;

/// Largest body.
const BODY: usize = 64 * 1024;
/// Newest rows of a log that are shown.
const AUDIT_ROWS: u32 = 1_000;

/// Who may use a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    /// Anybody.
    Public,
    /// Whoever is logged in with at least this role.
    Role(Role),
}

/// A row of the table.
#[derive(Clone, Copy)]
pub(super) struct Route {
    /// GET or POST.
    pub(super) method: Verb,
    /// Path; `{name}` stands for one piece.
    pub(super) path: &'static str,
    /// Who.
    pub(super) access: Access,
    handler: fn() -> MethodRouter<Arc<Server>>,
}

/// The methods in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verb {
    /// Looks.
    Get,
    /// Changes.
    Post,
}

use Access::{Public, Role as Needs};
use Verb::{Get, Post};

/// Every route there is.
pub(super) const TABLE: &[Route] = &[
    Route {
        method: Get,
        path: "/health",
        access: Public,
        handler: || get(health),
    },
    Route {
        method: Post,
        path: "/api/login",
        access: Public,
        handler: || post(login),
    },
    Route {
        method: Post,
        path: "/api/enter",
        access: Public,
        handler: || post(enter),
    },
    Route {
        method: Post,
        path: "/api/setup",
        access: Public,
        handler: || post(setup),
    },
    Route {
        method: Post,
        path: "/api/logout",
        access: Needs(Role::Viewer),
        handler: || post(logout),
    },
    Route {
        method: Get,
        path: "/api/session",
        access: Needs(Role::Viewer),
        handler: || get(session),
    },
    Route {
        method: Post,
        path: "/api/password",
        access: Needs(Role::Viewer),
        handler: || post(own_password),
    },
    Route {
        method: Get,
        path: "/api/plan",
        access: Needs(Role::Viewer),
        handler: || get(plan),
    },
    Route {
        method: Get,
        path: "/api/socket",
        access: Needs(Role::Viewer),
        handler: || get(socket::open),
    },
    Route {
        method: Get,
        path: "/signal",
        access: Needs(Role::Viewer),
        handler: || get(signal::open),
    },
    Route {
        method: Get,
        path: "/api/parameters",
        access: Needs(Role::Viewer),
        handler: || get(parameters),
    },
    Route {
        method: Get,
        path: "/api/logs",
        access: Needs(Role::Engineer),
        handler: || get(logs),
    },
    Route {
        method: Get,
        path: "/api/logs/{name}",
        access: Needs(Role::Engineer),
        handler: || get(log),
    },
    Route {
        method: Get,
        path: "/api/audit/{name}",
        access: Needs(Role::Admin),
        handler: || get(audit),
    },
    Route {
        method: Get,
        path: "/api/users",
        access: Needs(Role::Admin),
        handler: || get(users),
    },
    Route {
        method: Post,
        path: "/api/users",
        access: Needs(Role::Admin),
        handler: || post(set_user),
    },
    Route {
        method: Post,
        path: "/api/users/remove",
        access: Needs(Role::Admin),
        handler: || post(remove_user),
    },
];

/// Every route: method, path, and the role it needs (none: anybody's). For tests that walk it.
#[must_use]
pub fn table() -> Vec<(&'static str, &'static str, Option<Role>)> {
    TABLE
        .iter()
        .map(|r| {
            let method = match r.method {
                Get => "GET",
                Post => "POST",
            };
            let needs = match r.access {
                Public => None,
                Needs(role) => Some(role),
            };
            (method, r.path, needs)
        })
        .collect()
}

/// The row of a request.
pub(super) fn find(method: &Method, path: &str) -> Option<&'static Route> {
    let fits = |pattern: &str| {
        let (mut a, mut b) = (pattern.split('/'), path.split('/'));
        loop {
            match (a.next(), b.next()) {
                (None, None) => return true,
                (Some(p), Some(s)) if p == s || (p.starts_with('{') && !s.is_empty()) => {}
                _ => return false,
            }
        }
    };
    TABLE.iter().find(|r| {
        let is_method = match r.method {
            Get => *method == Method::GET || *method == Method::HEAD,
            Post => *method == Method::POST,
        };
        is_method && fits(r.path)
    })
}

/// All of it, behind the gate.
pub(super) fn router(server: Arc<Server>) -> Router {
    let mut router = Router::new();
    for route in TABLE {
        router = router.route(route.path, (route.handler)());
    }
    router
        .fallback(get(file))
        .layer(axum::middleware::from_fn_with_state(
            Arc::clone(&server),
            gate::pass,
        ))
        .layer(DefaultBodyLimit::max(BODY))
        .with_state(server)
}

type Reply = Result<Response, Refused>;

fn json(value: &serde_json::Value) -> Response {
    let mut response = value.to_string().into_response();
    response.headers_mut().insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/json"),
    );
    response
}

fn no(status: StatusCode, detail: &str) -> Refused {
    Refused::new(status, detail)
}

fn unavailable(e: impl std::fmt::Display) -> Refused {
    Refused::new(StatusCode::SERVICE_UNAVAILABLE, &e.to_string())
}

/// A body, or what is wrong with it.
fn body<T: serde::de::DeserializeOwned>(
    body: Result<axum::body::Bytes, axum::extract::rejection::BytesRejection>,
) -> Result<T, Refused> {
    let bytes = body.map_err(|e| no(e.status(), "the body cannot be read, or is too large"))?;
    serde_json::from_slice(&bytes).map_err(|e| {
        no(
            StatusCode::BAD_REQUEST,
            &format!("the JSON is not as expected: {e}"),
        )
    })
}

type Body = Result<axum::body::Bytes, axum::extract::rejection::BytesRejection>;

async fn health() -> &'static str {
    "ok\n"
}

async fn file(uri: Uri, headers: axum::http::HeaderMap) -> Response {
    pages::serve(uri.path(), &headers)
        .unwrap_or_else(|| problem(StatusCode::NOT_FOUND, "there is nothing here"))
}

fn described(session: &Session, server: &Server) -> serde_json::Value {
    serde_json::json!({
        "user": session.user,
        "role": session.role.name(),
        "system": session.system,
        "vehicle": { "system": server.us.system, "component": server.us.component, "name": server.vehicle },
        "camera": server.camera.is_some(),
        "version": env!("CARGO_PKG_VERSION"),
    })
}

/// A new session with its cookie.
fn welcome(server: &Server, arrival: Arrival, user: &str, role: Role, what: &'static str) -> Reply {
    let id = SessionId(password::random().map_err(unavailable)?);
    let session = server.begin(id, user, role, what == "link");
    server.ledger.note(Note::Login {
        user: user.to_owned(),
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

async fn login(
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
        .ask(move |books| books.secret(&name))
        .await
        .map_err(unavailable)?;
    let hash = kept.as_ref().map(|(_, hash, _)| hash.clone());
    let is_right = server.compare(given.password, hash).await?;
    match kept {
        Some((name, _, role)) if is_right => {
            server.forgive(arrival.peer.ip());
            welcome(&server, arrival, &name, role, "login")
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

async fn enter(
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
    welcome(&server, arrival, "you", Role::Admin, "link")
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Setup {
    code: String,
    user: String,
    password: String,
}

async fn setup(
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
    let user = user_name(&given.user)?;
    let hash = server.hash(given.password).await?;
    let name = user.clone();
    server
        .ledger
        .ask(move |books| books.set_user(&name, Some(&hash), Some(Role::Admin), None, None))
        .await
        .map_err(unavailable)?;
    server.set_entry(Entry::Password);
    server.forgive(arrival.peer.ip());
    welcome(&server, arrival, &user, Role::Admin, "setup")
}

/// A name that can be typed and printed.
fn user_name(text: &str) -> Result<String, Refused> {
    let is_fine = (1..=32).contains(&text.len())
        && text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "._-@".contains(c));
    if is_fine {
        Ok(text.to_owned())
    } else {
        Err(no(
            StatusCode::UNPROCESSABLE_ENTITY,
            "a user name is 1 to 32 letters, digits, dots, dashes",
        ))
    }
}

async fn logout(
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

async fn session(
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

async fn own_password(
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
        .ask(move |books| books.secret(&name))
        .await
        .map_err(unavailable)?;
    let hash = kept.map(|(_, hash, _)| hash);
    if !server.compare(given.old, hash).await? {
        server.intrusion(&user, arrival, "wrong old password");
        return Err(no(
            StatusCode::UNAUTHORIZED,
            "the old password is not right",
        ));
    }
    let hash = server.hash(given.new).await?;
    let name = user.clone();
    server
        .ledger
        .ask(move |books| books.set_user(&name, Some(&hash), None, None, None))
        .await
        .map_err(unavailable)?;
    server.end_of(&user);
    welcome(&server, arrival, &user, caller.session.role, "password")
}

async fn plan(State(server): State<Arc<Server>>) -> Response {
    json(&server.plan_json)
}

async fn parameters(State(server): State<Arc<Server>>) -> Response {
    json(&server.parameters_json)
}

async fn logs(State(server): State<Arc<Server>>) -> Reply {
    let Some(folder) = server.logs.clone() else {
        return Ok(json(&serde_json::json!([])));
    };
    let names = tokio::task::spawn_blocking(move || {
        let mut out = Vec::new();
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if let (Ok(name), Ok(meta)) = (entry.file_name().into_string(), entry.metadata())
                && meta.is_file()
            {
                out.push(serde_json::json!({ "name": name, "bytes": meta.len() }));
            }
        }
        out
    })
    .await
    .map_err(unavailable)?;
    Ok(json(&serde_json::Value::Array(names)))
}

async fn log(State(server): State<Arc<Server>>, Path(name): Path<String>) -> Reply {
    let nothing = || no(StatusCode::NOT_FOUND, "there is no such log");
    if !crate::gcs::disk::is_plain_name(&name) {
        return Err(nothing());
    }
    let folder = server.logs.clone().ok_or_else(nothing)?;
    let bytes = tokio::task::spawn_blocking(move || {
        let path = folder.join(name);
        // A link in the folder leads nowhere.
        let meta = std::fs::symlink_metadata(&path).ok()?;
        if !meta.is_file() || meta.len() > 256 << 20 {
            return None;
        }
        std::fs::read(path).ok()
    })
    .await
    .map_err(unavailable)?
    .ok_or_else(nothing)?;
    let mut response = bytes.into_response();
    response.headers_mut().insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/octet-stream"),
    );
    response.headers_mut().insert(
        header::CONTENT_DISPOSITION,
        HeaderValue::from_static("attachment"),
    );
    Ok(response)
}

async fn audit(State(server): State<Arc<Server>>, Path(name): Path<String>) -> Reply {
    let log = Log::named(&name).ok_or_else(|| no(StatusCode::NOT_FOUND, "there is no such log"))?;
    let rows = server
        .ledger
        .ask(move |books| books.rows(log, AUDIT_ROWS))
        .await
        .map_err(unavailable)?;
    Ok(json(&serde_json::json!(rows)))
}

async fn users(State(server): State<Arc<Server>>) -> Reply {
    let users = server
        .ledger
        .ask(|books| books.users())
        .await
        .map_err(unavailable)?;
    Ok(json(&serde_json::json!(users)))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ChangedUser {
    name: String,
    role: Option<String>,
    password: Option<String>,
    shown: Option<String>,
    mail: Option<String>,
}

async fn set_user(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: ChangedUser = body(given)?;
    let name = user_name(&given.name)?;
    let role = given
        .role
        .map(|r| r.parse::<Role>())
        .transpose()
        .map_err(|e| no(StatusCode::UNPROCESSABLE_ENTITY, &e))?;
    let hash = match given.password {
        Some(password) => Some(server.hash(password).await?),
        None => None,
    };
    let what = format!(
        "set user {name}{}{}",
        role.map(|r| format!(", role {r}")).unwrap_or_default(),
        if hash.is_some() { ", password" } else { "" }
    );
    let key = name.clone();
    let is_done = server
        .ledger
        .ask(move |books| {
            books.set_user(
                &key,
                hash.as_deref(),
                role,
                given.shown.as_deref(),
                given.mail.as_deref(),
            )
        })
        .await
        .map_err(unavailable)?;
    if !is_done {
        return Err(no(
            StatusCode::UNPROCESSABLE_ENTITY,
            "a new user needs a password",
        ));
    }
    server.end_of(&name);
    server.action(&caller.session.user, what);
    Ok(json(&serde_json::json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Name {
    name: String,
}

async fn remove_user(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: Name = body(given)?;
    let name = given.name.clone();
    let is_done = server
        .ledger
        .ask(move |books| books.remove_user(&name))
        .await
        .map_err(unavailable)?;
    if !is_done {
        return Err(no(StatusCode::NOT_FOUND, "there is no such user"));
    }
    server.end_of(&given.name);
    server.action(&caller.session.user, format!("removed user {}", given.name));
    Ok(json(&serde_json::json!({})))
}
