//! Checks: registers that are read back while the sensor runs, and their expected values.
//!
//! A sensor whose supply sags, or a cheap clone, can lose its settings silently. A changed full
//! scale then scales the attitude. Three short reads cover every setting, and each fits between two
//! bursts.

use core::fmt;

use super::config::Config;
use super::part::Part;
use super::registers::{
    ACCELEROMETER_LOW_PASS_MASK, FULL_SCALE_MASK, FULL_SCALE_SHIFT, GYROSCOPE_BYPASS_MASK,
    INTERRUPT_DATA_READY, INTERRUPT_PULSE_READ_CLEARS_BYPASS, LOW_PASS_MASK,
    POWER_AWAKE_GYROSCOPE_CLOCK, POWER_EVERY_AXIS_ON, Register, SELF_TEST_MASK,
};

/// State of the sensor's settings, by its registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SettingsState {
    /// The settings are as configured.
    Intact,
    /// The sensor has reset itself: its interrupt registers hold their reset values.
    Reset,
    /// A setting differs from the configuration.
    Changed,
}

/// Check of neighbouring registers that are read together.
///
/// ```
/// use aplomb::mpu6050::{Check, Config, Part, SettingsState};
///
/// let [ranges, ..] = Check::all(&Config::DEFAULT, &Part::MPU_6050);
/// // SMPLRT_DIV, CONFIG, GYRO_CONFIG and ACCEL_CONFIG as configured; then another full scale.
/// assert_eq!(ranges.evaluate(&[0x00, 0x01, 0x18, 0x18, 0x00]), SettingsState::Intact);
/// assert_eq!(ranges.evaluate(&[0x00, 0x01, 0x00, 0x18, 0x00]), SettingsState::Changed);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Check {
    /// First register.
    pub first: Register,
    /// Number of registers: two or more, as a transfer by DMA needs (RM0090, 27.3.7).
    pub length: usize,
    /// Bits that count in the first four bytes, as a little-endian word.
    masks: u32,
    /// Expected values of those bits.
    expected: u32,
    /// Bits that count in the fifth byte.
    last_mask: u8,
    /// Expected values of those bits.
    last_expected: u8,
}

impl Check {
    /// Number of bytes of the longest check.
    pub const LONGEST: usize = 5;

    /// Returns the checks for a configuration of a part: rates and full scales, interrupt pin,
    /// power and clock.
    pub const fn all(config: &Config, part: &Part) -> [Self; 3] {
        let low_pass = config.low_pass.bits();
        let (own_low_pass, bypass) = if part.is_mpu_6500_family {
            (ACCELEROMETER_LOW_PASS_MASK, GYROSCOPE_BYPASS_MASK)
        } else {
            (0, 0)
        };
        let scale_mask = FULL_SCALE_MASK | SELF_TEST_MASK;
        [
            Self {
                first: Register::SampleRateDivider,
                length: 5,
                masks: u32::from_le_bytes([0xFF, LOW_PASS_MASK, scale_mask | bypass, scale_mask]),
                expected: u32::from_le_bytes([
                    config.sample_rate_divider,
                    low_pass,
                    config.gyroscope_range.bits() << FULL_SCALE_SHIFT,
                    config.accelerometer_range.bits() << FULL_SCALE_SHIFT,
                ]),
                last_mask: own_low_pass,
                last_expected: low_pass & own_low_pass,
            },
            Self::pair(
                Register::InterruptPinConfiguration,
                [INTERRUPT_PULSE_READ_CLEARS_BYPASS, INTERRUPT_DATA_READY],
            ),
            Self::pair(
                Register::PowerManagement1,
                [POWER_AWAKE_GYROSCOPE_CLOCK, POWER_EVERY_AXIS_ON],
            ),
        ]
    }

    /// Checks every bit of two registers.
    const fn pair(first: Register, [one, other]: [u8; 2]) -> Self {
        Self {
            first,
            length: 2,
            masks: u32::from_le_bytes([0xFF, 0xFF, 0, 0]),
            expected: u32::from_le_bytes([one, other, 0, 0]),
            last_mask: 0,
            last_expected: 0,
        }
    }

    /// Returns the bits that count in each register, and their expected values. Both are zero
    /// beyond [`length`](Self::length).
    ///
    /// ```
    /// use aplomb::mpu6050::{Check, Config, Part};
    ///
    /// let [ranges, ..] = Check::all(&Config::DEFAULT, &Part::MPU_6050);
    /// let (masks, expected) = ranges.registers();
    /// assert_eq!((masks[2], expected[2]), (0xF8, 0x18)); // GYRO_CONFIG
    /// ```
    pub const fn registers(&self) -> ([u8; Self::LONGEST], [u8; Self::LONGEST]) {
        let [a, b, c, d] = self.masks.to_le_bytes();
        let masks = [a, b, c, d, self.last_mask];
        let [a, b, c, d] = self.expected.to_le_bytes();
        (masks, [a, b, c, d, self.last_expected])
    }

    /// Evaluates the bytes that were read; those beyond [`length`](Self::length) do not count.
    ///
    /// The check of the interrupt pin detects a reset: both of its registers are zero then, in
    /// every part. PWR_MGMT_1 would not show that of an MPU-6500, which is awake after a reset.
    #[inline(always)]
    pub const fn evaluate(&self, bytes: &[u8; Self::LONGEST]) -> SettingsState {
        let &[a, b, c, d, e] = bytes;
        let first = u32::from_le_bytes([a, b, c, d]) & self.masks;
        let last = e & self.last_mask;
        if first == self.expected && last == self.last_expected {
            SettingsState::Intact
        } else if matches!(self.first, Register::InterruptPinConfiguration) && first == 0 {
            SettingsState::Reset
        } else {
            SettingsState::Changed
        }
    }
}

/// Settings that were read back, byte by byte.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ReadBack {
    /// Part that was read.
    pub part: &'static Part,
    /// State of the settings.
    pub settings: SettingsState,
    /// Registers of each check: the first one, their number, and their bytes.
    pub registers: [(Register, usize, [u8; Check::LONGEST]); 3],
}

impl fmt::Display for ReadBack {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self.settings {
            SettingsState::Intact => "as configured",
            SettingsState::Reset => "the sensor has reset itself",
            SettingsState::Changed => "a setting differs",
        })?;
        write!(formatter, "; 0x75={:02x}", self.part.who_am_i)?;
        for (first, length, bytes) in &self.registers {
            write!(formatter, " 0x{:02x}", *first as u8)?;
            for (place, byte) in bytes.iter().take(*length).enumerate() {
                let separator = if place == 0 { '=' } else { ',' };
                write!(formatter, "{separator}{byte:02x}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::SettingsState::{Changed, Intact, Reset};
    use super::*;

    #[test]
    fn changed_settings_are_found_and_reserved_bits_ignored() {
        let [scales, interrupt, power] = Check::all(&Config::DEFAULT, &Part::MPU_6050);
        // SMPLRT_DIV 0, CONFIG 1, GYRO_CONFIG and ACCEL_CONFIG at full scale 3.
        let good = [0x00, 0x01, 0x18, 0x18, 0x00];
        assert_eq!(scales.evaluate(&good), Intact);
        let meaningful: [u8; 5] = [0xFF, 0x07, 0xF8, 0xF8, 0x00];
        for place in 0..5 {
            for bit in 0..8 {
                let mut bytes = good;
                bytes[place] ^= 1 << bit;
                let expected = if meaningful[place] & 1 << bit == 0 {
                    Intact
                } else {
                    Changed
                };
                assert_eq!(scales.evaluate(&bytes), expected, "{place} {bit}");
            }
        }
        assert_eq!(interrupt.evaluate(&[0x12, 0x01, 9, 9, 9]), Intact);
        assert_eq!(interrupt.evaluate(&[0x12, 0x00, 0, 0, 0]), Changed);
        assert_eq!(interrupt.evaluate(&[0x92, 0x01, 0, 0, 0]), Changed);
        assert_eq!(interrupt.evaluate(&[0x02, 0x01, 0, 0, 0]), Changed);
        assert_eq!(power.evaluate(&[0x01, 0x00, 0, 0, 0]), Intact);
        assert_eq!(power.evaluate(&[0x00, 0x00, 0, 0, 0]), Changed);
        assert_eq!(power.evaluate(&[0x01, 0x08, 0, 0, 0]), Changed);
        assert_eq!(power.evaluate(&[0x40, 0x00, 0, 0, 0]), Changed);
        assert_eq!(interrupt.evaluate(&[0x00, 0x01, 0, 0, 0]), Changed);
        assert_eq!(interrupt.evaluate(&[0x00, 0x00, 9, 9, 9]), Reset);
    }

    #[test]
    fn masks_and_values_judge_as_the_check_does() {
        for part in &super::super::part::PARTS {
            for check in Check::all(&Config::DEFAULT, part) {
                let (masks, expected) = check.registers();
                assert_eq!(check.evaluate(&expected), Intact);
                for (place, mask) in masks.into_iter().enumerate() {
                    assert!(place < check.length || mask == 0, "{check:?}");
                    for bit in (0..8).map(|bit| 1_u8 << bit) {
                        let mut bytes = expected;
                        bytes[place] ^= bit;
                        let is_intact = check.evaluate(&bytes) == Intact;
                        assert_eq!(is_intact, mask & bit == 0, "{check:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_was_read_back_is_printed_byte_by_byte() {
        let bytes = [0x00, 0x01, 0x18, 0x18, 0x00];
        let read = ReadBack {
            part: &Part::MPU_6050,
            settings: Intact,
            registers: [
                (Register::SampleRateDivider, 5, bytes),
                (Register::InterruptPinConfiguration, 2, bytes),
                (Register::PowerManagement1, 2, [0x01, 0x00, 0, 0, 0]),
            ],
        };
        assert_eq!(
            ToString::to_string(&read),
            "as configured; 0x75=68 0x19=00,01,18,18,00 0x37=00,01 0x6b=01,00"
        );
    }

    #[test]
    fn a_part_with_a_second_low_pass_has_it_checked() {
        for part in &super::super::part::PARTS {
            let [scales, ..] = Check::all(&Config::DEFAULT, part);
            let is_checked = |bytes| scales.evaluate(&bytes) == Changed;
            assert!(!is_checked([0x00, 0x01, 0x18, 0x18, 0x01]), "{}", part.name);
            // Another filter of the accelerometer, none of it, and none of the gyroscope.
            for bytes in [
                [0x00, 0x01, 0x18, 0x18, 0x00],
                [0x00, 0x01, 0x18, 0x18, 0x09],
                [0x00, 0x01, 0x19, 0x18, 0x01],
                [0x00, 0x01, 0x1A, 0x18, 0x01],
            ] {
                let expected = part.is_mpu_6500_family;
                assert_eq!(is_checked(bytes), expected, "{} {bytes:x?}", part.name);
            }
        }
    }
}
