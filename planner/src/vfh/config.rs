//! Everything that can be tuned in obstacle avoidance.

vehicle::params! {
    /// VFH+ obstacle avoidance (Ulrich and Borenstein 1998).
    pub struct VfhParams {
        /// Avoid obstacles at all.
        enabled: bool "VFH_ENABLE" = true;
        /// Polar density above which a free sector becomes blocked (t_high).
        threshold: float "VFH_THRESH" = 0.3, "1", 0.02..=5.0;
        /// Share of the threshold below which a blocked sector becomes free again (t_low / t_high, seven to eight tenths).
        hysteresis: float "VFH_HYST" = 0.7, "1", 0.1..=1.0;
        /// Free space kept beyond the vehicle's radius (d_safe).
        safety_m: float "VFH_SAFETY" = 0.1, "m", 0.0..=0.5;
        /// Radius of the active window: obstacles farther away do not steer.
        window_m: float "VFH_WINDOW" = 1.6, "m", 0.6..=3.0;
        /// Openings of fewer sectors of 5 degrees are passed in the middle (s_max).
        wide_sectors: int "VFH_WIDE" = 16, "1", 2..=36;
        /// Cost of turning away from the target (Ulrich and Borenstein 1998: 5).
        cost_target: float "VFH_COST_TARGET" = 5.0, "1", 0.0..=20.0;
        /// Cost of turning away from the present motion (2).
        cost_motion: float "VFH_COST_MOTION" = 2.0, "1", 0.0..=20.0;
        /// Cost of turning away from the last choice (2).
        cost_previous: float "VFH_COST_PREV" = 2.0, "1", 0.0..=20.0;
        /// Certainty added to the cell of a return.
        hit: int "VFH_HIT" = 3, "1", 1..=15;
        /// Certainty taken from the cells before it.
        free: int "VFH_FREE" = 1, "1", 0..=15;
        /// Half-life of cells that were seen a few times only: people, noise.
        fresh_half_life_s: float "VFH_DECAY_FRESH" = 2.0, "s", 0.5..=60.0;
        /// Half-life of cells that are certain: furniture. Long, so that a dead end stays known while it is left.
        certain_half_life_s: float "VFH_DECAY_SURE" = 40.0, "s", 1.0..=600.0;
        /// Deceleration that braking counts on.
        brake_mps2: float "VFH_BRAKE" = 1.5, "m/s2", 0.3..=5.0;
        /// Time from an obstacle's echo to the first braking (scan, dead time, tilt).
        latency_s: float "VFH_LATENCY" = 0.25, "s", 0.0..=1.0;
        /// Largest speed into a direction that no ranger has looked into for a second.
        blind_mps: float "VFH_BLIND_SPD" = 0.35, "m/s", 0.05..=1.0;
        /// Distance between hull and obstacle at which manual flight is stopped.
        manual_stop_m: float "VFH_MANUAL_STOP" = 0.3, "m", 0.05..=1.0;
    }
}
