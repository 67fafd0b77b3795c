//! Everything that can be tuned in obstacle avoidance.

vehicle::param_choice! {
    /// How a direction is chosen among what was seen.
    pub enum VfhVariant {
        /// VFH+ with a memory, ways planned anew and a look ahead: what flies.
        Plus = 0, "plus";
        /// SNSI's histogram of 2018 as its thesis prints it ([`thesis`](crate::vfh::thesis)).
        Thesis = 1, "thesis";
        /// SNSI's first planner, a potential field ([`potential`](crate::potential)).
        Potential = 2, "potential";
    }
}

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
        /// Half-life of cells that were seen a few times only: people, noise. Longer than a ring with gaps needs to look again.
        fresh_half_life_s: float "VFH_DECAY_FRESH" = 6.0, "s", 0.5..=60.0;
        /// Half-life of cells that are certain: furniture. Long, so that a dead end stays known while it is left.
        certain_half_life_s: float "VFH_DECAY_SURE" = 40.0, "s", 1.0..=600.0;
        /// Deceleration that braking counts on.
        brake_mps2: float "VFH_BRAKE" = 1.5, "m/s2", 0.3..=5.0;
        /// Time from an obstacle's echo to the first braking (scan, dead time, tilt).
        latency_s: float "VFH_LATENCY" = 0.25, "s", 0.0..=1.0;
        /// Largest speed into a direction that no ranger has looked into for a second.
        blind_mps: float "VFH_BLIND_SPD" = 0.35, "m/s", 0.05..=1.0;
        /// Distance between hull and obstacle at which manual flight is stopped.
        manual_stop_m: float "VFH_MANUAL_STOP" = 0.35, "m", 0.05..=1.0;
        /// How a direction is chosen: `plus` flies; `thesis` (SNSI's histogram) and `potential` (its first planner) are there
        /// to compare with. These two forget nothing, plan nothing anew and run into what their papers say they run into.
        variant: choice<VfhVariant> "VFH_VARIANT" = VfhVariant::Plus;
        /// Brake before obstacles also with a variant that would not by itself. Off only to see it fail.
        guard: bool "VFH_GUARD" = true;
        /// Variant `thesis`: density up to which a sector belongs to a valley. High flies close, low loses narrow passages.
        thesis_threshold: float "VFH_TH_THRESH" = 2.0, "1", 0.0..=1000.0;
        /// Variant `potential`: attraction (eps), force for each metre to the goal.
        potential_attraction: float "POT_ATTRACT" = 0.0625, "1", 0.001..=10.0;
        /// Variant `potential`: repulsion (eta) of each certain cell. The program's 5 counts in cells of its map.
        potential_repulsion: float "POT_REPEL" = 0.02, "1", 0.0..=10.0;
        /// Variant `potential`: obstacles farther away do not repel (rho).
        potential_reach_m: float "POT_REACH" = 1.0, "m", 0.1..=3.0;
    }
}
