//! Rotations: vectors, quaternions, Euler angles, and the two frames they connect.
//!
//! Body axes are forward, right, down (FRD). Earth axes are north, east, down (NED), where north is
//! the heading at start. A [`Quaternion`] rotates body coordinates to earth coordinates (Hamilton's
//! convention, scalar first). [`EulerAngles`] are yaw, pitch, roll, applied in that order (Z-Y-X):
//! roll is positive right wing down, pitch nose up, yaw clockwise from above.
//!
//! No function panics. [`Quaternion::normalize`] and [`Quaternion::to_euler`] give finite results
//! for any input bits. Sine and cosine are written out because those of `libm` compute in `f64`,
//! which the Cortex-M4F emulates.
//!
//! ```
//! use aplomb::attitude::{EulerAngles, Quaternion, Vector3};
//!
//! let attitude = Quaternion::from_euler(EulerAngles { roll_rad: 0.5, ..EulerAngles::default() });
//! assert!((attitude.to_euler().roll_rad - 0.5).abs() < 1e-6);
//! // Right wing down: gravity has a part to the right.
//! assert!(attitude.down_in_body().y > 0.4);
//! let back = attitude.conjugate().rotate(attitude.rotate(Vector3::new(1.0, 2.0, 3.0)));
//! assert!((back - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-5);
//! ```

use core::f32::consts::{FRAC_2_PI, PI, TAU};
use core::ops::{Add, Mul, Neg, Sub};

/// Vector. The name of a variable gives its frame and unit.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Vector3 {
    /// Component along the first axis (forward, or north).
    pub x: f32,
    /// Component along the second axis (right, or east).
    pub y: f32,
    /// Component along the third axis (down).
    pub z: f32,
}

/// Vector in body axes: forward, right, down. An estimator takes no other.
///
/// A sensor's axes are rarely those of the body, and a wrong sign passes every check: a level body
/// that reports +9.81 m/s² along `down` is upside down, with a roll of 180°.
/// [`Mount::to_body`](crate::calibration::Mount::to_body) converts what a sensor reports.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BodyVector(pub Vector3);

impl BodyVector {
    /// Zero vector.
    pub const ZERO: Self = Self(Vector3::ZERO);

    /// Creates a vector from its components. Level and at rest, the specific force is
    /// `new(0.0, 0.0, -9.81)` in m/s².
    pub const fn new(forward: f32, right: f32, down: f32) -> Self {
        Self(Vector3::new(forward, right, down))
    }
}

impl Vector3 {
    /// Zero vector.
    pub const ZERO: Self = Self::new(0.0, 0.0, 0.0);

    /// Creates a vector from its components.
    #[inline]
    pub const fn new(x: f32, y: f32, z: f32) -> Self {
        Self { x, y, z }
    }

    /// Multiplies the vector by a number.
    #[inline]
    #[must_use]
    pub fn scale(self, factor: f32) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }

    /// Returns the scalar product.
    #[inline]
    pub fn dot(self, other: Self) -> f32 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Returns the vector product.
    #[inline]
    #[must_use]
    pub fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    /// Returns the Euclidean length.
    #[inline]
    pub fn norm(self) -> f32 {
        libm::sqrtf(self.dot(self))
    }

    /// Returns whether every component is finite, with a magnitude of at most `limit`.
    #[inline(never)]
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

impl From<[f32; 3]> for Vector3 {
    /// Takes the components x, y, z.
    #[inline]
    fn from([x, y, z]: [f32; 3]) -> Self {
        Self::new(x, y, z)
    }
}

impl From<Vector3> for [f32; 3] {
    /// Returns the components x, y, z.
    #[inline]
    fn from(vector: Vector3) -> Self {
        [vector.x, vector.y, vector.z]
    }
}

impl From<[f32; 4]> for Quaternion {
    /// Takes the components w, x, y, z, without normalizing them.
    #[inline]
    fn from([w, x, y, z]: [f32; 4]) -> Self {
        Self::new(w, x, y, z)
    }
}

impl From<Quaternion> for [f32; 4] {
    /// Returns the components w, x, y, z.
    #[inline]
    fn from(rotation: Quaternion) -> Self {
        [rotation.w, rotation.x, rotation.y, rotation.z]
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

/// Yaw, pitch and roll, applied in that order (Z-Y-X), in radians.
///
/// Pitch lies in [−π/2, π/2], roll and yaw in (−π, π]. At pitch ±π/2 only the sum or
/// difference of roll and yaw is defined; roll is zero there, and yaw is the sum or difference.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct EulerAngles {
    /// Roll about the forward axis, positive right wing down.
    pub roll_rad: f32,
    /// Pitch about the right axis, positive nose up.
    pub pitch_rad: f32,
    /// Yaw about the down axis, positive clockwise from above, relative to the heading at start.
    pub yaw_rad: f32,
}

/// Rotation from body to earth coordinates.
///
/// `q` and `−q` are the same rotation. Filters keep the sign continuous from sample to sample, so
/// `w` may become negative.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Quaternion {
    /// Scalar part.
    pub w: f32,
    /// First component of the vector part.
    pub x: f32,
    /// Second component of the vector part.
    pub y: f32,
    /// Third component of the vector part.
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

    /// Creates a quaternion from its components, without normalizing it.
    #[inline]
    pub const fn new(w: f32, x: f32, y: f32, z: f32) -> Self {
        Self { w, x, y, z }
    }

    /// Returns the rotation about the direction of `rotation_rad` by its length; the identity if
    /// the length is not finite.
    #[inline]
    pub fn from_rotation_vector(rotation_rad: Vector3) -> Self {
        let half = rotation_rad.scale(0.5);
        let squared = half.dot(half);
        if squared < 0.16 {
            // The series of cos(h) and sin(h)/h to h⁶: below h = 0.4 the rest is under 2e-8.
            let w = 1.0 - squared * (1.0 / 2.0 - squared * (1.0 / 24.0 - squared * (1.0 / 720.0)));
            let s =
                1.0 - squared * (1.0 / 6.0 - squared * (1.0 / 120.0 - squared * (1.0 / 5040.0)));
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

    /// Returns the rotation with these angles.
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

    /// Returns the angles of the rotation; all zero if it is none (NaN, infinite or zero).
    ///
    /// With the half angles r, p, y of roll, pitch and yaw,
    ///
    /// ```text
    /// x + z = (cos p − sin p)·sin(r + y)      x − z = (cos p + sin p)·sin(r − y)
    /// w − y = (cos p − sin p)·cos(r + y)      w + y = (cos p + sin p)·cos(r − y)
    /// ```
    ///
    /// Near a pole one factor vanishes, and the other pair still determines the rotation. So the
    /// angles convert back to the rotation at any pitch.
    pub fn to_euler(self) -> EulerAngles {
        /// Below this factor (0.1 millidegree from a pole) its angle is only rounding noise.
        const POLE: f32 = 1.0e-6;

        let q = self.normalize();
        let (sum_sine, sum_cosine) = (q.x + q.z, q.w - q.y);
        let (difference_sine, difference_cosine) = (q.x - q.z, q.w + q.y);
        let sum_factor = libm::sqrtf(sum_sine * sum_sine + sum_cosine * sum_cosine);
        let difference_factor =
            libm::sqrtf(difference_sine * difference_sine + difference_cosine * difference_cosine);
        let mut half_sum = libm::atan2f(sum_sine, sum_cosine);
        let mut half_difference = libm::atan2f(difference_sine, difference_cosine);
        if sum_factor < POLE {
            half_sum = -half_difference;
        } else if difference_factor < POLE {
            half_difference = -half_sum;
        }
        EulerAngles {
            roll_rad: wrap_pi(half_sum + half_difference),
            pitch_rad: 2.0
                * libm::atan2f(
                    difference_factor - sum_factor,
                    difference_factor + sum_factor,
                ),
            yaw_rad: wrap_pi(half_sum - half_difference),
        }
    }

    /// Returns the product: this rotation after `other`.
    #[inline]
    #[must_use]
    pub fn multiply(self, other: Self) -> Self {
        Self::new(
            self.w * other.w - self.x * other.x - self.y * other.y - self.z * other.z,
            self.w * other.x + self.x * other.w + self.y * other.z - self.z * other.y,
            self.w * other.y - self.x * other.z + self.y * other.w + self.z * other.x,
            self.w * other.z + self.x * other.y - self.y * other.x + self.z * other.w,
        )
    }

    /// Returns the inverse rotation, earth to body.
    #[inline]
    #[must_use]
    pub fn conjugate(self) -> Self {
        Self::new(self.w, -self.x, -self.y, -self.z)
    }

    /// Rotates a vector from body to earth coordinates.
    pub fn rotate(self, body: Vector3) -> Vector3 {
        let axis = Vector3::new(self.x, self.y, self.z);
        let twice = axis.cross(body).scale(2.0);
        body + twice.scale(self.w) + axis.cross(twice)
    }

    /// Returns the earth's down direction in body coordinates: the direction of gravity.
    #[inline]
    pub fn down_in_body(self) -> Vector3 {
        Vector3::new(
            2.0 * (self.x * self.z - self.w * self.y),
            2.0 * (self.w * self.x + self.y * self.z),
            self.w * self.w - self.x * self.x - self.y * self.y + self.z * self.z,
        )
    }

    /// Returns the rotation without yaw in which `down` points down.
    ///
    /// `down` is in body axes, of any length but zero. Next to the poles, where the direction does
    /// not show roll, roll is zero.
    ///
    /// ```
    /// use aplomb::attitude::{Quaternion, Vector3};
    ///
    /// // Gravity pulls to the right: the right wing is down.
    /// let angles = Quaternion::from_down(Vector3::new(0.0, 0.5, 0.5)).to_euler();
    /// assert!((angles.roll_rad.to_degrees() - 45.0).abs() < 1e-3);
    /// assert!(angles.pitch_rad.abs() < 1e-6 && angles.yaw_rad.abs() < 1e-6);
    /// ```
    pub fn from_down(down: Vector3) -> Self {
        /// Within 0.6° of a pole the direction does not show roll.
        const MIN_PITCH_COSINE_SQUARED: f32 = 1.0e-4;

        let across_squared = down.y * down.y + down.z * down.z;
        let (cr, sr) = if across_squared > MIN_PITCH_COSINE_SQUARED * down.dot(down) {
            half_angle(down.z, down.y)
        } else {
            (1.0, 0.0)
        };
        let (cp, sp) = half_angle(libm::sqrtf(across_squared), -down.x);
        Self::new(cr * cp, sr * cp, cr * sp, -sr * sp).normalize()
    }

    /// Returns the rows of the rotation matrix of a quaternion with this squared norm. The rows
    /// turn body axes to earth axes: north, east, down.
    #[inline]
    pub(crate) fn matrix_rows(self, squared_norm: f32) -> [Vector3; 3] {
        let Self { w, x, y, z } = self;
        let s = 2.0 / squared_norm;
        let (sx, sy, sz) = (s * x, s * y, s * z);
        [
            Vector3::new(1.0 - (y * sy + z * sz), x * sy - w * sz, x * sz + w * sy),
            Vector3::new(x * sy + w * sz, 1.0 - (x * sx + z * sz), y * sz - w * sx),
            Vector3::new(x * sz - w * sy, y * sz + w * sx, 1.0 - (x * sx + y * sy)),
        ]
    }

    /// Returns the four-dimensional scalar product, near ±1 for nearly equal rotations.
    #[inline]
    pub fn dot(self, other: Self) -> f32 {
        self.w * other.w + self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Returns the rotation with the sign that is nearer to `reference`.
    #[inline]
    #[must_use]
    pub fn with_sign_of(self, reference: Self) -> Self {
        if self.dot(reference) < 0.0 {
            Self::new(-self.w, -self.x, -self.y, -self.z)
        } else {
            self
        }
    }

    /// Returns the rotation at unit length; the identity if it is none (NaN, infinite or zero).
    #[inline(never)]
    #[must_use]
    pub fn normalize(self) -> Self {
        let squared = self.dot(self);
        let error = squared - 1.0;
        if error.abs() < 1.0e-3 {
            // One Newton step of 1/√(1 + e) about e = 0; its error is below e² = 1e-6.
            return self.scale(1.0 - 0.5 * error);
        }
        // The largest component becomes 1, so that no square overflows. A NaN, an infinite or a
        // zero quaternion gives NaN, which fails the comparison.
        let mut largest = 0.0;
        for component in [self.w, self.x, self.y, self.z] {
            if component.abs() > largest {
                largest = component.abs();
            }
        }
        let Self { w, x, y, z } = self;
        let scaled = Self::new(w / largest, x / largest, y / largest, z / largest);
        let squared = scaled.dot(scaled);
        if squared >= 1.0 {
            scaled.scale(1.0 / libm::sqrtf(squared))
        } else {
            Self::IDENTITY
        }
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

/// Wraps an angle to (−π, π], in radians; returns zero if it is not finite.
///
/// The bounds are the `f32` nearest to π, which is included, and its negative, which is not.
pub fn wrap_pi(angle_rad: f32) -> f32 {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    if !angle_rad.is_finite() {
        return 0.0;
    }
    let within_a_turn = remainder_of_turn(angle_rad);
    if within_a_turn > PI {
        within_a_turn - TAU
    } else if within_a_turn <= -PI {
        within_a_turn + TAU
    } else {
        within_a_turn
    }
}

/// Returns the remainder of a finite angle after whole turns, with its sign, exact to the last bit.
///
/// The result is that of `fmodf`, without the 64-bit division of `libm`'s, which takes a kilobyte
/// of flash. Every difference in it is exact.
#[inline(never)]
fn remainder_of_turn(angle_rad: f32) -> f32 {
    let mut rest = angle_rad.abs();
    let mut turns = TAU;
    while turns <= 0.5 * rest {
        turns *= 2.0;
    }
    while turns >= TAU {
        if rest >= turns {
            rest -= turns;
        }
        turns *= 0.5;
    }
    rest.copysign(angle_rad)
}

/// Returns sine and cosine of an angle in radians; those of zero if it is not finite.
///
/// The error is below 2e-7 for angles up to 10 000 rad. Beyond, it grows to the error of reducing
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

/// Returns cosine and sine of half the angle of this direction, times a common factor.
fn half_angle(cosine: f32, sine: f32) -> (f32, f32) {
    let length = libm::sqrtf(cosine * cosine + sine * sine);
    if cosine < 0.0 {
        (sine.abs(), (length - cosine).copysign(sine))
    } else {
        (length + cosine, sine)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEGREE: f32 = PI / 180.0;

    #[test]
    fn the_remainder_of_a_turn_is_that_of_the_library() {
        let mut bits = 0x4000_0000_u32;
        while bits < f32::INFINITY.to_bits() {
            for angle in [f32::from_bits(bits), -f32::from_bits(bits)] {
                let expected = libm::fmodf(angle, TAU);
                assert_eq!(
                    remainder_of_turn(angle).to_bits(),
                    expected.to_bits(),
                    "{angle}"
                );
            }
            bits += 4_099;
        }
        for turns in [1.0, 2.0, 3.0, 64.0, 1e30] {
            assert_eq!(
                remainder_of_turn(turns * TAU),
                libm::fmodf(turns * TAU, TAU)
            );
        }
    }

    fn euler(roll: f32, pitch: f32, yaw: f32) -> EulerAngles {
        EulerAngles {
            roll_rad: roll * DEGREE,
            pitch_rad: pitch * DEGREE,
            yaw_rad: yaw * DEGREE,
        }
    }

    /// The angle between two rotations, in degrees, by their effect on the axes.
    fn angle_between(a: Quaternion, b: Quaternion) -> f32 {
        let difference = a.conjugate().multiply(b).normalize();
        let vector = Vector3::new(difference.x, difference.y, difference.z);
        2.0 * f32::atan2(vector.norm(), difference.w.abs()) / DEGREE
    }

    fn assert_close(a: Vector3, b: Vector3) {
        assert!((a - b).norm() < 1e-6, "{a:?} is not {b:?}");
    }

    const FORWARD: Vector3 = Vector3::new(1.0, 0.0, 0.0);
    const RIGHT: Vector3 = Vector3::new(0.0, 1.0, 0.0);
    const DOWN: Vector3 = Vector3::new(0.0, 0.0, 1.0);

    #[test]
    fn arrays_hold_the_components_in_order() {
        let vector = Vector3::from([1.0, 2.0, 3.0]);
        assert_eq!(vector, Vector3::new(1.0, 2.0, 3.0));
        assert_eq!(<[f32; 3]>::from(vector), [1.0, 2.0, 3.0]);
        let rotation = Quaternion::from([4.0, 1.0, 2.0, 3.0]);
        assert_eq!((rotation.w, rotation.z), (4.0, 3.0));
        assert_eq!(<[f32; 4]>::from(rotation), [4.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn signs_are_those_of_an_aeroplane() {
        // Nose up 30°: the forward axis points above the horizon, which is minus down.
        let q = Quaternion::from_euler(euler(0.0, 30.0, 0.0));
        assert_close(q.rotate(FORWARD), Vector3::new(0.75_f32.sqrt(), 0.0, -0.5));
        // Right wing down: the right axis points below the horizon.
        let q = Quaternion::from_euler(euler(30.0, 0.0, 0.0));
        assert_close(q.rotate(RIGHT), Vector3::new(0.0, 0.75_f32.sqrt(), 0.5));
        // Clockwise from above, from north to east.
        let q = Quaternion::from_euler(euler(0.0, 0.0, 90.0));
        assert_close(q.rotate(FORWARD), RIGHT);
    }

    #[test]
    fn angles_are_turned_in_the_order_yaw_pitch_roll() {
        let q = Quaternion::from_euler(euler(20.0, 30.0, 40.0));
        let about = |axis: Vector3, degrees: f32| {
            Quaternion::from_rotation_vector(axis.scale(degrees * DEGREE))
        };
        let expected = about(DOWN, 40.0)
            .multiply(about(RIGHT, 30.0))
            .multiply(about(FORWARD, 20.0));
        assert!(angle_between(q, expected) < 1e-4);
    }

    #[test]
    fn down_in_body_is_the_inverse_rotation_of_down() {
        let q = Quaternion::from_euler(euler(-50.0, 25.0, 130.0));
        assert_close(q.down_in_body(), q.conjugate().rotate(DOWN));
    }

    #[test]
    fn the_rotation_from_down_has_roll_and_pitch_and_no_yaw() {
        for roll in (-175..=180).step_by(5) {
            for pitch in (-85..=85).step_by(5) {
                let expected = Quaternion::from_euler(euler(roll as f32, pitch as f32, 0.0));
                for length in [1e-3, 9.8, 160.0] {
                    let down = expected.down_in_body().scale(length);
                    let found = Quaternion::from_down(down);
                    assert!(angle_between(found, expected) < 1e-2, "{roll} {pitch}");
                    assert!((found.dot(found) - 1.0).abs() < 1e-6);
                }
            }
        }
        for (x, pitch) in [(1.0, -90.0), (-1.0, 90.0)] {
            for y in [-1e-9, 0.0, 5e-3] {
                let found = Quaternion::from_down(Vector3::new(x, y, 0.0));
                let expected = Quaternion::from_euler(euler(0.0, pitch, 0.0));
                assert!(angle_between(found, expected) < 0.6, "{x} {y}");
            }
        }
    }

    #[test]
    fn sine_and_cosine_agree_with_double_precision() {
        let mut worst: f64 = 0.0;
        for step in -400_000..=400_000 {
            let angle = step as f32 * 0.0249;
            let (sine, cosine) = sine_cosine(angle);
            let exact = f64::from(angle);
            worst = worst
                .max((f64::from(sine) - exact.sin()).abs())
                .max((f64::from(cosine) - exact.cos()).abs());
        }
        assert!(worst < 2.0e-7, "{worst:e}");
    }

    #[test]
    fn sine_and_cosine_are_finite_for_any_input() {
        for angle in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(sine_cosine(angle), (0.0, 1.0));
        }
        for angle in [f32::MAX, f32::MIN, 1.0e4, 1.1e4, f32::MIN_POSITIVE] {
            let (sine, cosine) = sine_cosine(angle);
            assert!((sine * sine + cosine * cosine - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn a_full_turn_of_roll_and_yaw_stays_continuous() {
        let mut last = Quaternion::from_euler(euler(-180.0, 20.0, -180.0));
        for degrees in -180..=180 {
            let angle = degrees as f32;
            let q = Quaternion::from_euler(euler(angle, 20.0, angle)).with_sign_of(last);
            assert!(q.dot(last) > 0.99);
            last = q;
            let angles = q.to_euler();
            let expected = if degrees == -180 { 180.0 } else { angle };
            // At exactly half a turn rounding may choose either end of the interval.
            let error = wrap_pi(angles.roll_rad - expected * DEGREE).abs()
                + wrap_pi(angles.yaw_rad - expected * DEGREE).abs();
            assert!(error < 1e-5, "{degrees}: {angles:?}");
            assert!(angles.roll_rad > -PI && angles.roll_rad <= PI);
            assert!(angles.yaw_rad > -PI && angles.yaw_rad <= PI);
        }
    }

    #[test]
    fn pitch_goes_over_the_top_without_a_jump_in_the_rotation() {
        for tenths in 0..=3600 {
            let tilt = tenths as f32 * 0.1;
            let q = Quaternion::from_rotation_vector(RIGHT.scale(tilt * DEGREE));
            let angles = q.to_euler();
            let expected = (tilt * DEGREE).sin().asin();
            assert!((angles.pitch_rad - expected).abs() < 2e-3, "{tilt}");
            assert!(angles.pitch_rad.abs() <= PI / 2.0 + 1e-6);
            assert!(
                angle_between(Quaternion::from_euler(angles), q) < 1e-3,
                "{tilt}"
            );
        }
    }

    #[test]
    fn pitch_keeps_its_precision_next_to_the_pole() {
        for millidegrees in [1, 2, 5, 10, 100] {
            let pitch = 90.0 - millidegrees as f32 * 1e-3;
            let angles = Quaternion::from_euler(euler(0.0, pitch, 0.0)).to_euler();
            // An arcsine would be wrong by 20 millidegrees here.
            assert!((angles.pitch_rad / DEGREE - pitch).abs() < 1e-4, "{pitch}");
        }
    }

    #[test]
    fn at_the_pole_yaw_holds_the_whole_angle() {
        for (pitch, sign) in [(90.0, -1.0), (-90.0, 1.0)] {
            let q = Quaternion::from_euler(euler(25.0, pitch, 70.0));
            let angles = q.to_euler();
            assert!((angles.pitch_rad / DEGREE - pitch).abs() < 1e-3);
            assert!(angle_between(Quaternion::from_euler(angles), q) < 1e-3);
            assert_eq!(angles.roll_rad, 0.0);
            let total = angles.yaw_rad / DEGREE;
            assert!((total - (70.0 + sign * 25.0)).abs() < 1e-3, "{angles:?}");
        }
    }

    #[test]
    fn small_and_large_rotation_vectors_meet() {
        // On both sides of the series' limit, half an angle of 0.4.
        for angle in [0.799_99_f32, 0.800_01] {
            let q = Quaternion::from_rotation_vector(FORWARD.scale(angle));
            assert!((f64::from(q.w) - (f64::from(angle) / 2.0).cos()).abs() < 1e-7);
            assert!((f64::from(q.x) - (f64::from(angle) / 2.0).sin()).abs() < 1e-7);
        }
        let turn = Quaternion::from_rotation_vector(DOWN.scale(TAU + 0.1));
        let tenth = Quaternion::from_rotation_vector(DOWN.scale(0.1));
        assert!(angle_between(turn, tenth) < 1e-4);
    }

    #[test]
    fn quaternions_that_are_no_rotation_become_the_identity() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for position in 0..4 {
                let mut parts = [0.5; 4];
                parts[position] = bad;
                let [w, x, y, z] = parts;
                let q = Quaternion::new(w, x, y, z);
                assert_eq!(q.normalize(), Quaternion::IDENTITY);
                assert_eq!(q.to_euler(), EulerAngles::default());
            }
            assert_eq!(wrap_pi(bad), 0.0);
            let vector = Vector3::new(bad, 0.0, 0.0);
            assert_eq!(
                Quaternion::from_rotation_vector(vector),
                Quaternion::IDENTITY
            );
        }
        let zero = Quaternion::new(0.0, 0.0, 0.0, 0.0);
        assert_eq!(zero.normalize(), Quaternion::IDENTITY);
    }

    #[test]
    fn any_length_normalizes() {
        let unit = Quaternion::from_euler(euler(10.0, 20.0, 30.0));
        for length in [1e-37, 1e-20, 1e-3, 0.9996, 1.0, 1.0004, 7.0, 1e18, 3e38] {
            let q = unit.scale(length).normalize();
            assert!((q.dot(q) - 1.0).abs() < 2e-6, "{length:e}");
            assert!(angle_between(q, unit) < 1e-3, "{length:e}");
        }
    }

    #[test]
    fn wrapping_keeps_the_interval_half_open() {
        assert_eq!(wrap_pi(PI), PI);
        assert_eq!(wrap_pi(-PI), PI);
        assert_eq!(wrap_pi(TAU), 0.0);
        assert_eq!(wrap_pi(0.5), 0.5);
        assert!((wrap_pi(PI + 0.1) - (0.1 - PI)).abs() < 1e-6);
        assert!((wrap_pi(-PI - 0.1) - (PI - 0.1)).abs() < 1e-6);
    }
}
