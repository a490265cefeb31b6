//! Tuning of the filter: one set of numbers for every sensor and every motion.
//!
//! All are standard deviations (σ) or noise densities in physical units. A density per √Hz is
//! the σ of the mean over one second.
//!
//! Sources. Start values and random walks are those of a consumer part, mounted and shaken. They
//! exceed a datasheet's noise at rest. The other numbers were chosen on three sets together, by a
//! search and then by hand, each rounded to one or two digits. The sets are 14 trials of BROAD
//! (Laidig and others, *Data* 6(7), 2021) and 3 rooms of TUM-VI (Schubert and others, IROS 2018).
//! The third set has 12 simulated quadrotor flights with a gyroscope bias of 4 °/s, each with two
//! sensors. The scores of 36 more flights were visible. Sensitivity:
//!
//! - Each noise, each number of the velocity, the bias's prior and the memory were halved and
//!   doubled. The mean error of each set changes by less than a tenth, with two exceptions. Half of
//!   `velocity_noise_per_velocity` adds 48 % on TUM-VI. Half of `velocity_noise_limit` more than
//!   doubles the error of calibrated sensors in flight.
//! - On 24 flights that were simulated after the choice and scored once, with calibrated sensors,
//!   the error is 0.49° (median) and 0.52° (mean). On the twelve flights of the choice it is
//!   0.57° and 0.83°.
//!
//! The priors of scale, misalignment and accelerometer bias are not part of the tuning. They follow
//! from [`GyroscopeKnowledge`](super::GyroscopeKnowledge) and
//! [`AccelerometerKnowledge`](super::AccelerometerKnowledge).

use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Largest zero-rate offset of a gyroscope: 20 °/s, and 20 more over temperature (product
/// specification §6.1).
pub(super) const LARGEST_GYROSCOPE_BIAS_RAD_S: f32 = radians(40.0);
/// Largest offset of an accelerometer: 80 mg, and 60 more over temperature (product specification
/// §6.2).
pub(super) const LARGEST_ACCELEROMETER_BIAS_M_S2: f32 = 0.14 * STANDARD_GRAVITY_M_S2;
/// Largest norm of C − I, with a margin: the gyroscope's scale is within 3 %, its cross-axis
/// terms within 2 % (product specification §6.1).
pub(super) const LARGEST_MATRIX_ERROR: f32 = 0.1;

/// The filter's tuning.
///
/// Every number is positive and finite: the filter divides by some of them, and checks none.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tuning {
    /// σ of the tilt from the mean specific force at a start, per axis, rad. Larger: recovers
    /// sooner from a start in motion. Smaller: exact sooner after a start at rest.
    pub start_tilt_rad: f32,
    /// σ of the gyroscope bias at start, per axis, rad/s. Larger: finds a large bias sooner.
    /// Smaller: a start in motion with a small bias is calmer. The filter widens it when the data
    /// contradict it.
    pub gyroscope_bias_rad_s: f32,
    /// σ of the horizontal velocity at start, per axis, m/s.
    pub start_velocity_m_s: f32,
    /// Gyroscope noise, rad/s/√Hz. Larger: gravity corrects the attitude sooner, and so do
    /// accelerations.
    pub rate_noise: f32,
    /// Gyroscope noise per rate, 1/√Hz, beyond scale and misalignment.
    pub rate_noise_per_rate: f32,
    /// Random walk of the gyroscope bias, rad/s/√s. Larger: follows temperature sooner.
    pub gyroscope_bias_walk: f32,
    /// Time constant with which scale, misalignment and accelerometer bias return to their priors,
    /// s. Larger: keeps more of what motion has shown. Smaller: drifts less in hours of flight,
    /// where the velocity model turns accelerations into scale and bias.
    pub parameter_memory_s: f32,
    /// Accelerometer noise, m/s²/√Hz.
    pub force_noise: f32,
    /// Accelerometer noise per recent velocity, m/s²/√Hz per m/s: a moving vehicle shakes.
    pub force_noise_per_velocity: f32,
    /// Noise of the measurement "velocity is zero" for a vehicle that stays in place, m/s·√s.
    /// Larger: short accelerations tilt less, and true tilt errors last longer.
    pub velocity_noise: f32,
    /// Addition to `velocity_noise` per recent velocity, √s: a moving vehicle may move.
    pub velocity_noise_per_velocity: f32,
    /// Upper limit of the velocity noise, m/s·√s.
    pub velocity_noise_limit: f32,
    /// Averaging time of the recent velocity, s.
    pub velocity_average_s: f32,
    /// Time constant of the velocity's low-pass filter before it is averaged, s.
    pub velocity_smoothing_s: f32,
    /// Extra tilt noise while tilt and bias are both uncertain, rad/√Hz per rad/s per rad. It
    /// stands for the product of both errors, which the linear model leaves out.
    pub coupling: f32,
    /// Deviation of a bias from its prior, in σ, at which the prior's variance is doubled.
    pub prior_gate_sigma: f32,
    /// Time without motion after which the sensor is stationary, s, until a first rest has ended.
    /// Later rests: `LATER_REST_AFTER_S` in `rest_detector.rs`. When the first one is certain:
    /// `is_rest_certain` in `measurements.rs`.
    pub stationary_after_s: f32,
    /// Largest change of the rate of a stationary sensor, rad/s.
    pub stationary_rate_rad_s: f32,
    /// Largest change of the specific force of a stationary sensor, m/s².
    pub stationary_force_m_s2: f32,
    /// Noise of the zero-velocity update of a stationary sensor, m/s·√s.
    pub stationary_velocity_noise: f32,
    /// Noise of the zero-rate update of a stationary sensor, rad/s/√Hz.
    pub stationary_rate_noise: f32,
    /// Time between two covariance steps, s. The accuracy does not depend on it from 0.01 to 0.25
    /// s.
    pub covariance_period_s: f32,
    /// Time between two earth steps, s. Larger: cheaper. The accuracy does not depend on it from
    /// 0.007 to 0.02 s.
    pub earth_period_s: f32,
}

impl Tuning {
    /// The default tuning.
    pub const DEFAULT: Self = Self {
        start_tilt_rad: 0.2,
        gyroscope_bias_rad_s: 0.05,
        start_velocity_m_s: 0.1,
        rate_noise: 1.5e-3,
        rate_noise_per_rate: 1.0e-3,
        gyroscope_bias_walk: 1.5e-4,
        parameter_memory_s: 1_000.0,
        force_noise: 0.05,
        force_noise_per_velocity: 0.07,
        velocity_noise: 0.2,
        velocity_noise_per_velocity: 2.5,
        velocity_noise_limit: 5.0,
        velocity_average_s: 5.0,
        velocity_smoothing_s: 0.3,
        coupling: 1.0,
        prior_gate_sigma: 1.6,
        stationary_after_s: 0.8,
        stationary_rate_rad_s: radians(2.0),
        stationary_force_m_s2: 0.5,
        stationary_velocity_noise: 0.02,
        stationary_rate_noise: 0.8e-3,
        covariance_period_s: 0.22,
        earth_period_s: 19.9e-3,
    };
}

impl Default for Tuning {
    fn default() -> Self {
        Self::DEFAULT
    }
}
