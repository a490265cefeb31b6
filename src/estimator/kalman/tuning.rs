//! What the filter is told about the world: one set of numbers for every sensor and every motion.
//!
//! All are standard deviations (σ) or noise densities in physical units. A density per √Hz is the σ
//! of the mean over one second.
//!
//! Where they come from. Start values and walks are those of a consumer part as it is mounted and
//! shaken, larger than a datasheet's noise at rest. The others were chosen on three sets together,
//! by a search and then by hand, each rounded to one or two digits: 14 trials of BROAD (Laidig and
//! others, *Data* 6(7), 2021), 3 rooms of TUM-VI (Schubert and others, IROS 2018) and 12 simulated
//! quadrotor flights with a gyroscope bias of 4 °/s, each with two sensors; the scores of 12 more
//! flights were in view. What that is worth:
//!
//! - Half or twice the value of one of the noises, of what concerns velocity, or of the priors of
//!   scale, misalignment and accelerometer bias changes the mean error of each set by less than a
//!   tenth, but for four: half of `velocity_per_velocity` (half as much again on TUM-VI), and in
//!   flight half of `velocity_limit` (15 % more), twice `bias_walk` and half of `scale` (11 % each).
//! - On 24 flights that were simulated when all was chosen, and scored once, the error is 0.78° (median)
//!   and 0.82° (mean); on the twelve it was chosen on, 0.81° and 0.83°.

use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// The filter's tuning.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tuning {
    /// σ of the tilt that the first sample shows, per axis, rad. Larger: a start in motion is
    /// forgotten sooner. Smaller: a start at rest is exact sooner.
    pub start_tilt_rad: f32,
    /// σ of the gyroscope bias at start, per axis, rad/s. Larger: a large bias is found sooner.
    /// Smaller: a start in motion with a small bias is calmer. It widens by itself when the data
    /// contradict it.
    pub start_bias_rad_s: f32,
    /// σ of the horizontal velocity at start, per axis, m/s.
    pub start_velocity_m_s: f32,
    /// σ of the accelerometer bias, per axis, m/s². Larger: turning over shows more of it. Smaller:
    /// less of a lasting acceleration is taken for it.
    pub force_bias_m_s2: f32,
    /// σ of each scale of the gyroscope, 1. Larger: learned sooner, and wrongly from rough motion.
    pub scale: f32,
    /// σ of each misalignment of the gyroscope, rad. Larger and smaller: as for the scale.
    pub misalignment_rad: f32,
    /// Gyroscope noise, rad/s/√Hz. Larger: gravity corrects the attitude sooner, and so do
    /// accelerations.
    pub rate_noise: f32,
    /// More gyroscope noise per rate, 1/√Hz, for what scale and misalignment leave.
    pub rate_noise_per_rate: f32,
    /// How the gyroscope bias wanders, rad/s/√s. Larger: follows temperature sooner.
    pub bias_walk: f32,
    /// How the accelerometer bias wanders, m/s²/√s.
    pub force_bias_walk: f32,
    /// Accelerometer noise, m/s²/√Hz.
    pub force_noise: f32,
    /// More accelerometer noise per usual velocity, m/s²/√Hz per m/s: whoever moves, shakes.
    pub force_noise_per_velocity: f32,
    /// The velocity of something that stands about, m/s·√s. Larger: short accelerations tilt less,
    /// and true tilt errors live longer.
    pub velocity: f32,
    /// More of it per usual velocity, √s: whoever has been moving is allowed to move.
    pub velocity_per_velocity: f32,
    /// It grows no larger than this, m/s·√s.
    pub velocity_limit: f32,
    /// How far the usual velocity looks back, s.
    pub velocity_time_s: f32,
    /// Motions faster than this do not count in it, s.
    pub velocity_smoothing_s: f32,
    /// Extra tilt noise while tilt and bias are both uncertain, for what the linear model leaves
    /// out: the error of one turns with that of the other, rad/√Hz per rad/s per rad.
    pub coupling: f32,
    /// The bias prior is doubled where the bias lies so many σ off, 1.
    pub surprise: f32,
    /// At rest: so long without motion, s.
    pub rest_after_s: f32,
    /// At rest: rates change by no more than this, rad/s.
    pub rest_rate_rad_s: f32,
    /// At rest: specific forces change by no more than this, m/s².
    pub rest_force_m_s2: f32,
    /// At rest: what is left of the velocity, m/s·√s.
    pub rest_velocity: f32,
    /// At rest: what is left of the rate, rad/s/√Hz.
    pub rest_rate: f32,
    /// Time between two steps of the covariance, s. Accuracy is the same from 0.01 to 0.25 s.
    pub covariance_period_s: f32,
    /// Time between two steps of the mean in earth axes, s. Larger: cheaper; more than 10 ms loses
    /// accuracy in fast motion.
    pub earth_period_s: f32,
}

impl Tuning {
    /// The one tuning.
    pub const DEFAULT: Self = Self {
        start_tilt_rad: 0.2,
        start_bias_rad_s: 0.05,
        start_velocity_m_s: 0.1,
        force_bias_m_s2: 0.007 * STANDARD_GRAVITY_M_S2,
        scale: 0.011,
        misalignment_rad: 0.0035,
        rate_noise: 1.0e-3,
        rate_noise_per_rate: 1.0e-3,
        bias_walk: 1.5e-4,
        force_bias_walk: 1.0e-4,
        force_noise: 0.05,
        force_noise_per_velocity: 0.1,
        velocity: 0.2,
        velocity_per_velocity: 2.5,
        velocity_limit: 5.0,
        velocity_time_s: 10.0,
        velocity_smoothing_s: 0.3,
        coupling: 1.0,
        surprise: 1.6,
        rest_after_s: 0.8,
        rest_rate_rad_s: radians(2.0),
        rest_force_m_s2: 0.5,
        rest_velocity: 0.02,
        rest_rate: 0.8e-3,
        covariance_period_s: 0.22,
        earth_period_s: 6.9e-3,
    };
}

impl Default for Tuning {
    fn default() -> Self {
        Self::DEFAULT
    }
}
