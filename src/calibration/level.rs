//! Level fit: the small rotation between the mounted sensor's axes and the body's.
//!
//! The direction of gravity with the body level shows roll and pitch of that rotation. Its yaw
//! stays unknown and is taken for zero.
//!
//! ```
//! use aplomb::attitude::Vector3;
//! use aplomb::calibration::level;
//!
//! // Mounted 2° right wing down: the force points up, and 2° to the left.
//! let (sine, cosine) = 2.0_f32.to_radians().sin_cos();
//! let trim = level::trim(Vector3::new(0.0, -9.81 * sine, -9.81 * cosine))?;
//! assert!((trim.to_euler().roll_rad.to_degrees() - 2.0).abs() < 1e-3);
//! # Ok::<(), level::LevelError>(())
//! ```

use core::fmt;

use super::gravity::{direction, whole_degrees};
use crate::attitude::{Quaternion, Vector3};
use crate::units::{DEGREES_PER_RADIAN, radians};

/// Largest level trim, rad. A sensor that is further off has another mount than the one set.
const MAX_TRIM_RAD: f32 = radians(15.0);
/// Rounding of a quaternion that a user has written with four digits.
const ROUNDING: f32 = 1.0e-3;

/// Returns the level trim: the shortest rotation from mounted axes to body axes after which this
/// specific force points straight up.
///
/// `force_m_s2` is the mean at rest with the body level, in mounted axes: mount applied, level not.
///
/// # Errors
///
/// Returns a [`LevelError`] if the force is not gravity, or is more than 15° from up.
pub fn trim(force_m_s2: Vector3) -> Result<Quaternion, LevelError> {
    let up = direction(force_m_s2).ok_or(LevelError::NoGravity)?;
    let tilt_rad = libm::atan2f(libm::sqrtf(up.x * up.x + up.y * up.y), -up.z);
    if tilt_rad > MAX_TRIM_RAD {
        return Err(LevelError::TooFar {
            tilt_degrees: tilt_rad * DEGREES_PER_RADIAN,
        });
    }
    // The rotation from u to v is (1 + u·v, u × v); v is (0, 0, −1).
    Ok(Quaternion::new(1.0 - up.z, -up.y, up.x, 0.0).normalize())
}

/// Returns whether a quaternion is a rotation that [`trim`] can find, or one with a yaw too.
pub(super) fn is_trim(level: &Quaternion) -> bool {
    let length_error = level.dot(*level) - 1.0;
    let down = level.down_in_body();
    let tilt_rad = libm::atan2f(libm::sqrtf(down.x * down.x + down.y * down.y), down.z);
    length_error.abs() <= ROUNDING && tilt_rad <= MAX_TRIM_RAD + ROUNDING
}

/// Reason why there is no level trim.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LevelError {
    /// The force is more than 15° from up.
    TooFar {
        /// Angle between the force and up, °.
        tilt_degrees: f32,
    },
    /// The specific force is not about one g.
    NoGravity,
}

impl fmt::Display for LevelError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFar { tilt_degrees } => write!(
                formatter,
                "it is {} degrees from level, more than 15: is the mount right?",
                whole_degrees(*tilt_degrees)
            ),
            Self::NoGravity => formatter.write_str("the accelerometer reads no gravity"),
        }
    }
}

impl core::error::Error for LevelError {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::gravity::gravity_in;
    use crate::units::STANDARD_GRAVITY_M_S2;

    #[test]
    fn the_trim_makes_the_pose_level() {
        for (roll, pitch) in [(0.0, 0.0), (5.0, -3.0), (-10.0, 8.0)] {
            let force = gravity_in(roll, pitch);
            let rotation = trim(force).expect("near level");
            let levelled = rotation.rotate(force);
            let up = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
            assert!((levelled - up).norm() < 1e-4, "{levelled:?}");
            // The turn is the shortest: no yaw beyond what tilting about one level axis makes.
            assert_eq!(rotation.z, 0.0);
        }
    }

    #[test]
    fn a_pose_far_from_level_has_another_mount() {
        let error = trim(gravity_in(20.0, 0.0)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "it is 20 degrees from level, more than 15: is the mount right?"
        );
        let upside_down = trim(gravity_in(180.0, 0.0)).unwrap_err();
        assert!(matches!(upside_down, LevelError::TooFar { tilt_degrees } if tilt_degrees > 179.0));
        for nothing in [0.0, 1.0, 30.0, f32::NAN, f32::INFINITY] {
            let force = Vector3::new(0.0, 0.0, -nothing);
            assert_eq!(trim(force), Err(LevelError::NoGravity));
        }
    }
}
