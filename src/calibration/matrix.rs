//! 3×3 matrices.

use crate::attitude::Vector3;

/// 3×3 matrix.
///
/// ```
/// use aplomb::attitude::Vector3;
/// use aplomb::calibration::Matrix3;
///
/// let mut matrix = Matrix3::IDENTITY;
/// matrix.rows[0].y = 0.5;
/// let product = matrix.times(Vector3::new(1.0, 2.0, 3.0));
/// assert_eq!(product, Vector3::new(2.0, 2.0, 3.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Matrix3 {
    /// Rows.
    pub rows: [Vector3; 3],
}

impl Matrix3 {
    /// Identity matrix.
    pub const IDENTITY: Self = Self {
        rows: [
            Vector3::new(1.0, 0.0, 0.0),
            Vector3::new(0.0, 1.0, 0.0),
            Vector3::new(0.0, 0.0, 1.0),
        ],
    };

    /// Returns the matrix of the console's `gyro-matrix`: elements by rows, less those of the
    /// identity, in units of 10⁻⁴.
    ///
    /// ```
    /// use aplomb::calibration::Matrix3;
    ///
    /// let matrix = Matrix3::from_ten_thousandths([-250, 0, 0, 0, 0, 0, 0, 0, 12]);
    /// assert!((matrix.rows[0].x - 0.975).abs() < 1e-6);
    /// assert_eq!(matrix.to_ten_thousandths()[8], 12);
    /// ```
    pub fn from_ten_thousandths([xx, xy, xz, yx, yy, yz, zx, zy, zz]: [i16; 9]) -> Self {
        let row = |x, y, z| Vector3::new(f32::from(x), f32::from(y), f32::from(z)).scale(1.0e-4);
        let mut rows = [row(xx, xy, xz), row(yx, yy, yz), row(zx, zy, zz)];
        for (row, axis) in rows.iter_mut().zip(Self::IDENTITY.rows) {
            *row = *row + axis;
        }
        Self { rows }
    }

    /// Returns the elements of the console's `gyro-matrix`; see
    /// [`from_ten_thousandths`](Self::from_ten_thousandths).
    pub fn to_ten_thousandths(self) -> [i16; 9] {
        let mut elements = [0; 9];
        let rows = self.rows.iter().zip(Self::IDENTITY.rows);
        let differences = rows.flat_map(|(row, axis)| {
            let Vector3 { x, y, z } = *row - axis;
            [x, y, z]
        });
        for (element, difference) in elements.iter_mut().zip(differences) {
            *element = libm::roundf(difference * 1.0e4) as i16;
        }
        elements
    }

    /// Multiplies the matrix by a vector.
    pub fn times(&self, v: Vector3) -> Vector3 {
        let [x, y, z] = &self.rows;
        Vector3::new(x.dot(v), y.dot(v), z.dot(v))
    }
}

impl Default for Matrix3 {
    fn default() -> Self {
        Self::IDENTITY
    }
}

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

    /// Returns the same matrix with all nine elements.
    pub const fn to_matrix(self) -> Matrix3 {
        Matrix3 {
            rows: [
                Vector3::new(self.xx, self.xy, self.xz),
                Vector3::new(self.xy, self.yy, self.yz),
                Vector3::new(self.xz, self.yz, self.zz),
            ],
        }
    }

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
