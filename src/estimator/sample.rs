//! Input and output of a filter: [`Sample`], [`Estimate`], [`Issues`].

use crate::attitude::{BodyVector, EulerAngles, Quaternion, Vector3};

/// A calibrated sample in body axes: forward, right, down. [`Sample::new`] creates one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Sample {
    /// Time of the sample, in µs since start.
    pub t_us: u64,
    /// Specific force in m/s²: (0, 0, −9.81) at rest and level.
    pub specific_force_m_s2: Vector3,
    /// Angular rate in rad/s.
    pub angular_rate_rad_s: Vector3,
    /// True if an axis of the gyroscope reads full scale. Only a `Pipeline` recognises readings
    /// that no body can turn at, and replaces them.
    pub is_rate_saturated: bool,
    /// True if an axis of the accelerometer reads full scale.
    pub is_force_saturated: bool,
}

impl Sample {
    /// Creates a sample without an axis at full scale.
    pub const fn new(
        t_us: u64,
        specific_force_m_s2: BodyVector,
        angular_rate_rad_s: BodyVector,
    ) -> Self {
        Self {
            t_us,
            specific_force_m_s2: specific_force_m_s2.0,
            angular_rate_rad_s: angular_rate_rad_s.0,
            is_rate_saturated: false,
            is_force_saturated: false,
        }
    }
}

bitflags::bitflags! {
    /// Problems of a sample, with the estimator's reaction to each.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub struct Issues: u8 {
        /// The time did not increase. The attitude is held, and time continues from this sample.
        const TIME_WENT_BACK = 1 << 0;
        /// The step was longer than [`LONGEST_STEP_US`](super::LONGEST_STEP_US). Roll and pitch
        /// restart from the accelerometer, and yaw is kept.
        const GAP = 1 << 1;
        /// A value was not finite, or was implausibly large. The sample is ignored.
        const REJECTED = 1 << 2;
        /// The specific force was under
        /// [`LEAST_SPECIFIC_FORCE_M_S2`](super::LEAST_SPECIFIC_FORCE_M_S2). Only the gyroscope was
        /// used.
        const NO_GRAVITY = 1 << 3;
        /// The rate is above √((2·previous)² + (50 °/s)²), as if the gyroscope's full scale
        /// had changed.
        const RATE_JUMP = 1 << 4;
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Issues {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        for (index, (name, _)) in self.iter_names().enumerate() {
            let separator = if index > 0 { "|" } else { "" };
            defmt::write!(formatter, "{=str}{=str}", separator, name);
        }
    }
}

/// Result of a sample.
///
/// The attitude is that of the sample's time: it is extrapolated by the filter's delay. The body
/// rates are those of the sample, older by the delay.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Estimate {
    /// Body to earth.
    pub attitude: Quaternion,
    /// Body rates p, q, r in rad/s.
    pub body_rates_rad_s: Vector3,
    /// Variance of the direction of down, both axes together, rad². Infinite if unknown.
    pub tilt_variance_rad2: f32,
    /// True if the gyroscope's bias is known. Always true for filters that do not estimate it.
    pub is_bias_known: bool,
    /// Problems of the sample.
    pub issues: Issues,
}

impl Estimate {
    /// Returns roll, pitch and yaw in rad. Yaw is relative to the heading at start.
    pub fn euler(&self) -> EulerAngles {
        self.attitude.to_euler()
    }

    /// Returns σ of the direction of down, both axes together, in rad.
    pub fn tilt_sigma_rad(&self) -> f32 {
        libm::sqrtf(self.tilt_variance_rad2)
    }
}
