//! Watch over a sensor that has rested: has it really turned, if the gyroscope says so?
//!
//! While the specific force in body axes stays that of the rest, gravity has not turned. If the
//! filter's attitude turns meanwhile, the gyroscope's offset has changed, and the turn is an error.
//! Its size is known, so the reported σ includes it until a new rest is established.
//!
//! A new rest contradicts the offset. The filter believes it when no motion explains the readings:
//! no hand and few vehicles turn so steadily. That gravity has not turned in the vehicle is no
//! proof. A load on a rope and a buoy turn together with the force.

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

/// Largest change of the rate that is noise, rad/s: 5 σ of a sensor with a bandwidth of 188 Hz
/// (product specification §6.1), and less than a hand's tremor.
const NOISE_RATE_RAD_S: f32 = radians(0.8);
/// Time of so steady a rate after which the sensor does not turn, s. Before it, the sensor has been
/// without motion for two seconds.
const CERTAIN_S: f32 = 1.0;

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
    /// Time without motion, s, when steady readings began to contradict the offset.
    steady_from_s: f32,
}

impl RestWatch {
    /// No rest to watch.
    pub(super) const NONE: Self = Self {
        begins: false,
        force_m_s2: Vector3::new(f32::INFINITY, 0.0, 0.0),
        down: Vector3::ZERO,
        steady_from_s: f32::INFINITY,
    };

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
            *self = Self {
                force_m_s2: rest_detector.average_force_m_s2(),
                down,
                ..Self::NONE
            };
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

    /// Adds a covariance step of a new rest whose readings contradict the offset, `quiet_s` after
    /// the last motion. Returns whether no motion explains them.
    ///
    /// `mean_rate_rad_s` and `rate_rad_s` are the mean and the present rate without the filter's
    /// bias.
    pub(super) fn is_offset_wrong(
        &mut self,
        mean_rate_rad_s: Vector3,
        rate_rad_s: Vector3,
        quiet_s: f32,
    ) -> bool {
        let change = rate_rad_s - mean_rate_rad_s;
        if quiet_s < self.steady_from_s || change.dot(change) > square(NOISE_RATE_RAD_S) {
            self.steady_from_s = quiet_s;
        }
        quiet_s - self.steady_from_s > CERTAIN_S
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.bool(&mut self.begins);
        visitor.vector(&mut self.force_m_s2);
        visitor.vector(&mut self.down);
        visitor.f32(&mut self.steady_from_s);
    }
}
