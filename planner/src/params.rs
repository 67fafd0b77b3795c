//! Tuning of missions, routes and evasion; obstacle avoidance has its own table in [`crate::vfh`].

vehicle::params! {
    /// Missions, routes, evasion. Names as in PX4 where PX4 has the parameter.
    pub struct PlannerParams {
        /// Speed on the way unless a mission says otherwise.
        cruise_mps: float "MPC_XY_CRUISE" = 0.7, "m/s", 0.1..=3.0;
        /// A waypoint counts as reached within this distance (chosen: half the 0.25 m that is promised, the other half is
        /// for the position estimate).
        acceptance_m: float "NAV_ACC_RAD" = 0.12, "m", 0.03..=2.0;
        /// Largest acceptance radius an item may ask for: stations fill in metres meant for open fields (MAVSDK 1 to 3 m),
        /// which indoors would count rooms as visited through their walls.
        acceptance_max_m: float "NAV_ACC_MAX" = 0.2, "m", 0.05..=5.0;
        /// Height error within which a waypoint or take-off counts as reached.
        acceptance_alt_m: float "NAV_MC_ALT_RAD" = 0.15, "m", 0.05..=1.0;
        /// Heading error within which a commanded heading counts as reached.
        yaw_acceptance_deg: float "MIS_YAW_ERR" = 10.0, "deg", 1.0..=90.0;
        /// How long a heading is waited for.
        yaw_timeout_s: float "MIS_YAW_TMT" = 8.0, "s", 0.5..=60.0;
        /// Free space kept around the vehicle's radius on a route, where there is room for it; half of it where there is not.
        /// (100 missions with eight sonars: one door post touched at 0.2 m, none at 0.24 m.)
        margin_m: float "ROUTE_MARGIN" = 0.24, "m", 0.0..=0.5;
        /// How much a route prefers the middle of the room: cost 1 + w exp(-3 (d - r)).
        clearance_weight: float "ROUTE_CLEAR_W" = 2.0, "1", 0.0..=10.0;
        /// Distance ahead on the route that is steered for.
        look_ahead_m: float "ROUTE_AHEAD" = 1.0, "m", 0.4..=3.0;
        /// Without 0.2 m of progress in this time the way is planned anew with what was seen.
        stuck_s: float "ROUTE_STUCK_T" = 5.0, "s", 1.0..=30.0;
        /// Give way to moving people while hovering and on the way.
        evade: bool "AVOID_EVADE" = true;
        /// Distance kept from the centre of a person, beyond both radii.
        evade_clearance_m: float "AVOID_CLEAR" = 0.45, "m", 0.2..=1.5;
        /// Radius of a person.
        person_radius_m: float "AVOID_PERSON_R" = 0.25, "m", 0.1..=0.6;
        /// Swing of the nose while hovering after somebody was seen, to look into the gaps between the rangers; 0 keeps it
        /// still. (The heading loop follows about 80 % of it: 32 degrees close the 45 degree gaps of four multizone sensors with two columns to spare.)
        look_deg: float "AVOID_LOOK" = 40.0, "deg", 0.0..=45.0;
        /// Swing all the time while hovering where no heading was asked for, not only after somebody was seen: a person who
        /// comes out of a gap is seen in time, and the place is known better.
        look_always: bool "AVOID_LOOK_ALL" = true;
        /// Time of one swing there and back. Of 240 people walking by, 5 came too near or sent the vehicle too far at 2.5 s, 7 at 4.5 s.
        look_period_s: float "AVOID_LOOK_T" = 2.5, "s", 2.0..=20.0;
    }
}
