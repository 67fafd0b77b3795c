//! Flight logs: what is recorded, how it is written, how it is read and flown again. Values and bytes only; files and
//! threads are in [`io::logger`](crate::io::logger).
//!
//! A flight leaves two files. The `.mcap` holds everything; the `.tlog` holds the MAVLink frames of all links, for ground stations.
//!
//! | Topic | Encoding, schema | Holds |
//! | --- | --- | --- |
//! | `/flight` | postcard, `kestrel.FlightStream` | every input and output of `Flight`, and the digest of its state at each tick: what a replay needs |
//! | `/state` | JSON, `kestrel.State` | mode, estimate, set point, sticks, battery, controller, latency: 20 a second |
//! | `/pose`, `/tf` | JSON, `foxglove.PoseInFrame`, `foxglove.FrameTransform` | the estimate on the plan: 10 a second |
//! | `/scan` | JSON, `foxglove.PointCloud` | ends of the range finders' beams about the vehicle: 5 a second |
//! | `/map` | JSON, `foxglove.Grid` | the floor plan, once |
//! | `/log` | JSON, `foxglove.Log` | what was told to the pilots |
//! | `/summary` | JSON, `kestrel.Summary` | after each landing: how the flight was |
//! | `/lost` | JSON, `kestrel.Lost` | records that found no room since the last of these |
//! | `/uquad/...` | JSON, `kestrel.Row` | uQuad's streams: `imu_raw`, `kalman_in`, `x_hat`, `w` ([`uquad`]) |
//!
//! Every file opens with the metadata records `kestrel` (version, seed, source) and `parameters` (value and origin of each), and with
//! the attachment `flight.postcard`, the [`Header`] a replay starts from.
//!
//! Frames of the 3D topics: `map` is the floor plan (x right, y up on paper, z up), `base` the body (x forward, y left, z up).

pub mod header;
pub mod plot;
pub mod reader;
pub mod record;
pub mod replay;
mod schema;
pub mod summary;
pub mod tlog;
mod topic;
pub mod uquad;
pub mod writer;

pub use header::Header;
pub use reader::LogFile;
pub use record::{Emitted, FlightRecord, GroundRecord, Part};
pub use writer::LogWriter;
