//! uQuad's own text logs of a live flight, one file for each stream, by a thread of their own: a disk that stands still costs the loop
//! nothing, and what it could not take is counted.
//!
//! | File | Row |
//! | --- | --- |
//! | `imu_raw.log` | every frame as it came: host s and us, period us, 9 counts, temperature, pressure; `--imu imu_raw.log` flies it again |
//! | `kalman_in.log` | converted: host s and us, 3 accelerations, 3 rates, 3 angles, height |
//! | `flags.log` | host s and us, then 1 or 0: the norm is that of gravity; that of the field; the gyro measures; the barometer measures |
//! | `x_hat.log` | the 12 states |
//! | `w.log` | us since the row before, the four speeds given to the motors, rad/s |
//! | `w_ctrl.log` | the same before limits and ramp: what the law asked for |
//! | `int.log` | the four integrals |
//! | `t_err.log` | host s and us, period s, errors counted so far |
//! | `err.log` | first every setting and matrix of this flight, then each message with its time; at the end what was lost |
//!
//! Host time is this program's clock from its start.

use crate::autopilot::door::{Event, Notice};
use crate::autopilot::io::FcBytes;
use crate::uquad::{Step, UquadConfig};
use estimator::imu::Calibration;
use estimator::imu::binary::BinaryDecoder;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use vehicle::Timestamp;

/// Records that wait for the disk at most: ten seconds of flight.
const RECORDS: usize = 2048;
/// Rows between two flushes.
const FLUSH_EVERY: u32 = 50;

/// The files, in the order of `Stream`.
pub const FILES: [&str; 9] = [
    "imu_raw.log",
    "kalman_in.log",
    "flags.log",
    "x_hat.log",
    "w.log",
    "w_ctrl.log",
    "int.log",
    "t_err.log",
    "err.log",
];

/// One of [`FILES`].
#[derive(Clone, Copy)]
enum Stream {
    ImuRaw,
    KalmanIn,
    Flags,
    XHat,
    W,
    WCtrl,
    Int,
    TimingErrors,
    Errors,
}

/// What the loop hands over.
#[allow(clippy::large_enum_variant, reason = "a box would allocate in flight")]
enum Record {
    Bytes(Timestamp, FcBytes),
    Step(Timestamp, Step),
    Event(Timestamp, Event),
}

/// The loop's end. Dropped, it lets the thread write what it has and waits for it.
#[derive(Debug)]
pub struct UquadLogs {
    records: Option<SyncSender<Record>>,
    thread: Option<JoinHandle<()>>,
    lost: Arc<AtomicU64>,
}

impl UquadLogs {
    /// Opens [`FILES`] in a folder, which is made; `head` begins `err.log`.
    ///
    /// # Errors
    /// A file cannot be made.
    pub fn open(folder: &Path, head: &str) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let mut sinks = Vec::new();
        for name in FILES {
            sinks.push(BufWriter::new(File::create(folder.join(name))?));
        }
        Self::writing_to(sinks, head)
    }

    /// Writes to these, in the order of [`FILES`].
    ///
    /// # Errors
    /// No thread is left.
    pub fn writing_to<W: Write + Send + 'static>(sinks: Vec<W>, head: &str) -> io::Result<Self> {
        let (records, taken) = sync_channel(RECORDS);
        let lost = Arc::new(AtomicU64::new(0));
        let mut writer = Writer {
            sinks,
            decoder: BinaryDecoder::new(false),
            row: String::with_capacity(512),
            since_flush: 0,
            lost: Arc::clone(&lost),
        };
        let head = head.to_owned();
        let thread = thread::Builder::new()
            .name("logs".to_owned())
            .spawn(move || writer.run(&head, &taken))?;
        Ok(Self {
            records: Some(records),
            thread: Some(thread),
            lost,
        })
    }

    /// Bytes of the inertial unit.
    pub fn bytes(&mut self, at: Timestamp, bytes: &FcBytes) {
        self.hand_over(Record::Bytes(at, bytes.clone()));
    }

    /// What they made.
    pub fn step(&mut self, at: Timestamp, step: Step) {
        self.hand_over(Record::Step(at, step));
    }

    /// What happened.
    pub fn event(&mut self, at: Timestamp, event: &Event) {
        self.hand_over(Record::Event(at, event.clone()));
    }

    /// Records that the disk was too slow for.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    fn hand_over(&mut self, record: Record) {
        if let Some(records) = &self.records
            && records.try_send(record).is_err()
        {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for UquadLogs {
    fn drop(&mut self) {
        self.records = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The thread's end. A full disk must not end a flight: errors of writing are not acted upon.
struct Writer<W> {
    sinks: Vec<W>,
    decoder: BinaryDecoder,
    row: String,
    since_flush: u32,
    lost: Arc<AtomicU64>,
}

impl<W: Write> Writer<W> {
    fn run(&mut self, head: &str, taken: &Receiver<Record>) {
        self.row.push_str(head);
        self.put(Stream::Errors);
        for record in taken {
            match record {
                Record::Bytes(at, bytes) => self.frames(at, &bytes),
                Record::Step(at, step) => self.step(at, &step),
                Record::Event(at, event) => self.event(at, &event),
            }
            self.since_flush += 1;
            if self.since_flush >= FLUSH_EVERY {
                self.flush();
            }
        }
        let lost = self.lost.load(Ordering::Relaxed);
        let _ = writeln!(self.row, "end: {lost} records lost to a slow disk");
        self.put(Stream::Errors);
        self.flush();
    }

    fn frames(&mut self, at: Timestamp, bytes: &[u8]) {
        for &byte in bytes {
            let Some(received) = self.decoder.push(byte) else {
                continue;
            };
            let f = received.frame;
            self.time(at);
            let _ = write!(self.row, "\t{}", f.since_previous_us);
            for count in [f.accel, f.gyro, f.mag].into_iter().flatten() {
                let _ = write!(self.row, "\t{count}");
            }
            let _ = writeln!(self.row, "\t{}\t{}", f.temperature_ddeg, f.pressure_pa);
            self.put(Stream::ImuRaw);
        }
    }

    fn step(&mut self, at: Timestamp, step: &Step) {
        let reading = &step.reading;
        let m = &reading.measured;
        self.time(at);
        self.numbers(m.accel_mps2.as_slice());
        self.numbers(m.gyro_radps.as_slice());
        let a = &m.angles;
        self.numbers(&[a.psi_rad, a.phi_rad, a.theta_rad, m.altitude_m]);
        self.end(Stream::KalmanIn);
        self.time(at);
        for flag in [
            reading.accel_is_good,
            reading.mag_is_good,
            reading.gyro_is_good,
            reading.baro_is_good,
        ] {
            let _ = write!(self.row, "\t{}", u8::from(flag));
        }
        self.end(Stream::Flags);
        self.numbers(&step.state[..12]);
        self.row.remove(0);
        self.end(Stream::XHat);
        for (speeds, stream) in [
            (&step.speeds_radps, Stream::W),
            (&step.asked_radps, Stream::WCtrl),
        ] {
            let _ = write!(self.row, "{}", step.elapsed_us);
            self.numbers(speeds);
            self.end(stream);
        }
        let _ = write!(self.row, "{}", step.elapsed_us);
        self.numbers(&step.integrals);
        self.end(Stream::Int);
    }

    fn event(&mut self, at: Timestamp, event: &Event) {
        if let Event::Notice(Notice::ImuPeriod { ms, errors }) = event {
            self.time(at);
            let _ = writeln!(self.row, "\t{:.6}\t{errors}", ms * 1e-3);
            self.put(Stream::TimingErrors);
        }
        let _ = match event {
            Event::Notice(notice) => writeln!(self.row, "{:.3} s: {notice}", at.s()),
            other => writeln!(self.row, "{:.3} s: {other:?}", at.s()),
        };
        self.put(Stream::Errors);
    }

    fn time(&mut self, at: Timestamp) {
        let us = at.us();
        let _ = write!(self.row, "{}\t{}", us / 1_000_000, us % 1_000_000);
    }

    fn numbers(&mut self, values: &[f64]) {
        for value in values {
            let _ = write!(self.row, "\t{value:.8}");
        }
    }

    fn end(&mut self, stream: Stream) {
        self.row.push('\n');
        self.put(stream);
    }

    fn put(&mut self, stream: Stream) {
        if let Some(sink) = self.sinks.get_mut(stream as usize) {
            let _ = sink.write_all(self.row.as_bytes());
        }
        self.row.clear();
    }

    fn flush(&mut self) {
        self.since_flush = 0;
        for sink in &mut self.sinks {
            let _ = sink.flush();
        }
    }
}

/// Every setting and matrix of a flight, as `err.log` begins.
#[must_use]
pub fn head(program: &str, imu: &str, calibration: &Calibration, config: &UquadConfig) -> String {
    let mut out = format!(
        "{program}, inertial unit {imu}\n\nproportional gains, (rad/s) per unit, motors by states:\n"
    );
    for row in config.gains.matrix.row_iter() {
        let words: Vec<String> = row.iter().map(|v| format!("{v:.8}")).collect();
        let _ = writeln!(out, "{}", words.join("\t"));
    }
    let _ = writeln!(out, "\nintegral action:\n{:#?}", config.integral);
    let _ = writeln!(
        out,
        "\nhover {:.5} rad/s, speeds {:.2} to {:.2} rad/s, {} samples an action, start {:?}",
        config.hover_radps,
        config.speed_range_radps.0,
        config.speed_range_radps.1,
        config.steps_per_action,
        config.start
    );
    let _ = writeln!(out, "\ncalibration of the inertial unit:\n{calibration:#?}");
    let _ = writeln!(out, "\nits chain:\n{:#?}", config.imu);
    let _ = writeln!(out, "\nfilter:\n{:#?}\n", config.filter);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uquad::Uquad;
    use estimator::imu::RawFrame;
    use std::sync::Mutex;

    /// A disk that stands still while somebody else holds it.
    #[derive(Clone, Default)]
    struct Disk(Arc<Mutex<Vec<u8>>>);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn still() -> RawFrame {
        RawFrame {
            since_previous_us: 10_000,
            accel: [0, 0, 256],
            gyro: [1, -2, 3],
            mag: [500, 0, -300],
            temperature_ddeg: 250,
            pressure_pa: 101_325,
        }
    }

    fn steps(n: u32) -> Vec<Step> {
        let calibration = crate::io::uquad_lockstep::simulated_calibration();
        let mut config = UquadConfig::corrected();
        config.imu.calibration_frames = 20;
        let mut uquad = Uquad::new(calibration, config).unwrap();
        let frames = 0..n;
        frames
            .filter_map(|k| {
                uquad.frame(
                    Timestamp::from_us(10_000 * u64::from(k)),
                    still(),
                    &mut |_| (),
                )
            })
            .collect()
    }

    fn text(disk: &Disk) -> String {
        String::from_utf8(disk.0.lock().unwrap().clone()).unwrap()
    }

    fn disks() -> Vec<Disk> {
        FILES.iter().map(|_| Disk::default()).collect()
    }

    #[test]
    fn every_stream_of_a_uquad_flight_has_its_file_and_each_row_its_columns() {
        let disks = disks();
        let mut logs = UquadLogs::writing_to(disks.clone(), "head\n").unwrap();
        let steps = steps(200);
        assert!(steps.len() > 100, "{} steps", steps.len());
        for (k, step) in steps.iter().enumerate() {
            let at = Timestamp::from_us(10_000 * k as u64);
            // In pieces, as a serial line gives them.
            for piece in still().emit(b'A').chunks(7) {
                logs.bytes(at, &piece.iter().copied().collect());
            }
            logs.step(at, *step);
        }
        let late = Notice::ImuPeriod {
            ms: 15.0,
            errors: 1,
        };
        logs.event(Timestamp::from_us(2_000_000), &Event::Notice(late));
        assert_eq!(logs.lost(), 0);
        drop(logs);
        let columns = [14, 12, 6, 12, 5, 5, 5];
        for ((file, disk), columns) in FILES.iter().zip(&disks).zip(columns) {
            let text = text(disk);
            assert_eq!(text.lines().count(), steps.len(), "{file}");
            for line in text.lines() {
                assert_eq!(line.split('\t').count(), columns, "{file}: {line}");
            }
        }
        assert_eq!(
            text(&disks[0]).lines().next().unwrap(),
            "0\t0\t10000\t0\t0\t256\t1\t-2\t3\t500\t0\t-300\t250\t101325"
        );
        assert_eq!(text(&disks[7]), "2\t0\t0.015000\t1\n");
        let errors = text(&disks[8]);
        assert!(errors.starts_with("head\n2.000 s: "), "{errors}");
        assert!(errors.ends_with("end: 0 records lost to a slow disk\n"));
    }

    #[test]
    fn a_disk_that_stands_still_costs_uquads_loop_nothing_and_what_is_lost_is_counted() {
        let disks = disks();
        let step = steps(40)[0];
        let mut logs = UquadLogs::writing_to(disks.clone(), "head\n").unwrap();
        let held: Vec<_> = disks.iter().map(|d| d.0.lock().unwrap()).collect();
        // The thread holds one record at most; whatever this loop does, it returns.
        for k in 0..RECORDS as u64 + 500 {
            logs.step(Timestamp::from_us(10_000 * k), step);
        }
        let lost = logs.lost();
        assert!((499..=500).contains(&lost), "{lost} lost");
        drop(held);
        drop(logs);
        let errors = text(&disks[8]);
        assert!(
            errors.ends_with(&format!("end: {lost} records lost to a slow disk\n")),
            "{errors}"
        );
        let written = text(&disks[3]).lines().count() as u64;
        assert_eq!(written + lost, RECORDS as u64 + 500);
    }

    #[test]
    fn the_head_of_the_errors_holds_every_matrix_and_setting() {
        let calibration = crate::io::uquad_lockstep::simulated_calibration();
        let mut config = UquadConfig::corrected();
        config.integral = Some(
            control::integral::IntegralAction::parse(
                &"0.25 ".repeat(16),
                control::integral::COLUMNS_OF_PPTZ,
            )
            .unwrap(),
        );
        let head = head("Kestrel", "/dev/ttyUSB0", &calibration, &config);
        let gains: Vec<&str> = head
            .lines()
            .filter(|l| l.split('\t').count() == 12)
            .collect();
        assert_eq!(gains.len(), 4, "four rows of twelve gains");
        assert!(gains[0].contains("8.81297750"), "{}", gains[0]);
        for word in [
            "/dev/ttyUSB0",
            "0.25",
            "calibration_frames: 512",
            "declination_rad",
            "mass_kg: 1.7",
            "noise",
            "accel_reference_degc",
            "samples an action",
        ] {
            assert!(head.contains(word), "{word} is missing in\n{head}");
        }
    }
}
