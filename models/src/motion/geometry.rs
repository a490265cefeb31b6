//! Vectors, rotations and quaternions in double precision, for the truth side alone.
//!
//! The library has its own in single precision; these are separate so that the two can disagree.

/// Three components along the axes of a frame, which the name gives.
pub type Vector = [f64; 3];

/// `left + right`.
#[must_use]
pub fn add(left: Vector, right: Vector) -> Vector {
    [left[0] + right[0], left[1] + right[1], left[2] + right[2]]
}

/// `left - right`.
#[must_use]
pub fn subtract(left: Vector, right: Vector) -> Vector {
    [left[0] - right[0], left[1] - right[1], left[2] - right[2]]
}

/// `vector` times `factor`.
#[must_use]
pub fn scale(vector: Vector, factor: f64) -> Vector {
    [vector[0] * factor, vector[1] * factor, vector[2] * factor]
}

/// Scalar product.
#[must_use]
pub fn dot(left: Vector, right: Vector) -> f64 {
    left[0] * right[0] + left[1] * right[1] + left[2] * right[2]
}

/// Vector product.
#[must_use]
pub fn cross(left: Vector, right: Vector) -> Vector {
    [
        left[1] * right[2] - left[2] * right[1],
        left[2] * right[0] - left[0] * right[2],
        left[0] * right[1] - left[1] * right[0],
    ]
}

/// Euclidean length.
#[must_use]
pub fn norm(vector: Vector) -> f64 {
    dot(vector, vector).sqrt()
}

/// `start` at share 0, `end` at share 1, straight between.
#[must_use]
pub fn interpolate(start: Vector, end: Vector, share: f64) -> Vector {
    add(start, scale(subtract(end, start), share))
}

/// The angle between two directions, in radians from 0 to π, accurate for small angles too.
#[must_use]
pub fn angle_between(left: Vector, right: Vector) -> f64 {
    libm::atan2(norm(cross(left, right)), dot(left, right))
}

/// A Hamilton quaternion, scalar first. As a rotation it takes coordinates from one frame to
/// another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quaternion {
    /// Scalar part.
    pub w: f64,
    /// First component of the vector part.
    pub x: f64,
    /// Second component of the vector part.
    pub y: f64,
    /// Third component of the vector part.
    pub z: f64,
}

impl Quaternion {
    /// The rotation that changes nothing.
    pub const IDENTITY: Self = Self::new(1.0, 0.0, 0.0, 0.0);

    /// From scalar and vector parts.
    #[must_use]
    pub const fn new(w: f64, x: f64, y: f64, z: f64) -> Self {
        Self { w, x, y, z }
    }

    /// The rotation by `norm(vector)` radians about `vector`.
    #[must_use]
    pub fn from_rotation_vector(vector: Vector) -> Self {
        let half = 0.5 * norm(vector);
        // sin(x)/x by its series where the quotient would lose digits.
        let sinc = if half < 1e-4 {
            1.0 - half * half / 6.0
        } else {
            libm::sin(half) / half
        };
        let [x, y, z] = scale(vector, 0.5 * sinc);
        Self::new(libm::cos(half), x, y, z)
    }

    /// The rotation vector of the shorter way, in radians.
    #[must_use]
    pub fn to_rotation_vector(self) -> Vector {
        let shorter = if self.w < 0.0 {
            self.scaled(-1.0)
        } else {
            self
        };
        let vector = [shorter.x, shorter.y, shorter.z];
        let sine = norm(vector);
        if sine < 1e-12 {
            return scale(vector, 2.0);
        }
        scale(vector, 2.0 * libm::atan2(sine, shorter.w) / sine)
    }

    /// From yaw, then pitch, then roll about the moving axes (the aerospace sequence), in radians.
    #[must_use]
    pub fn from_euler(roll: f64, pitch: f64, yaw: f64) -> Self {
        let about = |axis: usize, angle: f64| {
            let mut vector = [0.0; 3];
            vector[axis] = angle;
            Self::from_rotation_vector(vector)
        };
        about(2, yaw)
            .multiply(about(1, pitch))
            .multiply(about(0, roll))
    }

    /// Roll, pitch and yaw in degrees, of a body → earth attitude.
    #[must_use]
    pub fn to_euler_degrees(self) -> [f64; 3] {
        let Self { w, x, y, z } = self;
        let roll = libm::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
        let pitch = libm::asin((2.0 * (w * y - z * x)).clamp(-1.0, 1.0));
        let yaw = libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
        [roll, pitch, yaw].map(f64::to_degrees)
    }

    /// From an orthonormal matrix with determinant +1 (Shepperd's method: divide by the largest
    /// part).
    #[must_use]
    pub fn from_matrix(m: [Vector; 3]) -> Self {
        let squares = [
            1.0 + m[0][0] + m[1][1] + m[2][2],
            1.0 + m[0][0] - m[1][1] - m[2][2],
            1.0 - m[0][0] + m[1][1] - m[2][2],
            1.0 - m[0][0] - m[1][1] + m[2][2],
        ];
        let largest = (0..4).fold(0, |best, index| {
            if squares[index] > squares[best] {
                index
            } else {
                best
            }
        });
        let (xy, xz, yz) = (m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]);
        let (wx, wy, wz) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
        match largest {
            0 => Self::new(squares[0], wx, wy, wz),
            1 => Self::new(wx, squares[1], xy, xz),
            2 => Self::new(wy, xy, squares[2], yz),
            _ => Self::new(wz, xz, yz, squares[3]),
        }
        .normalized()
    }

    /// The product `self ⊗ other`: first `other`, then `self`.
    #[must_use]
    pub fn multiply(self, other: Self) -> Self {
        let (a, b) = (self, other);
        Self::new(
            a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        )
    }

    /// The opposite rotation.
    #[must_use]
    pub fn conjugate(self) -> Self {
        Self::new(self.w, -self.x, -self.y, -self.z)
    }

    /// Every component times `factor`.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self::new(
            self.w * factor,
            self.x * factor,
            self.y * factor,
            self.z * factor,
        )
    }

    /// Length in four dimensions; 1 for a rotation.
    #[must_use]
    pub fn norm(self) -> f64 {
        self.dot(self).sqrt()
    }

    /// Scalar product in four dimensions.
    #[must_use]
    pub fn dot(self, other: Self) -> f64 {
        self.w * other.w + self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// The rotation in the same direction of the four-dimensional space, with length 1.
    #[must_use]
    pub fn normalized(self) -> Self {
        self.scaled(1.0 / self.norm())
    }

    /// `vector` in the frame that the rotation leads to.
    #[must_use]
    pub fn rotate(self, vector: Vector) -> Vector {
        let axis = [self.x, self.y, self.z];
        let doubled = scale(cross(axis, vector), 2.0);
        add(add(vector, scale(doubled, self.w)), cross(axis, doubled))
    }

    /// Great-circle interpolation (Shoemake 1985) the shorter way, `self` at share 0 and `end` at
    /// share 1.
    #[must_use]
    pub fn slerp(self, end: Self, share: f64) -> Self {
        let turn = self.conjugate().multiply(end).to_rotation_vector();
        self.multiply(Self::from_rotation_vector(scale(turn, share)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn close(left: Vector, right: Vector) -> bool {
        norm(subtract(left, right)) < 1e-12
    }

    #[test]
    fn angles_survive_being_an_attitude() {
        for (roll, pitch, yaw) in [(0.3, -0.7, 2.9), (-3.0, 1.2, -0.4), (0.0, 0.0, 0.0)] {
            let degrees = Quaternion::from_euler(roll, pitch, yaw).to_euler_degrees();
            for (found, expected) in degrees.into_iter().zip([roll, pitch, yaw]) {
                assert!((found - f64::to_degrees(expected)).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y() {
        let turn = Quaternion::from_rotation_vector([0.0, 0.0, FRAC_PI_2]);
        assert!(close(turn.rotate([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]));
        assert!(close(
            turn.conjugate().rotate([0.0, 1.0, 0.0]),
            [1.0, 0.0, 0.0]
        ));
    }

    #[test]
    fn the_product_applies_the_right_factor_first() {
        let about_x = Quaternion::from_rotation_vector([FRAC_PI_2, 0.0, 0.0]);
        let about_z = Quaternion::from_rotation_vector([0.0, 0.0, FRAC_PI_2]);
        let vector = [0.3, -0.2, 0.9];
        assert!(close(
            about_z.multiply(about_x).rotate(vector),
            about_z.rotate(about_x.rotate(vector))
        ));
        assert!(!close(
            about_z.multiply(about_x).rotate(vector),
            about_x.rotate(about_z.rotate(vector))
        ));
    }

    #[test]
    fn a_rotation_vector_survives_the_round_trip() {
        for vector in [
            [0.1, -0.2, 0.3],
            [1e-6, 2e-6, -3e-6],
            [0.0, 3.1, 0.0],
            [0.0, 0.0, 0.0],
        ] {
            let back = Quaternion::from_rotation_vector(vector).to_rotation_vector();
            assert!(close(back, vector), "{vector:?} became {back:?}");
        }
    }

    #[test]
    fn a_matrix_becomes_the_quaternion_that_rotates_alike() {
        // One case for each of the four branches.
        for vector in [
            [0.2, 0.1, -0.3],
            [PI, 0.0, 0.0],
            [0.0, 3.0, 0.1],
            [0.1, 0.0, 3.1],
        ] {
            let expected = Quaternion::from_rotation_vector(vector);
            let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
                .map(|axis| expected.rotate(axis));
            let matrix = [0, 1, 2].map(|row| [columns[0][row], columns[1][row], columns[2][row]]);
            let found = Quaternion::from_matrix(matrix);
            assert!(
                close(
                    found.rotate([0.3, 0.5, -0.7]),
                    expected.rotate([0.3, 0.5, -0.7])
                ),
                "{vector:?}"
            );
        }
    }

    #[test]
    fn euler_angles_have_the_aerospace_signs() {
        // Nose up lifts the nose: its direction has a negative down component.
        let nose = Quaternion::from_euler(0.0, 0.3, 0.0).rotate([1.0, 0.0, 0.0]);
        assert!(nose[2] < -0.29);
        // Right wing down: the right wing's direction has a positive down component.
        let wing = Quaternion::from_euler(0.3, 0.0, 0.0).rotate([0.0, 1.0, 0.0]);
        assert!(wing[2] > 0.29);
        // Yaw is clockwise from above: north goes towards east.
        let heading = Quaternion::from_euler(0.0, 0.0, 0.3).rotate([1.0, 0.0, 0.0]);
        assert!(heading[1] > 0.29);
    }

    #[test]
    fn slerp_turns_at_a_constant_rate_the_shorter_way() {
        let start = Quaternion::from_rotation_vector([0.1, 0.2, 0.3]);
        let end = start
            .multiply(Quaternion::from_rotation_vector([0.0, 1.2, 0.0]))
            .scaled(-1.0);
        let part = start
            .conjugate()
            .multiply(start.slerp(end, 0.25))
            .to_rotation_vector();
        assert!(close(part, [0.0, 0.3, 0.0]), "{part:?}");
    }

    #[test]
    fn small_angles_are_measured_exactly() {
        let tilted = Quaternion::from_rotation_vector([1e-7, 0.0, 0.0]).rotate([0.0, 0.0, 1.0]);
        assert!((angle_between([0.0, 0.0, 1.0], tilted) - 1e-7).abs() < 1e-15);
    }
}
