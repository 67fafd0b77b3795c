//! Words by which a viewer and the camera agree on a WebRTC session: the protocol of MAVLink Camera Manager, whose viewers (Cockpit
//! among them) therefore work unchanged.
//!
//! Text JSON on a WebSocket, every message `{"type": T, "content": {"type": K, "content": ...}}`; the viewer asks for its id and for
//! the streams, starts a session, gets our offer, and answers it.
//!
//! | Viewer says (T / K) | We say |
//! | --- | --- |
//! | question / peerId | answer / peerId `{id}` |
//! | question / availableStreams | answer / availableStreams `[{id, name, encode, height, width, interval ...}]` |
//! | question / startSession `{consumer_id, producer_id}` | answer / startSession, then negotiation / mediaNegotiation with the offer |
//! | negotiation / mediaNegotiation with the answer | |
//! | negotiation / iceNegotiation | ours is in the offer |
//! | question / endSession | |
//!
//! What cannot be read is ignored.

use serde_json::{Value, json};

/// Something a viewer said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Said {
    /// Its answer to our offer, SDP.
    Answer {
        /// Of which session.
        session: String,
        /// The SDP.
        sdp: String,
    },
    /// Which streams are there?
    AvailableStreams,
    /// An address of its.
    Candidate {
        /// Of which session.
        session: String,
        /// As in SDP, `candidate:...`.
        candidate: String,
    },
    /// It is enough.
    EndSession {
        /// Which.
        session: String,
    },
    /// Who am I?
    PeerId,
    /// Show me this.
    StartSession {
        /// Stream.
        producer: String,
    },
}

/// The stream as viewers are told of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Stream {
    /// Id, a UUID.
    pub id: String,
    /// For people.
    pub name: String,
    /// Pixels.
    pub size: [u32; 2],
    /// Pictures a second.
    pub fps: f64,
    /// Where it comes from.
    pub source: String,
}

/// Who talks with whom about what.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bind {
    /// The viewer.
    pub consumer: String,
    /// The stream.
    pub producer: String,
    /// The session.
    pub session: String,
}

/// Reads a message.
#[must_use]
pub fn read(text: &str) -> Option<Said> {
    let message: Value = serde_json::from_str(text).ok()?;
    let body = message.get("content")?;
    let content = body.get("content").unwrap_or(&Value::Null);
    let word = |name: &str| content.get(name)?.as_str().map(str::to_owned);
    let kinds = (message.get("type")?.as_str()?, body.get("type")?.as_str()?);
    Some(match kinds {
        ("question", "peerId") => Said::PeerId,
        ("question", "availableStreams") => Said::AvailableStreams,
        ("question", "startSession") => Said::StartSession {
            producer: word("producer_id")?,
        },
        ("question", "endSession") => Said::EndSession {
            session: word("session_id")?,
        },
        ("negotiation", "mediaNegotiation") => {
            let sdp = content.get("sdp")?;
            if sdp.get("type")?.as_str()? != "answer" {
                return None;
            }
            Said::Answer {
                session: word("session_id")?,
                sdp: sdp.get("sdp")?.as_str()?.to_owned(),
            }
        }
        ("negotiation", "iceNegotiation") => Said::Candidate {
            session: word("session_id")?,
            candidate: content.get("ice")?.get("candidate")?.as_str()?.to_owned(),
        },
        _ => return None,
    })
}

fn message(kind: &str, name: &str, content: Value) -> String {
    json!({ "type": kind, "content": { "type": name, "content": content } }).to_string()
}

/// "You are ..."
#[must_use]
pub fn peer_id(consumer: &str) -> String {
    message("answer", "peerId", json!({ "id": consumer }))
}

/// "There is ..."
#[must_use]
pub fn available_streams(streams: &[Stream]) -> String {
    let all: Vec<Value> = streams
        .iter()
        .map(|s| {
            json!({
                "id": s.id, "name": s.name, "encode": "H264",
                "width": s.size[0], "height": s.size[1],
                "interval": format!("{}", 1.0 / s.fps.max(0.1)),
                "source": s.source, "created": Value::Null,
            })
        })
        .collect();
    message("answer", "availableStreams", Value::Array(all))
}

/// "The session is ..."
#[must_use]
pub fn session_started(bind: &Bind) -> String {
    message("answer", "startSession", ids(bind))
}

/// "I offer ..."
#[must_use]
pub fn offer(bind: &Bind, sdp: &str) -> String {
    let mut content = ids(bind);
    content["sdp"] = json!({ "type": "offer", "sdp": sdp });
    message("negotiation", "mediaNegotiation", content)
}

/// "It is over because ..."
#[must_use]
pub fn session_ended(bind: &Bind, reason: &str) -> String {
    let mut content = ids(bind);
    content["reason"] = json!(reason);
    message("question", "endSession", content)
}

fn ids(bind: &Bind) -> Value {
    json!({ "consumer_id": bind.consumer, "producer_id": bind.producer, "session_id": bind.session })
}

/// A UUID (version 4) of random bytes.
#[must_use]
pub fn uuid(mut bytes: [u8; 16]) -> String {
    bytes[6] = bytes[6] & 0x0F | 0x40;
    bytes[8] = bytes[8] & 0x3F | 0x80;
    let mut out = String::with_capacity(36);
    for (i, b) in bytes.iter().enumerate() {
        if matches!(i, 4 | 6 | 8 | 10) {
            out.push('-');
        }
        out += &format!("{b:02x}");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_viewer_of_camera_manager_is_understood() {
        let said = [
            (
                r#"{"type":"question","content":{"type":"peerId"}}"#,
                Said::PeerId,
            ),
            (
                r#"{"type":"question","content":{"type":"availableStreams"}}"#,
                Said::AvailableStreams,
            ),
            (
                r#"{"type":"question","content":{"type":"startSession","content":{"consumer_id":"c","producer_id":"p"}}}"#,
                Said::StartSession {
                    producer: "p".to_owned(),
                },
            ),
            (
                r#"{"type":"negotiation","content":{"type":"mediaNegotiation","content":{"consumer_id":"c","producer_id":"p","session_id":"s","sdp":{"type":"answer","sdp":"v=0"}}}}"#,
                Said::Answer {
                    session: "s".to_owned(),
                    sdp: "v=0".to_owned(),
                },
            ),
            (
                r#"{"type":"negotiation","content":{"type":"iceNegotiation","content":{"consumer_id":"c","producer_id":"p","session_id":"s","ice":{"candidate":"candidate:1 1 udp 1 1.2.3.4 5 typ host","sdpMid":"0","sdpMLineIndex":0,"usernameFragment":"u"}}}}"#,
                Said::Candidate {
                    session: "s".to_owned(),
                    candidate: "candidate:1 1 udp 1 1.2.3.4 5 typ host".to_owned(),
                },
            ),
            (
                r#"{"type":"question","content":{"type":"endSession","content":{"consumer_id":"c","producer_id":"p","session_id":"s","reason":"bye"}}}"#,
                Said::EndSession {
                    session: "s".to_owned(),
                },
            ),
        ];
        for (text, expected) in said {
            assert_eq!(read(text), Some(expected));
        }
        for rubbish in [
            "",
            "{}",
            "[]",
            r#"{"type":"question"}"#,
            r#"{"type":"question","content":{"type":"startSession"}}"#,
        ] {
            assert_eq!(read(rubbish), None);
        }
    }

    #[test]
    fn an_offer_carries_the_three_ids() {
        let bind = Bind {
            consumer: "c".to_owned(),
            producer: "p".to_owned(),
            session: "s".to_owned(),
        };
        let said: Value = serde_json::from_str(&offer(&bind, "v=0")).unwrap();
        let content = &said["content"]["content"];
        assert_eq!(
            (&content["session_id"], &content["sdp"]["type"]),
            (&json!("s"), &json!("offer"))
        );
    }

    #[test]
    fn a_uuid_says_that_it_is_random() {
        let id = uuid([0xFF; 16]);
        assert_eq!(id, "ffffffff-ffff-4fff-bfff-ffffffffffff");
    }

    proptest! {
        #[test]
        fn any_text_is_survived(text in ".{0,80}") {
            let _ = read(&text);
        }
    }
}
