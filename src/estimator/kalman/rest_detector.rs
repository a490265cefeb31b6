//! Rest detector of the filter: readings that have not changed for a while, at about one g.
//!
//! Steady motion gives the same readings. The filter therefore uses the detector's readings
//! only as far as its covariance allows. The detector of the calibrations, `StationaryDetector`, is
//! another: it tests against the sensor's own noise.
//!
//! | term | time without motion | meaning |
//! |---|---|---|
//! | still | 0.3 s | nothing shakes |
//! | settled | 0.5 s | the averages hardly contain what came before |
//! | stationary | 0.8 s, later 2 s | and about one g: the readings may be those of a rest |
//! | rest | – | stationary, and they fit bias and tilt (`measurements.rs`) |

use super::tuning::{LARGEST_GYROSCOPE_BIAS_RAD_S, Tuning};
use crate::attitude::Vector3;
use crate::estimator::arithmetic::smaller;
use crate::serialize::StateVisitor;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Time constant of the average to which readings are compared, s.
const AVERAGING_TIME_S: f32 = 0.5;

/// Time constant at the beginning of a time without motion, s: the average forgets the motion.
const FORGETTING_TIME_S: f32 = 0.1;

/// Length of that beginning, s.
const FORGOTTEN_S: f32 = 0.25;

/// Length of the plain average at the start, s. Until it is complete no reading counts as motion,
/// because the sensor's low-pass filter still settles.
const FIRST_AVERAGE_S: f32 = 0.07;

/// Longest pause in a rest, s, with the rest of the earth step that it ends. In a longer one the
/// body may have moved.
pub(super) const LONGEST_REST_PAUSE_S: f32 = 0.1;

/// Time without motion after which the sensor is [still](RestDetector::is_still), s.
const STILL_S: f32 = 0.3;

/// Time without motion after which the average hardly contains what came before, s.
pub(super) const SETTLED_S: f32 = 0.5;

/// Time without motion at which its count returns to [`LONG_STILL_S`], s. After days an `f32` would
/// no longer count a step of 20 ms.
const LONGEST_STILL_S: f32 = 4_000.0;

/// Count to which it returns, s: longer than any comparison needs.
const LONG_STILL_S: f32 = 100.0;

/// Time without motion after which a sensor is stationary again, s. A load on a rope, a buoy or a
/// boat reads like rest for a second or more, near the largest rate of each swing.
const LATER_REST_AFTER_S: f32 = 2.0;

/// Largest error of the measured gravity, as a share of one g: 80 mg of offset and 3 % of scale
/// (product specification §6.2).
const GRAVITY_TOLERANCE: f32 = 0.12;

/// Mean readings of a stationary sensor, in body axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RestReadings {
    /// The gyroscope's reading, which is its bias.
    pub(super) rate_rad_s: Vector3,
    /// The accelerometer's reading: gravity upwards, plus its bias.
    pub(super) force_m_s2: Vector3,
}

/// Rest detector: the average readings, and the time without motion.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct RestDetector {
    average_rate_rad_s: Vector3,
    average_force_m_s2: Vector3,
    /// Variance of the rate about its average, all axes together, (rad/s)².
    rate_variance: f32,
    /// The averages when they had settled.
    first_rate_rad_s: Vector3,
    first_force_m_s2: Vector3,
    /// True once a rest has been accepted and has ended: the next one must be longer.
    is_later_rest: bool,
    /// Time without motion, s, until which the readings passed the bias gate. Zero before the
    /// first check of the drift.
    agreed_until_s: f32,
    /// Time without motion, s. During the first average it is minus the average's length so far.
    still_s: f32,
}

impl RestDetector {
    /// Creates a detector without readings. The first ones begin the first average.
    pub(super) const fn new() -> Self {
        Self {
            average_rate_rad_s: Vector3::ZERO,
            average_force_m_s2: Vector3::ZERO,
            rate_variance: 0.0,
            first_rate_rad_s: Vector3::ZERO,
            first_force_m_s2: Vector3::ZERO,
            is_later_rest: false,
            agreed_until_s: 0.0,
            still_s: -f32::MIN_POSITIVE,
        }
    }

    /// Shifts the average rates by a change of the readings without motion, rad/s.
    pub(super) fn shift_rate(&mut self, change_rad_s: Vector3) {
        self.first_rate_rad_s = self.first_rate_rad_s + change_rad_s;
        self.average_rate_rad_s = self.average_rate_rad_s + change_rad_s;
    }

    /// Adds a sample's readings, `duration_s` after the last ones, and the integral of the specific
    /// force over that time, m/s in body axes.
    ///
    /// After a pause the time without motion begins again, at 0.1 s: the averages are then those of
    /// one sample.
    pub(super) fn update(
        &mut self,
        rate_rad_s: Vector3,
        force_m_s2: Vector3,
        force_integral_m_s: Vector3,
        duration_s: f32,
        is_pause: bool,
        tuning: &Tuning,
    ) {
        let rate = rate_rad_s - self.average_rate_rad_s;
        let force = force_m_s2 - self.average_force_m_s2;
        let is_first_average = self.still_s < 0.0;
        let averaged_s = if is_first_average {
            duration_s - self.still_s
        } else if self.still_s > 0.0 && self.still_s < FORGOTTEN_S {
            FORGETTING_TIME_S
        } else {
            AVERAGING_TIME_S
        };
        let share = smaller(duration_s / averaged_s, 1.0);
        self.average_rate_rad_s = self.average_rate_rad_s + rate.scale(share);
        let squared_rate = rate.dot(rate);
        self.rate_variance += share * (squared_rate - self.rate_variance);
        let mean_force = force_integral_m_s.scale(1.0 / duration_s) - self.average_force_m_s2;
        self.average_force_m_s2 = self.average_force_m_s2 + mean_force.scale(share);
        let is_quiet = squared_rate < tuning.stationary_rate_rad_s * tuning.stationary_rate_rad_s
            && force.dot(force) + mean_force.dot(mean_force)
                < tuning.stationary_force_m_s2 * tuning.stationary_force_m_s2;
        self.still_s = if is_first_average {
            let is_complete = averaged_s >= FIRST_AVERAGE_S;
            if is_complete { averaged_s } else { -averaged_s }
        } else if is_quiet {
            let still_s = if is_pause {
                LONGEST_REST_PAUSE_S
            } else {
                self.still_s + duration_s
            };
            if still_s < LONGEST_STILL_S {
                still_s
            } else {
                LONG_STILL_S
            }
        } else {
            0.0
        };
    }

    /// Measures drift, variance and contradiction from now on. `has_rested` is true if a rest has
    /// been accepted before: the present one is then a later rest.
    pub(super) const fn set_drift_reference(&mut self, has_rested: bool) {
        self.is_later_rest |= has_rested;
        self.rate_variance = 0.0;
        self.agreed_until_s = self.still_s;
        self.first_rate_rad_s = self.average_rate_rad_s;
        self.first_force_m_s2 = self.average_force_m_s2;
    }

    /// Returns the mean rate, rad/s in body axes, bias included.
    pub(super) const fn average_rate_rad_s(&self) -> Vector3 {
        self.average_rate_rad_s
    }

    /// Returns the mean specific force, m/s² in body axes.
    pub(super) const fn average_force_m_s2(&self) -> Vector3 {
        self.average_force_m_s2
    }

    /// Returns the variance of the rate, all axes together, (rad/s)². It begins at zero when the
    /// averages settle, with a time constant of 0.5 s.
    pub(super) const fn rate_variance(&self) -> f32 {
        self.rate_variance
    }

    /// Notes that the readings pass the bias gate.
    pub(super) const fn agree(&mut self) {
        self.agreed_until_s = self.still_s;
    }

    /// Returns the time for which the readings have failed the bias gate without motion, s.
    pub(super) const fn contradicted_s(&self) -> f32 {
        self.still_s - self.agreed_until_s
    }

    /// Returns the time without motion, s.
    pub(super) const fn still_s(&self) -> f32 {
        self.still_s
    }

    /// Forgets the time without motion: the readings were no measurements, or those of a turn.
    pub(super) const fn interrupt(&mut self) {
        self.still_s = smaller(self.still_s, 0.0);
    }

    /// Returns the square of the mean rate's change in the time without motion, (rad/s)². In a
    /// swing the rate drifts.
    pub(super) fn squared_rate_drift(&self) -> f32 {
        let drift = self.average_rate_rad_s - self.first_rate_rad_s;
        drift.dot(drift)
    }

    /// Returns the square of the specific force's change in the time without motion, (m/s²)².
    /// While the sensor turns, the force drifts.
    pub(super) fn squared_force_drift(&self) -> f32 {
        let drift = self.average_force_m_s2 - self.first_force_m_s2;
        drift.dot(drift)
    }

    /// Returns whether the drift has to be measured from now on: the averages still contain motion,
    /// or this is the first check. At some rates, such as 50 and 100 Hz, that one is later.
    pub(super) fn needs_drift_reference(&self) -> bool {
        // Zero as an integer, because that comparison is shorter.
        self.still_s < SETTLED_S || self.agreed_until_s.to_bits() == 0
    }

    /// Returns whether the readings have not changed for 0.3 s.
    pub(super) fn is_still(&self) -> bool {
        self.still_s > STILL_S
    }

    /// Returns the mean readings, if the sensor is stationary.
    pub(super) fn stationary_readings(&self, tuning: &Tuning) -> Option<RestReadings> {
        const LEAST: f32 = (1.0 - GRAVITY_TOLERANCE) * STANDARD_GRAVITY_M_S2;
        const GREATEST: f32 = (1.0 + GRAVITY_TOLERANCE) * STANDARD_GRAVITY_M_S2;
        let force_m_s2 = self.average_force_m_s2;
        let squared = force_m_s2.dot(force_m_s2);
        let is_gravity = squared > LEAST * LEAST && squared < GREATEST * GREATEST;
        // A faster steady reading is a turn, because it exceeds any bias.
        let is_bias = self
            .average_rate_rad_s
            .is_within(LARGEST_GYROSCOPE_BIAS_RAD_S);
        let least_s = if self.is_later_rest {
            LATER_REST_AFTER_S
        } else {
            tuning.stationary_after_s
        };
        let is_stationary = self.still_s > least_s && is_gravity && is_bias;
        is_stationary.then_some(RestReadings {
            rate_rad_s: self.average_rate_rad_s,
            force_m_s2,
        })
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            average_rate_rad_s,
            average_force_m_s2,
            rate_variance,
            first_rate_rad_s,
            first_force_m_s2,
            is_later_rest,
            agreed_until_s,
            still_s,
        } = self;
        visitor.vector(average_rate_rad_s);
        visitor.vector(average_force_m_s2);
        visitor.f32(rate_variance);
        visitor.vector(first_rate_rad_s);
        visitor.vector(first_force_m_s2);
        visitor.bool(is_later_rest);
        visitor.f32(agreed_until_s);
        visitor.f32(still_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mast rests for a week. An offset that changes then is found only if the time goes on: its
    /// count must never be so large that a step is lost.
    #[test]
    fn the_time_without_motion_goes_on_for_days() {
        const STEP_S: f32 = 0.02;
        const STEPS: u32 = 9_000 * 50;
        let force = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
        let mut detector = RestDetector::new();
        for step in 0..STEPS {
            let before_s = detector.still_s();
            let (rate, velocity) = (Vector3::ZERO, force.scale(STEP_S));
            detector.update(rate, force, velocity, STEP_S, false, &Tuning::DEFAULT);
            assert_ne!(detector.still_s(), before_s, "step {step}");
            assert!(detector.still_s() < LONGEST_STILL_S);
            assert!(step < 100 || detector.stationary_readings(&Tuning::DEFAULT).is_some());
        }
    }
}
