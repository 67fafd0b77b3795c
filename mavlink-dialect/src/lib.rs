//! mavlink-dialect
