//! Rotations: vectors, quaternions, Euler angles, and the two frames they connect.
//!
//! Body axes are forward, right, down (FRD); earth axes are north, east, down (NED), where north is
//! the heading at start. A [`Quaternion`] turns body coordinates into earth coordinates (Hamilton's
//! convention, scalar first). [`EulerAngles`] are yaw, pitch, roll, turned in that order (Z-Y-X):
//! roll is positive right wing down, pitch nose up, yaw clockwise seen from above.
//!
//! Everything here is total: any bit pattern in gives finite numbers out. Sine and cosine are
//! written out because the ones in `libm` compute in `f64`, which this core emulates.

use core::f32::consts::{FRAC_2_PI, PI, TAU};
use core::ops::{Add, Mul, Neg, Sub};

/// A vector in whatever frame and unit its name says.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Vector3 {
    /// Along the first axis (forward, or north).
    pub x: f32,
    /// Along the second axis (right, or east).
    pub y: f32,
    /// Along the third axis (down).
    pub z: f32,
}

impl Vector3 {
    /// The zero vector.
    pub const ZERO: Self = Self::new(0.0, 0.0, 0.0);

    /// A vector from its components.
    #[inline]
    pub const fn new(x: f32, y: f32, z: f32) -> Self {
        Self { x, y, z }
    }

    /// The vector times a number.
    #[inline]
    pub fn scale(self, factor: f32) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }

    /// The scalar product.
    #[inline]
    pub fn dot(self, other: Self) -> f32 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// The vector product.
    #[inline]
    pub fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// The Euclidean length.
    #[inline]
    pub fn norm(self) -> f32 {
        libm::sqrtf(self.dot(self))
    }

    /// Whether every component is a finite number no larger than `limit`.
    #[inline]
    pub fn is_within(self, limit: f32) -> bool {
        // A NaN fails every comparison, so it fails this one.
        self.x.abs() <= limit && self.y.abs() <= limit && self.z.abs() <= limit
    }
}

impl Add for Vector3 {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y, self.z + other.z)
    }
}

impl Sub for Vector3 {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y, self.z - other.z)
    }
}

impl Neg for Vector3 {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y, -self.z)
    }
}

impl Mul<f32> for Vector3 {
    type Output = Self;

    #[inline]
    fn mul(self, factor: f32) -> Self {
        self.scale(factor)
    }
}

/// Yaw, pitch and roll, turned in that order (Z-Y-X), in radians.
///
/// Pitch lies in [−π/2, π/2], roll and yaw in (−π, π]. At pitch ±π/2 only the sum or difference of
/// roll and yaw is defined; there roll is zero and yaw carries all of it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EulerAngles {
    /// About the forward axis, positive right wing down.
    pub roll_rad: f32,
    /// About the right axis, positive nose up.
    pub pitch_rad: f32,
    /// About the down axis, positive clockwise from above, relative to the heading at start.
    pub yaw_rad: f32,
}

/// A rotation from body to earth coordinates.
///
/// `q` and `−q` are the same rotation. Filters keep the sign continuous from sample to sample, so
/// it may become negative.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Quaternion {
    /// The scalar part.
    pub w: f32,
    /// The first component of the vector part.
    pub x: f32,
    /// The second component of the vector part.
    pub y: f32,
    /// The third component of the vector part.
    pub z: f32,
}

impl Default for Quaternion {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Quaternion {
    /// No rotation: body axes along earth axes.
    pub const IDENTITY: Self = Self::new(1.0, 0.0, 0.0, 0.0);

    /// A quaternion from its components, as they are.
    #[inline]
    pub const fn new(w: f32, x: f32, y: f32, z: f32) -> Self {
        Self { w, x, y, z }
    }

    /// The rotation about `rotation_rad` by its length.
    pub fn from_rotation_vector(rotation_rad: Vector3) -> Self {
        let half = rotation_rad.scale(0.5);
        let squared = half.dot(half);
        if squared < 0.0625 {
            // The series of cos(h) and sin(h)/h to h⁶: below h = 1/4 the rest is under 1e-9.
            let w = 1.0 - squared * (1.0 / 2.0 - squared * (1.0 / 24.0 - squared / 720.0));
            let s = 1.0 - squared * (1.0 / 6.0 - squared * (1.0 / 120.0 - squared / 5040.0));
            return Self::new(w, half.x * s, half.y * s, half.z * s);
        }
        let norm = libm::sqrtf(squared);
        if !norm.is_finite() {
            return Self::IDENTITY;
        }
        let (sine, cosine) = sine_cosine(norm);
        let s = sine / norm;
        Self::new(cosine, half.x * s, half.y * s, half.z * s)
    }

    /// The rotation whose yaw, pitch and roll are `angles`.
    pub fn from_euler(angles: EulerAngles) -> Self {
        let (sr, cr) = sine_cosine(0.5 * angles.roll_rad);
        let (sp, cp) = sine_cosine(0.5 * angles.pitch_rad);
        let (sy, cy) = sine_cosine(0.5 * angles.yaw_rad);
        Self::new(
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    }

    /// The angles of this rotation; all zero if it is not a rotation (NaN, infinite or zero).
    pub fn to_euler(self) -> EulerAngles {
        /// Below this cosine of pitch (0.1 millidegree from the pole) roll is only rounding noise.
        const POLE_COSINE: f32 = 2.0e-6;

        let q = self.normalize();
        let down = q.down_in_body();
        let pitch_cosine = libm::sqrtf(down.y * down.y + down.z * down.z);
        // The arctangent keeps its precision at the pole, where an arcsine loses half its digits.
        let pitch_rad = libm::atan2f(-down.x, pitch_cosine);
        if pitch_cosine < POLE_COSINE {
            let sine = 2.0 * (q.w * q.z - q.x * q.y);
            let cosine = q.w * q.w - q.x * q.x + q.y * q.y - q.z * q.z;
            return EulerAngles {
                roll_rad: 0.0,
                pitch_rad,
                yaw_rad: wrap_pi(libm::atan2f(sine, cosine)),
            };
        }
        let yaw_sine = 2.0 * (q.x * q.y + q.w * q.z);
        let yaw_cosine = q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z;
        EulerAngles {
            roll_rad: wrap_pi(libm::atan2f(down.y, down.z)),
            pitch_rad,
            yaw_rad: wrap_pi(libm::atan2f(yaw_sine, yaw_cosine)),
        }
    }

    /// This rotation after `other`: body coordinates go through `other` first.
    #[inline]
    pub fn multiply(self, other: Self) -> Self {
        Self::new(
            self.w * other.w - self.x * other.x - self.y * other.y - self.z * other.z,
            self.w * other.x + self.x * other.w + self.y * other.z - self.z * other.y,
            self.w * other.y - self.x * other.z + self.y * other.w + self.z * other.x,
            self.w * other.z + self.x * other.y - self.y * other.x + self.z * other.w,
        )
    }

    /// The inverse rotation, earth to body.
    #[inline]
    pub fn conjugate(self) -> Self {
        Self::new(self.w, -self.x, -self.y, -self.z)
    }

    /// Turns a vector in body coordinates into earth coordinates.
    pub fn rotate(self, body: Vector3) -> Vector3 {
        let axis = Vector3::new(self.x, self.y, self.z);
        let twice = axis.cross(body).scale(2.0);
        body + twice.scale(self.w) + axis.cross(twice)
    }

    /// The earth's down direction in body coordinates: which way is gravity.
    #[inline]
    pub fn down_in_body(self) -> Vector3 {
        Vector3::new(
            2.0 * (self.x * self.z - self.w * self.y),
            2.0 * (self.w * self.x + self.y * self.z),
            self.w * self.w - self.x * self.x - self.y * self.y + self.z * self.z,
        )
    }

    /// The four-dimensional scalar product; near ±1 for nearly equal rotations.
    #[inline]
    pub fn dot(self, other: Self) -> f32 {
        self.w * other.w + self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// The same rotation, with the sign nearest to `reference`.
    #[inline]
    pub fn with_sign_of(self, reference: Self) -> Self {
        if self.dot(reference) < 0.0 {
            Self::new(-self.w, -self.x, -self.y, -self.z)
        } else {
            self
        }
    }

    /// The same rotation at unit length; the identity if there is none (NaN, infinite or zero).
    pub fn normalize(self) -> Self {
        let squared = self.dot(self);
        let error = squared - 1.0;
        if error.abs() < 1.0e-3 {
            // One Newton step of 1/√(1 + e) about e = 0; what it leaves is below e² = 1e-6.
            return self.scale(1.0 - 0.5 * error);
        }
        if (1.0e-30..1.0e30).contains(&squared) {
            return self.scale(1.0 / libm::sqrtf(squared));
        }
        self.normalize_extreme()
    }

    /// [`normalize`](Self::normalize) where the square of the length leaves the range of `f32`.
    #[cold]
    fn normalize_extreme(self) -> Self {
        let largest = self
            .w
            .abs()
            .max(self.x.abs())
            .max(self.y.abs())
            .max(self.z.abs());
        let is_finite =
            self.w.is_finite() && self.x.is_finite() && self.y.is_finite() && self.z.is_finite();
        if !is_finite || largest < f32::MIN_POSITIVE {
            return Self::IDENTITY;
        }
        // Division, not the reciprocal, because the reciprocal of the smallest numbers overflows.
        let q = Self::new(
            self.w / largest,
            self.x / largest,
            self.y / largest,
            self.z / largest,
        );
        q.scale(1.0 / libm::sqrtf(q.dot(q)))
    }

    #[inline]
    fn scale(self, factor: f32) -> Self {
        Self::new(
            self.w * factor,
            self.x * factor,
            self.y * factor,
            self.z * factor,
        )
    }
}

/// The same angle in (−π, π], in radians; zero if `angle_rad` is not finite.
///
/// The interval is that of `f32`: π is its nearest `f32`, which is included, and its negative is not.
pub fn wrap_pi(angle_rad: f32) -> f32 {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    if !angle_rad.is_finite() {
        return 0.0;
    }
    let within_a_turn = libm::fmodf(angle_rad, TAU);
    if within_a_turn > PI {
        within_a_turn - TAU
    } else if within_a_turn <= -PI {
        within_a_turn + TAU
    } else {
        within_a_turn
    }
}

/// Sine and cosine of an angle in radians; those of zero if it is not finite.
///
/// The error is below 2e-7 for angles up to 10 000 rad; beyond that it grows to that of reducing
/// the angle by a rounded turn.
pub fn sine_cosine(angle_rad: f32) -> (f32, f32) {
    /// π/2 in three parts; the first two have so few bits that their multiples are exact.
    const QUARTER_TURN: [f32; 3] = [1.570_312_5, 4.837_513e-4, 7.549_79e-8];

    let angle = if angle_rad.abs() <= 1.0e4 {
        angle_rad
    } else {
        wrap_pi(angle_rad)
    };
    let rounding = if angle < 0.0 { -0.5 } else { 0.5 };
    let quadrant = (angle * FRAC_2_PI + rounding) as i32;
    let turns = quadrant as f32;
    let [first, second, third] = QUARTER_TURN;
    let r = ((angle - turns * first) - turns * second) - turns * third;

    // Taylor series on [−π/4, π/4]; the first terms left out are below 2e-9 and 3e-8.
    let r2 = r * r;
    let sine = r - r * r2 * (1.0 / 6.0 - r2 * (1.0 / 120.0 - r2 * (1.0 / 5040.0 - r2 / 362_880.0)));
    let cosine = 1.0 - r2 * (0.5 - r2 * (1.0 / 24.0 - r2 * (1.0 / 720.0 - r2 / 40_320.0)));

    match quadrant & 3 {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}
