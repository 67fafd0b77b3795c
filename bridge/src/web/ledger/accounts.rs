//! Users and their passwords, programs and their keys.

use super::super::key::MachineKey;
use super::super::role::Role;
use super::{Books, LedgerError, now_us};
use rusqlite::{OptionalExtension as _, params};
use serde::Serialize;
use std::collections::BTreeMap;

/// Microseconds of a day.
const DAY_US: i64 = 86_400_000_000;

/// A user as administrators see him.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct User {
    /// Log-in name.
    pub name: String,
    /// Name for people.
    pub shown: String,
    /// Mail address.
    pub mail: String,
    /// What he may do.
    #[serde(serialize_with = "role_name")]
    pub role: Role,
}

/// What a log-in is compared with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Account {
    /// Log-in name as it was made.
    pub name: String,
    /// Hash of the password.
    pub hash: String,
    /// What he may do.
    pub role: Role,
    /// When password or role were changed last, UTC us.
    pub changed_us: i64,
}

/// A program's key as administrators see it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct KeyRow {
    /// Its name.
    pub name: String,
    /// The most it may do.
    #[serde(serialize_with = "role_name")]
    pub role: Role,
    /// Made at, UTC us.
    pub made_us: i64,
    /// Good until, UTC us.
    pub until_us: i64,
}

fn role_name<S: serde::Serializer>(role: &Role, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_str(role.name())
}

impl Books {
    /// Number of users.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn count(&self) -> Result<u32, LedgerError> {
        Ok(self
            .db
            .query_row("SELECT count(*) FROM users", [], |r| r.get(0))?)
    }

    /// A user's account.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn account(&self, name: &str) -> Result<Option<Account>, LedgerError> {
        let row = self
            .db
            .query_row(
                "SELECT name, hash, role, changed_us FROM users WHERE name = ?1",
                [name],
                |r| {
                    Ok((
                        r.get::<_, String>(2)?,
                        Account {
                            name: r.get(0)?,
                            hash: r.get(1)?,
                            role: Role::Viewer,
                            changed_us: r.get(3)?,
                        },
                    ))
                },
            )
            .optional()?;
        Ok(row.and_then(|(role, account)| {
            Some(Account {
                role: role.parse().ok()?,
                ..account
            })
        }))
    }

    /// Everybody.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn users(&self) -> Result<Vec<User>, LedgerError> {
        let mut query = self
            .db
            .prepare("SELECT name, shown, mail, role FROM users ORDER BY name")?;
        let rows = query.query_map([], |r| {
            Ok(User {
                name: r.get(0)?,
                shown: r.get(1)?,
                mail: r.get(2)?,
                role: r.get::<_, String>(3)?.parse().unwrap_or(Role::Viewer),
            })
        })?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// Makes a user or changes him; what is none stays. False if he is not there and no hash was given.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn set_user(
        &self,
        name: &str,
        hash: Option<&str>,
        role: Option<Role>,
        shown: Option<&str>,
        mail: Option<&str>,
    ) -> Result<bool, LedgerError> {
        let changed = self.db.execute(
            "UPDATE users SET hash = coalesce(?2, hash), role = coalesce(?3, role),
                 shown = coalesce(?4, shown), mail = coalesce(?5, mail),
                 changed_us = CASE WHEN ?2 IS NULL AND ?3 IS NULL THEN changed_us ELSE ?6 END WHERE name = ?1",
            params![name, hash, role.map(Role::name), shown, mail, now_us()],
        )?;
        if changed > 0 {
            return Ok(true);
        }
        let Some(hash) = hash else { return Ok(false) };
        self.db.execute(
            "INSERT INTO users (name, shown, mail, hash, role, made_us, changed_us) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?6)",
            params![
                name,
                shown.unwrap_or_default(),
                mail.unwrap_or_default(),
                hash,
                role.unwrap_or(Role::Viewer).name(),
                now_us()
            ],
        )?;
        Ok(true)
    }

    /// Removes a user; false if there is none.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn remove_user(&self, name: &str) -> Result<bool, LedgerError> {
        self.db
            .execute("DELETE FROM assignments WHERE user = ?1", [name])?;
        Ok(self
            .db
            .execute("DELETE FROM users WHERE name = ?1", [name])?
            > 0)
    }

    /// Every account and key with the time of its last change: a session that began before is over. Keys are named `@NAME`.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn stamps(&self) -> Result<BTreeMap<String, i64>, LedgerError> {
        let mut query = self.db.prepare(
            "SELECT name, changed_us FROM users UNION ALL SELECT '@' || name, made_us FROM machine_keys",
        )?;
        let rows = query.query_map([], |r| Ok((r.get(0)?, r.get(1)?)))?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// Keeps a key of a program, replacing one of this name.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn set_key(
        &self,
        name: &str,
        key: &MachineKey,
        role: Role,
        days: u32,
    ) -> Result<(), LedgerError> {
        let now = now_us();
        self.db.execute(
            "INSERT OR REPLACE INTO machine_keys (name, hash, role, made_us, until_us) VALUES (?1, ?2, ?3, ?4, ?5)",
            params![
                name,
                key.hash().as_slice(),
                role.name(),
                now,
                now.saturating_add(i64::from(days) * DAY_US)
            ],
        )?;
        Ok(())
    }

    /// The key's row, if there is one and its time is not over.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn key(&self, key: &MachineKey) -> Result<Option<KeyRow>, LedgerError> {
        let now = now_us();
        Ok(self
            .keys_where("WHERE hash = ?1", params![key.hash().as_slice()])?
            .into_iter()
            .find(|k| k.until_us > now))
    }

    /// Every key.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn keys(&self) -> Result<Vec<KeyRow>, LedgerError> {
        self.keys_where("ORDER BY name", params![])
    }

    fn keys_where(
        &self,
        which: &str,
        params: impl rusqlite::Params,
    ) -> Result<Vec<KeyRow>, LedgerError> {
        let mut query = self.db.prepare(&format!(
            "SELECT name, role, made_us, until_us FROM machine_keys {which}"
        ))?;
        let rows = query.query_map(params, |r| {
            Ok(KeyRow {
                name: r.get(0)?,
                role: r.get::<_, String>(1)?.parse().unwrap_or(Role::Viewer),
                made_us: r.get(2)?,
                until_us: r.get(3)?,
            })
        })?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    /// Removes a key; false if there is none.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn remove_key(&self, name: &str) -> Result<bool, LedgerError> {
        Ok(self
            .db
            .execute("DELETE FROM machine_keys WHERE name = ?1", [name])?
            > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_are_made_changed_and_removed() {
        let books = Books::open(None).unwrap();
        assert_eq!(books.count().unwrap(), 0);
        assert!(
            !books
                .set_user("ana", None, Some(Role::Pilot), None, None)
                .unwrap()
        );
        assert!(
            books
                .set_user("ana", Some("h1"), Some(Role::Pilot), Some("Ana"), None)
                .unwrap()
        );
        assert_eq!(
            books
                .account("ANA")
                .unwrap()
                .map(|a| (a.name, a.hash, a.role)),
            Some(("ana".to_owned(), "h1".to_owned(), Role::Pilot)),
            "names do not differ by case"
        );
        books
            .set_user("ana", None, Some(Role::Admin), None, None)
            .unwrap();
        assert_eq!(books.users().unwrap()[0].role, Role::Admin);
        assert!(books.remove_user("ana").unwrap() && !books.remove_user("ana").unwrap());
    }

    #[test]
    fn a_changed_password_or_role_changes_the_stamp_and_a_name_for_people_does_not() {
        let path = std::env::temp_dir().join(format!("kestrel-stamps-{}", std::process::id()));
        let books = Books::open(Some(&path)).unwrap();
        books.set_user("ana", Some("h"), None, None, None).unwrap();
        let before = books.stamps().unwrap();
        let other = Books::open(Some(&path)).unwrap();
        other
            .set_user("ana", None, None, Some("Ana"), None)
            .unwrap();
        assert_eq!(books.stamps().unwrap(), before);
        other.set_user("ana", Some("h2"), None, None, None).unwrap();
        assert!(books.stamps().unwrap()["ana"] > before["ana"]);
        other.remove_user("ana").unwrap();
        assert!(!books.stamps().unwrap().contains_key("ana"));
        drop((books, other));
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_key_opens_until_its_time_is_over_and_only_its_hash_is_kept() {
        let books = Books::open(None).unwrap();
        let key = MachineKey::from_hex(&"ab".repeat(32)).unwrap();
        books
            .set_key("guardhouse", &key, Role::Engineer, 1)
            .unwrap();
        let row = books.key(&key).unwrap().unwrap();
        assert_eq!(
            (row.name.as_str(), row.role),
            ("guardhouse", Role::Engineer)
        );
        let another = MachineKey::from_hex(&"ac".repeat(32)).unwrap();
        assert_eq!(books.key(&another).unwrap(), None);
        books
            .set_key("guardhouse", &key, Role::Engineer, 0)
            .unwrap();
        assert_eq!(books.key(&key).unwrap(), None, "its time is over");
        assert!(books.remove_key("GUARDHOUSE").unwrap() && books.keys().unwrap().is_empty());
    }
}
