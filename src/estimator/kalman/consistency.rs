//! Consistency test of the corrections against their covariance: finds a bias that has changed in
//! motion.
//!
//! A covariance step corrects the tilt by δ, north and east. If the filter's model holds,
//! corrections have no preferred direction, and the covariance of δ is the decrease P⁻ − P⁺
//! (Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
//! 2001, §5.4). A bias that the filter does not know tilts the attitude the same way all the time,
//! so the corrections add up. Over the last seconds, with forgetting factor φ,
//!
//! ```text
//! s ← φ·s + δ    v ← φ²·v + tr(P⁻ − P⁺)
//! |s|² > v: suspicion
//! |s|² > 4·v: contradiction
//! ```
//!
//! The filter's model of velocity is conservative. So |s|² stays below 4·v in healthy flights and
//! hand-held motion, and mostly below v.
//!
//! A contradiction adds process noise: the bias may have changed by as much as the corrections
//! show. A suspicion changes nothing but the reported σ. A filter that is sure of its bias
//! corrects little, so for seconds s is much smaller than the tilt's error.
//!
//! The correction of the first rest does not count: it may be large.

use crate::estimator::arithmetic::{larger, smaller, square};
use crate::serialize::StateVisitor;
use crate::units::radians;

/// Time constant of the sums, s. Longer: smaller changes are found. Shorter: found sooner.
const MEMORY_S: f32 = 3.0;
/// Square of the sum per variance from which on it is suspicious, and from which on it contradicts
/// the model.
const SUSPICION_GATE: f32 = 1.0;
const CONTRADICTION_GATE: f32 = 4.0;
/// Variance of the sum after unseen motion, per reported tilt variance of one axis. It decays to
/// (1°)² within 9 s of a turn of 2°, and within 20 s of one of 80°. A vehicle in flight needs
/// that time to correct the tilt.
const UNSEEN_SHARE: f32 = 128.0;
/// Variance of the sum from which on the test is suspended, rad².
const SUSPENDED_RAD2: f32 = square(radians(1.0));
/// Variance of the sum below which nothing hides a changed bias any more, rad².
const SETTLED_RAD2: f32 = square(radians(0.4));

/// Sums of the recent corrections.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Consistency {
    /// Corrections of the tilt, rad north and east.
    sum_rad: [f32; 2],
    /// Variance of the sum by the model, both axes together, rad².
    variance_rad2: f32,
}

/// Process noise of a contradiction, per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contradiction {
    /// Variance of the bias's change, (rad/s)²: one that has turned the tilt by the sum.
    pub(super) bias_variance: f32,
    /// Variance of the tilt, rad².
    pub(super) tilt_rad2: f32,
}

impl Consistency {
    /// No corrections.
    pub(super) const NONE: Self = Self {
        sum_rad: [0.0; 2],
        variance_rad2: 0.0,
    };

    /// Widens the gates: the next corrections also remove motion that no sample has shown, of this
    /// reported tilt variance per axis, rad². They contradict the bias again when this variance
    /// has decayed.
    pub(super) fn widen(&mut self, unseen_rad2: f32) {
        self.variance_rad2 += UNSEEN_SHARE * unseen_rad2;
    }

    /// Adds the correction of a covariance step of this length, and the decrease of the tilt's
    /// variance by its measurements.
    pub(super) fn add(&mut self, correction_rad: [f32; 2], decrease_rad2: f32, duration_s: f32) {
        let factor = 1.0 - smaller(duration_s / MEMORY_S, 1.0);
        for (sum, correction) in self.sum_rad.iter_mut().zip(correction_rad) {
            *sum = factor * *sum + correction;
        }
        self.variance_rad2 = square(factor) * self.variance_rad2 + larger(decrease_rad2, 0.0);
    }

    /// Returns the process noise of a contradiction, and clears the sums; `None` without one.
    #[inline]
    pub(super) fn take_contradiction(&mut self) -> Option<Contradiction> {
        let squared = self.squared();
        if squared <= CONTRADICTION_GATE * self.variance_rad2 {
            return None;
        }
        *self = Self::NONE;
        Some(Contradiction {
            bias_variance: square(1.0 / MEMORY_S) * squared,
            tilt_rad2: squared,
        })
    }

    /// Returns whether the corrections are suspicious.
    #[inline]
    pub(super) fn is_suspicious(&self) -> bool {
        self.squared() > SUSPICION_GATE * self.variance_rad2
    }

    /// Returns whether the test is suspended after unseen motion: for up to 20 s, or longer if
    /// more follows, or while the measurements reduce a large variance.
    #[inline]
    pub(super) fn is_suspended(&self) -> bool {
        self.variance_rad2 > SUSPENDED_RAD2
    }

    /// Returns whether the test has found nothing for long enough after unseen motion that the
    /// bias cannot have changed much: for some three seconds, in motion.
    #[inline]
    pub(super) fn is_conclusive(&self) -> bool {
        self.variance_rad2 < SETTLED_RAD2
    }

    /// Returns the square of the sum, rad².
    #[inline]
    fn squared(&self) -> f32 {
        let [north, east] = self.sum_rad;
        square(north) + square(east)
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            sum_rad,
            variance_rad2,
        } = self;
        visitor.f32s(sum_rad);
        visitor.f32(variance_rad2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrections_that_agree_contradict_and_those_that_alternate_do_not() {
        let (mut steady, mut alternating) = (Consistency::NONE, Consistency::NONE);
        let correction = [0.01, 0.0];
        let mut found = None;
        for index in 0..40 {
            steady.add(correction, 1.0e-4, 0.22);
            found = found.or(steady.take_contradiction().map(|it| (index, it)));
            let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
            alternating.add(correction.map(|it| sign * it), 1.0e-4, 0.22);
            assert_eq!(alternating.take_contradiction(), None);
        }
        // n corrections of σ: n² > 4·n from the fifth on, a little later for the forgetting.
        let (index, contradiction) = found.unwrap();
        assert!((4..8).contains(&index), "{index}");
        // The corrections so far are those of a bias of 0.01/0.22 rad/s for a part of the memory.
        let sigma_rad_s = libm::sqrtf(contradiction.bias_variance);
        assert!((0.01..0.05).contains(&sigma_rad_s), "{sigma_rad_s}");
    }

    #[test]
    fn a_suspicion_comes_before_the_contradiction() {
        let mut consistency = Consistency::NONE;
        let mut suspicions = 0;
        for _ in 0..40 {
            consistency.add([0.0, 0.01], 1.0e-4, 0.22);
            suspicions += u32::from(consistency.is_suspicious());
            if consistency.take_contradiction().is_some() {
                assert!(suspicions > 3, "{suspicions}");
                assert!(!consistency.is_suspicious());
                return;
            }
        }
        panic!("no contradiction");
    }

    #[test]
    fn a_contradiction_is_reported_once() {
        let mut consistency = Consistency::NONE;
        consistency.add([0.0, 0.1], 1.0e-4, 0.22);
        assert!(consistency.take_contradiction().is_some());
        assert_eq!(consistency.take_contradiction(), None);
    }
}
