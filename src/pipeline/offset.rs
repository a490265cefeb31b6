//! Stored gyroscope offset at a temperature, and its σ.

use crate::attitude::Vector3;
use crate::calibration::Calibration;
use crate::estimator::arithmetic::{larger, square};
use crate::units::radians;

/// σ of a stored offset at the temperature of its measurement, rad/s: the offset changes with the
/// pose (0.1 °/s per g, product specification §6.1).
pub(super) const STORED_SIGMA_RAD_S: f32 = radians(0.1);
/// Least σ of a stored offset at a start, rad/s: it changes with each power-up and with age. The
/// product specification has no figure for that. So a change of 2 °/s is within six σ.
const LEAST_START_SIGMA_RAD_S: f32 = radians(0.35);
/// σ that each °C of difference adds, rad/s: ±20 °/s over −40 to 85 °C (product
/// specification §6.1) is 0.16 at most.
pub(super) const SIGMA_PER_CELSIUS_RAD_S: f32 = radians(0.1);
/// σ of an unknown offset, rad/s. From this value on the filter's own prior is better.
const UNKNOWN_SIGMA_RAD_S: f32 = radians(3.0);
/// σ of the temperature model within its range, rad/s.
const MODEL_SIGMA_RAD_S: f32 = radians(0.15);

/// Gyroscope offset in sensor axes, with its σ per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StoredOffset {
    pub(super) offset_rad_s: Vector3,
    pub(super) sigma_rad_s: f32,
}

impl StoredOffset {
    /// Returns the offset of a calibration at this die temperature, in °C.
    pub(super) fn at(calibration: &Calibration, celsius: f32) -> Self {
        let stored = Self::measured(calibration, celsius);
        let Some(model) = calibration.temperature else {
            return stored;
        };
        let (offset, weight) = model.offset_at(celsius);
        let remainder = 1.0 - weight;
        Self {
            offset_rad_s: offset.scale(weight) + stored.offset_rad_s.scale(remainder),
            sigma_rad_s: MODEL_SIGMA_RAD_S * weight + stored.sigma_rad_s * remainder,
        }
    }

    /// Returns the offset without the temperature model.
    fn measured(calibration: &Calibration, celsius: f32) -> Self {
        let Some(measured) = calibration.gyroscope else {
            return Self {
                offset_rad_s: Vector3::ZERO,
                sigma_rad_s: UNKNOWN_SIGMA_RAD_S,
            };
        };
        let drift = SIGMA_PER_CELSIUS_RAD_S * (celsius - measured.temperature_celsius);
        let variance = square(STORED_SIGMA_RAD_S) + square(drift);
        Self {
            offset_rad_s: measured.offset_rad_s,
            sigma_rad_s: libm::sqrtf(variance).min(UNKNOWN_SIGMA_RAD_S),
        }
    }

    /// Returns σ per axis at a start, rad/s: the offset may have changed since its measurement.
    pub(super) fn start_sigma_rad_s(&self) -> f32 {
        larger(self.sigma_rad_s, LEAST_START_SIGMA_RAD_S)
    }

    /// Returns whether the offset is better than the filter's own prior.
    pub(super) fn is_known(&self) -> bool {
        self.sigma_rad_s < UNKNOWN_SIGMA_RAD_S
    }
}
