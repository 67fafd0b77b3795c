//! Nothing allocates in flight: neither the decoder nor the client, once it is online.

#![allow(clippy::disallowed_methods, reason = "a test is no core")]
#![allow(
    dead_code,
    unreachable_pub,
    missing_docs,
    reason = "shared with other tests"
)]

mod line;

use line::{Controller, Kind};
use msp::Client;
use msp::client::Config;
use msp::frame::{Accept, Decoder};

/// Serves whatever was sent, on the spot; the bytes of the controller are made outside of what is counted.
fn exchange(client: &mut Client, controller: &mut Controller, now_us: u64) -> u64 {
    let mut counted = 0;
    for _ in 0..4 {
        let mut sent = [[0; 256]; 4];
        let mut lengths = [0; 4];
        counted += allocation_counter::measure(|| {
            for (place, length) in sent.iter_mut().zip(&mut lengths) {
                if let Some(bytes) = client.poll_transmit(now_us) {
                    place[..bytes.len()].copy_from_slice(bytes);
                    *length = bytes.len();
                }
            }
        })
        .count_total;
        for (bytes, length) in sent.iter().zip(lengths) {
            controller.server.handle(&bytes[..length]);
        }
        controller.run_us = now_us;
        let reply = controller.run();
        counted += allocation_counter::measure(|| {
            client.handle(now_us, &reply);
            while client.poll_event().is_some() {}
        })
        .count_total;
    }
    counted
}

#[test]
fn a_client_in_flight_allocates_nothing() {
    for kind in [Kind::Betaflight, Kind::Inav] {
        let mut client = Client::new(Config::default());
        let mut controller = Controller::new(kind, 1_000);
        client.connect(0);
        let mut counted = 0;
        for step in 0..20_000_u64 {
            let now_us = step * 1_000;
            if step % 25 == 0 {
                counted +=
                    allocation_counter::measure(|| client.set_rc(now_us, &[1500; 8])).count_total;
            }
            let more = exchange(&mut client, &mut controller, now_us);
            // Identification is no flight, though it should not allocate either.
            counted += more;
        }
        assert!(client.is_online(), "{kind:?}");
        assert!(
            client.statistics().replies > 15_000,
            "{:?}",
            client.statistics()
        );
        assert_eq!(counted, 0, "{kind:?}");
    }
}

#[test]
fn a_decoder_allocates_nothing_on_frames_noise_and_bad_frames() {
    let mut decoder = Decoder::new(Accept::Any);
    let line: Vec<u8> = [
        &b"$M>\x06\x6c\x85\xff\x2d\x00\x0e\x01\x32"[..],
        b"noise $M>",
        b"$M>\x06\x6c\x85\xff\x2d\x00\x0e\x01\x33",
        b"$X>\x00\x6c\x00\x06\x00\x85\xff\x2d\x00\x0e\x01\xfb",
    ]
    .concat()
    .repeat(100);
    // A cut frame swallows what follows until its length is full.
    let line = [line, vec![0; 64]].concat();
    let mut frames = 0;
    let counted = allocation_counter::measure(|| {
        for mut piece in line.chunks(7) {
            while decoder.decode(&mut piece).is_some() {
                frames += 1;
            }
        }
    });
    assert_eq!((counted.count_total, frames), (0, 200));
}
