//! `--camera` and `--video-to`: the picture of this program's own camera.

use super::{Usage, video};
use anyhow::Result;
use bridge::autopilot::ground::Ground;
use bridge::web::signal::Desk;
use clap::Args;
use sim::camera::{Scenery, Shot};
use std::net::{IpAddr, SocketAddr, ToSocketAddrs as _};
use std::sync::Arc;

/// The camera.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct CameraArgs {
    /// Where the picture comes from: sim (the simulator's own), none, file:PATH.h264 (played again and again), - (H.264 on
    /// standard input), exec:COMMAND (its output, while somebody watches), rtsp://HOST/PATH, rpicam, v4l2:/dev/video0. H.264 is passed on as it
    /// is. Browsers see it in the console; default: sim in the simulator, none in flight.
    #[arg(
        long,
        value_name = "SOURCE",
        conflicts_with = "video",
        allow_hyphen_values = true
    )]
    camera: Option<String>,
    /// Send the camera's picture to a ground station too (RTP, H.264; repeatable): HOST[:PORT], port 5600 if none is named.
    /// Stations are told of it.
    #[arg(long, value_name = "HOST[:PORT]")]
    video_to: Vec<String>,
    /// Where the picture of another program's camera is to be had: rtsp://..., or udp://:PORT for RTP. Stations are told.
    #[arg(long, value_name = "URL")]
    video: Option<String>,
}

/// The camera's thread, or nothing: a build without video has none.
pub(crate) struct CameraSeat {
    #[cfg(feature = "video")]
    thread: Option<bridge::io::camera::CameraThread>,
}

impl CameraArgs {
    /// Starts the camera, if there is one, and tells the ground of it. `listen`: where the console is; `scenery`: of a simulator.
    #[cfg(feature = "video")]
    pub(crate) fn start(
        &self,
        ground: &mut Ground,
        listen: Option<IpAddr>,
        scenery: Option<Scenery>,
    ) -> Result<CameraSeat> {
        use bridge::gcs::camera::VideoStream;
        use bridge::io::camera::{CameraConfig, CameraError, CameraThread, SIZE};
        use bridge::video::CameraSource;
        use bridge::video::encode::EncoderSettings;
        ground.set_video(video(self.video.as_deref())?);
        let stations = self.stations()?;
        let named = match self.camera.as_deref() {
            Some("none") => None,
            Some(text) => Some(text),
            None if scenery.is_some() && self.video.is_none() => Some("sim"),
            None => None,
        };
        let Some(named) = named else {
            if !stations.is_empty() {
                return Err(Usage(
                    "--video-to sends the camera's picture: name one by --camera".to_owned(),
                )
                .into());
            }
            return Ok(CameraSeat { thread: None });
        };
        let source: CameraSource = named
            .parse()
            .map_err(|e: bridge::video::NoSource| Usage(e.to_string()))?;
        let encoder = EncoderSettings::default();
        if let Some(first) = stations.first() {
            let drawn = (source == CameraSource::Simulator).then_some(SIZE.map(|v| v as u16));
            ground.set_video(Some(VideoStream::rtp(
                first.port(),
                drawn,
                encoder.fps as f32,
                encoder.bits_per_s,
            )));
        }
        // Nobody to show it to.
        if listen.is_none() && stations.is_empty() {
            return Ok(CameraSeat { thread: None });
        }
        let config = CameraConfig {
            source,
            scenery,
            listen,
            stations,
            encoder,
        };
        match CameraThread::start(config) {
            Ok(thread) => Ok(CameraSeat {
                thread: Some(thread),
            }),
            Err(e @ CameraError::NoScenery) => Err(Usage(e.to_string()).into()),
            Err(e) => Err(e.into()),
        }
    }

    /// A build without video refuses to promise any.
    #[cfg(not(feature = "video"))]
    pub(crate) fn start(
        &self,
        ground: &mut Ground,
        _: Option<IpAddr>,
        _: Option<Scenery>,
    ) -> Result<CameraSeat> {
        ground.set_video(video(self.video.as_deref())?);
        let wants = self.camera.as_deref().is_some_and(|c| c != "none");
        if wants || !self.stations()?.is_empty() {
            let why = "this program was built without video: build it with default features, or leave --camera and --video-to out";
            return Err(Usage(why.to_owned()).into());
        }
        Ok(CameraSeat {})
    }

    fn stations(&self) -> Result<Vec<SocketAddr>> {
        let all = self.video_to.iter().map(|text| {
            let with_port = text
                .to_socket_addrs()
                .or_else(|_| (text.trim_matches(['[', ']']), 5600).to_socket_addrs());
            with_port
                .ok()
                .and_then(|mut found| found.next())
                .ok_or_else(|| {
                    Usage(format!(
                        "--video-to {text}: no such host; write HOST or HOST:PORT"
                    ))
                    .into()
                })
        });
        all.collect()
    }
}

#[cfg(feature = "video")]
impl CameraSeat {
    /// How the console reaches it.
    pub(crate) fn desk(&self) -> Option<Arc<dyn Desk>> {
        self.thread.as_ref().map(|t| t.desk())
    }

    /// Puts down a shot if one is wanted now.
    pub(crate) fn show(&mut self, shot: impl FnOnce() -> Option<Shot>) {
        if let Some(thread) = &mut self.thread
            && thread.wants_shot()
            && let Some(shot) = shot()
        {
            thread.show(shot);
        }
    }

    /// The next line for the terminal.
    pub(crate) fn poll_told(&self) -> Option<String> {
        self.thread.as_ref()?.poll_told()
    }
}

#[cfg(not(feature = "video"))]
impl CameraSeat {
    pub(crate) const fn desk(&self) -> Option<Arc<dyn Desk>> {
        None
    }

    pub(crate) fn show(&mut self, _: impl FnOnce() -> Option<Shot>) {}

    pub(crate) const fn poll_told(&self) -> Option<String> {
        None
    }
}
