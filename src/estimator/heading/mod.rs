//! Heading from a compass, beside the tilt filter.
mod covariance;
mod interval;
mod measurement;
mod step;
mod tuning;

pub use tuning::Tuning;

use super::kalman::Kalman;
use super::kalman::follow::{ERROR_STATES, FIRST_GYROSCOPE};
use crate::attitude::wrap_pi;
use crate::units::{MagneticField, SECONDS_PER_MICROSECOND};
use covariance::{Covariance, CrossRow, DEVIATION, FIELD, IRON, STATES};
use interval::Interval;
use step::Phase;
use tuning::square;

/// Shortest time between two earth steps that are added, s. Their sums serve the covariance alone.
const EARTH_PERIOD_S: f32 = 10.0e-3;
/// Period of the slices, s: a step is complete before the next one is due.
const SLICE_PERIOD_S: f32 = 1.7e-3;
/// Sample period from which on slices run beside earth steps, s.
const LONG_SAMPLE_PERIOD_S: f32 = 1.7e-3;
/// Sample period above which a step runs at once, s: the tilt filter's next step may follow with
/// the next sample.
const LONGEST_SLICED_S: f32 = 4.0e-3;
/// Upper limit of the slices per sample: more than a step has.
const MOST_SLICES: u32 = 160;

/// Largest sum of a reading's components, µT: no compass of this kind reaches it.
const LARGEST_FIELD_UT: f32 = 15_000.0;

/// Knowledge of the compass's hard iron before the first reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CompassKnowledge {
    /// Nothing.
    #[default]
    Factory,
    /// Calibrated.
    Calibrated,
}

impl CompassKnowledge {
    /// Returns σ of the hard iron per axis, µT.
    pub const fn sigma_ut(self) -> f32 {
        match self {
            Self::Factory => 200.0,
            Self::Calibrated => 0.5,
        }
    }
}

/// Heading of the level frame, and its σ.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HeadingEstimate {
    /// Heading minus yaw, rad.
    pub yaw_offset_rad: f32,
    /// σ of the heading, rad.
    pub sigma_rad: f32,
    /// True if the heading is valid.
    pub is_valid: bool,
}

/// The heading filter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Heading {
    tuning: &'static Tuning,
    knowledge: CompassKnowledge,
    phase: Phase,
    declination_rad: f32,
    state: [f32; STATES],
    elapsed_s: f32,
    /// Sums of the present interval, and of the one before, whose step is under way.
    intervals: [Interval; 2],
    /// Place of the present interval.
    present: u8,
    /// True if the present interval has an earth step.
    has_interval: bool,
    /// True if a reading waits for the next sample.
    has_reading: bool,
    reading_ut: [f32; 3],
    reading_age_s: f32,
    covariance: Covariance,
    column: CrossRow,
    own: [f32; STATES],
    inverse: f32,
    noise: f32,
    motion: f32,
    excess: f32,
    contradiction: f32,
    inconsistency: f32,
    contradicted_s: f32,
    estimate: Option<HeadingEstimate>,
}

impl Heading {
    /// Creates a filter.
    pub fn new(knowledge: CompassKnowledge) -> Self {
        Self::with_tuning(knowledge, &Tuning::DEFAULT)
    }

    /// Creates a filter with this tuning.
    pub fn with_tuning(knowledge: CompassKnowledge, tuning: &'static Tuning) -> Self {
        let mut filter = Self {
            tuning,
            knowledge,
            declination_rad: 0.0,
            state: [0.0; STATES],
            covariance: Covariance::ZERO,
            phase: Phase::Idle,
            elapsed_s: 0.0,
            intervals: [Interval::EMPTY; 2],
            present: 0,
            has_interval: false,
            has_reading: false,
            reading_ut: [0.0; 3],
            reading_age_s: 0.0,
            column: [0.0; ERROR_STATES],
            own: [0.0; STATES],
            inverse: 0.0,
            motion: 0.0,
            excess: 0.0,
            noise: 0.0,
            contradiction: 0.0,
            inconsistency: 0.0,
            contradicted_s: 0.0,
            estimate: None,
        };
        filter.reset_field();
        filter.reset_iron(square(knowledge.sigma_ut()));
        filter
    }

    /// Returns the heading.
    pub fn estimate(&self) -> Option<HeadingEstimate> {
        self.estimate
    }

    /// Returns the states.
    pub fn states(&self) -> &[f32; 9] {
        &self.state
    }

    fn reset_field(&mut self) {
        let (field, deviation) = (
            square(self.tuning.start_field_ut),
            square(self.tuning.deviation_ut),
        );
        for axis in 0..3 {
            self.covariance.reset(FIELD + axis, field);
            self.covariance.reset(DEVIATION + axis, deviation);
        }
        let [cx, cy, cz, _, _, _, dx, dy, dz] = &mut self.state;
        for state in [cx, cy, cz, dx, dy, dz] {
            *state = 0.0;
        }
        self.estimate = None;
        self.contradiction = 0.0;
        self.inconsistency = 0.0;
        self.contradicted_s = 0.0;
        self.excess = 0.0;
    }

    fn reset_iron(&mut self, variance: f32) {
        for axis in 0..3 {
            self.covariance.reset(IRON + axis, variance);
        }
    }

    fn restart(&mut self) {
        self.reset_field();
        let iron = square(self.knowledge.sigma_ut()) + square(self.tuning.restart_hard_iron_ut);
        self.reset_iron(iron);
        if !self.state.iter().all(|state| state.abs() < 1.0e4) {
            self.state = [0.0; STATES];
        }
    }

    /// Adds a reading of the compass, in body axes. Its motion was `age_us` before that of the last
    /// sample that the filter has followed. Readings that no compass delivers are ignored.
    ///
    /// The reading takes effect with the next sample.
    pub fn add_field(&mut self, field: MagneticField, age_us: u32) {
        let [x, y, z] = field.ut;
        let size = x.abs() + y.abs() + z.abs();
        // A NaN fails the comparison.
        self.has_reading = size < LARGEST_FIELD_UT;
        self.reading_ut = field.ut;
        self.reading_age_s = age_us as f32 * SECONDS_PER_MICROSECOND;
    }

    /// Follows the tilt filter, after each of its samples, `dt_s` seconds after the previous one.
    #[inline]
    pub fn follow(&mut self, kalman: &Kalman, dt_s: f32) {
        self.elapsed_s += dt_s;
        let is_earth_step = kalman.is_at_earth_step();
        if is_earth_step && self.elapsed_s > EARTH_PERIOD_S {
            self.add_earth_step(kalman);
        }
        if kalman.interval_s() == 0.0 && self.has_interval {
            self.close(kalman);
            // The tilt filter has just begun a step: the reading can wait.
            self.reading_age_s += dt_s;
            return;
        }
        if self.has_reading {
            self.add_reading(kalman, dt_s);
            // A slice can wait, unless samples are rare.
            if dt_s < LONG_SAMPLE_PERIOD_S && self.phase != Phase::Waiting {
                return;
            }
        }
        match self.phase {
            Phase::Idle => {}
            Phase::Waiting => {
                if !kalman.is_step_under_way() {
                    self.phase = Phase::Propagate(0);
                    if dt_s > LONGEST_SLICED_S {
                        self.run_slices(kalman, dt_s, false);
                    }
                }
            }
            _ => self.run_slices(kalman, dt_s, is_earth_step),
        }
    }

    #[inline(never)]
    fn add_reading(&mut self, kalman: &Kalman, dt_s: f32) {
        self.has_reading = false;
        if kalman.has_tilt() {
            let (field_ut, age_s) = (self.reading_ut, self.reading_age_s + dt_s);
            self.interval().add_reading(kalman, field_ut, age_s);
        }
    }

    /// Returns the present interval.
    #[inline]
    fn interval(&mut self) -> &mut Interval {
        let [first, second] = &mut self.intervals;
        if self.present == 0 { first } else { second }
    }

    /// Returns the interval of the step under way.
    #[inline]
    fn closed(&self) -> &Interval {
        let [first, second] = &self.intervals;
        if self.present == 0 { second } else { first }
    }

    /// Returns the interval of the step under way, for changes.
    #[inline]
    fn closed_mut(&mut self) -> &mut Interval {
        let [first, second] = &mut self.intervals;
        if self.present == 0 { second } else { first }
    }

    #[inline(never)]
    fn add_earth_step(&mut self, kalman: &Kalman) {
        let elapsed_s = self.elapsed_s;
        self.interval().add_earth_step(kalman, elapsed_s);
        self.elapsed_s = 0.0;
        self.has_interval = true;
    }

    /// Runs slices of the step: one a sample at 1 kHz, beside neither an earth step nor a slice of
    /// the tilt filter. Where samples are rarer there are more; and all that are left if the tilt
    /// filter is about to begin its next step.
    #[inline(never)]
    fn run_slices(&mut self, kalman: &Kalman, dt_s: f32, is_earth_step: bool) {
        let slices = if kalman.has_work() || dt_s > LONGEST_SLICED_S {
            MOST_SLICES
        } else if is_earth_step && dt_s < LONG_SAMPLE_PERIOD_S {
            0
        } else {
            1 + ((dt_s * (1.0 / SLICE_PERIOD_S)) as u32).min(MOST_SLICES)
        };
        for _ in 0..slices {
            if self.phase == Phase::Idle {
                return;
            }
            self.slice(kalman);
        }
    }

    /// Closes the interval: its step follows that of the tilt filter.
    #[inline(never)]
    fn close(&mut self, kalman: &Kalman) {
        self.has_interval = false;
        if kalman.is_motion_reset() {
            self.follow_reset(kalman);
            return;
        }
        *self.closed_mut() = Interval::EMPTY;
        self.present ^= 1;
        self.phase = Phase::Waiting;
    }

    /// Forgets the field after a reset of the tilt.
    #[cold]
    #[inline(never)]
    fn follow_reset(&mut self, kalman: &Kalman) {
        let known = if kalman.are_parameters_reset() {
            ERROR_STATES
        } else {
            FIRST_GYROSCOPE
        };
        for state in 0..known {
            self.covariance.scale_cross(state, 0.0);
        }
        self.reset_field();
        self.intervals = [Interval::EMPTY; 2];
        self.phase = Phase::Idle;
    }

    /// Sets the declination, rad: the heading is then that from true north. Default: 0.
    pub fn set_declination(&mut self, declination_rad: f32) {
        self.declination_rad = wrap_pi(declination_rad);
    }
}
