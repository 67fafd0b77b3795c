//! Endpoint URLs as ground-control people write them.

use crate::gcs::access::LinkPolicy;
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
    /// Call out heartbeats to a broadcast address until a station answers; every one that does becomes a link.
    UdpBroadcast(String),
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

const SCHEMES: [&str; 6] = [
    "udpserver",
    "udpclient",
    "udpbroadcast",
    "tcpserver",
    "tcpclient",
    "serial",
];

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
    /// An option has a value it does not take.
    #[error("{name}={got}: it takes {wants}")]
    Option {
        /// Which.
        name: &'static str,
        /// Its value.
        got: String,
        /// What it takes.
        wants: &'static str,
    },
    /// Baud rate wrong.
    #[error("`{0}` is no baud rate")]
    Baud(String),
}

/// Takes off a URL what it says about its links; what else the query says stays.
///
/// | Option | Says |
/// | --- | --- |
/// | `key=file:PATH`, `key=pass:TEXT` | frames are signed (64 hexadecimal digits in the file, see `kestrel keys`) |
/// | `role=viewer`, `pilot`, `engineer` | what who speaks there may do |
/// | `rate=N` | telemetry keeps within N bytes a second |
/// | `route=on` | a camera or companion speaks there: its frames go to the stations, theirs to it |
///
/// A serial line without a rate gets seven tenths of what its baud rate carries.
///
/// # Errors
/// [`EndpointError`] without the secret.
pub fn split_options(url: &str) -> Result<(String, LinkPolicy), EndpointError> {
    let (base, query) = url.split_once('?').unwrap_or((url, ""));
    let mut policy = LinkPolicy::default();
    let mut rest = Vec::new();
    for part in query.split('&').filter(|p| !p.is_empty()) {
        let option = |name: &'static str, value: &str, wants: &'static str| EndpointError::Option {
            name,
            got: value.to_owned(),
            wants,
        };
        match part.split_once('=') {
            Some(("key", source)) => policy.key = Some(read_key(source)?),
            Some(("role", value)) => {
                let role = value.parse();
                policy.role =
                    Some(role.map_err(|()| option("role", value, "viewer, pilot or engineer"))?);
            }
            Some(("rate", value)) => {
                let rate = value
                    .parse()
                    .ok()
                    .filter(|r: &f64| (100.0..=1e9).contains(r));
                policy.rate_bytes_per_s =
                    Some(rate.ok_or_else(|| option("rate", value, "bytes a second, 100 or more"))?);
            }
            Some(("route", value)) => {
                policy.is_routed = match value {
                    "on" => true,
                    "off" => false,
                    _ => return Err(option("route", value, "on or off")),
                }
            }
            _ => rest.push(part),
        }
    }
    policy.url = if rest.is_empty() {
        base.to_owned()
    } else {
        format!("{base}?{}", rest.join("&"))
    };
    if let Ok(Endpoint::Serial { baud, .. }) = policy.url.parse()
        && policy.rate_bytes_per_s.is_none()
    {
        policy.rate_bytes_per_s = Some(f64::from(baud) * 7.0 / 100.0);
    }
    Ok((policy.url.clone(), policy))
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
            "udpbroadcast" => Ok(Self::UdpBroadcast(address()?)),
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
            Self::UdpBroadcast(a) => write!(f, "udpbroadcast://{a}"),
            Self::TcpServer(a) => write!(f, "tcpserver://{a}"),
            Self::TcpClient(a) => write!(f, "tcpclient://{a}"),
            Self::Serial { device, baud } => write!(f, "serial://{device}?baudrate={baud}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcs::access::Role;

    #[test]
    fn every_form_survives_writing_and_reading() {
        for url in [
            "udpserver://0.0.0.0:14550",
            "udpclient://127.0.0.1:14540",
            "udpbroadcast://192.168.1.255:14550",
            "tcpserver://127.0.0.1:5760",
            "tcpclient://fc.local:5761",
            "serial:///dev/ttyAMA0?baudrate=500000",
        ] {
            assert_eq!(url.parse::<Endpoint>().unwrap().to_string(), url);
        }
    }

    #[test]
    fn options_are_taken_off_the_url_and_a_wrong_key_does_not_tell_the_secret() {
        let (url, policy) =
            split_options("serial:///dev/x?baudrate=57600&key=pass:a b&role=pilot").unwrap();
        assert_eq!(url, "serial:///dev/x?baudrate=57600");
        assert_eq!(policy.key, Some(SigningKey::from_passphrase("a b")));
        assert_eq!(policy.role, Some(Role::Pilot));
        assert_eq!(
            policy.rate_bytes_per_s,
            Some(4032.0),
            "what the line carries"
        );
        let (url, policy) = split_options("udpserver://h:1?rate=2000&route=on").unwrap();
        assert_eq!(url, "udpserver://h:1");
        assert_eq!(
            (policy.rate_bytes_per_s, policy.is_routed),
            (Some(2000.0), true)
        );
        let (url, policy) = split_options("udpserver://h:1").unwrap();
        assert_eq!(
            (url.as_str(), policy.role, policy.rate_bytes_per_s),
            ("udpserver://h:1", None, None)
        );
        let said = |url: &str| split_options(url).unwrap_err().to_string();
        let key = said("udpserver://h:1?key=hunter2");
        assert!(
            key.contains("pass:TEXT") && !key.contains("hunter2"),
            "{key}"
        );
        assert!(said("udpserver://h:1?key=file:/no/such").contains("/no/such"));
        assert!(said("udpserver://h:1?role=guard").contains("viewer, pilot or engineer"));
        assert!(said("udpserver://h:1?rate=fast").contains("bytes a second"));
        assert!(said("udpserver://h:1?route=maybe").contains("on or off"));
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
