//! A browser without a browser: HTTP and WebSocket by hand over a socket, so that nothing is sent that a test did not say.

use bridge::io::clock::Clock;
use bridge::web::envelope;
use mavlink_dialect::command::cmd;
use mavlink_dialect::{Address, Decoder, Encoder, Frame, Message, MessageData, raw};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{self, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

pub struct Answer {
    pub status: u16,
    pub headers: BTreeMap<String, String>,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or(Value::Null)
    }

    /// The cookie it sets, as it is sent back.
    pub fn cookie(&self) -> String {
        let whole = &self.headers["set-cookie"];
        whole.split(';').next().unwrap().to_owned()
    }
}

/// One request with exactly these headers.
pub fn raw_request(to: SocketAddr, text: &str, body: &[u8]) -> io::Result<Answer> {
    let mut stream = TcpStream::connect(to)?;
    stream.set_read_timeout(Some(Duration::from_secs(10)))?;
    stream.write_all(text.as_bytes())?;
    // A refusal may come before the body is through.
    let _ = stream.write_all(body);
    let head = read_head(&mut stream)?;
    let (status, headers) = parse(&head);
    let mut out = Vec::new();
    match headers.get("content-length").and_then(|n| n.parse().ok()) {
        Some(n) => {
            out.resize(n, 0);
            stream.read_exact(&mut out)?;
        }
        None => drop(stream.read_to_end(&mut out)),
    }
    Ok(Answer {
        status,
        headers,
        body: out,
    })
}

fn read_head(stream: &mut TcpStream) -> io::Result<String> {
    let mut head = Vec::new();
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") {
        if stream.read(&mut byte)? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        head.push(byte[0]);
    }
    Ok(String::from_utf8_lossy(&head).into_owned())
}

fn parse(head: &str) -> (u16, BTreeMap<String, String>) {
    let mut lines = head.lines();
    let status = lines
        .next()
        .unwrap()
        .split(' ')
        .nth(1)
        .unwrap()
        .parse()
        .unwrap();
    let headers = lines
        .filter_map(|l| l.split_once(": "))
        .map(|(k, v)| (k.to_ascii_lowercase(), v.to_owned()))
        .collect();
    (status, headers)
}

/// A browser with one cookie.
#[derive(Clone)]
pub struct Browser {
    pub to: SocketAddr,
    pub cookie: String,
}

impl Browser {
    pub fn new(to: SocketAddr) -> Self {
        Self {
            to,
            cookie: String::new(),
        }
    }

    pub fn logged_in(to: SocketAddr, user: &str) -> Self {
        let mut browser = Self::new(to);
        let body = serde_json::json!({ "user": user, "password": super::vehicle::PASSWORD });
        let answer = browser.post("/api/login", &body);
        assert_eq!(answer.status, 200, "{}", answer.json());
        browser.cookie = answer.cookie();
        browser
    }

    fn head(&self, method: &str, path: &str, more: &str) -> String {
        format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\n{more}",
            self.to, self.cookie
        )
    }

    pub fn get(&self, path: &str) -> Answer {
        let head = self.head("GET", path, "Connection: close\r\n\r\n");
        raw_request(self.to, &head, &[]).unwrap()
    }

    pub fn post(&self, path: &str, body: &Value) -> Answer {
        let body = body.to_string();
        let more = format!(
            "Origin: http://{}\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            self.to,
            body.len()
        );
        raw_request(self.to, &self.head("POST", path, &more), body.as_bytes()).unwrap()
    }

    /// Opens the socket; the status if it is refused.
    pub fn open(&self, origin: &str) -> Result<Page, u16> {
        self.open_at("/api/socket", origin)
    }

    /// Opens a socket at a path; the status if it is refused.
    pub fn open_at(&self, path: &str, origin: &str) -> Result<Page, u16> {
        let mut stream = TcpStream::connect(self.to).map_err(|_| 0u16)?;
        let _ = stream.set_nodelay(true);
        stream
            .set_read_timeout(Some(Duration::from_secs(5)))
            .map_err(|_| 0u16)?;
        let more = format!(
            "Origin: {origin}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        stream
            .write_all(self.head("GET", path, &more).as_bytes())
            .map_err(|_| 0u16)?;
        let head = read_head(&mut stream).map_err(|_| 0u16)?;
        let (status, _) = parse(&head);
        if status != 101 {
            return Err(status);
        }
        let mut page = Page {
            stream,
            clock: Clock::start(1.0),
            encoder: Encoder::new(Address {
                system: 0,
                component: 190,
            }),
            decoder: Decoder::new(),
            hello: Value::Null,
            seq: 0,
            lease: 0,
            control: Value::Null,
            frames: Vec::new(),
            acks: Vec::new(),
            states: 0,
            closed: None,
            delay_ms: 0.0,
        };
        page.pump(Duration::from_secs(2), |p| !p.hello.is_null());
        let system = page.hello["system"].as_u64().unwrap() as u8;
        page.encoder = Encoder::new(Address {
            system,
            component: 190,
        });
        Ok(page)
    }

    pub fn page(&self) -> Page {
        self.open(&format!("http://{}", self.to)).unwrap()
    }
}

/// One open page.
pub struct Page {
    pub stream: TcpStream,
    clock: Clock,
    pub encoder: Encoder,
    decoder: Decoder,
    pub hello: Value,
    pub seq: u32,
    pub lease: u64,
    pub control: Value,
    pub frames: Vec<Frame>,
    /// seq and verdict.
    pub acks: Vec<(u32, u8)>,
    pub states: u32,
    /// Code of the close.
    pub closed: Option<u16>,
    /// How late its messages claim to be, ms.
    pub delay_ms: f64,
}

impl Page {
    pub fn system(&self) -> u8 {
        self.hello["system"].as_u64().unwrap() as u8
    }

    /// Reads what comes until something is so; false if the time is over.
    pub fn pump(&mut self, most: Duration, is_so: impl Fn(&Self) -> bool) -> bool {
        let end = self.clock.now() + most;
        loop {
            if is_so(self) {
                return true;
            }
            if self.clock.now() >= end || self.closed.is_some() {
                return is_so(self);
            }
            let left = self.clock.until(end).max(Duration::from_millis(1));
            let _ = self.stream.set_read_timeout(Some(left));
            let mut peek = [0];
            match self.stream.peek(&mut peek) {
                Ok(0) => self.closed = self.closed.or(Some(1006)),
                Ok(_) => {
                    let _ = self.stream.set_read_timeout(Some(Duration::from_secs(5)));
                    if self.read_one().is_err() {
                        self.closed = self.closed.or(Some(1006));
                    }
                }
                Err(_) => {}
            }
        }
    }

    fn read_one(&mut self) -> io::Result<()> {
        let mut head = [0; 2];
        self.stream.read_exact(&mut head)?;
        let mut length = u64::from(head[1] & 0x7F);
        if length == 126 {
            let mut b = [0; 2];
            self.stream.read_exact(&mut b)?;
            length = u64::from(u16::from_be_bytes(b));
        } else if length == 127 {
            let mut b = [0; 8];
            self.stream.read_exact(&mut b)?;
            length = u64::from_be_bytes(b);
        }
        let mut payload = vec![0; length as usize];
        self.stream.read_exact(&mut payload)?;
        match head[0] & 0x0F {
            1 => {
                let said: Value = serde_json::from_slice(&payload).unwrap();
                if !said["hello"].is_null() {
                    self.hello = said["hello"].clone();
                }
                if !said["control"].is_null() {
                    self.control = said["control"].clone();
                    self.lease = said["control"]["owner"]["lease"].as_u64().unwrap_or(0);
                }
            }
            2 => match payload[0] {
                bridge::web::topics::STATE => self.states += 1,
                bridge::web::topics::MAVLINK => {
                    let frames = &mut self.frames;
                    self.decoder.push(&payload[9..], |f| frames.push(f));
                }
                bridge::web::topics::ACK => {
                    let seq = u32::from_le_bytes(payload[9..13].try_into().unwrap());
                    self.acks.push((seq, payload[21]));
                }
                _ => {}
            },
            8 => {
                self.closed = Some(
                    payload
                        .get(..2)
                        .map_or(1005, |c| u16::from_be_bytes([c[0], c[1]])),
                )
            }
            _ => {}
        }
        Ok(())
    }

    /// A WebSocket message with these bytes, masked as clients must.
    pub fn write(&mut self, opcode: u8, bytes: &[u8]) -> io::Result<()> {
        let mut out = vec![0x80 | opcode];
        if bytes.len() < 126 {
            out.push(0x80 | bytes.len() as u8);
        } else if bytes.len() < 65_536 {
            out.push(0x80 | 126);
            out.extend((bytes.len() as u16).to_be_bytes());
        } else {
            out.push(0x80 | 127);
            out.extend((bytes.len() as u64).to_be_bytes());
        }
        let mask = [7, 1, 9, 3];
        out.extend(mask);
        out.extend(bytes.iter().zip(mask.iter().cycle()).map(|(b, m)| b ^ m));
        self.stream.write_all(&out)
    }

    /// Frames in an envelope with the lease we hold.
    pub fn send_frames(&mut self, frames: &[u8]) {
        self.seq += 1;
        let t = self.clock.now().us() as f64 * 1e-3 - self.delay_ms;
        let bytes = envelope::wrap(self.lease, self.seq, t, frames);
        let _ = self.write(2, &bytes);
    }

    pub fn send<D: MessageData>(&mut self, message: &D) {
        let frame = self.encoder.encode(message);
        self.send_frames(&frame);
    }

    pub fn command(&mut self, command: u16, p1: f32, p2: f32) {
        self.send(&raw::COMMAND_LONG_DATA {
            target_system: 1,
            target_component: 1,
            command,
            param1: p1,
            param2: p2,
            param3: f32::NAN,
            param4: f32::NAN,
            param5: f32::NAN,
            param6: f32::NAN,
            param7: f32::NAN,
            ..Default::default()
        });
    }

    pub fn sticks(&mut self, forward: i16, right: i16) {
        self.send(&raw::MANUAL_CONTROL_DATA {
            target: 1,
            x: forward,
            y: right,
            z: 500,
            ..Default::default()
        });
    }

    pub fn beat(&mut self) {
        self.send(&raw::HEARTBEAT_DATA {
            mavtype: 6,
            autopilot: 8,
            mavlink_version: 3,
            ..Default::default()
        });
    }

    /// Asks for control and waits for it.
    pub fn take_control(&mut self) -> bool {
        self.command(cmd::REQUEST_OPERATOR_CONTROL, 1.0, 0.0);
        self.pump(Duration::from_secs(2), |p| p.lease != 0)
    }

    /// Result of the newest acknowledgement of a command.
    pub fn result(&mut self, command: u16) -> Option<u8> {
        // Acknowledgements go to all links.
        let ours = self.system();
        let find = |p: &Self| {
            p.frames.iter().rev().find_map(|f| match &f.message {
                Message::Raw(raw::MavMessage::COMMAND_ACK(a))
                    if a.command == command && a.target_system == ours && a.result != 5 =>
                {
                    Some(a.result)
                }
                _ => None,
            })
        };
        self.pump(Duration::from_secs(3), |p| find(p).is_some());
        find(self)
    }
}
