//! Parameters of modes, failsafes, take-off and landing.

vehicle::param_choice! {
    /// What to do when the ground station falls silent (PX4's codes).
    pub enum LossAction {
        /// Nothing.
        Disabled = 0, "disabled";
        /// Hover.
        Hold = 1, "hold";
        /// Fly home and land.
        Return = 2, "return";
        /// Come down here.
        Land = 3, "land";
    }
}

vehicle::params! {
    /// Modes, failsafes, take-off and landing.
    pub struct AutopilotParams {
        /// Height of a take-off that names none, above the floor at home (chosen: above furniture edges, below lamps).
        takeoff_height_m: float "MIS_TAKEOFF_ALT" = 1.0, "m", 0.3..=10.0;
        /// Height of the way home; 0 keeps the height flown at.
        return_height_m: float "RTL_RETURN_ALT" = 0.0, "m", 0.0..=10.0;
        /// Ceiling: no set point is higher, above the floor at home.
        ceiling_m: float "KST_CEILING" = 2.2, "m", 0.5..=20.0;
        /// Speed of climb on take-off.
        climb_mps: float "MPC_TKO_SPEED" = 0.6, "m/s", 0.1..=2.0;
        /// Speed of descent in landing.
        descent_mps: float "MPC_LAND_SPEED" = 0.4, "m/s", 0.05..=1.0;
        /// Time after touch-down before the motors stop.
        disarm_after_landing_s: float "COM_DISARM_LAND" = 0.5, "s", 0.0..=20.0;
        /// Time disarmed on the ground after arming without take-off.
        disarm_preflight_s: float "COM_DISARM_PRFLT" = 10.0, "s", 0.0..=120.0;
        /// Take off to look for the place on the plan when it is not known (climb to 0.8 m, one turn).
        search: bool "LOC_SEARCH" = true;
        /// Height of the search flight.
        search_height_m: float "LOC_SEARCH_ALT" = 0.8, "m", 0.4..=3.0;
        /// Longest search before landing.
        search_timeout_s: float "LOC_SEARCH_T" = 45.0, "s", 5.0..=300.0;
        /// Time without localization in the air before landing.
        lost_timeout_s: float "LOC_LOST_T" = 4.0, "s", 0.5..=60.0;
        /// Action when the ground station falls silent.
        ground_loss_action: choice<LossAction> "NAV_DLL_ACT" = LossAction::Land;
        /// Silence of the ground station before the action.
        ground_loss_s: float "COM_DL_LOSS_T" = 3.0, "s", 0.5..=60.0;
        /// Silence of an off-board stream before Hold.
        offboard_loss_s: float "COM_OF_LOSS_T" = 0.5, "s", 0.2..=10.0;
        /// Off-board set points pass obstacle avoidance.
        offboard_avoid: bool "KST_OFFB_AVOID" = true;
        /// Silence of manual input before the sticks count as centred.
        manual_loss_s: float "COM_RC_LOSS_T" = 0.5, "s", 0.1..=10.0;
        /// Silence of manual input, sticks centred, before Hold.
        manual_hold_s: float "KST_MAN_HOLD_T" = 2.0, "s", 0.2..=60.0;
        /// Battery left at which the vehicle returns and lands, percent; 0 never.
        battery_low_percent: float "BAT_LOW_THR" = 15.0, "%", 0.0..=60.0;
        /// Battery left at which the vehicle lands where it is, percent; 0 never (PX4: critical).
        battery_critical_percent: float "BAT_CRIT_THR" = 7.0, "%", 0.0..=60.0;
        /// Voltage of a cell under load below which the vehicle lands, for 1 s; 0 never (lithium polymer is damaged below 3.0).
        battery_sag_v: float "BAT_V_SAG" = 3.1, "V", 0.0..=4.0;
        /// Tilt for 0.2 s at which a mode that needs a place gives up and lands (control asks for 20 degrees at most).
        tilt_max_deg: float "KST_TILT_MAX" = 45.0, "deg", 25.0..=90.0;
        /// Tilt for 0.3 s at which the motors stop: it has toppled over (PX4: FD_FAIL_R).
        crash_tilt_deg: float "KST_CRASH_TILT" = 70.0, "deg", 45.0..=180.0;
        /// Time that the estimate may contradict itself before landing (the filter gives in to a refused attitude after 1 s).
        inconsistent_s: float "KST_EST_T" = 0.8, "s", 0.2..=30.0;
        /// Jumps of the place within 10 s before landing (a corridor with two like ends makes one).
        jumps_max: int "KST_JUMPS_MAX" = 3, "1", 1..=8;
        /// Time that a range finder may say the same while the vehicle moves before landing.
        stuck_s: float "KST_STUCK_T" = 3.0, "s", 1.0..=60.0;
        /// Time on the way within a metre before a mission holds and a return lands; 0 never.
        no_progress_s: float "KST_PROGRESS_T" = 30.0, "s", 0.0..=600.0;
        /// Share of beats missed within 2 s before landing, percent.
        missed_max_percent: float "KST_MISS_MAX" = 40.0, "%", 5.0..=100.0;
        /// Answers of the flight controller below which the vehicle lands, for 1 s (attitude needs ten a second at least).
        fc_min_hz: float "KST_FC_MIN_HZ" = 15.0, "Hz", 0.0..=60.0;
        /// Temperature of the computer at which the vehicle lands (a Raspberry Pi switches itself off soon after).
        hot_c: float "KST_TEMP_MAX" = 90.0, "degC", 40.0..=120.0;
        /// Time that must be left when the way home and the landing are flown, s; earlier than that it returns. 0 never.
        battery_reserve_s: float "KST_BAT_RESERVE" = 45.0, "s", 0.0..=600.0;
        /// Capacity of the battery, from which the time left is told before it has been learnt in flight; 0 unknown.
        battery_capacity_mah: float "BAT1_CAPACITY" = 0.0, "mAh", 0.0..=100000.0;
        /// Sticks neutral and the arm switch low for so long before it goes up (1 s is what controllers need; SNSI waited 5 s).
        arm_neutral_s: float "KST_ARM_NEUTRAL" = 1.0, "s", 1.0..=10.0;
        /// Added to the flight controller's heading, clockwise: declination, or how its compass is mounted. What is told before the place is known.
        heading_offset_deg: float "KST_HDG_OFFSET" = 0.0, "deg", -180.0..=180.0;
        /// A pilot's radio stays connected to the flight controller and takes over by its MSP OVERRIDE switch (override mask 15).
        radio: bool "KST_RADIO" = false;
        /// Motors may be turned by DO_MOTOR_TEST and ACTUATOR_TEST while disarmed: propellers off first.
        motor_test: bool "KST_MOTOR_TEST" = false;
        /// Ask the flight controller for its range finder's height (MSP_SONAR_ALTITUDE), where it has one.
        fc_range: bool "KST_FC_RANGE" = false;
        /// Ask the flight controller for its optical flow (MSP2_INAV_OPTICAL_FLOW, INAV only).
        fc_flow: bool "KST_FC_FLOW" = false;
        /// Ask the flight controller for satellite fixes (MSP_RAW_GPS).
        fc_gps: bool "KST_FC_GPS" = false;
        /// Satellite fixes hold the estimate where nothing better does; off: they are only shown. Indoors leave it off.
        gnss: bool "KST_GNSS_USE" = false;
        /// RC frames a second (Betaflight drops the craft after 0.3 s without one; its serial task serves 100 messages/s).
        rc_hz: int "KST_RC_HZ" = 40, "Hz", 20..=250;
    }
}
