//! `docs/failsafe.md`, written from the table that flies, so that it says what happens.

use super::failsafes::TABLE;
use std::fmt::Write as _;

const HEAD: &str = "# Failsafes

Written by `kestrel params --failsafes`; a test compares it with the program.

What happens by itself when something fails. Every row that acts is told as STATUSTEXT (`Failsafe: ...: Mode`) and shows in the heartbeat's
mode; when its cause is gone that is told too, and the mode stays until somebody asks for another. Rows that only tell say `Warning: ...`.

## What Kestrel does

The first row whose condition holds decides. A mode is never replaced by a less careful one (Land, Return, Hold, the others).

| When | What Kestrel does | It says | Set by | Keeps from arming | Flown by the test |
| --- | --- | --- | --- | --- | --- |
";

const REST: &str = "
Where a row ends in Land, the descent is vertical, by the height sensors that still speak, with the motors stopped after touch-down.

## What the ground side, the shell and people do

| When | What happens | Test |
| --- | --- | --- |
| the way leads out of the fence | `GF_ACTION`: Hold by default, before the border | `files.fence_stops_the_vehicle_and_outlives_the_program` |
| STOP (any station) | Hold; again within 3 s: Land | `stop_holds_and_stop_again_lands` |
| first Ctrl-C, SIGTERM, SIGHUP | Land, logging goes on until it is down; then the program ends | `shutting_down_in_flight_lands_first` |
| second one | the motors stop at once, wherever it is, and the program ends (beside a radio the pilot's switch decides) | `deployment.the_second_ctrl_c_stops_the_motors` |
| a thread of links, logs, web or video panics or hangs | the flight thread goes on; links that are gone are a lost ground station | `a_lost_ground_station_lands_the_vehicle` |
| the flight thread panics or never comes back | the keeper, a thread of its own with the line, sends sticks level and 95 % of the hover throttle for 1.5 s, then falls silent: the flight controller's own failsafe (below), set by `kestrel fc provision` | `a_flight_thread_that_never_comes_back_is_brought_down_without_it` |

## When Kestrel itself is late

The flight controller needs an RC frame every 0.15 s. What keeps them coming, and what ends them:

| Held up for | What | What happens |
| --- | --- | --- |
| up to 0.1 s | anything | nothing: the receiver bridges it; missed beats are counted (SYS_STATUS `errors_count3`, `missed`) |
| 0.1 s to 1.5 s | the flight loop | the keeper, a thread of its own, sends sticks level and 95 % of the hover throttle 25 times a second: the vehicle sinks slowly. From 0.3 s on the first tick that runs again lands |
| longer than 1.5 s | the flight loop | the keeper falls silent on purpose: the flight controller's own failsafe decides (below) |
| up to 0.3 s | the whole program (stopped process, stalled host) | Betaflight holds the last sticks: flying goes on |
| longer than 0.3 s | the whole program, Betaflight provisioned by `kestrel fc provision` | sticks centre and the throttle holds until stage 2 (1.5 s, then the motors stop): it stays up; when the program comes back it lands |
| longer than 0.3 s | the whole program, Betaflight as delivered | the motors idle 0.30 s after the last frame: **the vehicle falls**. If the program comes back in the air it lands. From 1 m a stop of 0.6 s ends on the floor |

Measured in the simulator (hover at 1 m, `tests/flights/failsafe.rs`): flight loop held 0.20 s: flies on in the same mode; held 0.60 s:
sinks by up to 0.3 m, then lands; program frozen 0.20 s: flies on; frozen 0.60 s: falls as delivered; provisioned it stays up, frozen
1.2 s too, and falls when frozen 2.5 s.

A reply that lay in the kernel meanwhile is dated back to when it was asked for, so the estimate does not take an old attitude for a new one.

## What the flight controller does without RC frames

As delivered; measured on Betaflight 4.6 and INAV 9, read in the sources of the others.

| | last sticks hold | then | at last |
| --- | --- | --- | --- |
| Betaflight | 0.30 s (flagged RX_FAILSAFE after 0.15 s) | motors idle, switches hold: it falls | 1.5 s: disarmed (procedure DROP); the arm switch must be seen low |
| INAV | 0.8 s (0.2 s receiver and 0.5 s delay) | its procedure: LAND | as configured |
| Cleanflight 1.x | 0.3 s | sticks centred, throttle down | 1.0 s: its procedure |
| MultiWii 2.x | about 1 s | back to the real receiver | - |

Beside a pilot's radio (`KST_RADIO`) all this is the radio's business: our override ends 0.3 s (Betaflight 2025.12 and later) or 0.7 s
(INAV) after our last frame, and his sticks count. Betaflight 4.6 and older keep our last frame for as long as his switch is on: there the
switch is the way out. The keeper does not speak beside a radio.

## The pilot's switch

| He | What happens |
| --- | --- |
| switches MSP OVERRIDE off | his sticks count from the next frame of his radio on; Kestrel shows mode Stabilized, says `Pilot took over` within 0.2 s, repeats his sticks so that none of its own is left in the controller, and its loops rest. None of the rows above acts |
| switches it on | nothing yet: Kestrel sends no frame until a station asks for a mode, a take-off or a place |
| is asked | the sticks leave his in steps of 4 % a frame for a second |

## Where there is no failsafe

- No row looks at the motors: a lost motor is the flight controller's.
- While a pilot steers, batteries and walls are his.
- MSP has no authentication: whoever holds the wire flies.
";

/// The page.
#[must_use]
pub fn page() -> String {
    let mut out = String::from(HEAD);
    for row in &TABLE {
        let params: Vec<String> = row.params.iter().map(|p| format!("`{p}`")).collect();
        let _ = writeln!(
            out,
            "| {} | {} | {} | {} | {} | `{}` |",
            row.doc,
            row.does,
            row.because.words(),
            params.join(" "),
            if row.refuses_arming { "yes" } else { "" },
            row.test,
        );
    }
    out.push_str(REST);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::failsafes::{FC_SILENT_S, LOOP_HELD_S};

    #[test]
    fn the_sentences_of_the_table_carry_the_numbers_of_the_program() {
        let page = page();
        assert!(page.contains(&format!("silent for {FC_SILENT_S} s")));
        assert!(page.contains(&format!("more than {LOOP_HELD_S} s in the air")));
    }

    #[test]
    fn the_page_in_the_documentation_is_this_one() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/failsafe.md");
        let kept = std::fs::read_to_string(path).unwrap_or_default();
        assert_eq!(
            kept,
            page(),
            "run `kestrel params --failsafes > docs/failsafe.md`"
        );
    }
}
