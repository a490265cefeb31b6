//! Coverage: directions of gravity and of a horizontal reference that the vehicle has shown.

use core::fmt;

use crate::attitude::{Quaternion, Vector3};

/// Largest angle between a side and a direction that it covers: 45°, as a cosine.
const COVERED_COSINE: f32 = 0.707;
/// Number of directions: six for gravity, six for the reference.
const DIRECTIONS: u32 = 12;

/// Side of the vehicle that can point down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Side {
    /// Nose down.
    Nose = 0,
    /// Tail down.
    Tail = 1,
    /// Right side down.
    Right = 2,
    /// Left side down.
    Left = 3,
    /// Level.
    Bottom = 4,
    /// Upside down.
    Top = 5,
}

impl Side {
    const ALL: [Self; 6] = [
        Self::Nose,
        Self::Tail,
        Self::Right,
        Self::Left,
        Self::Bottom,
        Self::Top,
    ];
}

impl fmt::Display for Side {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Nose => "nose down",
            Self::Tail => "tail down",
            Self::Right => "right side down",
            Self::Left => "left side down",
            Self::Bottom => "level",
            Self::Top => "upside down",
        })
    }
}

/// Directions that the vehicle has shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Coverage(pub(super) u16);

impl Coverage {
    /// Adds an attitude, body to earth.
    pub(super) fn add(&mut self, attitude: Quaternion) {
        let back = attitude.conjugate();
        let down = back.rotate(Vector3::new(0.0, 0.0, 1.0));
        let reference = back.rotate(Vector3::new(1.0, 0.0, 0.0));
        let directions = [
            down.x,
            down.y,
            down.z,
            reference.x,
            reference.y,
            reference.z,
        ];
        for (axis, component) in directions.into_iter().enumerate() {
            if component.abs() > COVERED_COSINE {
                let is_negative = usize::from(component < 0.0);
                self.0 |= 1 << (2 * axis + is_negative);
            }
        }
    }

    /// Returns the share of the directions, 0 to 100.
    pub fn percent(self) -> u8 {
        (100 * self.0.count_ones() / DIRECTIONS) as u8
    }

    /// Returns a side that has not pointed down yet.
    pub fn missing_side(self) -> Option<Side> {
        let is_missing = |side: &Side| self.0 & 1 << (*side as u8) == 0;
        Side::ALL.into_iter().find(is_missing)
    }
}
