//! `--airframe uquad`: which law flies it, from which files, refused before anything turns.

use super::Usage;
use anyhow::{Context as _, Result};
use bridge::io::uquad_lockstep::simulated_calibration;
use bridge::uquad::laws::{self, Law};
use bridge::uquad::{Uquad, UquadConfig};
use clap::{Args, ValueEnum};
use control::integral::{COLUMNS_OF_PPTZ, COLUMNS_OF_PPZT, COLUMNS_OF_XYZT, Columns};
use control::lqr::Weights;
use control::setpoint_list::SetpointList;
use estimator::imu::Smoothing;
use estimator::imu::fir::Fir;
use estimator::thesis::StateSet;
use std::path::{Path, PathBuf};
use vehicle::UquadAirframe;

/// Options of uQuad's law.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct UquadLawArgs {
    /// uQuad: estimated and controlled states; 8 = no position source (height, heading and tilt are held, the place is not).
    #[arg(long, value_name = "12|8")]
    states: Option<States>,
    /// uQuad: proportional gains, 4 x 12 or 4 x 8 numbers; default: LQR, made again as the nose turns.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["lqr_q", "lqr_r"])]
    gains: Option<PathBuf>,
    /// uQuad: integral gains, 4 x 4 numbers.
    #[arg(
        long,
        value_name = "FILE",
        requires = "gains",
        requires = "integral_columns"
    )]
    integral: Option<PathBuf>,
    /// uQuad: what the columns of the integral gains are; files differ in spite of their names.
    #[arg(long, value_name = "ORDER")]
    integral_columns: Option<Order>,
    /// uQuad: weights of the states of LQR, 16 x 16 numbers (the thesis's lqr-Q.txt).
    #[arg(long, value_name = "FILE", requires = "lqr_r")]
    lqr_q: Option<PathBuf>,
    /// uQuad: weights of the motors of LQR, 4 x 4 numbers (lqr-R.txt).
    #[arg(long, value_name = "FILE", requires = "lqr_q")]
    lqr_r: Option<PathBuf>,
    /// uQuad: set points, 17 numbers a line, flown in mode Mission while no MAVLink mission is stored.
    #[arg(long, value_name = "FILE")]
    setpoints: Option<PathBuf>,
    /// uQuad: coefficients of the filter over the newest frames, the newest first; they add up to 1.
    #[arg(
        long,
        value_name = "C,C,...",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    fir: Vec<f64>,
    /// uQuad: frames kept in the ring, more than the filter takes, 32 at most.
    #[arg(long, value_name = "N")]
    ring: Option<usize>,
    /// uQuad: frames for each action of the law; the motor speeds stand in between.
    #[arg(long, value_name = "N")]
    frames_per_action: Option<u32>,
    /// uQuad: magnetic declination, degrees, added to the heading counter-clockwise.
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    declination: Option<f64>,
    /// uQuad: mass, kg, that the law believes.
    #[arg(long, value_name = "KG")]
    mass: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum States {
    #[value(name = "12")]
    Twelve,
    #[value(name = "8")]
    Eight,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Order {
    /// z, psi, phi, theta: the file K_int_full_pptz.
    Zppt,
    /// psi, phi, z, theta: the file K_int_full_ppzt.
    Ppzt,
    /// x, y, z, theta: the older files.
    Xyzt,
}

impl Order {
    pub(crate) const fn columns(self) -> Columns {
        match self {
            Self::Zppt => COLUMNS_OF_PPTZ,
            Self::Ppzt => COLUMNS_OF_PPZT,
            Self::Xyzt => COLUMNS_OF_XYZT,
        }
    }
}

/// The law that was chosen.
#[derive(Debug)]
pub(crate) struct Chosen(Law);

impl Chosen {
    /// Weights of gains that follow the heading.
    pub(crate) const fn weights(&self) -> Option<Weights> {
        match &self.0 {
            Law::Optimal(weights) => Some(*weights),
            Law::Files { .. } => None,
        }
    }
}

impl UquadLawArgs {
    /// It has a position source.
    pub(crate) fn has_place(&self) -> bool {
        self.states != Some(States::Eight)
    }

    pub(crate) const fn states(&self) -> Option<States> {
        self.states
    }

    /// Without a position source where none was chosen.
    pub(crate) const fn without_place(&mut self) {
        self.states = Some(States::Eight);
    }

    pub(crate) fn law(&self) -> Result<Chosen> {
        if let Some(path) = &self.gains {
            let integral = match (&self.integral, self.integral_columns) {
                (Some(path), Some(order)) => Some((read(path)?, order.columns())),
                _ => None,
            };
            return Ok(Chosen(Law::Files {
                proportional: read(path)?,
                integral,
            }));
        }
        let weights = match (&self.lqr_q, &self.lqr_r) {
            (Some(q), Some(r)) => Weights::parse(&read(q)?, &read(r)?).with_context(|| {
                format!("cannot use the weights {} and {}", q.display(), r.display())
            })?,
            _ => Weights::indoor(),
        };
        Ok(Chosen(Law::Optimal(weights)))
    }

    fn craft(&self) -> Result<UquadAirframe> {
        let mut craft = UquadAirframe::default();
        if let Some(kg) = self.mass {
            if !(0.5..=2.2).contains(&kg) {
                return Err(Usage(format!("--mass {kg}: 0.5 to 2.2 kg")).into());
            }
            craft.mass_kg = kg;
        }
        Ok(craft)
    }

    /// The list of set points, if one is given.
    pub(crate) fn list(&self) -> Result<Option<SetpointList>> {
        let Some(path) = &self.setpoints else {
            return Ok(None);
        };
        let list = SetpointList::parse(&read(path)?, &self.craft()?)
            .map_err(|e| Usage(format!("{}: {e}", path.display())))?;
        Ok(Some(list))
    }

    /// Refused here, before anything turns.
    pub(crate) fn config(&self, law: &Chosen) -> Result<UquadConfig> {
        let craft = self.craft()?;
        let states = if self.has_place() {
            StateSet::Full
        } else {
            StateSet::Reduced
        };
        let mut config = laws::config(craft, states, &law.0).map_err(|e| Usage(e.to_string()))?;
        if !self.fir.is_empty() {
            let fir = Fir::new(&self.fir).map_err(|e| Usage(format!("--fir: {e}")))?;
            config.imu.smoothing = Smoothing::Fir(fir);
        }
        if let Some(frames) = self.ring {
            config.imu.ring_frames = frames;
        }
        if let Some(frames) = self.frames_per_action {
            config.steps_per_action = frames;
        }
        if let Some(degrees) = self.declination {
            config.imu.declination_rad = degrees.to_radians();
        }
        // What it could not be made with is a wrong command line.
        Uquad::new(simulated_calibration(), config.clone()).map_err(|e| Usage(e.to_string()))?;
        Ok(config)
    }
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}
