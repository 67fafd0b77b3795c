//! The bridge: flight controller on one side, ground on the other, the autopilot between them.
//!
//! | Module | Holds |
//! | --- | --- |
//! | [`autopilot`] | the brain: [`Flight`](autopilot::flight::Flight), [`Ground`](autopilot::ground::Ground) and the typed [`door`](autopilot::door) between them |
//! | [`experiment`] | fault-injection campaigns in virtual time, judged by truth |
//! | [`fc`] | towards the flight controller: MSP schedule, unit conversion, RC output |
//! | [`gcs`] | towards the ground: one MAVLink service per file |
//! | [`log`] | flight logs: what is recorded, how it is written, read and flown again |
//! | [`motor`] | towards motors without a flight controller: uQuad's driver on I2C |
//! | [`sensor`] | readings of range finders as scans |
//! | [`settings`] | every parameter of every component, with where its value came from |
//! | [`station`] | a small ground station: what `demo` and the tests fly with |
//! | [`uquad`] | uQuad's loop: frames of its inertial unit to motor speeds |
//! | `video` | the camera's picture: sources, H.264, WebRTC, RTP (feature `video`) |
//! | [`io`] | the shell: threads, sockets, serial ports, clocks |
//! | [`web`] | the operator's console: one page, one WebSocket, accounts |

pub mod autopilot;
pub mod experiment;
pub mod fc;
pub mod gcs;
pub mod io;
pub mod log;
pub mod motor;
pub mod sensor;
pub mod settings;
pub mod station;
pub mod uquad;
#[cfg(feature = "video")]
pub mod video;
pub mod web;
