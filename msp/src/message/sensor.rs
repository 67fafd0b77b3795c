//! IMU, attitude, altitude, rangefinder, optical flow, GPS.
//!
//! Axes, measured alike on Betaflight and INAV: body x forward, y left, z up (FLU). The signs of
//! the attitude angles are those of the pilot's view, roll right side down positive, but **pitch is
//! positive nose down**.

use super::messages;

messages! {
    /// Attitude by the controller's estimator.
    #[derive(Copy)]
    Attitude = ATTITUDE {
        /// Roll in 0.1 degree, right side down positive.
        roll_ddeg: i16,
        /// Pitch in 0.1 degree, **nose down positive**.
        pitch_ddeg: i16,
        /// Heading in whole degrees, clockwise from north: 0..=359, MultiWii -180..=180.
        yaw_deg: i16,
    }

    /// Attitude as a quaternion that turns body FLU into earth NWU (Betaflight API 1.49 and later).
    #[derive(Copy)]
    AttitudeQuaternion = ATTITUDE_QUATERNION {
        /// Scalar part times 32767.
        w_q15: i16,
        /// x times 32767.
        x_q15: i16,
        /// y times 32767.
        y_q15: i16,
        /// z times 32767.
        z_q15: i16,
    }

    /// Altitude by the controller's estimator, above the place of arming.
    #[derive(Copy)]
    Altitude = ALTITUDE {
        /// Altitude in cm.
        altitude_cm: i32,
        /// Climb rate in cm/s.
        vario_cms: i16,
        /// INAV: barometric altitude in cm.
        baro_altitude_cm: Option<i32>,
    }

    /// Inertial sensors in counts, FLU; scales in [`crate::firmware::Firmware`].
    #[derive(Copy)]
    RawImu = RAW_IMU {
        /// Specific force x, y, z in counts: level at rest (0, 0, +1 g).
        acc: [i16; 3],
        /// Rates: x roll right, y nose down, z counter-clockwise seen from above.
        gyro: [i16; 3],
        /// Magnetic field, uncalibrated counts.
        mag: [i16; 3],
    }

    /// Height by the controller's own rangefinder, tilt-corrected.
    #[derive(Copy)]
    SonarAltitude = SONAR_ALTITUDE {
        /// Height in cm, -1 out of range.
        altitude_cm: i32,
    }

    /// GPS position.
    #[derive(Copy)]
    RawGps = RAW_GPS {
        /// INAV 0 none, 1 2D, 2 3D; Betaflight non-zero = fix.
        fix: u8,
        /// Satellites in use.
        satellites: u8,
        /// Latitude in 1e-7 degree.
        lat_e7: i32,
        /// Longitude in 1e-7 degree.
        lon_e7: i32,
        /// Altitude above mean sea level in **m**.
        altitude_m: i16,
        /// Ground speed in cm/s.
        ground_speed_cms: u16,
        /// Course over ground in 0.1 degree.
        course_ddeg: u16,
        /// Dilution of precision times 100: PDOP in Betaflight (API 1.44), HDOP in INAV.
        dop_e2: Option<u16>,
    }

    /// GPS position from us, for a controller whose GPS provider is MSP.
    #[derive(Copy)]
    SetRawGps = SET_RAW_GPS {
        /// Non-zero = fix.
        fix: u8,
        /// Satellites in use.
        satellites: u8,
        /// Latitude in 1e-7 degree.
        lat_e7: i32,
        /// Longitude in 1e-7 degree.
        lon_e7: i32,
        /// Altitude in m.
        altitude_m: i16,
        /// Ground speed in cm/s.
        ground_speed_cms: u16,
    }

    /// Rangefinder sample from us (`rangefinder_hardware` set to MSP in INAV, to a module type in
    /// Betaflight).
    #[derive(Copy)]
    SensorRangefinder = SENSOR_RANGEFINDER {
        /// Quality 0..=255.
        quality: u8,
        /// Distance in mm, negative = out of range.
        distance_mm: i32,
    }

    /// Optical flow sample from us.
    #[derive(Copy)]
    SensorOpticFlow = SENSOR_OPTIC_FLOW {
        /// Quality 0..=255.
        quality: u8,
        /// Flow in x, sensor units.
        motion_x: i32,
        /// Flow in y, sensor units.
        motion_y: i32,
    }

    /// Optical flow as INAV sees it.
    #[derive(Copy)]
    InavOpticalFlow = INAV_OPTICAL_FLOW {
        /// Quality 0..=100.
        quality: u8,
        /// Flow rate about x in deg/s.
        flow_x_dps: i16,
        /// Flow rate about y in deg/s.
        flow_y_dps: i16,
        /// Body rate about x in deg/s.
        body_x_dps: i16,
        /// Body rate about y in deg/s.
        body_y_dps: i16,
    }

    /// Air speed as INAV sees it.
    #[derive(Copy)]
    InavAirSpeed = INAV_AIR_SPEED {
        /// Speed in cm/s.
        airspeed_cms: u32,
    }

    /// GPS solution from us, 52 bytes, for a controller whose GPS provider is MSP.
    #[derive(Copy)]
    SensorGps = SENSOR_GPS {
        /// Number of the receiver.
        instance: u8,
        /// GPS week, 0xFFFF unknown.
        gps_week: u16,
        /// Time of week in ms.
        time_of_week_ms: u32,
        /// 0 none, 2 2D, 3 3D.
        fix: u8,
        /// Satellites in use.
        satellites: u8,
        /// Horizontal accuracy in cm.
        horizontal_accuracy_cm: u16,
        /// Vertical accuracy in cm.
        vertical_accuracy_cm: u16,
        /// Accuracy of the horizontal speed in cm/s.
        speed_accuracy_cms: u16,
        /// Horizontal dilution of precision times 100.
        hdop_e2: u16,
        /// Longitude in 1e-7 degree.
        lon_e7: i32,
        /// Latitude in 1e-7 degree.
        lat_e7: i32,
        /// Altitude above mean sea level in cm.
        altitude_cm: i32,
        /// Velocity north, east, down in cm/s.
        velocity_ned_cms: [i32; 3],
        /// Course over ground in 0.01 degree.
        course_cdeg: u16,
        /// True heading in 0.01 degree, 65535 unknown.
        yaw_cdeg: u16,
        /// Year, UTC.
        year: u16,
        /// Month, day, hour, minute, second, UTC.
        date_time: [u8; 5],
    }

    /// Magnetometer sample from us.
    #[derive(Copy)]
    SensorCompass = SENSOR_COMPASS {
        /// Number of the sensor.
        instance: u8,
        /// Time stamp in ms.
        time_ms: u32,
        /// Field along x, y, z in mGauss.
        field_mgauss: [i16; 3],
    }

    /// Barometer sample from us.
    #[derive(Copy)]
    SensorBaro = SENSOR_BARO {
        /// Number of the sensor.
        instance: u8,
        /// Time stamp in ms.
        time_ms: u32,
        /// Pressure in Pa, the bits of an `f32`: [`SensorBaro::pressure_pa`].
        pressure_pa_bits: u32,
        /// Temperature in 0.01 degree Celsius.
        temperature_cdegc: i16,
    }
}

impl SensorBaro {
    /// Pressure in Pa; any bit pattern may come, NaN among them.
    #[must_use]
    pub const fn pressure_pa(&self) -> f32 {
        f32::from_bits(self.pressure_pa_bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Message;

    #[test]
    fn altitude_of_inav_carries_the_barometer_and_that_of_betaflight_does_not() {
        let short = Altitude::parse(&[0x7b, 0, 0, 0, 0xfc, 0xff]).unwrap();
        assert_eq!(
            short,
            Altitude {
                altitude_cm: 123,
                vario_cms: -4,
                baro_altitude_cm: None
            }
        );
        let long = Altitude::parse(&[0x7b, 0, 0, 0, 0xfc, 0xff, 0x82, 0, 0, 0]).unwrap();
        assert_eq!(long.baro_altitude_cm, Some(130));
    }

    #[test]
    fn heading_west_rolled_left_nose_down() {
        let attitude = Attitude::parse(&[0x85, 0xff, 0x2d, 0, 0x0e, 1]).unwrap();
        assert_eq!(
            attitude,
            Attitude {
                roll_ddeg: -123,
                pitch_ddeg: 45,
                yaw_deg: 270
            }
        );
    }
}
