//! Symmetric 3×3 matrices.

use crate::attitude::Vector3;

/// Symmetric 3×3 matrix.
///
/// ```
/// use aplomb::attitude::Vector3;
/// use aplomb::calibration::SymmetricMatrix;
///
/// let matrix = SymmetricMatrix { xx: 2.0, xy: 0.5, ..SymmetricMatrix::IDENTITY };
/// let product = matrix.times(Vector3::new(1.0, 2.0, 3.0));
/// assert_eq!(product, Vector3::new(3.0, 2.5, 3.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SymmetricMatrix {
    /// First diagonal element.
    pub xx: f32,
    /// Second diagonal element.
    pub yy: f32,
    /// Third diagonal element.
    pub zz: f32,
    /// Element of the first row, second column, and its mirror.
    pub xy: f32,
    /// Element of the first row, third column, and its mirror.
    pub xz: f32,
    /// Element of the second row, third column, and its mirror.
    pub yz: f32,
}

impl SymmetricMatrix {
    /// Identity matrix.
    pub const IDENTITY: Self = Self {
        xx: 1.0,
        yy: 1.0,
        zz: 1.0,
        xy: 0.0,
        xz: 0.0,
        yz: 0.0,
    };

    /// Multiplies the matrix by a vector.
    pub fn times(&self, v: Vector3) -> Vector3 {
        Vector3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }

    /// Inverts a positive definite matrix by cofactors; `None` if it is singular to `f32`
    /// precision.
    pub(super) fn inverse(&self) -> Option<Self> {
        let xx = self.yy * self.zz - self.yz * self.yz;
        let xy = self.xz * self.yz - self.xy * self.zz;
        let xz = self.xy * self.yz - self.xz * self.yy;
        let determinant = self.xx * xx + self.xy * xy + self.xz * xz;
        let scale = self.xx * self.yy * self.zz;
        // A NaN fails every comparison.
        let is_regular = determinant > 1.0e-6 * scale && scale > 0.0;
        is_regular.then(|| {
            let factor = 1.0 / determinant;
            Self {
                xx: xx * factor,
                xy: xy * factor,
                xz: xz * factor,
                yy: (self.xx * self.zz - self.xz * self.xz) * factor,
                yz: (self.xy * self.xz - self.xx * self.yz) * factor,
                zz: (self.xx * self.yy - self.xy * self.xy) * factor,
            }
        })
    }
}

impl Default for SymmetricMatrix {
    fn default() -> Self {
        Self::IDENTITY
    }
}
