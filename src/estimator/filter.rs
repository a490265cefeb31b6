//! Trait of all filters, so that one [`Estimator`](super::Estimator) serves them all.

use super::sample::Sample;
use crate::attitude::{Quaternion, Vector3};

/// Filter behind the estimator's gate. The gate passes finite samples only, and steps between 1 µs
/// and 0.5 s.
pub trait Filter {
    /// Resets everything but the settings and the quaternion's sign.
    fn restart(&mut self);

    /// Starts from the first sample, or the first after a gap. Takes the tilt from the specific
    /// force if it shows gravity, and keeps yaw.
    fn start(&mut self, sample: &Sample, shows_gravity: bool);

    /// Advances by one sample, `dt_s` seconds after the previous one.
    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool);

    /// Attitude at the last sample's time, body to earth.
    fn attitude(&self) -> Quaternion;

    /// Body rates p, q, r at the last sample, in rad/s.
    fn body_rates_rad_s(&self) -> Vector3;

    /// Variance of the direction of down, both axes together, in rad². Infinite if unknown.
    fn tilt_variance_rad2(&self) -> f32 {
        f32::INFINITY
    }

    /// Returns whether the gyroscope's bias is known. Always true for filters that do not estimate
    /// it.
    fn is_bias_known(&self) -> bool {
        true
    }
}
