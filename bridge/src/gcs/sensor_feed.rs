//! Sensors whose messages come over a MAVLink link, as companion programs and rangefinder boards send them.
//!
//! | Message | Here |
//! | --- | --- |
//! | DISTANCE_SENSOR, orientation 0..=7 | a ranger of the ring |
//! | DISTANCE_SENSOR, orientation 25 (looks down) | height |
//! | OBSTACLE_DISTANCE, frame BODY_FRD | a whole circle of rangers |
//! | OPTICAL_FLOW_RAD | flow; its distance, if it has one, height |
//! | VISION_POSITION_ESTIMATE, ODOMETRY | pose from outside |
//!
//! Nothing is taken that the configuration does not name, and from nobody else than it names. A message that repeats the time of
//! the one before is not a new measurement. Sender's clocks are not ours: a sample is as old as the configured latency when it
//! arrives.

use super::{Outbox, Peer};
use crate::autopilot::door::{Request, Severity};
use crate::sensor::Sample;
use crate::sensor::circle::COLUMN_DEG;
use crate::sensor::suite::{MavlinkFeed, Vision};
use core::time::Duration;
use mavlink_dialect::Message;
use mavlink_dialect::standard::{
    DISTANCE_SENSOR_DATA, MavFrame, MavMessage, OBSTACLE_DISTANCE_DATA, ODOMETRY_DATA,
    OPTICAL_FLOW_RAD_DATA, VISION_POSITION_ESTIMATE_DATA,
};
use vehicle::{
    DownRange, ExternalFrame, ExternalPose, FlowSample, Frd, In, Ned, RangerConfig, RangerReading,
    Rot, Timestamp,
};

/// Time between two complaints.
const COMPLAINT_PERIOD: Duration = Duration::from_secs(10);
/// Orientation that looks down.
const DOWN: u8 = 25;
/// Kinds of message whose time is watched: orientations 0..=7 and down, obstacle, flow, vision, odometry.
const CLOCKS: usize = 13;

/// Takes messages of sensors.
#[derive(Debug, Default)]
pub struct SensorFeed {
    feed: Option<MavlinkFeed>,
    /// Rangers of the circle of OBSTACLE_DISTANCE.
    circle: Vec<RangerConfig>,
    clocks: [Option<u64>; CLOCKS],
    complained_at: Option<Timestamp>,
}

impl SensorFeed {
    /// Takes nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes from now on what a configuration names.
    pub fn listen_to(&mut self, feed: MavlinkFeed) {
        self.circle = feed
            .obstacle
            .as_ref()
            .map(|(mount, _)| mount.rangers())
            .unwrap_or_default();
        self.feed = Some(feed);
    }

    /// True for a sample of a sensor where no configuration names one: other vehicles' telemetry.
    #[must_use]
    pub const fn ignores(&self, message: &Message) -> bool {
        self.feed.is_none()
            && matches!(
                message,
                Message::Standard(
                    MavMessage::DISTANCE_SENSOR(_)
                        | MavMessage::OBSTACLE_DISTANCE(_)
                        | MavMessage::OPTICAL_FLOW_RAD(_)
                        | MavMessage::VISION_POSITION_ESTIMATE(_)
                        | MavMessage::ODOMETRY(_)
                )
            )
    }

    /// Takes a message.
    pub fn handle(&mut self, now: Timestamp, from: Peer, message: &Message, out: &mut Outbox) {
        let Some(feed) = &self.feed else { return };
        let Message::Standard(message) = message else {
            return;
        };
        let may = feed
            .from
            .is_none_or(|f| f == [from.address.system, from.address.component]);
        if !may {
            return;
        }
        let at = now - feed.latency;
        let mut send = |sample| {
            let _ = out.ask(from, Request::Sensed(sample));
        };
        match message {
            MavMessage::DISTANCE_SENSOR(m) => {
                let orientation = m.orientation as u32 as u8;
                let ranger = feed.distance.iter().find(|(o, _)| *o == orientation);
                let is_down = orientation == DOWN && feed.down;
                if ranger.is_none() && !is_down {
                    return;
                }
                let clock = if is_down { 8 } else { usize::from(orientation) };
                if !is_news(&mut self.clocks[clock], u64::from(m.time_boot_ms)) {
                    return;
                }
                let mm = millimetres(m);
                if let Some((_, ranger)) = ranger {
                    send(Sample::Ranger(RangerReading {
                        at,
                        ranger: *ranger,
                        columns_mm: core::iter::once(mm).collect(),
                    }));
                } else {
                    send(Sample::DownRange(DownRange {
                        at,
                        distance_m: mm.map(|mm| f64::from(mm) / 1e3),
                    }));
                }
            }
            MavMessage::OBSTACLE_DISTANCE(m) => {
                let Some((mount, first)) = &feed.obstacle else {
                    return;
                };
                if m.frame != MavFrame::MAV_FRAME_BODY_FRD {
                    return complain(
                        &mut self.complained_at,
                        now,
                        out,
                        "OBSTACLE_DISTANCE is taken in frame MAV_FRAME_BODY_FRD (12) only",
                    );
                }
                if !is_news(&mut self.clocks[9], m.time_usec) {
                    return;
                }
                for (i, ranger) in (0u8..).zip(&self.circle) {
                    if let Some(columns_mm) = sector(m, mount.yaw_deg, ranger) {
                        send(Sample::Ranger(RangerReading {
                            at,
                            ranger: first + i,
                            columns_mm,
                        }));
                    }
                }
            }
            MavMessage::OPTICAL_FLOW_RAD(m) if feed.flow => {
                if !is_news(&mut self.clocks[10], m.time_usec) {
                    return;
                }
                if let Some(flow) = flow(at, m) {
                    send(Sample::Flow(flow));
                }
                let distance_m = f64::from(m.distance);
                if feed.down && distance_m > 0.0 && distance_m.is_finite() {
                    send(Sample::DownRange(DownRange {
                        at,
                        distance_m: Some(distance_m),
                    }));
                }
            }
            MavMessage::VISION_POSITION_ESTIMATE(m) => {
                let Some(frame) = external_frame(feed.vision) else {
                    return;
                };
                if is_news(&mut self.clocks[11], m.usec)
                    && let Some(pose) = vision(at, frame, m)
                {
                    send(Sample::Pose(pose));
                }
            }
            MavMessage::ODOMETRY(m) => {
                let Some(frame) = external_frame(feed.vision) else {
                    return;
                };
                match odometry(at, frame, m) {
                    Ok(pose) => {
                        if is_news(&mut self.clocks[12], m.time_usec) {
                            send(Sample::Pose(pose));
                        }
                    }
                    Err(why) => complain(&mut self.complained_at, now, out, why),
                }
            }
            _ => {}
        }
    }
}

fn complain(at: &mut Option<Timestamp>, now: Timestamp, out: &mut Outbox, what: &str) {
    if at.is_none_or(|at| now.since(at) >= COMPLAINT_PERIOD) {
        *at = Some(now);
        out.text(Severity::Warning, what);
    }
}

/// False if a sender repeats a time. Senders without a clock say zero.
fn is_news(clock: &mut Option<u64>, time: u64) -> bool {
    time == 0 || clock.replace(time) != Some(time)
}

const fn external_frame(vision: Vision) -> Option<ExternalFrame> {
    match vision {
        Vision::Off => None,
        Vision::Local => Some(ExternalFrame::Local),
        Vision::Own => Some(ExternalFrame::Own),
    }
}

/// A distance within the sensor's own limits; signal quality 1 says that it is invalid.
fn millimetres(m: &DISTANCE_SENSOR_DATA) -> Option<u16> {
    let cm = m.current_distance;
    let within = cm > 0 && cm >= m.min_distance && cm < m.max_distance;
    (within && m.signal_quality != 1).then(|| cm.saturating_mul(10))
}

/// Columns of one ranger from the bins that they overlap: the nearest counts. None if a column has no bin that says
/// anything: what was not measured is not open.
fn sector(
    m: &OBSTACLE_DISTANCE_DATA,
    yaw_deg: f64,
    ranger: &RangerConfig,
) -> Option<arrayvec::ArrayVec<Option<u16>, { vehicle::sample::MAX_COLUMNS }>> {
    let increment_deg = if m.increment_f != 0.0 {
        f64::from(m.increment_f)
    } else {
        f64::from(m.increment)
    };
    let offset_deg = f64::from(m.angle_offset);
    if !(increment_deg.abs() > 1e-3 && increment_deg.abs() <= 360.0 && offset_deg.is_finite()) {
        return None;
    }
    let reach_deg = 0.5 * (increment_deg.abs() + COLUMN_DEG) - 1e-6;
    (0..usize::from(ranger.columns))
        .map(|column| {
            let bearing_deg = ranger.column_bearing_rad(column).to_degrees();
            let mut nearest: Option<Option<u16>> = None;
            for (i, cm) in m.distances.iter().enumerate() {
                let bin_deg = offset_deg + yaw_deg + increment_deg * i as f64;
                let apart = (bin_deg - bearing_deg + 180.0).rem_euclid(360.0) - 180.0;
                if apart.abs() >= reach_deg || *cm == u16::MAX || *cm < m.min_distance.max(1) {
                    continue;
                }
                let mm = (*cm < m.max_distance).then(|| cm.saturating_mul(10));
                nearest = Some(match (nearest.flatten(), mm) {
                    (Some(a), Some(b)) => Some(a.min(b)),
                    (a, b) => a.or(b),
                });
            }
            nearest
        })
        .collect()
}

fn flow(at: Timestamp, m: &OPTICAL_FLOW_RAD_DATA) -> Option<FlowSample> {
    let dt_s = f64::from(m.integration_time_us) * 1e-6;
    if !(1e-4..=0.5).contains(&dt_s) {
        return None;
    }
    let (x, y) = (
        f64::from(m.integrated_x) / dt_s,
        f64::from(m.integrated_y) / dt_s,
    );
    (x.is_finite() && y.is_finite()).then(|| FlowSample {
        at: at - Duration::from_secs_f64(0.5 * dt_s),
        x_radps: x,
        y_radps: y,
        quality: m.quality,
    })
}

/// Doubts of a covariance (upper triangle of 6 x 6): horizontal position and yaw. NaN in the first place says unknown.
fn doubts(covariance: &[f32; 21]) -> (Option<f64>, Option<f64>) {
    let std =
        |variance: f64| (variance > 0.0 && variance.is_finite()).then(|| libm::sqrt(variance));
    let [xx, yy, yaw] = [covariance[0], covariance[6], covariance[20]].map(f64::from);
    (std(0.5 * (xx + yy)), std(yaw))
}

fn vision(
    at: Timestamp,
    frame: ExternalFrame,
    m: &VISION_POSITION_ESTIMATE_DATA,
) -> Option<ExternalPose> {
    let position = In::<Ned>::new(f64::from(m.x), f64::from(m.y), f64::from(m.z));
    let yaw_rad = f64::from(m.yaw);
    let (position_std_m, yaw_std_rad) = doubts(&m.covariance);
    (position.is_finite() && yaw_rad.is_finite()).then_some(ExternalPose {
        at,
        frame,
        position,
        yaw_rad,
        velocity: None,
        position_std_m,
        yaw_std_rad,
        reset_counter: m.reset_counter,
    })
}

fn odometry(
    at: Timestamp,
    frame: ExternalFrame,
    m: &ODOMETRY_DATA,
) -> Result<ExternalPose, &'static str> {
    let frame = match m.frame_id {
        MavFrame::MAV_FRAME_LOCAL_NED => frame,
        MavFrame::MAV_FRAME_LOCAL_FRD if frame == ExternalFrame::Own => frame,
        MavFrame::MAV_FRAME_LOCAL_FRD => {
            return Err(
                "ODOMETRY in MAV_FRAME_LOCAL_FRD has a heading of its own: configure vision=own",
            );
        }
        _ => return Err("ODOMETRY is taken in frame_id MAV_FRAME_LOCAL_NED (1) or LOCAL_FRD (20)"),
    };
    let [w, x, y, z] = m.q.map(f64::from);
    let norm = libm::sqrt(w * w + x * x + y * y + z * z);
    if !(0.5..2.0).contains(&norm) {
        return Err("ODOMETRY without a unit quaternion");
    }
    let yaw_rad = libm::atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z);
    let position = In::<Ned>::new(f64::from(m.x), f64::from(m.y), f64::from(m.z));
    let told = [m.vx, m.vy, m.vz].map(f64::from);
    let is_told = told.iter().all(|v| v.is_finite());
    let roll = libm::atan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z);
    let pitch = libm::asin((2.0 * (w * y - x * z) / (norm * norm)).clamp(-1.0, 1.0));
    // Level axes along the heading: what the filter takes.
    let velocity = match m.child_frame_id {
        MavFrame::MAV_FRAME_BODY_FRD if is_told => {
            let tilt = Rot::<Frd, Ned>::from_roll_pitch_yaw(roll, pitch, 0.0);
            let level = tilt * In::<Frd>::from(told);
            Some(In::<Frd>::new(level.x(), level.y(), level.z()))
        }
        MavFrame::MAV_FRAME_LOCAL_NED | MavFrame::MAV_FRAME_LOCAL_FRD if is_told => {
            let (s, c) = libm::sincos(yaw_rad);
            Some(In::new(
                c * told[0] + s * told[1],
                c * told[1] - s * told[0],
                told[2],
            ))
        }
        _ => None,
    };
    let (position_std_m, yaw_std_rad) = doubts(&m.pose_covariance);
    if !position.is_finite() {
        return Err("ODOMETRY with a position that is no number");
    }
    Ok(ExternalPose {
        at,
        frame,
        position,
        yaw_rad,
        velocity,
        position_std_m,
        yaw_std_rad,
        reset_counter: m.reset_counter,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcs::bench::station;
    use crate::sensor::options::SensorSpec;
    use crate::sensor::suite::Suite;
    use mavlink_dialect::standard::MavSensorOrientation;
    use vehicle::RingConfig;

    fn feed(options: &str) -> (SensorFeed, RingConfig) {
        let spec: SensorSpec = format!("mavlink:?latency_ms=0&{options}").parse().unwrap();
        let suite = Suite::new(&[spec], &RingConfig::built_in).unwrap();
        let mut feed = SensorFeed::new();
        feed.listen_to(suite.mavlink.unwrap());
        (feed, suite.ring)
    }

    fn take(feed: &mut SensorFeed, ms: u64, message: MavMessage) -> Vec<Sample> {
        let mut out = Outbox::default();
        feed.handle(
            Timestamp::from_ms(ms),
            station(9),
            &Message::Standard(message),
            &mut out,
        );
        let samples = out.requests.drain(..).map(|asked| match asked.request {
            Request::Sensed(sample) => sample,
            other => panic!("{other:?}"),
        });
        samples.collect()
    }

    fn distance(ms: u32, orientation: MavSensorOrientation, cm: u16) -> MavMessage {
        MavMessage::DISTANCE_SENSOR(DISTANCE_SENSOR_DATA {
            time_boot_ms: ms,
            min_distance: 10,
            max_distance: 400,
            current_distance: cm,
            orientation,
            ..DISTANCE_SENSOR_DATA::DEFAULT
        })
    }

    #[test]
    fn distances_are_the_rangers_that_were_named_and_down_is_a_height() {
        use MavSensorOrientation as O;
        let (mut feed, ring) = feed("distance=0,2&down=on");
        let out = take(
            &mut feed,
            50,
            distance(1, O::MAV_SENSOR_ROTATION_YAW_90, 123),
        );
        let [Sample::Ranger(r)] = &out[..] else {
            panic!("{out:?}")
        };
        assert_eq!((r.ranger, r.columns_mm[..].to_vec()), (1, vec![Some(1230)]));
        assert!((ring.rangers[1].bearing_deg - 90.0).abs() < 1e-9);
        let out = take(
            &mut feed,
            60,
            distance(2, O::MAV_SENSOR_ROTATION_PITCH_270, 95),
        );
        assert_eq!(
            out,
            [Sample::DownRange(DownRange {
                at: Timestamp::from_ms(60),
                distance_m: Some(0.95)
            })]
        );
        assert!(
            take(
                &mut feed,
                70,
                distance(3, O::MAV_SENSOR_ROTATION_YAW_45, 95)
            )
            .is_empty(),
            "not named"
        );
        let out = take(&mut feed, 70, distance(3, O::MAV_SENSOR_ROTATION_NONE, 400));
        assert!(matches!(&out[..], [Sample::Ranger(r)] if r.columns_mm[0].is_none()));
        assert!(
            take(&mut feed, 80, distance(3, O::MAV_SENSOR_ROTATION_NONE, 100)).is_empty(),
            "stands still"
        );
    }

    fn obstacle(usec: u64, frame: MavFrame, distances: [u16; 72]) -> MavMessage {
        MavMessage::OBSTACLE_DISTANCE(OBSTACLE_DISTANCE_DATA {
            time_usec: usec,
            distances,
            min_distance: 20,
            max_distance: 800,
            increment: 5,
            frame,
            ..OBSTACLE_DISTANCE_DATA::DEFAULT
        })
    }

    #[test]
    fn a_circle_of_72_bins_is_ten_rangers_with_the_nearest_of_each_column() {
        let (mut feed, ring) = feed("obstacle=on&max_m=10");
        let mut bins = [801u16; 72];
        bins[18] = 150; // 90 degrees: to the right.
        let out = take(
            &mut feed,
            10,
            obstacle(1, MavFrame::MAV_FRAME_BODY_FRD, bins),
        );
        assert_eq!(out.len(), 10);
        let mut hits = Vec::new();
        for sample in &out {
            let Sample::Ranger(r) = sample else { panic!() };
            let config = &ring.rangers[usize::from(r.ranger)];
            for (c, mm) in r.columns_mm.iter().enumerate() {
                if let Some(mm) = mm {
                    hits.push((config.column_bearing_rad(c).to_degrees().round(), *mm));
                }
            }
        }
        assert_eq!(hits, [(87.0, 1500), (93.0, 1500)]);
        assert!(
            take(
                &mut feed,
                20,
                obstacle(1, MavFrame::MAV_FRAME_BODY_FRD, bins)
            )
            .is_empty()
        );
        bins = [u16::MAX; 72];
        assert!(
            take(
                &mut feed,
                30,
                obstacle(2, MavFrame::MAV_FRAME_BODY_FRD, bins)
            )
            .is_empty(),
            "unknown is not open"
        );
    }

    #[test]
    fn a_circle_that_is_north_aligned_is_refused_in_words() {
        let (mut feed, _) = feed("obstacle=on");
        let mut out = Outbox::default();
        for ms in [0, 1000] {
            let message =
                Message::Standard(obstacle(ms + 1, MavFrame::MAV_FRAME_GLOBAL, [100; 72]));
            feed.handle(Timestamp::from_ms(ms), station(9), &message, &mut out);
        }
        assert_eq!((out.texts.len(), out.requests.len()), (1, 0));
        assert!(out.texts[0].1.contains("BODY_FRD"));
    }

    #[test]
    fn flow_is_a_rate_at_the_middle_of_its_exposure() {
        let (mut feed, _) = feed("flow=on&down=on");
        let message = |usec, distance| {
            MavMessage::OPTICAL_FLOW_RAD(OPTICAL_FLOW_RAD_DATA {
                time_usec: usec,
                integration_time_us: 20_000,
                integrated_x: 0.01,
                integrated_y: -0.02,
                distance,
                quality: 180,
                ..OPTICAL_FLOW_RAD_DATA::DEFAULT
            })
        };
        let out = take(&mut feed, 100, message(1, 1.2));
        let [Sample::Flow(f), Sample::DownRange(d)] = &out[..] else {
            panic!("{out:?}")
        };
        assert!((f.x_radps - 0.5).abs() < 1e-6 && (f.y_radps + 1.0).abs() < 1e-6);
        assert_eq!((f.at, f.quality), (Timestamp::from_ms(90), 180));
        assert!((d.distance_m.unwrap() - 1.2).abs() < 1e-6);
        assert_eq!(take(&mut feed, 120, message(2, -1.0)).len(), 1);
    }

    #[test]
    fn odometry_in_body_axes_is_velocity_along_the_heading() {
        let (mut feed, _) = feed("vision=own");
        let half = libm::sqrt(0.5) as f32;
        let message = MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: 5,
            x: 1.0,
            y: 2.0,
            z: -1.0,
            q: [half, 0.0, 0.0, half],
            vx: 0.5,
            vy: -0.25,
            vz: 0.0,
            frame_id: MavFrame::MAV_FRAME_LOCAL_FRD,
            child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
            pose_covariance: [f32::NAN; 21],
            reset_counter: 3,
            ..ODOMETRY_DATA::DEFAULT
        });
        let out = take(&mut feed, 100, message);
        let [Sample::Pose(p)] = out[..] else {
            panic!("{out:?}")
        };
        assert_eq!(
            (p.frame, p.reset_counter, p.position_std_m),
            (ExternalFrame::Own, 3, None)
        );
        assert!((p.yaw_rad - core::f64::consts::FRAC_PI_2).abs() < 1e-6);
        let v = p.velocity.unwrap();
        assert!((v.x() - 0.5).abs() < 1e-6 && (v.y() + 0.25).abs() < 1e-6);
    }

    #[test]
    fn whoever_is_not_named_is_not_heard() {
        let (mut feed, _) = feed("down=on&from=7/196");
        use MavSensorOrientation as O;
        assert!(
            take(
                &mut feed,
                60,
                distance(2, O::MAV_SENSOR_ROTATION_PITCH_270, 95)
            )
            .is_empty()
        );
    }
}
