//! Compares force and attitude with those of the last rest, to detect a changed gyroscope bias.
//!
//! While the specific force in body axes stays that of the rest, gravity has not turned. If the
//! filter's attitude turns meanwhile, the gyroscope's bias has changed, and the turn is an error.
//! Its size is known, so the reported σ includes it until a new rest is established.
//!
//! A new rest may contradict the bias. The filter restarts at it if the contradiction lasts 3 s and
//! the rate is as steady as at the last rest. No hand and few vehicles turn so steadily, because
//! they vibrate. Limit: a bias that changes as an engine starts is found when the vibration ends. A
//! constant force in body axes is no proof, because a load on a rope and a buoy turn with it.

use super::nominal::NominalState;
use super::rest_detector::RestDetector;
use super::tuning::Tuning;
use crate::attitude::Vector3;
use crate::estimator::arithmetic::square;
use crate::serialize::StateVisitor;
use crate::units::radians;

/// Variance of a turn that the specific force does not show, as a share of its square: the turn is
/// 2.5 σ.
const TURN_SHARE: f32 = square(1.0 / 2.5);

/// Longest time between two updates, s: two in each covariance step.
const UPDATE_PERIOD_S: f32 = 0.22;

/// Variance of the rate before a rest has shown it, all axes together, (rad/s)²: that of a sensor
/// with a bandwidth of 188 Hz (product specification §6.1).
const START_VARIANCE: f32 = square(radians(0.15));
/// Share of a covariance step at rest in the mean variance at rest.
const VARIANCE_SHARE: f32 = 1.0 / 16.0;
/// Variance of a rate that moves, as a multiple of that at rest: at 50 samples a second the
/// variance over half a second scatters by an eighth.
const MOTION_RATIO: f32 = 1.5;
/// Variance that is added to the one at rest, (rad/s)²: it may consist of digits alone, which are
/// 0.06 °/s at ±2000 °/s.
const DIGITS_VARIANCE: f32 = square(radians(0.1));

/// Comparison of the present readings with those of the last rest.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct RestWatch {
    /// True if a rest has just been established: the next update begins to watch it.
    pub(super) begins: bool,
    /// Specific force at rest, m/s² in body axes. Without a rest x is infinite, so that all
    /// readings differ.
    force_m_s2: Vector3,
    /// Down at rest by the filter, body axes.
    down: Vector3,
    /// Variance of the rate at rest, all axes together, (rad/s)².
    rate_variance: f32,
}

impl RestWatch {
    /// Creates a watch without a rest.
    pub(super) const fn new() -> Self {
        Self {
            begins: false,
            force_m_s2: Vector3::new(f32::INFINITY, 0.0, 0.0),
            down: Vector3::ZERO,
            rate_variance: START_VARIANCE,
        }
    }

    /// Ends the watch.
    pub(super) const fn end(&mut self) {
        self.begins = false;
        self.force_m_s2.x = f32::INFINITY;
    }

    /// Adds a covariance step at rest. The variance of the rate is that of all axes together,
    /// (rad/s)².
    pub(super) fn add_rest(&mut self, rate_variance: f32) {
        self.begins = true;
        self.rate_variance += VARIANCE_SHARE * (rate_variance - self.rate_variance);
    }

    /// Compares the present specific force and attitude with those of the rest. Returns the tilt
    /// variance of a turn that the specific force does not show, both axes together, rad². The
    /// watch ends when the specific force changes.
    pub(super) fn update(
        &mut self,
        nominal: &NominalState,
        rest_detector: &RestDetector,
        tuning: &Tuning,
    ) -> f32 {
        let down = nominal.attitude.down_in_body();
        if self.begins {
            self.begins = false;
            self.force_m_s2 = rest_detector.average_force_m_s2();
            self.down = down;
        }
        let change = nominal.force_m_s2 - self.force_m_s2;
        if change.dot(change) > square(tuning.stationary_force_m_s2) {
            self.force_m_s2.x = f32::INFINITY;
            return 0.0;
        }
        // The turn goes on until the next update.
        let later = down.cross(nominal.rate_rad_s).scale(UPDATE_PERIOD_S);
        let turn = down - self.down + later;
        TURN_SHARE * turn.dot(turn)
    }

    /// Returns whether this variance of the rate exceeds that at rest: the sensor moves.
    pub(super) fn is_motion(&self, rate_variance: f32) -> bool {
        rate_variance > MOTION_RATIO * self.rate_variance + DIGITS_VARIANCE
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            begins,
            force_m_s2,
            down,
            rate_variance,
        } = self;
        visitor.bool(begins);
        visitor.vector(force_m_s2);
        visitor.vector(down);
        visitor.f32(rate_variance);
    }
}
