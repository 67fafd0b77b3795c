//! Who is logged in, until when, and which MAVLink system id his pages speak with.

use super::hex;
use super::role::Role;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::time::Duration;
use vehicle::Timestamp;

/// Unused for this long and a session is over.
pub const IDLE: Duration = Duration::from_secs(30 * 60);
/// Over whatever happens.
pub const LIFETIME: Duration = Duration::from_secs(12 * 3600);
/// System ids of pages, one a session: also the most sessions at once.
pub const SYSTEMS: RangeInclusive<u8> = 200..=239;

/// A secret that only the browser knows: 128 random bits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct SessionId(pub [u8; 16]);

impl SessionId {
    /// As the cookie carries it.
    #[must_use]
    pub fn to_hex(self) -> String {
        hex::text(&self.0)
    }

    /// Back from the cookie.
    #[must_use]
    pub fn from_hex(text: &str) -> Option<Self> {
        hex::bytes(text).map(Self)
    }
}

/// Secrets stay out of logs.
impl std::fmt::Debug for SessionId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SessionId(***)")
    }
}

/// One logged-in browser.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Session {
    /// User name.
    pub user: String,
    /// What he may do.
    pub role: Role,
    /// MAVLink system id of his pages.
    pub system: u8,
    /// Account (or key, `@NAME`) that opened it, and when that was changed last, UTC us; none of a link on the terminal.
    account: Option<(String, i64)>,
    since: Timestamp,
    used: Timestamp,
    /// Ends only with [`LIFETIME`]: opened by the link on the terminal of whoever started the program.
    stays: bool,
}

impl Session {
    fn is_over(&self, now: Timestamp) -> bool {
        now.since(self.since) >= LIFETIME || (!self.stays && now.since(self.used) >= IDLE)
    }
}

/// Who opens a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entrant {
    /// User name.
    pub user: String,
    /// What he may do.
    pub role: Role,
    /// Account and the time of its last change, UTC us.
    pub account: Option<(String, i64)>,
    /// It does not end for want of use.
    pub stays: bool,
}

/// All sessions.
#[derive(Debug, Default)]
pub struct Sessions {
    open: BTreeMap<SessionId, Session>,
}

impl Sessions {
    /// Opens a session; the one unused for longest makes room.
    pub fn begin(&mut self, now: Timestamp, id: SessionId, who: Entrant) -> &Session {
        self.open.retain(|_, s| !s.is_over(now));
        let free = |open: &BTreeMap<SessionId, Session>| {
            SYSTEMS
                .clone()
                .find(|n| open.values().all(|s| s.system != *n))
        };
        let system = free(&self.open).unwrap_or_else(|| {
            let oldest = self
                .open
                .iter()
                .min_by_key(|(_, s)| s.used)
                .map(|(id, _)| *id);
            if let Some(oldest) = oldest {
                self.open.remove(&oldest);
            }
            free(&self.open).unwrap_or(*SYSTEMS.start())
        });
        self.open.entry(id).or_insert(Session {
            user: who.user,
            role: who.role,
            system,
            account: who.account,
            since: now,
            used: now,
            stays: who.stays,
        })
    }

    /// The session of a cookie, if it is still open; looking is not using.
    #[must_use]
    pub fn get(&self, now: Timestamp, id: SessionId) -> Option<&Session> {
        self.open.get(&id).filter(|s| !s.is_over(now))
    }

    /// The user did something.
    pub fn touch(&mut self, now: Timestamp, id: SessionId) {
        if let Some(session) = self.open.get_mut(&id) {
            session.used = now;
        }
    }

    /// Logged out.
    pub fn end(&mut self, id: SessionId) {
        self.open.remove(&id);
    }

    /// An account's role or password changed, or it is gone: all its sessions end.
    pub fn end_of(&mut self, account: &str) {
        self.open.retain(|_, s| {
            s.account
                .as_ref()
                .is_none_or(|(name, _)| !name.eq_ignore_ascii_case(account))
        });
    }

    /// Accounts with the time of their last change, as they are now: sessions of earlier ones end.
    pub fn keep_only(&mut self, accounts: &BTreeMap<String, i64>) {
        self.open.retain(|_, s| {
            s.account
                .as_ref()
                .is_none_or(|(name, changed)| accounts.get(name) == Some(changed))
        });
    }

    /// True if nobody is logged in.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.open.is_empty()
    }

    /// Everybody, for administrators and for naming who has control.
    pub fn iter(&self) -> impl Iterator<Item = &Session> {
        self.open.values()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn who(user: &str, changed_us: i64) -> Entrant {
        Entrant {
            user: user.to_owned(),
            role: Role::Pilot,
            account: Some((user.to_owned(), changed_us)),
            stays: false,
        }
    }

    fn id(n: u8) -> SessionId {
        SessionId([n; 16])
    }

    #[test]
    fn a_session_ends_half_an_hour_after_its_last_use_and_twelve_hours_after_its_start() {
        let mut sessions = Sessions::default();
        sessions.begin(Timestamp::ZERO, id(1), who("guard", 0));
        let minutes = |m: u64| Timestamp::from_ms(m * 60_000);
        assert!(sessions.get(minutes(29), id(1)).is_some());
        assert!(sessions.get(minutes(30), id(1)).is_none(), "idle");
        sessions.begin(minutes(30), id(2), who("guard", 0));
        for m in (40..750).step_by(10) {
            sessions.touch(minutes(m), id(2));
        }
        assert!(sessions.get(minutes(749), id(2)).is_some());
        assert!(sessions.get(minutes(750), id(2)).is_none(), "twelve hours");
    }

    #[test]
    fn a_page_opened_from_the_terminal_may_be_left_alone_but_not_overnight() {
        let mut sessions = Sessions::default();
        let from_terminal = Entrant {
            account: None,
            stays: true,
            ..who("you", 0)
        };
        sessions.begin(Timestamp::ZERO, id(1), from_terminal);
        sessions.keep_only(&BTreeMap::new());
        assert!(
            sessions
                .get(Timestamp::from_ms(11 * 3_600_000), id(1))
                .is_some()
        );
        assert!(
            sessions
                .get(Timestamp::from_ms(12 * 3_600_000), id(1))
                .is_none()
        );
    }

    #[test]
    fn every_session_has_a_number_of_its_own_and_the_oldest_makes_room() {
        let mut sessions = Sessions::default();
        for n in 0..60u8 {
            let at = Timestamp::from_ms(u64::from(n));
            sessions.begin(at, id(n), who(&n.to_string(), 0));
        }
        let mut numbers: Vec<u8> = sessions.iter().map(|s| s.system).collect();
        numbers.sort_unstable();
        assert_eq!(numbers, SYSTEMS.collect::<Vec<u8>>());
        assert!(sessions.get(Timestamp::from_ms(60), id(19)).is_none());
        assert!(sessions.get(Timestamp::from_ms(60), id(20)).is_some());
    }

    #[test]
    fn a_changed_user_is_out_everywhere() {
        let mut sessions = Sessions::default();
        sessions.begin(Timestamp::ZERO, id(1), who("a", 7));
        sessions.begin(Timestamp::ZERO, id(2), who("a", 7));
        sessions.begin(Timestamp::ZERO, id(3), who("b", 7));
        sessions.end_of("a");
        assert_eq!(sessions.iter().count(), 1);
    }

    #[test]
    fn who_was_changed_or_removed_by_another_program_is_out_and_the_others_stay() {
        let mut sessions = Sessions::default();
        for (n, user) in [(1, "a"), (2, "b"), (3, "c")] {
            sessions.begin(Timestamp::ZERO, id(n), who(user, 7));
        }
        let now = [("a", 7), ("b", 8)].map(|(name, at)| (name.to_owned(), at));
        sessions.keep_only(&now.into());
        let left: Vec<&str> = sessions.iter().map(|s| s.user.as_str()).collect();
        assert_eq!(left, ["a"]);
    }

    #[test]
    fn a_cookie_is_hex_or_nothing_and_never_in_a_log() {
        let secret = SessionId([0xAB; 16]);
        assert_eq!(SessionId::from_hex(&secret.to_hex()), Some(secret));
        for wrong in ["", "ab", &"g".repeat(32), &"é".repeat(16), &"a".repeat(33)] {
            assert_eq!(SessionId::from_hex(wrong), None);
        }
        assert!(!format!("{secret:?}").contains("ab"));
    }
}
