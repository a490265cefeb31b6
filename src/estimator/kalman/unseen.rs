//! Unobserved motion: inflates the variances for pauses and full-scale readings.
//!
//! Callers outside the filter have four methods:
//!
//! | method | when | tilt | velocity | bias |
//! |---|---|---|---|---|
//! | `inflate_tilt` | motion was hidden | σ grows, in reported units | – | suspect from 2° on |
//! | `inflate_turn` | a shown turn may be false | σ grows, in the filter's units | – | – |
//! | `inflate_motion` | samples were wrong | σ grows, in reported units | zero | suspect |
//! | `lose_tilt` | the hidden turn is too large | by the next sample | zero | suspect |

use super::confirmation::Confirmation;
use super::tilt_variance::REPORTED_VARIANCE_SCALE;
use super::{Kalman, Tilt, USABLE_TILT_RAD};
use crate::estimator::arithmetic::square;
use crate::estimator::sample::Sample;
use crate::units::radians;

/// σ per axis of the rate during a pause, in rad/s. Six σ, the limit of a valid attitude, are 180
/// °/s.
pub const PAUSE_RATE_RAD_S: f32 = radians(30.0);
/// Sample periods without a sample after which a pause hides motion.
const PAUSE_PERIODS: f32 = 3.5;

/// Largest σ per axis of a hidden turn, rad: 1.5 times that of the tilt at a start. Beyond it,
/// gravity shows the tilt better. A pause of up to half a second exceeds it if the rate changes.
/// After full-scale readings the limit is [`USABLE_TILT_RAD`], because a body that turns so fast
/// also accelerates.
pub(crate) const LARGEST_HIDDEN_TURN_RAD: f32 = 0.3;

/// σ per axis of an unseen turn, rad, from which on the vehicle may also have begun to move, and
/// the bias has to be confirmed. A pause of 61 ms reaches it. Below, no false correction of the
/// tilt is large enough to matter.
const UNCERTAIN_TILT_RAD: f32 = radians(2.0);

/// Variance of a turn after which anything may have happened, per axis, rad².
pub(super) const ANY_TURN_RAD2: f32 = 2.0;

/// Longest step in which the rate changes linearly, s. After a longer one the change of the rate
/// adds to σ.
pub(crate) const LONG_STEP_S: f32 = 15.0e-3;

/// σ per axis of the rate that full scale hides, as a share of the reading. Six σ exceed it.
pub(crate) const HIDDEN_SHARE: f32 = 0.2;
/// Tilt variance per second of full-scale gyroscope readings, rad²/s.
const SATURATED_TILT: f32 = 0.25;
/// Velocity variance per second of full-scale accelerometer readings, (m/s)²/s. Readings without
/// a pause add the square of the velocity that they show.
const SATURATED_VELOCITY: f32 = 100.0;

impl Kalman {
    /// Sets the sample period, s. A step of more than 3.5 periods is a pause, in which the body may
    /// turn unseen. Default: no step is a pause.
    pub const fn set_sample_period(&mut self, period_s: f32) {
        self.pause_after_s = PAUSE_PERIODS * period_s;
        self.long_after_s = if self.pause_after_s < LONG_STEP_S {
            self.pause_after_s
        } else {
            LONG_STEP_S
        };
    }

    /// Returns the tilt variance per axis that a pause of this length adds, rad².
    pub fn pause_variance_rad2(&self, pause_s: f32) -> f32 {
        if pause_s > self.pause_after_s {
            square(PAUSE_RATE_RAD_S * pause_s)
        } else {
            0.0
        }
    }

    /// Inflates the tilt by this reported variance per axis, rad²: motion that no sample shows.
    /// From a turn of 2° on the vehicle may also have begun to move, and the bias has to be
    /// confirmed: motion takes 13 to 21 s. Zero changes nothing.
    #[inline(never)]
    pub fn inflate_tilt(&mut self, variance: f32) {
        if variance > 0.0 {
            self.interval.unseen_tilt_rad2 += variance / REPORTED_VARIANCE_SCALE;
            if self.interval.unseen_tilt_rad2 > square(UNCERTAIN_TILT_RAD) {
                self.allow_unseen_motion(variance);
            }
        }
    }

    /// Inflates the tilt by this variance of the filter per axis, rad²: a turn that a sample has
    /// shown, and that may not have happened. The consistency test goes on.
    pub(crate) fn inflate_turn(&mut self, variance: f32) {
        self.interval.unseen_tilt_rad2 += variance;
    }

    /// Makes the next specific force that shows gravity set the tilt, which is unknown until then.
    pub(crate) fn lose_tilt(&mut self) {
        if self.tilt != Tilt::Unknown {
            self.tilt = Tilt::Lost;
        }
    }

    /// Inflates the tilt by this variance per axis, rad², and resets the velocity, which wrong
    /// samples corrupt at once. The vehicle may also have begun to move, and the gyroscope's bias
    /// has to be confirmed.
    pub fn inflate_motion(&mut self, variance: f32) {
        let tilt_variance = 0.5 * self.total_tilt_variance();
        self.reset_tilt_and_velocity(tilt_variance + variance / REPORTED_VARIANCE_SCALE);
        self.allow_unseen_motion(variance);
    }

    /// Allows for motion that no sample has shown, and a turn of this reported variance per axis,
    /// rad². The vehicle may have begun to move, and the bias has to be confirmed.
    #[inline(never)]
    pub(super) fn allow_unseen_motion(&mut self, turn_rad2: f32) {
        self.recent.may_move();
        self.confirmation = Confirmation::Suspect;
        self.consistency.widen(turn_rad2);
    }

    /// Inflates the variances for the motion hidden in a step of `dt_s` seconds to this sample. If
    /// the hidden motion is too large, the next sample resets the tilt, not this one.
    #[cold]
    #[inline(never)]
    pub(super) fn inflate_for_unseen_motion(&mut self, sample: &Sample, dt_s: f32) {
        let mut hidden_rad2 = self.pause_variance_rad2(dt_s);
        let (rate, force) = (sample.angular_rate_rad_s, sample.specific_force_m_s2);
        let (saturated_s, rate_s) = (self.saturated_s, self.rate_saturated_s);
        self.saturated_s = 0.0;
        self.rate_saturated_s = 0.0;
        if sample.is_rate_saturated || sample.is_force_saturated {
            self.saturated_s = saturated_s + dt_s;
        }
        let growth = square(self.saturated_s) - square(saturated_s);
        if sample.is_force_saturated {
            self.interval.unseen_velocity_m2_s2 +=
                force.dot(force) * growth + SATURATED_VELOCITY * dt_s;
        }
        if sample.is_rate_saturated {
            self.rate_saturated_s = rate_s + dt_s;
            let hidden = square(HIDDEN_SHARE) * rate.dot(rate);
            hidden_rad2 += hidden * growth + SATURATED_TILT * dt_s;
        } else {
            let last = self.nominal.rate_rad_s;
            if square(HIDDEN_SHARE * rate_s) * last.dot(last) > square(USABLE_TILT_RAD) {
                self.lose_tilt();
            }
        }
        self.inflate_tilt(hidden_rad2);
        if dt_s > LONG_STEP_S {
            let rate_rad_s = self.nominal.rate_after_pause(sample.angular_rate_rad_s);
            let rate_change = rate_rad_s - self.nominal.rate_rad_s;
            let force_change = sample.specific_force_m_s2 - self.nominal.force_m_s2;
            self.interval.unseen_tilt_rad2 += rate_change.dot(rate_change) * square(0.25 * dt_s);
            if dt_s > self.pause_after_s {
                self.interval.unseen_velocity_m2_s2 +=
                    force_change.dot(force_change) * square(0.25 * dt_s);
                self.nominal
                    .bridge_pause(rate_rad_s, sample.specific_force_m_s2);
                if self.interval.unseen_tilt_rad2 > square(LARGEST_HIDDEN_TURN_RAD) {
                    self.lose_tilt();
                }
            }
        }
    }
}
