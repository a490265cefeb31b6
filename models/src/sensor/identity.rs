//! The parts that are sold as an MPU-6050, by what they answer to WHO_AM_I, and how they differ.
//!
//! Two families are modelled. The MPU-6050's numbers come from its register map r4.2 (section 4.3)
//! and product specification r3.4. Those of the MPU-6500 family come from the MPU-6500 register map
//! r2.1 (sections 4.4 to 4.6, 4.8) and product specification. A part with an identity that no
//! document names behaves like an MPU-6050: its driver should refuse it anyway.

use super::low_pass::Response;
use super::registers::{PWR_MGMT_1_RESET, RegisterFile, address};

/// Differences of a part from its relatives.
#[derive(Clone, Copy, Debug)]
pub struct Identity {
    /// The value of WHO_AM_I.
    pub who_am_i: u8,
    /// PWR_MGMT_1 after a reset: 0x40 is asleep on the internal oscillator, 0x01 awake on the
    /// gyroscope's.
    pub power_management_1: u8,
    /// Least significant bits per °C.
    pub temperature_lsb_per_c: f64,
    /// The temperature at which the register reads zero, °C.
    pub temperature_zero_c: f64,
    /// The register whose low three bits select the accelerometer's low-pass filter.
    pub accelerometer_filter_register: u8,
    /// True if SMPLRT_DIV divides the 8 kHz of an unfiltered gyroscope too. In the MPU-6500 family
    /// it is effective only with FCHOICE_B = 0 and 0 < DLPF_CFG < 7 (RM-MPU-6500A r2.1 and
    /// RM-MPU-9250A r1.6, section 4.4, Sample Rate Divider).
    pub divides_unfiltered: bool,
    /// The gyroscope's filters by DLPF_CFG.
    pub gyroscope_filters: [Response; 8],
    /// The accelerometer's filters by the low bits of `accelerometer_filter_register`.
    pub accelerometer_filters: [Response; 8],
}

impl Identity {
    /// The part that answers `who_am_i`.
    #[must_use]
    pub fn of(who_am_i: u8) -> Self {
        match who_am_i {
            // MPU-6500, MPU-9250, MPU-9255: 333.87 LSB/°C, zero at 21 °C (their product
            // specifications).
            0x70 | 0x71 | 0x73 => Self {
                who_am_i,
                power_management_1: 0x01,
                ..Self::mpu_6500_family(333.87, 21.0)
            },
            // Sold as MPU-6050 with the ICM-20689's identity: T = 0.003·raw + 25.
            0x98 => Self {
                who_am_i,
                ..Self::mpu_6500_family(1.0 / 0.003, 25.0)
            },
            // 0x68 is the genuine part, 0x72 a clone seen in the wild that behaves like it.
            _ => Self {
                who_am_i,
                power_management_1: PWR_MGMT_1_RESET,
                temperature_lsb_per_c: 340.0,
                temperature_zero_c: 36.53,
                accelerometer_filter_register: address::CONFIG,
                divides_unfiltered: true,
                gyroscope_filters: MPU_6050_GYROSCOPE,
                accelerometer_filters: MPU_6050_ACCELEROMETER,
            },
        }
    }

    fn mpu_6500_family(temperature_lsb_per_c: f64, temperature_zero_c: f64) -> Self {
        Self {
            who_am_i: 0x70,
            power_management_1: PWR_MGMT_1_RESET,
            temperature_lsb_per_c,
            temperature_zero_c,
            accelerometer_filter_register: address::ACCEL_CONFIG_2,
            divides_unfiltered: false,
            gyroscope_filters: MPU_6500_GYROSCOPE,
            accelerometer_filters: MPU_6500_ACCELEROMETER,
        }
    }

    /// The bits of `register` that keep what is written to them, where this part differs from the
    /// MPU-6050.
    #[must_use]
    pub fn additional_writable_bits(&self, register: u8) -> u8 {
        match register {
            address::GYRO_CONFIG if self.is_of_mpu_6500_family() => FCHOICE_B,
            address::ACCEL_CONFIG_2 if self.is_of_mpu_6500_family() => 0x0F,
            _ => 0,
        }
    }

    /// Returns true if FCHOICE_B leads the gyroscope past its filter.
    #[must_use]
    pub fn bypasses_gyroscope_filter(&self, registers: &RegisterFile) -> bool {
        self.is_of_mpu_6500_family() && registers.get(address::GYRO_CONFIG) & FCHOICE_B != 0
    }

    fn is_of_mpu_6500_family(&self) -> bool {
        self.accelerometer_filter_register == address::ACCEL_CONFIG_2
    }
}

/// GYRO_CONFIG: past the gyroscope's filter unless zero (RM-MPU-6500A r2.1, sections 4.5 and 4.6).
const FCHOICE_B: u8 = 0x03;

const fn response(bandwidth_hz: f64, delay_ms: f64) -> Response {
    Response {
        bandwidth_hz,
        delay_ms,
    }
}

/// Register map r4.2, section 4.3; setting 7 is reserved there and taken to be setting 0.
const MPU_6050_GYROSCOPE: [Response; 8] = [
    response(256.0, 0.98),
    response(188.0, 1.9),
    response(98.0, 2.8),
    response(42.0, 4.8),
    response(20.0, 8.3),
    response(10.0, 13.4),
    response(5.0, 18.6),
    response(256.0, 0.98),
];

/// Register map r4.2, section 4.3; setting 7 is reserved there and taken to be setting 0.
const MPU_6050_ACCELEROMETER: [Response; 8] = [
    response(260.0, 0.0),
    response(184.0, 2.0),
    response(94.0, 3.0),
    response(44.0, 4.9),
    response(21.0, 8.5),
    response(10.0, 13.8),
    response(5.0, 19.0),
    response(260.0, 0.0),
];

/// MPU-6500 register map r2.1, section 4.5. Setting 7 (3600 Hz) is as wide as the model's 8 kHz
/// grid allows.
const MPU_6500_GYROSCOPE: [Response; 8] = [
    response(250.0, 0.97),
    response(184.0, 2.9),
    response(92.0, 3.9),
    response(41.0, 5.9),
    response(20.0, 9.9),
    response(10.0, 17.85),
    response(5.0, 33.48),
    response(3600.0, 0.17),
];

/// MPU-6500 register map r2.1, section 4.8.
const MPU_6500_ACCELEROMETER: [Response; 8] = [
    response(460.0, 1.94),
    response(184.0, 5.8),
    response(92.0, 7.8),
    response(41.0, 11.8),
    response(20.0, 19.8),
    response(10.0, 35.7),
    response(5.0, 66.96),
    response(460.0, 1.94),
];
