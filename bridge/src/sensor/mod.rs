//! Readings of sensors as samples for the estimator.

pub mod ring;
