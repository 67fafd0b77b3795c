//! uQuad's streams as topics, and back to its text formats.
//!
//! | Topic | Text file | Row |
//! | --- | --- | --- |
//! | `/uquad/imu_raw` | `imu_raw.log` | 14 whole numbers: host s, host us, T_us, 3 acc, 3 gyro, 3 mag, temperature, pressure |
//! | `/uquad/kalman_in` | `kalman_in.log` | host time and what the filter is given |
//! | `/uquad/x_hat` | `x_hat.log` | host time and the filter's state |
//! | `/uquad/w` | `w.log` | host time and the four motor speeds |
//!
//! The whole numbers of `imu_raw` come back exactly, the others to the eight decimals of uQuad's files.

use super::writer::Container;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Names of the streams, as uQuad names its files.
pub const STREAMS: [&str; 4] = ["imu_raw", "kalman_in", "x_hat", "w"];

/// Writes uQuad's streams into an MCAP file.
#[derive(Debug)]
pub struct UquadLog {
    container: Container,
    channels: [Option<u16>; STREAMS.len()],
}

impl UquadLog {
    /// With its head: `facts` are version, files, matrices of gain and calibration.
    ///
    /// # Errors
    /// The library refuses; in memory it has no reason to.
    pub fn new(facts: &[(&str, String)]) -> mcap::McapResult<Self> {
        let mut container = Container::new()?;
        let facts = facts
            .iter()
            .map(|(name, text)| ((*name).to_owned(), text.clone()))
            .collect();
        container.metadata("uquad", facts);
        let (name, schema) = super::schema::own("kestrel.Row");
        let channels = STREAMS.map(|stream| {
            let topic = format!("/uquad/{stream}");
            container.channel(&topic, "json", Some((name, "jsonschema", &schema)))
        });
        Ok(Self {
            container,
            channels,
        })
    }

    /// A row of a stream of [`STREAMS`]; `time` is the host's, s and us.
    pub fn row(&mut self, stream: usize, time: (u64, u64), values: &[f64]) {
        let ns = time.0 * 1_000_000_000 + time.1 * 1_000;
        let row = json!({ "sec": time.0, "usec": time.1, "row": values });
        let channel = self.channels.get(stream).copied().flatten();
        self.container
            .message(channel, ns, row.to_string().as_bytes());
    }

    /// The file.
    #[must_use]
    pub fn finish(mut self) -> Vec<u8> {
        self.container.finish();
        self.container.take()
    }
}

/// A row of a topic as a line of uQuad's text format.
#[must_use]
pub fn line(stream: &str, row: &Value) -> Option<String> {
    let mut out = format!("{}\t{}", row["sec"].as_u64()?, row["usec"].as_u64()?);
    for value in row["row"].as_array()? {
        let value = number(value)?;
        let _ = if stream == "imu_raw" {
            write!(out, "\t{value:.0}")
        } else {
            write!(out, "\t{value:.8}")
        };
    }
    out.push('\n');
    Some(out)
}

/// What is no number was written as null.
fn number(value: &Value) -> Option<f64> {
    if value.is_null() {
        return Some(f64::NAN);
    }
    value.as_f64()
}

#[cfg(test)]
mod tests {
    use super::super::reader::LogFile;
    use super::*;

    #[test]
    fn raw_frames_come_back_as_they_were() {
        let mut log = UquadLog::new(&[("calibration", "1 0 0".to_owned())]).unwrap();
        let raw = [
            10_001.0, -12.0, 3.0, 250.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 231.0, 101_325.0,
        ];
        log.row(0, (1_332_500_000, 123), &raw);
        log.row(2, (1_332_500_000, 124), &[0.125, f64::NAN]);
        let file = LogFile::read(&log.finish()).unwrap();
        assert_eq!(file.metadata["uquad"]["calibration"], "1 0 0");
        let (_, row) = file.values("/uquad/imu_raw").next().unwrap();
        assert_eq!(
            line("imu_raw", &row).unwrap(),
            "1332500000\t123\t10001\t-12\t3\t250\t0\t1\t2\t3\t4\t5\t231\t101325\n"
        );
        let (_, row) = file.values("/uquad/x_hat").next().unwrap();
        assert_eq!(
            line("x_hat", &row).unwrap(),
            "1332500000\t124\t0.12500000\tNaN\n"
        );
    }
}
