//! The camera component: says where the picture is to be had, takes none itself.
//!
//! There is a component 100 only where a stream was named (`--video URL`, another program's) or sent (`--video-to`). Pictures, recording, zoom and
//! focus are UNSUPPORTED at once; without a stream there is nobody to ask.
//!
//! | Asked | Answer |
//! | --- | --- |
//! | REQUEST_MESSAGE 259 to 262, 269, 270; the older 521, 522, 525, 527, 2504, 2505 | the message, COMMAND_ACK |
//! | SET_CAMERA_MODE | video is accepted |
//! | VIDEO_START_STREAMING | accepted: it runs |
//! | anything else | UNSUPPORTED |
//!
//! Its heartbeat goes out every 2 s, from 3 s after a link came up, and always just before the autopilot's: pymavlink takes the last
//! heartbeat it heard for the vehicle's.

use super::{Context, Destination, Outbox, Peer, Speaker};
use mavlink_dialect::command::{Command, cmd, result};
use mavlink_dialect::standard::{
    CAMERA_CAPTURE_STATUS_DATA, CAMERA_INFORMATION_DATA, CAMERA_SETTINGS_DATA, CameraCapFlags,
    CameraMode, MavMessage, STORAGE_INFORMATION_DATA, StorageStatus, VIDEO_STREAM_INFORMATION_DATA,
    VIDEO_STREAM_STATUS_DATA, VideoStreamEncoding, VideoStreamStatusFlags, VideoStreamType,
};
use mavlink_dialect::{Message, raw};
use thiserror::Error;
use vehicle::Timestamp;

/// Component id of a first camera.
pub const COMPONENT: u8 = 100;
/// MAV_TYPE_CAMERA, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE.
const TYPE_CAMERA: u8 = 30;
const AUTOPILOT_INVALID: u8 = 8;
const STATE_ACTIVE: u8 = 4;

const CAMERA_INFORMATION: u32 = 259;
const CAMERA_SETTINGS: u32 = 260;
const STORAGE_INFORMATION: u32 = 261;
const CAMERA_CAPTURE_STATUS: u32 = 262;
const VIDEO_STREAM_INFORMATION: u32 = 269;
const VIDEO_STREAM_STATUS: u32 = 270;

/// Where a picture is to be had.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoStream {
    kind: Kind,
    /// As VIDEO_STREAM_INFORMATION carries it: the URL, of RTP the port.
    uri: String,
    facts: Facts,
}

/// What VIDEO_STREAM_INFORMATION says beside the place; zero = not known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Facts {
    /// Pixels.
    size: [u16; 2],
    /// Pictures a second.
    fps: f32,
    /// Bits a second.
    bits_per_s: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Rtsp,
    Rtp,
    TcpMpeg,
    MpegTs,
}

/// Why a URL is no stream.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "`{0}` is no video stream: write it like rtsp://192.168.1.5:8554/front or udp://:5600 (RTP, H.264), 160 bytes at most"
)]
pub struct NoStream(String);

impl VideoStream {
    /// From `rtsp://host[:port]/path`, `udp://:port` (RTP), `tcp://host:port`, `mpegts://:port`.
    ///
    /// # Errors
    /// [`NoStream`].
    pub fn parse(url: &str) -> Result<Self, NoStream> {
        let wrong = || NoStream(url.to_owned());
        let (scheme, rest) = url.split_once("://").ok_or_else(wrong)?;
        let port = || {
            let port = rest.rsplit(':').next().unwrap_or(rest);
            port.parse::<u16>()
                .map(|p| p.to_string())
                .map_err(|_| wrong())
        };
        let (kind, uri) = match scheme {
            "rtsp" => (Kind::Rtsp, url.to_owned()),
            "udp" => (Kind::Rtp, port()?),
            "tcp" => (Kind::TcpMpeg, url.to_owned()),
            "mpegts" => (Kind::MpegTs, port()?),
            _ => return Err(wrong()),
        };
        if rest.is_empty() || uri.len() > 160 || !uri.is_ascii() {
            return Err(wrong());
        }
        Ok(Self {
            kind,
            uri,
            facts: Facts::default(),
        })
    }

    /// RTP with H.264 that we send to a port of the station ourselves. `size`: pixels, if known already.
    #[must_use]
    pub fn rtp(port: u16, size: Option<[u16; 2]>, fps: f32, bits_per_s: u32) -> Self {
        Self {
            kind: Kind::Rtp,
            uri: port.to_string(),
            facts: Facts {
                size: size.unwrap_or_default(),
                fps,
                bits_per_s,
            },
        }
    }
}

/// The camera, if there is one.
#[derive(Debug, Default)]
pub struct Camera {
    stream: Option<VideoStream>,
    /// The next heartbeat of the autopilot is not accompanied.
    skips: bool,
}

impl Camera {
    /// A camera with a stream, or none.
    #[must_use]
    pub const fn new(stream: Option<VideoStream>) -> Self {
        Self {
            stream,
            skips: false,
        }
    }

    /// True if there is one.
    #[must_use]
    pub const fn is_there(&self) -> bool {
        self.stream.is_some()
    }

    /// The autopilot's heartbeat is about to go out: true with every second one, if there is a camera.
    pub const fn beats(&mut self) -> bool {
        self.skips = !self.skips;
        self.is_there() && self.skips
    }

    /// Its heartbeat.
    #[must_use]
    pub fn heartbeat() -> raw::MavMessage {
        raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA {
            mavtype: TYPE_CAMERA,
            autopilot: AUTOPILOT_INVALID,
            system_status: STATE_ACTIVE,
            mavlink_version: 3,
            ..Default::default()
        })
    }

    /// A message for the camera; `by_name` if it was addressed and not everybody.
    pub fn handle(
        &self,
        now: Timestamp,
        from: Peer,
        message: &Message,
        by_name: bool,
        _ctx: &Context<'_>,
        out: &mut Outbox,
    ) {
        let command = match message {
            Message::Raw(raw::MavMessage::COMMAND_LONG(m)) => Command::from_long(m),
            Message::Raw(raw::MavMessage::COMMAND_INT(m)) => Command::from_int(m),
            _ => return,
        };
        let Some(stream) = &self.stream else { return };
        let wanted = match command.number {
            cmd::REQUEST_MESSAGE => command.whole(1).and_then(|id| u32::try_from(id).ok()),
            cmd::REQUEST_CAMERA_INFORMATION => Some(CAMERA_INFORMATION),
            cmd::REQUEST_CAMERA_SETTINGS => Some(CAMERA_SETTINGS),
            cmd::REQUEST_STORAGE_INFORMATION => Some(STORAGE_INFORMATION),
            cmd::REQUEST_CAMERA_CAPTURE_STATUS => Some(CAMERA_CAPTURE_STATUS),
            cmd::REQUEST_VIDEO_STREAM_INFORMATION => Some(VIDEO_STREAM_INFORMATION),
            cmd::REQUEST_VIDEO_STREAM_STATUS => Some(VIDEO_STREAM_STATUS),
            _ => None,
        };
        let reply = wanted.and_then(|id| tell(now, id, stream));
        let result = match (&reply, command.number) {
            (Some(_), _) => result::ACCEPTED,
            (None, cmd::VIDEO_START_STREAMING) => result::ACCEPTED,
            (None, cmd::SET_CAMERA_MODE) if command.whole(2) == Some(1) => result::ACCEPTED,
            (None, _) => result::UNSUPPORTED,
        };
        // A question to everybody that is not the camera's is the autopilot's to answer.
        if !by_name && reply.is_none() {
            return;
        }
        let ack = raw::COMMAND_ACK_DATA {
            command: command.number,
            result,
            target_system: from.address.system,
            target_component: from.address.component,
            ..Default::default()
        };
        out.send_as(
            Speaker::Camera,
            Destination::All,
            raw::MavMessage::COMMAND_ACK(ack).into(),
        );
        if let Some(reply) = reply {
            out.send_as(Speaker::Camera, Destination::All, reply.into());
        }
    }
}

fn tell(now: Timestamp, id: u32, stream: &VideoStream) -> Option<MavMessage> {
    let time_boot_ms = now.boot_ms();
    let Facts {
        size: [resolution_h, resolution_v],
        fps: framerate,
        bits_per_s: bitrate,
    } = stream.facts;
    Some(match id {
        CAMERA_INFORMATION => MavMessage::CAMERA_INFORMATION(CAMERA_INFORMATION_DATA {
            time_boot_ms,
            vendor_name: padded(b"Kestrel"),
            model_name: padded(b"video stream"),
            resolution_h,
            resolution_v,
            flags: CameraCapFlags::CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM,
            ..Default::default()
        }),
        CAMERA_SETTINGS => MavMessage::CAMERA_SETTINGS(CAMERA_SETTINGS_DATA {
            time_boot_ms,
            mode_id: CameraMode::CAMERA_MODE_VIDEO,
            zoomLevel: f32::NAN,
            focusLevel: f32::NAN,
            ..Default::default()
        }),
        STORAGE_INFORMATION => MavMessage::STORAGE_INFORMATION(STORAGE_INFORMATION_DATA {
            time_boot_ms,
            storage_id: 1,
            status: StorageStatus::STORAGE_STATUS_NOT_SUPPORTED,
            ..Default::default()
        }),
        CAMERA_CAPTURE_STATUS => MavMessage::CAMERA_CAPTURE_STATUS(CAMERA_CAPTURE_STATUS_DATA {
            time_boot_ms,
            ..Default::default()
        }),
        VIDEO_STREAM_INFORMATION => {
            MavMessage::VIDEO_STREAM_INFORMATION(VIDEO_STREAM_INFORMATION_DATA {
                stream_id: 1,
                count: 1,
                mavtype: match stream.kind {
                    Kind::Rtsp => VideoStreamType::VIDEO_STREAM_TYPE_RTSP,
                    Kind::Rtp => VideoStreamType::VIDEO_STREAM_TYPE_RTPUDP,
                    Kind::TcpMpeg => VideoStreamType::VIDEO_STREAM_TYPE_TCP_MPEG,
                    Kind::MpegTs => VideoStreamType::VIDEO_STREAM_TYPE_MPEG_TS,
                },
                flags: VideoStreamStatusFlags::VIDEO_STREAM_STATUS_FLAGS_RUNNING,
                framerate,
                resolution_h,
                resolution_v,
                bitrate,
                name: "front".into(),
                uri: stream.uri.as_str().into(),
                encoding: VideoStreamEncoding::VIDEO_STREAM_ENCODING_H264,
                ..Default::default()
            })
        }
        VIDEO_STREAM_STATUS => MavMessage::VIDEO_STREAM_STATUS(VIDEO_STREAM_STATUS_DATA {
            stream_id: 1,
            flags: VideoStreamStatusFlags::VIDEO_STREAM_STATUS_FLAGS_RUNNING,
            framerate,
            resolution_h,
            resolution_v,
            bitrate,
            ..Default::default()
        }),
        _ => return None,
    })
}

fn padded(name: &[u8]) -> [u8; 32] {
    let mut out = [0; 32];
    out[..name.len()].copy_from_slice(name);
    out
}

#[cfg(test)]
mod tests {
    use super::super::bench::{Bench, station};
    use super::*;

    fn ask(camera: &Camera, command: u16, params: [f32; 2], by_name: bool) -> Vec<Message> {
        let m = raw::COMMAND_LONG_DATA {
            command,
            param1: params[0],
            param2: params[1],
            ..Default::default()
        };
        let (bench, mut out) = (Bench::default(), Outbox::default());
        let message = raw::MavMessage::COMMAND_LONG(m).into();
        let from = station(255);
        camera.handle(
            Timestamp::ZERO,
            from,
            &message,
            by_name,
            &bench.ctx(),
            &mut out,
        );
        assert!(out.messages.iter().all(|m| m.from == Speaker::Camera));
        out.sent()
    }

    fn result_of(messages: &[Message]) -> Option<u8> {
        messages.iter().find_map(|m| match m {
            Message::Raw(raw::MavMessage::COMMAND_ACK(a)) => Some(a.result),
            _ => None,
        })
    }

    #[test]
    fn a_stream_is_described_in_the_forms_that_stations_ask() {
        let camera = Camera::new(Some(
            VideoStream::parse("rtsp://10.0.0.5:8554/front").unwrap(),
        ));
        for (command, id) in [(512, 269.0), (2504, 0.0)] {
            let said = ask(&camera, command, [id, 0.0], true);
            assert_eq!(result_of(&said), Some(result::ACCEPTED));
            let uri = said.iter().find_map(|m| match m {
                Message::Standard(MavMessage::VIDEO_STREAM_INFORMATION(s)) => {
                    Some((s.count, s.uri.to_str().unwrap().to_owned()))
                }
                _ => None,
            });
            assert_eq!(uri, Some((1, "rtsp://10.0.0.5:8554/front".to_owned())));
        }
        for (command, id) in [
            (512, 259.0),
            (512, 260.0),
            (512, 261.0),
            (512, 262.0),
            (521, 0.0),
        ] {
            assert_eq!(ask(&camera, command, [id, 0.0], true).len(), 2);
        }
    }

    #[test]
    fn what_it_cannot_do_is_unsupported_at_once() {
        let camera = Camera::new(Some(VideoStream::parse("udp://:5600").unwrap()));
        for command in [2000, 2001, 2500, 2501, 2503, 526, 529, 531, 532] {
            let said = ask(&camera, command, [0.0, 0.0], true);
            assert_eq!(result_of(&said), Some(result::UNSUPPORTED), "{command}");
        }
        assert_eq!(
            result_of(&ask(&camera, 530, [0.0, 1.0], true)),
            Some(result::ACCEPTED)
        );
        assert_eq!(
            result_of(&ask(&camera, 530, [0.0, 0.0], true)),
            Some(result::UNSUPPORTED)
        );
        assert!(
            ask(&camera, 400, [1.0, 0.0], false).is_empty(),
            "the autopilot answers that"
        );
        assert!(ask(&Camera::default(), 521, [0.0, 0.0], true).is_empty());
    }

    #[test]
    fn urls_say_their_kind_and_wrong_ones_how_to_write_them() {
        assert_eq!(VideoStream::parse("udp://:5600").unwrap().uri, "5600");
        assert_eq!(
            VideoStream::parse("mpegts://0.0.0.0:5601").unwrap().uri,
            "5601"
        );
        for wrong in [
            "/dev/video0",
            "rtsp://",
            "udp://:video",
            "http://x",
            &format!("rtsp://{}", "x".repeat(160)),
        ] {
            assert!(VideoStream::parse(wrong).is_err(), "{wrong}");
        }
    }
}
