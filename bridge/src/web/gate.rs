//! Every request passes here: host, origin, kind of body, session, role; and every answer gets its headers here.
//!
//! What is not in the table of [`routes`] and not a file of the page is not there; what is in the table without being public
//! needs a session of at least its role. Off the drone, what is about a vehicle (`/api/vehicles/NAME/...`) needs one whose user the
//! vehicle is assigned to, and goes on to that vehicle's own console. Nothing else decides that.

use super::console::Server;
use super::key::{self, MachineKey};
use super::ledger::Note;
use super::role::Role;
use super::routes::{Access, Route, find};
use super::sessions::{Entrant, Session, SessionId};
use super::{fleet, relay};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use std::net::SocketAddr;
use std::sync::Arc;

/// How a request came in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    /// From where.
    pub(super) peer: SocketAddr,
    /// To which of our addresses.
    pub(super) local: SocketAddr,
    /// Encrypted.
    pub(super) is_tls: bool,
}

/// Who asks.
#[derive(Clone, Debug)]
pub(super) struct Caller {
    pub(super) id: SessionId,
    pub(super) session: Session,
}

/// The page needs nothing from anywhere else, and nobody may frame it.
const CSP: &str = "default-src 'self'; connect-src 'self'; img-src 'self' data: blob:; media-src 'self' blob:; \
                   base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// An error as RFC 9457 has it.
pub(super) fn problem(status: StatusCode, detail: &str) -> Response {
    let body = serde_json::json!({
        "type": "about:blank",
        "title": status.canonical_reason().unwrap_or("Error"),
        "status": status.as_u16(),
        "detail": detail,
    });
    let mut response = (status, body.to_string()).into_response();
    response.headers_mut().insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/problem+json"),
    );
    response
}

/// A refusal on its way out of a handler.
pub(super) struct Refused(Box<Response>);

impl Refused {
    pub(super) fn new(status: StatusCode, detail: &str) -> Self {
        Self(Box::new(problem(status, detail)))
    }
}

impl axum::response::IntoResponse for Refused {
    fn into_response(self) -> Response {
        *self.0
    }
}

/// The gate.
pub(super) async fn pass(
    State(server): State<Arc<Server>>,
    arrival: axum::Extension<Arrival>,
    request: Request,
    next: Next,
) -> Response {
    let mut response = judge(&server, *arrival, request, next).await;
    let headers = response.headers_mut();
    let mut set = |name, value| {
        headers
            .entry(name)
            .or_insert(HeaderValue::from_static(value));
    };
    set(header::CONTENT_SECURITY_POLICY, CSP);
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::REFERRER_POLICY, "no-referrer");
    set(header::X_FRAME_OPTIONS, "DENY");
    set(header::CACHE_CONTROL, "no-store");
    response
}

async fn judge(
    server: &Arc<Server>,
    arrival: Arrival,
    mut request: Request,
    next: Next,
) -> Response {
    let Some(host) = host_of(request.headers(), request.uri()) else {
        return problem(StatusCode::BAD_REQUEST, "no host");
    };
    if !server.is_ours(&host, arrival) {
        server.intrusion("", arrival, &format!("foreign host {host}"));
        return problem(StatusCode::FORBIDDEN, "this host name is not served here");
    }
    let is_upgrade = request.headers().contains_key(header::UPGRADE);
    let is_safe = matches!(*request.method(), Method::GET | Method::HEAD) && !is_upgrade;
    if !is_safe {
        let origin = request
            .headers()
            .get(header::ORIGIN)
            .and_then(|o| o.to_str().ok())
            .unwrap_or_default();
        let expected = format!("{}://{host}", if arrival.is_tls { "https" } else { "http" });
        if origin != expected {
            server.intrusion("", arrival, &format!("foreign origin {origin}"));
            return problem(StatusCode::FORBIDDEN, "this origin is not served here");
        }
    }
    let is_json = |h: &HeaderMap| {
        h.get(header::CONTENT_TYPE)
            .and_then(|t| t.to_str().ok())
            .is_some_and(|t| t.split(';').next() == Some("application/json"))
    };
    if !is_safe && !is_upgrade && !is_json(request.headers()) {
        return problem(StatusCode::UNSUPPORTED_MEDIA_TYPE, "a body must be JSON");
    }
    let is_known = |path: &str| find(request.method(), path).is_some();
    let (vehicle, path) = fleet::split(request.uri().path(), is_known);
    let (needs, is_about_vehicle) = match find(request.method(), &path) {
        Some(Route {
            access: Access::Role(role),
            ..
        }) => (Some(*role), true),
        Some(Route {
            access: Access::Here(role),
            ..
        }) if vehicle.is_none() => (Some(*role), false),
        Some(Route {
            access: Access::Public,
            ..
        }) if vehicle.is_none() => (None, false),
        None if vehicle.is_none() && !path.starts_with("/api/") => (None, false),
        _ => return nothing(),
    };
    let Some(needs) = needs else {
        return next.run(request).await;
    };
    let caller = match server.enters(request.headers(), arrival).await {
        Ok(caller) => caller,
        Err(refused) => return refused.into_response(),
    };
    if caller.session.role < needs {
        server.intrusion(
            &caller.session.user,
            arrival,
            &format!("{} {path} needs the role {needs}", request.method()),
        );
        return problem(
            StatusCode::FORBIDDEN,
            &format!("this needs the role {needs}"),
        );
    }
    // Looking is not using: a page that polls does not keep a session alive.
    if !is_safe {
        server.touch(caller.id);
    }
    if is_about_vehicle {
        match (&server.aboard, &server.fleet, vehicle) {
            (Some(aboard), _, None) => {
                request.extensions_mut().insert(Arc::clone(aboard));
            }
            (_, Some(fleet), Some(name)) => {
                // A vehicle that is not there is refused like one of somebody else: names are not for guessing.
                let Some(place) = fleet.place(&name, &caller.session.user) else {
                    let what = format!("{path} of the vehicle {name}, which is not his");
                    server.intrusion(&caller.session.user, arrival, &what);
                    return problem(StatusCode::FORBIDDEN, "this vehicle is not assigned to you");
                };
                let to = relay::To { name, place, path };
                return relay::pass(server, arrival, caller, to, request).await;
            }
            _ => return nothing(),
        }
    }
    request.extensions_mut().insert(caller);
    next.run(request).await
}

fn nothing() -> Response {
    problem(StatusCode::NOT_FOUND, "there is nothing here")
}

fn host_of(headers: &HeaderMap, uri: &Uri) -> Option<String> {
    let host = headers
        .get(header::HOST)
        .and_then(|h| h.to_str().ok())
        .or_else(|| uri.authority().map(|a| a.as_str()))?;
    Some(host.to_ascii_lowercase())
}

impl Server {
    /// True if a host name (with port) is ours on this connection. Names of others that lead to us are DNS rebinding.
    fn is_ours(&self, host: &str, arrival: Arrival) -> bool {
        let port = arrival.local.port();
        let (name, host_port) = match host.rsplit_once(':') {
            Some((name, p)) if !p.ends_with(']') => (name, p.parse::<u16>().ok()),
            _ => (host, Some(if arrival.is_tls { 443 } else { 80 })),
        };
        if host_port != Some(port) {
            return false;
        }
        let local = arrival.local.ip().to_canonical();
        let is_address = name
            .trim_matches(['[', ']'])
            .parse::<std::net::IpAddr>()
            .is_ok_and(|a| a == local);
        is_address
            || (local.is_loopback() && name == "localhost")
            || self.names.iter().any(|n| n == name)
    }

    /// Name of the session cookie: ports do not separate cookies, so the name does.
    pub(super) fn cookie_name(arrival: Arrival) -> String {
        let port = arrival.local.port();
        if arrival.is_tls {
            format!("__Host-kestrel-{port}")
        } else {
            format!("kestrel-{port}")
        }
    }

    /// Who asks: a browser by its cookie, a program by its key.
    async fn enters(&self, headers: &HeaderMap, arrival: Arrival) -> Result<Caller, Refused> {
        let log_in = || Refused::new(StatusCode::UNAUTHORIZED, "log in first");
        let Some(given) = headers.get(header::AUTHORIZATION) else {
            return self.caller(headers, arrival).ok_or_else(log_in);
        };
        let text = |name: &str| headers.get(name).and_then(|v| v.to_str().ok());
        let named = text(key::SESSION).unwrap_or_default();
        let user = text(key::USER).unwrap_or_default();
        let claimed = text(key::ROLE).map_or(Ok(Role::Viewer), str::parse);
        let given = given.to_str().ok().and_then(|v| v.strip_prefix("Bearer "));
        let (Some(given), Ok(claimed), true) = (
            given.and_then(MachineKey::from_hex),
            claimed,
            user.len() <= 32 && named.len() <= 64,
        ) else {
            return Err(log_in());
        };
        let (asked, session) = (given.clone(), given.session(named));
        let row = self
            .ledger
            .ask(move |books| books.key(&asked))
            .await
            .map_err(|e| Refused::new(StatusCode::SERVICE_UNAVAILABLE, &e.to_string()))?;
        let Some(row) = row else {
            // Keys are not guessed; whoever tries many is slowed down all the same.
            if self.may_try(arrival.peer.ip()) {
                self.intrusion(user, arrival, "an unknown key");
            }
            return Err(log_in());
        };
        let role = claimed.min(row.role);
        let user = format!("{user}@{}", row.name);
        // The same browser with another role, or another user in it, is a new session.
        if let Some(open) = self.session(session)
            && open.role == role
            && open.user == user
        {
            return Ok(Caller {
                id: session,
                session: open,
            });
        }
        self.end(session);
        let who = Entrant {
            user: user.clone(),
            role,
            account: Some((format!("@{}", row.name), row.made_us)),
            // Whoever has the key looks after his own users' idleness.
            stays: true,
        };
        self.ledger.note(Note::Login {
            user,
            from: arrival.peer.ip().to_string(),
            what: "key",
        });
        Ok(Caller {
            id: session,
            session: self.begin(session, who),
        })
    }

    /// The session of a request's cookie.
    fn caller(&self, headers: &HeaderMap, arrival: Arrival) -> Option<Caller> {
        let name = Self::cookie_name(arrival);
        let id = headers
            .get_all(header::COOKIE)
            .iter()
            .filter_map(|c| c.to_str().ok())
            .flat_map(|c| c.split(';'))
            .filter_map(|pair| pair.trim().split_once('='))
            .find(|(n, _)| *n == name)
            .and_then(|(_, v)| SessionId::from_hex(v))?;
        let session = self.session(id)?;
        Some(Caller { id, session })
    }

    /// Writes a refusal down.
    pub(super) fn intrusion(&self, user: &str, arrival: Arrival, what: &str) {
        self.ledger.note(Note::Intrusion {
            user: user.to_owned(),
            from: arrival.peer.ip().to_string(),
            what: what.to_owned(),
        });
    }
}

/// What plain HTTP from another machine gets.
pub(super) fn redirect(host: &str, path: &str) -> Response {
    let mut response = Response::new(Body::empty());
    *response.status_mut() = StatusCode::PERMANENT_REDIRECT;
    if let Ok(to) = HeaderValue::from_str(&format!("https://{host}{path}")) {
        response.headers_mut().insert(header::LOCATION, to);
    }
    response
}
