//! Those who watch by WebRTC: one session each, all on one UDP socket. No sockets and no clock here: datagrams and time come in,
//! datagrams and words go out.
//!
//! Only whoever came through the signalling has a session; a datagram that belongs to none is dropped and counted. Sessions are
//! few, and each holds a second of packets at most, for what must be sent again.

use super::annex_b::AccessUnit;
use super::signalling::{self, Bind, Said, Stream};
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use str0m::change::{SdpAnswer, SdpPendingOffer};
use str0m::format::{Codec, PayloadParams};
use str0m::media::{Direction, Frequency, MediaKind, MediaTime, Mid, Pt};
use str0m::net::{Protocol, Receive};
use str0m::rtp::Extension;
use str0m::{Candidate, Event, Input, Output, Rtc};

/// Sessions at once.
pub const MOST: usize = 16;
/// A session that is not connected by then ends.
const PATIENCE: Duration = Duration::from_secs(15);
/// Errors that a session may have: datagrams with a forged source address make some.
const ERRORS: u32 = 50;
/// Longest SDP taken.
const LONGEST: usize = 32 * 1024;
/// RTP header extension: how long a viewer may hold a picture back (not at all).
const PLAYOUT_DELAY: u8 = 12;

/// A socket of the signalling.
pub type Caller = u64;

/// What leaves.
pub trait Out {
    /// A datagram.
    fn transmit(&mut self, to: SocketAddr, bytes: &[u8]);
    /// Words for a caller.
    fn tell(&mut self, caller: Caller, text: String);
}

struct Viewer {
    caller: Caller,
    bind: Bind,
    local: SocketAddr,
    rtc: Rtc,
    mid: Mid,
    pending: Option<SdpPendingOffer>,
    payload: Option<Pt>,
    begun: Instant,
    deadline: Instant,
    is_connected: bool,
    needs_key: bool,
    errors: u32,
}

/// All of them.
#[derive(Default)]
pub struct Viewers {
    all: Vec<Viewer>,
    wants_key: bool,
    /// Datagrams that belonged to no session, or could not be read.
    pub strangers: u64,
    /// Pictures that a session refused.
    pub refused: u64,
}

impl Viewers {
    /// How many sessions.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.all.len()
    }

    /// True once if somebody needs a key picture.
    pub const fn take_wants_key(&mut self) -> bool {
        std::mem::replace(&mut self.wants_key, false)
    }

    /// When [`Self::pass`] must be called next.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.all.iter().map(|v| v.deadline).min()
    }

    /// A caller wants to see. `local`: our media address as that caller reaches it; `ids`: random bytes.
    pub fn begin(
        &mut self,
        now: Instant,
        (caller, consumer): (Caller, &str),
        stream: &Stream,
        local: SocketAddr,
        ids: [u8; 16],
        out: &mut impl Out,
    ) {
        self.end(caller, out);
        let bind = Bind {
            consumer: consumer.to_owned(),
            producer: stream.id.clone(),
            session: signalling::uuid(ids),
        };
        if self.all.len() >= MOST {
            out.tell(caller, signalling::session_ended(&bind, "too many watch"));
            return;
        }
        let mut rtc = Rtc::builder()
            .clear_codecs()
            .enable_h264(true)
            .set_extension(PLAYOUT_DELAY, Extension::PlayoutDelay)
            .set_send_buffer_video(400)
            .build(now);
        let Ok(candidate) = Candidate::host(local, "udp") else {
            out.tell(caller, signalling::session_ended(&bind, "no address"));
            return;
        };
        rtc.add_local_candidate(candidate);
        let mut change = rtc.sdp_api();
        let track = Some("camera".to_owned());
        let mid = change.add_media(
            MediaKind::Video,
            Direction::SendOnly,
            track.clone(),
            track,
            None,
        );
        let Some((offer, pending)) = change.apply() else {
            return;
        };
        out.tell(caller, signalling::session_started(&bind));
        out.tell(caller, signalling::offer(&bind, &offer.to_sdp_string()));
        let mut viewer = Viewer {
            caller,
            bind,
            local,
            rtc,
            mid,
            pending: Some(pending),
            payload: None,
            begun: now,
            deadline: now,
            is_connected: false,
            needs_key: true,
            errors: 0,
        };
        viewer.drain(now, &mut self.wants_key, out);
        self.all.push(viewer);
    }

    /// What a caller says of its session.
    pub fn said(&mut self, now: Instant, caller: Caller, said: &Said, out: &mut impl Out) {
        let Some(viewer) = self.all.iter_mut().find(|v| v.caller == caller) else {
            return;
        };
        match said {
            Said::Answer { session, sdp }
                if *session == viewer.bind.session && sdp.len() <= LONGEST =>
            {
                let Ok(answer) = SdpAnswer::from_sdp_string(sdp) else {
                    return;
                };
                if let Some(pending) = viewer.pending.take()
                    && viewer.rtc.sdp_api().accept_answer(pending, answer).is_err()
                {
                    self.end(caller, out);
                    return;
                }
                viewer.drain(now, &mut self.wants_key, out);
            }
            Said::Candidate { session, candidate } if *session == viewer.bind.session => {
                // Names (mDNS) are not resolved: the viewer's address is learned from its first datagram.
                if let Ok(c) = Candidate::from_sdp_string(candidate) {
                    viewer.rtc.add_remote_candidate(c);
                    viewer.drain(now, &mut self.wants_key, out);
                }
            }
            Said::EndSession { session } if *session == viewer.bind.session => {
                self.end(caller, out);
            }
            _ => {}
        }
    }

    /// A caller is gone, or has had enough.
    pub fn end(&mut self, caller: Caller, out: &mut impl Out) {
        if let Some(at) = self.all.iter().position(|v| v.caller == caller) {
            let mut viewer = self.all.swap_remove(at);
            // A farewell, so that the other side need not wait.
            if viewer.rtc.close().is_ok() {
                let now = viewer.deadline;
                viewer.drain(now, &mut false, out);
            }
        }
    }

    /// A datagram came.
    pub fn receive(&mut self, now: Instant, from: SocketAddr, bytes: &[u8], out: &mut impl Out) {
        for viewer in &mut self.all {
            let Ok(receive) = Receive::new(Protocol::Udp, from, viewer.local, bytes) else {
                break;
            };
            let input = Input::Receive(now, receive);
            if viewer.rtc.accepts(&input) {
                if viewer.rtc.handle_input(input).is_err() {
                    viewer.errors += 1;
                    self.strangers += 1;
                }
                viewer.drain(now, &mut self.wants_key, out);
                return;
            }
        }
        self.strangers += 1;
    }

    /// Time passes; sessions that are over are ended.
    pub fn pass(&mut self, now: Instant, out: &mut impl Out) {
        let mut over = Vec::new();
        for viewer in &mut self.all {
            if viewer.deadline <= now {
                if viewer.rtc.handle_input(Input::Timeout(now)).is_err() {
                    viewer.errors += 1;
                }
                viewer.drain(now, &mut self.wants_key, out);
            }
            let is_late = !viewer.is_connected && now.duration_since(viewer.begun) > PATIENCE;
            if !viewer.rtc.is_alive() || is_late || viewer.errors > ERRORS {
                over.push((
                    viewer.caller,
                    signalling::session_ended(&viewer.bind, "the connection was lost"),
                ));
            }
        }
        for (caller, words) in over {
            self.all.retain(|v| v.caller != caller);
            out.tell(caller, words);
        }
    }

    /// A picture for everybody: coded once, sent to all. `time`: 90 kHz.
    pub fn show(&mut self, now: Instant, time: u64, unit: &AccessUnit, out: &mut impl Out) {
        let time = MediaTime::new(time, Frequency::NINETY_KHZ);
        for viewer in &mut self.all {
            if !viewer.is_connected || (viewer.needs_key && !unit.is_key) {
                continue;
            }
            let Some(writer) = viewer.rtc.writer(viewer.mid) else {
                continue;
            };
            let payload = viewer.payload.or_else(|| choose(writer.payload_params()));
            viewer.payload = payload;
            let Some(payload) = payload else { continue };
            let written = writer
                .playout_delay(MediaTime::ZERO, MediaTime::ZERO)
                .write(payload, now, time, unit.annex_b.clone());
            match written {
                Ok(()) => viewer.needs_key = false,
                Err(_) => {
                    self.refused += 1;
                    viewer.needs_key = true;
                    self.wants_key = true;
                }
            }
            // What was written is cut into packets when time passes.
            viewer.drain(now, &mut self.wants_key, out);
            if viewer.rtc.handle_input(Input::Timeout(now)).is_err() {
                viewer.errors += 1;
            }
            viewer.drain(now, &mut self.wants_key, out);
        }
    }
}

/// Of the formats agreed on: packetization mode 1, constrained baseline before others. Decoders take what the stream itself says.
fn choose<'a>(offered: impl Iterator<Item = &'a PayloadParams>) -> Option<Pt> {
    offered
        .filter(|p| p.spec().codec == Codec::H264)
        .filter(|p| p.spec().format.packetization_mode == Some(1))
        .max_by_key(
            |p| match p.spec().format.profile_level_id.map(|id| id >> 8) {
                Some(0x42E0) => 2,
                Some(0x4200) => 1,
                _ => 0,
            },
        )
        .map(PayloadParams::pt)
}

impl Viewer {
    /// Carries out all that the session wants, until it wants to wait.
    fn drain(&mut self, now: Instant, wants_key: &mut bool, out: &mut impl Out) {
        loop {
            match self.rtc.poll_output() {
                Ok(Output::Timeout(at)) => {
                    self.deadline = at;
                    return;
                }
                Ok(Output::Transmit(t)) => out.transmit(t.destination, &t.contents),
                Ok(Output::Event(Event::Connected)) => {
                    self.is_connected = true;
                    *wants_key = true;
                }
                Ok(Output::Event(Event::KeyframeRequest(_))) => *wants_key = true,
                Ok(Output::Event(_)) => {}
                Err(_) => {
                    self.errors += 1;
                    self.rtc.disconnect();
                    self.deadline = now;
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::clock;
    use str0m::change::SdpOffer;

    const CAMERA: &str = "127.0.0.1:8444";

    #[derive(Default)]
    struct Kept {
        datagrams: Vec<(SocketAddr, Vec<u8>)>,
        words: Vec<(Caller, String)>,
    }

    impl Out for Kept {
        fn transmit(&mut self, to: SocketAddr, bytes: &[u8]) {
            self.datagrams.push((to, bytes.to_vec()));
        }

        fn tell(&mut self, caller: Caller, text: String) {
            self.words.push((caller, text));
        }
    }

    /// Repeatable bytes.
    struct Dice(u64);

    impl Dice {
        fn byte(&mut self) -> u8 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 56) as u8
        }

        /// Something that looks like STUN, DTLS, RTP or RTCP from afar, or like nothing.
        fn datagram(&mut self) -> Vec<u8> {
            let first = match self.byte() % 4 {
                0 => self.byte() % 4,
                1 => 20 + self.byte() % 44,
                2 => 128 + self.byte() % 64,
                _ => self.byte(),
            };
            let length = usize::from(self.byte()) * 5;
            let mut bytes = vec![first];
            bytes.extend((0..length).map(|_| self.byte()));
            if first < 4 && bytes.len() >= 20 {
                // The cookie of STUN, and a length that fits.
                let length = (bytes.len() - 20) as u16;
                bytes[2..4].copy_from_slice(&length.to_be_bytes());
                bytes[4..8].copy_from_slice(&[0x21, 0x12, 0xA4, 0x42]);
            }
            bytes
        }
    }

    fn stream() -> Stream {
        Stream {
            id: "p".to_owned(),
            name: "camera".to_owned(),
            size: [640, 480],
            fps: 30.0,
            source: "test".to_owned(),
        }
    }

    fn address(text: &str) -> SocketAddr {
        text.parse().unwrap()
    }

    /// A real peer: what a browser does, with the same library.
    struct Browser {
        rtc: Rtc,
        at: SocketAddr,
        pictures: usize,
        deadline: Instant,
    }

    impl Browser {
        fn join(now: Instant, viewers: &mut Viewers, caller: Caller, out: &mut Kept) -> Self {
            viewers.begin(
                now,
                (caller, "c"),
                &stream(),
                address(CAMERA),
                [caller as u8; 16],
                out,
            );
            let (_, offer) = out.words.last().unwrap();
            let offer: serde_json::Value = serde_json::from_str(offer).unwrap();
            let content = &offer["content"]["content"];
            let sdp = content["sdp"]["sdp"].as_str().unwrap();
            let at = address("127.0.0.1:40000");
            let mut rtc = Rtc::new(now);
            rtc.add_local_candidate(Candidate::host(at, "udp").unwrap());
            let offer = SdpOffer::from_sdp_string(sdp).unwrap();
            let answer = rtc.sdp_api().accept_offer(offer).unwrap();
            let said = Said::Answer {
                session: content["session_id"].as_str().unwrap().to_owned(),
                sdp: answer.to_sdp_string(),
            };
            viewers.said(now, caller, &said, out);
            Self {
                rtc,
                at,
                pictures: 0,
                deadline: now,
            }
        }

        /// Ten milliseconds of both sides.
        fn pass(&mut self, now: Instant, viewers: &mut Viewers, out: &mut Kept) {
            for (to, bytes) in std::mem::take(&mut out.datagrams) {
                if to == self.at {
                    let receive = Receive::new(Protocol::Udp, address(CAMERA), self.at, &bytes);
                    let _ = self.rtc.handle_input(Input::Receive(now, receive.unwrap()));
                }
            }
            if self.deadline <= now {
                let _ = self.rtc.handle_input(Input::Timeout(now));
            }
            loop {
                match self.rtc.poll_output().unwrap() {
                    Output::Timeout(at) => {
                        self.deadline = at;
                        break;
                    }
                    Output::Transmit(t) => viewers.receive(now, self.at, &t.contents, out),
                    Output::Event(Event::MediaData(_)) => self.pictures += 1,
                    Output::Event(_) => {}
                }
            }
            viewers.pass(now, out);
        }
    }

    #[test]
    fn who_floods_the_port_of_the_pictures_reaches_no_session_and_takes_nobodys_picture() {
        str0m::crypto::from_feature_flags().install_process_default();
        let (mut now, mut out, mut viewers) =
            (clock::instant(), Kept::default(), Viewers::default());
        let mut browser = Browser::join(now, &mut viewers, 1, &mut out);
        let picture = AccessUnit {
            annex_b: [[0, 0, 0, 1, 0x65].as_slice(), &[7; 3000]].concat().into(),
            is_key: true,
        };
        let mut dice = Dice(1);
        let mut flood = 0;
        for tick in 0..400 {
            now += Duration::from_millis(10);
            for _ in 0..20 {
                let from = SocketAddr::from(([10, 0, dice.byte(), dice.byte()], 4000));
                let bytes = dice.datagram();
                viewers.receive(now, from, &bytes, &mut out);
                flood += 1;
            }
            browser.pass(now, &mut viewers, &mut out);
            if tick % 3 == 0 {
                viewers.show(now, tick * 900, &picture, &mut out);
            }
        }
        assert!(browser.pictures > 50, "{} pictures", browser.pictures);
        assert_eq!((viewers.count(), viewers.strangers), (1, flood));
        // Nothing was said to anybody but the one who watches, and nobody else was answered.
        assert!(out.words.iter().all(|(caller, _)| *caller == 1) && out.words.len() == 2);
        assert!(out.datagrams.iter().all(|(to, _)| *to == browser.at));
    }

    #[test]
    fn forged_datagrams_of_a_viewer_end_at_most_that_one() {
        str0m::crypto::from_feature_flags().install_process_default();
        let (mut now, mut out, mut viewers) =
            (clock::instant(), Kept::default(), Viewers::default());
        let mut browser = Browser::join(now, &mut viewers, 1, &mut out);
        viewers.begin(now, (2, "d"), &stream(), address(CAMERA), [2; 16], &mut out);
        let mut dice = Dice(2);
        for _ in 0..200 {
            now += Duration::from_millis(10);
            browser.pass(now, &mut viewers, &mut out);
            let bytes = dice.datagram();
            viewers.receive(now, browser.at, &bytes, &mut out);
        }
        assert!(viewers.count() >= 1);
        assert!(out.words.iter().filter(|(c, _)| *c == 2).count() == 2);
    }

    #[test]
    fn no_more_watch_than_there_are_places_and_nobody_who_does_not_answer_keeps_his() {
        str0m::crypto::from_feature_flags().install_process_default();
        let (now, mut out, mut viewers) = (clock::instant(), Kept::default(), Viewers::default());
        let most = MOST as Caller;
        for caller in 0..=most {
            let ids = [caller as u8; 16];
            viewers.begin(
                now,
                (caller, "c"),
                &stream(),
                address(CAMERA),
                ids,
                &mut out,
            );
        }
        assert_eq!(viewers.count(), MOST);
        let (caller, words) = out.words.last().unwrap();
        assert!(
            *caller == most && words.contains("too many watch"),
            "{words}"
        );
        viewers.pass(now + PATIENCE + Duration::from_secs(1), &mut out);
        assert_eq!(viewers.count(), 0);
    }

    #[test]
    fn an_answer_that_is_none_changes_nothing() {
        str0m::crypto::from_feature_flags().install_process_default();
        let (now, mut out, mut viewers) = (clock::instant(), Kept::default(), Viewers::default());
        viewers.begin(now, (1, "c"), &stream(), address(CAMERA), [1; 16], &mut out);
        let session = signalling::uuid([1; 16]);
        for sdp in [String::new(), "v=0".to_owned(), "a".repeat(LONGEST + 1)] {
            let session = session.clone();
            viewers.said(now, 1, &Said::Answer { session, sdp }, &mut out);
        }
        let candidate = "candidate:nonsense".to_owned();
        viewers.said(now, 1, &Said::Candidate { session, candidate }, &mut out);
        assert_eq!((viewers.count(), out.words.len()), (1, 2));
    }
}
