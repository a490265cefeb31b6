//! Correction of a compass: hard iron, soft iron, and the compass's place in the vehicle.

use super::super::mount::Mount;
use crate::attitude::{BodyVector, Quaternion, Vector3};
use crate::units::MagneticField;

/// Correction of a compass: field = matrix · reading − hard iron, in body axes.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CompassCorrection {
    /// Rows of the matrix, for soft iron, gains and small rotations; no unit.
    pub matrix: [Vector3; 3],
    /// Hard iron, µT in body axes.
    pub hard_iron_ut: Vector3,
}

impl CompassCorrection {
    /// No correction.
    pub const NONE: Self = Self {
        matrix: [
            Vector3::new(1.0, 0.0, 0.0),
            Vector3::new(0.0, 1.0, 0.0),
            Vector3::new(0.0, 0.0, 1.0),
        ],
        hard_iron_ut: Vector3::ZERO,
    };

    /// Returns whether soft iron is corrected too. Without it the hard iron is that of the heading
    /// filter, and not that of a calibration.
    pub fn has_soft_iron(&self) -> bool {
        self.matrix != Self::NONE.matrix
    }

    /// Returns the correction for other body axes. `turn` rotates vectors from the former body axes
    /// to the new ones.
    ///
    /// ```
    /// use aplomb::attitude::{Quaternion, Vector3};
    /// use aplomb::calibration::CompassCorrection;
    ///
    /// let correction = CompassCorrection {
    ///     hard_iron_ut: Vector3::new(0.0, 10.0, 0.0),
    ///     ..CompassCorrection::NONE
    /// };
    /// let turn = Quaternion::from_rotation_vector(Vector3::new(0.01, 0.0, 0.0));
    /// let turned = correction.turned(turn);
    /// assert!((turned.hard_iron_ut.z - 0.1).abs() < 1e-3);
    /// ```
    #[must_use]
    pub fn turned(&self, turn: Quaternion) -> Self {
        let mut turned = Self {
            hard_iron_ut: turn.rotate(self.hard_iron_ut),
            ..*self
        };
        // Without soft iron the matrix stands for a compass along the body axes.
        if self.has_soft_iron() {
            let [x, y, z] = self.matrix;
            turned.matrix = Self::NONE.matrix.map(|axis| {
                let row = turn.conjugate().rotate(axis);
                x.scale(row.x) + y.scale(row.y) + z.scale(row.z)
            });
        }
        turned
    }

    /// Corrects a reading in body axes; both are in µT.
    pub fn apply(&self, reading_ut: Vector3) -> Vector3 {
        let [x, y, z] = self.matrix.map(|row| row.dot(reading_ut));
        Vector3::new(x, y, z) - self.hard_iron_ut
    }
}

/// Place of a compass in the vehicle, and its correction.
///
/// ```
/// use aplomb::attitude::Vector3;
/// use aplomb::calibration::{CompassAlignment, Mount};
///
/// let alignment = CompassAlignment { mount: Mount::Z_UP, correction: None };
/// let field = alignment.apply(Vector3::new(20.0, 0.0, -45.0));
/// assert_eq!(field.ut, [20.0, 0.0, 45.0]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CompassAlignment {
    /// Mount of the compass, independent of the IMU's.
    pub mount: Mount,
    /// Correction in body axes; `None` if the compass was not calibrated.
    pub correction: Option<CompassCorrection>,
}

impl CompassAlignment {
    /// Returns the field in body axes for a reading in µT along the compass's axes.
    pub fn apply(&self, reading_ut: Vector3) -> MagneticField {
        let BodyVector(body) = self.mount.to_body(reading_ut);
        let Vector3 { x, y, z } = self
            .correction
            .map_or(body, |correction| correction.apply(body));
        MagneticField { ut: [x, y, z] }
    }
}
