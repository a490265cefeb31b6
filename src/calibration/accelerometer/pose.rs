//! Poses that the guide asks for.

use core::f32::consts::FRAC_1_SQRT_2;
use core::fmt;

use super::super::axis::{Axis, SignedAxis};
use crate::attitude::Vector3;

/// Largest angle between a reading and the pose that it shows: cosine of 30°.
pub(super) const DIRECTION_COSINE: f32 = 0.866_025_4;

/// Pose of the sensor, by the direction that points up in sensor axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Pose {
    /// The direction points up.
    Side(SignedAxis),
    /// The direction halfway between these two points up.
    Edge(SignedAxis, SignedAxis),
}

impl Pose {
    /// Poses of the guide: six sides, then six edges, two across from each other in every plane of
    /// two axes.
    pub const GUIDE: [Self; 12] = {
        use Axis::{X, Y, Z};
        [
            Self::Side(Z.positive()),
            Self::Side(Z.negative()),
            Self::Side(X.positive()),
            Self::Side(X.negative()),
            Self::Side(Y.positive()),
            Self::Side(Y.negative()),
            Self::Edge(X.positive(), Y.positive()),
            Self::Edge(X.positive(), Y.negative()),
            Self::Edge(X.positive(), Z.positive()),
            Self::Edge(X.positive(), Z.negative()),
            Self::Edge(Y.positive(), Z.positive()),
            Self::Edge(Y.positive(), Z.negative()),
        ]
    };

    /// Returns the unit vector that points up, in sensor axes: the specific force at rest, in g.
    pub fn up(self) -> Vector3 {
        match self {
            Self::Side(up) => up.unit(),
            Self::Edge(first, second) => (first.unit() + second.unit()).scale(FRAC_1_SQRT_2),
        }
    }
}

impl fmt::Display for Pose {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let way = |direction: SignedAxis| if direction.is_negative { "down" } else { "up" };
        match *self {
            Self::Side(up) => write!(formatter, "{} {}", up.axis, way(up)),
            Self::Edge(first, second) => write!(
                formatter,
                "{} {} and {} {}, halfway between",
                first.axis,
                way(first),
                second.axis,
                way(second)
            ),
        }
    }
}

/// Returns whether one of the readings shows this direction up, within 30°.
pub(super) fn covers(readings: &[Vector3], up: Vector3) -> bool {
    readings
        .iter()
        .any(|reading| reading.dot(up) > DIRECTION_COSINE * reading.norm())
}
