//! From calibrated samples to attitude: one file per filter, one seat for all of them.
//!
//! [`Estimator`] keeps the time and refuses what is not a number, so that a filter sees only finite
//! samples and steps between 1 µs and 0.5 s. [`FilterKind`] chooses the filter:
//!
//! - [`axis_kalman`], the default: an angle and bias Kalman filter each for roll and pitch, around
//!   an exact quaternion;
//! - [`classic`]: the same two filters with the formulas of the well-known tutorial.
//!
//! Neither sees a compass: yaw starts at zero and is only ever relative.

pub mod angle_bias;
pub mod axis_kalman;
pub mod classic;

pub use classic::ClassicAngles;

use crate::attitude::{Quaternion, Vector3};
use crate::units::{SECONDS_PER_MICROSECOND, STANDARD_GRAVITY_M_S2};
use axis_kalman::AxisKalman;
use classic::Classic;

/// A longer pause between samples is a gap: what happened in it is unknown.
pub const LONGEST_STEP_US: u64 = 500_000;

/// Below a quarter of gravity the accelerometer's own offset (80 mg, product specification §6.2) may
/// turn its direction by 20° and more, so it says nothing about down.
pub const LEAST_SPECIFIC_FORCE_M_S2: f32 = 0.25 * STANDARD_GRAVITY_M_S2;

/// No sensor of this family reaches a tenth of these; beyond them a sample is not a measurement.
const LARGEST_SPECIFIC_FORCE_M_S2: f32 = 10_000.0;
const LARGEST_RATE_RAD_S: f32 = 1_000.0;

/// Which filter estimates the attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FilterKind {
    /// [`axis_kalman`].
    #[default]
    AxisKalman,
    /// [`classic`].
    Classic,
}

impl FilterKind {
    /// Every filter.
    pub const ALL: [Self; 2] = [Self::AxisKalman, Self::Classic];

    /// The name by which it is chosen.
    pub const fn name(self) -> &'static str {
        match self {
            Self::AxisKalman => "axis-kalman",
            Self::Classic => "classic",
        }
    }

    /// The filter of this name.
    pub const fn parse(name: &str) -> Option<Self> {
        match name.as_bytes() {
            b"axis-kalman" => Some(Self::AxisKalman),
            b"classic" => Some(Self::Classic),
            _ => None,
        }
    }
}

/// A calibrated sample in body axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sample {
    /// When it was taken, in microseconds since start.
    pub t_us: u64,
    /// Specific force: at rest and level (0, 0, −9.81).
    pub specific_force_m_s2: Vector3,
    /// Angular rate, its offset at rest removed.
    pub angular_rate_rad_s: Vector3,
}

/// What a sample led to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimate {
    /// Body to earth.
    pub attitude: Quaternion,
    /// The body's own rates p, q, r.
    pub body_rates_rad_s: Vector3,
    /// What was wrong with the sample.
    pub remarks: Remarks,
}

/// What was wrong with a sample, and what was done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Remarks {
    /// Time stood still or ran backwards: the attitude is held, time continues from here.
    pub time_went_back: bool,
    /// The step was longer than [`LONGEST_STEP_US`]: roll and pitch start again from the
    /// accelerometer, yaw is kept.
    pub gap: bool,
    /// A value was not finite or absurd: the sample is ignored.
    pub rejected: bool,
    /// The specific force was under [`LEAST_SPECIFIC_FORCE_M_S2`]: the gyroscope alone was used.
    pub no_gravity: bool,
}

/// A filter with its sense of time. Total: whatever comes in, the attitude stays a finite rotation,
/// and good samples bring it back.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimator {
    filter: Filter,
    last_t_us: Option<u64>,
    body_rates_rad_s: Vector3,
}

#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Filter {
    AxisKalman(AxisKalman),
    Classic(Classic),
}

impl Estimator {
    /// An estimator that starts with its first sample.
    pub const fn new(kind: FilterKind) -> Self {
        Self {
            filter: match kind {
                FilterKind::AxisKalman => Filter::AxisKalman(AxisKalman::new()),
                FilterKind::Classic => Filter::Classic(Classic::new()),
            },
            last_t_us: None,
            body_rates_rad_s: Vector3::ZERO,
        }
    }

    /// Forgets everything but the quaternion's sign; yaw starts at zero again.
    pub fn restart(&mut self) {
        match &mut self.filter {
            Filter::AxisKalman(filter) => filter.restart(),
            Filter::Classic(filter) => filter.restart(),
        }
    }

    /// Takes one sample and gives the attitude at its time.
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        let mut remarks = Remarks::default();
        let is_measurement = sample
            .specific_force_m_s2
            .is_within(LARGEST_SPECIFIC_FORCE_M_S2)
            && sample.angular_rate_rad_s.is_within(LARGEST_RATE_RAD_S);
        if is_measurement {
            let force = sample.specific_force_m_s2;
            remarks.no_gravity =
                force.dot(force) < LEAST_SPECIFIC_FORCE_M_S2 * LEAST_SPECIFIC_FORCE_M_S2;
            self.step(sample, &mut remarks);
            self.body_rates_rad_s = sample.angular_rate_rad_s;
        } else {
            remarks.rejected = true;
        }
        Estimate {
            attitude: self.attitude(),
            body_rates_rad_s: self.body_rates_rad_s,
            remarks,
        }
    }

    /// The attitude after the last sample, body to earth.
    pub fn attitude(&self) -> Quaternion {
        match &self.filter {
            Filter::AxisKalman(filter) => filter.attitude(),
            Filter::Classic(filter) => filter.attitude(),
        }
    }

    /// The numbers of the classic tutorial; `None` with any other filter.
    pub fn classic_angles(&self) -> Option<ClassicAngles> {
        match &self.filter {
            Filter::Classic(filter) => Some(filter.angles()),
            Filter::AxisKalman(_) => None,
        }
    }

    fn step(&mut self, sample: &Sample, remarks: &mut Remarks) {
        let last_t_us = self.last_t_us.replace(sample.t_us);
        let measurement = Measurement {
            specific_force_m_s2: (!remarks.no_gravity).then_some(sample.specific_force_m_s2),
            angular_rate_rad_s: sample.angular_rate_rad_s,
        };
        let step_us = match last_t_us {
            // The first sample only sets the tilt.
            None => 0,
            Some(last) if sample.t_us <= last => {
                remarks.time_went_back = true;
                return;
            }
            Some(last) => sample.t_us - last,
        };
        remarks.gap = step_us > LONGEST_STEP_US;
        if step_us == 0 || remarks.gap {
            match &mut self.filter {
                Filter::AxisKalman(filter) => filter.start(&measurement),
                Filter::Classic(filter) => filter.start(&measurement),
            }
            return;
        }
        let dt_s = step_us as u32 as f32 * SECONDS_PER_MICROSECOND;
        match &mut self.filter {
            Filter::AxisKalman(filter) => filter.update(&measurement, dt_s),
            Filter::Classic(filter) => filter.update(&measurement, dt_s),
        }
    }
}

/// What a filter gets: finite values, and a specific force only where it shows gravity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Measurement {
    pub(crate) specific_force_m_s2: Option<Vector3>,
    pub(crate) angular_rate_rad_s: Vector3,
}
