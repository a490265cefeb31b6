//! How the sensor sits: which of the 24 mounts, and the small rotation that is left between it and the body.
//!
//! Both come from the direction of gravity in a pose that a person vouches for: level, and nose down.

use core::fmt;

use super::Mount;
use crate::attitude::{Quaternion, Vector3};
use crate::units::{DEGREES_PER_RADIAN, STANDARD_GRAVITY_M_S2, radians};

/// No level trim is larger; a sensor that is further off is mounted otherwise than its mount says.
const LARGEST_TRIM_RAD: f32 = radians(15.0);
/// How far from an axis a direction may lie to be taken for it.
const AXIS_TOLERANCE_RAD: f32 = radians(30.0);
/// So far the nose has to be down at least.
const LEAST_NOSE_DOWN_RAD: f32 = radians(30.0);

/// The level trim: the shortest rotation, mounted axes to body, after which this specific force points straight up.
///
/// `force_m_s2` is the mean at rest in mounted axes (mount applied, level not), with the body level.
///
/// # Errors
///
/// [`LevelError`] if it is further than 15° off or not gravity.
pub fn level(force_m_s2: Vector3) -> Result<Quaternion, LevelError> {
    let up = direction(force_m_s2).ok_or(LevelError::NoGravity)?;
    let tilt_rad = libm::atan2f(libm::sqrtf(up.x * up.x + up.y * up.y), -up.z);
    if tilt_rad > LARGEST_TRIM_RAD {
        return Err(LevelError::TooFar {
            tilt_degrees: tilt_rad * DEGREES_PER_RADIAN,
        });
    }
    // The rotation from u to v is (1 + u·v, u × v); v is (0, 0, −1).
    Ok(Quaternion::new(1.0 - up.z, -up.y, up.x, 0.0).normalize())
}

/// Why there is no level trim.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LevelError {
    /// It is further off than any trim.
    TooFar {
        /// How far, in degrees.
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
                whole(*tilt_degrees)
            ),
            Self::NoGravity => formatter.write_str("the accelerometer reads no gravity"),
        }
    }
}

impl core::error::Error for LevelError {}

/// Finds the mount from two poses: level, then nose down.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MountFinder {
    /// Which way was down when it was level, in sensor axes.
    down: Option<Vector3>,
}

/// What is next.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MountStep {
    /// Now the nose down, by 90 degrees or as far as it goes.
    NoseDown,
    /// This is it.
    Found(Mount),
}

impl MountFinder {
    /// A finder that waits for the level pose.
    pub const fn new() -> Self {
        Self { down: None }
    }

    /// Takes the mean specific force of a pose at rest, m/s² in sensor axes: first level, then nose down.
    ///
    /// # Errors
    ///
    /// [`MountError`]; the pose does not count then, and the same one may be tried again.
    pub fn add(&mut self, force_m_s2: Vector3) -> Result<MountStep, MountError> {
        let down_now = -direction(force_m_s2).ok_or(MountError::NoGravity)?;
        let Some(down) = self.down else {
            let (mount, angle_rad) = nearest(Vector3::ZERO, down_now);
            if angle_rad > AXIS_TOLERANCE_RAD {
                return Err(MountError::NotSquare {
                    degrees: angle_rad * DEGREES_PER_RADIAN,
                });
            }
            self.down = Some(mount.to_sensor(Vector3::new(0.0, 0.0, 1.0)));
            return Ok(MountStep::NoseDown);
        };
        // What of gravity now lies across the level pose's down axis points to the nose.
        let along = down_now.dot(down);
        let across = down_now - down.scale(along);
        let length = across.norm();
        let nose_down_rad = libm::atan2f(length, along);
        if nose_down_rad < LEAST_NOSE_DOWN_RAD || length < 0.1 {
            return Err(MountError::NoseNotDown {
                degrees: nose_down_rad * DEGREES_PER_RADIAN,
            });
        }
        let (mount, angle_rad) = nearest(across.scale(1.0 / length), down);
        if angle_rad > AXIS_TOLERANCE_RAD {
            return Err(MountError::NotSquare {
                degrees: angle_rad * DEGREES_PER_RADIAN,
            });
        }
        self.down = None;
        Ok(MountStep::Found(mount))
    }
}

/// Why a pose says nothing about the mount.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MountError {
    /// The specific force is not about one g.
    NoGravity,
    /// No axis of the sensor is near the direction that was shown.
    NotSquare {
        /// How far the nearest one is, in degrees.
        degrees: f32,
    },
    /// The nose is not down.
    NoseNotDown {
        /// How far it is down, in degrees.
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
                whole(*degrees)
            ),
            Self::NoseNotDown { degrees } => write!(
                formatter,
                "the nose is {} degrees from the level pose: point it straight down",
                whole(*degrees)
            ),
        }
    }
}

impl core::error::Error for MountError {}

/// The mount whose axes are nearest to these directions, and how far the farther one is; a zero vector asks for nothing.
fn nearest(forward: Vector3, down: Vector3) -> (Mount, f32) {
    let cosines = |mount: Mount| {
        let forward_cosine = mount.to_sensor(Vector3::new(1.0, 0.0, 0.0)).dot(forward);
        let down_cosine = mount.to_sensor(Vector3::new(0.0, 0.0, 1.0)).dot(down);
        (forward_cosine, down_cosine)
    };
    let mut best = (Mount::Z_UP, f32::NEG_INFINITY);
    for mount in Mount::ALL {
        let (forward_cosine, down_cosine) = cosines(mount);
        let score = forward_cosine + 2.0 * down_cosine;
        if score > best.1 {
            best = (mount, score);
        }
    }
    let (mount, _) = best;
    let (forward_cosine, down_cosine) = cosines(mount);
    let least = if forward == Vector3::ZERO {
        down_cosine
    } else {
        forward_cosine.min(down_cosine)
    };
    (mount, libm::acosf(least.clamp(-1.0, 1.0)))
}

/// The direction of a specific force that may be gravity.
fn direction(force_m_s2: Vector3) -> Option<Vector3> {
    const LEAST: f32 = 0.8 * STANDARD_GRAVITY_M_S2;
    const MOST: f32 = 1.2 * STANDARD_GRAVITY_M_S2;
    let norm = force_m_s2.norm();
    (LEAST..=MOST)
        .contains(&norm)
        .then(|| force_m_s2.scale(1.0 / norm))
}

/// Whole degrees, for messages.
fn whole(degrees: f32) -> i32 {
    (degrees + 0.5) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::EulerAngles;

    fn gravity_in(roll_degrees: f32, pitch_degrees: f32) -> Vector3 {
        let attitude = Quaternion::from_euler(EulerAngles {
            roll_rad: radians(roll_degrees),
            pitch_rad: radians(pitch_degrees),
            yaw_rad: 0.0,
        });
        -attitude.down_in_body().scale(STANDARD_GRAVITY_M_S2)
    }

    #[test]
    fn the_trim_makes_the_pose_level() {
        for (roll, pitch) in [(0.0, 0.0), (5.0, -3.0), (-10.0, 8.0)] {
            let force = gravity_in(roll, pitch);
            let trim = level(force).expect("near level");
            let levelled = trim.rotate(force);
            let up = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
            assert!((levelled - up).norm() < 1e-4, "{levelled:?}");
            // It is the shortest: no yaw beyond what tilting about one level axis makes.
            assert_eq!(trim.z, 0.0);
        }
    }

    #[test]
    fn what_is_far_from_level_is_another_mount() {
        let error = level(gravity_in(20.0, 0.0)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "it is 20 degrees from level, more than 15: is the mount right?"
        );
        let upside_down = level(gravity_in(180.0, 0.0)).unwrap_err();
        assert!(matches!(upside_down, LevelError::TooFar { tilt_degrees } if tilt_degrees > 179.0));
        for nothing in [0.0, 1.0, 30.0, f32::NAN, f32::INFINITY] {
            let force = Vector3::new(0.0, 0.0, -nothing);
            assert_eq!(level(force), Err(LevelError::NoGravity));
        }
    }

    #[test]
    fn every_mount_is_found_from_two_poses_held_roughly() {
        for mount in Mount::ALL {
            for (roll, pitch, nose) in [(0.0, 0.0, -90.0), (10.0, -12.0, -75.0), (-8.0, 5.0, -45.0)]
            {
                let mut finder = MountFinder::new();
                let flat = mount.to_sensor(gravity_in(roll, pitch));
                assert_eq!(finder.add(flat), Ok(MountStep::NoseDown));
                let down = mount.to_sensor(gravity_in(0.5 * roll, nose));
                assert_eq!(finder.add(down), Ok(MountStep::Found(mount)), "{mount}");
            }
        }
    }

    #[test]
    fn poses_that_do_not_say_which_axis_are_refused_and_may_be_tried_again() {
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
