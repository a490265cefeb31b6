//! One Kalman filter for tilt, velocity and the sensor's parameters.
//!
//! An accelerometer shows down only while nothing accelerates. In motion the filter does not try to
//! detect such moments. It integrates the specific force to a velocity, and uses the
//! pseudo-measurement that velocities stay small. A force that integrates to an implausible
//! velocity is no acceleration, but gravity seen in a wrong attitude.
//!
//! # Nominal state (`nominal.rs`)
//!
//! Attitude q (body to earth), gyroscope bias b and matrix C = I − E (scale and misalignment),
//! accelerometer bias a, horizontal velocity v. With the readings g and f,
//!
//! ```text
//! ω = C·(g − b)
//! q ← q ⊗ exp(ω·dt)
//! v ← v + [R(q)·(f − a)·dt] north and east
//! ```
//!
//! Samples are values at an instant, so increments are trapezoids. They are summed in body axes,
//! with the terms for coning and sculling: the axes turn between two increments (Savage,
//! *Strapdown Analytics*, 2000, §7.1 and §7.2). Every 20 ms the sums are turned to earth axes by
//! the attitude half-way. The attitude at a sample is q ⊗ exp(rotation since the last earth step
//! + ω·delay). The delay is that of the sensor, so the attitude belongs to the sample's time.
//!
//! # Error state
//!
//! An error-state filter (Solà, *Quaternion kinematics for the error-state Kalman filter*, 2017,
//! §7, with the error on the earth's side). Nineteen states are the *error* of the nominal state:
//! tilt θ (north, east: R_true = exp(θ)·R), v, b, E by rows, a. Every correction moves into the
//! nominal state at once. Yaw is no state, because nothing observes it. Over an interval T with p =
//! ω,
//!
//! ```text
//! θ ← θ − Σ_j (∫R_kj dt)·b_j − Σ_jl (∫R_kj·p_l dt)·E_jl        k = north, east
//! v_n ← v_n + (∫f_down dt)·θ_e − Σ_j (∫R_nj dt)·a_j
//! v_e ← v_e − (∫f_down dt)·θ_n − Σ_j (∫R_ej dt)·a_j
//! ```
//!
//! A covariance step needs only these integrals, and may come late, at 4.5 Hz. The step runs in
//! slices, one a sample. In motion the measurement is v = 0, with a variance that follows how much
//! the vehicle has been moving: the small-velocity measurement.
//!
//! # Start (`init.rs`, `recovery.rs`)
//!
//! - The first sample sets a provisional tilt with a σ above 30°, so the attitude is not `VALID`.
//!   The mean specific force of 0.15 s then replaces this tilt, because one sample in vibration
//!   may point anywhere. A mean that is not 0.7 to 1.4 g grows to 0.75 s; then the filter starts
//!   again. A pause that hides the tilt repeats both steps.
//! - In motion, a mean specific force of about one g, over 45° from up, contradicts the tilt. It
//!   sets an ambiguous tilt after 1.3 s. A certain tilt loses `VALID` after 1.3 s, and is set after
//!   4 s, which is longer than a push-over.
//! - The bias has a prior. If the bias lies more than [`Tuning::prior_gate_sigma`] outside it, the
//!   prior is widened, unless a rest of this run or an earlier one has measured the bias.
//! - While tilt and bias are both uncertain, their product, which the linear model leaves out,
//!   counts as noise ([`Tuning::coupling`]).
//!
//! # Rest (`measurements.rs`)
//!
//! - At rest the gyroscope reads its bias, and the velocity is zero. Both updates have a gate, and
//!   neither runs while armed.
//! - The filter restarts at the first rest if that contradicts the state, or if the tilt is too
//!   uncertain. It restarts at any rest whose force contradicts the tilt for longer than a vehicle
//!   accelerates: at once if the tilt is over 35° wrong, after 6.8 s if it is nearly level.
//! - A slow, steady turn reads like a rest, but gravity turns in the body. A rest ends when the
//!   force drifts by 0.6°. If it has drifted from the rest's beginning on, and the gyroscope shows
//!   no turn, then the bias was measured in the turn, and is unknown again. A swing's rate drifts;
//!   a bias that less than 1 s of rest has measured is then unknown again.
//! - Rest and steady motion read alike. A velocity that lasts while the readings are those of rest
//!   is reset. Therefore a vehicle that coasts after a long acceleration finds down again.
//!
//! # Known, unconfirmed and changed bias
//!
//! - A rest, of this run or an earlier one, must have measured the bias before it counts as known
//!   ([`Filter::is_bias_known`]). After a contradiction motion may make it known again, if it is
//!   within 1 °/s of that measurement.
//! - In motion, a large bias about the vertical can mislead the filter, and its σ too. Therefore
//!   the reported σ is much larger while the bias is not known (`tilt_variance.rs`).
//! - A stored bias, or one kept over a reset or a pause, may have changed. In motion, or while
//!   armed, σ is then at least 4° (stored) or 6.4° (kept), and larger the more the force differs
//!   from one g. A rest or motion confirms the bias (`confirmation.rs`).
//! - An offset that changes at rest is found again: readings that no motion explains restart the
//!   filter. Until then σ includes the turn that the specific force does not show
//!   (`rest_watch.rs`).
//! - An offset that changes in motion shows within seconds, because corrections add up that should
//!   not (`consistency.rs`). The reported σ grows at the first suspicion; later bias and tilt
//!   are uncertain again. It takes seconds because a tilt error looks like an acceleration.
//! - A turn of minutes contradicts the bias too, and a wrong bias may then explain it. A wide turn
//!   moves it without a contradiction. So it has to be confirmed: by a rest, or by motion that
//!   leads it back to within 0.2 °/s of the last rest's.
//!
//! # Limits
//!
//! - An offset that changes by over 1 °/s in flight is not known again before the next rest. From
//!   0.2 °/s on σ stays at 4° or more: 6.4° if the change was sudden.
//! - Unsolved: from power-up on, a slow, steady turn about the vertical is measured as the bias.
//! - After a start in motion, a bias of 20 °/s about the vertical takes over half a minute, or is
//!   not found, because yaw is not observed. A lasting turn is taken for a bias. The reported σ
//!   covers both.
//!
//! # Cost
//!
//! Deadline: one sample. At 1 kHz a sample costs about 320 instructions on a Cortex-M4F on average,
//! covariance included, and about 730 at worst. At 100 Hz the worst case is 1,100. A reset of the
//! motion adds at most eight pairs of rows of the covariance.

mod confirmation;
mod consistency;
mod covariance;
pub(super) mod heading_access;
mod init;
mod measurements;
mod nominal;
mod prior;
mod process_noise;
mod propagation;
mod recent_velocity;
mod recovery;
mod rest_detector;
mod rest_watch;
mod slices;
mod state;
mod tilt_variance;
mod tuning;
mod unseen;
mod warm_start;

#[cfg(test)]
mod tests;

pub use prior::{AccelerometerKnowledge, GyroscopeKnowledge};
pub use tuning::Tuning;
pub use unseen::PAUSE_RATE_RAD_S;
pub(crate) use unseen::{HIDDEN_SHARE, LARGEST_HIDDEN_TURN_RAD, LONG_STEP_S};
#[cfg(feature = "firmware")]
pub(crate) use warm_start::VALUES;
pub use warm_start::WarmStart;

use super::filter::Filter;
use super::sample::Sample;
use crate::attitude::{Quaternion, Vector3};
use crate::estimator::LONGEST_DELAY_US;
use crate::estimator::arithmetic::{larger, square};
use crate::units::{SECONDS_PER_MICROSECOND, STANDARD_GRAVITY_M_S2, radians};
use confirmation::Confirmation;
use consistency::Consistency;
use covariance::Column;
use init::Tilt;
use nominal::NominalState;
use prior::{BiasPrior, ParameterPriors};
use propagation::{GYROSCOPE_PARAMETERS, Interval};
use recent_velocity::RecentVelocity;
use recovery::ForceSum;
use rest_detector::{LONGEST_REST_PAUSE_S, RestDetector};
use rest_watch::RestWatch;
use slices::{CovarianceStep, Progress};

/// Largest σ of a known bias, per axis.
const KNOWN_BIAS_RAD_S: f32 = radians(0.5);

/// σ of the tilt, both axes together, rad, from which on the specific force shows the tilt better:
/// at the start, and at rest.
const USABLE_TILT_RAD: f32 = radians(30.0);

/// Least length of the mean specific force that sets the tilt at a start, s: more than seven
/// periods of a vibration of 50 Hz.
const FIRST_MEAN_S: f32 = 0.15;

/// Least ratio of the prior's variance to that of a certain accelerometer bias. Motion then weighs
/// 1.5 times as much as the prior.
const CERTAIN_VARIANCE_RATIO: f32 = 2.5;

/// Time per slice of a covariance step, s: a longer sample period runs several slices with each
/// sample. At about 100 Hz a step takes longer than [`Tuning::covariance_period_s`], and the next
/// interval is longer by that.
const SLICE_PERIOD_S: f32 = 10.5e-3;
/// Sample period above which slices also run beside an earth step, s.
const LONG_SAMPLE_PERIOD_S: f32 = 5.5e-3;
/// Upper limit of the slices per sample: more than a covariance step has.
const MOST_SLICES: u32 = 80;

/// Kalman filter for tilt, velocity and the parameters of the sensor.
///
/// The fields keep this order in memory, because a core reaches the first kilobyte with shorter
/// code.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Kalman {
    tuning: &'static Tuning,
    delay_s: f32,
    /// Longest step that hides no motion: a longer one is a pause.
    pause_after_s: f32,
    /// Longest step that is neither a pause nor longer than `LONG_STEP_S`.
    long_after_s: f32,
    /// Duration of the present full-scale readings of any axis of either sensor.
    saturated_s: f32,
    /// Duration of the present full-scale readings of the gyroscope.
    rate_saturated_s: f32,
    is_armed: bool,
    tilt: Tilt,
    /// True if a covariance step is due or under way.
    is_step_pending: bool,
    /// True if the tilt has been checked for the covariance step that is due.
    is_tilt_checked: bool,
    /// True if the bias is known: a rest, of this run or an earlier one, has measured it, and its
    /// σ is small. A contradicted one is also within 1 °/s of that measurement.
    is_bias_known: bool,
    /// True if a rest of this run has measured the bias.
    has_rested: bool,
    /// True if the covariance step under way is at rest, before any rest has been accepted.
    is_first_rest: bool,
    /// Well-known axis whose bias was measured last at rest.
    last_measured_axis: u8,
    /// Parameter that has last returned towards its prior.
    last_relaxed: u8,
    /// True if the bias started with a small σ: a rest of an earlier run, or before a restart, had
    /// measured it.
    has_measured_prior: bool,
    /// Confirmation of the bias by a rest or by motion.
    confirmation: Confirmation,
    /// True if a single sample has set the tilt: the mean specific force will set it again.
    is_from_one_sample: bool,
    /// Tilt variance of the nominal state during a covariance step, both axes together, rad².
    nominal_tilt_rad2: f32,
    /// Length of the present rest, s, up to which its readings were steady.
    steady_until_s: f32,
    /// Time at rest that has measured the bias, s.
    rested_s: f32,
    nominal: NominalState,
    interval: Interval,
    rest_detector: RestDetector,
    recent: RecentVelocity,
    consistency: Consistency,
    bias_prior: BiasPrior,
    force_sum: ForceSum,
    parameter_priors: ParameterPriors,
    rest_watch: RestWatch,
    /// Tilt variance that is reported beside the covariance's, both axes together, rad²: see
    /// `tilt_variance.rs`.
    extra_tilt_rad2: f32,
    step: CovarianceStep,
    /// Variance that the bias gains in a second beyond the tuning's random walk, rad²/s³.
    added_bias_walk: f32,
}

impl Default for Kalman {
    fn default() -> Self {
        Self::new()
    }
}

impl Filter for Kalman {
    #[inline(never)]
    fn restart(&mut self) {
        let attitude = Quaternion::IDENTITY.with_sign_of(self.nominal.attitude);
        *self = Self {
            delay_s: self.delay_s,
            pause_after_s: self.pause_after_s,
            long_after_s: self.long_after_s,
            is_armed: self.is_armed,
            ..Self::fresh(self.tuning, self.parameter_priors)
        };
        self.nominal.attitude = attitude;
    }

    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        let shows_gravity = shows_gravity && !sample.is_force_saturated;
        self.start_from(sample, shows_gravity, f32::INFINITY);
    }

    #[inline]
    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        if self.tilt != Tilt::Known && shows_gravity && !sample.is_force_saturated {
            self.start_from(sample, true, dt_s);
            return;
        }
        let (rate, force) = (sample.angular_rate_rad_s, sample.specific_force_m_s2);
        let is_saturated = sample.is_rate_saturated || sample.is_force_saturated;
        if dt_s > self.long_after_s || is_saturated || self.saturated_s > 0.0 {
            self.inflate_for_unseen_motion(sample, dt_s);
        }
        let elapsed_s = self.nominal.integrate(rate, force, dt_s);
        let is_earth_step = elapsed_s >= self.tuning.earth_period_s;
        if is_earth_step {
            self.step_in_earth_axes(rate, force);
        }
        // One slice a sample, but none beside an earth step; more where samples are rare.
        if self.is_step_pending && (!is_earth_step || dt_s > LONG_SAMPLE_PERIOD_S) {
            let slices = 1 + ((dt_s * (1.0 / SLICE_PERIOD_S)) as u32).min(MOST_SLICES);
            self.run_slices(slices);
        }
    }

    /// Returns the attitude, extrapolated by the sensor's delay.
    // Out of line it costs a host a tenth of its time.
    #[inline(always)]
    fn attitude(&self) -> Quaternion {
        self.nominal.extrapolate(self.delay_s)
    }

    /// Returns the rates without bias, scale error and misalignment.
    #[inline]
    fn body_rates_rad_s(&self) -> Vector3 {
        self.nominal.rate_rad_s
    }

    /// Returns the tilt variance, including unobserved motion since the last covariance step.
    /// Much larger while the bias is not known. Infinite without a tilt.
    #[inline]
    fn tilt_variance_rad2(&self) -> f32 {
        self.reported_tilt_variance()
    }

    /// Returns whether the bias is known. It must have been measured at rest, in this run or that
    /// of a stored value, with σ below 0.5 °/s on every axis. If motion has contradicted it, it
    /// must be within 1 °/s of that measurement.
    #[inline]
    fn is_bias_known(&self) -> bool {
        self.is_bias_known
    }
}

impl Kalman {
    /// Creates a filter without an attitude.
    pub fn new() -> Self {
        Self::with_tuning(&Tuning::DEFAULT)
    }

    /// Creates a filter with this tuning.
    pub fn with_tuning(tuning: &'static Tuning) -> Self {
        let accelerometer = AccelerometerKnowledge::default();
        let gyroscope = GyroscopeKnowledge::default();
        Self::fresh(tuning, ParameterPriors::new(accelerometer, gyroscope))
    }

    fn fresh(tuning: &'static Tuning, parameter_priors: ParameterPriors) -> Self {
        let mut filter = Self {
            tuning,
            delay_s: 0.0,
            pause_after_s: f32::INFINITY,
            long_after_s: LONG_STEP_S,
            saturated_s: 0.0,
            rate_saturated_s: 0.0,
            is_armed: false,
            tilt: Tilt::Unknown,
            is_step_pending: false,
            is_tilt_checked: false,
            is_bias_known: false,
            has_measured_prior: false,
            confirmation: Confirmation::Confirmed,
            has_rested: false,
            is_first_rest: false,
            is_from_one_sample: false,
            nominal: NominalState::new(),
            step: CovarianceStep::new(),
            interval: Interval::EMPTY,
            rest_detector: RestDetector::new(),
            recent: RecentVelocity::NONE,
            consistency: Consistency::NONE,
            rest_watch: RestWatch::new(),
            extra_tilt_rad2: 0.0,
            added_bias_walk: 0.0,
            parameter_priors,
            bias_prior: BiasPrior::new(Vector3::ZERO, tuning.gyroscope_bias_rad_s),
            force_sum: ForceSum::NONE,
            last_measured_axis: 0,
            last_relaxed: 0,
            nominal_tilt_rad2: 0.0,
            steady_until_s: 0.0,
            rested_s: 0.0,
        };
        filter.reset_parameters();
        filter.return_bias_to_prior();
        filter.reset_tilt_and_velocity(square(tuning.start_tilt_rad));
        filter
    }

    /// Sets the delay of the sensor, µs: age of a sample's content at the sample's time. The
    /// attitude is extrapolated by it. A delay above [`LONGEST_DELAY_US`] changes nothing. Default:
    /// 0.
    pub const fn set_delay_us(&mut self, delay_us: u32) {
        if delay_us <= LONGEST_DELAY_US {
            self.delay_s = delay_us as f32 * SECONDS_PER_MICROSECOND;
        }
    }

    /// Sets the variance that the gyroscope's bias gains in a second beyond the tuning's random
    /// walk, rad²/s³, from 0. Default: 0. A changing temperature shows that the bias may change.
    pub const fn set_added_bias_walk(&mut self, added_rad2_s3: f32) {
        self.added_bias_walk = added_rad2_s3;
    }

    /// Sets what is known of the accelerometer's offset, and forgets what motion has shown of every
    /// parameter but the gyroscope's bias. Default: calibrated.
    pub fn set_accelerometer_knowledge(&mut self, knowledge: AccelerometerKnowledge) {
        self.parameter_priors.accelerometer_m_s2 = knowledge.sigma_m_s2();
        self.forget_parameters();
    }

    /// Sets what is known of the gyroscope's scale and cross-axis terms, and forgets what motion
    /// has shown of every parameter but its bias. Default: calibrated.
    pub fn set_gyroscope_knowledge(&mut self, knowledge: GyroscopeKnowledge) {
        self.parameter_priors.gyroscope_scale = knowledge.scale_sigma();
        self.parameter_priors.gyroscope_misalignment_rad = knowledge.misalignment_sigma_rad();
        self.forget_parameters();
    }

    fn forget_parameters(&mut self) {
        self.reset_tilt_and_velocity(0.5 * self.total_tilt_variance());
        self.reset_parameters();
    }

    /// Disables (`true`) the zero-rate and zero-velocity updates, which are only safe on the
    /// ground. Default: false.
    pub const fn set_armed(&mut self, is_armed: bool) {
        if self.is_armed != is_armed {
            // A steady turn while armed says nothing about the offset.
            self.rest_detector.agree();
        }
        self.is_armed = is_armed;
    }

    /// Turns the increments to earth axes, and adds them to the interval's sums.
    #[inline(never)]
    fn step_in_earth_axes(&mut self, rate_rad_s: Vector3, force_m_s2: Vector3) {
        let interval = &mut self.interval;
        let step = self.nominal.step_in_earth_axes(&mut interval.transition);
        let [north, east] = &mut interval.velocity_change_m_s;
        *north += step.force_integral_ned_m_s.x;
        *east += step.force_integral_ned_m_s.y;
        interval.duration_s += step.duration_s;
        interval.squared_rate += step.rotation_rad.dot(step.rotation_rad) / step.duration_s;
        let is_pause =
            step.duration_s > self.pause_after_s && step.duration_s > LONGEST_REST_PAUSE_S;
        self.rest_detector.update(
            rate_rad_s,
            force_m_s2,
            step.force_integral_body_m_s,
            step.duration_s,
            is_pause,
            self.tuning,
        );
        let period_s = if self.is_from_one_sample {
            FIRST_MEAN_S
        } else {
            self.tuning.covariance_period_s
        };
        let is_due = self.interval.duration_s >= period_s;
        self.is_step_pending |= is_due && self.tilt == Tilt::Known;
    }

    /// Runs slices of the covariance step.
    #[inline(never)]
    fn run_slices(&mut self, slices: u32) {
        for _ in 0..slices {
            match self.step.slice() {
                Progress::Idle => self.begin_covariance_step(),
                Progress::Working => {}
                Progress::Propagated | Progress::Checked => self.update_extra_tilt(),
                Progress::PreparationDue => {
                    self.admit_changed_bias();
                    self.check_rest_drift();
                    self.relax_parameter(self.step.duration_s());
                }
                Progress::MeasurementsDue => {
                    self.nominal_tilt_rad2 = self.step.tilt_variance_rad2();
                    self.measure();
                }
                Progress::Corrected => self.apply_correction(),
                Progress::Unsound => self.restart_from_unusable_numbers(),
            }
            if !self.is_step_pending {
                return;
            }
        }
    }

    /// Moves the correction of the covariance step, propagated to the present, into the nominal
    /// state.
    fn apply_correction(&mut self) {
        self.is_step_pending = false;
        let Column {
            mut dynamic,
            parameters,
        } = self.step.correction;
        // The first rest may correct much, and contradicts nothing.
        if !self.is_first_rest {
            let [north, east, ..] = dynamic;
            let decrease_rad2 = self.nominal_tilt_rad2 - self.step.tilt_variance_rad2();
            let duration_s = self.step.duration_s();
            self.consistency
                .add([north, east], decrease_rad2, duration_s);
        }
        self.is_first_rest = false;
        self.interval.transition.apply(&mut dynamic, &parameters);
        self.nominal.add_error(&dynamic, &parameters);
        if !self.nominal.is_plausible() {
            self.restart_from_unusable_numbers();
            return;
        }
        self.judge_bias();
    }

    /// Returns the gyroscope bias, rad/s in body axes.
    pub fn bias_rad_s(&self) -> Vector3 {
        self.nominal.gyroscope_bias_rad_s
    }

    /// Returns σ of [`bias_rad_s`](Self::bias_rad_s), rad/s.
    pub fn bias_sigma_rad_s(&self) -> Vector3 {
        let [x, y, z] = self.step.covariance.bias_variances().map(sigma);
        Vector3::new(x, y, z)
    }

    /// Returns σ of the bias of the worst axis, rad/s.
    pub fn largest_bias_sigma_rad_s(&self) -> f32 {
        sigma(self.largest_bias_variance())
    }

    /// Returns the mean squared horizontal velocity of the last seconds, (m/s)².
    pub const fn squared_velocity_m2_s2(&self) -> f32 {
        self.recent.squared
    }

    fn largest_bias_variance(&self) -> f32 {
        let [x, y, z] = self.step.covariance.bias_variances();
        larger(larger(x, y), z)
    }

    /// Returns the accelerometer bias, m/s² in body axes.
    pub fn accelerometer_bias_m_s2(&self) -> Vector3 {
        self.nominal.accelerometer_bias_m_s2
    }

    /// Returns σ of [`accelerometer_bias_m_s2`](Self::accelerometer_bias_m_s2), m/s².
    pub fn accelerometer_bias_sigma_m_s2(&self) -> Vector3 {
        let covariance = &self.step.covariance;
        let sigma = |axis| sigma(covariance.parameter_variance(GYROSCOPE_PARAMETERS + axis));
        Vector3::new(sigma(0), sigma(1), sigma(2))
    }

    /// Returns the accelerometer bias along the body's forward and right axes, m/s²; `None` until
    /// motion has reduced both variances to 0.4 of the prior's. The part along the down axis is
    /// zero, because its estimate drifts in flight.
    ///
    /// The next run can start with it: see `Calibration::add_accelerometer_offset`.
    pub fn certain_accelerometer_bias_m_s2(&self) -> Option<Vector3> {
        let variance = |axis| {
            let covariance = &self.step.covariance;
            covariance.parameter_variance(GYROSCOPE_PARAMETERS + axis)
        };
        let is_certain = CERTAIN_VARIANCE_RATIO * larger(variance(0), variance(1))
            < square(self.parameter_priors.accelerometer_m_s2);
        let bias = self.nominal.accelerometer_bias_m_s2;
        is_certain.then(|| Vector3::new(bias.x, bias.y, 0.0))
    }

    /// Returns the acceleration of the body without gravity, m/s² in body axes.
    pub fn linear_acceleration_m_s2(&self) -> Vector3 {
        let attitude = self.nominal.extrapolate(0.0);
        let gravity = attitude.down_in_body().scale(STANDARD_GRAVITY_M_S2);
        self.nominal.force_m_s2 - self.nominal.accelerometer_bias_m_s2 + gravity
    }

    /// Returns whether the readings have not changed for 0.3 s.
    pub fn is_still(&self) -> bool {
        self.rest_detector.is_still()
    }

    /// Forgets how long the sensor has been stationary, because its readings were no measurements.
    pub(crate) const fn interrupt_rest(&mut self) {
        self.rest_detector.interrupt();
    }
}

fn sigma(variance: f32) -> f32 {
    libm::sqrtf(larger(variance, 0.0))
}
