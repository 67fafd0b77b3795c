//! MSP_SIMULATOR: INAV, on hardware or as a program, with sensors from outside. One request carries the
//! true state, its reply what the controller would do.

use super::Message;
use crate::command;
use crate::wire::{ParseError, Reader, Wire};
use arrayvec::ArrayVec;

/// Version of the layout, the only one INAV 9 takes.
pub const VERSION: u8 = 2;

/// Bits of [`SimulatorRequest::flags`].
pub mod flag {
    /// Simulation on; a request without it ends the simulation.
    pub const ENABLE: u8 = 0x01;
    /// The firmware's own estimator turns the IMU into an attitude.
    pub const USE_IMU: u8 = 0x08;
    /// The GPS fields are new.
    pub const NEW_GPS: u8 = 0x10;
    /// A battery voltage follows.
    pub const BATTERY: u8 = 0x20;
    /// An air speed follows.
    pub const AIRSPEED: u8 = 0x40;
}

/// State of the simulated vehicle. Axes as in [`super::sensor`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct SimulatorRequest {
    /// [`VERSION`].
    pub version: u8,
    /// Bits of [`flag`]. `BATTERY` and `AIRSPEED` must agree with the fields that follow them.
    pub flags: u8,
    /// GPS fix: 0 none, 1 2D, 2 3D.
    pub fix: u8,
    /// Satellites in use.
    pub satellites: u8,
    /// Latitude in 1e-7 degree.
    pub lat_e7: i32,
    /// Longitude in 1e-7 degree.
    pub lon_e7: i32,
    /// Altitude in cm.
    pub altitude_cm: i32,
    /// Ground speed in cm/s.
    pub ground_speed_cms: i16,
    /// Course over ground in 0.1 degree.
    pub course_ddeg: i16,
    /// Velocity north, east, down in cm/s.
    pub velocity_ned_cms: [i16; 3],
    /// Roll in 0.1 degree, right side down positive.
    pub roll_ddeg: i16,
    /// Pitch in 0.1 degree, nose down positive.
    pub pitch_ddeg: i16,
    /// Heading in 0.1 degree, clockwise from north.
    pub yaw_ddeg: i16,
    /// Specific force, FLU, in thousandths of g.
    pub acc_mg: [i16; 3],
    /// Rates, FLU, in 1/16 degree per second.
    pub gyro_16th_dps: [i16; 3],
    /// Air pressure in Pa.
    pub pressure_pa: u32,
    /// Magnetic field.
    pub mag: [i16; 3],
    /// Battery voltage in 0.1 V; present with [`flag::BATTERY`].
    pub vbat_dv: Option<u8>,
    /// Air speed in cm/s; present with [`flag::AIRSPEED`].
    pub airspeed_cms: Option<u16>,
}

impl Message for SimulatorRequest {
    const COMMAND: u16 = command::SIMULATOR;

    fn parse(payload: &[u8]) -> Result<Self, ParseError> {
        let reader = &mut Reader::new(Self::COMMAND, payload);
        let (version, flags) = (u8::read(reader)?, u8::read(reader)?);
        let mut request = Self {
            version,
            flags,
            fix: Wire::read(reader)?,
            satellites: Wire::read(reader)?,
            lat_e7: Wire::read(reader)?,
            lon_e7: Wire::read(reader)?,
            altitude_cm: Wire::read(reader)?,
            ground_speed_cms: Wire::read(reader)?,
            course_ddeg: Wire::read(reader)?,
            velocity_ned_cms: Wire::read(reader)?,
            roll_ddeg: Wire::read(reader)?,
            pitch_ddeg: Wire::read(reader)?,
            yaw_ddeg: Wire::read(reader)?,
            acc_mg: Wire::read(reader)?,
            gyro_16th_dps: Wire::read(reader)?,
            pressure_pa: Wire::read(reader)?,
            mag: Wire::read(reader)?,
            vbat_dv: None,
            airspeed_cms: None,
        };
        if flags & flag::BATTERY != 0 {
            request.vbat_dv = Some(Wire::read(reader)?);
        }
        if flags & flag::AIRSPEED != 0 {
            request.airspeed_cms = Some(Wire::read(reader)?);
        }
        Ok(request)
    }

    fn emit(&self, out: &mut Vec<u8>) {
        [self.version, self.flags, self.fix, self.satellites].write(out);
        [self.lat_e7, self.lon_e7, self.altitude_cm].write(out);
        [self.ground_speed_cms, self.course_ddeg].write(out);
        self.velocity_ned_cms.write(out);
        [self.roll_ddeg, self.pitch_ddeg, self.yaw_ddeg].write(out);
        self.acc_mg.write(out);
        self.gyro_16th_dps.write(out);
        self.pressure_pa.write(out);
        self.mag.write(out);
        self.vbat_dv.write(out);
        self.airspeed_cms.write(out);
    }
}

super::messages! {
    /// What the controller would do.
    SimulatorReply = SIMULATOR {
        /// Stabilised roll, -500..=500; -500 disarmed.
        roll: i16,
        /// Stabilised pitch.
        pitch: i16,
        /// Stabilised yaw.
        yaw: i16,
        /// Throttle; -500 disarmed.
        throttle: i16,
        /// Low bits: which debug value follows; high bits: state of the controller.
        debug_index_flags: u8,
        /// A debug value.
        debug: u32,
        /// Attitude by the controller, roll in 0.1 degree.
        roll_ddeg: i16,
        /// Pitch in 0.1 degree, nose down positive.
        pitch_ddeg: i16,
        /// Heading in 0.1 degree.
        yaw_ddeg: i16,
        /// Changes of the on-screen display, packed.
        osd: ArrayVec<u8, 512>,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_follows_the_fixed_part_is_told_by_the_flags() {
        for (flags, vbat_dv, airspeed_cms, length) in [
            (flag::ENABLE, None, None, 54),
            (flag::ENABLE | flag::BATTERY, Some(126), None, 55),
            (flag::ENABLE | flag::AIRSPEED, None, Some(1200), 56),
            (flag::BATTERY | flag::AIRSPEED, Some(126), Some(1200), 57),
        ] {
            let request = SimulatorRequest {
                version: VERSION,
                flags,
                acc_mg: [0, 0, 1000],
                pressure_pa: 101_325,
                vbat_dv,
                airspeed_cms,
                ..SimulatorRequest::default()
            };
            let mut payload = Vec::new();
            request.emit(&mut payload);
            assert_eq!(payload.len(), length);
            assert_eq!(SimulatorRequest::parse(&payload), Ok(request));
            assert!(SimulatorRequest::parse(&payload[..length - 1]).is_err());
        }
    }
}
