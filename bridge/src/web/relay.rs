//! A request about a vehicle that is elsewhere goes on to that vehicle's own console, and its answer comes back.
//!
//! The vehicle judges it as if the page were open there: role, order and age of frames, the lease, the dead man's rules. Here it is
//! seen to that the vehicle is the user's for as long as the socket is open, and what he asks for is written down.

use super::console::{Server, SocketPlace};
use super::envelope::HEADER;
use super::gate::{Arrival, Caller, problem};
use super::place::Place;
use super::routes::BODY;
use super::upstream::{self, Afar, Guest, Upstream};
use super::witness::{Witness, words};
use crate::gcs::intent;
use axum::body::Body;
use axum::extract::ws::{CloseFrame, Message as Ws, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequestParts as _, Request};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::Response;
use futures_util::{SinkExt as _, StreamExt as _};
use hyper::body::Incoming;
use mavlink_dialect::{Decoder, Frame};
use sha2::{Digest as _, Sha256};
use std::sync::Arc;
use std::time::Duration;
use tokio_tungstenite::tungstenite::Message as Up;
use vehicle::Timestamp;

/// The page's socket, which carries frames.
const FRAMES: &str = "/api/socket";
/// Largest message of a page on it.
const FRAMES_MESSAGE: usize = 4096;
/// Largest message of a page on another one.
const MESSAGE: usize = 64 * 1024;
/// What may wait for a page that does not read.
const UNREAD: usize = 256 * 1024;
/// Who takes longer than this to read is disconnected.
const PATIENCE: Duration = Duration::from_secs(5);
/// How often session and assignment are looked at.
const LOOK: Duration = Duration::from_millis(250);
/// The session here is over.
const OVER: (u16, &str) = (4001, "the session is over");
/// The session there is over: a page comes back for a new one.
const AGAIN: (u16, &str) = (4004, "the vehicle asks to be opened again");
/// Neither reads.
const SLOW: (u16, &str) = (4002, "this page does not keep up");
/// Anything else.
const GONE: (u16, &str) = (1000, "");

/// Where a request goes.
pub(super) struct To {
    /// The vehicle's name here.
    pub(super) name: String,
    /// Where it is.
    pub(super) place: Place,
    /// Path at its own console.
    pub(super) path: String,
}

impl Guest {
    /// A user of this console.
    pub(super) fn of(caller: &Caller) -> Self {
        let digest = Sha256::digest(caller.id.0);
        Self {
            user: caller.session.user.clone(),
            role: caller.session.role,
            // The vehicle can tell browsers apart, and open none of them here.
            session: super::hex::text(&digest[..8]),
        }
    }
}

/// Asks the vehicle.
pub(super) async fn pass(
    server: &Arc<Server>,
    arrival: Arrival,
    caller: Caller,
    to: To,
    request: Request,
) -> Response {
    let guest = Guest::of(&caller);
    let (mut parts, body) = request.into_parts();
    if parts.headers.contains_key(header::UPGRADE) {
        let Ok(upgrade) = WebSocketUpgrade::from_request_parts(&mut parts, &()).await else {
            return problem(StatusCode::UPGRADE_REQUIRED, "this is a WebSocket");
        };
        let Some(place) = server.take_socket() else {
            return problem(StatusCode::SERVICE_UNAVAILABLE, "too many pages are open");
        };
        let up = match upstream::open(&to.place, &guest, &to.path).await {
            Ok(Ok(up)) => up,
            Ok(Err(answer)) => return back(&to.name, answer),
            Err(e) => return unreached(&to.name, &e),
        };
        let is_frames = to.path == FRAMES;
        let most = if is_frames { FRAMES_MESSAGE } else { MESSAGE };
        let line = Line {
            decoder: Decoder::new(),
            witness: Witness::new(Arc::clone(server), arrival, caller, to.name.clone()),
            server: Arc::clone(server),
            name: to.name,
            is_frames,
        };
        return upgrade
            .max_message_size(most)
            .max_frame_size(most)
            .max_write_buffer_size(UNREAD)
            .on_upgrade(move |ws| line.serve(ws, up, place));
    }
    let Ok(bytes) = axum::body::to_bytes(body, BODY).await else {
        return problem(
            StatusCode::PAYLOAD_TOO_LARGE,
            "the body cannot be read, or is too large",
        );
    };
    let mut headers = HeaderMap::new();
    if !bytes.is_empty() {
        headers.insert(
            header::CONTENT_TYPE,
            HeaderValue::from_static("application/json"),
        );
    }
    let asked = upstream::ask(
        &to.place,
        &guest,
        parts.method,
        &to.path,
        headers,
        Body::from(bytes),
    );
    match asked.await {
        Ok(answered) => back(&to.name, answered.response),
        Err(e) => unreached(&to.name, &e),
    }
}

/// The vehicle's answer; a refusal of ourselves is no refusal of the user.
fn back(name: &str, answer: axum::http::Response<Incoming>) -> Response {
    if answer.status() == StatusCode::UNAUTHORIZED {
        return unreached(name, &Afar::Key);
    }
    let (parts, body) = answer.into_parts();
    let mut response = Response::new(Body::new(body));
    *response.status_mut() = parts.status;
    for kept in [header::CONTENT_TYPE, header::CONTENT_DISPOSITION] {
        if let Some(value) = parts.headers.get(&kept) {
            response.headers_mut().insert(kept, value.clone());
        }
    }
    response
}

fn unreached(name: &str, why: &Afar) -> Response {
    problem(StatusCode::BAD_GATEWAY, &format!("{name}: {why}"))
}

/// One page and one vehicle.
struct Line {
    decoder: Decoder,
    witness: Witness,
    server: Arc<Server>,
    name: String,
    is_frames: bool,
}

impl Line {
    async fn serve(mut self, mut down: WebSocket, mut up: Upstream, place: SocketPlace) {
        let _place = place;
        let why = self.run(&mut down, &mut up).await;
        self.witness.manual_ends();
        let _ = tokio::time::timeout(Duration::from_secs(1), up.close(None)).await;
        let close = Ws::Close(Some(CloseFrame {
            code: why.0,
            reason: why.1.into(),
        }));
        let _ = tokio::time::timeout(Duration::from_secs(1), down.send(close)).await;
    }

    async fn run(&mut self, down: &mut WebSocket, up: &mut Upstream) -> (u16, &'static str) {
        let mut look = tokio::time::interval(LOOK);
        look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            let sent = tokio::select! {
                biased;
                got = down.recv() => match got {
                    Some(Ok(Ws::Binary(bytes))) => {
                        if self.is_frames {
                            self.watch(&bytes);
                        }
                        to_vehicle(up, Up::Binary(bytes)).await
                    }
                    Some(Ok(Ws::Text(text))) => {
                        if text.as_str() == r#"{"touch":true}"# {
                            self.server.touch(self.witness.caller.id);
                        }
                        to_vehicle(up, Up::text(text.as_str())).await
                    }
                    Some(Ok(Ws::Ping(_) | Ws::Pong(_))) => Ok(()),
                    Some(Err(e)) => {
                        if e.to_string().contains("too long") {
                            self.witness.intrusion("a message that is too large");
                        }
                        Err(GONE)
                    }
                    Some(Ok(Ws::Close(_))) | None => Err(GONE),
                },
                _ = look.tick() => self.look(),
                got = up.next() => match got {
                    Some(Ok(Up::Binary(bytes))) => to_page(down, Ws::Binary(bytes)).await,
                    Some(Ok(Up::Text(text))) => to_page(down, Ws::text(text.as_str())).await,
                    Some(Ok(Up::Close(Some(frame)))) if u16::from(frame.code) == OVER.0 => Err(AGAIN),
                    Some(Ok(Up::Close(_)) | Err(_)) | None => Err(GONE),
                    Some(Ok(_)) => Ok(()),
                },
            };
            if let Err(why) = sent {
                return why;
            }
        }
    }

    /// What passes by itself: the session ends, the vehicle is taken away.
    fn look(&mut self) -> Result<(), (u16, &'static str)> {
        let caller = &self.witness.caller;
        let is_his = self
            .server
            .fleet
            .as_ref()
            .is_some_and(|f| f.is_of(&self.name, &caller.session.user));
        if self.server.session(caller.id).is_none() || !is_his {
            return Err(OVER);
        }
        let now = self.now();
        self.witness.look(now);
        Ok(())
    }

    fn now(&self) -> Timestamp {
        self.server.clock.now()
    }

    /// Writes down what is asked of the vehicle. What may not be is refused there, and a row here.
    fn watch(&mut self, bytes: &[u8]) {
        let now = self.now();
        let mut frames: Vec<Frame> = Vec::new();
        let wrapped = bytes.get(HEADER..).unwrap_or_default();
        self.decoder.push(wrapped, |frame| frames.push(frame));
        self.decoder.end_of_datagram(|frame| frames.push(frame));
        let role = self.witness.caller.session.role;
        for frame in &frames {
            if role.may(intent::of(&frame.message)) {
                self.witness.passed(now, &frame.message);
            } else {
                let what = format!("{} needs another role than {role}", words(&frame.message));
                self.witness.intrusion(&what);
            }
        }
    }
}

async fn to_vehicle(up: &mut Upstream, message: Up) -> Result<(), (u16, &'static str)> {
    match tokio::time::timeout(PATIENCE, up.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(GONE),
    }
}

async fn to_page(down: &mut WebSocket, message: Ws) -> Result<(), (u16, &'static str)> {
    match tokio::time::timeout(PATIENCE, down.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(GONE),
        Err(_) => Err(SLOW),
    }
}
