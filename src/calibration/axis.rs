//! Sensor axes, with and without a sign.

use core::fmt;
use core::str::FromStr;

use crate::attitude::Vector3;

/// Axis of the sensor.
///
/// ```
/// use aplomb::calibration::Axis;
///
/// assert_eq!("y".parse(), Ok(Axis::Y));
/// assert_eq!(Axis::Y.to_string(), "y");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Axis {
    /// X, printed as an arrow on many boards.
    X,
    /// Y, in the plane of the chip.
    Y,
    /// Z, out of the chip's face.
    Z,
}

impl Axis {
    /// Every axis, in order.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    /// Returns the letter: `x`, `y` or `z`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
        }
    }

    /// Returns the direction along the axis.
    pub const fn positive(self) -> SignedAxis {
        SignedAxis::new(self, false)
    }

    /// Returns the direction against the axis.
    pub const fn negative(self) -> SignedAxis {
        SignedAxis::new(self, true)
    }

    /// Returns the component of a vector in sensor axes along this axis.
    #[inline]
    pub const fn component(self, vector: Vector3) -> f32 {
        match self {
            Self::X => vector.x,
            Self::Y => vector.y,
            Self::Z => vector.z,
        }
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl FromStr for Axis {
    type Err = ParseAxisError;

    /// Parses the letter of an axis: `x`, `y` or `z`.
    fn from_str(text: &str) -> Result<Self, ParseAxisError> {
        Self::ALL
            .into_iter()
            .find(|axis| axis.name() == text)
            .ok_or(ParseAxisError(()))
    }
}

/// Text that names no [`Axis`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParseAxisError(());

impl fmt::Display for ParseAxisError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("an axis is x, y or z")
    }
}

impl core::error::Error for ParseAxisError {}

/// Direction along or against a sensor axis. Its text is the sign and the letter, such as `-z`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SignedAxis {
    /// Axis.
    pub axis: Axis,
    /// True if the direction is against the axis.
    pub is_negative: bool,
}

impl SignedAxis {
    pub(super) const fn new(axis: Axis, is_negative: bool) -> Self {
        Self { axis, is_negative }
    }

    /// Parses a sign and a letter.
    pub(super) const fn parse(sign: u8, axis: u8) -> Option<Self> {
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

    /// Returns the component of a vector in sensor axes along this direction.
    #[inline]
    pub fn component(self, vector: Vector3) -> f32 {
        let component = self.axis.component(vector);
        if self.is_negative {
            -component
        } else {
            component
        }
    }

    /// Returns the unit vector of this direction in sensor axes.
    pub fn unit(self) -> Vector3 {
        let length = if self.is_negative { -1.0 } else { 1.0 };
        match self.axis {
            Axis::X => Vector3::new(length, 0.0, 0.0),
            Axis::Y => Vector3::new(0.0, length, 0.0),
            Axis::Z => Vector3::new(0.0, 0.0, length),
        }
    }
}

impl fmt::Display for SignedAxis {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(if self.is_negative { "-" } else { "+" })?;
        formatter.write_str(self.axis.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_read_back_from_its_letter() {
        for axis in Axis::ALL {
            assert_eq!(axis.to_string().parse(), Ok(axis));
            assert_eq!(axis.negative().to_string(), format!("-{axis}"));
        }
        for text in ["", "X", "+x", "w", "xy"] {
            let error = text.parse::<Axis>().expect_err(text);
            assert_eq!(error.to_string(), "an axis is x, y or z");
        }
    }

    #[test]
    fn a_direction_has_its_unit_vector_and_component() {
        let vector = Vector3::new(1.0, 2.0, 3.0);
        for (index, axis) in Axis::ALL.into_iter().enumerate() {
            for (direction, sign) in [(axis.positive(), 1.0), (axis.negative(), -1.0)] {
                let expected = sign * (index + 1) as f32;
                assert_eq!(direction.component(vector), expected);
                assert_eq!(direction.unit().dot(vector), expected);
            }
        }
    }
}
