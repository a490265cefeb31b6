//! The flags that travel with every attitude, and the watch for data that no longer change.

use core::fmt;
use core::ops::{BitOr, BitOrAssign};

use crate::state::Exchange;

/// What there is to say about a sample; none set means that all is well.
///
/// As text it is the names joined by `|`, empty if none is set.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Flags(u16);

impl Flags {
    /// Nothing to report.
    pub const NONE: Self = Self(0);
    /// The gyroscope's offset is not known yet. Where a start-up average looks for it, offsets are not
    /// removed until it is complete, and then yaw starts over.
    pub const CALIBRATING: Self = Self(1 << 0);
    /// The sensor moved during the start-up average, which restarts with the next sample.
    pub const MOVED: Self = Self(1 << 1);
    /// Data-ready edges before this sample gave none.
    pub const MISSED: Self = Self(1 << 2);
    /// More than half a second without samples: roll and pitch started again from gravity.
    pub const GAP: Self = Self(1 << 3);
    /// The sample's time is not after the one before; the attitude is held.
    pub const TIME: Self = Self(1 << 4);
    /// A gyroscope axis reads full scale.
    pub const GYROSCOPE_SATURATED: Self = Self(1 << 5);
    /// An accelerometer axis reads full scale.
    pub const ACCELEROMETER_SATURATED: Self = Self(1 << 6);
    /// Too little specific force to tell where down is; the gyroscope alone was used.
    pub const FREE_FALL: Self = Self(1 << 7);
    /// The sensor repeats itself to the last bit: it sleeps, or the bus returns a stuck level.
    pub const FROZEN: Self = Self(1 << 8);
    /// The sample was not a measurement and was ignored.
    pub const REJECTED: Self = Self(1 << 9);

    /// Every flag with its name.
    pub const NAMES: [(Self, &'static str); 10] = [
        (Self::CALIBRATING, "CALIBRATING"),
        (Self::MOVED, "MOVED"),
        (Self::MISSED, "MISSED"),
        (Self::GAP, "GAP"),
        (Self::TIME, "TIME"),
        (Self::GYROSCOPE_SATURATED, "GYROSCOPE_SATURATED"),
        (Self::ACCELEROMETER_SATURATED, "ACCELEROMETER_SATURATED"),
        (Self::FREE_FALL, "FREE_FALL"),
        (Self::FROZEN, "FROZEN"),
        (Self::REJECTED, "REJECTED"),
    ];

    /// The bits, as they lie in memory.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Flags from bits as they lie in memory.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// Whether every flag of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether none is set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// These flags, and those of `other` if `condition` holds.
    #[must_use]
    pub const fn with(self, other: Self, condition: bool) -> Self {
        // Without a branch, since this runs for every flag of every sample.
        Self(self.0 | (other.0 * condition as u16))
    }

    /// Flags from names joined by `|`; `None` if one is unknown.
    pub fn parse(text: &str) -> Option<Self> {
        if text.is_empty() {
            return Some(Self::NONE);
        }
        text.split('|').try_fold(Self::NONE, |flags, name| {
            Self::NAMES
                .iter()
                .find(|(_, known)| *known == name)
                .map(|(flag, _)| flags | *flag)
        })
    }
}

impl BitOr for Flags {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Flags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl fmt::Display for Flags {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let set = Self::NAMES.iter().filter(|(flag, _)| self.contains(*flag));
        for (index, (_, name)) in set.enumerate() {
            if index > 0 {
                formatter.write_str("|")?;
            }
            formatter.write_str(name)?;
        }
        Ok(())
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Flags {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        let set = Self::NAMES.iter().filter(|(flag, _)| self.contains(*flag));
        for (index, (_, name)) in set.enumerate() {
            let separator = if index > 0 { "|" } else { "" };
            defmt::write!(formatter, "{=str}{=str}", separator, name);
        }
    }
}

/// Notices data that do not change: with 16 bits and the sensor's noise on six axes, even a sensor
/// bolted down does not repeat itself for long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FreezeWatch {
    last: [u8; 14],
    repeats: u8,
}

impl FreezeWatch {
    /// This many repeats in a row (0.1 s at 1 kHz) are a frozen sensor.
    pub const REPEATS: u8 = 100;

    /// A watch that has seen nothing.
    pub const fn new() -> Self {
        Self {
            last: [0; 14],
            repeats: 0,
        }
    }

    /// Walks through everything it remembers.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        state.bytes(&mut self.last);
        state.byte(&mut self.repeats);
    }

    /// Takes a sample's bytes; true while they are frozen.
    pub fn update(&mut self, bytes: &[u8; 14]) -> bool {
        if *bytes == self.last {
            self.repeats = self.repeats.saturating_add(1);
        } else {
            self.last = *bytes;
            self.repeats = 0;
        }
        self.repeats >= Self::REPEATS
    }
}

impl Default for FreezeWatch {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_joined_and_read_back() {
        assert_eq!(Flags::NONE.to_string(), "");
        let flags = Flags::MOVED | Flags::CALIBRATING;
        assert_eq!(flags.to_string(), "CALIBRATING|MOVED");
        for bits in 0..1 << Flags::NAMES.len() {
            let flags = Flags::from_bits(bits);
            assert_eq!(Flags::parse(&flags.to_string()), Some(flags));
        }
        assert_eq!(Flags::parse("MOVED|"), None);
        assert_eq!(Flags::parse("moved"), None);
    }

    #[test]
    fn every_flag_has_its_own_bit_and_name() {
        let mut seen = Flags::NONE;
        for (flag, name) in Flags::NAMES {
            assert_eq!(flag.bits().count_ones(), 1, "{name}");
            assert!(!seen.contains(flag), "{name}");
            seen |= flag;
        }
        assert_eq!(seen.bits(), (1 << Flags::NAMES.len()) - 1);
    }

    #[test]
    fn a_condition_decides_and_removes_nothing() {
        let flags = Flags::GAP.with(Flags::TIME, true).with(Flags::GAP, false);
        assert_eq!(flags, Flags::GAP | Flags::TIME);
        assert!(!flags.is_empty());
        assert!(!flags.contains(Flags::GAP | Flags::FROZEN));
    }

    #[test]
    fn data_freeze_after_a_hundred_repeats_and_thaw_at_once() {
        let mut watch = FreezeWatch::new();
        let mut bytes = [7; 14];
        for _ in 0..300 {
            bytes[13] ^= 1;
            assert!(!watch.update(&bytes));
        }
        for repeat in 1..=1000 {
            assert_eq!(watch.update(&bytes), repeat >= 100, "{repeat}");
        }
        bytes[0] ^= 1;
        assert!(!watch.update(&bytes));
    }
}
