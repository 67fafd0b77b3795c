//! `kestrel video`: what players need to know of the picture, and a recording to try things with.

use super::rooms;
use anyhow::{Context as _, Result};
use bridge::io::camera::SIZE;
use bridge::io::clock::{self, thread_cpu_ns};
use bridge::video::encode::{Encoder, EncoderSettings};
use bridge::video::rtp;
use clap::{Args, Subcommand};
use sim::camera::{Camera, Picture, stamp};
use sim::{Room, SimConfig, Simulator};
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use vehicle::{In, RingConfig};

/// The camera's picture.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel video sdp > video.sdp; ffplay -protocol_whitelist file,rtp,udp video.sdp      beside: kestrel sim --video-to 127.0.0.1\n  kestrel video clip office -o clip.h264; kestrel sim --camera file:clip.h264"
)]
pub(crate) struct VideoArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Print the session description by which a player receives what --video-to sends.
    Sdp {
        /// Where it is sent to.
        #[arg(long, default_value = "127.0.0.1")]
        host: String,
        /// Its port.
        #[arg(long, default_value_t = 5600)]
        port: u16,
    },
    /// Write a recording: the simulated camera turns once on the spot, at home in a room. Says what a picture costs.
    Clip {
        /// A bundled room.
        #[arg(default_value = "office")]
        room: String,
        /// File to write, H.264 (annex B).
        #[arg(short, long, value_name = "FILE.h264")]
        output: PathBuf,
        /// How long.
        #[arg(long, default_value_t = 10.0, value_name = "S")]
        seconds: f64,
    },
}

pub(crate) fn run(args: &VideoArgs) -> Result<ExitCode> {
    let mut out = std::io::stdout().lock();
    match &args.what {
        What::Sdp { host, port } => write!(out, "{}", rtp::sdp(host, *port))?,
        What::Clip {
            room,
            output,
            seconds,
        } => {
            let file = File::create(output)
                .with_context(|| format!("cannot write {}", output.display()))?;
            let words = clip(rooms::bundled(room)?, *seconds, &mut BufWriter::new(file))?;
            writeln!(out, "{}: {words}", output.display())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn clip(room: Room, seconds: f64, file: &mut impl std::io::Write) -> Result<String> {
    let settings = EncoderSettings::default();
    let count = (seconds.clamp(0.1, 600.0) * settings.fps) as u64;
    let sim = Simulator::new(SimConfig::new(room, RingConfig::built_in("tof32")?, 1))?;
    let mut shot = sim.shot(0);
    shot.eye = shot.eye.with_z(1.0);
    let mut camera = Camera::new(sim.scenery());
    let mut picture = Picture::new(SIZE[0], SIZE[1]);
    let mut encoder = Encoder::new(settings)?;
    let (mut drawing_ns, mut coding_ns, mut bytes) = (0, 0, 0);
    let begin_ms = clock::utc_us() / 1000;
    for n in 0..count {
        let turn = n as f64 / count as f64 * core::f64::consts::TAU;
        let (s, c) = libm::sincos(turn);
        shot.axes = [
            In::new(c, s, 0.0),
            In::new(s, -c, 0.0),
            In::new(0.0, 0.0, -1.0),
        ];
        let at_ms = (n as f64 * 1000.0 / settings.fps) as u64;
        let begin = thread_cpu_ns();
        camera.render(&shot, &mut picture);
        stamp(&mut picture, begin_ms + at_ms);
        let drawn = thread_cpu_ns();
        // A key picture every second: a viewer may come at any time.
        let is_key = n % settings.fps as u64 == 0;
        let unit = encoder.encode(&picture, at_ms, is_key)?;
        drawing_ns += drawn - begin;
        coding_ns += thread_cpu_ns() - drawn;
        if let Some(unit) = unit {
            file.write_all(&unit.annex_b)?;
            bytes += unit.annex_b.len();
        }
    }
    file.flush()?;
    let ms = |ns: u64| ns as f64 * 1e-6 / count as f64;
    Ok(format!(
        "{count} pictures, {:.0} kbit/s; drawing one takes {:.2} ms of processor, coding it {:.2} ms",
        bytes as f64 * 8e-3 * settings.fps / count as f64,
        ms(drawing_ns),
        ms(coding_ns)
    ))
}
