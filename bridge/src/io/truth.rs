//! `--truth`: what really happened, beside what the estimator believed. The only reader of the simulator's truth.

use crate::autopilot::door::Snapshot;
use sim::Simulator;
use std::fs::File;
use std::io::{self, BufWriter, Write as _};
use std::path::Path;
use vehicle::Timestamp;

/// Columns of the file.
pub const HEADER: &str = "t_s,x,y,z,yaw,contact,est_x,est_y,est_z,est_yaw,localized,roll,pitch";

/// One row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Seconds since start.
    pub t_s: f64,
    /// True position, NED about home, m.
    pub position: [f64; 3],
    /// True yaw, rad.
    pub yaw_rad: f64,
    /// Touching something that is not the floor, or the floor too hard.
    pub contact: bool,
    /// Estimated position, NED about home, m.
    pub est_position: [f64; 3],
    /// Estimated yaw, rad.
    pub est_yaw_rad: f64,
    /// The estimator claims to know the place.
    pub localized: bool,
    /// True roll (right side down) and pitch (nose up), rad.
    pub tilt_rad: [f64; 2],
}

impl Row {
    /// Truth of a vehicle beside its estimate.
    #[must_use]
    pub fn take(
        now: Timestamp,
        simulator: &Simulator,
        vehicle: usize,
        snapshot: &Snapshot,
    ) -> Self {
        let truth = simulator.truth(vehicle);
        let (roll, pitch, yaw_rad) = truth.attitude.roll_pitch_yaw();
        Self {
            t_s: now.s(),
            position: truth.position.into(),
            yaw_rad,
            contact: truth.in_contact,
            est_position: snapshot.nav.position.into(),
            est_yaw_rad: snapshot.nav.yaw_rad(),
            localized: snapshot.nav.health.position,
            tilt_rad: [roll, pitch],
        }
    }
}

/// Writes the CSV.
#[derive(Debug)]
pub struct TruthFile {
    out: BufWriter<File>,
}

impl TruthFile {
    /// A fresh file with its header.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: &Path) -> io::Result<Self> {
        let mut out = BufWriter::new(File::create(path)?);
        writeln!(out, "{HEADER}")?;
        Ok(Self { out })
    }

    /// Appends a row.
    ///
    /// # Errors
    /// The disk says no.
    pub fn write(&mut self, r: &Row) -> io::Result<()> {
        let ([x, y, z], [ex, ey, ez]) = (r.position, r.est_position);
        let [roll, pitch] = r.tilt_rad;
        writeln!(
            self.out,
            "{:.3},{x:.4},{y:.4},{z:.4},{:.5},{},{ex:.4},{ey:.4},{ez:.4},{:.5},{},{roll:.5},{pitch:.5}",
            r.t_s,
            r.yaw_rad,
            u8::from(r.contact),
            r.est_yaw_rad,
            u8::from(r.localized),
        )
    }

    /// Writes what is buffered.
    ///
    /// # Errors
    /// The disk says no.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
