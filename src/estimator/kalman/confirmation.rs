//! Confirmation of the bias, and the least σ of the tilt while something contradicts the state.
//!
//! A stored bias may have changed since it was measured. A bias that motion contradicts may have
//! changed as well, or the vehicle turns for long: in a coordinated turn of minutes a wrong tilt
//! and a wrong bias explain all readings together, and their covariance becomes small. So such a
//! bias has to be confirmed, and σ of the tilt stays large until then. A rest confirms it, and
//! motion that leads back to the bias that a rest has measured. Far from that, it is not even
//! known.

use super::consistency::SUSPICION_RAD;
use super::{KNOWN_BIAS_RAD_S, Kalman};
use crate::estimator::arithmetic::{larger, square};
use crate::units::radians;

/// Largest σ of a bias that is confirmed, per axis: below that of a stored bias at the start.
const CONFIRMED_SIGMA_RAD_S: f32 = radians(0.3);
/// Least σ with which a bias that is not confirmed is kept over a reset, per axis: nearly too
/// large for a known one, so that a confirmed one hardly has it.
const KEPT_SIGMA_RAD_S: f32 = radians(0.45);
/// Largest change of a bias that is confirmed, since a rest has measured it.
const CONFIRMED_CHANGE_RAD_S: f32 = radians(0.3);
/// Largest change of a contradicted bias that is known: a flight in turns had one of 5 °/s.
const KNOWN_CHANGE_RAD_S: f32 = radians(1.0);
/// Least σ of the tilt after motion has contradicted the bias, both axes together, rad: as
/// reported, 6.4°. Six σ are 39°.
const CONTRADICTED_BIAS_TILT_RAD: f32 = radians(7.0);
/// Least σ of the tilt while the specific force contradicts it, both axes together, rad: too much
/// for `VALID`.
const CONTRADICTED_TILT_RAD: f32 = radians(40.0);

/// Confirmation of the bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum Confirmation {
    /// Confirmed; or neither stored nor contradicted.
    Confirmed,
    /// Motion has contradicted it.
    Contradicted,
    /// Stored, and not confirmed since the start. The tilt may be that of a start in a turn, whose
    /// bank the specific force shows.
    Stored,
}

impl Kalman {
    /// Decides after a correction whether the bias is confirmed and known. Motion confirms one that
    /// is certain, and near the one that a rest has measured.
    pub(super) fn judge_bias(&mut self) {
        let variance = self.largest_bias_variance();
        let change = self.nominal.gyroscope_bias_rad_s - self.bias_prior.mean_rad_s;
        let squared_change = change.dot(change);
        if variance < square(CONFIRMED_SIGMA_RAD_S)
            && squared_change < square(CONFIRMED_CHANGE_RAD_S)
        {
            self.confirmation = Confirmation::Confirmed;
        }
        self.is_bias_known = self.is_bias_measured()
            && variance < square(KNOWN_BIAS_RAD_S)
            && (self.confirmation != Confirmation::Contradicted
                || squared_change < square(KNOWN_CHANGE_RAD_S));
    }

    /// Returns σ of the bias of the worst axis for a later run, rad/s: at least
    /// [`KEPT_SIGMA_RAD_S`] unless the bias is confirmed.
    pub(crate) fn kept_bias_sigma_rad_s(&self) -> f32 {
        let sigma_rad_s = self.largest_bias_sigma_rad_s();
        match self.confirmation {
            Confirmation::Confirmed => sigma_rad_s,
            _ => larger(sigma_rad_s, KEPT_SIGMA_RAD_S),
        }
    }

    /// Sets the confirmation of a bias that an earlier run has kept with this σ.
    pub(super) fn judge_kept_bias(&mut self, sigma_rad_s: f32) {
        self.confirmation = if sigma_rad_s < KEPT_SIGMA_RAD_S {
            Confirmation::Confirmed
        } else {
            Confirmation::Contradicted
        };
    }

    /// Sets the tilt variance that is reported beside the covariance's, twice in each covariance
    /// step. Compares the present readings with those of the last rest.
    #[inline(never)]
    pub(super) fn watch_rest_and_consistency(&mut self) {
        self.extra_tilt_rad2 =
            self.rest_watch
                .update(&self.nominal, &self.rest_detector, self.tuning);
        if let Some(least_rad2) = self.least_tilt_rad2() {
            let missing_rad2 = least_rad2 - self.step.tilt_variance_rad2();
            self.extra_tilt_rad2 = larger(self.extra_tilt_rad2, missing_rad2);
        }
    }

    /// Returns the least tilt variance, both axes together, rad². A still sensor that is not armed
    /// needs none, unless gravity contradicts its tilt.
    fn least_tilt_rad2(&self) -> Option<f32> {
        if self.is_tilt_contradicted() {
            return Some(square(CONTRADICTED_TILT_RAD));
        }
        if !self.is_armed && self.rest_detector.is_still() {
            return None;
        }
        match self.confirmation {
            Confirmation::Stored => Some(square(SUSPICION_RAD) + self.bank_variance()),
            Confirmation::Contradicted => Some(square(CONTRADICTED_BIAS_TILT_RAD)),
            Confirmation::Confirmed => {
                let is_suspicious = self.consistency.is_suspicious();
                is_suspicious.then_some(square(SUSPICION_RAD))
            }
        }
    }
}
