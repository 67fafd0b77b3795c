//! Passwords: Argon2id with the parameters of RFC 9106's second recommendation cut to 19 MiB (OWASP), a salt of 16 random bytes.

use argon2::password_hash::{Error, Output, PasswordHash, Salt, SaltString};
use argon2::{ARGON2ID_IDENT, Algorithm, Argon2, Block, Params, Version};
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
    kept(password, salt.as_salt()).map_err(|e| e.to_string())
}

/// The whole line that is kept: parameters, salt, output.
fn kept(password: &str, salt: Salt<'_>) -> Result<String, Error> {
    let params = Params::default();
    let line = PasswordHash {
        algorithm: ARGON2ID_IDENT,
        version: Some(Version::V0x13.into()),
        params: (&params).try_into()?,
        salt: Some(salt),
        hash: Some(output(password, salt, params)?),
    };
    Ok(line.to_string())
}

/// The work itself.
fn output(password: &str, salt: Salt<'_>, params: Params) -> Result<Output, Error> {
    // glibc gives more than 32 MiB back to the system as soon as it is freed. Less than that it would keep, 19 MiB for every thread that
    // ever did this: no more is touched than is needed.
    const GIVEN_BACK: usize = 33 * 1024 * 1024 / Block::SIZE;
    let mut memory = Vec::with_capacity(params.block_count().max(GIVEN_BACK));
    memory.resize(params.block_count(), Block::default());
    let mut bytes = [0; Salt::MAX_LENGTH];
    let salt = salt.decode_b64(&mut bytes)?;
    let length = params.output_len().unwrap_or(Params::DEFAULT_OUTPUT_LEN);
    let argon2 = Argon2::new(Algorithm::Argon2id, Version::V0x13, params);
    Output::init_with(length, |out| {
        let password = password.as_bytes();
        Ok(argon2.hash_password_into_with_memory(password, salt, out, &mut memory)?)
    })
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
    let (Some(salt), Ok(params)) = (parsed.salt, Params::try_from(&parsed)) else {
        return false;
    };
    let is_ours = parsed.algorithm == ARGON2ID_IDENT && hash.is_some();
    // `Output` compares in constant time.
    output(password, salt, params).is_ok_and(|out| Some(out) == parsed.hash) && is_ours
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
    fn what_the_crate_itself_has_hashed_is_recognised_and_the_other_way_round() {
        use argon2::password_hash::{PasswordHasher as _, PasswordVerifier as _};
        let salt = SaltString::encode_b64(&[7; 16]).unwrap();
        let password = "correct horse battery";
        let theirs = Argon2::default().hash_password(password.as_bytes(), &salt);
        let ours = kept(password, salt.as_salt()).unwrap();
        assert_eq!(theirs.unwrap().to_string(), ours);
        let parsed = PasswordHash::new(&ours).unwrap();
        assert!(
            Argon2::default()
                .verify_password(password.as_bytes(), &parsed)
                .is_ok()
        );
        assert!(is_right(password, Some(&ours)));
        assert!(!is_right(
            password,
            Some(&ours.replace("argon2id", "argon2i"))
        ));
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
