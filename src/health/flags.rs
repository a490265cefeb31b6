//! Flags of an attitude, and of the board's conditions.

use core::error::Error;
use core::fmt;
use core::str::FromStr;

bitflags::bitflags! {
    /// State of an attitude. [`Flags::VALID`] alone means no problem.
    ///
    /// As text, the names are joined by `|`; no flag is the empty text.
    ///
    /// ```
    /// use aplomb::health::Flags;
    ///
    /// let flags: Flags = "VALID|MISSED".parse()?;
    /// assert_eq!(flags, Flags::MISSED | Flags::VALID);
    /// assert_eq!(flags.to_string(), "MISSED|VALID");
    /// # Ok::<(), aplomb::health::UnknownFlag>(())
    /// ```
    #[repr(transparent)]
    #[derive(Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct Flags: u32 {
        /// The gyroscope's offset is not known: no rest has shown it yet, or it has changed since.
        /// The reported σ is much larger, so an attitude can be [`Flags::VALID`] all the same.
        const CALIBRATING = 1 << 0;
        /// The sensor moved before its offset was known.
        const MOVED = 1 << 1;
        /// Samples before this one were lost.
        const MISSED = 1 << 2;
        /// No sample came for more than half a second. Roll and pitch restarted from gravity. At
        /// less than 2 samples a second each attitude has this flag, and none is [`Flags::VALID`].
        const GAP = 1 << 3;
        /// The sample's time is not after the previous one. The attitude is held.
        const TIME = 1 << 4;
        /// A gyroscope axis reads full scale.
        const GYROSCOPE_SATURATED = 1 << 5;
        /// An accelerometer axis reads full scale.
        const ACCELEROMETER_SATURATED = 1 << 6;
        /// The specific force is too small to show where down is. Only the gyroscope was used.
        const FREE_FALL = 1 << 7;
        /// The data repeat to the last bit: the sensor sleeps, or the bus returns a stuck level. Or
        /// one axis repeats its value while another moves. The attitude is held.
        const FROZEN = 1 << 8;
        /// The sample was not a measurement and was ignored.
        const REJECTED = 1 << 9;
        /// The tilt is wrong by no more than the larger of 5° and six σ. Only filters with a σ
        /// set it.
        const VALID = 1 << 10;
        /// The attitude is less certain than usual: σ is above 5°, one of [`Flags::DEGRADING`] is
        /// set, or the rate has jumped as if the full scale had changed, which is being checked.
        ///
        /// Alone, σ is the reason, or that check. σ grows in a pause; with an offset that is not
        /// confirmed, such as after a pause in flight; and if samples come more slowly than
        /// [`Config`](crate::mpu6050::Config) says, because each step is then a pause. At the
        /// configured rate 20 samples a second are enough, also in flight.
        const DEGRADED = 1 << 11;
        /// No sample came: the attitude is the last one, and its σ grows.
        const STALE = 1 << 12;
        /// Bursts have failed since the previous sample. Without [`Flags::VALID`] and without
        /// [`Flags::STALE`]: the bus is held after the burst of this sample, whose rates may be
        /// false.
        const BUS_FAULT = 1 << 13;
        /// The sensor had lost its settings, and has been or is being reconfigured.
        const SENSOR_RESET = 1 << 14;
        /// A sample was lost because the attitude task had not finished the previous one.
        const LATE = 1 << 15;
        /// The die is outside −40 °C to 85 °C, the rated range of the datasheet.
        const TEMPERATURE = 1 << 16;
        /// No data-ready edges come. Samples are read by timer, and their time is uncertain by one
        /// period.
        const POLLED = 1 << 17;
        /// The crystal has failed. Times are those of the internal oscillator: accurate to 1 % at
        /// 25 °C, to 8 % over temperature. The attitude goes by the sensor's clock, so the time of
        /// a burst has to be that of its edge, unless [`Flags::POLLED`] is set.
        const INTERNAL_CLOCK = 1 << 18;
        /// The heading from a compass is wrong by no more than the larger of 15° and six σ.
        const HEADING_VALID = 1 << 19;
        /// A compass was found or named, and gives no usable readings. The attitude does not
        /// depend on it.
        const COMPASS_FAULT = 1 << 20;
        /// Vibration is so strong that the accelerometer may clip. The tilt can be wrong by
        /// degrees.
        const VIBRATION = 1 << 21;
    }
}

impl Flags {
    /// Flags of an attitude that cannot be valid.
    pub const INVALIDATING: Self = Self::GYROSCOPE_SATURATED
        .union(Self::TIME)
        .union(Self::FROZEN)
        .union(Self::REJECTED)
        .union(Self::STALE)
        .union(Self::TEMPERATURE);

    /// Flags of a sample that is no measurement.
    pub(crate) const UNUSABLE_SAMPLE: Self = Self::FROZEN.union(Self::REJECTED);

    /// Flags of an attitude whose sample is no measurement, or that has no new sample.
    pub(crate) const NO_MEASUREMENT: Self = Self::UNUSABLE_SAMPLE.union(Self::STALE);

    /// Flags of an attitude that is degraded.
    pub const DEGRADING: Self = Self::INVALIDATING
        .union(Self::CALIBRATING)
        .union(Self::POLLED)
        .union(Self::INTERNAL_CLOCK)
        .union(Self::VIBRATION);

    /// Flags that last as long as their cause. The others report single events.
    pub const LASTING: Self = Self::DEGRADING
        .difference(Self::CALIBRATING)
        .union(Self::ACCELEROMETER_SATURATED)
        .union(Self::COMPASS_FAULT)
        .union(Self::VALID)
        .union(Self::DEGRADED)
        .union(Self::HEADING_VALID);
}

bitflags::bitflags! {
    /// Conditions that the board reports with a burst. All but the last have the bits and names of
    /// their [`Flags`].
    #[repr(transparent)]
    #[derive(Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct BoardFlags: u32 {
        /// [`Flags::BUS_FAULT`].
        const BUS_FAULT = Flags::BUS_FAULT.bits();
        /// [`Flags::SENSOR_RESET`].
        const SENSOR_RESET = Flags::SENSOR_RESET.bits();
        /// [`Flags::LATE`].
        const LATE = Flags::LATE.bits();
        /// [`Flags::POLLED`].
        const POLLED = Flags::POLLED.bits();
        /// [`Flags::INTERNAL_CLOCK`].
        const INTERNAL_CLOCK = Flags::INTERNAL_CLOCK.bits();
        /// [`Flags::COMPASS_FAULT`].
        const COMPASS_FAULT = Flags::COMPASS_FAULT.bits();
        /// The sensor's full scales have been read back since the previous burst, and are right.
        const SCALES_VERIFIED = 1 << 31;
    }
}

impl From<BoardFlags> for Flags {
    fn from(board: BoardFlags) -> Self {
        Self::from_bits_truncate(board.bits())
    }
}

/// Error of a text that names an unknown flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct UnknownFlag;

impl fmt::Display for UnknownFlag {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("unknown flag: expected names such as VALID, joined by |")
    }
}

impl Error for UnknownFlag {}

macro_rules! text_form {
    ($flags:ty) => {
        impl fmt::Display for $flags {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                for (index, (name, _)) in self.iter_names().enumerate() {
                    formatter.write_str(if index > 0 { "|" } else { "" })?;
                    formatter.write_str(name)?;
                }
                Ok(())
            }
        }

        /// The names, as `Flags(CALIBRATING|DEGRADED)`.
        impl fmt::Debug for $flags {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(formatter, "{}({self})", stringify!($flags))
            }
        }

        impl FromStr for $flags {
            type Err = UnknownFlag;

            fn from_str(text: &str) -> Result<Self, UnknownFlag> {
                if text.is_empty() {
                    return Ok(Self::empty());
                }
                let flags = text.split('|').map(Self::from_name);
                flags.collect::<Option<Self>>().ok_or(UnknownFlag)
            }
        }

        #[cfg(feature = "defmt")]
        impl defmt::Format for $flags {
            fn format(&self, formatter: defmt::Formatter<'_>) {
                for (index, (name, _)) in self.iter_names().enumerate() {
                    let separator = if index > 0 { "|" } else { "" };
                    defmt::write!(formatter, "{=str}{=str}", separator, name);
                }
            }
        }
    };
}

text_form!(Flags);
text_form!(BoardFlags);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_joined_and_read_back() {
        assert_eq!(Flags::empty().to_string(), "");
        let flags = Flags::MOVED | Flags::CALIBRATING;
        assert_eq!(flags.to_string(), "CALIBRATING|MOVED");
        for first in Flags::all().iter() {
            for second in Flags::all().iter() {
                let flags = first | second;
                assert_eq!(flags.to_string().parse(), Ok(flags));
            }
        }
        assert_eq!(format!("{flags:?}"), "Flags(CALIBRATING|MOVED)");
        assert_eq!(format!("{:?}", BoardFlags::LATE), "BoardFlags(LATE)");
        assert_eq!("MOVED|".parse::<Flags>(), Err(UnknownFlag));
        assert_eq!("moved".parse::<Flags>(), Err(UnknownFlag));
    }

    #[test]
    fn flags_of_the_board_are_flags_of_the_attitude() {
        for (name, flag) in BoardFlags::all().iter_names() {
            let expected = Flags::from_name(name).unwrap_or_default();
            assert_eq!(Flags::from(flag), expected, "{name}");
        }
        let verified = Flags::from(BoardFlags::SCALES_VERIFIED);
        assert!(verified.is_empty());
        assert_eq!("LATE".parse(), Ok(BoardFlags::LATE));
    }
}
