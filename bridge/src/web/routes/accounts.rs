//! Users, keys of programs, and the logs of what they did: for administrators.

use super::super::console::Server;
use super::super::gate::Caller;
use super::super::key::MachineKey;
use super::super::ledger::Log;
use super::super::role::Role;
use super::super::{hex, password};
use super::{Body, Reply, body, json, no, plain_name, unavailable};
use axum::Extension;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use serde::Deserialize;
use std::sync::Arc;

/// Newest rows of a log that are shown.
const AUDIT_ROWS: u32 = 1_000;
/// Days a key is good for unless said otherwise.
const DAYS: u32 = 365;

pub(in crate::web) async fn audit(
    State(server): State<Arc<Server>>,
    Path(name): Path<String>,
) -> Reply {
    let log = Log::named(&name).ok_or_else(|| no(StatusCode::NOT_FOUND, "there is no such log"))?;
    let rows = server
        .ledger
        .ask(move |books| books.rows(log, AUDIT_ROWS))
        .await
        .map_err(unavailable)?;
    Ok(json(&serde_json::json!(rows)))
}

pub(in crate::web) async fn users(State(server): State<Arc<Server>>) -> Reply {
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

pub(in crate::web) async fn set_user(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: ChangedUser = body(given)?;
    let name = plain_name(&given.name)?;
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
    server.administered(&caller.session.user, what);
    Ok(json(&serde_json::json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Name {
    name: String,
}

/// Who signs in.
#[derive(Clone, Copy)]
enum Account {
    User,
    Key,
}

/// Strikes an account from the books and ends its sessions.
async fn remove(server: &Arc<Server>, caller: &Caller, given: Body, kind: Account) -> Reply {
    let Name { name } = body(given)?;
    let entry = name.clone();
    let is_done = server
        .ledger
        .ask(move |books| match kind {
            Account::User => books.remove_user(&entry),
            Account::Key => books.remove_key(&entry),
        })
        .await
        .map_err(unavailable)?;
    // A key signs in under its name behind an @.
    let (word, login) = match kind {
        Account::User => ("user", name.clone()),
        Account::Key => ("key", format!("@{name}")),
    };
    if !is_done {
        return Err(no(
            StatusCode::NOT_FOUND,
            &format!("there is no such {word}"),
        ));
    }
    server.end_of(&login);
    server.administered(&caller.session.user, format!("removed {word} {name}"));
    Ok(json(&serde_json::json!({})))
}

pub(in crate::web) async fn remove_user(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let reply = remove(&server, &caller, given, Account::User).await?;
    if let Some(fleet) = &server.fleet {
        fleet.reload(&server).await;
    }
    Ok(reply)
}

pub(in crate::web) async fn keys(State(server): State<Arc<Server>>) -> Reply {
    let keys = server
        .ledger
        .ask(|books| books.keys())
        .await
        .map_err(unavailable)?;
    Ok(json(&serde_json::json!(keys)))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NewKey {
    name: String,
    role: Option<String>,
    days: Option<u32>,
}

/// The key is told once, here; the drone keeps its hash.
pub(in crate::web) async fn make_key(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    let given: NewKey = body(given)?;
    let name = plain_name(&given.name)?;
    let role = match given.role {
        Some(role) => role
            .parse::<Role>()
            .map_err(|e| no(StatusCode::UNPROCESSABLE_ENTITY, &e))?,
        None => Role::Engineer,
    };
    let key = MachineKey::new(password::random().map_err(unavailable)?);
    let what = format!("made key {name}, role {role}");
    let told = key.to_hex();
    server.end_of(&format!("@{name}"));
    server
        .ledger
        .ask(move |books| books.set_key(&name, &key, role, given.days.unwrap_or(DAYS)))
        .await
        .map_err(unavailable)?;
    server.administered(&caller.session.user, what);
    Ok(json(
        &serde_json::json!({ "key": told, "pin": hex::text(&server.pin) }),
    ))
}

pub(in crate::web) async fn remove_key(
    State(server): State<Arc<Server>>,
    Extension(caller): Extension<Caller>,
    given: Body,
) -> Reply {
    remove(&server, &caller, given, Account::Key).await
}
