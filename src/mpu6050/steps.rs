//! Steps: the configuration as a list of writes, for any kind of bus, blocking or asynchronous.
//!
//! A bus that only writes sends each step's `value` and waits; after the device reset every other
//! bit of an MPU-6050 is zero. To be sure, read back the registers of
//! [`Check::all`](super::Check::all) afterwards.

use super::config::Config;
use super::part::Part;
use super::registers::{
    ACCELEROMETER_LOW_PASS_MASK, FULL_SCALE_MASK, FULL_SCALE_SHIFT, GYROSCOPE_BYPASS_MASK,
    INTERRUPT_DATA_READY, INTERRUPT_PULSE_READ_CLEARS_BYPASS, LOW_PASS_MASK,
    POWER_AWAKE_GYROSCOPE_CLOCK, POWER_AWAKE_INTERNAL_CLOCK, POWER_DEVICE_RESET,
    POWER_EVERY_AXIS_ON, Register, SELF_TEST_MASK, SIGNAL_PATH_RESET_ALL,
};

/// Wait after a device reset and after a signal path reset, ms (register map §4.28).
const RESET_MS: u32 = 100;
/// Settling time of the gyroscope's zero-rate output, ms (product specification §6.1).
const ZERO_RATE_SETTLING_MS: u32 = 30;

/// One register write, and the wait after it.
///
/// ```
/// use aplomb::mpu6050::{Config, Part, Step};
///
/// let steps = Step::configuration(&Config::DEFAULT, &Part::MPU_6050);
/// let wait_ms: u32 = steps.map(|step| step.wait_ms).sum();
/// assert_eq!(wait_ms, 230);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Step {
    /// Register to write.
    pub register: Register,
    /// Value to write, within `mask`.
    pub value: u8,
    /// Bits to change; the others keep their value, or are zero after a device reset.
    pub mask: u8,
    /// Wait before the next step, ms.
    pub wait_ms: u32,
}

impl Step {
    /// Returns the steps of [`Mpu6050::configure`](super::Mpu6050::configure), in the datasheet's
    /// order, for a sensor in any state. Data-ready pulses begin with the last step, after 230 ms.
    pub const fn configuration(config: &Config, part: &Part) -> Steps {
        Steps::new(RESET_AND_WAKE | RANGES | INTERRUPT, config, part)
    }

    /// Returns the steps of [`Mpu6050::reconfigure`](super::Mpu6050::reconfigure), for a sensor
    /// that has just reset itself, or that lost one setting. They take 30 ms. None is a device
    /// reset.
    pub const fn reconfiguration(config: &Config, part: &Part) -> Steps {
        Steps::new(WAKE | RANGES | INTERRUPT, config, part)
    }

    /// Returns the steps before a self-test; the interrupt stays off.
    pub(super) const fn before_self_test(config: &Config, part: &Part) -> Steps {
        Steps::new(RESET_AND_WAKE | RANGES, config, part)
    }

    /// Returns the steps that switch the self-test of every axis on.
    pub(super) const fn self_test(config: &Config, part: &Part) -> Steps {
        Steps::new(SELF_TEST, config, part)
    }

    /// Returns whether the step is the device reset, after which the register holds one of the
    /// part's values.
    pub(super) fn is_device_reset(self) -> bool {
        self.register == Register::PowerManagement1 && self.value == POWER_DEVICE_RESET
    }

    /// Returns whether the register reads back as written. (SIGNAL_PATH_RESET reads back as zero,
    /// §4.26.)
    pub(super) fn reads_back(self) -> bool {
        self.register != Register::SignalPathReset
    }

    const fn whole(register: Register, value: u8, wait_ms: u32) -> Self {
        Self {
            register,
            value,
            mask: u8::MAX,
            wait_ms,
        }
    }

    const fn setting(register: Register, mask: u8) -> Self {
        Self {
            register,
            value: 0,
            mask,
            wait_ms: 0,
        }
    }

    const fn testing(register: Register) -> Self {
        Self {
            register,
            value: SELF_TEST_MASK,
            mask: SELF_TEST_MASK,
            wait_ms: 0,
        }
    }
}

/// Every step. Values that depend on the settings are zero here.
const ALL: [Step; 16] = [
    Step::whole(Register::PowerManagement1, POWER_DEVICE_RESET, RESET_MS),
    Step::whole(Register::PowerManagement1, POWER_AWAKE_INTERNAL_CLOCK, 0),
    Step::whole(Register::SignalPathReset, SIGNAL_PATH_RESET_ALL, RESET_MS),
    Step::whole(
        Register::PowerManagement1,
        POWER_AWAKE_GYROSCOPE_CLOCK,
        ZERO_RATE_SETTLING_MS,
    ),
    Step::whole(Register::PowerManagement1, POWER_AWAKE_GYROSCOPE_CLOCK, 0),
    Step::whole(
        Register::PowerManagement2,
        POWER_EVERY_AXIS_ON,
        ZERO_RATE_SETTLING_MS,
    ),
    Step::setting(Register::SampleRateDivider, u8::MAX),
    Step::setting(Register::Configuration, LOW_PASS_MASK),
    Step::setting(
        Register::GyroscopeConfiguration,
        FULL_SCALE_MASK | SELF_TEST_MASK,
    ),
    Step::setting(
        Register::GyroscopeConfiguration,
        FULL_SCALE_MASK | SELF_TEST_MASK | GYROSCOPE_BYPASS_MASK,
    ),
    Step::setting(
        Register::AccelerometerConfiguration,
        FULL_SCALE_MASK | SELF_TEST_MASK,
    ),
    Step::setting(
        Register::AccelerometerConfiguration2,
        ACCELEROMETER_LOW_PASS_MASK,
    ),
    Step::whole(
        Register::InterruptPinConfiguration,
        INTERRUPT_PULSE_READ_CLEARS_BYPASS,
        0,
    ),
    Step::whole(Register::InterruptEnable, INTERRUPT_DATA_READY, 0),
    Step::testing(Register::GyroscopeConfiguration),
    Step::testing(Register::AccelerometerConfiguration),
];

/// Steps that reset and wake the sensor, as a set of indices in [`ALL`].
const RESET_AND_WAKE: u16 = 0b1111;
const WAKE: u16 = 0b11 << 4;
const RANGES: u16 = 0b11_1111 << 6;
const INTERRUPT: u16 = 0b11 << 12;
const SELF_TEST: u16 = 0b11 << 14;
/// Part of [`RANGES`] for the MPU-6050 and its clones alone.
const MPU_6050_ALONE: u16 = 1 << 8;
/// Part of [`RANGES`] for the MPU-6500 family alone: FCHOICE_B, and the accelerometer's filter.
const MPU_6500_ALONE: u16 = 1 << 9 | 1 << 11;

/// Iterator over the steps of a configuration.
#[derive(Debug, Clone)]
pub struct Steps {
    /// Set of the remaining steps.
    left: u16,
    config: Config,
}

impl Steps {
    const fn new(set: u16, config: &Config, part: &Part) -> Self {
        let left = if part.is_mpu_6500_family {
            set & !MPU_6050_ALONE
        } else {
            set & !MPU_6500_ALONE
        };
        Self {
            left,
            config: *config,
        }
    }
}

impl Iterator for Steps {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        let mut step = *ALL.get(self.left.trailing_zeros() as usize)?;
        self.left &= self.left.wrapping_sub(1);
        let config = &self.config;
        step.value |= step.mask
            & match step.register {
                Register::SampleRateDivider => config.sample_rate_divider,
                Register::Configuration | Register::AccelerometerConfiguration2 => {
                    config.low_pass.bits()
                }
                Register::GyroscopeConfiguration => {
                    config.gyroscope_range.bits() << FULL_SCALE_SHIFT
                }
                Register::AccelerometerConfiguration => {
                    config.accelerometer_range.bits() << FULL_SCALE_SHIFT
                }
                _ => 0,
            };
        Some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{AccelerometerRange, GyroscopeRange, LowPass};
    use super::*;

    /// Register, value and wait in ms of each step.
    fn list(config: &Config, part: &Part) -> Vec<(u8, u8, u32)> {
        Step::configuration(config, part)
            .inspect(|step| assert_eq!(step.value & !step.mask, 0, "{step:?}"))
            .map(|step| (step.register.address(), step.value, step.wait_ms))
            .collect()
    }

    #[test]
    fn the_default_configuration_follows_the_datasheet() {
        let expected = [
            (0x6B, 0x80, 100),
            (0x6B, 0x00, 0),
            (0x68, 0x07, 100),
            (0x6B, 0x01, 30),
            (0x19, 0x00, 0),
            (0x1A, 0x01, 0),
            (0x1B, 0x18, 0),
            (0x1C, 0x18, 0),
            (0x37, 0x12, 0),
            (0x38, 0x01, 0),
        ];
        assert_eq!(list(&Config::DEFAULT, &Part::MPU_6050), expected);
    }

    #[test]
    fn settings_and_parts_differ_where_they_should() {
        let config = Config {
            accelerometer_range: AccelerometerRange::G4,
            gyroscope_range: GyroscopeRange::Degrees500,
            low_pass: LowPass::Hertz42,
            sample_rate_divider: 4,
        };
        let part = super::super::PARTS
            .iter()
            .find(|part| part.is_mpu_6500_family)
            .expect("the MPU-6500 is one");
        let ranges = list(&config, part).split_off(4);
        let expected = [
            (0x19, 4, 0),
            (0x1A, 3, 0),
            (0x1B, 0x08, 0),
            (0x1C, 0x08, 0),
            (0x1D, 3, 0),
            (0x37, 0x12, 0),
            (0x38, 0x01, 0),
        ];
        assert_eq!(ranges, expected);
    }
}
