//! Keys that come by SETUP_SIGNING.

use super::*;
use crate::gcs::signing;
use mavlink_dialect::signing::{SigningKey, SigningState};

const HERE: LinkId = LinkId::of(0, 1);
const FAR: LinkId = LinkId::of(0, 2).remote();
const LINE: LinkId = LinkId::of(1, 3);
const KEY: [u8; 32] = [9; 32];

/// A link on this machine, one from another machine, a serial line.
fn bench() -> Bench {
    let mut bench = Bench::new();
    let serial = LinkPolicy {
        url: "serial:///dev/ttyACM0?baudrate=115200".to_owned(),
        ..LinkPolicy::default()
    };
    bench
        .ground
        .set_policies(vec![LinkPolicy::default(), serial]);
    for link in [HERE, FAR, LINE] {
        bench.link_up(link);
    }
    bench
}

fn setup(secret_key: [u8; 32], initial_timestamp: u64) -> Message {
    Std::SETUP_SIGNING(standard::SETUP_SIGNING_DATA {
        initial_timestamp,
        target_system: 1,
        target_component: 1,
        secret_key,
    })
    .into()
}

fn arm() -> Message {
    Raw::COMMAND_LONG(raw::COMMAND_LONG_DATA {
        command: 400,
        param1: 1.0,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    })
    .into()
}

/// A station that signs.
struct Signer {
    encoder: Encoder,
    key: SigningKey,
    state: SigningState,
}

impl Signer {
    fn new(system: u8, key: [u8; 32]) -> Self {
        let mut state = SigningState::new(0);
        state.set_utc(1_800_000_000_000_000);
        Self {
            encoder: Encoder::new(Address {
                system,
                component: 190,
            }),
            key: SigningKey::new(key),
            state,
        }
    }

    fn sign(&mut self, message: &Message) -> FrameBytes {
        let stamp = self.state.stamp();
        self.encoder.encode_signed(message, &self.key, 0, stamp)
    }
}

/// How many requests to the vehicle these bytes cause.
fn asks(bench: &mut Bench, link: LinkId, bytes: &[u8]) -> usize {
    bench.requests.clear();
    bench.ground.receive(bench.now, link, bytes, true);
    bench.collect();
    bench.requests.len()
}

fn key_document(bench: &Bench) -> Option<&Document> {
    let named = |d: &&Document| d.name == signing::KEY_DOCUMENT;
    bench.documents.iter().rev().find(named)
}

fn has_said(bench: &Bench, words: &str) -> bool {
    bench.ground.texts().any(|t| t.text.contains(words))
}

#[test]
fn a_key_given_on_this_machine_is_kept_and_others_must_sign_with_it() {
    let mut bench = bench();
    assert_eq!(bench.ground.access.role(FAR), Role::Viewer);
    bench.say_on(HERE, setup(KEY, 0));
    assert!(has_said(&bench, "Signing key stored"));
    let kept = key_document(&bench).cloned().unwrap();
    assert_eq!(kept.bytes, ("09".repeat(32) + "\n").into_bytes());

    let (mut friend, mut thief) = (Signer::new(250, KEY), Signer::new(251, [8; 32]));
    let mut plain = Encoder::new(Address {
        system: 252,
        component: 190,
    });
    for link in [FAR, LINE] {
        let unsigned = plain.encode_message(&arm());
        assert_eq!(asks(&mut bench, link, &unsigned), 0, "unsigned");
        let foreign = thief.sign(&arm());
        assert_eq!(asks(&mut bench, link, &foreign), 0, "another key");
    }
    let good = friend.sign(&arm());
    assert_eq!(asks(&mut bench, FAR, &good), 1, "who knows the key flies");
    assert_eq!(asks(&mut bench, FAR, &good), 0, "but not twice");
    let unsigned = plain.encode_message(&arm());
    assert_eq!(asks(&mut bench, HERE, &unsigned), 1, "this machine may");
    bench.heard.clear();
    bench.run_for(2_000);
    for link in [HERE, FAR, LINE] {
        assert!(bench.on(link).count() > 5);
        assert!(bench.on(link).all(|f| f.is_signed), "{link:?}");
    }

    // The next start has it too.
    let mut again = Ground::new(GroundConfig {
        us: US,
        settings: Settings::default(),
        anchor: MapAnchor::new(2.0, 2.0, 1.0),
        plan: Arc::new(FloorPlan::from_cells(4, 1.0, [0.0, 0.0], vec![Cell::Free; 16]).unwrap()),
        airframe: Airframe::default(),
        boot_utc_us: 1_000_000_000_000_000,
        documents: vec![kept],
    });
    again.set_policies(vec![LinkPolicy::default()]);
    assert!(again.has_given_key() && again.access.role(FAR) == Role::Engineer);

    // All zeros take it away.
    bench.say_on(HERE, setup([0; 32], 0));
    assert_eq!(key_document(&bench).unwrap().bytes, b"");
    assert_eq!(bench.ground.access.role(FAR), Role::Viewer);
    bench.heard.clear();
    bench.run_for(2_000);
    assert!(bench.on(FAR).all(|f| !f.is_signed));
}

#[test]
fn a_key_is_refused_with_the_reason_wherever_somebody_could_listen() {
    for (link, radio, is_armed, stamp, why) in [
        (FAR, false, false, 0, "only from this machine or over USB"),
        (LINE, true, false, 0, "not over a radio"),
        (HERE, false, true, 0, "disarm first"),
        (HERE, false, false, u64::MAX, "decades ahead"),
    ] {
        let mut bench = bench();
        if radio {
            bench.say_on(link, Std::RADIO_STATUS(Default::default()));
        }
        let snapshot = Snapshot {
            is_armed,
            ..Snapshot::default()
        };
        bench.ground.snapshot(bench.now, &snapshot);
        bench.say_on(link, setup(KEY, stamp));
        assert!(has_said(&bench, why), "{why}");
        assert_eq!(key_document(&bench), None, "{why}");
        assert!(!bench.ground.has_given_key());
    }
    // A line without a radio is as good as this machine.
    let mut bench = bench();
    bench.say_on(LINE, setup(KEY, 0));
    assert!(bench.ground.has_given_key());
}
