//! Estimates the attitude from calibrated samples.
//!
//! An [`Estimator`] is a gate and a filter. The gate checks each sample and measures the time since
//! the previous one. A filter therefore gets only finite samples, and steps between 1 µs and
//! 0.5 s. The filter is a type parameter:
//!
//! - [`kalman`], the default: one Kalman filter for tilt, velocity and the sensor's parameters;
//! - [`classic`]: the filters of the well-known tutorial, for comparison.
//!
//! Yaw starts at zero and is relative. [`heading`] adds the heading from a compass, beside the
//! default filter.
//!
//! A [`Pipeline`](crate::pipeline::Pipeline) adds the checks that an [`Estimator`] lacks. Samples
//! in SI units, in body axes (forward, right, down), need nothing else:
//!
//! ```
//! use aplomb::attitude::BodyVector;
//! use aplomb::estimator::{Estimator, Sample};
//!
//! let mut estimator = Estimator::new();
//! for millisecond in 0..2_000 {
//!     // At rest and rolled by 30°: m/s², then rad/s.
//!     let force = BodyVector::new(0.0, -4.903, -8.493);
//!     let sample = Sample::new(1_000 * millisecond, force, BodyVector::ZERO);
//!     let estimate = estimator.update(&sample);
//!     let roll_deg = estimate.euler().roll_rad.to_degrees();
//!     let sigma_deg = estimate.tilt_sigma_rad().to_degrees();
//!     assert!((roll_deg - 30.0).abs() < 0.1);
//!     // The first second of rest shows the gyroscope's bias.
//!     assert!(sigma_deg < 2.0 || millisecond < 1_500);
//! }
//! ```

pub(crate) mod arithmetic;
pub mod classic;
mod filter;
pub mod heading;
pub mod kalman;
mod sample;

pub use filter::Filter;
pub use sample::{Estimate, Issues, Sample};

use crate::serialize::StateVisitor;
use crate::units::{SECONDS_PER_MICROSECOND, STANDARD_GRAVITY_M_S2, radians};
use arithmetic::square;
use kalman::{Kalman, WarmStart};

/// Revision of the filters' arithmetic. It increases with every change of an attitude, even by one
/// bit, or of the state's layout. A flight log carries it. `tests/revision.rs` fails when the bits
/// of its flight change and the revision does not.
pub const REVISION: u16 = 35;

/// Longest step that a filter bridges, in µs. After a longer one the motion in between is unknown.
pub const LONGEST_STEP_US: u64 = 500_000;

/// Longest delay of a sensor that a filter takes, in µs: 0.1 s. The slowest low-pass filter of a
/// part delays by 67 ms (MPU-6500 register map r2.1 §4.8).
pub const LONGEST_DELAY_US: u32 = 100_000;

/// Smallest specific force that shows where down is, in m/s²: a quarter of gravity. Below it the
/// accelerometer's offset (80 mg, product specification §6.2) may turn its direction by 20° and
/// more.
pub const LEAST_SPECIFIC_FORCE_M_S2: f32 = 0.25 * STANDARD_GRAVITY_M_S2;

/// Part of the rate limit from one sample to the next, in rad/s: 50 °/s. The limit is
/// √((2·previous)² + (50 °/s)²). No airframe exceeds it in a millisecond. A changed full
/// scale does, and so does a blow to the sensor.
const RATE_JUMP_RAD_S: f32 = radians(50.0);

/// Largest error of the clock that the sensor's own clock corrects, as a share: 8 % of the internal
/// oscillator (STM32F405 datasheet, HSI characteristics) and 5 % of a clone. A longer or shorter
/// period shows something else, such as a missed sample.
const LARGEST_CLOCK_ERROR: f32 = 0.2;
/// Weight of one period in the average of the clock's unit.
const CLOCK_SHARE: f32 = 1.0 / 64.0;

/// From these magnitudes on a sample is no measurement. The largest ranges of this family, ±16 g
/// and ±2000 °/s, on all axes at once are 272 m/s² and 60 rad/s.
const IMPLAUSIBLE_SPECIFIC_FORCE_M_S2: f32 = 400.0;
const IMPLAUSIBLE_RATE_RAD_S: f32 = 90.0;

/// Filter with its gate. The attitude stays a finite rotation for any input, and good samples
/// restore it.
///
/// A [`Pipeline`](crate::pipeline::Pipeline) does more, with its
/// [`update_sample`](crate::pipeline::Pipeline::update_sample) too. The estimator alone
///
/// - does not notice frozen data, a stuck axis, or vibration that clips;
/// - takes a late sample, and then counts the time between twice;
/// - inflates no σ for spurious full-scale readings or wrong full scales;
/// - has no `VALID`: check [`Estimate::is_bias_known`], σ and [`Estimate::issues`];
/// - takes no step for a pause until [`Kalman::set_sample_period`] is called.
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
            GateDecision::Hold => {}
            GateDecision::Start => self.filter.start(sample, shows_gravity),
            GateDecision::Advance { dt_s } => self.filter.update(sample, dt_s, shows_gravity),
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

    /// Corrects the clock that stamps the samples by the sensor's clock: the next sample, at `t_us`
    /// (µs since start), comes one nominal period `period_s` after the last. Call it before the
    /// update with each sample of a clock that is worse than the sensor's. It averages over 64
    /// periods, and ignores one that is off by 20 % or more.
    pub fn follow_sensor_clock(&mut self, t_us: u64, period_s: f32) {
        self.gate.follow_sensor_clock(t_us, period_s);
    }
}

impl Default for Estimator {
    fn default() -> Self {
        Self::new()
    }
}

impl Estimator {
    /// Creates an estimator with the default filter, for a calibrated sensor. The first sample
    /// starts it.
    ///
    /// For a sensor as it left the factory pass `AccelerometerKnowledge::Factory` to
    /// [`set_accelerometer_knowledge`](Kalman::set_accelerometer_knowledge) and
    /// `GyroscopeKnowledge::Factory` to
    /// [`set_gyroscope_knowledge`](Kalman::set_gyroscope_knowledge) of
    /// [`filter_mut`](Self::filter_mut). Else σ is too small.
    pub fn new() -> Self {
        Self::with_filter(Kalman::new())
    }

    /// Continues from the state of an earlier run, whose σ belong to `t_us`, in µs since start.
    /// Samples come later. Until the first one the tilt counts as hidden by a pause: after 0.5 s
    /// the specific force sets it. So it does if σ of the kept tilt is 30° or more. Yaw is kept.
    ///
    /// In motion, or while armed, σ of the tilt is then at least 6.4°, and larger the more the
    /// force differs from one g. That ends with a rest, or when motion has confirmed the bias,
    /// after some 20 s.
    ///
    /// Returns false, and changes nothing, if no filter can have given that state: the memory that
    /// kept it was damaged.
    pub fn resume(&mut self, start: &WarmStart, t_us: u64) -> bool {
        let is_plausible = start.is_plausible();
        if is_plausible {
            self.gate.last_t_us = Some(t_us);
            self.filter.resume(start);
        }
        is_plausible
    }

    /// Visits every field.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self { gate, filter } = self;
        filter.visit_state(visitor);
        gate.visit_state(visitor);
    }
}

/// Action of the filter on a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
enum GateDecision {
    /// Holds the attitude.
    Hold,
    /// Starts from the sample, which is the first one or the first after a gap.
    Start,
    /// Advances by a time step.
    Advance {
        /// Time since the previous sample in seconds, from 1 µs to [`LONGEST_STEP_US`].
        dt_s: f32,
    },
}

/// Gate in front of every filter: time and rate of the last accepted sample, and the clock's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Gate {
    last_t_us: Option<u64>,
    rate_squared: f32,
    /// Duration of a microsecond of the clock that stamps the samples, s.
    seconds_per_us: f32,
}

impl Gate {
    /// Creates a gate without a sample.
    const fn new() -> Self {
        Self {
            last_t_us: None,
            rate_squared: 0.0,
            seconds_per_us: SECONDS_PER_MICROSECOND,
        }
    }

    /// Time of the last accepted sample, in µs.
    const fn last_t_us(&self) -> Option<u64> {
        self.last_t_us
    }

    /// Forgets the last sample's time, so that the next sample starts the filter.
    const fn reset(&mut self) {
        self.last_t_us = None;
    }

    /// Checks a sample. Returns the filter's action and the issues found.
    #[inline]
    fn check(&mut self, sample: &Sample) -> (GateDecision, Issues) {
        let force = sample.specific_force_m_s2;
        let rate = sample.angular_rate_rad_s;
        let (force_squared, rate_squared) = (force.dot(force), rate.dot(rate));
        // A NaN fails every comparison.
        let is_measurement = force_squared <= square(IMPLAUSIBLE_SPECIFIC_FORCE_M_S2)
            && rate_squared <= square(IMPLAUSIBLE_RATE_RAD_S);
        if !is_measurement {
            return (GateDecision::Hold, Issues::REJECTED);
        }
        let mut issues = Issues::empty();
        if force_squared < square(LEAST_SPECIFIC_FORCE_M_S2) {
            issues |= Issues::NO_GRAVITY;
        }
        if rate_squared > 4.0 * self.rate_squared + square(RATE_JUMP_RAD_S) {
            issues |= Issues::RATE_JUMP;
        }
        self.rate_squared = rate_squared;
        let Some(last_t_us) = self.last_t_us.replace(sample.t_us) else {
            return (GateDecision::Start, issues);
        };
        if sample.t_us <= last_t_us {
            return (GateDecision::Hold, issues | Issues::TIME_WENT_BACK);
        }
        let step_us = sample.t_us - last_t_us;
        if step_us > LONGEST_STEP_US {
            return (GateDecision::Start, issues | Issues::GAP);
        }
        let dt_s = step_us as u32 as f32 * self.seconds_per_us;
        (GateDecision::Advance { dt_s }, issues)
    }

    /// Measures the clock's unit by the period from the last sample to this one.
    fn follow_sensor_clock(&mut self, t_us: u64, period_s: f32) {
        let Some(last_t_us) = self.last_t_us else {
            return;
        };
        let found = period_s / t_us.saturating_sub(last_t_us) as f32;
        let error = found - SECONDS_PER_MICROSECOND;
        if error.abs() < LARGEST_CLOCK_ERROR * SECONDS_PER_MICROSECOND {
            self.seconds_per_us += CLOCK_SHARE * (found - self.seconds_per_us);
        }
    }

    /// Visits every field.
    fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            last_t_us,
            rate_squared,
            seconds_per_us,
        } = self;
        visitor.optional(last_t_us, 0, StateVisitor::u64);
        visitor.f32(rate_squared);
        visitor.f32(seconds_per_us);
    }
}

#[cfg(test)]
mod tests;
