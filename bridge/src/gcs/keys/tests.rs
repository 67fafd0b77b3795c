//! The key console as three stations speak it.

use super::super::bench::{Bench, answer, station};
use super::*;
use crate::autopilot::door::{Asked, KeySetpoint, Step};
use crate::gcs::LinkId;
use proptest::prelude::*;
use raw::MavMessage as M;
use vehicle::{In, ParamValue};

const A: Peer = station(255);
const B: Peer = station(250);

/// How a station wraps a line.
#[derive(Clone, Copy, Debug)]
enum Framing {
    /// Whole line, `\n`, flags RESPOND, EXCLUSIVE, MULTI.
    Qgc,
    /// `\r\n`, then polls with count 0 and the same flags.
    MavProxy,
    /// `\n`, flags 0.
    Mavsdk,
}

const FRAMINGS: [Framing; 3] = [Framing::Qgc, Framing::MavProxy, Framing::Mavsdk];

fn control(flags: u8, bytes: &[u8]) -> Message {
    let mut data = [0; CHUNK];
    data[..bytes.len()].copy_from_slice(bytes);
    let m = raw::SERIAL_CONTROL_DATA {
        device: SHELL,
        flags,
        count: bytes.len() as u8,
        data,
        ..Default::default()
    };
    Message::Raw(M::SERIAL_CONTROL(m))
}

/// The console with a vehicle behind it that knows key mode and nothing else.
struct Cockpit {
    console: KeyConsole,
    bench: Bench,
    out: Outbox,
    now: Timestamp,
    setpoint: KeySetpoint,
    keys: Vec<Key>,
    asked: Vec<Request>,
}

impl Cockpit {
    fn new() -> Self {
        Self {
            console: KeyConsole::new(),
            bench: Bench::default(),
            out: Outbox::default(),
            now: Timestamp::ZERO,
            setpoint: KeySetpoint {
                position: In::new(1.0, 2.0, -1.0),
                mass_kg: 1.7,
                ..Default::default()
            },
            keys: Vec::new(),
            asked: Vec::new(),
        }
    }

    fn send(&mut self, from: Peer, flags: u8, bytes: &[u8]) {
        self.console.handle(
            self.now,
            from,
            &control(flags, bytes),
            &self.bench.ctx(),
            &mut self.out,
        );
    }

    fn vehicle(&mut self, asked: &Asked) -> Outcome {
        let Request::Key(key) = asked.request else {
            self.asked.push(asked.request.clone());
            return Outcome::Accepted;
        };
        let sp = &mut self.setpoint;
        match key {
            Key::ToggleManual => sp.is_manual = !sp.is_manual,
            Key::Marker | Key::Escape => {
                self.keys.push(key);
                return Outcome::Accepted;
            }
            _ if !sp.is_manual => return Outcome::Refused(Refusal::KeyModeOff),
            Key::Roll(step) => sp.roll_rad += 0.045 * step.sign(),
            Key::Height(step) => {
                sp.position = sp.position.with_z(sp.position.z() - 0.2 * step.sign())
            }
            _ => {}
        }
        self.keys.push(key);
        Outcome::KeyTaken(self.setpoint)
    }

    /// 20 ms pass: the vehicle answers, then a snapshot comes.
    fn tick(&mut self) {
        self.now += Duration::from_millis(20);
        for asked in self.out.asked() {
            let outcome = self.vehicle(&asked);
            let answer = answer(&asked, outcome);
            assert!(
                self.console
                    .answer(self.now, &answer, &self.bench.ctx(), &mut self.out)
            );
        }
        self.bench.snapshot.is_key_mode = self.setpoint.is_manual;
        self.console
            .tick(self.now, &self.bench.ctx(), &mut self.out);
    }

    /// What was printed to a station since the last call, frames checked.
    fn printed(&mut self, to: Peer) -> String {
        let mut text = String::new();
        for m in self.out.messages.drain(..) {
            let Message::Raw(M::SERIAL_CONTROL(c)) = m.message else {
                panic!("only SERIAL_CONTROL")
            };
            assert_eq!(
                (c.device, c.flags, m.to),
                (SHELL, REPLY, Destination::Link(to.link))
            );
            assert_eq!(
                (c.target_system, c.target_component),
                (to.address.system, to.address.component)
            );
            assert!(c.count > 0 && usize::from(c.count) <= CHUNK);
            text.push_str(core::str::from_utf8(&c.data[..usize::from(c.count)]).unwrap());
        }
        assert!(text.is_ascii());
        text
    }

    /// Types a line the way a station does; what it prints.
    fn line(&mut self, framing: Framing, line: &str) -> String {
        let (end, flags) = match framing {
            Framing::Qgc => ("\n", 2 | 4 | 16),
            Framing::MavProxy => ("\r\n", 2 | 4 | 16),
            Framing::Mavsdk => ("\n", 0),
        };
        for chunk in format!("{line}{end}").as_bytes().chunks(CHUNK) {
            self.send(A, flags, chunk);
        }
        self.tick();
        if matches!(framing, Framing::MavProxy) {
            for _ in 0..5 {
                self.send(A, flags, b"");
                self.tick();
            }
        }
        self.printed(A)
    }
}

#[test]
fn every_key_works_in_every_framing() {
    use Step::{Minus, Plus};
    for framing in FRAMINGS {
        let mut c = Cockpit::new();
        let on = c.line(framing, "m");
        assert_eq!(
            on,
            "m: manual mode on: roll +0.000 nose-down +0.000 yaw +0.000 rad, x +1.00 y +2.00 height 1.00 m, mass 1.700 kg\n\
             kestrel> "
        );
        for (letter, key) in [
            ("j", Key::Roll(Plus)),
            ("g", Key::Roll(Minus)),
            ("y", Key::NoseDown(Plus)),
            ("h", Key::NoseDown(Minus)),
            ("q", Key::YawLeft(Plus)),
            ("w", Key::YawLeft(Minus)),
            ("e", Key::Height(Plus)),
            ("d", Key::Height(Minus)),
            ("i", Key::Mass(Plus)),
            ("k", Key::Mass(Minus)),
            ("0", Key::MassDefault),
            ("8", Key::NudgeForward(Plus)),
            ("2", Key::NudgeForward(Minus)),
            ("6", Key::NudgeRight(Plus)),
            ("4", Key::NudgeRight(Minus)),
            ("", Key::Marker),
            ("\u{1B}", Key::Escape),
        ] {
            c.keys.clear();
            let printed = c.line(framing, letter);
            assert_eq!(c.keys, [key], "{framing:?} {letter:?}");
            assert!(
                printed.ends_with(PROMPT) && printed.matches(PROMPT).count() == 1,
                "{framing:?} {printed}"
            );
            if !matches!(key, Key::Marker | Key::Escape) {
                assert!(
                    printed.starts_with(&format!("{letter}: roll ")),
                    "{framing:?} {printed}"
                );
            }
        }
        assert!(c.line(framing, "m").starts_with("m: manual mode off\n"));
    }
}

#[test]
fn a_line_of_keys_repeats_the_set_point_after_each() {
    let mut c = Cockpit::new();
    c.line(Framing::Qgc, "m");
    let printed = c.line(Framing::Qgc, "jje");
    let lines: Vec<&str> = printed.lines().collect();
    assert!(
        lines[0].starts_with("j: roll +0.045") && lines[1].starts_with("j: roll +0.090"),
        "{printed}"
    );
    assert!(
        lines[2].starts_with("e: roll +0.090") && lines[2].contains("height 1.20 m"),
        "{printed}"
    );
    assert_eq!(lines[3], "kestrel> ");
}

#[test]
fn a_wrong_letter_refuses_the_whole_line() {
    let mut c = Cockpit::new();
    c.line(Framing::Qgc, "m");
    c.keys.clear();
    assert_eq!(
        c.line(Framing::Qgc, "jjx"),
        "`x` is no key: nothing done\nkestrel> "
    );
    assert!(c.keys.is_empty());
}

#[test]
fn without_manual_mode_keys_are_ignored_with_a_message() {
    let mut c = Cockpit::new();
    assert_eq!(
        c.line(Framing::Qgc, "jj"),
        "j: ignored: manual mode is off (m switches it on)\nkestrel> "
    );
    assert!(c.keys.is_empty());
    c.line(Framing::Qgc, "");
    c.line(Framing::Qgc, "\u{1B}");
    assert_eq!(
        c.keys,
        [Key::Marker, Key::Escape],
        "ENTER and ESC always count"
    );
}

#[test]
fn a_key_right_behind_the_toggle_counts() {
    let mut c = Cockpit::new();
    c.send(A, 0, b"m\nj\n");
    c.tick();
    assert_eq!(c.keys, [Key::ToggleManual, Key::Roll(Step::Plus)]);
    c.printed(A);
    c.line(Framing::Qgc, "m");
    c.keys.clear();
    c.line(Framing::Qgc, "mjm");
    assert_eq!(
        c.keys,
        [Key::ToggleManual, Key::Roll(Step::Plus), Key::ToggleManual],
        "and in one line"
    );
}

#[test]
fn keys_refused_for_one_reason_say_it_once_a_line() {
    let mut c = Cockpit::new();
    c.line(Framing::Qgc, "m");
    let printed = c.line(Framing::Qgc, "mjjj");
    assert_eq!(printed.matches("refused").count(), 1, "{printed}");
}

#[test]
fn words_ask_for_what_they_say() {
    for (word, request) in [
        ("arm", Request::Arm { force: false }),
        ("disarm", Request::Disarm { force: false }),
        ("takeoff", Request::Takeoff { height_m: None }),
        (
            "takeoff 1.5",
            Request::Takeoff {
                height_m: Some(1.5),
            },
        ),
        (
            "takeoff 99",
            Request::Takeoff {
                height_m: Some(2.2_f32.into()),
            },
        ),
        ("land", Request::SetMode(Mode::Land)),
        ("hold", Request::SetMode(Mode::Hold)),
        ("return", Request::SetMode(Mode::Return)),
    ] {
        for framing in FRAMINGS {
            let mut c = Cockpit::new();
            let printed = c.line(framing, word);
            assert_eq!(c.asked, std::slice::from_ref(&request));
            let name = word.split(' ').next().unwrap();
            assert_eq!(printed, format!("{name}: ok\nkestrel> "));
        }
    }
}

#[test]
fn a_refused_word_says_why() {
    let mut c = Cockpit::new();
    c.send(A, 0, b"arm\n");
    let asked = c.out.asked().remove(0);
    let refused = answer(&asked, Outcome::Refused(Refusal::FcSilent));
    assert!(
        c.console
            .answer(c.now, &refused, &c.bench.ctx(), &mut c.out)
    );
    assert_eq!(
        c.printed(A),
        "arm: refused: flight controller does not answer\nkestrel> "
    );
    assert!(
        !c.console
            .answer(c.now, &refused, &c.bench.ctx(), &mut c.out),
        "not ours any more"
    );
}

#[test]
fn help_and_status_come_in_chunks_and_end_in_the_prompt() {
    let mut c = Cockpit::new();
    assert_eq!(c.line(Framing::Mavsdk, "help"), format!("{HELP}{PROMPT}"));
    let status = c.line(Framing::Qgc, "status");
    assert!(
        status.starts_with("mode Hold, disarmed, on the ground\nx +0.00"),
        "{status}"
    );
    assert_eq!(
        c.line(Framing::Qgc, "fly"),
        "unknown command `fly`: try help\nkestrel> "
    );
    assert_eq!(
        c.line(Framing::Qgc, "takeoff high"),
        "usage: takeoff [height in m]\nkestrel> "
    );
}

#[test]
fn parameters_are_read_and_set_by_name() {
    let mut c = Cockpit::new();
    assert_eq!(
        c.line(Framing::Qgc, "param get mis_takeoff_alt"),
        "MIS_TAKEOFF_ALT = 1 m (default)\nkestrel> "
    );
    assert_eq!(
        c.line(Framing::Qgc, "param set MIS_TAKEOFF_ALT 1.5"),
        "MIS_TAKEOFF_ALT = 1.5\nkestrel> "
    );
    let index = c.bench.settings.index_of("MIS_TAKEOFF_ALT").unwrap() as u16;
    assert_eq!(
        c.asked,
        [Request::SetParam {
            index,
            value: ParamValue::Float(1.5)
        }]
    );
    assert_eq!(
        c.line(Framing::Qgc, "param set MIS_TAKEOF_ALT 1.5"),
        "no parameter `MIS_TAKEOF_ALT`; did you mean `MIS_TAKEOFF_ALT`?\nkestrel> "
    );
    assert_eq!(
        c.line(Framing::Qgc, "param set MIS_TAKEOFF_ALT 99"),
        "MIS_TAKEOFF_ALT = 99 is outside 0.3..=10\nkestrel> "
    );
    assert!(
        c.line(Framing::Qgc, "param get NOPE")
            .starts_with("no parameter `NOPE`")
    );
}

#[test]
fn a_line_may_come_in_pieces_and_nothing_happens_before_enter() {
    let mut c = Cockpit::new();
    for piece in [&b"tak"[..], b"eoff 1", b".5"] {
        c.send(A, 22, piece);
        c.tick();
        assert_eq!((c.printed(A), c.asked.len()), (String::new(), 0));
    }
    c.send(A, 22, b"\r");
    c.send(A, 22, b"\n");
    c.tick();
    assert_eq!(
        c.printed(A),
        "takeoff: ok\nkestrel> ",
        "the pair is one ENTER also when split"
    );
    c.send(A, 22, b"\n");
    c.tick();
    assert_eq!(c.printed(A), "marker\nkestrel> ");
}

#[test]
fn a_half_line_is_dropped_after_ten_seconds() {
    let mut c = Cockpit::new();
    c.send(A, 22, b"disarm");
    c.now += Duration::from_secs(10);
    c.send(A, 22, b"m\n");
    c.tick();
    assert!(c.printed(A).starts_with("m: manual mode on"));
    assert!(c.asked.is_empty());
}

#[test]
fn polls_bring_out_nothing_when_nothing_waits() {
    let mut c = Cockpit::new();
    c.send(B, 22, b"");
    assert_eq!(c.printed(B), "");
    c.line(Framing::Qgc, "m");
    for _ in 0..10 {
        c.send(A, 22, b"");
        c.tick();
    }
    assert_eq!(c.printed(A), "");
}

#[test]
fn a_station_that_asks_for_a_reply_without_multi_gets_all_of_it() {
    // MAVSDK 4.1.0 asks so: RESPOND alone.
    const RESPOND: u8 = 2;
    let mut c = Cockpit::new();
    c.send(A, RESPOND, b"help\n");
    assert_eq!(c.printed(A), format!("{HELP}{PROMPT}"));
    c.tick();
    assert_eq!(c.printed(A), "", "nothing unasked");
}

#[test]
fn two_stations_have_a_console_each() {
    let mut c = Cockpit::new();
    c.send(A, 22, b"ar");
    c.send(B, 22, b"la");
    c.send(A, 22, b"m\n");
    c.tick();
    assert_eq!(
        (c.printed(A), &c.asked[..]),
        (
            "arm: ok\nkestrel> ".to_owned(),
            &[Request::Arm { force: false }][..]
        )
    );
    c.send(B, 22, b"nd\n");
    c.tick();
    assert_eq!(c.printed(B), "land: ok\nkestrel> ");
}

#[test]
fn other_devices_replies_and_overlong_lines_do_nothing() {
    let mut c = Cockpit::new();
    let Message::Raw(M::SERIAL_CONTROL(mut gps)) = control(0, b"arm\n") else {
        unreachable!()
    };
    gps.device = 2;
    c.console.handle(
        c.now,
        A,
        &Message::Raw(M::SERIAL_CONTROL(gps)),
        &c.bench.ctx(),
        &mut c.out,
    );
    c.send(A, REPLY, b"arm\n");
    c.tick();
    assert_eq!((c.printed(A), c.asked.len()), (String::new(), 0));
    let printed = c.line(Framing::Qgc, &"j".repeat(300));
    assert_eq!(
        printed,
        "line longer than 256 bytes: nothing done\nkestrel> "
    );
}

#[test]
fn a_count_beyond_the_payload_is_the_payload() {
    let mut c = Cockpit::new();
    let Message::Raw(M::SERIAL_CONTROL(mut m)) = control(22, &[b' '; CHUNK]) else {
        unreachable!()
    };
    (m.count, m.data[CHUNK - 1]) = (255, b'\n');
    c.console.handle(
        c.now,
        A,
        &Message::Raw(M::SERIAL_CONTROL(m)),
        &c.bench.ctx(),
        &mut c.out,
    );
    c.tick();
    assert_eq!(c.printed(A), "marker\nkestrel> ");
}

#[test]
fn a_vehicle_that_does_not_answer_gives_the_prompt_back() {
    let mut c = Cockpit::new();
    c.send(A, 0, b"arm\n");
    c.out.asked();
    c.now += ANSWER_TIMEOUT;
    c.tick();
    assert_eq!(c.printed(A), "no answer\nkestrel> ");
}

#[test]
fn a_ninth_console_takes_the_place_of_the_one_silent_longest() {
    let mut c = Cockpit::new();
    for system in 1..=9 {
        c.now += Duration::from_millis(1);
        c.send(station(system), 0, b"j");
    }
    assert_eq!(c.console.consoles.len(), MAX_CONSOLES);
    assert!(c.console.consoles.iter().all(|c| c.peer.link != LinkId(1)));
}

proptest! {
    #[test]
    fn no_bytes_and_flags_panic(
        script in proptest::collection::vec(
            (any::<bool>(), any::<u8>(), any::<u8>(), proptest::collection::vec(
                prop_oneof![Just(b'\n'), Just(b'\r'), Just(b'm'), Just(b'j'), Just(0x1B), any::<u8>()], 0..CHUNK)), 0..40)
    ) {
        let mut c = Cockpit::new();
        for (is_a, flags, count, bytes) in script {
            let Message::Raw(M::SERIAL_CONTROL(mut m)) = control(flags, &bytes) else { unreachable!() };
            m.count = if count > 200 { count } else { m.count };
            let from = if is_a { A } else { B };
            c.console.handle(c.now, from, &Message::Raw(M::SERIAL_CONTROL(m)), &c.bench.ctx(), &mut c.out);
            c.tick();
            for m in c.out.messages.drain(..) {
                let Message::Raw(M::SERIAL_CONTROL(reply)) = m.message else { panic!("only SERIAL_CONTROL") };
                prop_assert!(reply.data[..usize::from(reply.count)].is_ascii());
            }
        }
    }
}
