//! Accounts, log-ins, intrusions and actions, each a row with user and time, in one SQLite file.
//!
//! A thread of its own owns the file: what must not wait (a note) goes into a bounded queue and is dropped and counted when
//! that is full; what needs an answer waits for it there and nowhere else.
//!
//! | Table | Rows |
//! | --- | --- |
//! | `users` | name, shown name, mail address, hash of the password, role, when it was changed |
//! | `machine_keys` | name, hash of the key, role, until when: programs that come instead of a browser |
//! | `vehicles`, `assignments` | off the drone: whose consoles are served here, and who may use which |
//! | `logins` | user, time, address; and the end of each session |
//! | `intrusions` | name that was tried, time, address, what was wrong |
//! | `actions` | user, time, vehicle, what was asked of it |

mod accounts;
mod roster;

pub use accounts::{Account, KeyRow, User};
pub use roster::{Roster, VehicleRow};

use crate::io::clock;
use rusqlite::{Connection, params};
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;
use thiserror::Error;
use tokio::sync::oneshot;

/// Name of the file in the state folder.
pub const FILE: &str = "console.sqlite3";
/// Jobs that wait at most.
const QUEUE: usize = 512;
/// Rows kept of each log.
const ROWS: u32 = 100_000;

/// Why the ledger cannot do something.
#[derive(Debug, Error)]
pub enum LedgerError {
    /// SQLite says no.
    #[error("accounts: {0}")]
    Sqlite(#[from] rusqlite::Error),
    /// The file cannot be made private, or its thread started.
    #[error("accounts: {0}")]
    Io(#[from] std::io::Error),
    /// Too much is asked of it at once.
    #[error("accounts: busy")]
    Busy,
}

/// What is to be remembered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// A session began (or ended).
    Login {
        /// Who.
        user: String,
        /// From where.
        from: String,
        /// What: `login`, `logout`, `link`, `setup`.
        what: &'static str,
    },
    /// Somebody tried what he may not.
    Intrusion {
        /// Name he gave, or his session's.
        user: String,
        /// From where.
        from: String,
        /// What was wrong.
        what: String,
    },
    /// Something was asked of the vehicle.
    Action {
        /// Who.
        user: String,
        /// Of which vehicle.
        vehicle: String,
        /// What.
        what: String,
    },
}

/// A row of a log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Row {
    /// UTC, us.
    pub at_us: i64,
    /// Who.
    pub user: String,
    /// Address, or vehicle.
    pub place: String,
    /// What.
    pub what: String,
}

/// Which log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Log {
    /// Sessions.
    Logins,
    /// Refusals.
    Intrusions,
    /// Commands.
    Actions,
}

impl Log {
    /// By the name of its table.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "logins" => Some(Self::Logins),
            "intrusions" => Some(Self::Intrusions),
            "actions" => Some(Self::Actions),
            _ => None,
        }
    }

    const fn table(self) -> &'static str {
        match self {
            Self::Logins => "logins",
            Self::Intrusions => "intrusions",
            Self::Actions => "actions",
        }
    }
}

/// The file, for whoever owns it.
pub struct Books {
    db: Connection,
    notes: u32,
}

impl Books {
    /// Opens the file (made if it is not there, readable by its owner only), or memory.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn open(path: Option<&Path>) -> Result<Self, LedgerError> {
        let db = match path {
            Some(path) => {
                use std::os::unix::fs::OpenOptionsExt as _;
                std::fs::OpenOptions::new()
                    .create(true)
                    .append(true)
                    .mode(0o600)
                    .open(path)?;
                Connection::open(path)?
            }
            None => Connection::open_in_memory()?,
        };
        db.busy_timeout(Duration::from_secs(2))?;
        db.execute_batch(
            "PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL;
             CREATE TABLE IF NOT EXISTS users (
                 name TEXT PRIMARY KEY COLLATE NOCASE, shown TEXT NOT NULL, mail TEXT NOT NULL,
                 hash TEXT NOT NULL, role TEXT NOT NULL, made_us INTEGER NOT NULL, changed_us INTEGER NOT NULL DEFAULT 0) STRICT;
             CREATE TABLE IF NOT EXISTS machine_keys (
                 name TEXT PRIMARY KEY COLLATE NOCASE, hash BLOB NOT NULL, role TEXT NOT NULL,
                 made_us INTEGER NOT NULL, until_us INTEGER NOT NULL) STRICT;
             CREATE TABLE IF NOT EXISTS vehicles (
                 name TEXT PRIMARY KEY COLLATE NOCASE, url TEXT NOT NULL, made_us INTEGER NOT NULL) STRICT;
             CREATE TABLE IF NOT EXISTS assignments (
                 user TEXT NOT NULL COLLATE NOCASE, vehicle TEXT NOT NULL COLLATE NOCASE, PRIMARY KEY (user, vehicle)) STRICT;
             CREATE TABLE IF NOT EXISTS logins (
                 id INTEGER PRIMARY KEY, at_us INTEGER NOT NULL, user TEXT NOT NULL, place TEXT NOT NULL, what TEXT NOT NULL) STRICT;
             CREATE TABLE IF NOT EXISTS intrusions (
                 id INTEGER PRIMARY KEY, at_us INTEGER NOT NULL, user TEXT NOT NULL, place TEXT NOT NULL, what TEXT NOT NULL) STRICT;
             CREATE TABLE IF NOT EXISTS actions (
                 id INTEGER PRIMARY KEY, at_us INTEGER NOT NULL, user TEXT NOT NULL, place TEXT NOT NULL, what TEXT NOT NULL) STRICT;",
        )?;
        // Accounts of an earlier version.
        let has_change = db.query_row(
            "SELECT count(*) FROM pragma_table_info('users') WHERE name = 'changed_us'",
            [],
            |r| r.get::<_, i64>(0),
        )?;
        if has_change == 0 {
            db.execute_batch("ALTER TABLE users ADD COLUMN changed_us INTEGER NOT NULL DEFAULT 0")?;
        }
        Ok(Self { db, notes: 0 })
    }

    /// The newest rows of a log, newest first.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn rows(&self, log: Log, most: u32) -> Result<Vec<Row>, LedgerError> {
        let mut query = self.db.prepare(&format!(
            "SELECT at_us, user, place, what FROM {} ORDER BY id DESC LIMIT ?1",
            log.table()
        ))?;
        let rows = query.query_map([most], |r| {
            Ok(Row {
                at_us: r.get(0)?,
                user: r.get(1)?,
                place: r.get(2)?,
                what: r.get(3)?,
            })
        })?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// Writes a row.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn note(&mut self, note: &Note) -> Result<(), LedgerError> {
        let (log, user, place, what) = match note {
            Note::Login { user, from, what } => (Log::Logins, user, from.clone(), *what),
            Note::Intrusion { user, from, what } => {
                (Log::Intrusions, user, from.clone(), what.as_str())
            }
            Note::Action {
                user,
                vehicle,
                what,
            } => (Log::Actions, user, vehicle.clone(), what.as_str()),
        };
        let table = log.table();
        self.db.execute(
            &format!("INSERT INTO {table} (at_us, user, place, what) VALUES (?1, ?2, ?3, ?4)"),
            params![now_us(), cut(user, 64), cut(&place, 64), cut(what, 200)],
        )?;
        self.notes += 1;
        if self.notes.is_multiple_of(1_000) {
            self.db.execute(
                &format!("DELETE FROM {table} WHERE id <= (SELECT max(id) FROM {table}) - ?1"),
                [ROWS],
            )?;
        }
        Ok(())
    }
}

/// At most so many characters: what strangers send is kept, not hoarded.
fn cut(text: &str, most: usize) -> String {
    text.chars()
        .filter(|c| !c.is_control())
        .take(most)
        .collect()
}

fn now_us() -> i64 {
    clock::utc_us().cast_signed()
}

type Job = Box<dyn FnOnce(&mut Books) + Send>;

/// The way to the thread that owns the file.
#[derive(Clone)]
pub struct Ledger {
    jobs: SyncSender<Job>,
    dropped: Arc<AtomicU64>,
}

impl Ledger {
    /// Starts the thread.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn start(mut books: Books) -> Result<Self, LedgerError> {
        let (jobs, asked) = sync_channel::<Job>(QUEUE);
        std::thread::Builder::new()
            .name("ledger".to_owned())
            .spawn(move || {
                for job in asked {
                    job(&mut books);
                }
            })?;
        Ok(Self {
            jobs,
            dropped: Arc::default(),
        })
    }

    /// Remembers something. Never waits; dropped and counted if too much happens at once.
    pub fn note(&self, note: Note) {
        let dropped = Arc::clone(&self.dropped);
        let job: Job = Box::new(move |books| {
            if let Err(e) = books.note(&note) {
                dropped.fetch_add(1, Ordering::Relaxed);
                tracing::warn!("{e}");
            }
        });
        if self.jobs.try_send(job).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Notes that were lost.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Asks something of the file.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub async fn ask<T: Send + 'static>(
        &self,
        question: impl FnOnce(&mut Books) -> Result<T, LedgerError> + Send + 'static,
    ) -> Result<T, LedgerError> {
        let (reply, answer) = oneshot::channel();
        let job: Job = Box::new(move |books| drop(reply.send(question(books))));
        self.jobs.try_send(job).map_err(|_| LedgerError::Busy)?;
        answer.await.map_err(|_| LedgerError::Busy)?
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_action_login_and_intrusion_is_a_row_with_user_and_time() {
        let mut books = Books::open(None).unwrap();
        let user = || "ana".to_owned();
        books
            .note(&Note::Login {
                user: user(),
                from: "10.0.0.1".to_owned(),
                what: "login",
            })
            .unwrap();
        books
            .note(&Note::Action {
                user: user(),
                vehicle: "vehicle 1".to_owned(),
                what: "NAV_TAKEOFF".to_owned(),
            })
            .unwrap();
        books
            .note(&Note::Intrusion {
                user: "x'; DROP TABLE users;--\n".to_owned(),
                from: "10.0.0.9".to_owned(),
                what: "wrong password".repeat(99),
            })
            .unwrap();
        for (log, who, what) in [
            (Log::Logins, "ana", "login"),
            (Log::Actions, "ana", "NAV_TAKEOFF"),
            (Log::Intrusions, "x'; DROP TABLE users;--", "wrong password"),
        ] {
            let rows = books.rows(log, 10).unwrap();
            assert_eq!((rows.len(), rows[0].user.as_str()), (1, who));
            assert!(rows[0].what.starts_with(what) && rows[0].what.len() <= 200);
            assert!(rows[0].at_us > 1_600_000_000_000_000);
        }
    }

    #[test]
    fn the_file_is_for_its_owner_only_and_outlives_the_program() {
        use std::os::unix::fs::PermissionsExt as _;
        let path = std::env::temp_dir().join(format!("kestrel-ledger-{}", std::process::id()));
        {
            let books = Books::open(Some(&path)).unwrap();
            books.set_user("ana", Some("h"), None, None, None).unwrap();
        }
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(Books::open(Some(&path)).unwrap().count().unwrap(), 1);
        std::fs::remove_file(&path).unwrap();
    }
}
