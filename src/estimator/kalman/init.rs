//! Start of the filter: from a first sample, from a stored bias, or from an earlier run.
//!
//! The table lists the effects (–: none). Each start sets the velocity to zero and ends a
//! covariance step under way, except `set_bias` and `confirm_start`.
//!
//! | method | when | tilt | bias | other parameters |
//! |---|---|---|---|---|
//! | `new`, `restart` | first of all; other axes | unknown, yaw zero | prior | priors |
//! | `set_bias` | a stored offset counts | – | stored | – |
//! | `resume` | the core was reset | kept | kept: suspect | kept: accelerometer |
//! | `start_from` | first sample, gap, hidden tilt | one sample; yaw kept | suspect ¹ | – ² |
//! | `confirm_start` | 0.15 to 0.75 s later | by the mean force | – | – |
//! | `check_tilt` | 1.3 or 4 s of force contradict it | by the mean force | – | – |
//! | `restart_at_rest` | a rest contradicts the state | by its force | by its rate | priors |
//! | `forget_parameters` | another calibration | kept | – | priors |
//! | `inflate_motion` | the sensor lost its settings | kept, σ grows | suspect | – |
//! | `restart_from_unusable_numbers` | no sensor's numbers | kept, σ 17° | kept | priors |
//!
//! ¹ Not at the first sample. ² Priors, if the accelerometer's bias is implausible.
//!
//! A suspect bias has to be confirmed (`confirmation.rs`).

use super::confirmation::Confirmation;
use super::propagation::Interval;
use super::recent_velocity::RecentVelocity;
use super::recovery::ForceSum;
use super::rest_detector::RestDetector;
use super::tilt_variance::REPORTED_VARIANCE_SCALE;
use super::unseen::ANY_TURN_RAD2;
use super::warm_start::WarmStart;
use super::{KNOWN_BIAS_RAD_S, Kalman, USABLE_TILT_RAD};
use crate::attitude::{Quaternion, Vector3};
use crate::estimator::arithmetic::{larger, square};
use crate::estimator::sample::Sample;

/// Tilt variance that a single sample's specific force adds to that of a mean, both axes together,
/// rad²: too much for `VALID`.
const ONE_SAMPLE_TILT_RAD2: f32 = 0.5;

/// Longest time over which the first mean specific force has to become about one g, s. Shaking of
/// 2 Hz and more cancels; a longer mean would keep readings of another time.
const LONGEST_FIRST_MEAN_S: f32 = 0.75;

/// Bias of the accelerometer beyond which a new start forgets it, in σ of what is known of it.
/// Flights reach three; readings that are no measurements lead beyond.
const IMPLAUSIBLE_BIAS_SIGMA: f32 = 4.0;

/// Source of the tilt, now or with the next sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum Tilt {
    /// Unknown: no specific force has shown where down is.
    Unknown,
    /// From the mean readings at rest, which contradict the state: the next sample restarts the
    /// filter.
    Restarting,
    /// Hidden by a pause or by full-scale readings, or the first mean was not about one g: the next
    /// sample that shows gravity sets it.
    Lost,
    /// Known.
    Known,
}

impl Kalman {
    /// Starts with a known gyroscope bias, rad/s in body axes, and its σ per axis. Call it before
    /// the first sample.
    ///
    /// With σ of 0.3 °/s or more, the bias may have changed since. In motion, or while armed, σ
    /// of the tilt is then at least 4°. It grows with the difference of the force from one g. A
    /// rest or motion that confirms the bias ends this. With a smaller σ, the first correction
    /// confirms the bias once the start's uncertainty has decayed. The vehicle may move, because
    /// the attitude becomes `VALID` before any rest.
    pub fn set_bias(&mut self, bias_rad_s: Vector3, sigma_rad_s: f32) {
        self.recent = RecentVelocity::kept(0.0, self.tuning);
        self.bias_prior.reference_rad_s = bias_rad_s;
        self.set_bias_prior(bias_rad_s, sigma_rad_s);
        self.confirmation = Confirmation::Stored;
    }

    /// Sets the bias, rad/s in body axes, and its σ per axis, until a rest measures it. The
    /// reference of a known bias stays.
    #[inline(never)]
    pub(super) fn set_bias_prior(&mut self, bias_rad_s: Vector3, sigma_rad_s: f32) {
        self.nominal.set_gyroscope_bias(bias_rad_s);
        self.bias_prior.variance = [square(sigma_rad_s); 3];
        self.has_measured_prior = sigma_rad_s < KNOWN_BIAS_RAD_S;
        self.is_bias_known = self.has_measured_prior;
        self.return_bias_to_prior();
    }

    /// Returns the bias's variances to their prior, about the present bias, until a rest measures
    /// it. The reference of a known bias stays.
    #[inline(never)]
    pub(super) fn return_bias_to_prior(&mut self) {
        self.has_rested = false;
        self.rested_s = 0.0;
        if !self.is_bias_known {
            self.bias_prior.reference_rad_s = self.nominal.gyroscope_bias_rad_s;
        }
        self.step.covariance.reset_bias(self.bias_prior.variance);
    }

    /// Continues from an earlier run, instead of taking the tilt from the first sample.
    pub(crate) fn resume(&mut self, start: &WarmStart) {
        self.nominal.attitude = start.attitude;
        self.bias_prior.reference_rad_s = start.bias_rad_s - start.bias_change_rad_s;
        self.start_from_attitude(
            start.bias_rad_s,
            start.bias_sigma_rad_s,
            start.tilt_sigma_rad,
        );
        self.allow_unseen_motion(ANY_TURN_RAD2);
        self.recent = RecentVelocity::kept(start.squared_velocity_m2_s2, self.tuning);
        let [forward, right] = start.accelerometer_bias_m_s2;
        self.nominal.accelerometer_bias_m_s2 = Vector3::new(forward, right, 0.0);
        self.tilt = if start.tilt_sigma_rad < USABLE_TILT_RAD {
            Tilt::Known
        } else {
            Tilt::Lost
        };
    }

    /// Returns the change of the bias from its reference, rad/s: since the last rest, or else since
    /// it was stored.
    pub(crate) fn bias_change_rad_s(&self) -> Vector3 {
        self.nominal.gyroscope_bias_rad_s - self.bias_prior.reference_rad_s
    }

    /// Returns σ per axis with which a later run may take over the bias, rad/s: too large for a
    /// known bias while this one is not known. `None` until a rest, of this run or an earlier one,
    /// has measured it.
    pub(crate) fn kept_bias_sigma_rad_s(&self) -> Option<f32> {
        let least_rad_s = if self.is_bias_known {
            0.0
        } else {
            KNOWN_BIAS_RAD_S
        };
        self.is_bias_measured()
            .then(|| larger(self.largest_bias_sigma_rad_s(), least_rad_s))
    }

    /// Starts from the present attitude with this bias, and their σ. Keeps the other parameters.
    pub(super) fn start_from_attitude(
        &mut self,
        bias_rad_s: Vector3,
        bias_sigma_rad_s: f32,
        tilt_sigma_rad: f32,
    ) {
        self.set_bias_prior(bias_rad_s, bias_sigma_rad_s);
        self.reset_tilt_and_velocity(0.5 * square(tilt_sigma_rad) / REPORTED_VARIANCE_SCALE);
    }

    /// Shifts the bias estimate after the upstream compensation changed, rad/s. The attitude is
    /// unaffected.
    pub(crate) fn shift_bias(&mut self, change_rad_s: Vector3) {
        let bias_rad_s = self.nominal.gyroscope_bias_rad_s + change_rad_s;
        self.nominal.set_gyroscope_bias(bias_rad_s);
        self.bias_prior.reference_rad_s = self.bias_prior.reference_rad_s + change_rad_s;
        self.rest_detector.shift_rate(change_rad_s);
    }

    /// Starts from the first sample, or the first after a gap: takes roll and pitch from the
    /// specific force if it shows gravity. Keeps yaw and the sensor's parameters.
    ///
    /// A rest that contradicted the state shows the tilt only if the sample follows it directly,
    /// `dt_s` after the last one: in a pause the body may turn.
    pub(super) fn start_from(&mut self, sample: &Sample, shows_gravity: bool, dt_s: f32) {
        let (rate, force) = (sample.angular_rate_rad_s, sample.specific_force_m_s2);
        let readings = self.rest_detector.stationary_readings(self.tuning);
        if let (Tilt::Restarting, Some(readings)) = (self.tilt, readings)
            && dt_s < self.pause_after_s
        {
            self.restart_at_rest(&readings);
        } else {
            self.rest_detector = RestDetector::new();
            self.start_tilt(force, shows_gravity);
        }
        self.nominal.start(rate, force);
    }

    /// Takes the tilt from the specific force, body axes. Without gravity, a tilt that was known
    /// becomes [`Tilt::Lost`].
    fn start_tilt(&mut self, force: Vector3, shows_gravity: bool) {
        self.reset_tilt_and_velocity(square(self.tuning.start_tilt_rad));
        self.extra_tilt_rad2 = ONE_SAMPLE_TILT_RAD2;
        self.is_from_one_sample = true;
        if shows_gravity {
            self.level_to(force);
        } else {
            self.lose_tilt();
        }
    }

    /// Makes this sample's specific force, body axes, point up. The first tilt has no yaw. A later
    /// one is the nearest to the present attitude, of a vehicle that may move.
    fn level_to(&mut self, force: Vector3) {
        let attitude = self.nominal.attitude;
        if self.tilt == Tilt::Unknown {
            self.nominal.attitude = Quaternion::from_down(-force).with_sign_of(attitude);
        } else {
            self.allow_unseen_motion(ANY_TURN_RAD2);
            let bias = self.nominal.accelerometer_bias_m_s2;
            if bias.dot(bias)
                > square(IMPLAUSIBLE_BIAS_SIGMA * self.parameter_priors.accelerometer_m_s2)
            {
                self.reset_parameters();
            }
            self.level(attitude.rotate(force));
        }
        self.tilt = Tilt::Known;
    }

    /// Takes the tilt from this mean force instead of that of a single sample. While
    /// it is not about one g, the vehicle shakes or falls, and a longer mean follows. In the end
    /// the next sample sets the tilt again.
    pub(super) fn confirm_start(&mut self, force: &ForceSum) {
        self.is_step_pending = false;
        self.is_tilt_checked = false;
        if force.is_gravity_up().is_none() {
            if force.duration_s > LONGEST_FIRST_MEAN_S {
                self.tilt = Tilt::Lost;
            }
            return;
        }
        self.level(force.integral_m_s);
        let unseen_tilt_rad2 = self.interval.unseen_tilt_rad2;
        self.interval = Interval::EMPTY;
        self.interval.unseen_tilt_rad2 = unseen_tilt_rad2;
        self.extra_tilt_rad2 = 0.0;
        self.is_from_one_sample = false;
    }

    /// Resets tilt (variance per axis, rad²) and velocity, and abandons the covariance step under
    /// way.
    ///
    /// An abandoned step of a first rest has reduced the bias's variance, but not corrected the
    /// bias. Its variance is therefore reset.
    #[inline(never)]
    pub(super) fn reset_tilt_and_velocity(&mut self, tilt_variance: f32) {
        self.step.abandon();
        if self.is_first_rest {
            self.return_bias_to_prior();
        }
        let velocity_variance = square(self.tuning.start_velocity_m_s);
        let covariance = &mut self.step.covariance;
        covariance.reset_tilt_and_velocity(tilt_variance, velocity_variance);
        self.is_step_pending = false;
        self.is_tilt_checked = false;
        self.rest_watch.end();
        self.extra_tilt_rad2 = 0.0;
        self.interval = Interval::EMPTY;
        self.nominal.velocity_m_s = [0.0; 2];
        self.force_sum = ForceSum::NONE;
    }
}
