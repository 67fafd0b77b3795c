//! The camera's picture: from a source, coded once, to browsers by WebRTC and to ground stations by RTP.
//!
//! ```text
//! simulator --pictures--> encode --+
//! file, pipe, program, RTSP -------+--access units--> viewers (WebRTC, browsers)
//!                        (annex_b) |
//!                                  +----------------> rtp (UDP, ground stations)
//! ```
//!
//! Everything runs on a thread of its own, `camera` ([`crate::io::camera`]), at a low priority, and only while somebody watches. No
//! picture is stored.
//!
//! | File | Does |
//! | --- | --- |
//! | [`annex_b`] | bytes to NAL units to pictures |
//! | [`encode`] | pictures of the simulator to H.264 |
//! | [`rtp`] | pictures to RTP packets and back |
//! | [`rtsp`] | a client of RTSP cameras |
//! | [`signalling`] | the words of a WebRTC session |
//! | [`source`] | what `--camera` names |
//! | [`sps`] | size and rate of a stream |
//! | [`viewers`] | WebRTC sessions |

pub mod annex_b;
pub mod encode;
pub mod rtp;
pub mod rtsp;
pub mod signalling;
pub mod source;
pub mod sps;
pub mod viewers;

pub use source::{CameraSource, NoSource};
