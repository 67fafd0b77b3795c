//! The camera's thread from outside: a viewer by the words of MAVLink Camera Manager, a ground station by RTP, and rubbish.

#![cfg(feature = "video")]
#![allow(
    clippy::disallowed_methods,
    clippy::unwrap_used,
    reason = "real sockets run in real time; a test program fails where it stands"
)]

use bridge::io::camera::{CameraConfig, CameraThread};
use bridge::video::CameraSource;
use bridge::video::annex_b::{AccessUnit, Assembler};
use bridge::video::encode::{Encoder, EncoderSettings};
use bridge::video::rtp::{Depacketizer, Packetizer};
use bridge::web::signal::Desk;
use serde_json::{Value, json};
use sim::camera::{Picture, stamp};
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};
use str0m::change::SdpOffer;
use str0m::net::{Protocol, Receive};
use str0m::{Candidate, Event, Input, Output, Rtc};

const LOCAL: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// A recording of two seconds, a key picture every half second, in a file of its own.
struct Recording {
    path: PathBuf,
    units: Vec<AccessUnit>,
}

impl Recording {
    fn make(name: &str) -> Self {
        let mut encoder = Encoder::new(EncoderSettings::default()).unwrap();
        let mut picture = Picture::new(320, 240);
        let mut bytes = Vec::new();
        for n in 0..60_u64 {
            for (i, y) in picture.y.iter_mut().enumerate() {
                *y = (40 + (i as u64 * 7 + n * 1931) / 977 % 160) as u8;
            }
            stamp(&mut picture, n * 33);
            if let Some(unit) = encoder.encode(&picture, n * 33, n % 15 == 0).unwrap() {
                bytes.extend_from_slice(&unit.annex_b);
            }
        }
        let path = std::env::temp_dir().join(format!("kestrel-{name}-{}.h264", std::process::id()));
        std::fs::write(&path, &bytes).unwrap();
        let (mut assembler, mut units) = (Assembler::default(), Vec::new());
        assembler.push(&bytes, &mut |u| units.push(u));
        assembler.finish(&mut |u| units.push(u));
        assert!(units.len() > 50);
        Self { path, units }
    }

    fn source(&self) -> CameraSource {
        CameraSource::File {
            path: self.path.clone(),
            fps: Some(60.0),
        }
    }

    /// Where in the recording a run of pictures is, whole and in order; it goes round.
    fn place_of(&self, run: &[Vec<u8>]) -> Option<usize> {
        let whole = |bytes: &[u8]| bytes.to_vec();
        (0..self.units.len()).find(|start| {
            run.iter()
                .enumerate()
                .all(|(i, got)| whole(&self.units[(start + i) % self.units.len()].annex_b) == *got)
        })
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

fn camera(source: CameraSource, listen: Option<IpAddr>, stations: Vec<SocketAddr>) -> CameraThread {
    CameraThread::start(CameraConfig {
        source,
        scenery: None,
        listen,
        stations,
        encoder: EncoderSettings::default(),
    })
    .unwrap()
}

/// A viewer of MAVLink Camera Manager, by script.
struct Viewer {
    desk: Arc<dyn Desk>,
    caller: u64,
    told: Receiver<String>,
    socket: UdpSocket,
    rtc: Rtc,
    pictures: Vec<Vec<u8>>,
    is_over: bool,
}

impl Viewer {
    fn come(camera: &CameraThread) -> Self {
        let desk = camera.desk();
        Self::come_to(desk)
    }

    fn come_to(desk: Arc<dyn Desk>) -> Self {
        let (tell, told) = sync_channel(64);
        let reply = Box::new(move |text| tell.try_send(text).is_ok());
        let caller = desk.open(LOCAL, reply).unwrap();
        let socket = UdpSocket::bind((LOCAL, 0)).unwrap();
        let rtc = Rtc::builder()
            .clear_codecs()
            .enable_h264(true)
            .build(Instant::now());
        Self {
            desk,
            caller,
            told,
            socket,
            rtc,
            pictures: Vec::new(),
            is_over: false,
        }
    }

    fn say(&self, kind: &str, name: &str, content: &Value) {
        let message = json!({ "type": kind, "content": { "type": name, "content": content } });
        assert!(self.desk.say(self.caller, message.to_string()));
    }

    fn hear(&self) -> (String, Value) {
        let text = self.told.recv_timeout(Duration::from_secs(10)).unwrap();
        let message: Value = serde_json::from_str(&text).unwrap();
        let name = message["content"]["type"].as_str().unwrap().to_owned();
        (name, message["content"]["content"].clone())
    }

    /// Asks for the stream and answers the offer.
    fn ask(&mut self) {
        self.say("question", "peerId", &Value::Null);
        let (name, me) = self.hear();
        assert_eq!(name, "peerId");
        self.say("question", "availableStreams", &Value::Null);
        let (_, streams) = self.hear();
        assert_eq!(streams[0]["encode"], "H264");
        let ids = json!({ "consumer_id": me["id"], "producer_id": streams[0]["id"] });
        self.say("question", "startSession", &ids);
        assert_eq!(self.hear().0, "startSession");
        let (name, offer) = self.hear();
        assert_eq!(name, "mediaNegotiation");
        let local = Candidate::host(self.socket.local_addr().unwrap(), "udp").unwrap();
        self.rtc.add_local_candidate(local);
        let sdp = SdpOffer::from_sdp_string(offer["sdp"]["sdp"].as_str().unwrap()).unwrap();
        let answer = self.rtc.sdp_api().accept_offer(sdp).unwrap();
        let mut content = offer.clone();
        content["sdp"] = json!({ "type": "answer", "sdp": answer.to_sdp_string() });
        self.say("negotiation", "mediaNegotiation", &content);
    }

    /// Receives until it has so many pictures, or the time is over.
    fn watch(&mut self, pictures: usize, most: Duration) {
        let end = Instant::now() + most;
        let mut bytes = [0; 2048];
        while self.pictures.len() < pictures && Instant::now() < end {
            let until = loop {
                match self.rtc.poll_output().unwrap() {
                    Output::Timeout(t) => break t,
                    Output::Transmit(t) => {
                        self.socket.send_to(&t.contents, t.destination).unwrap();
                    }
                    Output::Event(Event::MediaData(m)) => self.pictures.push(m.data.to_vec()),
                    Output::Event(Event::Closed) => self.is_over = true,
                    Output::Event(_) => {}
                }
            };
            if self.is_over {
                return;
            }
            let wait = until
                .min(end)
                .saturating_duration_since(Instant::now())
                .max(Duration::from_millis(1));
            self.socket.set_read_timeout(Some(wait)).unwrap();
            let now = Instant::now();
            match self.socket.recv_from(&mut bytes) {
                Ok((n, from)) => {
                    let to = self.socket.local_addr().unwrap();
                    let receive = Receive::new(Protocol::Udp, from, to, &bytes[..n]).unwrap();
                    self.rtc.handle_input(Input::Receive(now, receive)).unwrap();
                }
                Err(_) => self.rtc.handle_input(Input::Timeout(now)).unwrap(),
            }
        }
    }
}

#[test]
fn a_recording_reaches_a_viewer_of_camera_manager_unchanged_and_rubbish_does_not_disturb_it() {
    let recording = Recording::make("viewer");
    let camera = camera(recording.source(), Some(LOCAL), Vec::new());
    let media = camera.address.unwrap();
    let mut viewer = Viewer::come(&camera);
    viewer.ask();
    viewer.watch(20, Duration::from_secs(20));
    assert!(viewer.pictures.len() >= 20, "{}", viewer.pictures.len());
    assert!(
        recording.place_of(&viewer.pictures).is_some(),
        "byte by byte"
    );

    // A stranger sends noise, and things that look like STUN, DTLS and RTP.
    let before = camera.counts().strangers.load(Relaxed);
    let stranger = UdpSocket::bind((LOCAL, 0)).unwrap();
    let mut seed = 1_u32;
    for i in 0..3000_usize {
        let bytes: Vec<u8> = (0..i % 700)
            .map(|k| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                match k {
                    0 => [0, 1, 20, 22, 128, 129, 200][i % 7],
                    _ => (seed >> 24) as u8,
                }
            })
            .collect();
        stranger.send_to(&bytes, media).unwrap();
        if i % 50 == 0 {
            viewer.watch(viewer.pictures.len() + 1, Duration::from_millis(200));
        }
    }
    let seen = viewer.pictures.len();
    viewer.watch(seen + 30, Duration::from_secs(10));
    assert!(viewer.pictures.len() >= seen + 30, "the picture goes on");
    let strangers = camera.counts().strangers.load(Relaxed) - before;
    println!(
        "FIGURES\nWebRTC socket: {strangers} of 3000 strange datagrams dropped and counted (the rest by the system)\nEND"
    );
    assert!(strangers > 500, "{strangers}");

    // It says good-bye: nobody is watching any more.
    viewer.desk.close(viewer.caller);
    viewer.watch(usize::MAX, Duration::from_secs(5));
    assert!(viewer.is_over, "told of the end");
    let end = Instant::now() + Duration::from_secs(5);
    while camera.counts().viewers.load(Relaxed) > 0 {
        assert!(Instant::now() < end);
        std::thread::yield_now();
    }
}

#[test]
fn sessions_are_limited_and_one_too_many_is_told_so() {
    let recording = Recording::make("many");
    let camera = camera(recording.source(), Some(LOCAL), Vec::new());
    let desk = camera.desk();
    let mut all = Vec::new();
    for i in 0..=bridge::video::viewers::MOST {
        let viewer = Viewer::come_to(Arc::clone(&desk));
        viewer.say("question", "availableStreams", &Value::Null);
        let (_, streams) = viewer.hear();
        viewer.say(
            "question",
            "startSession",
            &json!({ "producer_id": streams[0]["id"] }),
        );
        let expected = if i < bridge::video::viewers::MOST {
            "startSession"
        } else {
            "endSession"
        };
        assert_eq!(viewer.hear().0, expected, "{i}");
        all.push(viewer);
    }
    for words in [
        "",
        "{",
        "null",
        "[1]",
        "{\"type\":\"question\",\"content\":{\"type\":\"startSession\",\"content\":{\"producer_id\":\"none\"}}}",
    ] {
        assert!(desk.say(all[0].caller, words.to_owned()));
    }
    all[0].say("question", "peerId", &Value::Null);
    // The offer was waiting; then the answer to the last word.
    assert_eq!(all[0].hear().0, "mediaNegotiation");
    assert_eq!(all[0].hear().0, "peerId");
}

#[test]
fn a_ground_station_that_listens_gets_every_picture_and_one_that_does_not_costs_nothing() {
    let recording = Recording::make("station");
    let station = UdpSocket::bind((LOCAL, 0)).unwrap();
    station
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    let target = station.local_addr().unwrap();
    let camera = camera(recording.source(), None, vec![target]);
    let (mut depacketizer, mut got) = (Depacketizer::default(), Vec::new());
    let mut packet = [0; 2048];
    while got.len() < 40 {
        let n = station.recv(&mut packet).unwrap();
        depacketizer.push(&packet[..n], &mut |u| got.push(u.annex_b.to_vec()));
    }
    assert!(recording.place_of(&got).is_some(), "byte by byte");
    // It closes; the system says so, and the recording stops.
    drop(station);
    let settled = |camera: &CameraThread| {
        let before = camera.counts().pictures.load(Relaxed);
        let end = Instant::now() + Duration::from_millis(900);
        while Instant::now() < end {
            std::thread::sleep(Duration::from_millis(20));
        }
        camera.counts().pictures.load(Relaxed) - before
    };
    let _ = settled(&camera);
    let still = settled(&camera);
    // A knock a second may find nobody a moment too late: a picture or two.
    assert!(still < 10, "{still} pictures for nobody");
    // And comes back.
    let station = UdpSocket::bind(target).unwrap();
    station
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    let (mut depacketizer, mut again) = (Depacketizer::default(), 0);
    while again < 5 {
        let n = station.recv(&mut packet).unwrap();
        depacketizer.push(&packet[..n], &mut |_| again += 1);
    }
}

#[test]
fn a_camera_program_runs_only_while_somebody_watches() {
    let recording = Recording::make("program");
    let mark = recording.path.with_extension("started");
    let command = format!(
        "echo x >> {}; while true; do cat {}; sleep 0.2; done",
        mark.display(),
        recording.path.display()
    );
    let camera = camera(CameraSource::Command(command), Some(LOCAL), Vec::new());
    std::thread::sleep(Duration::from_millis(400));
    assert!(!mark.exists(), "nobody watches");
    let mut viewer = Viewer::come(&camera);
    viewer.ask();
    viewer.watch(10, Duration::from_secs(20));
    assert!(viewer.pictures.len() >= 10);
    assert!(mark.exists());
    drop(camera);
    let _ = std::fs::remove_file(mark);
}

#[test]
fn a_recording_that_is_not_there_is_told_at_once() {
    let config = CameraConfig {
        source: CameraSource::File {
            path: "/nowhere/x.h264".into(),
            fps: None,
        },
        scenery: None,
        listen: Some(LOCAL),
        stations: Vec::new(),
        encoder: EncoderSettings::default(),
    };
    let error = CameraThread::start(config).unwrap_err().to_string();
    assert!(error.contains("/nowhere/x.h264"), "{error}");
}

/// An RTSP camera in this process, which wants a password; its port, and how often it was asked to play.
fn rtsp_camera(units: Vec<AccessUnit>) -> (u16, Arc<AtomicUsize>) {
    let listener = TcpListener::bind((LOCAL, 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    let plays = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&plays);
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let _ = serve_rtsp(stream.unwrap(), &units, &counted);
        }
    });
    (port, plays)
}

fn serve_rtsp(stream: TcpStream, units: &[AccessUnit], plays: &AtomicUsize) -> std::io::Result<()> {
    let mut lines = BufReader::new(stream.try_clone()?).lines();
    let mut stream = stream;
    loop {
        let mut head = Vec::new();
        for line in lines.by_ref() {
            let line = line?;
            if line.is_empty() {
                break;
            }
            head.push(line);
        }
        let Some(first) = head.first() else {
            return Ok(());
        };
        let is_known = head.iter().any(|l| l.starts_with("Authorization: Digest "));
        let sdp = "v=0\r\nm=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\na=control:track1\r\n";
        let (status, fields, body) = match first.split(' ').next() {
            Some("DESCRIBE") if !is_known => (
                "401 Unauthorized",
                "WWW-Authenticate: Digest realm=\"camera\", nonce=\"abc\"\r\n",
                "",
            ),
            Some("DESCRIBE") => ("200 OK", "", sdp),
            Some("SETUP") => ("200 OK", "Session: 7;timeout=10\r\n", ""),
            Some("PLAY") => ("200 OK", "", ""),
            _ => ("200 OK", "", ""),
        };
        write!(
            stream,
            "RTSP/1.0 {status}\r\nCSeq: 1\r\n{fields}Content-Length: {}\r\n\r\n{body}",
            body.len()
        )?;
        if first.starts_with("PLAY") {
            plays.fetch_add(1, Relaxed);
            let mut packetizer = Packetizer::new(9, 65_000);
            for (n, unit) in units.iter().cycle().enumerate() {
                let mut bytes = Vec::new();
                packetizer.packets(unit, n as u32 * 1500, &mut |p| {
                    bytes.extend([b'$', 0]);
                    bytes.extend((p.len() as u16).to_be_bytes());
                    bytes.extend(p);
                });
                stream.write_all(&bytes)?;
                std::thread::sleep(Duration::from_millis(16));
            }
        }
    }
}

#[test]
fn an_rtsp_camera_with_a_password_reaches_a_viewer_unchanged() {
    let recording = Recording::make("rtsp");
    let (port, plays) = rtsp_camera(recording.units.clone());
    let url = format!("rtsp://guard:secret@127.0.0.1:{port}/live");
    let camera = camera(CameraSource::Rtsp(url), Some(LOCAL), Vec::new());
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(plays.load(Relaxed), 0, "nobody watches");
    let mut viewer = Viewer::come(&camera);
    viewer.ask();
    viewer.watch(20, Duration::from_secs(20));
    assert!(viewer.pictures.len() >= 20, "{:?}", camera.poll_told());
    assert!(
        recording.place_of(&viewer.pictures).is_some(),
        "byte by byte"
    );
}
