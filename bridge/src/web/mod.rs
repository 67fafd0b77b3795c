//! The operator's console: one HTTPS listener that serves the page, the accounts and one WebSocket per page.
//!
//! It runs on a thread of its own and meets the rest of the program in two places only: a page is one more MAVLink station
//! (its socket joins [`Links`](crate::io::net::Links)), and what MAVLink is too coarse for is shown to it as a [`Picture`]
//! that the main thread puts down and never waits for. There is no command path beside MAVLink.
//!
//! | File | Does |
//! | --- | --- |
//! | [`console`] | starts the thread; what the main thread holds |
//! | [`picture`] | what pages are shown |
//! | [`role`], [`envelope`], [`dead_man`], [`sessions`], [`throttle`] | pure: who may what, order and age of frames, released sticks, who is logged in, how often |
//! | [`topics`] | pure: the compact telemetry, byte by byte |
//! | [`ledger`], [`password`] | accounts and the audit log in SQLite, Argon2id |
//! | `listener`, `tls` | connections, limits, certificate |
//! | `gate` | host, origin, session and role of every request; headers of every answer |
//! | `routes` | the table of all routes and what each does |
//! | `socket` | one page's WebSocket |
//! | [`signal`] | the WebSocket of the camera's viewers |
//! | `pages` | the page's files, in the binary |

pub mod console;
pub mod dead_man;
pub mod envelope;
mod gate;
pub mod ledger;
mod listener;
mod pages;
pub mod password;
pub mod picture;
pub mod role;
mod routes;
pub mod sessions;
pub mod signal;
mod socket;
pub mod throttle;
mod tls;
pub mod topics;

pub use console::{Console, ConsoleConfig};
pub use picture::Picture;
pub use role::Role;
pub use routes::table as routes_table;
