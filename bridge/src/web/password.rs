//! Passwords: Argon2id with the parameters of RFC 9106's second recommendation cut to 19 MiB (OWASP), a salt of 16 random bytes.

use argon2::Argon2;
use argon2::password_hash::{PasswordHash, PasswordHasher as _, PasswordVerifier as _, SaltString};
use std::fs::File;
use std::io::{self, Read as _};

/// Shortest password taken.
pub const MIN_LENGTH: usize = 10;
/// Longest: the work must be bounded.
pub const MAX_LENGTH: usize = 256;
/// A hash that no password has: what an unknown user's password is compared with, so that he costs the same time.
const NOBODY: &str =
    "$argon2id$v=19$m=19456,t=2,p=1$bm9ib2R5LWhhcy1pdA$9wSYSQmjS9pGYQ1OVbW3xZzoHTEbC5OqLxyFCVGeIfo";

/// Random bytes.
///
/// # Errors
/// The system has none.
pub fn random<const N: usize>() -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// The hash to keep.
///
/// # Errors
/// Too short, too long, or no random bytes: in words.
pub fn hash(password: &str) -> Result<String, String> {
    if password.chars().count() < MIN_LENGTH {
        return Err(format!("a password has at least {MIN_LENGTH} characters"));
    }
    if password.len() > MAX_LENGTH {
        return Err(format!("a password has at most {MAX_LENGTH} bytes"));
    }
    let salt = random::<16>().map_err(|e| e.to_string())?;
    let salt = SaltString::encode_b64(&salt).map_err(|e| e.to_string())?;
    Argon2::default()
        .hash_password(password.as_bytes(), &salt)
        .map(|h| h.to_string())
        .map_err(|e| e.to_string())
}

/// Compares; without a hash it takes as long and fails.
#[must_use]
pub fn is_right(password: &str, hash: Option<&str>) -> bool {
    if password.len() > MAX_LENGTH {
        return false;
    }
    let Ok(parsed) = PasswordHash::new(hash.unwrap_or(NOBODY)) else {
        return false;
    };
    Argon2::default()
        .verify_password(password.as_bytes(), &parsed)
        .is_ok()
        && hash.is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_recognised_and_another_is_not() {
        let kept = hash("correct horse battery").unwrap();
        assert!(
            kept.starts_with("$argon2id$v=19$m=19456,t=2,p=1$"),
            "{kept}"
        );
        assert!(is_right("correct horse battery", Some(&kept)));
        assert!(!is_right("correct horse batterz", Some(&kept)));
        assert!(!is_right("correct horse battery", None));
        assert_ne!(kept, hash("correct horse battery").unwrap(), "salted");
    }

    #[test]
    fn the_hash_of_nobody_is_one_that_is_computed() {
        let parsed = PasswordHash::new(NOBODY).unwrap();
        assert_eq!(parsed.hash.unwrap().len(), 32);
    }

    #[test]
    fn short_and_endless_passwords_are_refused() {
        assert!(hash("short").unwrap_err().contains("at least 10"));
        assert!(hash(&"x".repeat(257)).unwrap_err().contains("at most 256"));
        assert!(!is_right(&"x".repeat(100_000), None));
    }
}
