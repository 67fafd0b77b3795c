//! GPIO lines of ultrasonic rangers: trigger pulses out, edges in, stamped by the kernel.

use gpiocdev::Request;
use gpiocdev::line::{EdgeDetection, EdgeKind, EventClock, Value};
use std::io;
use std::time::Duration;

/// Length of a trigger pulse at least.
const PULSE: Duration = Duration::from_micros(12);
/// Edges that the kernel keeps for us: more than a slot of all sensors has.
const KEPT: u32 = 256;

/// An edge of an echo line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Line of the chip.
    pub line: u32,
    /// CLOCK_MONOTONIC, ns, when the interrupt came.
    pub at_ns: u64,
    /// Upwards.
    pub is_rising: bool,
}

/// The lines of a ring.
#[derive(Debug)]
pub struct Lines {
    triggers: Request,
    echoes: Request,
}

impl Lines {
    /// Takes the lines of a chip: pairs of trigger and echo.
    ///
    /// # Errors
    /// No such chip or line, or somebody has it.
    pub fn open(chip: &str, pins: &[[u32; 2]]) -> io::Result<Self> {
        let failed = |e: gpiocdev::Error| {
            io::Error::other(format!(
                "{e}: check the chip, the lines and that you may open it (group gpio)"
            ))
        };
        let triggers: Vec<u32> = pins.iter().map(|p| p[0]).collect();
        let echoes: Vec<u32> = pins.iter().map(|p| p[1]).collect();
        Ok(Self {
            triggers: Request::builder()
                .on_chip(chip)
                .with_consumer("kestrel")
                .with_lines(&triggers)
                .as_output(Value::Inactive)
                .request()
                .map_err(failed)?,
            echoes: Request::builder()
                .on_chip(chip)
                .with_consumer("kestrel")
                .with_kernel_event_buffer_size(KEPT)
                .with_lines(&echoes)
                .with_edge_detection(EdgeDetection::BothEdges)
                .with_event_clock(EventClock::Monotonic)
                .request()
                .map_err(failed)?,
        })
    }

    /// Triggers some sensors, together.
    ///
    /// # Errors
    /// The chip is gone.
    pub fn pulse(&self, lines: impl Iterator<Item = u32> + Clone) -> io::Result<()> {
        for line in lines.clone() {
            self.triggers
                .set_value(line, Value::Active)
                .map_err(io::Error::other)?;
        }
        super::clock::sleep(PULSE);
        for line in lines {
            self.triggers
                .set_value(line, Value::Inactive)
                .map_err(io::Error::other)?;
        }
        Ok(())
    }

    /// The next edge, waiting for it this long at most.
    ///
    /// # Errors
    /// The chip is gone.
    pub fn edge(&self, wait: Duration) -> io::Result<Option<Edge>> {
        if !self
            .echoes
            .wait_edge_event(wait)
            .map_err(io::Error::other)?
        {
            return Ok(None);
        }
        let event = self.echoes.read_edge_event().map_err(io::Error::other)?;
        Ok(Some(Edge {
            line: event.offset,
            at_ns: event.timestamp_ns,
            is_rising: event.kind == EdgeKind::Rising,
        }))
    }
}
