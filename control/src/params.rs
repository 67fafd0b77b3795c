//! Everything that can be tuned in this crate.

vehicle::param_choice! {
    /// Which stick curves the flight controller's firmware has.
    pub enum CurveKind {
        /// Betaflight with `rates_type = ACTUAL`, expo 0 (4.3 and later; angle mode shaped by the rate curve).
        BetaflightActual = 0, "betaflight-actual";
        /// Deflection proportional to angle and yaw rate (INAV with expo 0).
        Linear = 1, "linear";
        /// `x (1 - expo + expo x^2)`, cut off at the angle limit (INAV, Cleanflight, MultiWii).
        Expo = 2, "expo";
        /// Of the firmware that answers, as it is delivered (Betaflight: `betaflight-actual` with the values given here).
        Auto = 3, "auto";
    }
}

vehicle::param_choice! {
    /// Which law flies from set point to sticks.
    pub enum Variant {
        /// The cascade: place, velocity, acceleration, tilt.
        Cascade = 0, "cascade";
        /// LQR on the outer-loop model, with the dead time of the RC stream in it, for places and heights; velocities stay the cascade's.
        Lqr = 1, "lqr";
        /// SNSI's PID family with priorities: height to throttle, inclination (8 degrees at most) to elevator, heading to rudder.
        Snsi = 2, "snsi";
    }
}

vehicle::params! {
    /// Tuning of the outer loops. Names as in PX4 where PX4 has the parameter.
    pub struct ControlParams {
        /// Which law flies.
        variant: choice<Variant> "KST_CTL_VARIANT" = Variant::Cascade;
        /// Position error to velocity (chosen: half of the velocity loop's bandwidth).
        xy_p: float "MPC_XY_P" = 1.3, "1/s", 0.1..=3.0;
        /// Velocity error to acceleration (chosen for 60 ms dead time and 100 ms attitude response: 6 dB gain margin).
        xy_vel_p: float "MPC_XY_VEL_P_ACC" = 2.4, "1/s", 0.2..=6.0;
        /// Velocity error integral to acceleration.
        xy_vel_i: float "MPC_XY_VEL_I_ACC" = 0.8, "1/s2", 0.0..=3.0;
        /// Measured acceleration to acceleration, the damping.
        xy_vel_d: float "MPC_XY_VEL_D_ACC" = 0.1, "1", 0.0..=0.8;
        /// Largest horizontal speed.
        xy_vel_max: float "MPC_XY_VEL_MAX" = 1.5, "m/s", 0.1..=5.0;
        /// Largest horizontal acceleration asked for.
        acc_hor: float "MPC_ACC_HOR" = 2.2, "m/s2", 0.3..=5.0;
        /// Largest change of the acceleration asked for.
        jerk_max: float "MPC_JERK_MAX" = 15.0, "m/s3", 2.0..=100.0;
        /// Largest tilt.
        tilt_max_deg: float "MPC_TILTMAX_AIR" = 15.0, "deg", 3.0..=45.0;
        /// Height error to climb.
        z_p: float "MPC_Z_P" = 1.3, "1/s", 0.1..=3.0;
        /// Climb error to acceleration.
        z_vel_p: float "MPC_Z_VEL_P_ACC" = 4.0, "1/s", 0.5..=15.0;
        /// Climb error integral to acceleration.
        z_vel_i: float "MPC_Z_VEL_I_ACC" = 1.5, "1/s2", 0.0..=6.0;
        /// Largest climb.
        z_vel_max_up: float "MPC_Z_VEL_MAX_UP" = 0.8, "m/s", 0.1..=3.0;
        /// Largest descent.
        z_vel_max_dn: float "MPC_Z_VEL_MAX_DN" = 0.6, "m/s", 0.1..=2.0;
        /// Largest vertical acceleration asked for while flying set points.
        acc_vert: float "MPC_ACC_VERT" = 2.0, "m/s2", 0.3..=6.0;
        /// Heading error to yaw rate.
        yaw_p: float "MC_YAW_P" = 1.8, "1/s", 0.2..=5.0;
        /// Largest yaw rate.
        yaw_rate_max_deg: float "MPC_YAWRAUTO_MAX" = 70.0, "deg/s", 5.0..=360.0;
        /// Largest change of the yaw rate.
        yaw_acc_max_deg: float "MPC_YAWRAUTO_ACC" = 300.0, "deg/s2", 20.0..=2000.0;
        /// Mass that the thrust model believes; 0 takes the airframe's. Keys i, k and 0 change it.
        mass_kg: float "VEH_MASS" = 0.0, "kg", 0.0..=10.0;
        /// Throttle stick that hovers before any is learnt; 0 computes it from mass and largest thrust.
        hover_throttle: float "MPC_THR_HOVER" = 0.0, "1", 0.0..=0.8;
        /// Time constant of learning the hover throttle.
        hover_learn_s: float "MPC_HOVER_TAU" = 6.0, "s", 1.0..=60.0;
        /// Least thrust in the air as a share of hover thrust: keeps the attitude controllable.
        thrust_min: float "MPC_THR_MIN" = 0.4, "1", 0.1..=0.9;
        /// Largest throttle stick.
        throttle_max: float "MPC_THR_MAX" = 0.95, "1", 0.3..=1.0;
        /// Exponent of thrust over motor command (2: thrust follows the square of speed).
        thrust_exponent: float "FC_THRUST_EXP" = 2.0, "1", 1.0..=2.5;
        /// Motor command at zero throttle (Betaflight `dshot_idle_value` 550 = 5.5 %).
        motor_idle: float "FC_MOTOR_IDLE" = 0.055, "1", 0.0..=0.2;
        /// Time of the throttle ramp from idle to hover at take-off.
        takeoff_ramp_s: float "MPC_TKO_RAMP_T" = 1.5, "s", 0.3..=5.0;
        /// Height below which a landing slows down to the crawl speed.
        land_slow_m: float "MPC_LAND_ALT2" = 0.5, "m", 0.1..=2.0;
        /// Speed of the last piece of a landing.
        land_crawl_mps: float "MPC_LAND_CRWL" = 0.25, "m/s", 0.1..=0.6;
        /// Shape of the firmware's stick curves.
        curve: choice<CurveKind> "FC_STICK_CURVE" = CurveKind::Auto;
        /// Angle at full stick (Betaflight `angle_limit`, INAV `max_angle_inclination`).
        angle_limit_deg: float "FC_ANGLE_LIMIT" = 60.0, "deg", 10.0..=85.0;
        /// Roll and pitch rate sensitivity at the stick's centre (Betaflight `roll_rc_rate` x 10).
        rate_center_dps: float "FC_RATE_CENTER" = 70.0, "deg/s", 10.0..=2000.0;
        /// Roll and pitch rate at full stick (Betaflight `roll_srate` x 10).
        rate_max_dps: float "FC_RATE_MAX" = 670.0, "deg/s", 20.0..=2000.0;
        /// Yaw rate sensitivity at the stick's centre (Betaflight `yaw_rc_rate` x 10).
        yaw_center_dps: float "FC_YAW_CENTER" = 70.0, "deg/s", 10.0..=2000.0;
        /// Yaw rate at full stick (Betaflight `yaw_srate` x 10; INAV `yaw_rate` x 10).
        yaw_max_dps: float "FC_YAW_MAX" = 670.0, "deg/s", 20.0..=2000.0;
        /// Curve `expo`: angle at full stick if there were no limit (MultiWii 90); 0 takes the limit.
        angle_gain_deg: float "FC_ANGLE_GAIN" = 0.0, "deg", 0.0..=180.0;
        /// Curve `expo`: expo of roll and pitch (INAV `rc_expo` / 100).
        tilt_expo: float "FC_RC_EXPO" = 0.7, "1", 0.0..=0.95;
        /// Curve `expo`: expo of yaw (INAV `rc_yaw_expo` / 100).
        yaw_expo: float "FC_YAW_EXPO" = 0.2, "1", 0.0..=0.95;
    }
}
