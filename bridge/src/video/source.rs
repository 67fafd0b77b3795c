//! Where the picture comes from, as the command line names it (`--camera`).

use std::path::PathBuf;
use std::str::FromStr;
use thiserror::Error;

/// A source of pictures. All but the simulator's deliver H.264, which is passed on as it is.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraSource {
    /// A program that writes H.264 (annex B) to its standard output; it runs while somebody watches.
    Command(String),
    /// A recording, H.264 (annex B), played again and again.
    File {
        /// Where.
        path: PathBuf,
        /// Pictures a second; none: as the stream says, or 30.
        fps: Option<f64>,
    },
    /// An RTSP camera.
    Rtsp(String),
    /// The camera of the simulated vehicle.
    Simulator,
    /// Standard input, H.264 (annex B).
    Stdin {
        /// A recording, at this many pictures a second; none: live, as it comes.
        fps: Option<f64>,
    },
}

/// Why it is no source.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "`{0}` is no camera: write sim, file:PATH, - (standard input), exec:COMMAND, v4l2:DEVICE, rpicam or rtsp://HOST/PATH; recordings take ?fps=N"
)]
pub struct NoSource(String);

impl FromStr for CameraSource {
    type Err = NoSource;

    fn from_str(text: &str) -> Result<Self, NoSource> {
        let wrong = || NoSource(text.to_owned());
        let timed = |s: &str| -> Result<(String, Option<f64>), NoSource> {
            let Some((name, option)) = s.rsplit_once('?') else {
                return Ok((s.to_owned(), None));
            };
            let fps = option
                .strip_prefix("fps=")
                .and_then(|v| v.parse::<f64>().ok())
                .filter(|v| (1.0..=120.0).contains(v))
                .ok_or_else(wrong)?;
            Ok((name.to_owned(), Some(fps)))
        };
        let some = |s: &str| {
            if s.trim().is_empty() {
                Err(wrong())
            } else {
                Ok(s.to_owned())
            }
        };
        if text == "sim" {
            return Ok(Self::Simulator);
        }
        if text == "-" || text.starts_with("-?") {
            return Ok(Self::Stdin {
                fps: timed(text)?.1,
            });
        }
        if text == "rpicam" {
            return Ok(Self::Command(RPICAM.to_owned()));
        }
        if text.starts_with("rtsp://") && text.len() > "rtsp://".len() {
            return Ok(Self::Rtsp(text.to_owned()));
        }
        match text.split_once(':').ok_or_else(wrong)? {
            ("exec", command) => Ok(Self::Command(some(command)?)),
            ("file", rest) => {
                let (path, fps) = timed(rest)?;
                let path = PathBuf::from(some(&path)?);
                Ok(Self::File { path, fps })
            }
            ("v4l2", device)
                if device.starts_with('/') && !device.contains(char::is_whitespace) =>
            {
                Ok(Self::Command(v4l2(device)))
            }
            _ => Err(wrong()),
        }
    }
}

impl CameraSource {
    /// What stations are told of it.
    #[must_use]
    pub const fn describe(&self) -> &'static str {
        match self {
            Self::Command(_) => "camera program",
            Self::File { .. } => "recording",
            Self::Rtsp(_) => "RTSP camera",
            Self::Simulator => "simulated camera",
            Self::Stdin { .. } => "standard input",
        }
    }
}

/// The camera of a Raspberry Pi: parameter sets before every key picture, one a second.
const RPICAM: &str = "rpicam-vid --timeout 0 --nopreview --codec h264 --profile baseline --inline --intra 30 --flush --width 640 --height 480 --framerate 30 --output -";

/// A USB camera that gives raw pictures or MJPEG, by ffmpeg.
fn v4l2(device: &str) -> String {
    format!(
        "ffmpeg -loglevel error -fflags nobuffer -f v4l2 -framerate 30 -video_size 640x480 -i {device} -an -c:v libx264 \
         -profile:v baseline -preset ultrafast -tune zerolatency -pix_fmt yuv420p -g 30 -b:v 1500k -f h264 -"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_named_as_the_help_says() {
        let parse = |s: &str| s.parse::<CameraSource>().unwrap();
        assert_eq!(parse("sim"), CameraSource::Simulator);
        assert_eq!(parse("-"), CameraSource::Stdin { fps: None });
        assert_eq!(parse("-?fps=25"), CameraSource::Stdin { fps: Some(25.0) });
        assert_eq!(
            parse("file:/a/b.h264?fps=10"),
            CameraSource::File {
                path: "/a/b.h264".into(),
                fps: Some(10.0)
            }
        );
        assert_eq!(
            parse("exec:cat x"),
            CameraSource::Command("cat x".to_owned())
        );
        assert!(
            matches!(parse("v4l2:/dev/video0"), CameraSource::Command(c) if c.contains("-i /dev/video0 "))
        );
        assert!(matches!(parse("rtsp://cam/1"), CameraSource::Rtsp(_)));
        for wrong in [
            "",
            "x",
            "file:",
            "exec:  ",
            "-?fps=0",
            "v4l2:/dev/video0; rm",
            "http://x",
            "rtsp://",
        ] {
            let e = wrong.parse::<CameraSource>().unwrap_err();
            assert!(e.to_string().contains("is no camera"), "{wrong}");
        }
    }
}
