//! Files that people write, draw or download.

use crate::fuzz;
use bridge::gcs::plan_file::PlanFile;
use bridge::io::endpoint::{Endpoint, split_options};
use bridge::log::reader::LogFile;
use bridge::sensor::gps::log::Log as GpsLog;
use bridge::sensor::options::SensorSpec;
use bridge::settings::{Origin, Settings};
use bridge::web::envelope::Envelopes;
use estimator::imu::calibration::Calibration;
use estimator::imu::replay::LogRow;
use vehicle::floor_plan::drawing::{Marks, from_drawing};
use vehicle::{FloorPlan, RingConfig, Timestamp};

fuzz!(
    /// Plan files of stations: what is read is written and read again the same.
    plan_files,
    |bytes: &[u8]| {
        if let Ok(plan) = PlanFile::parse(&String::from_utf8_lossy(bytes)) {
            let again = PlanFile::parse(&plan.to_json()).unwrap();
            assert_eq!(again.mission.len(), plan.mission.len());
            assert_eq!(again.fence.len(), plan.fence.len());
            for item in &plan.mission {
                let _ = item.action();
            }
        }
    }
);

fuzz!(
    /// Parameters: whatever a file says, every value stays in its range.
    parameter_files,
    |bytes: &[u8]| {
        let mut settings = Settings::default();
        let _ = settings.set_toml(&String::from_utf8_lossy(bytes), Origin::Stored);
        for row in settings.rows() {
            if let Some((value, range)) = settings.number(row.meta.id) {
                assert!(range.contains(&value), "{} = {value}", row.meta.id);
            }
        }
        let mut again = Settings::default();
        again
            .set_toml(&settings.stored_toml(), Origin::Stored)
            .unwrap();
    }
);

fuzz!(
    /// Rings of rangers, sensors and calibrations.
    sensor_files,
    |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes);
        let _ = RingConfig::from_toml(&text);
        let _ = Calibration::parse(&text);
        let _ = GpsLog::from_text(&text);
        for line in text.lines() {
            let _ = line.parse::<SensorSpec>();
            let _ = LogRow::parse(line);
        }
    }
);

fuzz!(
    /// Endpoints of the command line.
    endpoint_urls,
    |bytes: &[u8]| {
        for line in String::from_utf8_lossy(bytes).lines() {
            if let Ok(endpoint) = line.parse::<Endpoint>() {
                assert_eq!(endpoint.to_string().parse(), Ok(endpoint));
            }
            // A key file would be read; nothing here names one that is there.
            let _ = split_options(line);
        }
    }
);

fuzz!(
    /// A floor plan: its YAML, a zero byte, its picture.
    floor_plans,
    |bytes: &[u8]| {
        let cut = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
        let (yaml, picture) = bytes.split_at(cut);
        let picture = picture.get(1..).unwrap_or_default();
        let yaml = String::from_utf8_lossy(yaml);
        let plan = FloorPlan::from_yaml(&yaml, |_| Ok::<_, String>(picture.to_vec()));
        if let Ok(plan) = plan {
            let _ = plan.wall_segments();
            let _ = vehicle::floor_plan::check::check(&plan, 0.2);
        }
        let marks = Marks::new([0.0, 0.0], [4.0, 0.0], 1.0);
        let _ = from_drawing(picture, &marks);
    }
);

fuzz!(
    /// Flight logs, also torn ones.
    flight_logs,
    |bytes: &[u8]| {
        if let Ok(log) = LogFile::read(bytes) {
            let _ = log.stream();
            let _ = log.lost();
        }
    }
);

fuzz!(
    /// Messages of a page's socket.
    page_messages,
    |bytes: &[u8]| {
        let mut envelopes = Envelopes::default();
        for (i, chunk) in bytes.chunks(40).enumerate() {
            let now = Timestamp::from_ms(i as u64 * 20);
            if let Ok(opened) = envelopes.open(now, chunk) {
                assert!(opened.frames.len() < chunk.len());
            }
        }
    }
);
