//! The operator's console: one HTTPS listener that serves the page, the accounts and one WebSocket per page.
//!
//! It runs on a thread of its own and meets the rest of the program in two places only: a page is one more MAVLink station
//! (its socket joins [`Links`](crate::io::net::Links)), and what MAVLink is too coarse for is shown to it as a [`Picture`]
//! that the main thread puts down and never waits for. There is no command path beside MAVLink.
//!
//! | File | Does |
//! | --- | --- |
//! | [`console`] | starts the thread; what the main thread holds |
//! | `aboard` | the vehicle this console is aboard of |
//! | `fleet`, `relay`, `upstream`, [`place`] | off the drone: several vehicles, each behind its own console |
//! | [`picture`] | what pages are shown |
//! | [`role`], [`envelope`], [`dead_man`], [`sessions`], [`throttle`] | pure: who may what, order and age of frames, released sticks, who is logged in, how often |
//! | [`topics`], [`recording`] | pure: the compact telemetry, byte by byte; a flight log as if it had been seen on a page |
//! | [`ledger`], [`password`], [`key`] | accounts and the audit log in SQLite, Argon2id, keys of programs |
//! | `listener`, `tls` | connections, limits, certificate |
//! | `gate` | host, origin, session and role of every request; headers of every answer |
//! | `routes` | the table of all routes and what each does |
//! | `socket`, `witness` | one page's WebSocket; what it asked for is written down |
//! | [`signal`] | the WebSocket of the camera's viewers |
//! | `pages` | the page's files, in the binary |

mod aboard;
pub mod console;
pub mod dead_man;
pub mod envelope;
mod fleet;
mod gate;
mod hex;
pub mod key;
pub mod ledger;
mod listener;
mod pages;
pub mod password;
pub mod picture;
pub mod place;
pub mod recording;
mod relay;
pub mod role;
mod routes;
pub mod sessions;
pub mod signal;
mod socket;
pub mod throttle;
mod tls;
pub mod topics;
mod upstream;
mod witness;

pub use console::{Console, ConsoleConfig, FleetConfig};
pub use picture::Picture;
pub use role::Role;
pub use routes::{about_vehicle, table as routes_table};
pub use tls::pin as certificate_pin;
