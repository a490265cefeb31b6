//! Mount fit: finds which of the 24 mounts the sensor has, from two poses.
//!
//! A person shows two poses: the body level, then nose down. The first shows the body's down axis,
//! the second its forward axis, each to within 30°.
//!
//! ```
//! use aplomb::attitude::Vector3;
//! use aplomb::calibration::Mount;
//! use aplomb::calibration::mount_finder::{MountFinder, MountStep};
//!
//! let mut finder = MountFinder::new();
//! // Chip face up: the force at rest is +1 g along the sensor's Z. Nose down: along its −X.
//! assert_eq!(finder.add(Vector3::new(0.0, 0.0, 9.81)), Ok(MountStep::NoseDown));
//! let found = finder.add(Vector3::new(-9.81, 0.0, 0.0));
//! assert_eq!(found, Ok(MountStep::Found(Mount::Z_UP)));
//! ```

use core::fmt;

use super::gravity::{direction, whole_degrees};
use super::mount::Mount;
use crate::attitude::{BodyVector, Vector3};
use crate::units::{DEGREES_PER_RADIAN, radians};

/// Largest angle between a shown direction and its sensor axis, rad.
const AXIS_TOLERANCE_RAD: f32 = radians(30.0);
/// Smallest angle between the two poses, rad.
const MIN_NOSE_DOWN_RAD: f32 = radians(30.0);

/// Finds the mount from two poses: level, then nose down.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MountFinder {
    /// Down direction of the level pose, in sensor axes.
    down: Option<Vector3>,
}

/// Result of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MountStep {
    /// The finder needs the second pose: nose down by 90°, or as far as possible.
    NoseDown,
    /// The poses show this mount. The finder starts over.
    Found(Mount),
}

impl MountFinder {
    /// Creates a finder that waits for the level pose.
    pub const fn new() -> Self {
        Self { down: None }
    }

    /// Adds the mean specific force of a stationary pose, m/s² in sensor axes.
    ///
    /// # Errors
    ///
    /// Returns a [`MountError`] if the pose shows no axis. The finder then waits for the same pose.
    pub fn add(&mut self, force_m_s2: Vector3) -> Result<MountStep, MountError> {
        let down_now = -direction(force_m_s2).ok_or(MountError::NoGravity)?;
        let Some(down) = self.down else {
            let mount = nearest(Vector3::ZERO, down_now)?;
            self.down = Some(mount.to_sensor(BodyVector::new(0.0, 0.0, 1.0)));
            return Ok(MountStep::NoseDown);
        };
        // The part of gravity across the level pose's down axis points to the nose.
        let along = down_now.dot(down);
        let across = down_now - down.scale(along);
        let length = across.norm();
        let nose_down_rad = libm::atan2f(length, along);
        if nose_down_rad < MIN_NOSE_DOWN_RAD || length < 0.1 {
            return Err(MountError::NoseNotDown {
                degrees: nose_down_rad * DEGREES_PER_RADIAN,
            });
        }
        let mount = nearest(across.scale(1.0 / length), down)?;
        self.down = None;
        Ok(MountStep::Found(mount))
    }
}

/// Reason why a pose does not show the mount.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MountError {
    /// The specific force is not about one g.
    NoGravity,
    /// No sensor axis lies within 30° of the shown direction.
    NotSquare {
        /// Angle to the nearest axis, °.
        degrees: f32,
    },
    /// The second pose is less than 30° from the level pose.
    NoseNotDown {
        /// Angle between the two poses, °.
        degrees: f32,
    },
}

impl fmt::Display for MountError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoGravity => formatter.write_str("the accelerometer reads no gravity"),
            Self::NotSquare { degrees } => write!(
                formatter,
                "the nearest sensor axis is {} degrees off, more than 30: hold it squarely",
                whole_degrees(*degrees)
            ),
            Self::NoseNotDown { degrees } => write!(
                formatter,
                "the nose is {} degrees from the level pose: point it straight down",
                whole_degrees(*degrees)
            ),
        }
    }
}

impl core::error::Error for MountError {}

/// Returns the mount whose axes are nearest to these directions; a zero vector means any.
fn nearest(forward: Vector3, down: Vector3) -> Result<Mount, MountError> {
    let mut best_score = f32::NEG_INFINITY;
    let mut best = (Mount::Z_UP, 0.0, 0.0);
    for mount in Mount::ALL {
        let forward_cosine = mount.to_body(forward).0.x;
        let down_cosine = mount.to_body(down).0.z;
        let score = forward_cosine + 2.0 * down_cosine;
        if score > best_score {
            best_score = score;
            best = (mount, forward_cosine, down_cosine);
        }
    }
    let (mount, forward_cosine, down_cosine) = best;
    let smaller = if forward == Vector3::ZERO {
        down_cosine
    } else {
        forward_cosine.min(down_cosine)
    };
    let angle_rad = libm::acosf(smaller.clamp(-1.0, 1.0));
    if angle_rad > AXIS_TOLERANCE_RAD {
        return Err(MountError::NotSquare {
            degrees: angle_rad * DEGREES_PER_RADIAN,
        });
    }
    Ok(mount)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::gravity::gravity_in;
    use crate::units::STANDARD_GRAVITY_M_S2;

    #[test]
    fn every_mount_is_found_from_two_poses_held_roughly() {
        for mount in Mount::ALL {
            for (roll, pitch, nose) in [(0.0, 0.0, -90.0), (10.0, -12.0, -75.0), (-8.0, 5.0, -45.0)]
            {
                let mut finder = MountFinder::new();
                let flat = mount.to_sensor(BodyVector(gravity_in(roll, pitch)));
                assert_eq!(finder.add(flat), Ok(MountStep::NoseDown));
                let down = mount.to_sensor(BodyVector(gravity_in(0.5 * roll, nose)));
                assert_eq!(finder.add(down), Ok(MountStep::Found(mount)), "{mount}");
            }
        }
    }

    #[test]
    fn poses_without_an_axis_are_refused_and_can_be_repeated() {
        let mut finder = MountFinder::new();
        let slanted = finder.add(gravity_in(45.0, 0.0)).unwrap_err();
        assert!(matches!(slanted, MountError::NotSquare { .. }), "{slanted}");
        assert_eq!(finder.add(Vector3::ZERO), Err(MountError::NoGravity));
        assert_eq!(finder.add(gravity_in(0.0, 0.0)), Ok(MountStep::NoseDown));
        let still_level = finder.add(gravity_in(0.0, -10.0)).unwrap_err();
        assert_eq!(
            still_level.to_string(),
            "the nose is 10 degrees from the level pose: point it straight down"
        );
        let upside_down = finder.add(gravity_in(180.0, 0.0));
        assert!(matches!(upside_down, Err(MountError::NoseNotDown { .. })));
        // Nose down, but turned by half a right angle: between two axes.
        let diagonal = Vector3::new(1.0, 1.0, 0.0).scale(0.707 * STANDARD_GRAVITY_M_S2);
        assert!(matches!(
            finder.add(diagonal),
            Err(MountError::NotSquare { .. })
        ));
        let nose_down = finder.add(gravity_in(0.0, -90.0));
        assert_eq!(
            nose_down,
            Ok(MountStep::Found(Mount::Z_DOWN)),
            "body = sensor here"
        );
    }
}
