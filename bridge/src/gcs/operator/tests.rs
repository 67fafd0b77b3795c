use super::super::bench::{Bench, station};
use super::*;
use proptest::prelude::*;

fn bench(policy: ControlPolicy) -> Bench {
    let mut bench = Bench::default();
    bench.settings.ground.control_policy = policy;
    bench.snapshot.is_armed = true;
    bench
}

fn request(action: u8, takeover: u8) -> Message {
    raw::MavMessage::COMMAND_LONG(raw::COMMAND_LONG_DATA {
        command: cmd::REQUEST_OPERATOR_CONTROL,
        param1: f32::from(action),
        param2: f32::from(takeover),
        ..Default::default()
    })
    .into()
}

struct Table {
    bench: Bench,
    control: OperatorControl,
    out: Outbox,
    now: Timestamp,
}

impl Table {
    fn new(policy: ControlPolicy) -> Self {
        Self {
            bench: bench(policy),
            control: OperatorControl::new(),
            out: Outbox::default(),
            now: Timestamp::ZERO,
        }
    }

    fn ask(&mut self, system: u8, action: u8, takeover: u8) -> u8 {
        self.out = Outbox::default();
        let message = request(action, takeover);
        assert!(
            self.control
                .handle(self.now, station(system), &message, &mut self.out)
        );
        let acks: Vec<u8> = self
            .out
            .messages
            .iter()
            .filter_map(|m| match &m.message {
                Message::Raw(raw::MavMessage::COMMAND_ACK(a)) => Some(a.result),
                _ => None,
            })
            .collect();
        assert_eq!(acks.len(), 1);
        acks[0]
    }

    fn may(&self, system: u8) -> bool {
        self.control.admits(station(system), &self.bench.ctx())
    }

    fn beat(&mut self, system: u8) {
        let beat = Message::Raw(raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA::default()));
        self.control
            .handle(self.now, station(system), &beat, &mut self.out);
    }

    fn tick(&mut self, ms: u64) {
        self.now += Duration::from_millis(ms);
        let ctx = self.bench.ctx();
        self.control.tick(self.now, &ctx, &mut self.out);
    }
}

#[test]
fn open_control_hinders_nobody_until_somebody_asks_for_it() {
    let mut t = Table::new(ControlPolicy::Open);
    assert!(t.may(245) && t.may(246));
    assert_eq!(t.ask(245, 1, 0), result::ACCEPTED);
    assert!(t.may(245) && !t.may(246));
    assert_eq!(t.ask(246, 1, 0), result::FAILED, "the owner is asked");
    assert_eq!(t.control.main_system(), 245);
    assert_eq!(t.ask(245, 0, 0), result::ACCEPTED);
    assert!(!t.may(245) && t.may(246), "who waited has it now");
    t.tick(3_100);
    assert!(t.may(245) && t.may(246), "a silent owner is none");
}

#[test]
fn who_speaks_with_the_owners_number_from_another_link_is_somebody_else() {
    let mut t = Table::new(ControlPolicy::Exclusive);
    t.ask(245, 1, 0);
    let elsewhere = Peer {
        link: LinkId::of(7, 7),
        ..station(245)
    };
    assert!(!t.control.admits(elsewhere, &t.bench.ctx()));
}

#[test]
fn a_link_that_goes_down_frees_control_centres_the_sticks_and_ends_the_lease() {
    let mut t = Table::new(ControlPolicy::Exclusive);
    t.ask(245, 1, 0);
    let before = t.control.control();
    t.out = Outbox::default();
    t.control.link_down(station(245).link);
    t.tick(100);
    let after = t.control.control();
    assert_eq!(after.owner, None);
    assert!(after.lease > before.lease);
    let centred = t.out.requests.iter().any(|asked| {
        matches!(asked.request, Request::Manual(m) if m.forward == Some(0.0) && m.throttle == Some(0.5))
    });
    assert!(centred);
}

#[test]
fn exclusive_control_is_asked_for_kept_and_given_back() {
    let mut t = Table::new(ControlPolicy::Exclusive);
    assert!(!t.may(245), "nobody commands before they ask");
    assert_eq!(t.ask(245, 1, 0), result::ACCEPTED);
    assert!(t.may(245) && !t.may(246));
    assert_eq!(t.ask(246, 0, 0), result::ACCEPTED);
    assert!(t.may(245), "nobody gives back what is another's");
    assert_eq!(t.ask(245, 0, 0), result::ACCEPTED);
    assert!(!t.may(245));
}

#[test]
fn an_owner_is_asked_and_grants_by_allowing() {
    let mut t = Table::new(ControlPolicy::Exclusive);
    t.ask(245, 1, 0);
    assert_eq!(t.ask(246, 1, 1), result::FAILED);
    let passed_on = t.out.messages.iter().any(|m| {
        matches!(&m.message, Message::Raw(raw::MavMessage::COMMAND_LONG(c))
            if c.target_system == 245 && c.command == cmd::REQUEST_OPERATOR_CONTROL && c.param4 > 245.5)
    });
    assert!(passed_on);
    assert!(t.may(245));
    assert_eq!(t.ask(245, 1, 1), result::ACCEPTED);
    assert!(t.may(246) && !t.may(245));
    // 246 allows takeover: it is taken at once.
    assert_eq!(t.ask(245, 1, 0), result::ACCEPTED);
    assert!(t.may(245));
}

#[test]
fn an_owner_that_does_not_answer_keeps_control_and_a_silent_one_loses_it() {
    let mut t = Table::new(ControlPolicy::Exclusive);
    t.ask(245, 1, 0);
    t.ask(246, 1, 0);
    for _ in 0..11 {
        t.tick(1_000);
        t.beat(245);
    }
    assert_eq!(t.ask(245, 0, 0), result::ACCEPTED);
    assert!(!t.may(246), "its time was over");
    t.ask(245, 1, 0);
    t.tick(2_900);
    assert!(t.may(245));
    t.tick(200);
    assert!(!t.may(245));
    let ctx = t.bench.ctx();
    assert!(
        !t.control.counts_as_presence(station(246), &ctx),
        "the ground is lost though another watches"
    );
    assert_eq!(t.ask(246, 1, 0), result::ACCEPTED);
    let ctx = t.bench.ctx();
    assert!(t.control.counts_as_presence(station(246), &ctx));
}

#[test]
fn nobody_asks_in_the_name_of_another() {
    let mut t = Table::new(ControlPolicy::Exclusive);
    let forged = raw::COMMAND_LONG_DATA {
        command: cmd::REQUEST_OPERATOR_CONTROL,
        param1: 1.0,
        param4: 77.0,
        ..Default::default()
    };
    let message = raw::MavMessage::COMMAND_LONG(forged).into();
    t.control.handle(t.now, station(245), &message, &mut t.out);
    assert_eq!(t.control.main_system(), 0);
}

proptest! {
    #[test]
    fn at_most_one_station_commands(steps in prop::collection::vec((245u8..249, 0u8..3, 0u8..2, 0u64..4_000), 0..60)) {
        let mut t = Table::new(ControlPolicy::Exclusive);
        for (system, action, takeover, ms) in steps {
            if action < 2 {
                t.ask(system, action, takeover);
            } else {
                t.beat(system);
            }
            t.tick(ms);
            prop_assert!((245..249).filter(|s| t.may(*s)).count() <= 1);
        }
    }

    /// The lock's automaton after every single event: exactly one owner or none, whom alone it lets through; each ownership has
    /// a number of its own; nobody loses control against his will who is there and did not allow it.
    #[test]
    fn one_owner_at_every_instant_and_each_ownership_has_its_own_lease(
        is_open in any::<bool>(),
        steps in prop::collection::vec((0usize..4, 0u8..6, 0u64..1_200), 0..120),
    ) {
        let policy = if is_open { ControlPolicy::Open } else { ControlPolicy::Exclusive };
        let mut t = Table::new(policy);
        // Three stations, and one that has the number of the first on another link.
        let at = |link: u32, system| Peer { link: LinkId::of(1, link), ..station(system) };
        let peers = [at(1, 245), at(2, 246), at(3, 247), at(4, 245)];
        let (mut heard, mut allows) = ([Timestamp::ZERO; 4], false);
        let mut leases = std::collections::BTreeSet::from([0]);
        let mut before = t.control.control();
        for (who, what, ms) in steps {
            let mut is_gone = false;
            match what {
                0..=2 => {
                    // Gives back, asks, asks and lets anybody take over.
                    let message = request(u8::from(what > 0), u8::from(what == 2));
                    t.control.handle(t.now, peers[who], &message, &mut t.out);
                }
                3 | 4 => {
                    let beat = Message::Raw(raw::MavMessage::HEARTBEAT(raw::HEARTBEAT_DATA::default()));
                    t.control.handle(t.now, peers[who], &beat, &mut t.out);
                    heard[who] = t.now;
                }
                _ => {
                    t.control.link_down(peers[who].link);
                    is_gone = before.owner.is_some_and(|(link, _)| link == peers[who].link);
                    t.tick(0);
                }
            }
            for (event, silent) in [(true, false), (false, true)] {
                if silent {
                    t.tick(ms);
                }
                let now = t.control.control();
                let admitted: Vec<usize> = (0..4).filter(|i| t.control.admits(peers[*i], &t.bench.ctx())).collect();
                let owner = now.owner.map(|(link, _)| (0..4).find(|i| peers[*i].link == link).unwrap());
                match owner {
                    Some(owner) => prop_assert_eq!(admitted, vec![owner]),
                    None => prop_assert_eq!(admitted.len(), if is_open { 4 } else { 0 }),
                }
                prop_assert_eq!(t.control.main_system(), now.owner.map_or(0, |(_, system)| system));
                if now.owner != before.owner {
                    prop_assert!(now.lease > before.lease && leases.insert(now.lease), "{} again", now.lease);
                    if let Some((link, _)) = before.owner {
                        let owner = (0..4).find(|i| peers[*i].link == link).unwrap();
                        let is_own_word = event && owner == who && what <= 2;
                        let was_silent = t.now.since(heard[owner]) >= OWNER_SILENT;
                        prop_assert!(is_own_word || allows || is_gone || was_silent, "{owner} lost it");
                    }
                } else {
                    prop_assert!(now.lease == before.lease || now.owner.is_some());
                }
                // Asking is being heard.
                if event && (1..=2).contains(&what) && now.owner.map(|(link, _)| link) == Some(peers[who].link) {
                    heard[who] = t.now;
                }
                // Who waited and is granted is heard in that moment.
                if now.owner != before.owner && let Some(owner) = owner {
                    heard[owner] = t.now;
                }
                allows = now.is_open;
                before = now;
            }
        }
    }
}
