//! Every tunable of the attitude estimator.

/// Tunables of [`AttitudeEstimator`](super::AttitudeEstimator); one set for all motions.
///
/// Magnetic values are shares of the earth's field (the first field seen is 1), so that any unit will do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeParams {
    /// Local gravity, m/s2.
    pub gravity_mps2: f64,
    /// Largest rate the gyro can report, rad/s (2000 deg/s).
    pub gyro_range_radps: f64,
    /// Largest force the accelerometer can report, m/s2 (16 g).
    pub accel_range_mps2: f64,
    /// Group delay of the inertial sensor's low-pass, s: the published attitude is turned ahead by it. 3.5 ms belongs to the
    /// 50-100 Hz filters usual in MEMS sensors, and was best on recordings with optical truth; it changes neither biases nor heading.
    pub sensor_delay_s: f64,

    /// Velocity is believed to stay within this, one standard deviation, m/s.
    pub velocity_std_mps: f64,
    /// For so long a velocity is like itself, s.
    pub velocity_correlation_s: f64,
    /// Accelerometer noise, m/s2/sqrt(Hz).
    pub accel_noise: f64,
    /// Accelerometer noise per m/s2 beyond gravity, m/s2/sqrt(Hz): scale errors and clipped shocks.
    pub accel_noise_share: f64,
    /// Gyro noise, rad/s/sqrt(Hz).
    pub gyro_noise: f64,
    /// Gyro noise per rad/s turned, rad/s/sqrt(Hz): scale and alignment errors.
    pub gyro_noise_share: f64,
    /// Accelerometer bias at the start, m/s2.
    pub accel_bias_std_mps2: f64,
    /// Walk of the accelerometer bias, m/s3/sqrt(Hz).
    pub accel_bias_walk: f64,
    /// Gyro bias at the start, rad/s.
    pub gyro_bias_std_radps: f64,
    /// Walk of the gyro bias, rad/s2/sqrt(Hz).
    pub gyro_bias_walk: f64,

    /// At rest the gyro stays this close to its mean of half a second, rad/s.
    pub rest_gyro_radps: f64,
    /// At rest that mean is within this, rad/s: the largest bias to expect.
    pub rest_bias_radps: f64,
    /// At rest the accelerometer stays this close to its mean of half a second, m/s2.
    pub rest_accel_mps2: f64,
    /// So long both must hold, s.
    pub rest_after_s: f64,
    /// What the gyro's mean is worth as a bias at rest, rad/s.
    pub rest_gyro_std_radps: f64,

    /// Readings are averaged over this before they are used, s.
    pub field_block_s: f64,
    /// Noise of the field, share: unevenness of the room's field on the way.
    pub field_std: f64,
    /// For so long that unevenness is like itself, s.
    pub field_correlation_s: f64,
    /// Walk of the field from place to place, share/sqrt(s).
    pub field_walk: f64,
    /// Heading drift per rad/s turned, rad/s/sqrt(Hz).
    pub heading_walk_share: f64,
    /// Hard iron at the start, share.
    pub hard_iron_std: f64,
    /// Walk of the hard iron, share/sqrt(s).
    pub hard_iron_walk: f64,
    /// Beyond this misfit of strength and dip something new is near the sensor, share.
    pub disturbance_threshold: f64,
    /// How fast the hard iron opens then: share of the squared misfit per second.
    pub disturbance_to_hard_iron_per_s: f64,
    /// A disturbance is remembered so long, s.
    pub disturbance_memory_s: f64,
    /// Delay of the magnetometer behind the gyro at the start, s.
    pub mag_delay_s: f64,
    /// Its standard deviation, s.
    pub mag_delay_std_s: f64,
}

impl Default for AttitudeParams {
    fn default() -> Self {
        Self {
            gravity_mps2: 9.81,
            gyro_range_radps: 34.9,
            accel_range_mps2: 157.0,
            sensor_delay_s: 0.0035,

            velocity_std_mps: 0.5,
            velocity_correlation_s: 0.3,
            accel_noise: 0.03,
            accel_noise_share: 1.4e-3,
            gyro_noise: 3.5e-4,
            gyro_noise_share: 3.2e-3,
            accel_bias_std_mps2: 0.02,
            accel_bias_walk: 3e-4,
            gyro_bias_std_radps: 8.7e-3,
            gyro_bias_walk: 3.5e-5,

            rest_gyro_radps: 0.035,
            rest_bias_radps: 0.052,
            rest_accel_mps2: 0.5,
            rest_after_s: 1.5,
            rest_gyro_std_radps: 5.2e-4,

            field_block_s: 0.07,
            field_std: 0.022,
            field_correlation_s: 3.0,
            field_walk: 0.0067,
            heading_walk_share: 8e-3,
            hard_iron_std: 0.067,
            hard_iron_walk: 2.2e-3,
            disturbance_threshold: 0.067,
            disturbance_to_hard_iron_per_s: 0.3,
            disturbance_memory_s: 1.0,
            mag_delay_s: 0.005,
            mag_delay_std_s: 0.010,
        }
    }
}
