//! Off the drone: the vehicles that are served here, whose they are, and the routes by which administrators say so.
//!
//! `/api/vehicles/NAME/...` is the API of that vehicle's own console, for users it is assigned to: [`relay`](super::relay).

use super::console::Server;
use super::gate::Caller;
use super::hex;
use super::key::MachineKey;
use super::ledger::{Roster, VehicleRow};
use super::place::{Opener, Place};
use super::role::Role;
use super::routes::{Body, Reply, body, json, no, plain_name, unavailable};
use super::upstream::{self, Afar, Answered, Guest};
use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::task::JoinSet;

/// What is about one vehicle is below this.
const BELOW: &str = "/api/vehicles/";
/// A vehicle's answer to "are you there" is not waited for longer.
const SOON: Duration = Duration::from_millis(1_500);
/// Largest answer of a vehicle about itself.
const ANSWER: usize = 64 * 1024;

/// The vehicle a path is about, and the path at that vehicle's own console: below `/api/` there if `is_known` is true of that, else at
/// the root.
pub(super) fn split(path: &str, is_known: impl Fn(&str) -> bool) -> (Option<String>, String) {
    match path
        .strip_prefix(BELOW)
        .and_then(|rest| rest.split_once('/'))
    {
        Some((name, rest)) if !name.is_empty() => {
            let below = format!("/api/{rest}");
            let there = if is_known(&below) {
                below
            } else {
                format!("/{rest}")
            };
            (Some(name.to_owned()), there)
        }
        _ => (None, path.to_owned()),
    }
}

/// The vehicles.
pub(super) struct Fleet {
    /// As the ledger has it; read again every second.
    roster: Mutex<Arc<Roster>>,
    /// Of the command line, to be added at the start.
    wanted: Mutex<Vec<(Option<String>, Place)>>,
    tell: SyncSender<String>,
}

impl Fleet {
    pub(super) fn new(
        roster: Roster,
        wanted: Vec<(Option<String>, Place)>,
        tell: SyncSender<String>,
    ) -> Self {
        Self {
            roster: Mutex::new(Arc::new(roster)),
            wanted: Mutex::new(wanted),
            tell,
        }
    }

    fn roster(&self) -> Arc<Roster> {
        Arc::clone(&self.roster.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Reads the roster again.
    pub(super) async fn reload(&self, server: &Server) {
        if let Ok(roster) = server.ledger.ask(|books| books.roster()).await {
            *self.roster.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(roster);
        }
    }

    /// Names of a user's vehicles.
    pub(super) fn names_of(&self, user: &str) -> Vec<String> {
        let roster = self.roster();
        roster.of(user).map(|(name, _)| name.to_owned()).collect()
    }

    /// True if a vehicle is a user's, now.
    pub(super) fn is_of(&self, vehicle: &str, user: &str) -> bool {
        self.roster().is_of(vehicle, user)
    }

    /// Where a vehicle is, for a user it is assigned to.
    pub(super) fn place(&self, vehicle: &str, user: &str) -> Option<Place> {
        let roster = self.roster();
        let url = roster
            .is_of(vehicle, user)
            .then(|| roster.vehicles.get(vehicle))??;
        url.parse().ok()
    }

    /// Adds the vehicles of the command line.
    pub(super) async fn add_wanted(&self, server: &Server) {
        let wanted =
            std::mem::take(&mut *self.wanted.lock().unwrap_or_else(PoisonError::into_inner));
        for (name, place) in wanted {
            let shown = place.shown();
            let line = match enlist(server, name, place).await {
                Ok(name) => format!("Vehicle {name}: {shown}"),
                Err(why) => format!("Vehicle at {shown} was not added: {why}"),
            };
            let _ = self.tell.try_send(line);
        }
        self.reload(server).await;
    }
}

impl Guest {
    /// This console itself, not one of its users.
    fn ourselves() -> Self {
        Self {
            user: "console".to_owned(),
            role: Role::Admin,
            session: "console".to_owned(),
        }
    }
}

/// Adds a vehicle under a name, or the one it calls itself; its name.
async fn enlist(server: &Server, name: Option<String>, place: Place) -> Result<String, String> {
    let taken = server
        .ledger
        .ask(|books| books.roster())
        .await
        .map_err(|e| e.to_string())?;
    let known = taken
        .vehicles
        .values()
        .filter_map(|url| url.parse::<Place>().ok())
        .find(|known| known.shown() == place.shown() && matches!(place.opener, Opener::Link(_)));
    // A link that was used already is no matter while the key that was fetched with it opens.
    let (place, called) = match (settle(place).await, known) {
        (Ok(settled), _) => settled,
        (Err(why), Some(known)) => settle(known).await.map_err(|_| why)?,
        (Err(why), None) => return Err(why),
    };
    let name = match name {
        Some(name) => name,
        None => free_name(&called, &place, &taken),
    };
    let row = VehicleRow {
        name: name.clone(),
        url: place.to_string(),
    };
    let vehicle = name.clone();
    server
        .ledger
        .ask(move |books| {
            books.set_vehicle(&row)?;
            // The only user there is has it; among several an administrator says whose it is.
            if let [only] = books.users()?.as_slice() {
                books.assign(&only.name, &vehicle, true)?;
            }
            Ok(())
        })
        .await
        .map_err(|e| e.to_string())?;
    Ok(name)
}

/// A name nobody else has: what the vehicle calls itself, with a number if need be; the same place keeps its name.
fn free_name(called: &str, place: &Place, taken: &Roster) -> String {
    let known = taken.vehicles.iter().find(|(_, url)| {
        url.parse::<Place>()
            .is_ok_and(|known| known.shown() == place.shown())
    });
    if let Some((name, _)) = known {
        return name.clone();
    }
    let mut base: String = called
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || c == '-' {
                c
            } else {
                '-'
            }
        })
        .take(24)
        .collect();
    if plain_name(&base).is_err() {
        base = "drone".to_owned();
    }
    let is_taken = |name: &str| taken.vehicles.keys().any(|n| n.eq_ignore_ascii_case(name));
    if !is_taken(&base) {
        return base;
    }
    (2..)
        .map(|n| format!("{base}-{n}"))
        .find(|name| !is_taken(name))
        .unwrap_or(base)
}

/// Reaches a vehicle: fetches a key if there is only a link, keeps the certificate; and what it calls itself.
async fn settle(mut place: Place) -> Result<(Place, String), String> {
    let ourselves = Guest::ourselves();
    if let Opener::Link(link) = place.opener.clone() {
        let (entered, answer) = post(&place, "/api/enter", None, json!({ "key": link })).await?;
        let cookie = entered
            .get(header::SET_COOKIE)
            .and_then(|c| c.to_str().ok())
            .and_then(|c| c.split(';').next())
            .ok_or("it gave no session")?
            .to_owned();
        let name = format!(
            "console-{}",
            hex::text(&super::password::random::<4>().map_err(|e| e.to_string())?)
        );
        let request = json!({ "name": name, "role": "engineer" });
        let (_, made) = post(&place, "/api/keys", Some(&cookie), request).await?;
        let key = made["key"].as_str().and_then(MachineKey::from_hex);
        place.opener = Opener::Key(key.ok_or("it gave no key")?);
        // The pin it tells is of its own certificate, which nobody on this machine could have put in between.
        if !place.is_tls {
            place.pin = None;
        }
        let called = answer["vehicle"]["name"].as_str().unwrap_or_default();
        return Ok((place, called.to_owned()));
    }
    let answered = upstream::ask(
        &place,
        &ourselves,
        Method::GET,
        "/api/session",
        HeaderMap::new(),
        axum::body::Body::empty(),
    )
    .await;
    match answered {
        Ok(Answered { response, seen }) => {
            if response.status() == StatusCode::UNAUTHORIZED {
                return Err(Afar::Key.to_string());
            }
            place.pin = place.pin.or(seen);
            let said = read(response).await.unwrap_or_default();
            Ok((
                place,
                said["vehicle"]["name"]
                    .as_str()
                    .unwrap_or_default()
                    .to_owned(),
            ))
        }
        // It may be switched off now and there later; another certificate is another matter.
        Err(Afar::Unreachable(_)) => Ok((place, String::new())),
        Err(e) => Err(e.to_string()),
    }
}

async fn post(
    place: &Place,
    path: &str,
    cookie: Option<&str>,
    given: Value,
) -> Result<(HeaderMap, Value), String> {
    let mut headers = HeaderMap::new();
    headers.insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/json"),
    );
    if let Some(cookie) = cookie {
        let cookie = HeaderValue::from_str(cookie).map_err(|e| e.to_string())?;
        headers.insert(header::COOKIE, cookie);
    }
    let given = given.to_string();
    let body = axum::body::Body::from(given);
    let answered = upstream::ask(
        place,
        &Guest::ourselves(),
        Method::POST,
        path,
        headers,
        body,
    )
    .await
    .map_err(|e| e.to_string())?;
    let (status, headers) = (
        answered.response.status(),
        answered.response.headers().clone(),
    );
    let said = read(answered.response).await?;
    if status.is_success() {
        Ok((headers, said))
    } else {
        Err(said["detail"].as_str().unwrap_or("refused").to_owned())
    }
}

async fn read(response: axum::http::Response<hyper::body::Incoming>) -> Result<Value, String> {
    let bytes = axum::body::to_bytes(axum::body::Body::new(response.into_body()), ANSWER)
        .await
        .map_err(|e| e.to_string())?;
    serde_json::from_slice(&bytes).map_err(|e| e.to_string())
}

fn fleet(server: &Server) -> Result<&Fleet, super::gate::Refused> {
    server
        .fleet
        .as_ref()
        .ok_or_else(|| no(StatusCode::NOT_FOUND, "this console is aboard a vehicle"))
}

/// A user's own vehicles, and whether each is there.
pub(super) async fn own(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
) -> Reply {
    let user = caller.session.user.clone();
    let roster = fleet(&server)?.roster();
    let mut asked = JoinSet::new();
    for (name, url) in roster.of(&user) {
        let (name, url, guest) = (name.to_owned(), url.to_owned(), Guest::of(&caller));
        asked.spawn(async move {
            let state = tokio::time::timeout(SOON, look(&url, &guest)).await;
            let why = match state {
                Ok(Ok(said)) => {
                    return (name, json!({ "is_there": true, "about": said["vehicle"] }));
                }
                Ok(Err(why)) => why,
                Err(_) => "it does not answer".to_owned(),
            };
            (name, json!({ "is_there": false, "why": why }))
        });
    }
    let mut out = serde_json::Map::new();
    while let Some(answer) = asked.join_next().await {
        if let Ok((name, state)) = answer {
            out.insert(name, state);
        }
    }
    Ok(json(&Value::Object(out)))
}

async fn look(url: &str, guest: &Guest) -> Result<Value, String> {
    let place: Place = url.parse()?;
    let answered = upstream::ask(
        &place,
        guest,
        Method::GET,
        "/api/session",
        HeaderMap::new(),
        axum::body::Body::empty(),
    )
    .await
    .map_err(|e| e.to_string())?;
    if answered.response.status() == StatusCode::UNAUTHORIZED {
        return Err(Afar::Key.to_string());
    }
    read(answered.response).await
}

/// Every vehicle, where it is (without its key), and whose: for administrators.
pub(super) async fn all(State(server): State<Arc<Server>>) -> Reply {
    let roster = fleet(&server)?.roster();
    let rows: Vec<Value> = roster
        .vehicles
        .iter()
        .map(|(name, url)| {
            let shown = url.parse::<Place>().map(|p| p.shown()).unwrap_or_default();
            let users: Vec<&str> = roster
                .assigned
                .iter()
                .filter(|(_, vehicle)| vehicle == name)
                .map(|(user, _)| user.as_str())
                .collect();
            json!({ "name": name, "url": shown, "users": users })
        })
        .collect();
    Ok(json(&Value::Array(rows)))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NewVehicle {
    name: Option<String>,
    url: String,
}

pub(super) async fn add(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: NewVehicle = body(given)?;
    let fleet = fleet(&server)?;
    let name = match given.name.filter(|n| !n.is_empty()) {
        Some(name) if name.contains('@') => {
            return Err(no(
                StatusCode::UNPROCESSABLE_ENTITY,
                "a vehicle's name has no @",
            ));
        }
        Some(name) => Some(plain_name(&name)?),
        None => None,
    };
    let place: Place = given
        .url
        .parse()
        .map_err(|e: String| no(StatusCode::UNPROCESSABLE_ENTITY, &e))?;
    let shown = place.shown();
    let name = enlist(&server, name, place)
        .await
        .map_err(|e| no(StatusCode::BAD_GATEWAY, &e))?;
    fleet.reload(&server).await;
    server.administered(
        &caller.session.user,
        format!("added vehicle {name} at {shown}"),
    );
    Ok(json(&json!({ "name": name })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Name {
    name: String,
}

pub(super) async fn remove(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: Name = body(given)?;
    let fleet = fleet(&server)?;
    let name = given.name.clone();
    let is_done = server
        .ledger
        .ask(move |books| books.remove_vehicle(&name))
        .await
        .map_err(unavailable)?;
    if !is_done {
        return Err(no(StatusCode::NOT_FOUND, "there is no such vehicle"));
    }
    fleet.reload(&server).await;
    server.administered(
        &caller.session.user,
        format!("removed vehicle {}", given.name),
    );
    Ok(json(&json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Assignment {
    user: String,
    vehicle: String,
    on: bool,
}

pub(super) async fn assign(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: Assignment = body(given)?;
    let fleet = fleet(&server)?;
    let (user, vehicle) = (given.user.clone(), given.vehicle.clone());
    let is_done = server
        .ledger
        .ask(move |books| books.assign(&user, &vehicle, given.on))
        .await
        .map_err(unavailable)?;
    if !is_done {
        return Err(no(
            StatusCode::NOT_FOUND,
            "there is no such user or no such vehicle",
        ));
    }
    fleet.reload(&server).await;
    let verb = if given.on { "assigned" } else { "took away" };
    server.administered(
        &caller.session.user,
        format!("{verb} {}: {}", given.vehicle, given.user),
    );
    Ok(json(&json!({})))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_below_a_vehicle_is_the_path_at_its_own_console() {
        let of = |path| split(path, |below| below == "/api/logs/3.mcap");
        let east = |path: &str| (Some("east".to_owned()), path.to_owned());
        assert_eq!(
            of("/api/vehicles/east/logs/3.mcap"),
            east("/api/logs/3.mcap")
        );
        assert_eq!(of("/api/vehicles/east/signal"), east("/signal"));
        for other in [
            "/api/vehicles",
            "/api/vehicles/",
            "/api/vehicles/east",
            "/api/vehicles//plan",
            "/api/plan",
        ] {
            assert_eq!(of(other), (None, other.to_owned()));
        }
    }

    #[test]
    fn a_vehicle_is_named_as_it_calls_itself_with_a_number_if_that_is_taken() {
        let place = |port: u16| -> Place {
            format!("https://drone:{port}/#key={}", "ab".repeat(32))
                .parse()
                .unwrap()
        };
        let mut taken = Roster::default();
        assert_eq!(free_name("office", &place(1), &taken), "office");
        taken
            .vehicles
            .insert("Office".to_owned(), place(1).to_string());
        assert_eq!(free_name("office", &place(2), &taken), "office-2");
        assert_eq!(
            free_name("office", &place(1), &taken),
            "Office",
            "the same place"
        );
        assert_eq!(free_name("my house!", &place(2), &taken), "my-house-");
        assert_eq!(free_name("", &place(2), &taken), "drone");
    }
}
