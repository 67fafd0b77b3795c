//! Who is logged in, until when, and which MAVLink system id his pages speak with.

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
        use std::fmt::Write as _;
        self.0.iter().fold(String::with_capacity(32), |mut s, b| {
            let _ = write!(s, "{b:02x}");
            s
        })
    }

    /// Back from the cookie.
    #[must_use]
    pub fn from_hex(text: &str) -> Option<Self> {
        if text.len() != 32 || !text.is_ascii() {
            return None;
        }
        let mut id = [0; 16];
        for (i, byte) in id.iter_mut().enumerate() {
            *byte = u8::from_str_radix(text.get(2 * i..2 * i + 2)?, 16).ok()?;
        }
        Some(Self(id))
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

/// All sessions.
#[derive(Debug, Default)]
pub struct Sessions {
    open: BTreeMap<SessionId, Session>,
}

impl Sessions {
    /// Opens a session; the one unused for longest makes room. `stays`: it does not end for want of use.
    pub fn begin(
        &mut self,
        now: Timestamp,
        id: SessionId,
        user: &str,
        role: Role,
        stays: bool,
    ) -> &Session {
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
            user: user.to_owned(),
            role,
            system,
            since: now,
            used: now,
            stays,
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

    /// A user's role or password changed, or he is gone: all his sessions end.
    pub fn end_of(&mut self, user: &str) {
        self.open.retain(|_, s| s.user != user);
    }

    /// Everybody, for administrators and for naming who has control.
    pub fn iter(&self) -> impl Iterator<Item = &Session> {
        self.open.values()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(n: u8) -> SessionId {
        SessionId([n; 16])
    }

    #[test]
    fn a_session_ends_half_an_hour_after_its_last_use_and_twelve_hours_after_its_start() {
        let mut sessions = Sessions::default();
        sessions.begin(Timestamp::ZERO, id(1), "guard", Role::Viewer, false);
        let minutes = |m: u64| Timestamp::from_ms(m * 60_000);
        assert!(sessions.get(minutes(29), id(1)).is_some());
        assert!(sessions.get(minutes(30), id(1)).is_none(), "idle");
        sessions.begin(minutes(30), id(2), "guard", Role::Viewer, false);
        for m in (40..750).step_by(10) {
            sessions.touch(minutes(m), id(2));
        }
        assert!(sessions.get(minutes(749), id(2)).is_some());
        assert!(sessions.get(minutes(750), id(2)).is_none(), "twelve hours");
    }

    #[test]
    fn a_page_opened_from_the_terminal_may_be_left_alone_but_not_overnight() {
        let mut sessions = Sessions::default();
        sessions.begin(Timestamp::ZERO, id(1), "you", Role::Admin, true);
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
            sessions.begin(at, id(n), &n.to_string(), Role::Viewer, false);
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
        sessions.begin(Timestamp::ZERO, id(1), "a", Role::Pilot, false);
        sessions.begin(Timestamp::ZERO, id(2), "a", Role::Pilot, false);
        sessions.begin(Timestamp::ZERO, id(3), "b", Role::Pilot, false);
        sessions.end_of("a");
        assert_eq!(sessions.iter().count(), 1);
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
