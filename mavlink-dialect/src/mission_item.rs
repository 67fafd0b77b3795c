//! Mission items typed, or the reason why not.
