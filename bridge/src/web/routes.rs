//! The table of all routes, and what each does. What is not here (and no file of the page) does not exist.

mod accounts;
mod entry;

use super::console::Server;
use super::gate::{Refused, problem};
use super::role::Role;
use super::{aboard, fleet, gate, pages, signal, socket};
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{MethodRouter, get, post};
use std::sync::Arc;

/// Largest body.
pub(super) const BODY: usize = 64 * 1024;

/// Who may use a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Access {
    /// Anybody.
    Public,
    /// Whoever is logged in with at least this role: about the vehicle. Off the drone these are below `/api/vehicles/NAME/`, for whom
    /// the vehicle is assigned to.
    Role(Role),
    /// Whoever is logged in with at least this role: about this console itself.
    Here(Role),
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

use Access::{Here, Public, Role as Needs};
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
        handler: || post(entry::login),
    },
    Route {
        method: Post,
        path: "/api/enter",
        access: Public,
        handler: || post(entry::enter),
    },
    Route {
        method: Post,
        path: "/api/setup",
        access: Public,
        handler: || post(entry::setup),
    },
    Route {
        method: Post,
        path: "/api/logout",
        access: Here(Role::Viewer),
        handler: || post(entry::logout),
    },
    Route {
        method: Get,
        path: "/api/session",
        access: Here(Role::Viewer),
        handler: || get(entry::session),
    },
    Route {
        method: Post,
        path: "/api/password",
        access: Here(Role::Viewer),
        handler: || post(entry::own_password),
    },
    Route {
        method: Get,
        path: "/api/plan",
        access: Needs(Role::Viewer),
        handler: || get(aboard::plan),
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
        handler: || get(aboard::parameters),
    },
    Route {
        method: Get,
        path: "/api/logs",
        access: Needs(Role::Engineer),
        handler: || get(aboard::logs),
    },
    Route {
        method: Get,
        path: "/api/logs/{name}",
        access: Needs(Role::Engineer),
        handler: || get(aboard::log),
    },
    Route {
        method: Get,
        path: "/api/logs/{name}/recording",
        access: Needs(Role::Engineer),
        handler: || get(aboard::recording),
    },
    Route {
        method: Get,
        path: "/api/audit/{name}",
        access: Here(Role::Admin),
        handler: || get(accounts::audit),
    },
    Route {
        method: Get,
        path: "/api/users",
        access: Here(Role::Admin),
        handler: || get(accounts::users),
    },
    Route {
        method: Post,
        path: "/api/users",
        access: Here(Role::Admin),
        handler: || post(accounts::set_user),
    },
    Route {
        method: Post,
        path: "/api/users/remove",
        access: Here(Role::Admin),
        handler: || post(accounts::remove_user),
    },
    Route {
        method: Get,
        path: "/api/keys",
        access: Here(Role::Admin),
        handler: || get(accounts::keys),
    },
    Route {
        method: Post,
        path: "/api/keys",
        access: Here(Role::Admin),
        handler: || post(accounts::make_key),
    },
    Route {
        method: Post,
        path: "/api/keys/remove",
        access: Here(Role::Admin),
        handler: || post(accounts::remove_key),
    },
    Route {
        method: Get,
        path: "/api/vehicles",
        access: Here(Role::Viewer),
        handler: || get(fleet::own),
    },
    Route {
        method: Get,
        path: "/api/fleet",
        access: Here(Role::Admin),
        handler: || get(fleet::all),
    },
    Route {
        method: Post,
        path: "/api/fleet",
        access: Here(Role::Admin),
        handler: || post(fleet::add),
    },
    Route {
        method: Post,
        path: "/api/fleet/remove",
        access: Here(Role::Admin),
        handler: || post(fleet::remove),
    },
    Route {
        method: Post,
        path: "/api/fleet/assign",
        access: Here(Role::Admin),
        handler: || post(fleet::assign),
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
                Needs(role) | Here(role) => Some(role),
            };
            (method, r.path, needs)
        })
        .collect()
}

/// Those of them that are about a vehicle: off the drone they are below `/api/vehicles/NAME/`. For tests that walk them.
#[must_use]
pub fn about_vehicle() -> Vec<&'static str> {
    TABLE
        .iter()
        .filter(|r| matches!(r.access, Needs(_)))
        .map(|r| r.path)
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

pub(super) type Reply = Result<Response, Refused>;

pub(super) fn json(value: &serde_json::Value) -> Response {
    let mut response = value.to_string().into_response();
    response.headers_mut().insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/json"),
    );
    response
}

pub(super) fn no(status: StatusCode, detail: &str) -> Refused {
    Refused::new(status, detail)
}

pub(super) fn unavailable(e: impl std::fmt::Display) -> Refused {
    Refused::new(StatusCode::SERVICE_UNAVAILABLE, &e.to_string())
}

/// A body, or what is wrong with it.
pub(super) fn body<T: serde::de::DeserializeOwned>(
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

pub(super) type Body = Result<axum::body::Bytes, axum::extract::rejection::BytesRejection>;

async fn health() -> &'static str {
    "ok\n"
}

async fn file(uri: Uri, headers: axum::http::HeaderMap) -> Response {
    pages::serve(uri.path(), &headers)
        .unwrap_or_else(|| problem(StatusCode::NOT_FOUND, "there is nothing here"))
}

/// A name that can be typed and printed.
pub(super) fn plain_name(text: &str) -> Result<String, Refused> {
    let is_fine = (1..=32).contains(&text.len())
        && text.starts_with(|c: char| c.is_ascii_alphanumeric())
        && text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "._-@".contains(c));
    if is_fine {
        Ok(text.to_owned())
    } else {
        Err(no(
            StatusCode::UNPROCESSABLE_ENTITY,
            "a name is 1 to 32 letters, digits, dots, dashes, and begins with a letter or digit",
        ))
    }
}
