//! Where a vehicle's console is, as people write it: `https://drone:8443/#key=KEY&pin=PIN`.
//!
//! | Part | |
//! | --- | --- |
//! | `key` | opens it: `kestrel passwd --key NAME` on the drone prints the whole line |
//! | `enter` | instead: the link on the terminal of a simulator; a key is fetched with it, once |
//! | `pin` | SHA-256 of the drone's certificate; without it the first one seen is kept |

use super::hex;
use super::key::MachineKey;
use std::fmt;
use std::str::FromStr;

/// How the vehicle's console is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Opener {
    /// For good.
    Key(MachineKey),
    /// Once: 32 hex digits.
    Link(String),
}

/// A vehicle's console.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// Encrypted; plain only from the machine to itself.
    pub is_tls: bool,
    /// Name or address, as it is connected to.
    pub host: String,
    /// Port.
    pub port: u16,
    /// How it is opened.
    pub opener: Opener,
    /// SHA-256 of its certificate.
    pub pin: Option<[u8; 32]>,
}

impl Place {
    /// Where, without secrets: for people.
    #[must_use]
    pub fn shown(&self) -> String {
        let scheme = if self.is_tls { "https" } else { "http" };
        format!("{scheme}://{}:{}", self.host, self.port)
    }
}

/// With its secrets: for the ledger, never for a log.
impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/#", self.shown())?;
        match &self.opener {
            Opener::Key(key) => write!(f, "key={}", key.to_hex())?,
            Opener::Link(link) => write!(f, "enter={link}")?,
        }
        match &self.pin {
            Some(pin) => write!(f, "&pin={}", hex::text(pin)),
            None => Ok(()),
        }
    }
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (scheme, rest) = text
            .trim()
            .split_once("://")
            .ok_or("a vehicle is https://HOST:PORT/#key=... (kestrel passwd --key prints it)")?;
        let is_tls = match scheme {
            "https" => true,
            "http" => false,
            other => return Err(format!("`{other}` is neither https nor http")),
        };
        let (site, secrets) = rest
            .split_once('#')
            .ok_or("the part behind # is missing: #key=... or #enter=...")?;
        let site = site.trim_end_matches('/');
        let (host, port) = match site.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => {
                let port = port.parse().map_err(|_| format!("`{port}` is no port"))?;
                (host, port)
            }
            _ => (site, if is_tls { 443 } else { 80 }),
        };
        if host.is_empty() || host.contains(['/', '@', ' ']) {
            return Err(format!("`{host}` is no host"));
        }
        let is_loopback = host == "localhost"
            || host
                .trim_matches(['[', ']'])
                .parse::<std::net::IpAddr>()
                .is_ok_and(|a| a.is_loopback());
        if !is_tls && !is_loopback {
            return Err("plain http is for this machine only: write https".to_owned());
        }
        let (mut opener, mut pin) = (None, None);
        for part in secrets.split('&') {
            match part.split_once('=') {
                Some(("key", key)) => {
                    opener = Some(Opener::Key(
                        MachineKey::from_hex(key).ok_or("a key is 64 hex digits")?,
                    ));
                }
                Some(("enter", link)) if hex::bytes::<16>(link).is_some() => {
                    opener = Some(Opener::Link(link.to_owned()));
                }
                Some(("pin", given)) => {
                    pin = Some(hex::bytes(given).ok_or("a pin is 64 hex digits")?);
                }
                _ => return Err("behind # comes key=..., enter=... or pin=...".to_owned()),
            }
        }
        Ok(Self {
            is_tls,
            host: host.to_owned(),
            port,
            opener: opener.ok_or("the part behind # is missing: #key=... or #enter=...")?,
            pin,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_terminal_prints_is_read_and_written_back() {
        let key = "ab".repeat(32);
        for text in [
            format!("https://drone.local:8443/#key={key}"),
            format!("https://10.0.0.7:8443/#key={key}&pin={}", "0c".repeat(32)),
            format!("http://127.0.0.1:8443/#enter={}", "1d".repeat(16)),
            format!("https://[fe80::1]:8443/#key={key}"),
        ] {
            assert_eq!(text.parse::<Place>().unwrap().to_string(), text);
        }
        let place: Place = format!("https://drone/#key={key}").parse().unwrap();
        assert_eq!(
            (place.port, place.shown().as_str()),
            (443, "https://drone:443")
        );
        assert!(!format!("{place:?}").contains(&key), "not in a log");
    }

    #[test]
    fn what_is_missing_or_unsafe_is_said() {
        let key = "ab".repeat(32);
        for (text, words) in [
            ("drone:8443".to_owned(), "kestrel passwd --key"),
            ("https://drone:8443/".to_owned(), "behind #"),
            ("https://drone:8443/#key=12".to_owned(), "64 hex digits"),
            ("https://drone:x/#key=12".to_owned(), "no port"),
            (format!("http://10.0.0.7:8443/#key={key}"), "write https"),
            (format!("ftp://drone/#key={key}"), "neither"),
            (format!("https://a/b/#key={key}"), "no host"),
            (format!("https://drone/#pin={key}"), "behind #"),
        ] {
            let said = text.parse::<Place>().unwrap_err();
            assert!(said.contains(words), "{text}: {said}");
        }
    }
}
