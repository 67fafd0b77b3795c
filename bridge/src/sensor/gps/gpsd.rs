//! gpsd's JSON protocol over TCP, as a client: TPV reports in, fixes out.

use super::RawFix;
use serde::Deserialize;
use vehicle::Timestamp;

/// Where gpsd listens.
pub const PORT: u16 = 2947;
/// What a client says first.
pub const WATCH: &[u8] = b"?WATCH={\"enable\":true,\"json\":true};\n";
/// Longest line (gpsd's own limit); a longer one is dropped whole.
const LONGEST: usize = 10_240;

/// A report, with what of it we use. Everything else may come and is not looked at.
#[derive(Debug, Deserialize)]
struct Report {
    class: String,
    #[serde(default)]
    mode: u8,
    lat: Option<f64>,
    lon: Option<f64>,
    #[serde(rename = "altMSL")]
    alt_msl: Option<f64>,
    alt: Option<f64>,
    speed: Option<f64>,
    track: Option<f64>,
    climb: Option<f64>,
    epx: Option<f64>,
    epy: Option<f64>,
    epv: Option<f64>,
    #[serde(rename = "uSat")]
    used: Option<u8>,
    time: Option<String>,
}

/// The driver.
#[derive(Clone, Debug, Default)]
pub struct Gpsd {
    line: Vec<u8>,
    is_too_long: bool,
    satellites: u8,
    /// Time of the last report: one that repeats it is old.
    time: Option<String>,
    /// Lines that were no JSON.
    pub garbled: u64,
}

impl Gpsd {
    /// Takes bytes that were read at a time.
    pub fn bytes(&mut self, at: Timestamp, bytes: &[u8], out: &mut impl FnMut(Timestamp, RawFix)) {
        for byte in bytes {
            match byte {
                b'\n' => {
                    let line = core::mem::take(&mut self.line);
                    if !core::mem::take(&mut self.is_too_long) {
                        self.report(at, &line, out);
                    }
                    self.line = line;
                    self.line.clear();
                }
                _ if self.line.len() >= LONGEST => self.is_too_long = true,
                _ => self.line.push(*byte),
            }
        }
    }

    fn report(&mut self, at: Timestamp, line: &[u8], out: &mut impl FnMut(Timestamp, RawFix)) {
        if line.iter().all(u8::is_ascii_whitespace) {
            return;
        }
        let Ok(r) = serde_json::from_slice::<Report>(line) else {
            self.garbled += 1;
            return;
        };
        match r.class.as_str() {
            "SKY" => self.satellites = r.used.unwrap_or(self.satellites),
            "TPV" => {
                if r.time.is_some() && r.time == self.time {
                    return;
                }
                let doubt_m = match (r.epx, r.epy, r.epv) {
                    (Some(x), Some(y), Some(v)) => Some([x, y, v]),
                    _ => None,
                };
                let has_place = r.lat.is_some() && r.lon.is_some();
                out(
                    at,
                    RawFix {
                        mode: if has_place { r.mode } else { 0 },
                        place_deg: [r.lat.unwrap_or(0.0), r.lon.unwrap_or(0.0)],
                        altitude_m: r.alt_msl.or(r.alt).unwrap_or(f64::NAN),
                        speed_mps: r.speed,
                        track_deg: r.track,
                        climb_mps: r.climb,
                        doubt_m,
                        satellites: self.satellites,
                    },
                );
                self.time = r.time;
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const VERSION: &str =
        r#"{"class":"VERSION","release":"3.25","rev":"3.25","proto_major":3,"proto_minor":15}"#;
    const SKY: &str = r#"{"class":"SKY","device":"/dev/ttyACM0","nSat":12,"uSat":9,"satellites":[{"PRN":5,"used":true}]}"#;
    const TPV: &str = r#"{"class":"TPV","device":"/dev/ttyACM0","mode":3,"time":"2026-03-01T10:00:00.000Z","ept":0.005,"lat":-34.919363,"lon":-56.167382,"altHAE":50.1,"altMSL":40.5,"alt":40.5,"epx":2.1,"epy":3.2,"epv":6.4,"track":45.0,"speed":1.5,"climb":-0.2}"#;

    fn read(gpsd: &mut Gpsd, text: &str) -> Vec<RawFix> {
        let mut out = Vec::new();
        gpsd.bytes(Timestamp::from_ms(1), text.as_bytes(), &mut |_, fix| {
            out.push(fix)
        });
        out
    }

    #[test]
    fn a_golden_report_is_a_fix() {
        let out = read(
            &mut Gpsd::default(),
            &format!("{VERSION}\r\n{SKY}\r\n{TPV}\r\n"),
        );
        assert_eq!(
            out,
            [RawFix {
                mode: 3,
                place_deg: [-34.919363, -56.167382],
                altitude_m: 40.5,
                speed_mps: Some(1.5),
                track_deg: Some(45.0),
                climb_mps: Some(-0.2),
                doubt_m: Some([2.1, 3.2, 6.4]),
                satellites: 9,
            }]
        );
    }

    #[test]
    fn the_same_report_again_is_old_and_one_without_doubt_has_none() {
        let mut gpsd = Gpsd::default();
        assert_eq!(read(&mut gpsd, &format!("{TPV}\n{TPV}\n")).len(), 1);
        let no_doubt = r#"{"class":"TPV","mode":3,"lat":1.0,"lon":2.0,"alt":3.0}"#;
        assert_eq!(read(&mut gpsd, &format!("{no_doubt}\n"))[0].doubt_m, None);
        assert_eq!(
            read(&mut gpsd, "{\"class\":\"TPV\",\"mode\":3}\n")[0].mode,
            0
        );
    }

    #[test]
    fn a_line_that_never_ends_is_dropped_whole() {
        let mut gpsd = Gpsd::default();
        let out = read(&mut gpsd, &format!("{}{TPV}\n{TPV}\n", "x".repeat(20_000)));
        assert_eq!((out.len(), gpsd.line.capacity() <= 2 * LONGEST), (1, true));
    }

    proptest! {
        #[test]
        fn cut_anywhere_and_with_any_bytes_between_it_reads_the_same(noise in "[^\n]{0,80}", size in 1usize..50) {
            let text = format!("{noise}\n{TPV}\n");
            let (mut gpsd, mut out) = (Gpsd::default(), Vec::new());
            for chunk in text.as_bytes().chunks(size) {
                gpsd.bytes(Timestamp::ZERO, chunk, &mut |_, fix| out.push(fix));
            }
            prop_assert_eq!(out.len(), 1);
        }
    }
}
