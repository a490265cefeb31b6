//! Drift of the gyroscope's offset while the die warms or cools.
//!
//! The offset follows the die's temperature, by up to 0.16 °/s per °C. A filter that takes it for
//! constant turns the drift into tilt. So the offset's random walk grows with the difference of the
//! temperature from its average: over the averaging time, σ of the walk is that of the change.

use super::offset::SIGMA_PER_CELSIUS_RAD_S;
use crate::estimator::arithmetic::{larger, smaller, square};
use crate::serialize::StateVisitor;

/// Averaging time of the temperature, s: shorter than a chip's warm-up of a minute and more, so
/// that the walk ends with it, and long enough for a register with noise.
const AVERAGE_S: f32 = 30.0;
/// Share of the drift that a temperature model leaves, because it was measured once, at rest.
const MODEL_ERROR_SHARE: f32 = 0.33;
/// Largest difference that counts, °C: that of 20 °C in a minute. So a reading that is far off
/// hardly widens the bias.
const MOST_CELSIUS: f32 = 10.0;
/// Fastest change of a die's temperature, °C/s: 25 °C, from a room into frost, in 50 s.
const FASTEST_CELSIUS_S: f32 = 0.5;
/// Least distance of the register from what that pace allows at which it is wrong, °C.
const WRONG_CELSIUS: f32 = 2.0;
/// No temperature yet.
const NONE_CELSIUS: f32 = -273.0;

/// Average of the die's temperature, and whether a model's offset follows it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct ThermalDrift {
    average_celsius: f32,
    /// Temperature that follows the register no faster than a die's.
    slow_celsius: f32,
    /// True if a temperature model removes most of the drift: it has this temperature in its
    /// range, and the register is credible.
    follows_model: bool,
}

impl ThermalDrift {
    pub(super) const NONE: Self = Self {
        average_celsius: NONE_CELSIUS,
        slow_celsius: NONE_CELSIUS,
        // A start applies the model's offset.
        follows_model: true,
    };

    /// Returns whether the offset follows the temperature model.
    pub(super) const fn follows_model(&self) -> bool {
        self.follows_model
    }

    /// Leaves the model until its offset is applied anew.
    pub(super) const fn leave_model(&mut self) {
        self.follows_model = false;
    }

    /// Takes the temperature `dt_s` after the last one, and whether it is in the range of a model.
    /// Decides whether the offset follows the model. Returns the variance that the offset's random
    /// walk gains, rad²/s² per second.
    pub(super) fn update(&mut self, celsius: f32, dt_s: f32, is_in_range: bool) -> f32 {
        if self.average_celsius == NONE_CELSIUS {
            (self.average_celsius, self.slow_celsius) = (celsius, celsius);
        }
        let most = FASTEST_CELSIUS_S * dt_s;
        let change = celsius - self.slow_celsius;
        self.slow_celsius += within(change, most);
        self.follows_model = is_in_range && change.abs() < WRONG_CELSIUS + most;
        let difference = within(celsius - self.average_celsius, MOST_CELSIUS);
        self.average_celsius += difference * smaller(dt_s / AVERAGE_S, 1.0);
        let share = if self.follows_model {
            MODEL_ERROR_SHARE
        } else {
            1.0
        };
        square(share * SIGMA_PER_CELSIUS_RAD_S * difference) / AVERAGE_S
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.f32(&mut self.average_celsius);
        visitor.f32(&mut self.slow_celsius);
        visitor.bool(&mut self.follows_model);
    }
}

/// Returns the number, or its limit if it is beyond.
fn within(number: f32, limit: f32) -> f32 {
    larger(smaller(number, limit), -limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::radians;

    /// Time between two temperatures, s.
    const STEP_S: f32 = 0.064;

    /// Returns σ of what a walk adds in a minute of a temperature that changes by this much, after
    /// a minute of the same, rad/s.
    fn sigma_of_a_minute(celsius_per_minute: f32) -> f32 {
        let mut drift = ThermalDrift::NONE;
        let steps = (60.0 / STEP_S) as u16;
        let mut variance = 0.0;
        for step in 0..2 * steps {
            let minutes = f32::from(step) / f32::from(steps);
            let walk = drift.update(20.0 + celsius_per_minute * minutes, STEP_S, false);
            if step >= steps {
                variance += walk * STEP_S;
            }
        }
        libm::sqrtf(variance)
    }

    #[test]
    fn the_walk_of_a_minute_covers_most_of_the_drift_of_a_minute() {
        // The walk of each averaging time is that of its change; two of them are a minute.
        assert_eq!(sigma_of_a_minute(0.0), 0.0);
        for celsius in [1.0, 6.0, -6.0_f32] {
            let share = sigma_of_a_minute(celsius) / (celsius.abs() * SIGMA_PER_CELSIUS_RAD_S);
            assert!((0.6..0.72).contains(&share), "{celsius}: {share}");
        }
    }

    #[test]
    fn the_first_temperature_is_no_change_and_a_wrong_one_adds_little() {
        let mut drift = ThermalDrift::NONE;
        assert_eq!(drift.update(-30.0, STEP_S, false), 0.0);
        assert_eq!(drift.update(-30.0, STEP_S, false), 0.0);
        // A register that is 100 °C off for a third of a second.
        let mut variance = 0.0;
        for step in 0..1_000 {
            let celsius = if step < 5 { 70.0 } else { -30.0 };
            variance += drift.update(celsius, STEP_S, false) * STEP_S;
        }
        let sigma_rad_s = libm::sqrtf(variance);
        assert!(sigma_rad_s < radians(0.15), "{sigma_rad_s}");
    }

    #[test]
    fn slow_bursts_follow_the_temperature_at_once() {
        // Bursts of 1 Hz: 64 of them take longer than the average.
        let mut drift = ThermalDrift::NONE;
        drift.update(20.0, 64.0, false);
        assert!(drift.update(30.0, 64.0, false) > 0.0);
        assert_eq!(drift.update(30.0, 64.0, false), 0.0);
    }

    #[test]
    fn the_model_is_followed_at_the_pace_of_a_die() {
        // A jump of the register, and the time until the model is followed again, s.
        for (jump_celsius, expected_s) in [(1.9, 0.0), (-20.0, 36.0), (20.0, 36.0)] {
            let mut drift = ThermalDrift::NONE;
            drift.update(30.0, STEP_S, true);
            assert!(drift.follows_model());
            let mut steps: u16 = 0;
            drift.update(30.0 + jump_celsius, STEP_S, true);
            while !drift.follows_model() {
                drift.update(30.0 + jump_celsius, STEP_S, true);
                steps += 1;
            }
            let followed_s = f32::from(steps) * STEP_S;
            assert!((followed_s - expected_s).abs() < 0.2, "{followed_s}");
        }
        // 0.45 °C/s is that of a die.
        let mut drift = ThermalDrift::NONE;
        for step in 0..1_000_u16 {
            drift.update(0.45 * STEP_S * f32::from(step), STEP_S, true);
            assert!(drift.follows_model());
        }
    }
}
