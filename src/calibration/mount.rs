//! Mounts: how the chip sits in the vehicle, one of the 24 ways to lay three axes along three
//! others.
//!
//! The name of a mount gives the sensor axes along which the body's forward and down axes point, in
//! that order. With `+x-z`, forward is along the sensor's +X and down along its −Z: a chip that
//! lies face up. The right axis follows, so that a mount is always a proper rotation.

use core::fmt;
use core::str::FromStr;

use super::axis::{Axis, SignedAxis};
use crate::attitude::{BodyVector, Vector3};
use crate::serialize::StateVisitor;

/// Rotation from sensor axes to body axes, one of 24. The default is [`Z_UP`](Self::Z_UP).
///
/// ```
/// use aplomb::attitude::{BodyVector, Vector3};
/// use aplomb::calibration::Mount;
///
/// let mount: Mount = "+y-z".parse()?;
/// // Forward is the sensor's Y, down its −Z, so right is the sensor's X.
/// let body = mount.to_body(Vector3::new(1.0, 2.0, 3.0));
/// assert_eq!(body, BodyVector::new(2.0, 1.0, -3.0));
/// # Ok::<(), aplomb::calibration::ParseMountError>(())
/// ```
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Mount {
    forward: SignedAxis,
    right: SignedAxis,
    down: SignedAxis,
}

/// The 24 names, in the order of [`Mount::ALL`].
const NAMES: [&str; 24] = [
    "+x+y", "+x-y", "+x+z", "+x-z", "-x+y", "-x-y", "-x+z", "-x-z", "+y+x", "+y-x", "+y+z", "+y-z",
    "-y+x", "-y-x", "-y+z", "-y-z", "+z+x", "+z-x", "+z+y", "+z-y", "-z+x", "-z-x", "-z+y", "-z-y",
];

impl Mount {
    /// Chip face up, X forward (`+x-z`): body = (x, −y, −z).
    pub const Z_UP: Self = Self::from_axes(Axis::X.positive(), Axis::Z.negative());

    /// Chip face down, X forward (`+x+z`): body = sensor. The classic mounting.
    pub const Z_DOWN: Self = Self::from_axes(Axis::X.positive(), Axis::Z.positive());

    /// Every mount. A stored state holds the index in this array.
    pub const ALL: [Self; 24] = {
        let mut all = [Self::Z_UP; 24];
        let mut index = 0;
        while index < all.len() {
            all[index] = match Self::parse(NAMES[index]) {
                Some(mount) => mount,
                None => panic!("every name in the table is a mount"),
            };
            index += 1;
        }
        all
    };

    /// Parses a name such as `+x-z`, or an alias: `z-up`, `z-down`.
    ///
    /// Works in constants, so that a firmware's mount can come from its environment at compile
    /// time. At run time `str::parse` gives an error with the reason.
    pub const fn parse(name: &str) -> Option<Self> {
        match name.as_bytes() {
            b"z-up" => Some(Self::Z_UP),
            b"z-down" => Some(Self::Z_DOWN),
            &[forward_sign, forward_axis, down_sign, down_axis] => {
                let forward = SignedAxis::parse(forward_sign, forward_axis);
                let down = SignedAxis::parse(down_sign, down_axis);
                match (forward, down) {
                    (Some(forward), Some(down)) if forward.axis as u8 != down.axis as u8 => {
                        Some(Self::from_axes(forward, down))
                    }
                    _ => None,
                }
            }
            _ => None,
        }
    }

    /// Returns the name, never an alias.
    pub fn name(self) -> &'static str {
        NAMES
            .into_iter()
            .zip(Self::ALL)
            .find_map(|(name, mount)| (mount == self).then_some(name))
            .unwrap_or("+x-z")
    }

    /// Visits every field.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let mount = *self;
        let mut index = Self::ALL
            .iter()
            .position(|known| *known == mount)
            .unwrap_or(0);
        visitor.index(&mut index, Self::ALL.len());
        if let Some(mount) = Self::ALL.get(index) {
            *self = *mount;
        }
    }

    /// Rotates a vector from sensor axes to body axes.
    #[inline(never)]
    pub fn to_body(self, sensor: Vector3) -> BodyVector {
        BodyVector::new(
            self.forward.component(sensor),
            self.right.component(sensor),
            self.down.component(sensor),
        )
    }

    /// Rotates a vector from body axes to sensor axes.
    pub fn to_sensor(self, body: BodyVector) -> Vector3 {
        self.forward.unit().scale(body.0.x)
            + self.right.unit().scale(body.0.y)
            + self.down.unit().scale(body.0.z)
    }

    /// Completes two perpendicular axes to a mount.
    const fn from_axes(forward: SignedAxis, down: SignedAxis) -> Self {
        // right = down × forward. Cyclic neighbours (x y, y z, z x) multiply to plus the third.
        let (axis, is_cyclic) = match (down.axis, forward.axis) {
            (Axis::Y, Axis::Z) => (Axis::X, true),
            (Axis::Z, Axis::X) => (Axis::Y, true),
            (Axis::X, Axis::Y) => (Axis::Z, true),
            (Axis::Z, Axis::Y) => (Axis::X, false),
            (Axis::X, Axis::Z) => (Axis::Y, false),
            (_, _) => (Axis::Z, false),
        };
        let is_negative = (down.is_negative != forward.is_negative) == is_cyclic;
        Self {
            forward,
            right: SignedAxis::new(axis, is_negative),
            down,
        }
    }
}

impl Default for Mount {
    fn default() -> Self {
        Self::Z_UP
    }
}

impl FromStr for Mount {
    type Err = ParseMountError;

    /// Parses a name such as `+x-z`, or an alias: `z-up`, `z-down`.
    fn from_str(name: &str) -> Result<Self, ParseMountError> {
        Self::parse(name).ok_or(ParseMountError(()))
    }
}

impl fmt::Debug for Mount {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Mount({})", self.name())
    }
}

impl fmt::Display for Mount {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Mount {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        defmt::write!(formatter, "{=str}", self.name());
    }
}

/// Text that names no [`Mount`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParseMountError(());

impl fmt::Display for ParseMountError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(
            "a mount is the sensor's axes that point forward and down, such as +x-z, or z-up or \
             z-down",
        )
    }
}

impl core::error::Error for ParseMountError {}

#[cfg(test)]
mod tests {
    use super::*;

    const X: Vector3 = Vector3::new(1.0, 0.0, 0.0);
    const Y: Vector3 = Vector3::new(0.0, 1.0, 0.0);
    const Z: Vector3 = Vector3::new(0.0, 0.0, 1.0);

    #[test]
    fn the_named_mounts_have_the_documented_axes() {
        let v = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(Mount::Z_UP.to_body(v), BodyVector::new(1.0, -2.0, -3.0));
        assert_eq!(Mount::Z_DOWN.to_body(v), BodyVector(v));
        assert_eq!(Mount::default(), Mount::Z_UP);
        assert_eq!(Mount::parse("z-up"), Some(Mount::Z_UP));
        assert_eq!("z-down".parse(), Ok(Mount::Z_DOWN));
        assert_eq!(Mount::parse("+x-z"), Some(Mount::Z_UP));
        assert_eq!(Mount::parse("+x+z"), Some(Mount::Z_DOWN));
        // Parsing happens in constants.
        const SIDEWAYS: Mount = match Mount::parse("+y-z") {
            Some(mount) => mount,
            None => panic!(),
        };
        assert_eq!(SIDEWAYS.name(), "+y-z");
        // Forward is the sensor's Y and down its −Z, so right is the sensor's X.
        assert_eq!(SIDEWAYS.to_body(v), BodyVector::new(2.0, 1.0, -3.0));
    }

    #[test]
    fn a_name_gives_the_forward_and_down_axes() {
        for mount in Mount::ALL {
            let name = mount.name().as_bytes();
            for (body, sign, axis) in [(X, name[0], name[1]), (Z, name[2], name[3])] {
                let length = if sign == b'-' { -1.0 } else { 1.0 };
                let expected = match axis {
                    b'x' => X,
                    b'y' => Y,
                    _ => Z,
                }
                .scale(length);
                assert_eq!(mount.to_sensor(BodyVector(body)), expected, "{mount}");
                assert_eq!(mount.to_body(expected), BodyVector(body), "{mount}");
            }
        }
    }

    #[test]
    fn there_are_24_distinct_proper_rotations() {
        for (index, mount) in Mount::ALL.into_iter().enumerate() {
            assert_eq!(Mount::ALL.iter().position(|m| *m == mount), Some(index));
            assert_eq!(mount.to_string().parse(), Ok(mount));
            let [x, y, z] = [X, Y, Z].map(|axis| mount.to_body(axis).0);
            assert_eq!(x.cross(y).dot(z), 1.0, "{mount}");
            for axis in [X, Y, Z] {
                assert_eq!(mount.to_sensor(mount.to_body(axis)), axis, "{mount}");
            }
        }
    }

    #[test]
    fn invalid_mount_names_are_refused() {
        for name in [
            "", "z", "+x", "+x+x", "+x-x", "-z+z", "+x-w", "x-z", "+X-Z", "+x-z ", " +x-z", "*x-z",
            "+x*z", "z-UP", "+x-y+z",
        ] {
            assert_eq!(Mount::parse(name), None, "{name}");
            let error = name.parse::<Mount>().expect_err(name);
            assert!(error.to_string().contains("such as +x-z"), "{error}");
        }
    }
}
