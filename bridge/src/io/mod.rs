//! The shell: the only place that knows threads, sockets, serial ports and clocks.
//!
//! | File | Does |
//! | --- | --- |
//! | [`endpoint`] | endpoint URLs: `udpserver://host:port`, `serial:///dev/ttyAMA0?baudrate=115200` ... |
//! | [`net`] | MAVLink links on a thread of their own; bytes in, bytes out, bounded queues |
//! | [`host`] | how the computer is: heat, clock, log |
//! | [`doctor`] | what a computer lacks: devices, permissions, real time, clock, disk |
//! | [`lockstep`] | simulator, `Flight` and `Ground` stepped in one thread: real, scaled or virtual time |
//! | [`firmware`] | Betaflight's simulator build as a child process in place of the fake controller |
//! | [`bench_line`] | a controller on the bench, one question at a time: `kestrel fc` |
//! | [`passthrough`] | a configurator on the controller's line, by TCP: `kestrel fc passthrough` |
//! | [`flight_thread`] | the thread that owns the real flight controller's line |
//! | [`sensors`] | a thread for each device of `--sensor` |
//! | [`gpio`] | trigger and echo lines, edges stamped by the kernel |
//! | [`terminal`] | pseudo terminals that simulated devices speak on |
//! | [`mod@line`] | that line: serial port or TCP connection, whole frames or nothing |
//! | [`realtime`] | SCHED_FIFO, locked memory, timer slack, where allowed |
//! | `camera` | the thread of the camera: pictures to browsers and ground stations |
//! | [`clock`] | the only reader of the clock |
//! | [`timer`] | an absolute timer to wait for in `poll` |
//! | [`inject`] | MAV_CMD_INJECT_FAILURE in the simulator |
//! | [`watchdog`] | signs of life for systemd |
//! | [`truth`] | `--truth` CSV: the only reader of the simulator's truth |
//! | [`logger`] | flight logs on disk, by a thread of their own |
//! | [`uquad_thread`] | uQuad for real: the thread of its inertial unit, the thread of its motors |
//! | [`uquad_lockstep`] | uQuad in the simulator: inertial unit, motor driver, aircraft, in one thread |
//! | [`folder`] | flight logs and uploads on disk, safe from names and links |
//! | [`keep`] | documents on disk, written atomically |

pub mod bench_line;
#[cfg(feature = "video")]
pub mod camera;
#[cfg(feature = "video")]
mod camera_feed;
#[cfg(feature = "video")]
mod camera_rtp;
pub mod clock;
pub mod doctor;
pub mod endpoint;
pub mod firmware;
pub mod flight_thread;
pub mod folder;
pub mod gpio;
pub mod host;
pub mod inject;
pub mod keep;
pub mod line;
pub mod lockstep;
pub mod logger;
pub mod net;
pub mod passthrough;
pub mod realtime;
pub mod route;
pub mod sensors;
pub mod terminal;
pub mod timer;
pub mod truth;
pub mod uquad_lockstep;
pub mod uquad_logs;
pub mod uquad_thread;
pub mod watchdog;
