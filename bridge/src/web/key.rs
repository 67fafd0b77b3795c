//! Keys of programs that come instead of a browser: a console off the drone, a script.
//!
//! 256 random bits, shown once; the drone keeps their SHA-256. Whoever sends one as `Authorization: Bearer KEY` is the user that
//! `Kestrel-User` names, with the role of `Kestrel-Role` but no more than the key's own, in the session of `Kestrel-Session` (one
//! MAVLink system id for each).

use super::hex;
use super::sessions::SessionId;
use sha2::{Digest as _, Sha256};

/// Header: who sits at the other console.
pub const USER: &str = "kestrel-user";
/// Header: what he may do there.
pub const ROLE: &str = "kestrel-role";
/// Header: one of his browsers.
pub const SESSION: &str = "kestrel-session";

/// A secret of a program.
#[derive(Clone, PartialEq, Eq)]
pub struct MachineKey([u8; 32]);

impl MachineKey {
    /// Of random bytes.
    #[must_use]
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// As people carry it from one machine to the other.
    #[must_use]
    pub fn to_hex(&self) -> String {
        hex::text(&self.0)
    }

    /// Back again.
    #[must_use]
    pub fn from_hex(text: &str) -> Option<Self> {
        hex::bytes(text).map(Self)
    }

    /// What the drone keeps.
    #[must_use]
    pub fn hash(&self) -> [u8; 32] {
        Sha256::digest(self.0).into()
    }

    /// The session that this program calls `name`: no other key leads to it.
    #[must_use]
    pub fn session(&self, name: &str) -> SessionId {
        let digest = Sha256::new()
            .chain_update(self.0)
            .chain_update(name.as_bytes())
            .finalize();
        let mut id = [0; 16];
        id.copy_from_slice(&digest[..16]);
        SessionId(id)
    }
}

/// Secrets stay out of logs.
impl std::fmt::Debug for MachineKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("MachineKey(***)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_64_hex_digits_and_never_in_a_log() {
        let key = MachineKey::new([0xAB; 32]);
        assert_eq!(MachineKey::from_hex(&key.to_hex()), Some(key.clone()));
        for wrong in ["", "ab", &"g".repeat(64), &"a".repeat(65)] {
            assert_eq!(MachineKey::from_hex(wrong), None);
        }
        assert!(!format!("{key:?}").contains("ab"));
    }

    #[test]
    fn sessions_of_one_key_differ_by_name_and_of_two_keys_by_key() {
        let (a, b) = (MachineKey::new([1; 32]), MachineKey::new([2; 32]));
        assert!(a.session("x") == a.session("x") && a.session("x") != a.session("y"));
        assert!(a.session("x") != b.session("x"));
    }
}
