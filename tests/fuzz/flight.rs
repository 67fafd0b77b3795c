//! The flight half behind a flight controller that has gone mad.

use crate::fuzz;
use bridge::autopilot::io::Input;
use core::time::Duration;
use flight_tests::Scenario;
use std::sync::{Mutex, PoisonError};
use vehicle::Timestamp;

fuzz!(
    /// Bytes of a line at the pace of a line: the tick goes on, commands leave within their bounds.
    flight,
    |bytes: &[u8]| {
        // Built once: its tables take longer than a flight of a second.
        static FLIGHT: Mutex<Option<(flight_tests::Flight, Timestamp)>> = Mutex::new(None);
        let mut place = FLIGHT.lock().unwrap_or_else(PoisonError::into_inner);
        let (world, now) =
            place.get_or_insert_with(|| (Scenario::office().start(), Timestamp::ZERO));
        let flight = &mut world.world.flight;
        flight.handle(*now, Input::FcOpened);
        for chunk in bytes.chunks(48) {
            *now += Duration::from_millis(5);
            flight.handle(*now, Input::Fc(chunk.iter().copied().collect()));
            if flight.deadline() <= *now {
                flight.handle(*now, Input::Wake);
            }
            let mut outputs = 0;
            while flight.poll().is_some() {
                outputs += 1;
                assert!(outputs < 10_000, "its outputs have no end");
            }
        }
    }
);
