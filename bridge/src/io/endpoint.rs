//! Endpoint URLs as ground-control people write them.

use mavlink_dialect::signing::SigningKey;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Where a byte stream comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// Wait for datagrams; every sender becomes a link.
    UdpServer(String),
    /// Send datagrams there.
    UdpClient(String),
    /// Wait for connections; every one is a link.
    TcpServer(String),
    /// Connect there.
    TcpClient(String),
    /// A serial port.
    Serial {
        /// Device file.
        device: String,
        /// Baud.
        baud: u32,
    },
}

/// Baud of a serial URL that names none.
pub const DEFAULT_BAUD: u32 = 115_200;

const SCHEMES: [&str; 5] = ["udpserver", "udpclient", "tcpserver", "tcpclient", "serial"];

/// Why a URL is no endpoint.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EndpointError {
    /// Not `scheme://...`.
    #[error(
        "`{0}` is no endpoint: write it like udpserver://127.0.0.1:14550 or serial:///dev/ttyAMA0?baudrate=115200"
    )]
    NoScheme(String),
    /// Scheme not known.
    #[error("no endpoint type `{got}`{}; there are {}", nearest.as_ref().map(|n| format!("; did you mean `{n}`?")).unwrap_or_default(), SCHEMES.join(", "))]
    UnknownScheme {
        /// Asked for.
        got: String,
        /// Nearest known.
        nearest: Option<String>,
    },
    /// Not `host:port`.
    #[error("`{0}` is no host:port: write it like 127.0.0.1:14550")]
    NoPort(String),
    /// `key=` wrong.
    #[error("key={what}: {why}")]
    Key {
        /// The kind and, of a file, its name; never a secret.
        what: String,
        /// Reason.
        why: String,
    },
    /// Baud rate wrong.
    #[error("`{0}` is no baud rate")]
    Baud(String),
}

/// Takes the key off a URL: `?key=file:PATH` (64 hexadecimal digits, see `kestrel keys`) or `?key=pass:TEXT`. What else
/// the query says stays.
///
/// # Errors
/// [`EndpointError::Key`] without the secret.
pub fn split_key(url: &str) -> Result<(String, Option<SigningKey>), EndpointError> {
    let Some((base, query)) = url.split_once('?') else {
        return Ok((url.to_owned(), None));
    };
    let mut key = None;
    let mut rest = Vec::new();
    for part in query.split('&') {
        match part.strip_prefix("key=") {
            Some(source) => key = Some(read_key(source)?),
            None => rest.push(part),
        }
    }
    let rest = rest.join("&");
    let url = if rest.is_empty() {
        base.to_owned()
    } else {
        format!("{base}?{rest}")
    };
    Ok((url, key))
}

fn read_key(source: &str) -> Result<SigningKey, EndpointError> {
    let wrong = |what: &str, why: String| EndpointError::Key {
        what: what.to_owned(),
        why,
    };
    match source.split_once(':') {
        Some(("pass", text)) if !text.is_empty() => Ok(SigningKey::from_passphrase(text)),
        Some(("file", path)) => {
            let text = std::fs::read_to_string(path).map_err(|e| wrong(source, e.to_string()))?;
            SigningKey::from_hex(&text).ok_or_else(|| {
                let why = "holds no key: 64 hexadecimal digits, made by `kestrel keys new`";
                wrong(source, why.to_owned())
            })
        }
        _ => Err(wrong(
            "...",
            "write it like file:PATH or pass:TEXT".to_owned(),
        )),
    }
}

impl FromStr for Endpoint {
    type Err = EndpointError;

    fn from_str(url: &str) -> Result<Self, EndpointError> {
        let (scheme, rest) = url
            .split_once("://")
            .ok_or_else(|| EndpointError::NoScheme(url.to_owned()))?;
        let address = || {
            let port_ok = rest
                .rsplit_once(':')
                .is_some_and(|(h, p)| !h.is_empty() && p.parse::<u16>().is_ok());
            if port_ok {
                Ok(rest.to_owned())
            } else {
                Err(EndpointError::NoPort(rest.to_owned()))
            }
        };
        match scheme {
            "udpserver" => Ok(Self::UdpServer(address()?)),
            "udpclient" => Ok(Self::UdpClient(address()?)),
            "tcpserver" => Ok(Self::TcpServer(address()?)),
            "tcpclient" => Ok(Self::TcpClient(address()?)),
            "serial" => {
                let (device, query) = rest.split_once('?').unwrap_or((rest, ""));
                let baud = match query.split_once('=') {
                    Some(("baudrate" | "baud", baud)) => baud
                        .parse()
                        .map_err(|_| EndpointError::Baud(baud.to_owned()))?,
                    Some(_) => return Err(EndpointError::Baud(query.to_owned())),
                    None => DEFAULT_BAUD,
                };
                Ok(Self::Serial {
                    device: device.to_owned(),
                    baud,
                })
            }
            other => Err(EndpointError::UnknownScheme {
                got: other.to_owned(),
                nearest: crate::settings::nearest(other, SCHEMES.into_iter()).map(str::to_owned),
            }),
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UdpServer(a) => write!(f, "udpserver://{a}"),
            Self::UdpClient(a) => write!(f, "udpclient://{a}"),
            Self::TcpServer(a) => write!(f, "tcpserver://{a}"),
            Self::TcpClient(a) => write!(f, "tcpclient://{a}"),
            Self::Serial { device, baud } => write!(f, "serial://{device}?baudrate={baud}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_survives_writing_and_reading() {
        for url in [
            "udpserver://0.0.0.0:14550",
            "udpclient://127.0.0.1:14540",
            "tcpserver://127.0.0.1:5760",
            "tcpclient://fc.local:5761",
            "serial:///dev/ttyAMA0?baudrate=500000",
        ] {
            assert_eq!(url.parse::<Endpoint>().unwrap().to_string(), url);
        }
    }

    #[test]
    fn a_key_is_taken_off_the_url_and_a_wrong_one_does_not_tell_the_secret() {
        let (url, key) = split_key("serial:///dev/x?baudrate=57600&key=pass:a b").unwrap();
        assert_eq!(url, "serial:///dev/x?baudrate=57600");
        assert_eq!(key, Some(SigningKey::from_passphrase("a b")));
        assert_eq!(
            split_key("udpserver://h:1").unwrap(),
            ("udpserver://h:1".to_owned(), None)
        );
        assert_eq!(
            split_key("udpserver://h:1?key=pass:x").unwrap().0,
            "udpserver://h:1"
        );
        let said = split_key("udpserver://h:1?key=hunter2")
            .unwrap_err()
            .to_string();
        assert!(
            said.contains("pass:TEXT") && !said.contains("hunter2"),
            "{said}"
        );
        let said = split_key("udpserver://h:1?key=file:/no/such")
            .unwrap_err()
            .to_string();
        assert!(said.contains("/no/such"), "{said}");
    }

    #[test]
    fn a_wrong_one_says_what_to_write() {
        let said = |url: &str| url.parse::<Endpoint>().unwrap_err().to_string();
        assert!(said("14550").contains("udpserver://127.0.0.1:14550"));
        assert!(said("udpsever://127.0.0.1:1").contains("did you mean `udpserver`?"));
        assert!(said("udpserver://127.0.0.1").contains("no host:port"));
        assert!(said("serial:///dev/x?baudrate=fast").contains("no baud rate"));
    }
}
