//! The two-state Kalman filter of one angle: the angle, and the bias of the rate that moves it.
//!
//! State x = (angle, bias), input u = measured rate, measurement z = angle:
//!
//! ```text
//! angle' = angle + (u − bias)·dt      F = [1 −dt; 0 1]
//! bias'  = bias                       Q = [Q_angle 0; 0 Q_bias]·dt
//! z      = angle + noise              H = [1 0],  R = R_measure
//! ```
//!
//! This file holds the covariance and the bias. The angle belongs to the filter that uses it, since
//! one adds corrections to a number and another turns a quaternion by them. The gains do not depend
//! on the unit of the angle, so the covariance is in degrees, where the classic constants live,
//! whatever the angle's unit.

/// Variance that the angle gains, in deg²/s. Larger: trusts the rate less, follows the measured
/// angle faster and with more of its noise. The classic value.
pub const Q_ANGLE: f32 = 0.001;
/// Variance that the bias gains, in (deg/s)²/s. Larger: the bias follows faster, and takes every
/// acceleration for one. The classic value.
pub const Q_BIAS: f32 = 0.003;
/// Variance of one measured angle, in deg². Larger: smoother, slower. The classic value.
pub const R_MEASURE: f32 = 0.03;

/// The covariance and the bias of one angle.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AngleBias {
    /// The bias of the rate, in the angle's unit per second.
    pub bias: f32,
    variance_angle: f32,
    covariance: f32,
    variance_bias: f32,
}

impl Default for AngleBias {
    fn default() -> Self {
        Self::new()
    }
}

impl AngleBias {
    /// Angle and bias known exactly, as the classic filter starts.
    pub const fn new() -> Self {
        Self {
            bias: 0.0,
            variance_angle: 0.0,
            covariance: 0.0,
            variance_bias: 0.0,
        }
    }

    /// P ← F·P·Fᵀ + Q over `dt_s` seconds.
    #[inline]
    pub fn predict(&mut self, dt_s: f32) {
        let crossed = self.covariance - dt_s * self.variance_bias;
        self.variance_angle += dt_s * (Q_ANGLE - self.covariance - crossed);
        self.covariance = crossed;
        self.variance_bias += dt_s * Q_BIAS;
    }

    /// Moves the bias by an innovation and returns by how much the angle moves.
    ///
    /// `innovation` is measured minus predicted angle; `variance_measured` is R, in deg².
    #[inline]
    pub fn correct(&mut self, innovation: f32, variance_measured: f32) -> f32 {
        // S = H·P·Hᵀ + R and K = P·Hᵀ/S.
        let inverse = 1.0 / (self.variance_angle + variance_measured);
        let gain_angle = self.variance_angle * inverse;
        let gain_bias = self.covariance * inverse;
        // P ← (I − K·H)·P, in the form that rounding cannot make negative: 1 − K₀ = R/S.
        let kept = variance_measured * inverse;
        self.variance_bias = (self.variance_bias - gain_bias * self.covariance).max(0.0);
        self.variance_angle *= kept;
        self.covariance *= kept;
        // x ← x + K·y
        self.bias += gain_bias * innovation;
        gain_angle * innovation
    }
}
