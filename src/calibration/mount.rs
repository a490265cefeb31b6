//! How the chip sits in the vehicle: one of the 24 ways to lay three axes along three others.
//!
//! A mount names where the body's forward and down axes point in sensor axes, in that order:
//! `+x-z` says that forward is the sensor's +X and down is its −Z, which is a chip lying face up.
//! The right axis follows, so a mount is always a proper rotation.

use crate::attitude::Vector3;
use crate::state::Exchange;

/// A mounting, sensor axes to body axes. The default is [`Z_UP`](Self::Z_UP).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Mount {
    forward: Direction,
    right: Direction,
    down: Direction,
}

/// The 24 names, in the order of [`Mount::ALL`].
const NAMES: [&str; 24] = [
    "+x+y", "+x-y", "+x+z", "+x-z", "-x+y", "-x-y", "-x+z", "-x-z", "+y+x", "+y-x", "+y+z", "+y-z",
    "-y+x", "-y-x", "-y+z", "-y-z", "+z+x", "+z-x", "+z+y", "+z-y", "-z+x", "-z-x", "-z+y", "-z-y",
];

impl Mount {
    /// Chip face up, X forward (`+x-z`): body = (x, −y, −z).
    pub const Z_UP: Self = Self::from_axes(
        Direction::new(Axis::X, false),
        Direction::new(Axis::Z, true),
    );

    /// Chip face down, X forward (`+x+z`): body = sensor. The classic mounting.
    pub const Z_DOWN: Self = Self::from_axes(
        Direction::new(Axis::X, false),
        Direction::new(Axis::Z, false),
    );

    /// Every mount.
    pub const ALL: [Self; 24] = {
        let mut all = [Self::Z_UP; 24];
        let mut index = 0;
        while index < all.len() {
            all[index] = match Self::parse(NAMES[index]) {
                Some(mount) => mount,
                None => panic!("a name in the table is not one"),
            };
            index += 1;
        }
        all
    };

    /// The mount of this name, for instance `+x-z`, or an alias: `z-up`, `z-down`.
    ///
    /// Works in constants, so a firmware's mount can come from its environment at compile time.
    pub const fn parse(name: &str) -> Option<Self> {
        match name.as_bytes() {
            b"z-up" => Some(Self::Z_UP),
            b"z-down" => Some(Self::Z_DOWN),
            &[forward_sign, forward_axis, down_sign, down_axis] => {
                let forward = Direction::parse(forward_sign, forward_axis);
                let down = Direction::parse(down_sign, down_axis);
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

    /// The name, without aliases.
    pub fn name(self) -> &'static str {
        NAMES
            .into_iter()
            .zip(Self::ALL)
            .find_map(|(name, mount)| (mount == self).then_some(name))
            .unwrap_or("+x-z")
    }

    /// Is shown to `state`, or set by it.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        let mount = *self;
        let mut index = Self::ALL
            .iter()
            .position(|known| *known == mount)
            .unwrap_or(0);
        state.index(&mut index, Self::ALL.len());
        if let Some(mount) = Self::ALL.get(index) {
            *self = *mount;
        }
    }

    /// Turns a vector in sensor axes into body axes.
    #[inline]
    pub fn to_body(self, sensor: Vector3) -> Vector3 {
        Vector3::new(
            self.forward.of(sensor),
            self.right.of(sensor),
            self.down.of(sensor),
        )
    }

    /// Turns a vector in body axes into sensor axes.
    pub fn to_sensor(self, body: Vector3) -> Vector3 {
        self.forward.unit().scale(body.x)
            + self.right.unit().scale(body.y)
            + self.down.unit().scale(body.z)
    }

    /// Completes the two axes of a name; they are never parallel.
    const fn from_axes(forward: Direction, down: Direction) -> Self {
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
            right: Direction::new(axis, is_negative),
            down,
        }
    }
}

impl Default for Mount {
    fn default() -> Self {
        Self::Z_UP
    }
}

impl core::fmt::Debug for Mount {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(formatter, "Mount({})", self.name())
    }
}

impl core::fmt::Display for Mount {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.pad(self.name())
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Mount {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        defmt::write!(formatter, "{=str}", self.name());
    }
}

/// A signed sensor axis.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Direction {
    axis: Axis,
    is_negative: bool,
}

/// An axis of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Axis {
    /// Printed as an arrow on many boards.
    X,
    /// Across it.
    Y,
    /// Out of the chip's face.
    Z,
}

impl Axis {
    /// All of them, in order.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    /// Its letter.
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }
}

impl core::fmt::Display for Axis {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.pad(self.name())
    }
}

impl Direction {
    const fn new(axis: Axis, is_negative: bool) -> Self {
        Self { axis, is_negative }
    }

    const fn parse(sign: u8, axis: u8) -> Option<Self> {
        let is_negative = match sign {
            b'+' => false,
            b'-' => true,
            _ => return None,
        };
        let axis = match axis {
            b'x' => Axis::X,
            b'y' => Axis::Y,
            b'z' => Axis::Z,
            _ => return None,
        };
        Some(Self::new(axis, is_negative))
    }

    /// The component of a sensor vector along this direction.
    #[inline]
    fn of(self, sensor: Vector3) -> f32 {
        let component = match self.axis {
            Axis::X => sensor.x,
            Axis::Y => sensor.y,
            Axis::Z => sensor.z,
        };
        if self.is_negative {
            -component
        } else {
            component
        }
    }

    fn unit(self) -> Vector3 {
        let length = if self.is_negative { -1.0 } else { 1.0 };
        match self.axis {
            Axis::X => Vector3::new(length, 0.0, 0.0),
            Axis::Y => Vector3::new(0.0, length, 0.0),
            Axis::Z => Vector3::new(0.0, 0.0, length),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const X: Vector3 = Vector3::new(1.0, 0.0, 0.0);
    const Y: Vector3 = Vector3::new(0.0, 1.0, 0.0);
    const Z: Vector3 = Vector3::new(0.0, 0.0, 1.0);

    #[test]
    fn the_named_mounts_are_what_they_say() {
        let v = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(Mount::Z_UP.to_body(v), Vector3::new(1.0, -2.0, -3.0));
        assert_eq!(Mount::Z_DOWN.to_body(v), v);
        assert_eq!(Mount::default(), Mount::Z_UP);
        assert_eq!(Mount::parse("z-up"), Some(Mount::Z_UP));
        assert_eq!(Mount::parse("z-down"), Some(Mount::Z_DOWN));
        assert_eq!(Mount::parse("+x-z"), Some(Mount::Z_UP));
        assert_eq!(Mount::parse("+x+z"), Some(Mount::Z_DOWN));
        // Parsing happens in constants.
        const SIDEWAYS: Mount = match Mount::parse("+y-z") {
            Some(mount) => mount,
            None => panic!(),
        };
        assert_eq!(SIDEWAYS.name(), "+y-z");
        // Forward is the sensor's Y and down its −Z, so right is the sensor's X.
        assert_eq!(SIDEWAYS.to_body(v), Vector3::new(2.0, 1.0, -3.0));
    }

    #[test]
    fn a_name_says_where_forward_and_down_point() {
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
                assert_eq!(mount.to_sensor(body), expected, "{mount}");
                assert_eq!(mount.to_body(expected), body, "{mount}");
            }
        }
    }

    #[test]
    fn there_are_24_distinct_proper_rotations() {
        for (index, mount) in Mount::ALL.into_iter().enumerate() {
            assert_eq!(Mount::ALL.iter().position(|m| *m == mount), Some(index));
            assert_eq!(Mount::parse(mount.name()), Some(mount));
            let [x, y, z] = [X, Y, Z].map(|axis| mount.to_body(axis));
            assert_eq!(x.cross(y).dot(z), 1.0, "{mount}");
            for axis in [X, Y, Z] {
                assert_eq!(mount.to_sensor(mount.to_body(axis)), axis, "{mount}");
            }
        }
    }

    #[test]
    fn what_is_not_a_mount_is_refused() {
        for name in [
            "", "z", "+x", "+x+x", "+x-x", "-z+z", "+x-w", "x-z", "+X-Z", "+x-z ", " +x-z", "*x-z",
            "+x*z", "z-UP", "+x-y+z",
        ] {
            assert_eq!(Mount::parse(name), None, "{name}");
        }
    }
}
