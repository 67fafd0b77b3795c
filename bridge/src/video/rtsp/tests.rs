use super::*;
use crate::video::annex_b::nals;
use crate::video::rtp::Packetizer;
use proptest::prelude::*;

const SDP: &str = "v=0\r\no=- 0 0 IN IP4 0\r\ns=x\r\nm=audio 0 RTP/AVP 0\r\na=control:trackID=9\r\n\
                   m=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\n\
                   a=fmtp:96 packetization-mode=1;sprop-parameter-sets=ZwEC,aAM=;x=1\r\na=control:trackID=1\r\n";

fn reply(status: &str, fields: &str, body: &str) -> Vec<u8> {
    format!(
        "RTSP/1.0 {status}\r\nCSeq: 1\r\n{fields}Content-Length: {}\r\n\r\n{body}",
        body.len()
    )
    .into_bytes()
}

fn asked(client: &mut Client) -> String {
    String::from_utf8(client.poll_transmit().unwrap()).unwrap()
}

fn client(url: &str) -> Client {
    Client::new(Address::parse(url).unwrap())
}

#[test]
fn addresses_hide_their_password_and_know_their_port() {
    let a = Address::parse("rtsp://me:se:cret@cam:8554/live/1?x=2").unwrap();
    assert_eq!((a.host.as_str(), a.port), ("cam", 8554));
    assert_eq!(a.url, "rtsp://cam:8554/live/1?x=2");
    assert_eq!(a.user, Some(("me".to_owned(), "se:cret".to_owned())));
    assert_eq!(Address::parse("rtsp://[::1]/x").unwrap().host, "::1");
    assert_eq!(Address::parse("rtsp://cam").unwrap().port, 554);
    for wrong in [
        "http://cam",
        "rtsp://",
        "rtsp://cam:x/1",
        "rtsp://cam/a\r\nb",
    ] {
        assert!(Address::parse(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn a_camera_is_described_set_up_and_played_and_its_pictures_come_out() {
    let mut c = client("rtsp://cam/live");
    assert!(asked(&mut c).starts_with("DESCRIBE rtsp://cam/live RTSP/1.0\r\nCSeq: 1\r\n"));
    let mut got = Vec::new();
    let take = &mut |u: AccessUnit| got.push(u);
    // The answer comes in two pieces.
    let described = reply("200 OK", "Content-Base: rtsp://cam/live/\r\n", SDP);
    c.push(&described[..50], take).unwrap();
    assert_eq!(c.poll_transmit(), None);
    c.push(&described[50..], take).unwrap();
    let setup = asked(&mut c);
    assert!(
        setup.starts_with("SETUP rtsp://cam/live/trackID=1 "),
        "{setup}"
    );
    c.push(&reply("200 OK", "Session: 42;timeout=30\r\n", ""), take)
        .unwrap();
    let play = asked(&mut c);
    assert!(play.starts_with("PLAY ") && play.contains("Session: 42\r\n"));
    assert_eq!(c.timeout_s, 30);
    let mut bytes = reply("200 OK", "", "");
    // A key picture without its sets: they were in the description.
    let picture = AccessUnit {
        annex_b: [&[0, 0, 0, 1, 0x65, 0x88][..], &[7; 3000]].concat().into(),
        is_key: true,
    };
    Packetizer::new(1, 1).packets(&picture, 0, &mut |p| {
        bytes.extend([b'$', 0]);
        bytes.extend((p.len() as u16).to_be_bytes());
        bytes.extend(p);
        bytes.extend([b'$', 1, 0, 2, 9, 9]);
    });
    for piece in bytes.chunks(700) {
        c.push(piece, take).unwrap();
    }
    assert!(c.is_playing());
    assert_eq!(got.len(), 1);
    let kinds: Vec<u8> = nals(&got[0].annex_b).map(|n| n[0]).collect();
    assert_eq!(kinds, [0x67, 0x68, 0x65]);
    c.tear_down();
    assert!(asked(&mut c).starts_with("TEARDOWN "));
}

#[test]
fn a_camera_that_wants_a_password_gets_it_once() {
    let mut c = client(
        "rtsp://Mufasa:Circle Of Life@h/dir"
            .replace(' ', "%20")
            .as_str(),
    );
    let _ = asked(&mut c);
    let wants = "WWW-Authenticate: Basic realm=\"x\"\r\nWWW-Authenticate: Digest realm=\"r\", nonce=\"n\"\r\n";
    c.push(&reply("401 Unauthorized", wants, ""), &mut |_| {})
        .unwrap();
    let again = asked(&mut c);
    let expected = {
        let a = md5_hex("Mufasa:r:Circle%20Of%20Life");
        let b = md5_hex("DESCRIBE:rtsp://h/dir");
        md5_hex(&format!("{a}:n:{b}"))
    };
    assert!(
        again.contains(&format!("response=\"{expected}\"")),
        "{again}"
    );
    let refused = c.push(&reply("401 Unauthorized", wants, ""), &mut |_| {});
    assert!(refused.unwrap_err().to_string().contains("password"));
}

#[test]
fn a_camera_without_h264_and_a_web_server_are_told_apart() {
    let mut c = client("rtsp://cam/x");
    let none = c.push(
        &reply("200 OK", "", "v=0\r\nm=video 0 RTP/AVP 26\r\n"),
        &mut |_| {},
    );
    assert_eq!(none, Err(RtspError::NoH264));
    let mut c = client("rtsp://cam/x");
    let junk = vec![b'x'; LONGEST + 1];
    assert_eq!(c.push(&junk, &mut |_| {}), Err(RtspError::NoRtsp));
}

#[test]
fn base64_and_md5_are_as_their_papers_say() {
    assert_eq!(
        base64(b"Aladdin:open sesame"),
        "QWxhZGRpbjpvcGVuIHNlc2FtZQ=="
    );
    assert_eq!(unbase64("ZwEC"), Some(vec![0x67, 1, 2]));
    assert_eq!(unbase64("aAM="), Some(vec![0x68, 3]));
    assert_eq!(md5_hex("abc"), "900150983cd24fb0d6963f7d28e17f72");
}

proptest! {
    #[test]
    fn any_bytes_are_survived(pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..60), 0..20)) {
        let mut c = client("rtsp://cam/x");
        for piece in pieces {
            if c.push(&piece, &mut |_| {}).is_err() {
                break;
            }
        }
    }
}
