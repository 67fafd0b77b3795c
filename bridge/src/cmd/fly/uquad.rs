//! uQuad: no flight controller, its own thread.

use super::super::sim::StartArg;
use super::super::stop::Stop;
use super::super::term::Terminal;
use super::super::{Usage, load_plan};
use super::ground_loop::GroundLoop;
use super::{FlyArgs, Kept, wanted};
use anyhow::{Context as _, Result, anyhow};
use bridge::autopilot::ground::{Ground, GroundConfig};
use bridge::io::clock::{self, Clock};
use bridge::io::endpoint::{Endpoint, EndpointError};
use bridge::io::lockstep::our_address;
use bridge::io::net::Links;
use bridge::io::uquad_lockstep::simulated_calibration;
use bridge::io::uquad_logs::{self, UquadLogs};
use bridge::io::uquad_thread::{self, ImuSource, Motors};
use bridge::uquad::flight::{UquadFlight, UquadFlightConfig};
use estimator::imu::Calibration;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use vehicle::floor_plan::Cell;
use vehicle::{FloorPlan, MapPose};

/// Side of the empty plan that uQuad flies over without one, m.
const FIELD_M: f64 = 40.0;

/// Open floor with home in its middle.
fn field() -> Result<FloorPlan> {
    let cells = (FIELD_M / 0.25) as usize;
    let middle = FIELD_M / 2.0;
    let mut plan = FloorPlan::from_cells(cells, 0.25, [0.0, 0.0], vec![Cell::Free; cells * cells])?;
    plan.home = Some(MapPose::new(middle, middle, 0.0));
    Ok(plan)
}

/// Where the frames come from.
fn imu_source(imu: &str) -> Result<ImuSource> {
    if imu.contains("://") {
        let endpoint: Endpoint = imu
            .parse()
            .map_err(|e: EndpointError| Usage(e.to_string()))?;
        return Ok(ImuSource::Line(endpoint));
    }
    let text = std::fs::read_to_string(imu)
        .with_context(|| format!("cannot read the recorded frames {imu}"))?;
    let (frames, refused) = crate::cmd::eval::uquad_frames(&text);
    if let Some(first) = refused.first() {
        crate::cmd::term::complain(&format!(
            "{} rows of {imu} are not used, the first: {first}",
            refused.len()
        ));
    }
    if frames.is_empty() {
        return Err(anyhow!("{imu} has no usable row of imu_raw (14 columns)"));
    }
    Ok(ImuSource::Recording(frames))
}

fn motors(name: &str) -> Result<Motors> {
    match name.strip_prefix("i2c://") {
        Some(path) => Ok(Motors::I2c(PathBuf::from(path))),
        None if name == "sim" => Ok(Motors::Simulated),
        None if name == "stdin" => Ok(Motors::Typed),
        None => Err(Usage(format!(
            "--motors {name}: write sim, i2c:///dev/i2c-2 or stdin"
        ))
        .into()),
    }
}

/// uQuad: no flight controller, its own thread.
pub(super) fn fly_uquad(mut args: FlyArgs, stop: Stop) -> Result<ExitCode> {
    let Some(imu) = args.imu.clone() else {
        return Err(Usage(
            "--airframe uquad needs --imu serial:///dev/... or --imu imu_raw.log".to_owned(),
        )
        .into());
    };
    let motors = motors(&args.motors)?;
    let wanted = wanted(&args)?;
    let plan = Arc::new(match &args.map {
        Some(path) => load_plan(path)?,
        None => field()?,
    });
    let calibration = match &args.calib {
        Some(path) => {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            Calibration::parse(&text)
                .with_context(|| format!("cannot use the calibration {}", path.display()))?
        }
        None => simulated_calibration(),
    };
    // No ring of range finders speaks here yet: there is no position source.
    if args.uquad.states().is_none() {
        args.uquad.without_place();
    }
    if args.uquad.has_place() {
        return Err(Usage(
            "--states 12 needs a position source, and range finder drivers are not built yet"
                .to_owned(),
        )
        .into());
    }
    let law = args.uquad.law()?;
    let mut uquad = args.uquad.config(&law)?;
    uquad.imu.calibration_frames = args.calibration_frames;
    let source = imu_source(&imu)?;
    let Kept {
        keep,
        settings,
        documents,
        ..
    } = Kept::open(&args)?;
    let start = StartArg::on(args.start, &plan);
    let clock = Clock::start(1.0);
    let boot_utc_us = clock::utc_us();
    let mut ground = Ground::new(GroundConfig {
        us: our_address(&settings),
        settings: settings.clone(),
        anchor: plan.anchor(),
        plan: Arc::clone(&plan),
        airframe: bridge::uquad::flight::airframe(&uquad.filter.craft),
        boot_utc_us,
        documents,
    });
    let logs = match &args.log_dir {
        Some(folder) => {
            let program = concat!("Kestrel ", env!("CARGO_PKG_VERSION"));
            let head = uquad_logs::head(program, &imu, &calibration, &uquad);
            let opened = UquadLogs::open(folder, &head)
                .with_context(|| format!("cannot write the logs in {}", folder.display()))?;
            Some(opened)
        }
        None => None,
    };
    let flight = UquadFlight::new(
        clock.now(),
        UquadFlightConfig {
            plan,
            ring: None,
            start,
            settings,
            seed: boot_utc_us,
            calibration,
            uquad,
            weights: law.weights(),
            list: args.uquad.list()?,
        },
    )
    .map_err(|e| Usage(e.to_string()))?;
    ground.snapshot(clock.now(), flight.snapshot());
    ground.set_policies(wanted.iter().map(|w| w.policy.clone()).collect());
    let links = Links::open(&wanted).map_err(|e| anyhow!(e))?;
    links.route_for(&mut ground);
    let (handle, thread) = uquad_thread::start(flight, source, &motors, logs, clock)?;
    let mut terminal = Terminal::new(args.quiet);
    terminal.line(&format!(
        "Kestrel {}: uQuad, inertial unit {imu}, motors {}",
        env!("CARGO_PKG_VERSION"),
        args.motors
    ));
    for link in &links.described {
        terminal.line(&format!("  MAVLink {link}"));
    }
    terminal.line("  No position source: height, heading and tilt are held, the place is not.");
    let ended = GroundLoop {
        ground,
        handle,
        links,
        console: None,
        camera: None,
        keep,
        log: None,
        tap: None,
        texts_logged: 0,
        terminal,
        clock,
        stop,
        unanswered: format!("no frame comes from the inertial unit {imu}: check the baud rate"),
        told: None,
        sensors_told: None,
        shows_status: !args.headless,
        waits: args.wait,
    }
    .run();
    // The last rows of its logs.
    let _ = thread.join();
    ended
}
