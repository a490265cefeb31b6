//! Information before the first sample: priors of the parameters, and the state of an earlier run.

use super::propagation::PARAMETERS;
use super::tuning::{Tuning, square};
use crate::attitude::{Quaternion, Vector3};
use crate::serialize::StateVisitor;

/// State of an earlier run, from which the filter continues.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WarmStart {
    /// Body to earth.
    pub attitude: Quaternion,
    /// σ of the tilt, both axes together, rad.
    pub tilt_sigma_rad: f32,
    /// The gyroscope's bias in body axes, rad/s.
    pub bias_rad_s: Vector3,
    /// σ of the bias per axis, rad/s.
    pub bias_sigma_rad_s: f32,
}

/// Prior of the gyroscope's bias.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct BiasPrior {
    /// Mean, rad/s in body axes.
    pub(super) mean_rad_s: Vector3,
    /// Variance per axis, (rad/s)².
    pub(super) variance: [f32; 3],
}

impl BiasPrior {
    pub(super) const fn new(mean_rad_s: Vector3, sigma_rad_s: f32) -> Self {
        Self {
            mean_rad_s,
            variance: [square(sigma_rad_s); 3],
        }
    }

    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.vector(&mut self.mean_rad_s);
        visitor.f32s(&mut self.variance);
    }
}

/// Returns the variances of all parameters before the first sample, from the bias prior and the
/// tuning.
pub(super) fn parameter_variances(tuning: &Tuning, bias: &[f32; 3]) -> [f32; PARAMETERS] {
    let [x, y, z] = *bias;
    let scale = square(tuning.gyroscope_scale);
    let skew = square(tuning.gyroscope_misalignment_rad);
    let accelerometer = square(tuning.accelerometer_bias_m_s2);
    [
        x,
        y,
        z, // gyroscope bias
        scale,
        skew,
        skew, // gyroscope matrix, by rows
        skew,
        scale,
        skew, //
        skew,
        skew,
        scale, //
        accelerometer,
        accelerometer,
        accelerometer,
    ]
}
