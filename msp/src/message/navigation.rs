//! What the controller's own navigation does: for watching, Kestrel does not fly by it.

use super::messages;

messages! {
    /// Way home by GPS.
    #[derive(Copy)]
    CompGps = COMP_GPS {
        /// Distance to home in m.
        distance_home_m: u16,
        /// Direction to home in degrees.
        direction_home_deg: i16,
        /// Toggles with each new position.
        update: u8,
    }

    /// Navigation of INAV.
    #[derive(Copy)]
    NavStatus = NAV_STATUS {
        /// 0 none, 1 position hold, 2 return home, 3 mission.
        mode: u8,
        /// State of the mode.
        state: u8,
        /// Action of the active way-point.
        active_wp_action: u8,
        /// Number of the active way-point.
        active_wp_number: u8,
        /// Why navigation cannot go on, 0 = nothing.
        error: u8,
        /// Heading to hold in degrees.
        heading_hold_target_deg: i16,
    }
}
