//! One Kalman filter for tilt, velocity and everything that is wrong with the sensor.
//!
//! An accelerometer shows down only while nothing accelerates. This filter does not guess when that
//! is: it integrates the specific force to a velocity and takes it that velocities stay small. What
//! integrates to an absurd velocity is not an acceleration but gravity seen in a wrong attitude.
//!
//! # The mean
//!
//! Attitude q (body to earth), gyroscope bias b and matrix C = I − E (scale and misalignment),
//! accelerometer bias a, horizontal velocity v. With the readings g and f,
//!
//! ```text
//! ω = C·(g − b)      q ← q ⊗ exp(ω·dt)      v ← v + [R(q)·(f − a)·dt] north and east
//! ```
//!
//! Samples are values at an instant, so increments are trapezoids. They are summed up in body axes
//! (`mean`) and turned to earth axes every 7 ms, by the attitude half-way, which accounts for the
//! turn in between (the rotation correction of Savage, *Strapdown Analytics*, 2000, §7.1 and §7.2).
//! The attitude is published at every sample: it is q ⊗ exp(what turned since + ω·delay), where the
//! delay is that of the sensor, so that the attitude is the one at the sample's time.
//!
//! # The error
//!
//! An error-state filter (Solà, *Quaternion kinematics for the error-state Kalman filter*, 2017,
//! §7, with the error on the earth's side): nineteen states are the *error* of the mean, zero but
//! for a moment, since every correction goes into the mean at once. Tilt θ (north, east:
//! R_true = exp(θ)·R), v, b, E by rows, a. Yaw is not among them: nothing observes it. Over an
//! interval T with p = ω,
//!
//! ```text
//! θ ← θ − Σ_j (∫R_kj dt)·b_j − Σ_jl (∫R_kj·p_l dt)·E_jl        k = north, east
//! v_n ← v_n + (∫f_down dt)·θ_e − Σ_j (∫R_nj dt)·a_j
//! v_e ← v_e − (∫f_down dt)·θ_n − Σ_j (∫R_ej dt)·a_j
//! ```
//!
//! so that a covariance step (`covariance`, `matrix`) needs nothing but these integrals, and
//! may come late, at 4.5 Hz. The measurement is v = 0, with a variance that follows how much the
//! vehicle has been moving. In white noise s²/T it says what an average over time says, and the
//! filter becomes one that trusts gravity over seconds and the gyroscope below.
//!
//! # Start, doubt and recovery
//!
//! - The first sample sets the tilt, with a large σ. No average is waited for.
//! - The bias has a prior. As it becomes known, it is compared with what the prior said of it; where
//!   that was wrong by more than [`Tuning::surprise`] σ, the prior is taken back, as a measurement
//!   of negative variance, and a wider one put in its place (`doubt_the_prior`: a maximum
//!   of the likelihood over the prior's width, found step by step).
//! - While tilt and bias are both uncertain, what the linear model leaves out counts as noise
//!   ([`Tuning::coupling`]).
//! - At rest the gyroscope reads its bias and the velocity is zero (`rest`); both are believed
//!   only if they are likely under P, and neither when armed. The first rest decides: where it contradicts
//!   what the filter has made of the bias before, what came of that is wrong too, and the filter begins again from
//!   that rest (`begin_at_rest`).
//! - Only a rest, of this run or an earlier one, makes the bias count as known ([`Kalman::is_bias_known`]): a bias about
//!   the vertical that is far outside the prior can fool the filter in motion, and its σ too.
//! - Rest and steady motion are the same to the sensor. Where the readings are those of rest and the
//!   velocity is not, it is forgotten, so that whoever accelerated for long and now coasts finds down again.
//! - Known and not solved: a bias of 20 °/s about the vertical that starts in motion takes longer than
//!   half a minute to find, if it is found, since yaw is not observed. It counts as unknown until the first rest.
//! - A specific force of about one g that stays in the wrong direction for a second and a half,
//!   over 45° from up, cannot come from a vehicle that holds its height: sideways acceleration of
//!   one g would make it 1.4 g. So the attitude is wrong, and starts again from that direction.
//! - Readings that no sensor delivers may spoil the numbers; that is checked in each step, and the
//!   filter then begins again.
//!
//! # What was tuned on what
//!
//! See [`Tuning`]. The default tuning is one for all; the recordings' own sensor delay is the only
//! thing that differs.
//!
//! Deadline: one sample. At 1 kHz a sample costs about 325 instructions on a Cortex-M4F on average,
//! covariance included, and below 800 in the worst case; below 800 also at 200 Hz, and 1,100 at 100 Hz. There is no loop whose length depends on data.

mod covariance;
mod matrix;
mod mean;
mod rest;
mod tuning;

#[cfg(test)]
mod tests;

pub use tuning::Tuning;

use super::Sample;
use crate::attitude::{Quaternion, Vector3};
use crate::state::Exchange;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};
use covariance::{Measurement, Progress, State, Step};
use matrix::{Column, Covariance, TURNING, Transition};
use mean::Mean;
use rest::Rest;

/// The zero-rate offset ends here: 20 °/s, and 20 more over temperature (product specification §6.1).
const LARGEST_BIAS_RAD_S: f32 = radians(40.0);
/// The accelerometer's ends here: 80 mg, and 60 more over temperature (ibidem, §6.2).
const LARGEST_FORCE_BIAS_M_S2: f32 = 0.14 * STANDARD_GRAVITY_M_S2;
/// The gyroscope's scale is within 3 %, its axes within 2 % (ibidem, §6.1); and some more.
const LARGEST_MATRIX_ERROR: f32 = 0.1;

/// The bias counts as known when the σ of each axis is below this.
const KNOWN_BIAS_RAD_S: f32 = radians(0.5);

/// With a σ below this there is little to learn at rest, rad/s.
const WELL_KNOWN_BIAS_RAD_S: f32 = radians(0.1);

/// A full-scale reading hides how fast the body turns: tilt variance per second, rad²/s.
const SATURATED_TILT: f32 = 0.3;
/// The same for how hard it is pushed: velocity variance per second, (m/s)²/s.
const SATURATED_VELOCITY: f32 = 100.0;
/// Between samples farther apart than this the rate is not known to change linearly, s.
const LONG_STEP_S: f32 = super::EVERYDAY_STEP_US as f32 * 1.0e-6;

/// At rest no more than this of one g is horizontal beyond what σ of tilt explains: the accelerometer's bias.
const REST_ACCELERATION: f32 = 0.03;

/// The share of the covariance's σ of tilt that is told. The velocities of vehicles are no white
/// noise, as the filter takes them to be: on every set of recordings with truth its σ is too large. No
/// more is taken off, so that 3 σ hold 99 % of the errors of each
/// set together. A single recording may have less, such as 98.6 % of one room of TUM-VI.
const TOLD_SIGMA: f32 = 0.92;
const TOLD_VARIANCE: f32 = TOLD_SIGMA * TOLD_SIGMA;

/// Rest is believed if no bias is off by more σ than this.
const LIKELY: f32 = 4.0;
/// By more than this, what came before the first rest is not worth keeping.
const UNSURPRISING: f32 = 2.0;
/// σ of the tilt that the mean force at rest shows, both axes together, rad: the accelerometer's bias.
const RESTING_TILT_RAD: f32 = 1.4 * REST_ACCELERATION;
/// σ of the bias that the mean rate at rest shows, per axis, rad/s: what the average of half a second has not forgotten yet.
const RESTING_BIAS_RAD_S: f32 = radians(0.1);

/// At rest a velocity of more σ than this is one that lasts, and no error of the tilt.
const COASTING: f32 = 3.0;

/// Time constant in which the mean specific force has to agree with gravity, s.
const RECOVERY_TIME_S: f32 = 1.5;
/// σ of the tilt after a recovery, rad.
const RECOVERED_TILT_RAD: f32 = 0.3;

/// The filter's state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Kalman {
    tuning: &'static Tuning,
    delay_s: f32,
    is_armed: bool,
    has_tilt: bool,
    /// The covariance is the one that the first sample wants.
    is_prepared: bool,
    /// The tilt is known from an earlier run; the first sample does not set it.
    is_resumed: bool,
    /// A covariance step is due or under way.
    has_work: bool,
    is_bias_known: bool,
    first_rest: FirstRest,
    mean: Mean,
    step: Step,
    interval: Interval,
    rest: Rest,
    usual: UsualVelocity,
    /// Where each bias's prior lies, rad/s, and its variance, (rad/s)².
    prior_bias_rad_s: Vector3,
    bias_prior: [f32; 3],
    /// The mean specific force in earth axes over [`RECOVERY_TIME_S`], m/s².
    mean_force_m_s2: Vector3,
    /// Which bias was last measured at rest.
    next_axis: u8,
}

/// The first rest of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum FirstRest {
    /// It has not been.
    Awaited,
    /// It is, and contradicts what was known or found: the filter has to begin again.
    Contradicts,
    /// It has been, and so the bias has been measured.
    Taken,
}

/// What an earlier run knew.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Known {
    /// Body to earth.
    pub attitude: Quaternion,
    /// σ of its tilt per axis, rad.
    pub tilt_sigma_rad: f32,
    /// The gyroscope's bias in body axes, rad/s.
    pub bias_rad_s: Vector3,
    /// σ of the bias per axis, rad/s.
    pub bias_sigma_rad_s: f32,
}

/// Sums since the last covariance step began.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Interval {
    transition: Transition,
    velocity_m_s: [f32; 2],
    duration_s: f32,
    /// ∫|ω|² dt, rad²/s.
    squared_rate: f32,
    /// Tilt variance of what was not measured, rad².
    tilt_variance: f32,
    /// Velocity variance of the same, (m/s)².
    velocity_variance: f32,
}

impl Interval {
    const EMPTY: Self = Self {
        transition: Transition::NONE,
        velocity_m_s: [0.0; 2],
        duration_s: 0.0,
        squared_rate: 0.0,
        tilt_variance: 0.0,
        velocity_variance: 0.0,
    };
}

impl Interval {
    fn exchange(&mut self, state: &mut impl Exchange) {
        self.transition.exchange(state);
        state.numbers(&mut self.velocity_m_s);
        state.number(&mut self.duration_s);
        state.number(&mut self.squared_rate);
        state.number(&mut self.tilt_variance);
        state.number(&mut self.velocity_variance);
    }
}

/// How much the vehicle has been moving of late.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct UsualVelocity {
    smooth_m_s: [f32; 2],
    squared: f32,
    age_s: f32,
}

impl UsualVelocity {
    const NONE: Self = Self {
        smooth_m_s: [0.0; 2],
        squared: 0.0,
        age_s: 0.5,
    };

    fn exchange(&mut self, state: &mut impl Exchange) {
        state.numbers(&mut self.smooth_m_s);
        state.number(&mut self.squared);
        state.number(&mut self.age_s);
    }

    fn update(&mut self, velocity_m_s: [f32; 2], duration_s: f32, tuning: &Tuning) {
        let share = duration_s / (tuning.velocity_smoothing_s + duration_s);
        for (smooth, velocity) in self.smooth_m_s.iter_mut().zip(velocity_m_s) {
            *smooth += share * (velocity - *smooth);
        }
        // A plain average at first, which then forgets.
        self.age_s = (self.age_s + duration_s).min(tuning.velocity_time_s);
        let [north, east] = self.smooth_m_s;
        // Nothing is gained beyond the limit of what depends on it, and a knock would echo for long.
        let squared = (square(north) + square(east)).min(square(2.0 * tuning.velocity_limit));
        self.squared += duration_s / (self.age_s + duration_s) * (squared - self.squared);
    }
}

impl Default for Kalman {
    fn default() -> Self {
        Self::new()
    }
}

impl Kalman {
    /// A filter without an attitude.
    pub const fn new() -> Self {
        Self::with_tuning(&Tuning::DEFAULT)
    }

    /// A filter with a tuning of one's own.
    pub const fn with_tuning(tuning: &'static Tuning) -> Self {
        Self {
            tuning,
            delay_s: 0.0,
            is_armed: false,
            has_tilt: false,
            is_prepared: false,
            is_resumed: false,
            has_work: false,
            is_bias_known: false,
            first_rest: FirstRest::Awaited,
            mean: Mean::new(),
            step: Step::new(),
            interval: Interval::EMPTY,
            rest: Rest::new(),
            usual: UsualVelocity::NONE,
            prior_bias_rad_s: Vector3::ZERO,
            bias_prior: [square(tuning.start_bias_rad_s); 3],
            mean_force_m_s2: Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2),
            next_axis: 0,
        }
    }

    /// Says by how much the sensor lags the motion, s; the attitude is extrapolated by that.
    pub const fn set_delay(&mut self, delay_s: f32) {
        self.delay_s = delay_s;
    }

    /// Switches off (`true`) what is only safe on the ground: taking stillness for rest.
    pub const fn set_armed(&mut self, is_armed: bool) {
        self.is_armed = is_armed;
    }

    /// Starts from a known gyroscope bias (rad/s, body axes) with a σ per axis; call it before the first sample.
    pub fn set_bias(&mut self, bias_rad_s: Vector3, sigma_rad_s: f32) {
        self.mean.bias_rad_s = bias_rad_s;
        self.mean.derive_offset();
        self.prior_bias_rad_s = bias_rad_s;
        self.bias_prior = [square(sigma_rad_s); 3];
        self.first_rest = FirstRest::Awaited;
        self.is_prepared = false;
    }

    /// From the next sample on the readings have this more of a bias, rad/s, because less is removed before they come here.
    pub(super) fn shift_bias(&mut self, change_rad_s: Vector3) {
        self.mean.bias_rad_s = self.mean.bias_rad_s + change_rad_s;
        self.mean.derive_offset();
        self.prior_bias_rad_s = self.prior_bias_rad_s + change_rad_s;
        self.rest.shift(change_rad_s);
    }

    /// Forgets everything but its settings and the quaternion's sign.
    pub(super) fn restart(&mut self) {
        let attitude = Quaternion::IDENTITY.with_sign_of(self.mean.attitude);
        *self = Self {
            delay_s: self.delay_s,
            is_armed: self.is_armed,
            ..Self::with_tuning(self.tuning)
        };
        self.mean.attitude = attitude;
    }

    /// Does what can be done before the first sample, which is the slowest one anyway.
    pub(super) fn prepare(&mut self) {
        self.expect(square(self.tuning.start_tilt_rad));
        self.is_prepared = true;
    }

    /// Sets the covariance for a sample that sets the tilt: what is known of the sensor stays, or is at its prior.
    fn expect(&mut self, tilt_variance: f32) {
        if !self.has_tilt {
            set_start_covariance(&mut self.step.covariance, self.tuning, &self.bias_prior);
        }
        self.forget_motion(tilt_variance);
    }

    /// The first sample, or the first after a gap: takes roll and pitch from the specific force if it shows gravity, and keeps yaw and what is known of the sensor.
    pub(super) fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        if !core::mem::take(&mut self.is_prepared) {
            self.expect(square(self.tuning.start_tilt_rad));
        }
        if core::mem::take(&mut self.is_resumed) {
            self.has_tilt = true;
        } else if shows_gravity {
            let down = -sample.specific_force_m_s2;
            self.mean.attitude = self.mean.attitude.with_down(down);
            self.has_tilt = true;
        }
        self.rest
            .begin(sample.angular_rate_rad_s, sample.specific_force_m_s2);
        self.mean
            .begin(sample.angular_rate_rad_s, sample.specific_force_m_s2);
    }

    /// Walks through everything it remembers; the tuning is the owner's.
    pub(super) fn exchange(&mut self, state: &mut impl Exchange) {
        state.number(&mut self.delay_s);
        state.truth(&mut self.is_armed);
        state.truth(&mut self.has_tilt);
        state.truth(&mut self.is_prepared);
        state.truth(&mut self.is_resumed);
        state.truth(&mut self.has_work);
        state.truth(&mut self.is_bias_known);
        let mut first_rest = self.first_rest as usize;
        state.index(&mut first_rest, 3);
        self.first_rest = match first_rest {
            0 => FirstRest::Awaited,
            1 => FirstRest::Contradicts,
            _ => FirstRest::Taken,
        };
        self.mean.exchange(state);
        self.step.exchange(state);
        self.interval.exchange(state);
        self.rest.exchange(state);
        self.usual.exchange(state);
        state.vector(&mut self.prior_bias_rad_s);
        state.numbers(&mut self.bias_prior);
        state.vector(&mut self.mean_force_m_s2);
        let mut next_axis = usize::from(self.next_axis);
        state.index(&mut next_axis, 3);
        self.next_axis = next_axis as u8;
    }

    /// One step of `dt_s` seconds.
    #[inline]
    pub(super) fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        if !self.has_tilt && shows_gravity {
            self.start(sample, true);
            return;
        }
        let elapsed_s = self
            .mean
            .add(sample.angular_rate_rad_s, sample.specific_force_m_s2, dt_s);
        let is_earth_step = elapsed_s >= self.tuning.earth_period_s;
        if is_earth_step {
            self.step_in_earth_axes(sample);
        }
        // One slice a sample, where a step in earth axes leaves room; more where samples are rare.
        if self.has_work && (!is_earth_step || dt_s > BUSY_STEP_S) {
            self.work(1 + ((dt_s * (1.0 / SLICE_TIME_S)) as u32).min(MOST_SLICES));
        }
    }

    /// Body to earth, extrapolated from the time of the last sample's motion to that of its stamp.
    #[inline]
    pub(super) fn attitude(&self) -> Quaternion {
        self.mean.ahead(self.delay_s)
    }

    /// The body's rates p, q, r, rad/s: the last reading without bias, scale error and misalignment.
    #[inline]
    pub(super) fn body_rates_rad_s(&self) -> Vector3 {
        self.mean.rate_rad_s
    }

    /// The gyroscope's bias, rad/s in body axes.
    pub fn bias_rad_s(&self) -> Vector3 {
        self.mean.bias_rad_s
    }

    /// σ of [`bias_rad_s`](Self::bias_rad_s), rad/s.
    pub fn bias_sigma_rad_s(&self) -> Vector3 {
        let sigma = |axis| sigma(self.step.covariance.constant_variance(axis));
        Vector3::new(sigma(0), sigma(1), sigma(2))
    }

    /// The largest of these, rad/s.
    pub fn largest_bias_sigma_rad_s(&self) -> f32 {
        let covariance = &self.step.covariance;
        let [x, y, z] = [0, 1, 2].map(|axis| covariance.constant_variance(axis));
        sigma(x.max(y).max(z))
    }

    /// The accelerometer's bias, m/s² in body axes.
    pub fn force_bias_m_s2(&self) -> Vector3 {
        self.mean.force_bias_m_s2
    }

    /// σ of [`force_bias_m_s2`](Self::force_bias_m_s2), m/s².
    pub fn force_bias_sigma_m_s2(&self) -> Vector3 {
        let sigma = |axis| sigma(self.step.covariance.constant_variance(TURNING + axis));
        Vector3::new(sigma(0), sigma(1), sigma(2))
    }

    /// σ of the direction of down, rad: the root of the sum of both tilt variances.
    pub fn tilt_sigma_rad(&self) -> f32 {
        sigma(self.tilt_variance_rad2())
    }

    /// The square of [`tilt_sigma_rad`](Self::tilt_sigma_rad), rad². What the next covariance step will
    /// add for missing samples and full-scale readings counts at once.
    #[inline]
    pub fn tilt_variance_rad2(&self) -> f32 {
        TOLD_VARIANCE * self.doubled_tilt_variance()
    }

    /// The sum of both tilt variances of the covariance, rad².
    #[inline]
    fn doubled_tilt_variance(&self) -> f32 {
        self.step.covariance.moving_variance(0)
            + self.step.covariance.moving_variance(1)
            + 2.0 * self.interval.tilt_variance
    }

    /// Whether a specific force has shown where down is.
    pub const fn has_tilt(&self) -> bool {
        self.has_tilt
    }

    /// Adds so much variance per axis to the tilt, rad²: what the motion did that no sample shows.
    pub fn doubt_tilt(&mut self, variance: f32) {
        self.interval.tilt_variance += variance / TOLD_VARIANCE;
    }

    /// Doubts what the last samples have said: adds so much variance per axis to the tilt, rad², and
    /// forgets the velocity, which wrong samples spoil at once.
    pub fn doubt_motion(&mut self, variance: f32) {
        let tilt_variance = 0.5 * self.doubled_tilt_variance();
        self.forget_motion(tilt_variance + variance / TOLD_VARIANCE);
    }

    /// Goes on from what an earlier run knew, instead of taking the tilt from the first sample: call it
    /// before that. The bias is as in [`set_bias`](Self::set_bias), σ of the tilt is per axis, rad.
    pub fn resume(&mut self, known: &Known) {
        self.set_bias(known.bias_rad_s, known.bias_sigma_rad_s);
        self.mean.attitude = known.attitude;
        // What is told is about both axes together.
        self.expect(0.5 * square(known.tilt_sigma_rad) / TOLD_VARIANCE);
        self.is_prepared = true;
        self.is_resumed = true;
        self.is_bias_known = known.bias_sigma_rad_s < KNOWN_BIAS_RAD_S;
    }

    /// The acceleration of the body without gravity, m/s² in body axes.
    pub fn linear_acceleration_m_s2(&self) -> Vector3 {
        let gravity = self
            .mean
            .ahead(0.0)
            .down_in_body()
            .scale(STANDARD_GRAVITY_M_S2);
        self.mean.force_m_s2 - self.mean.force_bias_m_s2 + gravity
    }

    /// Whether the readings have not changed for a third of a second.
    pub fn is_still(&self) -> bool {
        self.rest.is_still()
    }

    /// Whether the gyroscope's bias is known: it has been measured at rest, in this run or the one that a stored value
    /// came from, and its σ is below 0.5 °/s on every axis.
    pub fn is_bias_known(&self) -> bool {
        self.is_bias_known
    }

    /// What saturation and long steps hide.
    pub(super) fn allow_for(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        if !self.has_tilt && shows_gravity {
            // The sample starts the filter.
            return;
        }
        if dt_s > LONG_STEP_S {
            let change = self.mean.corrected(sample.angular_rate_rad_s) - self.mean.rate_rad_s;
            self.interval.tilt_variance += change.dot(change) * square(0.25 * dt_s);
        }
        if sample.is_rate_saturated {
            self.interval.tilt_variance += SATURATED_TILT * dt_s;
        }
        if sample.is_force_saturated {
            self.interval.velocity_variance += SATURATED_VELOCITY * dt_s;
        }
    }

    /// Turns the increments since the last such step to earth axes, and keeps the sums that a
    /// covariance step needs.
    #[inline(never)]
    fn step_in_earth_axes(&mut self, sample: &Sample) {
        let step = self.mean.step(&mut self.interval.transition);
        let interval = &mut self.interval;
        let [north, east] = &mut interval.velocity_m_s;
        *north += step.velocity_m_s.x;
        *east += step.velocity_m_s.y;
        interval.duration_s += step.duration_s;
        interval.squared_rate += step.turned_rad.dot(step.turned_rad) / step.duration_s;
        self.rest.update(
            sample.angular_rate_rad_s,
            sample.specific_force_m_s2,
            step.duration_s,
            self.tuning,
        );
        let is_due = self.interval.duration_s >= self.tuning.covariance_period_s;
        self.has_work |= is_due && self.has_tilt;
    }

    /// Does the next pieces of covariance work.
    #[inline(never)]
    fn work(&mut self, slices: u32) {
        for _ in 0..slices {
            match self.step.slice() {
                Progress::Idle => self.begin(),
                Progress::Working => {}
                Progress::Predicted => self.measure(),
                Progress::Corrected => self.correct(),
                Progress::Unsound => self.begin_again(),
            }
            if !self.has_work {
                return;
            }
        }
    }

    /// Closes the interval and begins its covariance step.
    fn begin(&mut self) {
        // Where nobody takes stock.
        self.take_stock();
        let tuning = self.tuning;
        let duration_s = self.interval.duration_s;
        for (velocity, change) in self
            .mean
            .velocity_m_s
            .iter_mut()
            .zip(self.interval.velocity_m_s)
        {
            *velocity += change;
        }
        if self.recover() {
            return;
        }
        // Q: what the interval adds that no state explains.
        let covariance = &mut self.step.covariance;
        let mut bias = 0.0;
        for axis in 0..3 {
            bias += covariance.constant_variance(axis);
            covariance.add_to_constant(axis, square(tuning.bias_walk) * duration_s);
            covariance.add_to_constant(TURNING + axis, square(tuning.force_bias_walk) * duration_s);
        }
        let tilt = covariance.moving_variance(0) + covariance.moving_variance(1);
        let density = square(tuning.rate_noise) + square(tuning.coupling) * bias * tilt;
        let tilt_noise = density * duration_s
            + square(tuning.rate_noise_per_rate) * self.interval.squared_rate
            + self.interval.tilt_variance;
        // What does not shake now needs no allowance for that.
        let shaking = if self.rest.is_still() {
            0.0
        } else {
            square(tuning.force_noise_per_velocity) * self.usual.squared
        };
        let density = square(tuning.force_noise) + shaking;
        let velocity_noise = density * duration_s + self.interval.velocity_variance;
        self.step.begin(
            &self.interval.transition,
            [tilt_noise, velocity_noise],
            duration_s,
        );
        self.interval = Interval::EMPTY;
    }

    /// Says what is measured at the end of the interval, when the covariance is predicted there.
    fn measure(&mut self) {
        let tuning = self.tuning;
        let duration_s = self.step.duration_s();
        let [north, east] = self.mean.velocity_m_s;
        self.usual.update([north, east], duration_s, tuning);
        let mut variance = (square(tuning.velocity)
            + square(tuning.velocity_per_velocity) * self.usual.squared)
            .min(square(tuning.velocity_limit));
        match self.rest.readings(tuning) {
            Some((rate_rad_s, force_m_s2)) if !self.is_armed => {
                let difference = rate_rad_s - self.mean.bias_rad_s;
                let is_first = self.first_rest != FirstRest::Taken;
                if is_first && !self.is_likely(difference, UNSURPRISING) {
                    self.first_rest = FirstRest::Contradicts;
                } else {
                    self.first_rest = FirstRest::Taken;
                    if self.is_likely(difference, LIKELY) {
                        self.measure_bias(difference, square(tuning.rest_rate) / duration_s);
                    }
                }
                let force = self.mean.attitude.rotate(force_m_s2);
                let tilt = self.step.covariance.moving_variance(0)
                    + self.step.covariance.moving_variance(1);
                let sine_squared =
                    (square(force.x) + square(force.y)) * square(1.0 / STANDARD_GRAVITY_M_S2);
                if sine_squared < 16.0 * tilt + square(REST_ACCELERATION) {
                    variance = variance.min(square(tuning.rest_velocity));
                    self.forget_coasting(variance / duration_s);
                }
            }
            _ => self.doubt_the_prior(),
        }
        let [north, east] = self.mean.velocity_m_s;
        for (state, velocity) in [(2, north), (3, east)] {
            self.step.measure(Measurement {
                state: State::Moving(state),
                innovation: -velocity,
                variance: variance / duration_s,
            });
        }
    }

    /// Whoever feels no acceleration may still move, steadily: rest and steady motion are the same
    /// to the sensor. A velocity that tilt cannot explain is forgotten then, and counts from here.
    fn forget_coasting(&mut self, variance: f32) {
        let [north, east] = self.mean.velocity_m_s;
        let covariance = &mut self.step.covariance;
        let explained =
            covariance.moving_variance(2) + covariance.moving_variance(3) + 2.0 * variance;
        if square(north) + square(east) > square(COASTING) * explained {
            covariance.reset_moving(2, variance);
            covariance.reset_moving(3, variance);
            self.mean.velocity_m_s = [0.0; 2];
        }
    }

    /// At rest the gyroscope reads its bias.
    fn measure_bias(&mut self, difference: Vector3, variance: f32) {
        let innovations = [difference.x, difference.y, difference.z];
        // What is well known is watched one axis at a time, which costs less.
        self.next_axis = if self.next_axis < 2 {
            self.next_axis + 1
        } else {
            0
        };
        for (axis, innovation) in innovations.into_iter().enumerate() {
            let own = self.step.covariance.constant_variance(axis);
            if own > square(WELL_KNOWN_BIAS_RAD_S) || axis == usize::from(self.next_axis) {
                let state = State::Constant(axis);
                self.step.measure(Measurement {
                    state,
                    innovation,
                    variance,
                });
            }
        }
    }

    /// Whether biases may be off by this, rad/s, which is so many σ.
    fn is_likely(&self, difference: Vector3, sigmas: f32) -> bool {
        let rest = square(self.tuning.rest_rate);
        let differences = [difference.x, difference.y, difference.z];
        (0..3).zip(differences).all(|(axis, difference)| {
            let own = self.step.covariance.constant_variance(axis);
            square(difference) < square(sigmas) * (own + rest)
        })
    }

    /// Does what has time: call it once the attitude is out, every dozen samples or so.
    pub(crate) fn take_stock(&mut self) {
        if self.first_rest == FirstRest::Contradicts {
            self.begin_at_rest();
        }
    }

    /// Begins anew with the next sample, from bias and tilt as the mean readings at rest show them; keeps yaw.
    #[cold]
    #[inline(never)]
    fn begin_at_rest(&mut self) {
        self.first_rest = FirstRest::Awaited;
        let Some((rate_rad_s, force_m_s2)) = self.rest.readings(self.tuning) else {
            return;
        };
        self.mean.forget_sensor();
        self.has_tilt = false;
        self.resume(&Known {
            attitude: self.mean.attitude.with_down(-force_m_s2),
            tilt_sigma_rad: RESTING_TILT_RAD,
            bias_rad_s: rate_rad_s,
            bias_sigma_rad_s: RESTING_BIAS_RAD_S,
        });
        self.first_rest = FirstRest::Taken;
    }

    /// Widens the prior of a bias that lies where the prior said it would not.
    ///
    /// The prior is a measurement "zero, variance p"; to replace p by 2p is to take back a
    /// measurement of variance 2p, which is to make one of variance −2p.
    fn doubt_the_prior(&mut self) {
        let bias = self.mean.bias_rad_s - self.prior_bias_rad_s;
        for (axis, bias) in [bias.x, bias.y, bias.z].into_iter().enumerate() {
            let own = self.step.covariance.constant_variance(axis);
            let Some(prior) = self.bias_prior.get_mut(axis) else {
                return;
            };
            let learned = (*prior - own).max(0.02 * *prior);
            if square(bias) > square(self.tuning.surprise) * learned
                && *prior < square(LARGEST_BIAS_RAD_S)
                && own < *prior * 1.5
            {
                self.step.measure(Measurement {
                    state: State::Constant(axis),
                    innovation: -bias,
                    variance: -2.0 * *prior,
                });
                *prior *= 2.0;
            }
        }
    }

    /// Finds a tilt that is so wrong that the linear model does not lead back.
    fn recover(&mut self) -> bool {
        let interval = &self.interval;
        let inverse = 1.0 / interval.duration_s;
        let [north, east] = interval.velocity_m_s;
        let force = Vector3::new(north, east, interval.transition.vertical_m_s).scale(inverse);
        const LEAST: f32 = 0.7 * STANDARD_GRAVITY_M_S2;
        const GREATEST: f32 = 1.4 * STANDARD_GRAVITY_M_S2;
        let is_gravity = |squared: f32| (LEAST * LEAST..GREATEST * GREATEST).contains(&squared);
        // A knock or a reading at full scale is short, but so large that it would decide the mean.
        if !is_gravity(force.dot(force)) {
            return false;
        }
        let share = (interval.duration_s / RECOVERY_TIME_S).min(1.0);
        self.mean_force_m_s2 = self.mean_force_m_s2 + (force - self.mean_force_m_s2).scale(share);
        let mean = self.mean_force_m_s2;
        let squared = mean.dot(mean);
        let is_down = mean.z < 0.0 && 2.0 * square(mean.z) > squared;
        if !is_gravity(squared) || is_down {
            return false;
        }
        self.mean.attitude = shortest_to_up(mean)
            .multiply(self.mean.attitude)
            .normalize();
        self.forget_motion(square(RECOVERED_TILT_RAD));
        true
    }

    /// Forgets velocity and what is known of tilt, and whatever covariance step was under way.
    #[inline(never)]
    fn forget_motion(&mut self, tilt_variance: f32) {
        let velocity_variance = square(self.tuning.start_velocity_m_s);
        let covariance = &mut self.step.covariance;
        for (state, variance) in [
            tilt_variance,
            tilt_variance,
            velocity_variance,
            velocity_variance,
        ]
        .into_iter()
        .enumerate()
        {
            covariance.reset_moving(state, variance);
        }
        self.step.abandon();
        self.has_work = false;
        self.interval = Interval::EMPTY;
        self.mean.velocity_m_s = [0.0; 2];
        self.mean_force_m_s2 = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
    }

    /// Only readings that no sensor delivers lead here: keeps yaw and settings, and begins again.
    #[cold]
    #[inline(never)]
    fn begin_again(&mut self) {
        let attitude = self.mean.attitude;
        self.restart();
        self.mean.attitude = attitude;
    }

    /// Applies the corrections of the covariance step, carried from its time to now.
    fn correct(&mut self) {
        self.has_work = false;
        let Column {
            mut moving,
            constants,
        } = self.step.correction;
        self.interval.transition.carry(&mut moving, &constants);
        self.mean.correct(&moving, &constants);
        if !self.mean.is_plausible() {
            self.begin_again();
            return;
        }
        // What is told of a bias beforehand is told of all axes.
        let is_told =
            self.first_rest == FirstRest::Taken || self.bias_prior[0] < square(KNOWN_BIAS_RAD_S);
        self.is_bias_known = is_told
            && (0..3).all(|axis| {
                self.step.covariance.constant_variance(axis) < square(KNOWN_BIAS_RAD_S)
            });
    }
}

/// A slice of covariance work is due in this time, s: then a step is done before the next begins.
const SLICE_TIME_S: f32 = 10.5e-3;
/// Samples farther apart than this leave none without a step in earth axes, s.
const BUSY_STEP_S: f32 = 5.5e-3;
/// More than a whole covariance step has.
const MOST_SLICES: u32 = 80;

#[inline]
const fn square(number: f32) -> f32 {
    number * number
}

fn sigma(variance: f32) -> f32 {
    libm::sqrtf(variance.max(0.0))
}

/// Before the first sample: everything at its prior.
fn set_start_covariance(covariance: &mut Covariance, tuning: &Tuning, bias_prior: &[f32; 3]) {
    covariance.clear();
    for (axis, prior) in bias_prior.iter().enumerate() {
        covariance.add_to_constant(axis, *prior);
        covariance.add_to_constant(TURNING + axis, square(tuning.force_bias_m_s2));
        for column in 0..3 {
            let sigma = if column == axis {
                tuning.scale
            } else {
                tuning.misalignment_rad
            };
            covariance.add_to_constant(3 + 3 * axis + column, square(sigma));
        }
    }
}

/// The shortest turn that brings this direction, which is not zero, up: to (0, 0, −1).
fn shortest_to_up(direction: Vector3) -> Quaternion {
    let norm = direction.norm();
    // w = 1 + cos and the axis is direction × up; both vanish where it points straight down.
    let w = norm - direction.z;
    if w < 1.0e-3 * norm {
        return Quaternion::new(0.0, 1.0, 0.0, 0.0);
    }
    Quaternion::new(w, -direction.y, direction.x, 0.0).normalize()
}
