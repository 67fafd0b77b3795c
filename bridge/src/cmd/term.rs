//! What people see on the terminal.

use bridge::autopilot::door::{LandedState, Snapshot};
use bridge::autopilot::ground::Ground;
use bridge::autopilot::mode::Because;
use std::io::{IsTerminal as _, Write as _, stderr, stdout};
use vehicle::{LocalizationState, Timestamp};

const RED: &str = "\x1b[31m";
const GREEN: &str = "\x1b[32m";
const YELLOW: &str = "\x1b[33m";
const BOLD: &str = "\x1b[1m";
const DIM: &str = "\x1b[2m";
const PLAIN: &str = "\x1b[0m";

/// One line of complaint.
pub(crate) fn complain(text: &str) {
    let mut out = stderr().lock();
    // A closed terminal is no reason to fail differently.
    let _ = if stderr().is_terminal() {
        writeln!(out, "{BOLD}{RED}error:{PLAIN} {text}")
    } else {
        writeln!(out, "error: {text}")
    };
}

/// One line of warning.
pub(crate) fn warn(text: &str) {
    let mut out = stderr().lock();
    let _ = if stderr().is_terminal() {
        writeln!(out, "{BOLD}warning:{PLAIN} {text}")
    } else {
        writeln!(out, "warning: {text}")
    };
}

/// A terminal, or a pipe that gets the same words without colours and without overwriting.
#[derive(Debug)]
pub(crate) struct Terminal {
    is_terminal: bool,
    is_quiet: bool,
    status_shown: bool,
    plain_lines: u32,
}

impl Terminal {
    /// The program's standard output.
    pub(crate) fn new(is_quiet: bool) -> Self {
        Self {
            is_terminal: stdout().is_terminal(),
            is_quiet,
            status_shown: false,
            plain_lines: 0,
        }
    }

    /// A line that stays.
    pub(crate) fn line(&mut self, text: &str) {
        if self.is_quiet {
            return;
        }
        let mut out = stdout().lock();
        let clear = if self.status_shown { "\r\x1b[2K" } else { "" };
        self.status_shown = false;
        let _ = writeln!(out, "{clear}{text}");
    }

    /// What pilots were told since the last look.
    pub(crate) fn texts(&mut self, ground: &Ground, seen: &mut Timestamp) {
        let fresh: Vec<String> = ground
            .texts()
            .filter(|t| t.at > *seen)
            .map(|t| format!("  [{:8.2}] {}", t.at.s(), t.text))
            .collect();
        if let Some(last) = ground.texts().map(|t| t.at).max() {
            *seen = last.max(*seen);
        }
        for line in fresh {
            self.line(&line);
        }
    }

    /// The live status line: overwritten on a terminal, once in a while in a pipe.
    pub(crate) fn status(&mut self, s: &Snapshot, links: usize) {
        if self.is_quiet {
            return;
        }
        let text = self.status_text(s, links);
        let mut out = stdout().lock();
        if self.is_terminal {
            let _ = write!(out, "\r\x1b[2K{text}");
            let _ = out.flush();
            self.status_shown = true;
        } else {
            if self.plain_lines.is_multiple_of(10) {
                let _ = writeln!(out, "{text}");
                let _ = out.flush();
            }
            self.plain_lines = self.plain_lines.wrapping_add(1);
        }
    }

    /// Ends the status line.
    pub(crate) fn finish(&mut self) {
        if self.status_shown {
            let _ = writeln!(stdout());
            self.status_shown = false;
        }
    }

    fn paint(&self, colour: &str, text: &str) -> String {
        if self.is_terminal {
            format!("{colour}{text}{PLAIN}")
        } else {
            text.to_owned()
        }
    }

    fn status_text(&self, s: &Snapshot, links: usize) -> String {
        let mode = match s.mode.because {
            Because::Asked | Because::Finished => self.paint(BOLD, s.mode.mode.name()),
            because => self.paint(
                RED,
                &format!("{} ({})", s.mode.mode.name(), because.words()),
            ),
        };
        let armed = match (s.is_armed, &s.arm_blocked_by) {
            (true, _) => self.paint(YELLOW, "ARMED"),
            (false, None) => self.paint(GREEN, "ready"),
            (false, Some(why)) => self.paint(DIM, &format!("not ready: {why}")),
        };
        let where_ = match s.landed {
            LandedState::OnGround => "on ground",
            LandedState::InAir => "in air",
            LandedState::TakingOff => "taking off",
            LandedState::Landing => "landing",
        };
        let battery = s.battery.map_or_else(
            || "battery ?".to_owned(),
            |b| {
                let left = b
                    .remaining
                    .map_or_else(String::new, |r| format!(" {:.0} %", r * 100.0));
                format!("{:.1} V{left}", b.voltage_v)
            },
        );
        let p = s.nav.position;
        let place = match s.nav.localization.state {
            LocalizationState::Localized => self.paint(
                GREEN,
                &format!("localized {:.0} %", s.nav.localization.mass * 100.0),
            ),
            LocalizationState::Searching => self.paint(YELLOW, "searching"),
            LocalizationState::Lost => self.paint(RED, "lost"),
            LocalizationState::Off => self.paint(DIM, "no ranges"),
        };
        format!(
            "{mode} | {armed} | {where_} | N {:+.2} E {:+.2} up {:.2} m | {place} | {battery} | FC {:.0}/s | {links} link{}",
            p.x(),
            p.y(),
            -p.z(),
            s.fc.service_rate_hz,
            if links == 1 { "" } else { "s" },
        )
    }
}
