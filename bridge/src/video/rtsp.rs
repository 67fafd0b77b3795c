//! A client of RTSP cameras (RFC 2326), over one TCP connection that carries requests and RTP interleaved.
//!
//! ```text
//! DESCRIBE -> SDP; 401: again with credentials (Basic, Digest)
//! SETUP    -> session
//! PLAY     -> $ channel length RTP, $ channel length RTP ...
//! GET_PARAMETER now and then, TEARDOWN at the end
//! ```
//!
//! Sans-IO: bytes come in by [`Client::push`], requests go out by [`Client::poll_transmit`].

#[cfg(test)]
mod tests;

use super::annex_b::AccessUnit;
use super::rtp::Depacketizer;
use md5::{Digest as _, Md5};
use std::collections::VecDeque;
use std::fmt::Write as _;
use thiserror::Error;

/// Largest head or body of an answer.
const LONGEST: usize = 64 * 1024;
/// Port if none is named.
const PORT: u16 = 554;

/// Why there is no picture.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RtspError {
    /// A status that is no success.
    #[error("the camera answers {request} with {status}{}", if *status == 401 { ": user or password are wrong (rtsp://USER:PASSWORD@HOST/PATH)" } else { "" })]
    Refused {
        /// Which request.
        request: &'static str,
        /// Status code.
        status: u16,
    },
    /// No H.264 in the description.
    #[error("the camera has no H.264 stream")]
    NoH264,
    /// Something else than RTSP.
    #[error("what the camera says is no RTSP")]
    NoRtsp,
    /// The address cannot be used.
    #[error("write the camera like rtsp://USER:PASSWORD@HOST:PORT/PATH")]
    Url,
}

/// Where a camera is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Name or number.
    pub host: String,
    /// TCP port.
    pub port: u16,
    /// Without user and password.
    pub url: String,
    user: Option<(String, String)>,
}

impl Address {
    /// From `rtsp://[user:password@]host[:port][/path]`.
    ///
    /// # Errors
    /// [`RtspError::Url`].
    pub fn parse(url: &str) -> Result<Self, RtspError> {
        let rest = url.strip_prefix("rtsp://").ok_or(RtspError::Url)?;
        let (authority, path) = rest.find('/').map_or((rest, ""), |at| rest.split_at(at));
        let (user, place) = match authority.rsplit_once('@') {
            Some((user, place)) => {
                let (name, password) = user.split_once(':').unwrap_or((user, ""));
                (Some((name.to_owned(), password.to_owned())), place)
            }
            None => (None, authority),
        };
        let (host, port) = match place.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => {
                (host, port.parse().map_err(|_| RtspError::Url)?)
            }
            _ => (place, PORT),
        };
        let is_odd = |c: char| c.is_control() || c.is_whitespace();
        if host.is_empty() || url.contains(is_odd) {
            return Err(RtspError::Url);
        }
        Ok(Self {
            host: host.trim_matches(['[', ']']).to_owned(),
            port,
            url: format!("rtsp://{place}{path}"),
            user,
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Describe,
    Setup,
    Play,
    Playing,
}

impl Step {
    const fn request(self) -> &'static str {
        match self {
            Self::Describe => "DESCRIBE",
            Self::Setup => "SETUP",
            Self::Play => "PLAY",
            Self::Playing => "GET_PARAMETER",
        }
    }
}

/// How requests are signed.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Credentials {
    None,
    Basic,
    Digest { realm: String, nonce: String },
}

/// One camera, from the request for its description to its pictures.
#[derive(Debug)]
pub struct Client {
    address: Address,
    step: Step,
    sequence: u32,
    credentials: Credentials,
    session: Option<String>,
    control: String,
    out: VecDeque<Vec<u8>>,
    buffer: Vec<u8>,
    depacketizer: Depacketizer,
    /// The camera closes a silent session after this, s.
    pub timeout_s: u64,
}

impl Client {
    /// Asks for the description.
    #[must_use]
    pub fn new(address: Address) -> Self {
        let mut client = Self {
            control: address.url.clone(),
            address,
            step: Step::Describe,
            sequence: 0,
            credentials: Credentials::None,
            session: None,
            out: VecDeque::new(),
            buffer: Vec::new(),
            depacketizer: Depacketizer::default(),
            timeout_s: 60,
        };
        client.ask(Step::Describe);
        client
    }

    /// The next request to send.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.out.pop_front()
    }

    /// True once pictures come.
    #[must_use]
    pub fn is_playing(&self) -> bool {
        self.step == Step::Playing
    }

    /// A sign of life: to be called well within [`Self::timeout_s`].
    pub fn keep_alive(&mut self) {
        if self.is_playing() {
            self.ask(Step::Playing);
        }
    }

    /// The farewell.
    pub fn tear_down(&mut self) {
        if self.session.is_some() {
            let url = self.address.url.clone();
            self.request("TEARDOWN", &url, "");
        }
    }

    /// Bytes of the camera.
    ///
    /// # Errors
    /// [`RtspError`]: the connection is of no use.
    pub fn push(
        &mut self,
        bytes: &[u8],
        out: &mut impl FnMut(AccessUnit),
    ) -> Result<(), RtspError> {
        self.buffer.extend_from_slice(bytes);
        let mut at = 0;
        loop {
            let rest = &self.buffer[at..];
            match rest {
                [] => break,
                [b'$', channel, a, b, more @ ..] => {
                    let n = usize::from(u16::from_be_bytes([*a, *b]));
                    if more.len() < n {
                        break;
                    }
                    if *channel == 0 {
                        self.depacketizer.push(&more[..n], out);
                    }
                    at += 4 + n;
                }
                [b'$', ..] => break,
                _ => match whole(rest)? {
                    Some((head, body, length)) => {
                        let (head, body) = (head.to_owned(), body.to_vec());
                        at += length;
                        self.answer(&head, &body, out)?;
                    }
                    None => break,
                },
            }
        }
        self.buffer.drain(..at);
        if self.buffer.len() > 2 * LONGEST {
            return Err(RtspError::NoRtsp);
        }
        Ok(())
    }

    fn answer(
        &mut self,
        head: &str,
        body: &[u8],
        out: &mut impl FnMut(AccessUnit),
    ) -> Result<(), RtspError> {
        let mut lines = head.split("\r\n");
        let first = lines.next().unwrap_or_default();
        // Cameras may ask us things too (OPTIONS); they go without an answer.
        let Some(status) = first
            .strip_prefix("RTSP/1.0 ")
            .and_then(|s| s.get(..3)?.parse::<u16>().ok())
        else {
            return Ok(());
        };
        let field = |name: &str| {
            head.split("\r\n").find_map(|line| {
                let (n, v) = line.split_once(':')?;
                n.eq_ignore_ascii_case(name).then(|| v.trim())
            })
        };
        if status == 401 && self.credentials == Credentials::None && self.address.user.is_some() {
            self.credentials = credentials(head);
            if self.credentials != Credentials::None {
                self.ask(self.step);
                return Ok(());
            }
        }
        // A camera that does not know GET_PARAMETER is alive nevertheless.
        if !(200..300).contains(&status) && self.step != Step::Playing {
            let request = self.step.request();
            return Err(RtspError::Refused { request, status });
        }
        match self.step {
            Step::Describe => {
                let base = field("Content-Base")
                    .unwrap_or(&self.address.url)
                    .to_owned();
                let (control, sets) = describe(&String::from_utf8_lossy(body), &base)?;
                self.control = control;
                for set in sets {
                    self.depacketizer.know(&set, out);
                }
                self.ask(Step::Setup);
            }
            Step::Setup => {
                let session = field("Session").ok_or(RtspError::NoRtsp)?;
                let (id, options) = session.split_once(';').unwrap_or((session, ""));
                self.session = Some(id.trim().to_owned());
                if let Some(s) = options.trim().strip_prefix("timeout=") {
                    self.timeout_s = s.parse().unwrap_or(60).clamp(5, 600);
                }
                self.ask(Step::Play);
            }
            Step::Play => self.step = Step::Playing,
            Step::Playing => {}
        }
        Ok(())
    }

    fn ask(&mut self, step: Step) {
        self.step = step;
        let (url, more) = match step {
            Step::Describe => (self.address.url.clone(), "Accept: application/sdp\r\n"),
            Step::Setup => (
                self.control.clone(),
                "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n",
            ),
            Step::Play => (self.address.url.clone(), "Range: npt=0.000-\r\n"),
            Step::Playing => (self.address.url.clone(), ""),
        };
        self.request(step.request(), &url, more);
    }

    fn request(&mut self, method: &str, url: &str, more: &str) {
        self.sequence += 1;
        let mut text = format!(
            "{method} {url} RTSP/1.0\r\nCSeq: {}\r\nUser-Agent: kestrel\r\n{more}",
            self.sequence
        );
        if let Some(session) = &self.session {
            let _ = write!(text, "Session: {session}\r\n");
        }
        if let Some(signed) = self.signed(method, url) {
            let _ = write!(text, "Authorization: {signed}\r\n");
        }
        text += "\r\n";
        self.out.push_back(text.into_bytes());
    }

    fn signed(&self, method: &str, url: &str) -> Option<String> {
        let (user, password) = self.address.user.as_ref()?;
        match &self.credentials {
            Credentials::None => None,
            Credentials::Basic => Some(format!(
                "Basic {}",
                base64(format!("{user}:{password}").as_bytes())
            )),
            Credentials::Digest { realm, nonce } => {
                let first = md5_hex(&format!("{user}:{realm}:{password}"));
                let second = md5_hex(&format!("{method}:{url}"));
                let response = md5_hex(&format!("{first}:{nonce}:{second}"));
                Some(format!(
                    "Digest username=\"{user}\", realm=\"{realm}\", nonce=\"{nonce}\", uri=\"{url}\", response=\"{response}\""
                ))
            }
        }
    }
}

/// Head, body and length in all of an answer.
type Answer<'a> = (&'a str, &'a [u8], usize);

/// A whole answer; none if more must come.
fn whole(bytes: &[u8]) -> Result<Option<Answer<'_>>, RtspError> {
    let Some(end) = bytes.windows(4).position(|w| w == b"\r\n\r\n") else {
        return if bytes.len() > LONGEST {
            Err(RtspError::NoRtsp)
        } else {
            Ok(None)
        };
    };
    let head = std::str::from_utf8(&bytes[..end]).map_err(|_| RtspError::NoRtsp)?;
    let length = head
        .split("\r\n")
        .filter_map(|line| line.split_once(':'))
        .find(|(name, _)| name.eq_ignore_ascii_case("Content-Length"))
        .map_or(Ok(0), |(_, v)| v.trim().parse::<usize>())
        .map_err(|_| RtspError::NoRtsp)?;
    if length > LONGEST {
        return Err(RtspError::NoRtsp);
    }
    let body = end + 4;
    Ok(bytes
        .get(body..body + length)
        .map(|b| (head, b, body + length)))
}

/// What a 401 wants: Digest before Basic.
fn credentials(head: &str) -> Credentials {
    let offers: Vec<&str> = head
        .split("\r\n")
        .filter_map(|line| line.split_once(':'))
        .filter(|(name, _)| name.eq_ignore_ascii_case("WWW-Authenticate"))
        .map(|(_, offer)| offer.trim())
        .collect();
    let quoted = |offer: &str, name: &str| {
        let at = offer.find(&format!("{name}=\""))? + name.len() + 2;
        let end = offer[at..].find('"')?;
        Some(offer[at..at + end].to_owned())
    };
    for offer in &offers {
        if offer.to_ascii_lowercase().starts_with("digest")
            && let (Some(realm), Some(nonce)) = (quoted(offer, "realm"), quoted(offer, "nonce"))
        {
            return Credentials::Digest { realm, nonce };
        }
    }
    if offers
        .iter()
        .any(|o| o.to_ascii_lowercase().starts_with("basic"))
    {
        return Credentials::Basic;
    }
    Credentials::None
}

/// Of a session description: the address of its H.264 stream, and the parameter sets in it.
fn describe(sdp: &str, base: &str) -> Result<(String, Vec<Vec<u8>>), RtspError> {
    let mut sections = sdp.split("\nm=");
    let _ = sections.next();
    let video = sections
        .find(|s| s.starts_with("video") && s.to_ascii_uppercase().contains("H264/90000"))
        .ok_or(RtspError::NoH264)?;
    let attribute = |name: &str| {
        video
            .lines()
            .find_map(|l| l.trim().strip_prefix(name).map(str::to_owned))
    };
    let control = match attribute("a=control:") {
        Some(c) if c.starts_with("rtsp://") => c,
        Some(c) if c == "*" || c.is_empty() => base.to_owned(),
        Some(c) => format!("{}/{c}", base.trim_end_matches('/')),
        None => base.to_owned(),
    };
    let sets = attribute("a=fmtp:")
        .and_then(|f| {
            let at = f.find("sprop-parameter-sets=")? + "sprop-parameter-sets=".len();
            let end = f[at..].find([';', ' ']).map_or(f.len(), |n| at + n);
            Some(f[at..end].split(',').filter_map(unbase64).collect())
        })
        .unwrap_or_default();
    Ok((control, sets))
}

const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

fn base64(bytes: &[u8]) -> String {
    let mut out = String::new();
    for chunk in bytes.chunks(3) {
        let word =
            chunk.iter().fold(0_u32, |w, b| w << 8 | u32::from(*b)) << (8 * (3 - chunk.len()));
        for i in 0..4 {
            out.push(if i <= chunk.len() {
                char::from(ALPHABET[(word >> (18 - 6 * i)) as usize & 63])
            } else {
                '='
            });
        }
    }
    out
}

fn unbase64(text: &str) -> Option<Vec<u8>> {
    let (mut out, mut word, mut bits) = (Vec::new(), 0_u32, 0);
    for c in text.trim().trim_end_matches('=').bytes() {
        let digit = ALPHABET.iter().position(|a| *a == c)? as u32;
        word = (word << 6 | digit) & 0xFF_FFFF;
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            out.push((word >> bits) as u8);
        }
    }
    Some(out)
}

fn md5_hex(text: &str) -> String {
    let digest = Md5::digest(text.as_bytes());
    digest.iter().fold(String::new(), |mut s, b| {
        let _ = write!(s, "{b:02x}");
        s
    })
}
