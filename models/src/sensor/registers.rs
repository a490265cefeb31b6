//! The MPU-6050's register file, from the register map (RM-MPU-6000A r4.2, section 3).
//!
//! This is the model's own table. The driver under test has another, so a mistake in one of them
//! shows. Registers that the map does not list read zero and ignore writes; real chips keep
//! undocumented factory values there.

/// The addresses the model itself acts on, by the register map's names.
pub mod address {
    /// First of the four registers with the self-test's factory trims.
    pub const SELF_TEST_X: u8 = 0x0D;
    /// Sample rate divider.
    pub const SMPLRT_DIV: u8 = 0x19;
    /// Low-pass filter.
    pub const CONFIG: u8 = 0x1A;
    /// Gyroscope: self-test and full scale.
    pub const GYRO_CONFIG: u8 = 0x1B;
    /// Accelerometer: self-test and full scale.
    pub const ACCEL_CONFIG: u8 = 0x1C;
    /// The accelerometer's own filter, in the MPU-6500 and its relatives alone (RM-MPU-6500A r2.1,
    /// section 4.8).
    pub const ACCEL_CONFIG_2: u8 = 0x1D;
    /// Shape of the INT pin's signal.
    pub const INT_PIN_CFG: u8 = 0x37;
    /// Events that interrupt.
    pub const INT_ENABLE: u8 = 0x38;
    /// Events that have interrupted.
    pub const INT_STATUS: u8 = 0x3A;
    /// First of the 14 data registers.
    pub const ACCEL_XOUT_H: u8 = 0x3B;
    /// Last of the 14 data registers.
    pub const GYRO_ZOUT_L: u8 = 0x48;
    /// Resets of the three signal paths.
    pub const SIGNAL_PATH_RESET: u8 = 0x68;
    /// FIFO, auxiliary bus and their resets.
    pub const USER_CTRL: u8 = 0x6A;
    /// Reset, sleep, clock.
    pub const PWR_MGMT_1: u8 = 0x6B;
    /// Standby of single axes, wake-up rate.
    pub const PWR_MGMT_2: u8 = 0x6C;
    /// The FIFO's port.
    pub const FIFO_R_W: u8 = 0x74;
    /// Identity.
    pub const WHO_AM_I: u8 = 0x75;
}

/// Accelerometer, temperature and gyroscope, 0x3B to 0x48.
pub const DATA_LENGTH: usize = 14;

/// One past the last register of the file.
const LENGTH: usize = 0x76;

/// PWR_MGMT_1 after a reset: asleep (section 3, note to the table).
pub const PWR_MGMT_1_RESET: u8 = 0x40;

/// The bits of the register at `register` that keep what is written to them.
///
/// Bits that trigger an action and clear themselves are not among them: DEVICE_RESET, the resets in
/// USER_CTRL, SIGNAL_PATH_RESET. They never read as set once the action is done.
#[must_use]
pub const fn writable_bits(register: u8) -> u8 {
    match register {
        0x0D..=0x0F => 0xFF, // SELF_TEST_X, _Y, _Z
        0x10 => 0x3F,        // SELF_TEST_A
        0x19 => 0xFF,        // SMPLRT_DIV
        0x1A => 0x3F,        // CONFIG: EXT_SYNC_SET, DLPF_CFG
        0x1B | 0x1C => 0xF8, // GYRO_CONFIG, ACCEL_CONFIG: self-test, full scale
        0x23 => 0xFF,        // FIFO_EN
        0x24 => 0xFF,        // I2C_MST_CTRL
        0x25..=0x34 => 0xFF, // I2C_SLV0 to I2C_SLV4
        0x37 => 0xFE,        // INT_PIN_CFG
        0x38 => 0x19,        // INT_ENABLE: FIFO overflow, I2C master, data ready
        0x63..=0x66 => 0xFF, // I2C_SLV0_DO to I2C_SLV3_DO
        0x67 => 0x9F,        // I2C_MST_DELAY_CTRL
        0x6A => 0x60,        // USER_CTRL: FIFO_EN, I2C_MST_EN; I2C_IF_DIS is the SPI part's
        0x6B => 0x6F,        // PWR_MGMT_1: SLEEP, CYCLE, TEMP_DIS, CLKSEL
        0x6C => 0xFF,        // PWR_MGMT_2
        _ => 0x00,           // read-only, trigger bits alone, or not in the map
    }
}

/// The values of all registers but the 14 data registers, which the sample path owns.
#[derive(Clone, Debug)]
pub struct RegisterFile {
    values: [u8; LENGTH],
}

impl RegisterFile {
    /// All registers at their reset values: zero, except PWR_MGMT_1, WHO_AM_I and the factory's
    /// self-test trims.
    #[must_use]
    pub fn at_reset(who_am_i: u8, power_management_1: u8, self_test: [u8; 4]) -> Self {
        let mut file = Self {
            values: [0; LENGTH],
        };
        file.put(address::PWR_MGMT_1, power_management_1);
        file.put(address::WHO_AM_I, who_am_i);
        for (offset, trim) in (0_u8..).zip(self_test) {
            file.put(address::SELF_TEST_X + offset, trim);
        }
        file
    }

    /// The value at `register`; zero beyond the end of the file.
    #[must_use]
    pub fn get(&self, register: u8) -> u8 {
        self.values.get(usize::from(register)).copied().unwrap_or(0)
    }

    /// A write over the bus: only the writable bits change.
    pub fn write(&mut self, register: u8, value: u8, writable: u8) {
        let kept = self.get(register) & !writable;
        self.put(register, kept | (value & writable));
    }

    /// A change by the chip itself.
    pub fn put(&mut self, register: u8, value: u8) {
        if let Some(slot) = self.values.get_mut(usize::from(register)) {
            *slot = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reset_values_are_the_register_maps() {
        let file = RegisterFile::at_reset(0x68, PWR_MGMT_1_RESET, [0; 4]);
        for register in 0..=0xFF {
            let expected = match register {
                0x6B => 0x40,
                0x75 => 0x68,
                _ => 0,
            };
            assert_eq!(file.get(register), expected, "{register:#04x}");
        }
    }

    #[test]
    fn read_only_and_reserved_registers_ignore_writes() {
        let mut file = RegisterFile::at_reset(0x68, PWR_MGMT_1_RESET, [0; 4]);
        let read_only = (0x35..=0x36).chain(0x39..=0x62).chain([0x75, 0x72, 0x73]);
        let reserved = (0x00..=0x0C)
            .chain(0x11..=0x18)
            .chain(0x1D..=0x22)
            .chain([0x39, 0x69, 0x6D, 0x70, 0x71]);
        for register in read_only.chain(reserved) {
            let before = file.get(register);
            file.write(register, !before, writable_bits(register));
            assert_eq!(file.get(register), before, "{register:#04x}");
        }
    }

    #[test]
    fn reserved_bits_of_writable_registers_stay_zero() {
        let mut file = RegisterFile::at_reset(0x68, PWR_MGMT_1_RESET, [0; 4]);
        for (register, expected) in [
            (0x1A, 0x3F),
            (0x1B, 0xF8),
            (0x1C, 0xF8),
            (0x37, 0xFE),
            (0x38, 0x19),
            (0x19, 0xFF),
        ] {
            file.write(register, 0xFF, writable_bits(register));
            assert_eq!(file.get(register), expected, "{register:#04x}");
        }
    }
}
