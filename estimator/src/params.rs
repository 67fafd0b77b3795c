//! Every tunable of the estimator.

vehicle::param_choice! {
    /// Which localization runs.
    pub enum MclVariant {
        /// The one that is flown.
        Production = 0, "production";
        /// The filter of the SNSI thesis, to compare with.
        Thesis = 1, "thesis";
    }
}

vehicle::params! {
    /// Parameters of the estimator.
    pub struct EstimatorParams {
        /// Accelerometer noise density. A frame-mounted sensor in flight shakes 10-30 times its bench value (0.08); sampled at 40 Hz over MSP it aliases, so more.
        accel_noise: float "EST_ACC_NOISE" = 0.2, "m/s2/sqrt(Hz)", 0.01..=2.0;
        /// Gyro noise density, for the same reason above the bench value (0.003).
        gyro_noise: float "EST_GYR_NOISE" = 0.01, "rad/s/sqrt(Hz)", 0.0005..=0.2;
        /// Accelerometer bias walk (algorithms note 1.1).
        accel_bias_walk: float "EST_ACC_WALK" = 0.002, "m/s3/sqrt(Hz)", 0.0..=0.1;
        /// Gyro bias walk (algorithms note 1.1).
        gyro_bias_walk: float "EST_GYR_WALK" = 0.0001, "rad/s2/sqrt(Hz)", 0.0..=0.01;
        /// Trust in the flight controller's roll and pitch: quantised to 0.1 deg, leaning with acceleration.
        attitude_std_deg: float "EST_ATT_STD" = 1.0, "deg", 0.1..=10.0;
        /// Trust in the flight controller's heading inside odometry: whole degrees, 10 ms old.
        heading_std_deg: float "EST_HDG_STD" = 1.0, "deg", 0.1..=20.0;
        /// Down-range noise at the sensor (algorithms note 1.2).
        range_std_m: float "EST_RNG_STD" = 0.03, "m", 0.002..=0.5;
        /// Down-range noise that grows with distance (algorithms note 1.2).
        range_std_per_m: float "EST_RNG_STD_K" = 0.02, "m/m", 0.0..=0.2;
        /// Barometer noise (algorithms note 1.2).
        baro_std_m: float "EST_BARO_STD" = 0.3, "m", 0.05..=5.0;
        /// Optical flow noise at full quality (algorithms note 1.2).
        flow_std_radps: float "EST_FLOW_STD" = 0.1, "rad/s", 0.01..=1.0;
        /// Flow of lower quality is not used (0-255; PX4 uses 50 - 100 for the same sensor class).
        flow_quality_min: int "EST_FLOW_QMIN" = 60, "1", 0..=255;
        /// Smallest deviation of a plan pose (algorithms note 1.2: 0.05; recorded flights reach 0.03).
        pose_std_m: float "EST_POSE_STD" = 0.03, "m", 0.005..=1.0;
        /// Smallest deviation of a plan yaw (algorithms note 1.2: 2 deg).
        pose_std_yaw_deg: float "EST_POSE_STDYAW" = 1.5, "deg", 0.1..=20.0;
        /// Neighbouring plan poses share their error for this long, so that a fast ring is not trusted more than it knows. The state follows the particles within a few times this.
        pose_correlation_s: float "EST_POSE_TAU" = 0.1, "s", 0.0..=5.0;
        /// Height of the body centre above the floor when landed.
        landed_height_m: float "EST_LAND_HEIGHT" = 0.05, "m", 0.0..=1.0;
        /// Height of the walls of the plan: higher hits are not compared with it.
        wall_height_m: float "EST_WALL_HEIGHT" = 2.2, "m", 0.3..=20.0;
        /// Most particles.
        particles_max: int "MCL_PARTICLES" = 2000, "1", 100..=8000;
        /// Fewest particles that KLD sampling may keep.
        particles_min: int "MCL_PART_MIN" = 300, "1", 50..=8000;
        /// KLD sampling error (algorithms note 2: 0.02 - 0.05).
        kld_error: float "MCL_KLD_ERR" = 0.05, "1", 0.005..=0.5;
        /// Independent readings that one scan is worth; the rest of its evidence is the same walls again. Literature says 4 - 8; on the seven recorded flights 16 gives 0.021 m where 8 gives 0.029 m.
        effective_beams: float "MCL_BEAMS_EFF" = 16.0, "1", 1.0..=64.0;
        /// Resample when the effective sample size falls below this share (algorithms note 2: 0.5 - 0.7).
        resample_below: float "MCL_RESAMPLE" = 0.6, "1", 0.1..=1.0;
        /// Deviation of a time-of-flight hit from the wall, plan errors included (algorithms note 2: 0.06).
        ray_std_m: float "MCL_RAY_STD" = 0.06, "m", 0.01..=0.5;
        /// Deviation of a sonar return from the wall (algorithms note 2: 0.10; 0.08 is better on the recorded flights).
        cone_std_m: float "MCL_CONE_STD" = 0.08, "m", 0.01..=0.5;
        /// Deviation of a laser return from the wall, plan errors included.
        laser_std_m: float "MCL_LASER_STD" = 0.05, "m", 0.005..=0.5;
        /// Share of readings that mean nothing (algorithms note 2: 0.05; 0.03 is better on the recorded flights).
        random_share: float "MCL_RANDOM" = 0.03, "1", 0.001..=0.5;
        /// Position noise per metre of odometry (algorithms note 2: 0.08; recorded flow odometry is worse: 0.12).
        motion_per_m: float "MCL_MOTION" = 0.12, "m/m", 0.01..=1.0;
        /// Share of returns that must end at a wall before a place is believed (recorded flights: 0.8 - 1.0 at the true place).
        good_fit: float "MCL_FIT_GOOD" = 0.7, "1", 0.3..=1.0;
        /// Below this share the place is doubted (recorded flights with other drones about: never below 0.8; a kidnapped vehicle: below 0.6 at once).
        bad_fit: float "MCL_FIT_BAD" = 0.6, "1", 0.1..=0.9;
        /// Which localization runs: production, or the SNSI thesis to compare with (taken at start).
        mcl_variant: choice<MclVariant> "MCL_VARIANT" = MclVariant::Production;
    }
}
