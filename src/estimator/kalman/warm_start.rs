//! Start that continues an earlier run.

use crate::attitude::{Quaternion, Vector3};

/// State of an earlier run, from which the filter continues.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WarmStart {
    /// Body to earth.
    pub attitude: Quaternion,
    /// σ of the tilt, both axes together, rad. From 30° on, the specific force sets the tilt.
    pub tilt_sigma_rad: f32,
    /// The gyroscope's bias in body axes, rad/s.
    pub bias_rad_s: Vector3,
    /// Change of the bias since the last rest, or else since it was stored, rad/s. Motion confirms
    /// the bias only if it then is within 0.2 °/s of that rest's.
    pub bias_change_rad_s: Vector3,
    /// σ of the bias per axis, rad/s. From 0.5 °/s on, the bias is not known.
    pub bias_sigma_rad_s: f32,
    /// Bias of the accelerometer along the body's forward and right axes, m/s².
    pub accelerometer_bias_m_s2: [f32; 2],
    /// Mean squared horizontal velocity of the last seconds, (m/s)²: 0 for a vehicle that has
    /// stayed in place. The filter assumes 2 at least, because the vehicle may have begun to move.
    /// The faster it moves, the less its accelerations say of the tilt.
    pub squared_velocity_m2_s2: f32,
}
