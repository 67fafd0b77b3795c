//! Off the drone: the vehicles that are served, and who may use which.

use super::{Books, LedgerError, now_us};
use rusqlite::params;
use std::collections::{BTreeMap, BTreeSet};

/// A vehicle: its name here, and where its console is (with the key that opens it: not for people).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VehicleRow {
    /// Name.
    pub name: String,
    /// Where, with key and certificate: [`Place`](super::super::place::Place) as text.
    pub url: String,
}

/// All vehicles and assignments.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Roster {
    /// Where each is, by name.
    pub vehicles: BTreeMap<String, String>,
    /// (user, vehicle), as they are written in their tables.
    pub assigned: BTreeSet<(String, String)>,
}

impl Roster {
    /// True if a vehicle is there and the user's.
    #[must_use]
    pub fn is_of(&self, vehicle: &str, user: &str) -> bool {
        self.vehicles.contains_key(vehicle)
            && self
                .assigned
                .contains(&(user.to_owned(), vehicle.to_owned()))
    }

    /// A user's vehicles.
    pub fn of<'a>(&'a self, user: &'a str) -> impl Iterator<Item = (&'a str, &'a str)> {
        self.vehicles
            .iter()
            .filter(move |(name, _)| self.is_of(name, user))
            .map(|(name, url)| (name.as_str(), url.as_str()))
    }
}

impl Books {
    /// Everything about vehicles.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn roster(&self) -> Result<Roster, LedgerError> {
        let mut query = self.db.prepare("SELECT name, url FROM vehicles")?;
        let vehicles = query.query_map([], |r| Ok((r.get(0)?, r.get(1)?)))?;
        let vehicles = vehicles.collect::<Result<_, _>>()?;
        // Names as they are written where they were made.
        let mut query = self.db.prepare(
            "SELECT u.name, v.name FROM assignments a JOIN users u ON u.name = a.user JOIN vehicles v ON v.name = a.vehicle",
        )?;
        let assigned = query.query_map([], |r| Ok((r.get(0)?, r.get(1)?)))?;
        let assigned = assigned.collect::<Result<_, _>>()?;
        Ok(Roster { vehicles, assigned })
    }

    /// Adds a vehicle, or says anew where it is.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn set_vehicle(&self, row: &VehicleRow) -> Result<(), LedgerError> {
        self.db.execute(
            "INSERT INTO vehicles (name, url, made_us) VALUES (?1, ?2, ?3)
             ON CONFLICT (name) DO UPDATE SET url = excluded.url",
            params![row.name, row.url, now_us()],
        )?;
        Ok(())
    }

    /// Removes a vehicle and whom it was assigned to; false if there is none.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn remove_vehicle(&self, name: &str) -> Result<bool, LedgerError> {
        self.db
            .execute("DELETE FROM assignments WHERE vehicle = ?1", [name])?;
        Ok(self
            .db
            .execute("DELETE FROM vehicles WHERE name = ?1", [name])?
            > 0)
    }

    /// Assigns a vehicle to a user, or takes it away; false if one of them is not there.
    ///
    /// # Errors
    /// [`LedgerError`].
    pub fn assign(&self, user: &str, vehicle: &str, is_his: bool) -> Result<bool, LedgerError> {
        let are_there = self.db.query_row(
            "SELECT (SELECT count(*) FROM users WHERE name = ?1) * (SELECT count(*) FROM vehicles WHERE name = ?2)",
            [user, vehicle],
            |r| r.get::<_, i64>(0),
        )?;
        if are_there == 0 {
            return Ok(false);
        }
        let statement = if is_his {
            "INSERT OR IGNORE INTO assignments (user, vehicle) VALUES (?1, ?2)"
        } else {
            "DELETE FROM assignments WHERE user = ?1 AND vehicle = ?2"
        };
        self.db.execute(statement, [user, vehicle])?;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_has_what_is_assigned_to_him_and_loses_it_with_his_account_or_the_vehicle() {
        let books = Books::open(None).unwrap();
        for user in ["ana", "ben"] {
            books.set_user(user, Some("h"), None, None, None).unwrap();
        }
        for name in ["east", "west"] {
            let url = format!("https://{name}/");
            let name = name.to_owned();
            books.set_vehicle(&VehicleRow { name, url }).unwrap();
        }
        assert!(!books.assign("nobody", "east", true).unwrap());
        assert!(!books.assign("ana", "north", true).unwrap());
        assert!(books.assign("ANA", "east", true).unwrap());
        assert!(books.assign("ben", "west", true).unwrap());
        let roster = books.roster().unwrap();
        assert!(roster.is_of("east", "ana") && !roster.is_of("west", "ana"));
        assert_eq!(
            roster.of("ben").collect::<Vec<_>>(),
            [("west", "https://west/")]
        );
        // A new place is the same vehicle, with the same users.
        let (name, url) = ("east".to_owned(), "https://elsewhere/".to_owned());
        books.set_vehicle(&VehicleRow { name, url }).unwrap();
        assert!(books.roster().unwrap().is_of("east", "ana"));
        books.assign("ana", "east", false).unwrap();
        assert!(!books.roster().unwrap().is_of("east", "ana"));
        // Who comes back under the same name has nothing of before.
        books.remove_user("ben").unwrap();
        books.set_user("ben", Some("h"), None, None, None).unwrap();
        assert_eq!(books.roster().unwrap().of("ben").count(), 0);
        assert!(books.remove_vehicle("west").unwrap() && !books.remove_vehicle("west").unwrap());
    }
}
