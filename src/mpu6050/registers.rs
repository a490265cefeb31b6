//! Register map, as far as this project uses it: addresses, fields and reset values.
//!
//! Section numbers are those of the register map (RM-MPU-6000A revision 4.2); `ACCEL_CONFIG_2`
//! exists only in the MPU-6500 family (RM-MPU-6500A revision 2.1 §4.8).
//!
//! ```
//! use aplomb::mpu6050::registers::Register;
//!
//! assert_eq!(Register::PowerManagement1.address(), 0x6B);
//! assert_eq!(Register::PowerManagement1.to_string(), "PWR_MGMT_1");
//! ```

use core::fmt;

/// Both bus addresses: with the AD0 pin low, and high (product specification §9.2).
pub const ADDRESSES: [u8; 2] = [0x68, 0x69];

/// Register. Its text is the datasheet's name.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Register {
    /// SELF_TEST_X, §4.1: the first of four registers with the factory trim of the self-test.
    SelfTestX = 0x0D,
    /// SMPLRT_DIV, §4.2: the sample rate is the filter's output rate over this plus one.
    SampleRateDivider = 0x19,
    /// CONFIG, §4.3: the digital low-pass filter.
    Configuration = 0x1A,
    /// GYRO_CONFIG, §4.4: the gyroscope's full scale.
    GyroscopeConfiguration = 0x1B,
    /// ACCEL_CONFIG, §4.5: the accelerometer's full scale.
    AccelerometerConfiguration = 0x1C,
    /// ACCEL_CONFIG_2: the accelerometer's own low-pass filter (MPU-6500 family).
    AccelerometerConfiguration2 = 0x1D,
    /// INT_PIN_CFG, §4.14: the interrupt pin's level, drive and length.
    InterruptPinConfiguration = 0x37,
    /// INT_ENABLE, §4.15: what raises the interrupt pin.
    InterruptEnable = 0x38,
    /// ACCEL_XOUT_H, §4.17: the first of the 14 data registers.
    AccelerometerXHigh = 0x3B,
    /// SIGNAL_PATH_RESET, §4.26: resets the sensors' signal paths; reads back as zero.
    SignalPathReset = 0x68,
    /// PWR_MGMT_1, §4.28: device reset, sleep, clock source.
    PowerManagement1 = 0x6B,
    /// PWR_MGMT_2, §4.29: single axes in standby.
    PowerManagement2 = 0x6C,
    /// WHO_AM_I, §4.32: the identity.
    WhoAmI = 0x75,
}

impl Register {
    /// Returns the register's address.
    pub const fn address(self) -> u8 {
        self as u8
    }

    /// Returns the datasheet's name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SelfTestX => "SELF_TEST_X",
            Self::SampleRateDivider => "SMPLRT_DIV",
            Self::Configuration => "CONFIG",
            Self::GyroscopeConfiguration => "GYRO_CONFIG",
            Self::AccelerometerConfiguration => "ACCEL_CONFIG",
            Self::AccelerometerConfiguration2 => "ACCEL_CONFIG_2",
            Self::InterruptPinConfiguration => "INT_PIN_CFG",
            Self::InterruptEnable => "INT_ENABLE",
            Self::AccelerometerXHigh => "ACCEL_XOUT_H",
            Self::SignalPathReset => "SIGNAL_PATH_RESET",
            Self::PowerManagement1 => "PWR_MGMT_1",
            Self::PowerManagement2 => "PWR_MGMT_2",
            Self::WhoAmI => "WHO_AM_I",
        }
    }
}

impl fmt::Display for Register {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

/// CONFIG bits 2:0, DLPF_CFG (§4.3).
pub const LOW_PASS_MASK: u8 = 0b0000_0111;
/// ACCEL_CONFIG_2 bits 3:0, ACCEL_FCHOICE_B (zero: filter on) and A_DLPF_CFG (MPU-6500 §4.8).
pub const ACCELEROMETER_LOW_PASS_MASK: u8 = 0b0000_1111;
/// GYRO_CONFIG bits 1:0, FCHOICE_B (zero: filter on), of the MPU-6500 family (MPU-6500 §4.6). They
/// are reserved in an MPU-6050.
pub const GYROSCOPE_BYPASS_MASK: u8 = 0b0000_0011;
/// GYRO_CONFIG and ACCEL_CONFIG bits 4:3, FS_SEL and AFS_SEL (§4.4, §4.5).
pub const FULL_SCALE_MASK: u8 = 0b0001_1000;
/// GYRO_CONFIG and ACCEL_CONFIG bits 7:5, the self-test of each axis (§4.4, §4.5).
pub const SELF_TEST_MASK: u8 = 0b1110_0000;
/// Lowest bit of [`FULL_SCALE_MASK`].
pub const FULL_SCALE_SHIFT: u32 = 3;
/// INT_PIN_CFG: active high, push-pull, 50 µs pulse, INT_RD_CLEAR and I2C_BYPASS_EN (§4.14).
///
/// With INT_RD_CLEAR any read ends an interrupt that was latched before: a setting that has changed
/// may have set LATCH_INT_EN. Without it the pin would stay active after the repair.
///
/// The bypass connects a compass on the auxiliary bus to the main bus: that of an MPU-9250, a GY-86
/// or a GY-87.
pub const INTERRUPT_PULSE_READ_CLEARS_BYPASS: u8 = 0x12;
/// INT_ENABLE bit 0, DATA_RDY_EN (§4.15).
pub const INTERRUPT_DATA_READY: u8 = 0x01;
/// SIGNAL_PATH_RESET bits 2:0: gyroscope, accelerometer and temperature (§4.26).
pub const SIGNAL_PATH_RESET_ALL: u8 = 0x07;
/// PWR_MGMT_1 bit 7, DEVICE_RESET (§4.28).
pub const POWER_DEVICE_RESET: u8 = 0x80;
/// PWR_MGMT_1 bit 6, SLEEP (§4.28).
pub const POWER_SLEEP: u8 = 0x40;
/// PWR_MGMT_2 with no axis in standby and no wake-up cycles (§4.29).
pub const POWER_EVERY_AXIS_ON: u8 = 0x00;
/// PWR_MGMT_1 with everything off: awake, on the internal oscillator (§4.28).
pub const POWER_AWAKE_INTERNAL_CLOCK: u8 = 0x00;
/// PWR_MGMT_1 CLKSEL = 1: awake, on the X gyroscope's PLL, "highly recommended" (§4.28). In the
/// MPU-6500 family 1 selects the best clock there is, which is that PLL once it is ready.
pub const POWER_AWAKE_GYROSCOPE_CLOCK: u8 = 0x01;
