//! Parts: the supported chips, their identities, and their differences.
//!
//! All of them share the MPU-6050's data registers, full scales and sensitivities. They differ in:
//!
//! - the temperature formula;
//! - the family. Parts of the MPU-6500 family have a low-pass filter of the accelerometer's own,
//!   the bits FCHOICE_B, and longer delays of both filters;
//! - the factory trim of the self-test;
//! - the value of PWR_MGMT_1 after a reset.

use super::config::LowPass;

/// Linear temperature scale: °C = counts · `celsius_per_count` + `celsius_at_zero`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Temperature {
    /// °C per count.
    pub celsius_per_count: f32,
    /// °C at a count of zero.
    pub celsius_at_zero: f32,
}

/// Supported chip: its identity, and its differences from the others.
///
/// ```
/// use aplomb::mpu6050::Part;
///
/// let part = Part::from_who_am_i(0x70).unwrap();
/// assert_eq!(part.name, "MPU-6500");
/// assert!(part.is_mpu_6500_family);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Part {
    /// Name.
    pub name: &'static str,
    /// Value of its WHO_AM_I register.
    pub who_am_i: u8,
    /// Scale of its temperature sensor.
    pub temperature: Temperature,
    /// True for the MPU-6500 and its successors. ACCEL_CONFIG_2 (0x1D) sets their accelerometer's
    /// low-pass filter, GYRO_CONFIG (0x1B) has FCHOICE_B, and the filters have other delays.
    pub is_mpu_6500_family: bool,
    /// True if SELF_TEST_X to _A (0x0D to 0x10) hold the factory trim of the MPU-6050's self-test.
    pub has_self_test_trim: bool,
    /// Values that PWR_MGMT_1 may have after a reset.
    pub power_after_reset: &'static [u8],
}

impl Part {
    /// MPU-6050.
    pub const MPU_6050: Self = Self {
        name: "MPU-6050",
        who_am_i: 0x68,
        temperature: MPU_6050_TEMPERATURE,
        is_mpu_6500_family: false,
        has_self_test_trim: true,
        power_after_reset: &[ASLEEP],
    };

    /// Returns the gyroscope's delay in this low-pass filter, µs.
    pub const fn gyroscope_delay_us(&self, low_pass: LowPass) -> u16 {
        if !self.is_mpu_6500_family {
            return low_pass.gyroscope_delay_us();
        }
        // MPU-6500 register map r2.1 §4.5, MPU-9250 register map r1.4 §4.5.
        match low_pass {
            LowPass::Hertz256 => 970,
            LowPass::Hertz188 => 2_900,
            LowPass::Hertz98 => 3_900,
            LowPass::Hertz42 => 5_900,
            LowPass::Hertz20 => 9_900,
            LowPass::Hertz10 => 17_850,
            LowPass::Hertz5 => 33_480,
        }
    }

    /// Returns the accelerometer's delay in this low-pass filter, µs.
    pub const fn accelerometer_delay_us(&self, low_pass: LowPass) -> u32 {
        if !self.is_mpu_6500_family {
            return low_pass.accelerometer_delay_us() as u32;
        }
        // MPU-6500 register map r2.1 §4.8, MPU-9250 register map r1.4 §4.8.
        match low_pass {
            LowPass::Hertz256 => 1_940,
            LowPass::Hertz188 => 5_800,
            LowPass::Hertz98 => 7_800,
            LowPass::Hertz42 => 11_800,
            LowPass::Hertz20 => 19_800,
            LowPass::Hertz10 => 35_700,
            LowPass::Hertz5 => 66_960,
        }
    }

    /// Returns the part with this identity.
    pub fn from_who_am_i(who_am_i: u8) -> Option<&'static Self> {
        PARTS.iter().find(|part| part.who_am_i == who_am_i)
    }
}

/// PWR_MGMT_1 after reset: asleep on the internal oscillator (register map §3).
const ASLEEP: u8 = 0x40;
/// PWR_MGMT_1 after reset: awake on the best clock (MPU-6500 and MPU-9250 register maps §3).
const AWAKE: u8 = 0x01;
/// PWR_MGMT_1 after reset: asleep with the best clock selected (later parts of the family).
const ASLEEP_BEST_CLOCK: u8 = 0x41;

/// Temperature scale of the MPU-6050 (register map §4.18).
const MPU_6050_TEMPERATURE: Temperature = Temperature {
    celsius_per_count: 1.0 / 340.0,
    celsius_at_zero: 36.53,
};

/// Temperature scale of the MPU-6500 and MPU-9250 (register maps, TEMP_OUT, with RoomTemp_Offset
/// zero).
const MPU_6500_TEMPERATURE: Temperature = Temperature {
    celsius_per_count: 1.0 / 333.87,
    celsius_at_zero: 21.0,
};

/// Every part that [`probe`](super::Mpu6050::probe) accepts.
pub static PARTS: [Part; 6] = [
    Part::MPU_6050,
    Part {
        name: "MPU-6500",
        who_am_i: 0x70,
        temperature: MPU_6500_TEMPERATURE,
        is_mpu_6500_family: true,
        has_self_test_trim: false,
        power_after_reset: &[AWAKE, ASLEEP, ASLEEP_BEST_CLOCK],
    },
    Part {
        name: "MPU-9250",
        who_am_i: 0x71,
        temperature: MPU_6500_TEMPERATURE,
        is_mpu_6500_family: true,
        has_self_test_trim: false,
        power_after_reset: &[AWAKE, ASLEEP, ASLEEP_BEST_CLOCK],
    },
    // Found on modules sold as MPU-6050 (GY-87 and others); behaves as one.
    Part {
        name: "MPU-6050 clone 0x72",
        who_am_i: 0x72,
        temperature: MPU_6050_TEMPERATURE,
        is_mpu_6500_family: false,
        has_self_test_trim: true,
        power_after_reset: &[ASLEEP, AWAKE, ASLEEP_BEST_CLOCK],
    },
    Part {
        name: "MPU-9255",
        who_am_i: 0x73,
        temperature: MPU_6500_TEMPERATURE,
        is_mpu_6500_family: true,
        has_self_test_trim: false,
        power_after_reset: &[AWAKE, ASLEEP, ASLEEP_BEST_CLOCK],
    },
    // Also the identity of the commonest clone sold as MPU-6050.
    Part {
        name: "ICM-20689",
        who_am_i: 0x98,
        temperature: Temperature {
            celsius_per_count: 0.003,
            celsius_at_zero: 25.0,
        },
        is_mpu_6500_family: true,
        has_self_test_trim: false,
        power_after_reset: &[ASLEEP, ASLEEP_BEST_CLOCK, AWAKE],
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    /// The delays of the register maps, in the order of the settings.
    #[test]
    fn each_family_has_its_own_delays() {
        let mpu_9250 = Part::from_who_am_i(0x71).expect("in the table");
        let gyroscope = LowPass::ALL.map(|low_pass| mpu_9250.gyroscope_delay_us(low_pass));
        assert_eq!(gyroscope, [970, 2900, 3900, 5900, 9900, 17850, 33480]);
        let force = LowPass::ALL.map(|low_pass| mpu_9250.accelerometer_delay_us(low_pass));
        assert_eq!(force, [1940, 5800, 7800, 11800, 19800, 35700, 66960]);
        let mpu_6050 = Part::MPU_6050;
        let gyroscope = LowPass::ALL.map(|low_pass| mpu_6050.gyroscope_delay_us(low_pass));
        assert_eq!(gyroscope, [980, 1900, 2800, 4800, 8300, 13400, 18600]);
    }

    #[test]
    fn identities_are_distinct_and_found() {
        for (index, part) in PARTS.iter().enumerate() {
            assert_eq!(
                PARTS.iter().position(|p| p.who_am_i == part.who_am_i),
                Some(index)
            );
            assert_eq!(Part::from_who_am_i(part.who_am_i), Some(part));
            assert!(!part.power_after_reset.is_empty());
        }
        assert_eq!(Part::from_who_am_i(0x00), None);
        assert_eq!(Part::from_who_am_i(0xFF), None);
    }
}
