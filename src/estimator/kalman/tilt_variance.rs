//! From the covariance to the reported tilt variance. All are of both axes together, rad².
//!
//! ```text
//!   tilt of the covariance; while a step is under way, `nominal_tilt_rad2`:
//!   that of the nominal state, which the step corrects last
//! + motion that no sample has shown since the last step
//! = covariance_tilt_variance()
//! + extra_tilt_rad2: errors that the covariance does not hold
//! = total_tilt_variance()
//! × 0.92²
//!   while the bias is not known: × 3² + a bank that looks level
//! = reported_tilt_variance()
//! ```
//!
//! Errors that the covariance does not hold take turns in `extra_tilt_rad2`:
//!
//! - After a start the tilt is that of a single sample (`init.rs`).
//! - Once the sensor has rested, it may turn while the specific force does not (`rest_watch.rs`).
//! - In motion, or while armed, the bias is not confirmed, or the specific force contradicts the
//!   tilt (`confirmation.rs`), or the corrections are suspicious (`consistency.rs`).

use super::confirmation::Confirmation;
use super::{Kalman, Tilt, sigma};
use crate::estimator::arithmetic::{larger, smaller, square};
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Scale from the filter's σ of tilt, which is conservative, to the reported σ.
///
/// Vehicle velocities are not the white noise that the filter assumes, so its σ is too large on
/// every set of recordings with truth. This is the smallest scale with which 3 σ hold 99 % of
/// the errors of each set. A single recording may have less, such as 98.6 % of one room of TUM-VI.
pub(super) const REPORTED_SIGMA_SCALE: f32 = 0.92;
pub(super) const REPORTED_VARIANCE_SCALE: f32 = square(REPORTED_SIGMA_SCALE);

/// Factor of the reported σ while the bias is not known, beside the variance of a bank.
///
/// A large bias about the vertical misleads the filter after a start in motion: while bias and tilt
/// are uncertain, the linear model leaves out their product.
pub(super) const UNKNOWN_BIAS_SIGMA_SCALE: f32 = 3.0;

/// σ of a bank that the accelerometer's error hides, rad.
const HIDDEN_BANK_RAD: f32 = 0.1;

/// Least σ of the tilt with a bias that has drifted or is stored, and while the corrections are
/// suspicious (`consistency.rs`), both axes together, rad: as reported, 4°. So six σ are 24°.
/// Healthy flights raise suspicions too: it is below the limits of `DEGRADED` and of a valid
/// heading.
const UNCONFIRMED_TILT_RAD: f32 = radians(4.3);
/// Least σ of the tilt with a suspect bias, both axes together, rad: as reported, 6.4°. Six σ
/// are 39°.
const SUSPECT_BIAS_TILT_RAD: f32 = radians(7.0);
/// Largest σ of a bank that the specific force shows, both axes together, rad. In turns of up to
/// 68° no error exceeded six σ, and with it a quadrotor's accelerations do not end `VALID`.
const SHOWN_BANK_RAD: f32 = radians(15.0);
/// Least σ of the tilt while it fails the force check, both axes together, rad: too much for
/// `VALID`.
const CONTRADICTED_TILT_RAD: f32 = radians(40.0);

impl Kalman {
    /// Returns the reported tilt variance. Infinite without a tilt.
    #[inline]
    pub(super) fn reported_tilt_variance(&self) -> f32 {
        match self.tilt {
            Tilt::Unknown | Tilt::Lost => f32::INFINITY,
            Tilt::Restarting | Tilt::Known => {
                let variance = REPORTED_VARIANCE_SCALE * self.total_tilt_variance();
                if self.is_bias_known {
                    variance
                } else {
                    square(UNKNOWN_BIAS_SIGMA_SCALE) * variance
                        + self.bank_variance()
                        + square(HIDDEN_BANK_RAD)
                }
            }
        }
    }

    /// Returns σ of the direction of down, both axes together, rad. Infinite without a tilt.
    pub fn tilt_sigma_rad(&self) -> f32 {
        sigma(self.reported_tilt_variance())
    }

    /// Returns the tilt variance of the nominal state, with the errors that the covariance does not
    /// hold.
    #[inline]
    pub(super) fn total_tilt_variance(&self) -> f32 {
        self.covariance_tilt_variance() + self.extra_tilt_rad2
    }

    /// Returns the tilt variance of the nominal state by the covariance.
    #[inline]
    pub(super) fn covariance_tilt_variance(&self) -> f32 {
        let tilt_rad2 = if self.step.is_under_way() {
            self.nominal_tilt_rad2
        } else {
            self.step.tilt_variance_rad2()
        };
        tilt_rad2 + 2.0 * self.interval.unseen_tilt_rad2
    }

    /// Returns the variance of a bank that the filter may take for level while the bias is not
    /// known or not confirmed.
    ///
    /// A level turn reads like a tilted rest with a bias. The specific force shows the bank φ:
    /// |f|²/g² − 1 = tan² φ. With a quarter of it, six σ are three times the bank. The
    /// accelerometer's error may hide 20°, so [`HIDDEN_BANK_RAD`] is to be added: six of it are
    /// 34°.
    #[inline(never)]
    pub(super) fn bank_variance(&self) -> f32 {
        const GRAVITY_SQUARED: f32 = square(STANDARD_GRAVITY_M_S2);
        let force = self.rest_detector.average_force_m_s2();
        let excess = force.dot(force) - GRAVITY_SQUARED;
        0.25 / GRAVITY_SQUARED * excess.abs()
    }

    /// Sets the tilt variance of errors that the covariance does not hold, twice in each covariance
    /// step: the turn since the last rest that the readings do not show, or what is missing to the
    /// least variance, whichever is larger.
    pub(super) fn update_extra_tilt(&mut self) {
        let turned_rad2 = self
            .rest_watch
            .update(&self.nominal, &self.rest_detector, self.tuning);
        let missing_rad2 = self.least_tilt_rad2() - self.step.tilt_variance_rad2();
        self.extra_tilt_rad2 = larger(turned_rad2, missing_rad2);
    }

    /// Returns the least tilt variance, both axes together, rad². It is zero for a still sensor
    /// that is not armed, unless gravity contradicts the tilt. A stored or suspect bias hides a
    /// bank, which the specific force shows. That of an unknown bias comes later, in
    /// `reported_tilt_variance()`.
    fn least_tilt_rad2(&self) -> f32 {
        if self.is_tilt_contradicted() {
            return square(CONTRADICTED_TILT_RAD);
        }
        if !self.is_armed && self.rest_detector.is_still() {
            return 0.0;
        }
        if self.confirmation == Confirmation::Confirmed && !self.consistency.is_suspicious() {
            return 0.0;
        }
        let least_rad2 = match self.confirmation {
            Confirmation::Confirmed | Confirmation::Drifted => return square(UNCONFIRMED_TILT_RAD),
            Confirmation::Stored => square(UNCONFIRMED_TILT_RAD),
            Confirmation::Suspect => square(SUSPECT_BIAS_TILT_RAD),
        };
        if self.is_bias_known {
            least_rad2 + smaller(self.bank_variance(), square(SHOWN_BANK_RAD))
        } else {
            least_rad2
        }
    }
}
