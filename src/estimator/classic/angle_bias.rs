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
//! This file holds the covariance and the bias. The angle belongs to the filter that uses it: one
//! adds corrections to a number, another turns a quaternion by them. The gains do not depend on the
//! unit of the angle. Therefore the covariance is in degrees, the unit of the classic constants.

/// Process noise of the angle, in deg²/s: the classic value. Larger: relies less on the rate,
/// follows the measured angle faster and with more of its noise.
pub const Q_ANGLE: f32 = 0.001;
/// Process noise of the bias, in (deg/s)²/s: the classic value. Larger: the bias follows faster,
/// and accelerations disturb it more.
pub const Q_BIAS: f32 = 0.003;
/// Variance of one measured angle, in deg²: the classic value. Larger: smoother, slower.
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
    /// Creates the classic start: angle and bias known exactly.
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

    /// Corrects the bias by an innovation. Returns the correction of the angle.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference filter as in the textbook: whole matrices, double precision.
    struct Textbook {
        x: [f64; 2],
        p: [[f64; 2]; 2],
    }

    fn product(a: [[f64; 2]; 2], b: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
        let entry = |i: usize, j: usize| a[i][0] * b[0][j] + a[i][1] * b[1][j];
        [[entry(0, 0), entry(0, 1)], [entry(1, 0), entry(1, 1)]]
    }

    impl Textbook {
        fn step(&mut self, rate: f64, measured: f64, r: f64, dt: f64) {
            let f = [[1.0, -dt], [0.0, 1.0]];
            let f_transposed = [[1.0, 0.0], [-dt, 1.0]];
            self.x = [self.x[0] + (rate - self.x[1]) * dt, self.x[1]];
            self.p = product(product(f, self.p), f_transposed);
            self.p[0][0] += 0.001 * dt;
            self.p[1][1] += 0.003 * dt;
            let s = self.p[0][0] + r;
            let k = [self.p[0][0] / s, self.p[1][0] / s];
            let innovation = measured - self.x[0];
            self.x = [self.x[0] + k[0] * innovation, self.x[1] + k[1] * innovation];
            self.p = product([[1.0 - k[0], 0.0], [-k[1], 1.0]], self.p);
        }
    }

    #[test]
    fn the_filter_agrees_with_the_textbook() {
        for dt in [0.001, 0.01, 0.1] {
            let mut textbook = Textbook {
                x: [5.0, 0.0],
                p: [[0.0; 2]; 2],
            };
            let mut filter = AngleBias::new();
            let mut angle = 5.0_f32;
            for step in 0..3000 {
                let time = f64::from(step) * dt;
                let rate = 1.5 + 10.0 * (2.0 * time).cos();
                let measured = 5.0 * (2.0 * time).sin() + 0.3 * (700.0 * time).sin();
                let r = if step % 7 == 0 { 0.3 } else { 0.03 };
                textbook.step(rate, measured, r, dt);
                filter.predict(dt as f32);
                angle += (rate as f32 - filter.bias) * dt as f32;
                angle += filter.correct(measured as f32 - angle, r as f32);
                assert!((f64::from(angle) - textbook.x[0]).abs() < 1e-3, "{step}");
                assert!((f64::from(filter.bias) - textbook.x[1]).abs() < 1e-2);
                let variance = f64::from(filter.variance_angle);
                assert!((variance / textbook.p[0][0] - 1.0).abs() < 1e-3, "{step}");
            }
            // The filter has found the bias of 1.5.
            assert!((filter.bias - 1.5).abs() < 0.5, "{dt}: {}", filter.bias);
        }
    }

    #[test]
    fn the_covariance_stays_positive_definite() {
        let mut filter = AngleBias::new();
        let steps = [1e-6, 0.5, 0.001, 0.3, 0.01];
        for (step, dt_s) in steps.into_iter().cycle().take(100_000).enumerate() {
            filter.predict(dt_s);
            if step % 3 > 0 {
                filter.correct(1.0, if step % 2 > 0 { 300.0 } else { 0.03 });
            }
            let determinant = f64::from(filter.variance_angle) * f64::from(filter.variance_bias)
                - f64::from(filter.covariance) * f64::from(filter.covariance);
            assert!(filter.variance_angle >= 0.0 && filter.variance_bias >= 0.0);
            assert!(determinant >= -1e-4, "{step}: {filter:?}");
            assert!(filter.bias.is_finite());
        }
    }
}
