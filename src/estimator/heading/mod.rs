//! Heading from a compass, beside the tilt filter.
//!
//! The tilt filter's attitude leads from body axes to a *level frame*: down is known, and its
//! heading is whatever the gyroscope says. The compass never turns this attitude. Nine states
//! describe the field instead, in microtesla:
//!
//! - c, the earth's field in the level frame. The level frame turns slowly by the gyroscope's
//!   errors, and c turns with it. Its horizontal part points to magnetic north.
//! - b, the hard iron, in body axes.
//! - d, a slow local deviation in the level frame: steel in the floor, cables, a table.
//!
//! The measurement z = c + d + W·b is linear in all of them. There is no first heading to find and
//! no linearisation about one: the filter starts in any attitude, at rest or in motion.
//!
//! # Symbols
//!
//! | symbol | stands for | in code |
//! |---|---|---|
//! | f | the states: c, b and d | `Heading::state` |
//! | ε | errors of the tilt filter's states; θ of the tilt comes first | `ERROR_STATES` |
//! | O | the filter's *own* covariance: of f, 9 × 9 | `FieldCovariance::triangle` |
//! | X | *cross*-covariance: c and b with ε, 6 × 19 | `FieldCovariance::cross` |
//! | P | the tilt filter's covariance: of ε, 19 × 19 | `kalman/covariance.rs` |
//! | J | joint covariance of f and ε: O, X and P | – |
//! | z, W | means of R·m and R: R from body to level axes, m a reading | `field_ut`, `rotation` |
//! | h | row of an axis of z, over f and ε | `measurement.rs`: `Row` |
//! | s | variance of an axis's innovation | `1.0 / inverse_variance` |
//! | ψ | row over ε: yaw over an interval per error of the gyroscope | `FieldInterval::yaw` |
//! | δ | correction of ε by the tilt filter's step | `gyroscope_correction` |
//! | e_i, p_i | unit vector of the tilt filter's measurement i; X·e_i before it | `step.rs` |
//!
//! # Passive
//!
//! The filter reads the tilt filter and changes nothing in it, so the attitude with a compass is
//! that without one, to the bit. A magnet cannot tilt the horizon. The errors of all its states are
//! *considered*: X, their cross-covariance with c and b, follows each of the tilt filter's
//! covariance steps.
//!
//! A slow change of the gyroscope's offset about down turns the level frame, and nothing shows it
//! to the tilt filter. While the heading is valid, a 60th of each correction of c therefore counts
//! as a rate of yaw, and turns c from then on.
//!
//! # Disturbances
//!
//! - d belongs to the place. Its memory is 10 s at rest and 0.3 s in motion. So a wrong field at
//!   rest counts as one measurement, and in motion it averages out.
//! - The squared innovation beyond 0.2 of the expected one adds to the noise at once. It also
//!   inflates b and d for a while, because a magnet may have been attached.
//! - Before the body has moved and turned, a magnet beside it, iron on it and a wrong mount look
//!   like north. The heading is not valid until 2.5 s of motion agree with it; for an uncalibrated
//!   compass 6 s, with turns about two axes.
//! - If the innovation stays large while the field's length fits, the field is right and the
//!   filter is wrong. It restarts with uncertain hard iron. A valid heading then needs the motion
//!   that an uncalibrated compass needs.
//!
//! # Cost
//!
//! Deadline: one sample. `docs/results.md` has the instructions that a sample costs with both
//! filters. Below 250 Hz a whole step runs with one sample.
//!
//! ```
//! use aplomb::attitude::BodyVector;
//! use aplomb::estimator::heading::{CompassKnowledge, Heading};
//! use aplomb::estimator::{Estimator, Sample};
//! use aplomb::units::{MagneticField, STANDARD_GRAVITY_M_S2};
//!
//! let mut estimator = Estimator::new();
//! let mut heading = Heading::new(CompassKnowledge::Calibrated);
//! for index in 0..3_000_u64 {
//!     // Level and at rest, its nose to the east.
//!     let force = BodyVector::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
//!     estimator.update(&Sample::new(1_000 * index, force, BodyVector::ZERO));
//!     heading.update(estimator.filter(), 0.001);
//!     if index % 10 == 0 {
//!         let field = MagneticField { ut: [0.0, -20.0, 45.0] };
//!         heading.add_field(field, 5_000);
//!     }
//! }
//! let estimate = heading.estimate().expect("a heading");
//! let yaw_rad = estimator.estimate().euler().yaw_rad;
//! assert!((estimate.heading_rad(yaw_rad).to_degrees() - 90.0).abs() < 1.0);
//! ```

mod covariance;
mod interval;
mod knowledge;
mod measurement;
mod state;
mod step;
mod tuning;

#[cfg(test)]
mod tests;

pub use knowledge::CompassKnowledge;
pub use tuning::HeadingTuning;
pub(crate) use tuning::VALID_TILT_RAD;

use super::arithmetic::{larger, square};
use super::kalman::Kalman;
use super::kalman::heading_access::ERROR_STATES;
use crate::attitude::{Quaternion, Vector3, wrap_pi};
use crate::units::{MagneticField, SECONDS_PER_MICROSECOND};
use covariance::{CrossRow, DEVIATION, FIELD, FieldCovariance, IRON, STATES};
use interval::{FieldInterval, IntervalPair};
use step::FieldSlice;

/// Shortest time between two earth steps that are added, s. Their sums serve the covariance, and
/// the turn of the field by the tilt filter's corrections.
const EARTH_PERIOD_S: f32 = 10.0e-3;
/// Period of the slices, s: a step is complete before the next one is due. The tilt filter's slices
/// have longer periods (`kalman/mod.rs`).
const FIELD_SLICE_PERIOD_S: f32 = 1.7e-3;
/// Sample period from which on slices of the field run beside earth steps, s.
const FIELD_LONG_SAMPLE_PERIOD_S: f32 = 1.7e-3;
/// Sample period above which a step runs at once, s: the tilt filter's next step may follow with
/// the next sample.
const LONGEST_SLICED_S: f32 = 4.0e-3;
/// Upper limit of the slices per sample: more than a step has.
const MOST_FIELD_SLICES: u32 = 160;

/// Heading of the level frame, in which yaw is zero.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HeadingEstimate {
    /// Heading minus yaw, rad in (−π, π]. The absolute attitude is the quaternion turned by it
    /// about down.
    pub yaw_offset_rad: f32,
    /// σ of the heading, rad.
    pub sigma_rad: f32,
    /// True if the heading is wrong by no more than the larger of 15° and six σ, provided that
    /// the tilt is valid. The body has to move and turn first.
    pub is_valid: bool,
}

impl HeadingEstimate {
    /// Returns the heading for this yaw, both in rad: that of body forward, clockwise from north,
    /// in (−π, π].
    pub fn heading_rad(&self, yaw_rad: f32) -> f32 {
        wrap_pi(yaw_rad + self.yaw_offset_rad)
    }
}

/// The heading filter: [`update`](Self::update) it after each sample of the tilt filter.
///
/// The fields keep this order in memory, because a core reaches the first kilobyte with shorter
/// code.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Heading {
    tuning: &'static HeadingTuning,
    next_slice: FieldSlice,
    /// Place of the open interval in `intervals`.
    open: u8,
    /// True if the open interval has an earth step.
    has_interval: bool,
    /// True if a reading waits for the next sample.
    has_reading: bool,
    /// Number of changes of the estimate, which wraps.
    changes: u8,
    /// True after turns about two axes.
    has_two_axes: bool,
    /// True if a calibration or an earlier flight has given the hard iron, until a restart.
    is_iron_known: bool,
    /// Time since the last earth step that was added, s.
    elapsed_s: f32,
    /// Scratch of the step, from `FieldSlice::Relax` to `FieldSlice::Finish`: turn of the level
    /// frame, rad, by what the tilt filter's step corrected, from the interval's end to the
    /// correction.
    late_turn_rad: f32,
    /// Scratch of the step, from `FieldSlice::Expect` to `FieldSlice::Gate`: expected squared
    /// innovation of all axes without noise.
    expected_ut2: f32,
    /// Scratch of the step, from `FieldSlice::Gate` on: variance of an axis's noise.
    noise_ut2: f32,
    /// Scratch of the step, from `FieldSlice::CorrectStates` on: inverse of the innovation variance
    /// of an axis, 1/µT².
    inverse_variance: f32,
    /// Rate of the level frame about down that the gyroscope does not show, rad/s.
    drift_rad_s: f32,
    /// Motion of the body: 0 at rest, at most 1.
    motion: f32,
    /// Recent excess of the squared innovation, µT².
    excess: f32,
    /// Mean squared innovation beyond what an error of the field's length explains, µT².
    contradiction: f32,
    /// Mean squared innovation per expected one.
    inconsistency: f32,
    /// Time for which the innovation has contradicted the field, s.
    contradicted_s: f32,
    /// Time without a reading, s.
    silent_s: f32,
    /// Time in motion, in proportion to it, turned away from `first_attitude`, s.
    verified_s: f32,
    /// Time since `first_attitude` was taken, s. Infinite: the next measurement takes it anew.
    since_first_s: f32,
    reading_ut: [f32; 3],
    reading_age_s: f32,
    /// Field, hard iron and local deviation, µT.
    state: [f32; STATES],
    /// Scratch of the step, which three of its parts use:
    ///
    /// - From `FieldSlice::RepeatOnCross` on: p_i/r_i of a row of X for each measurement i of the
    ///   tilt filter, the gains.
    /// - From `FieldSlice::ProjectDrift` on: X·ψᵀ, covariance of c and b with the drift of yaw.
    /// - From `FieldSlice::Project` on: the entries of J·hᵀ at f, for an axis.
    own_scratch: [f32; STATES],
    /// Scratch of the step, which two of its parts use:
    ///
    /// - From `FieldSlice::Drift` on: P·ψᵀ, covariance of ε with the drift of yaw.
    /// - From `FieldSlice::ProjectCross` on: the entries of J·hᵀ at ε, for an axis.
    cross_scratch: CrossRow,
    /// Sums of the open interval, and of the closed one, whose step is under way.
    intervals: IntervalPair,
    covariance: FieldCovariance,
    knowledge: CompassKnowledge,
    /// True after the first update that had a reading.
    has_started: bool,
    declination_rad: f32,
    /// Attitude from which turns count, of the last 15 s.
    first_attitude: Quaternion,
    /// Largest turn from there: axis in body axes, times the sine of half the angle. Zero before.
    largest_turn: Vector3,
    estimate: Option<HeadingEstimate>,
    /// Time of the last sample that [`update_to`](Self::update_to) has processed, µs.
    updated_us: u64,
}

impl Heading {
    /// Creates a filter without a reading.
    pub fn new(knowledge: CompassKnowledge) -> Self {
        Self::with_tuning(knowledge, &HeadingTuning::DEFAULT)
    }

    /// Creates a filter with this tuning.
    pub fn with_tuning(knowledge: CompassKnowledge, tuning: &'static HeadingTuning) -> Self {
        let mut filter = Self {
            tuning,
            knowledge,
            declination_rad: 0.0,
            state: [0.0; STATES],
            covariance: FieldCovariance::ZERO,
            next_slice: FieldSlice::Idle,
            elapsed_s: 0.0,
            late_turn_rad: 0.0,
            intervals: IntervalPair::EMPTY,
            open: 0,
            has_interval: false,
            has_reading: false,
            reading_ut: [0.0; 3],
            reading_age_s: 0.0,
            cross_scratch: [0.0; ERROR_STATES],
            own_scratch: [0.0; STATES],
            inverse_variance: 0.0,
            drift_rad_s: 0.0,
            motion: 0.0,
            excess: 0.0,
            expected_ut2: 0.0,
            noise_ut2: 0.0,
            contradiction: 0.0,
            inconsistency: 0.0,
            contradicted_s: 0.0,
            silent_s: 0.0,
            updated_us: 0,
            has_started: false,
            first_attitude: Quaternion::IDENTITY,
            largest_turn: Vector3::ZERO,
            since_first_s: f32::INFINITY,
            has_two_axes: false,
            is_iron_known: knowledge != CompassKnowledge::Factory,
            verified_s: 0.0,
            estimate: None,
            changes: 0,
        };
        filter.reset_field();
        filter.reset_iron(square(knowledge.sigma_ut()));
        filter
    }

    /// Starts again without a reading, with the same settings: the body axes have changed.
    pub fn reset(&mut self) {
        *self = Self {
            declination_rad: self.declination_rad,
            changes: self.changes.wrapping_add(1),
            ..Self::with_tuning(self.knowledge, self.tuning)
        };
    }

    /// Sets the declination, rad, east positive: the heading is then that from true north. Default:
    /// 0, for the heading from magnetic north. Ignores infinity and NaN.
    pub fn set_declination(&mut self, declination_rad: f32) {
        if !declination_rad.is_finite() {
            return;
        }
        let turn_rad = declination_rad - self.declination_rad;
        self.declination_rad = declination_rad;
        if let Some(estimate) = &mut self.estimate {
            estimate.yaw_offset_rad = wrap_pi(estimate.yaw_offset_rad + turn_rad);
        }
        self.changes = self.changes.wrapping_add(1);
    }

    /// Returns the declination, rad.
    pub const fn declination_rad(&self) -> f32 {
        self.declination_rad
    }

    /// Returns the heading; `None` while σ is above 29° (0.5 rad).
    pub const fn estimate(&self) -> Option<HeadingEstimate> {
        self.estimate
    }

    /// Returns the number of changes of the estimate, which wraps: another number means another
    /// estimate.
    #[inline]
    pub const fn changes(&self) -> u8 {
        self.changes
    }

    /// Returns the earth's field in the level frame, µT: along yaw zero, to its right, down.
    pub const fn field_ut(&self) -> Vector3 {
        let [x, y, z, ..] = self.state;
        Vector3::new(x, y, z)
    }

    /// Returns the hard iron that the filter has found, µT in body axes.
    pub const fn hard_iron_ut(&self) -> Vector3 {
        let [_, _, _, x, y, z, ..] = self.state;
        Vector3::new(x, y, z)
    }

    /// Returns σ of [`hard_iron_ut`](Self::hard_iron_ut), µT.
    pub fn hard_iron_sigma_ut(&self) -> Vector3 {
        let sigma = |axis| {
            let state = IRON + axis;
            libm::sqrtf(self.covariance.entry(state, state).max(0.0))
        };
        Vector3::new(sigma(0), sigma(1), sigma(2))
    }

    /// Returns the hard iron, µT in body axes, once it is certain enough for a later start with
    /// [`CompassKnowledge::HardIron`]: the heading is valid, and σ of each axis is below 3 µT.
    /// `None` for a calibrated compass: a new calibration is better.
    pub fn certain_hard_iron_ut(&self) -> Option<Vector3> {
        const LARGEST_VARIANCE_UT2: f32 = square(3.0);
        let is_valid = self.estimate.is_some_and(|estimate| estimate.is_valid)
            && self.knowledge != CompassKnowledge::Calibrated;
        let is_certain = |state| self.covariance.entry(state, state) < LARGEST_VARIANCE_UT2;
        (is_valid && (IRON..IRON + 3).all(is_certain)).then(|| self.hard_iron_ut())
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
        self.set_estimate(None);
        self.drift_rad_s = 0.0;
        self.contradiction = 0.0;
        self.inconsistency = 0.0;
        self.contradicted_s = 0.0;
        self.excess = 0.0;
        self.forget_turns();
    }

    fn set_estimate(&mut self, estimate: Option<HeadingEstimate>) {
        self.estimate = estimate;
        self.changes = self.changes.wrapping_add(1);
    }

    fn reset_iron(&mut self, variance: f32) {
        for axis in 0..3 {
            self.covariance.reset(IRON + axis, variance);
        }
    }

    fn restart(&mut self) {
        // A product with zero keeps a NaN.
        self.covariance = FieldCovariance::ZERO;
        self.reset_field();
        self.is_iron_known = false;
        let iron = square(self.knowledge.sigma_ut()) + square(self.tuning.restart_hard_iron_ut);
        self.reset_iron(iron);
        if !self.state.iter().all(|state| state.abs() < 1.0e4) {
            self.state = [0.0; STATES];
        }
    }

    /// Adds a reading of the compass, in body axes. Its motion was `age_us` before that of the last
    /// sample of the last update. Ignores readings that no compass delivers, and those that are
    /// older than a second.
    ///
    /// The reading takes effect with the next sample. A reading that waits for it is replaced.
    pub fn add_field(&mut self, field: MagneticField, age_us: u32) {
        if Self::uses_field(field, age_us) {
            self.has_reading = true;
            self.reading_ut = field.ut;
            self.reading_age_s = age_us as f32 * SECONDS_PER_MICROSECOND;
        }
    }

    /// Returns whether the filter needs each sample: true from the first reading on.
    pub const fn is_running(&self) -> bool {
        self.has_reading || self.has_started
    }

    /// Processes the last sample of the tilt filter, at `t_us` (µs): like [`update`](Self::update)
    /// with the time since the last call. Does nothing before the first reading, or if the time is
    /// not later than that of the last call.
    #[inline]
    pub fn update_to(&mut self, kalman: &Kalman, t_us: u64) {
        if !self.is_running() {
            return;
        }
        let before_us = core::mem::replace(&mut self.updated_us, t_us);
        let step_us = t_us.saturating_sub(before_us);
        if core::mem::replace(&mut self.has_started, true) && step_us > 0 {
            let step_us = u32::try_from(step_us).unwrap_or(u32::MAX);
            self.update(kalman, step_us as f32 * SECONDS_PER_MICROSECOND);
        }
    }

    /// Processes the last sample of the tilt filter, `dt_s` seconds after the previous one.
    ///
    /// Runs at most one slice of a step at 1 kHz, two at 500 Hz and three at 250 Hz. Runs the whole
    /// rest of the step below 250 Hz, or if the tilt filter's next step is due.
    #[inline]
    pub fn update(&mut self, kalman: &Kalman, dt_s: f32) {
        if kalman.are_tilt_and_velocity_reset()
            && (self.covariance.is_correlated() || self.next_slice != FieldSlice::Idle)
        {
            self.reset_with_tilt();
        }
        self.elapsed_s += dt_s;
        let is_earth_step = kalman.is_at_earth_step();
        if is_earth_step && self.elapsed_s > EARTH_PERIOD_S {
            self.add_earth_step(kalman, dt_s);
        }
        if kalman.interval_s() == 0.0 && self.has_interval {
            self.end_interval();
            // The tilt filter has just begun a step: the reading can wait.
            self.reading_age_s += dt_s;
            return;
        }
        if self.has_reading {
            self.add_reading(kalman, dt_s);
            // A slice can wait, unless samples are rare, or the step has to end.
            let can_wait = self.next_slice != FieldSlice::Waiting && !kalman.is_step_pending();
            if dt_s < FIELD_LONG_SAMPLE_PERIOD_S && can_wait {
                return;
            }
        }
        match self.next_slice {
            FieldSlice::Idle => {}
            FieldSlice::Waiting => {
                if !kalman.is_step_under_way() {
                    self.next_slice = FieldSlice::Propagate(0);
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
        self.has_started = true;
        if kalman.has_tilt() {
            let (field_ut, age_s) = (self.reading_ut, self.reading_age_s + dt_s);
            let interval = self.intervals.open_mut(self.open);
            interval.add_reading(kalman, field_ut, age_s);
        }
    }

    /// Returns the closed interval: that of the step under way.
    #[inline]
    fn closed(&self) -> &FieldInterval {
        self.intervals.closed(self.open)
    }

    #[inline(never)]
    fn add_earth_step(&mut self, kalman: &Kalman, dt_s: f32) {
        let elapsed_s = core::mem::take(&mut self.elapsed_s);
        if !kalman.has_tilt() {
            *self.intervals.open_mut(self.open) = FieldInterval::EMPTY;
            return;
        }
        let interval = self.intervals.open_mut(self.open);
        interval.add_earth_step(kalman, elapsed_s);
        // A pause, which the tilt filter may already have used.
        let before = interval.unseen_rad2;
        let unseen = before + kalman.pause_variance_rad2(dt_s);
        let unseen = larger(unseen, kalman.unseen_tilt_rad2());
        interval.unseen_rad2 = unseen;
        self.has_interval = true;
        if unseen > before {
            self.inflate_estimate(kalman, unseen - before);
        }
    }

    /// Runs slices of the step: one a sample at 1 kHz, beside neither an earth step nor a slice of
    /// the tilt filter. Where samples are rarer there are more; and all that are left if the tilt
    /// filter is about to begin its next step.
    #[inline(never)]
    fn run_slices(&mut self, kalman: &Kalman, dt_s: f32, is_earth_step: bool) {
        let slices = if kalman.is_step_pending() || dt_s > LONGEST_SLICED_S {
            MOST_FIELD_SLICES
        } else if is_earth_step && dt_s < FIELD_LONG_SAMPLE_PERIOD_S {
            0
        } else {
            1 + ((dt_s * (1.0 / FIELD_SLICE_PERIOD_S)) as u32).min(MOST_FIELD_SLICES)
        };
        for _ in 0..slices {
            if self.next_slice == FieldSlice::Idle {
                return;
            }
            self.slice(kalman);
        }
    }

    /// Closes the open interval: its step follows that of the tilt filter.
    #[inline(never)]
    fn end_interval(&mut self) {
        self.has_interval = false;
        *self.intervals.closed_mut(self.open) = FieldInterval::EMPTY;
        self.open ^= 1;
        self.next_slice = FieldSlice::Waiting;
    }

    /// Forgets the field after a reset of the tilt, and the correlations with the tilt filter: it
    /// may have abandoned a step, or reset the parameters.
    #[cold]
    #[inline(never)]
    fn reset_with_tilt(&mut self) {
        self.covariance.forget_cross();
        self.reset_field();
        self.intervals = IntervalPair::EMPTY;
        self.has_interval = false;
        self.next_slice = FieldSlice::Idle;
    }
}
