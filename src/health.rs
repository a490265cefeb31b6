//! How far an attitude can be trusted: the flags that travel with it, and the watch over the samples.
//!
//! The rule that [`Flags::VALID`] stands for: a tilt that is wrong by more than the larger of 5° and
//! six of its own σ is never published as valid. So σ has to be honest where samples are missing, and
//! what cannot be told from a wrong sample costs the flag: a sample that is no measurement, data that
//! repeat themselves, a temperature the part is not made for, rates that could come from a changed
//! full scale as long as the sensor's registers have not been read back, and an offset not known yet.

use core::fmt::{self, Write};
use core::ops::{BitAnd, BitOr, BitOrAssign};

use crate::state::Exchange;
use crate::units::radians;

/// What there is to say about a sample. [`Flags::VALID`] alone means that all is well.
///
/// As text it is the names joined by `|`, empty if none is set.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Flags(u32);

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
    /// The tilt is wrong by no more than the larger of 5° and six σ. Only with a filter that knows its σ.
    pub const VALID: Self = Self(1 << 10);
    /// The attitude rests on less than it should: σ is above 5°, or one of the flags after this one says why.
    pub const DEGRADED: Self = Self(1 << 11);
    /// No sample has come: the attitude is the last one, carried on, and its σ grows.
    pub const STALE: Self = Self(1 << 12);
    /// Bursts have failed since the sample before.
    pub const BUS_FAULT: Self = Self(1 << 13);
    /// The sensor had lost its settings, and has been or is being set up again.
    pub const SENSOR_RESET: Self = Self(1 << 14);
    /// A sample was lost because the attitude of the one before was not done in time.
    pub const LATE: Self = Self(1 << 15);
    /// The die is outside −40 °C to 85 °C, where the datasheet promises nothing.
    pub const TEMPERATURE: Self = Self(1 << 16);
    /// No data-ready edges come: samples are read by timer, and their time is uncertain by a period.
    pub const POLLED: Self = Self(1 << 17);
    /// The crystal has failed: times are those of the chip's own oscillator, right to 1 %.
    pub const INTERNAL_CLOCK: Self = Self(1 << 18);

    /// What the board has to say of a burst, and the pipeline takes into account.
    pub const OF_BOARD: Self = Self(
        Self::BUS_FAULT.0
            | Self::SENSOR_RESET.0
            | Self::LATE.0
            | Self::POLLED.0
            | Self::INTERNAL_CLOCK.0,
    );

    /// What an attitude cannot be valid with.
    pub const SPOILS: Self = Self(
        Self::CALIBRATING.0
            | Self::GYROSCOPE_SATURATED.0
            | Self::TIME.0
            | Self::FROZEN.0
            | Self::REJECTED.0
            | Self::STALE.0
            | Self::TEMPERATURE.0,
    );
    /// What makes an attitude degraded.
    pub const DEGRADES: Self = Self(Self::SPOILS.0 | Self::POLLED.0 | Self::INTERNAL_CLOCK.0);

    /// What lasts for as long as its cause does, and so tells what an attitude is like; the others say what has happened.
    pub const LASTING: Self = Self(
        (Self::DEGRADES.0 & !Self::CALIBRATING.0)
            | Self::ACCELEROMETER_SATURATED.0
            | Self::VALID.0
            | Self::DEGRADED.0,
    );

    /// What needs a second look at whether an attitude is valid or degraded.
    pub(crate) const ODD: Self = Self(Self::SPOILS.0 | Self::DEGRADES.0);

    /// Every flag with its name, in the order of the bits.
    pub const NAMES: [(Self, &'static str); 19] = [
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
        (Self::VALID, "VALID"),
        (Self::DEGRADED, "DEGRADED"),
        (Self::STALE, "STALE"),
        (Self::BUS_FAULT, "BUS_FAULT"),
        (Self::SENSOR_RESET, "SENSOR_RESET"),
        (Self::LATE, "LATE"),
        (Self::TEMPERATURE, "TEMPERATURE"),
        (Self::POLLED, "POLLED"),
        (Self::INTERNAL_CLOCK, "INTERNAL_CLOCK"),
    ];

    /// The bits, as they lie in memory.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Flags from bits as they lie in memory.
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// Walks through them.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        state.word(&mut self.0);
    }

    /// Whether every flag of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether any flag of `other` is set.
    pub const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// These flags without those of `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Whether none is set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// These flags, and those of `other` if `condition` holds.
    #[must_use]
    pub const fn with(self, other: Self, condition: bool) -> Self {
        // Without a branch, since this runs for every flag of every sample.
        Self(self.0 | (other.0 * condition as u32))
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

impl BitAnd for Flags {
    type Output = Self;

    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl BitOrAssign for Flags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

/// The names by the numbers of their bits, each followed by `|`, which take less flash so than in a table.
static NAMES_BY_BIT: [u8; NAMES_LENGTH] = {
    let mut text = [b'|'; NAMES_LENGTH];
    let (mut at, mut bit) = (0, 0);
    while bit < Flags::NAMES.len() {
        let (flag, name) = Flags::NAMES[bit];
        assert!(flag.0 == 1 << bit, "the names are in the order of the bits");
        let (_, rest) = text.split_at_mut(at);
        rest.split_at_mut(name.len())
            .0
            .copy_from_slice(name.as_bytes());
        at += name.len() + 1;
        bit += 1;
    }
    text
};

const NAMES_LENGTH: usize = {
    let (mut length, mut bit) = (0, 0);
    while bit < Flags::NAMES.len() {
        length += Flags::NAMES[bit].1.len() + 1;
        bit += 1;
    }
    length
};

impl fmt::Display for Flags {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut left = self.0;
        let (mut is_first, mut is_between) = (true, false);
        for &letter in &NAMES_BY_BIT {
            if letter == b'|' {
                left >>= 1;
                is_between = !is_first;
            } else if left & 1 == 1 {
                if core::mem::take(&mut is_between) {
                    formatter.write_char('|')?;
                }
                is_first = false;
                formatter.write_char(letter.into())?;
            }
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

/// Tells a person when the flags that last have changed, and not again and again if they flicker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FlagReport {
    told: Flags,
    seen: Flags,
    seen_since_us: u32,
}

impl FlagReport {
    /// Flags that stay for less than this are not told, in µs: a burst that is lost and a bus that is freed
    /// have messages of their own.
    const STEADY_US: u32 = 200_000;

    /// A report that begins with a valid attitude: that it is not yet, [`Flags::CALIBRATING`] says.
    pub const fn new() -> Self {
        Self {
            told: Flags::VALID,
            seen: Flags::VALID,
            seen_since_us: 0,
        }
    }

    /// Takes the flags of an attitude at a time in µs, which may wrap; gives what there is to tell.
    pub fn update(&mut self, flags: Flags, now_us: u32) -> Option<Flags> {
        let lasting = flags & Flags::LASTING;
        if lasting != self.seen || flags.contains(Flags::CALIBRATING) {
            self.seen = lasting;
            self.seen_since_us = now_us;
        }
        let is_steady = now_us.wrapping_sub(self.seen_since_us) >= Self::STEADY_US;
        if !is_steady || self.told == lasting {
            return None;
        }
        self.told = lasting;
        Some(lasting)
    }
}

impl Default for FlagReport {
    fn default() -> Self {
        Self::new()
    }
}

/// Notices data that do not change: with 16 bits and the sensor's noise on six axes, even a sensor
/// bolted down does not repeat itself for long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FreezeWatch {
    last: [u8; 14],
    repeats: u8,
    limit: u8,
}

impl FreezeWatch {
    /// A watch that has seen nothing, for a sensor that filters with this bandwidth in hertz, of which it
    /// is shown every eleventh sample at 1 kHz.
    ///
    /// At 98 Hz and more, noise alone (product specification §6.1 and §6.2) makes a repeat of all six
    /// axes less likely than one in 10,000, so two in a row are none of noise's; below, samples a few
    /// milliseconds apart are alike, and it takes 9, which is 0.1 s.
    pub const fn new(bandwidth_hz: u16) -> Self {
        Self {
            last: [0; 14],
            repeats: 0,
            limit: if bandwidth_hz >= 98 { 2 } else { 9 },
        }
    }

    /// Walks through everything it remembers.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        state.bytes(&mut self.last);
        state.byte(&mut self.repeats);
        state.byte(&mut self.limit);
    }

    /// Takes a sample's bytes; true while they are frozen.
    pub fn update(&mut self, bytes: &[u8; 14]) -> bool {
        if is_same(bytes, &self.last) {
            self.repeats = self.repeats.saturating_add(1);
        } else {
            self.last = *bytes;
            self.repeats = 0;
        }
        self.repeats >= self.limit
    }
}

/// Word by word: a compiler that saves flash calls a loop over bytes for so few of them.
#[inline]
const fn is_same(one: &[u8; 14], other: &[u8; 14]) -> bool {
    let &[a, b, c, d, e, f, g, h, i, j, k, l, m, n] = one;
    let &[aa, bb, cc, dd, ee, ff, gg, hh, ii, jj, kk, ll, mm, nn] = other;
    u32::from_ne_bytes([a, b, c, d]) == u32::from_ne_bytes([aa, bb, cc, dd])
        && u32::from_ne_bytes([e, f, g, h]) == u32::from_ne_bytes([ee, ff, gg, hh])
        && u32::from_ne_bytes([i, j, k, l]) == u32::from_ne_bytes([ii, jj, kk, ll])
        && u16::from_ne_bytes([m, n]) == u16::from_ne_bytes([mm, nn])
}

/// Whether these bytes are those of a bus or a sensor that says nothing: all zeros or all ones in the
/// accelerometer and the temperature, which no noise leaves so.
#[inline]
pub const fn is_blank(bytes: &[u8; 14]) -> bool {
    let &[a, b, c, d, e, f, g, h, ..] = bytes;
    let first = u32::from_ne_bytes([a, b, c, d]);
    let second = u32::from_ne_bytes([e, f, g, h]);
    first == second && (first == 0 || first == u32::MAX)
}

/// Counts are within the temperatures that the part is made for, −40 °C to 85 °C (product
/// specification §6.2), by this scale, as (lowest, highest).
pub fn temperature_limits(celsius_per_count: f32, celsius_at_zero: f32) -> (i16, i16) {
    let counts = |celsius: f32| ((celsius - celsius_at_zero) / celsius_per_count) as i16;
    (counts(COLDEST_CELSIUS), counts(HOTTEST_CELSIUS))
}

const COLDEST_CELSIUS: f32 = -40.0;
const HOTTEST_CELSIUS: f32 = 85.0;

/// While samples are missing, the body may turn faster than anybody knows: this much is one σ of it per
/// axis, in rad/s, so that the rule's six σ are 180 °/s for as long as it lasts.
pub const UNSEEN_RATE_RAD_S: f32 = radians(30.0);

/// With a larger σ of the tilt than this an attitude is degraded, in rad.
pub const DEGRADED_TILT_RAD: f32 = radians(5.0);

/// With a larger σ of the tilt than this there is no attitude to speak of, in rad: six of them are more
/// than half a turn.
pub const LOST_TILT_RAD: f32 = radians(30.0);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_joined_and_read_back() {
        assert_eq!(Flags::NONE.to_string(), "");
        let flags = Flags::MOVED | Flags::CALIBRATING;
        assert_eq!(flags.to_string(), "CALIBRATING|MOVED");
        for first in 0..Flags::NAMES.len() {
            for second in 0..=first {
                let flags = Flags::from_bits(1 << first | 1 << second);
                assert_eq!(Flags::parse(&flags.to_string()), Some(flags));
            }
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
    fn flags_that_last_are_told_once_and_flickering_ones_never() {
        let mut report = FlagReport::new();
        // Shortly before the count wraps, one look every 20 ms.
        let mut now_us = u32::MAX - 100_000;
        let mut told = |flags: Flags, looks: u32| {
            let mut told = Vec::new();
            for _ in 0..looks {
                now_us = now_us.wrapping_add(20_000);
                told.extend(report.update(flags, now_us));
            }
            told
        };
        assert_eq!(told(Flags::CALIBRATING | Flags::DEGRADED, 100), []);
        assert_eq!(told(Flags::VALID, 100), []);
        let polled = Flags::VALID | Flags::DEGRADED | Flags::POLLED;
        assert_eq!(told(polled, 10), [], "not at once");
        assert_eq!(told(polled | Flags::MISSED, 50), [polled]);
        assert_eq!(told(Flags::STALE | Flags::DEGRADED, 9), []);
        assert_eq!(told(polled, 50), []);
        for _ in 0..50 {
            assert_eq!(told(Flags::VALID, 1), []);
            assert_eq!(told(Flags::STALE | Flags::DEGRADED, 1), []);
        }
        assert_eq!(told(Flags::VALID, 50), [Flags::VALID]);
    }

    #[test]
    fn data_freeze_after_repeats_and_thaw_at_once() {
        for (bandwidth_hz, limit) in [(188, 2), (98, 2), (42, 9)] {
            let mut watch = FreezeWatch::new(bandwidth_hz);
            let mut bytes = [7; 14];
            for _ in 0..300 {
                bytes[13] ^= 1;
                assert!(!watch.update(&bytes));
            }
            for repeat in 1..=1000 {
                assert_eq!(watch.update(&bytes), repeat >= limit, "{repeat}");
            }
            bytes[0] ^= 1;
            assert!(!watch.update(&bytes));
        }
    }

    #[test]
    fn blank_is_all_zeros_or_all_ones_and_no_measurement() {
        assert!(is_blank(&[0; 14]) && is_blank(&[0xFF; 14]));
        // A burst of a sensor in free fall, at rest about every axis, at 36.53 °C: one count of noise.
        for place in 0..8 {
            let mut bytes = [0; 14];
            bytes[place] = 1;
            assert!(!is_blank(&bytes), "{place}");
        }
        assert!(!is_blank(&[0x55; 14]));
    }

    #[test]
    fn temperature_limits_are_the_datasheet_s() {
        // −40 °C and 85 °C by the MPU-6050's scale: 340 counts per °C, zero at 36.53 °C.
        assert_eq!(temperature_limits(1.0 / 340.0, 36.53), (-26_020, 16_479));
    }
}
