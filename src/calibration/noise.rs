//! Noise of the sensor: what the datasheet promises, and what the sensor shows while stationary.

use crate::attitude::Vector3;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Number of independent samples in a window: its variance is then known within a quarter.
pub(super) const WINDOW_INDEPENDENT: f32 = 32.0;
/// Margin of the measured noise, in standard deviations of its own error: one estimate in 4000 lies
/// beyond it, on one side.
pub(super) const MEASURED_NOISE_SIGMA: f32 = 3.5;
/// Degrees of freedom that the measured noise remembers: eight windows.
const MEASURED_FREEDOM: f32 = 8.0 * WINDOW_INDEPENDENT;
/// Largest noise of a poor clone, as a multiple of the datasheet's σ.
pub(super) const NOISE_TOLERANCE: f32 = 4.0;

/// Gyroscope noise density, °/s/√Hz (product specification §6.1).
const GYROSCOPE_NOISE_DEGREES_S: f32 = 0.005;
/// Accelerometer noise density, g/√Hz (product specification §6.2).
const ACCELEROMETER_NOISE_G: f32 = 400.0e-6;
/// Variance of rounding to whole counts, counts².
pub(super) const ROUNDING_VARIANCE: f32 = 1.0 / 12.0;

/// Scales, filters and sample rate of a configured sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorSetup {
    /// Gyroscope sensitivity, counts per °/s.
    pub gyroscope_counts_per_degree_s: f32,
    /// Accelerometer sensitivity, counts per g.
    pub accelerometer_counts_per_g: f32,
    /// Bandwidth of the gyroscope's low-pass filter, Hz.
    pub gyroscope_bandwidth_hz: f32,
    /// Bandwidth of the accelerometer's low-pass filter, Hz.
    pub accelerometer_bandwidth_hz: f32,
    /// Sample rate, Hz.
    pub sample_rate_hz: f32,
}

/// Scale and expected noise of both sensors, in counts.
///
/// ```
/// use aplomb::calibration::{NoiseModel, SensorSetup};
///
/// let noise = NoiseModel::new(&SensorSetup {
///     gyroscope_counts_per_degree_s: 16.4,
///     accelerometer_counts_per_g: 2048.0,
///     gyroscope_bandwidth_hz: 188.0,
///     accelerometer_bandwidth_hz: 184.0,
///     sample_rate_hz: 1000.0,
/// });
/// // 0.005 °/s/√Hz over 188 Hz, and rounding.
/// assert!((noise.gyroscope_sigma_counts - 1.16).abs() < 0.01);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoiseModel {
    /// Gyroscope sensitivity, counts per °/s.
    pub counts_per_degree_s: f32,
    /// Accelerometer sensitivity, counts per g.
    pub counts_per_g: f32,
    /// σ of one gyroscope sample by the datasheet, counts.
    pub gyroscope_sigma_counts: f32,
    /// σ of one accelerometer sample by the datasheet, counts.
    pub accelerometer_sigma_counts: f32,
    /// Number of successive gyroscope samples per independent one; at least 1.
    pub gyroscope_correlation: f32,
    /// Number of successive accelerometer samples per independent one; at least 1.
    pub accelerometer_correlation: f32,
}

impl NoiseModel {
    /// Scale and noise at ±2000 °/s and ±16 g.
    #[cfg(test)]
    pub(super) const FOR_TESTS: Self = Self {
        counts_per_degree_s: 16.4,
        counts_per_g: 2048.0,
        gyroscope_sigma_counts: 1.2,
        accelerometer_sigma_counts: 11.0,
        gyroscope_correlation: 2.7,
        accelerometer_correlation: 2.7,
    };

    /// Derives the noise of a sensor from the datasheet's noise densities.
    ///
    /// A density times the square root of the bandwidth B is the σ of one sample. At the sample
    /// rate f, f/2B successive samples are worth one independent sample.
    pub fn new(setup: &SensorSetup) -> Self {
        let sigma = |density_counts: f32, bandwidth_hz: f32| {
            libm::sqrtf(density_counts * density_counts * bandwidth_hz + ROUNDING_VARIANCE)
        };
        let correlation = |bandwidth_hz: f32| (0.5 * setup.sample_rate_hz / bandwidth_hz).max(1.0);
        Self {
            counts_per_degree_s: setup.gyroscope_counts_per_degree_s,
            counts_per_g: setup.accelerometer_counts_per_g,
            gyroscope_sigma_counts: sigma(
                GYROSCOPE_NOISE_DEGREES_S * setup.gyroscope_counts_per_degree_s,
                setup.gyroscope_bandwidth_hz,
            ),
            accelerometer_sigma_counts: sigma(
                ACCELEROMETER_NOISE_G * setup.accelerometer_counts_per_g,
                setup.accelerometer_bandwidth_hz,
            ),
            gyroscope_correlation: correlation(setup.gyroscope_bandwidth_hz),
            accelerometer_correlation: correlation(setup.accelerometer_bandwidth_hz),
        }
    }

    /// Converts gyroscope counts to rad/s.
    pub fn gyroscope_rad_s(&self, counts: Vector3) -> Vector3 {
        counts.scale(radians(1.0) / self.counts_per_degree_s)
    }

    /// Converts accelerometer counts to m/s².
    pub fn accelerometer_m_s2(&self, counts: Vector3) -> Vector3 {
        counts.scale(STANDARD_GRAVITY_M_S2 / self.counts_per_g)
    }
}

/// Noise variance of one axis as its stationary windows show it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct MeasuredNoise {
    variance: f32,
    freedom: f32,
}

impl MeasuredNoise {
    /// No window was measured.
    pub(super) const NONE: Self = Self {
        variance: f32::MAX,
        freedom: 0.0,
    };

    /// Returns the upper limit of the variance, counts².
    pub(super) fn upper_limit(&self) -> f32 {
        if self.freedom <= 0.0 {
            return f32::MAX;
        }
        self.variance / chi_squared_per_freedom(self.freedom, -MEASURED_NOISE_SIGMA).max(0.01)
    }

    /// Adds the variance of a window, with its degrees of freedom.
    ///
    /// A window below `lower_share` of the variance so far is too quiet for the same noise: the
    /// earlier windows held motion too, and are forgotten.
    pub(super) fn update(&mut self, variance: f32, freedom: f32, lower_share: f32) {
        if self.freedom <= 0.0 || variance < lower_share * self.variance {
            *self = Self { variance, freedom };
            return;
        }
        let share = freedom / (self.freedom + freedom);
        self.variance += share * (variance - self.variance);
        self.freedom = (self.freedom + freedom).min(MEASURED_FREEDOM);
    }
}

/// Returns the χ² quantile at this many standard deviations, divided by its degrees of freedom
/// (Wilson and Hilferty, 1931).
pub(super) fn chi_squared_per_freedom(freedom: f32, sigma: f32) -> f32 {
    let variance = 2.0 / (9.0 * freedom);
    let root = (1.0 - variance + sigma * libm::sqrtf(variance)).max(0.0);
    root * root * root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_approximation_of_the_quantiles_is_good() {
        // From tables: χ² with 30 degrees of freedom exceeds 59.70 in 0.1 % of the cases
        // (z = 3.0902) and 11.59 in 99.9 %.
        assert!((30.0 * chi_squared_per_freedom(30.0, 3.0902) - 59.70).abs() < 0.2);
        assert!((30.0 * chi_squared_per_freedom(30.0, -3.0902) - 11.59).abs() < 0.2);
    }
}
