//! Estimates the attitude from calibrated samples.
//!
//! An [`Estimator`] is a gate and a filter. The gate checks each sample and measures the time since
//! the previous one. A filter therefore gets only finite samples, and steps between 1 µs and 0.5 s.
//! The filter is a type parameter:
//!
//! - [`kalman`], the default: one Kalman filter for tilt, velocity and the sensor's parameters;
//! - [`classic`]: the filters of the well-known tutorial, for comparison.
//!
//! No filter here has a compass: yaw starts at zero and is relative.
//!
//! Samples in SI units, in body axes (forward, right, down), need nothing else:
//!
//! ```
//! use aplomb::attitude::Vector3;
//! use aplomb::estimator::{Estimator, Sample};
//!
//! let mut estimator = Estimator::new();
//! for millisecond in 0..2_000 {
//!     // At rest and rolled by 30°: m/s², then rad/s.
//!     let force = Vector3::new(0.0, -4.903, -8.493);
//!     let sample = Sample::new(1_000 * millisecond, force, Vector3::ZERO);
//!     let estimate = estimator.update(&sample);
//!     let roll_deg = estimate.euler().roll_rad.to_degrees();
//!     let sigma_deg = estimate.tilt_sigma_rad().to_degrees();
//!     assert!((roll_deg - 30.0).abs() < 0.1 && sigma_deg < 20.0);
//! }
//! ```

pub mod classic;
mod filter;
mod gate;
pub mod kalman;
mod sample;

pub use filter::Filter;
pub use gate::{LEAST_SPECIFIC_FORCE_M_S2, LONGEST_STEP_US};
pub use sample::{Estimate, Issues, Sample};

use crate::serialize::StateVisitor;
use gate::{Gate, Step};
use kalman::Kalman;

/// Revision of the filters' arithmetic. It increases with every change of an attitude, even by one
/// bit, or of the state's layout. A flight log carries it. `tests/revision.rs` fails when the bits
/// change and the revision does not.
pub const REVISION: u16 = 3;

/// Filter with its gate. The attitude stays a finite rotation for any input, and good samples
/// restore it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimator<F = Kalman> {
    gate: Gate,
    filter: F,
}

impl<F: Filter> Estimator<F> {
    /// Creates an estimator with this filter. The first sample starts it.
    pub const fn with_filter(filter: F) -> Self {
        Self {
            gate: Gate::new(),
            filter,
        }
    }

    /// Updates with one sample, and returns the attitude at the sample's time.
    #[inline]
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        let (step, issues) = self.gate.check(sample);
        let shows_gravity = !issues.contains(Issues::NO_GRAVITY);
        match step {
            Step::Hold => {}
            Step::Start => self.filter.start(sample, shows_gravity),
            Step::Advance { dt_s } => self.filter.update(sample, dt_s, shows_gravity),
        }
        self.estimate_with(issues)
    }

    /// Returns the estimate after the last sample, without its issues.
    pub fn estimate(&self) -> Estimate {
        self.estimate_with(Issues::empty())
    }

    #[inline(always)]
    fn estimate_with(&self, issues: Issues) -> Estimate {
        Estimate {
            attitude: self.filter.attitude(),
            body_rates_rad_s: self.filter.body_rates_rad_s(),
            tilt_variance_rad2: self.filter.tilt_variance_rad2(),
            is_bias_known: self.filter.is_bias_known(),
            issues,
        }
    }

    /// Returns the time of the last accepted sample, in µs since start.
    pub const fn last_t_us(&self) -> Option<u64> {
        self.gate.last_t_us()
    }

    /// Returns the filter.
    pub const fn filter(&self) -> &F {
        &self.filter
    }

    /// Returns the filter for changes that are not in the samples: its settings, and unobserved
    /// motion.
    pub const fn filter_mut(&mut self) -> &mut F {
        &mut self.filter
    }

    /// Resets everything but the settings and the quaternion's sign. Yaw starts at zero again.
    pub fn restart(&mut self) {
        self.gate.reset();
        self.filter.restart();
    }

    /// Makes the next sample set the tilt from its specific force, as after a gap. Yaw and the
    /// sensor's parameters are kept.
    pub const fn reset_tilt(&mut self) {
        self.gate.reset();
    }
}

impl Default for Estimator {
    fn default() -> Self {
        Self::new()
    }
}

impl Estimator {
    /// Creates an estimator with the default filter. The first sample starts it.
    pub fn new() -> Self {
        Self::with_filter(Kalman::new())
    }

    /// Visits every field.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        self.filter.visit_state(visitor);
        self.gate.visit_state(visitor);
    }
}

#[cfg(test)]
mod tests;
