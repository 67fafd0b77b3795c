//! MAV_CMD numbers and results.
