//! AK8963, the compass inside an MPU-9250 or MPU-9255.
//!
//! The IMU's bypass (INT_PIN_CFG bit 1) puts it on the main bus. Section numbers are those of the
//! AK8963 datasheet, MS1356-E-02.
//!
//! A reading begins with ST1 and ends with ST2: reading ST2 frees the data registers for the next
//! measurement (§6.4.3.2). The chip's X is the accelerometer's Y, its Y the accelerometer's X, and
//! its Z points down the other way (MPU-9250 product specification, §9.1).

use super::part::{
    Bytes, Facts, Part, Registers, SelfTestPlan, Status, Step, little_endian, mean_age_us,
};
use crate::attitude::Vector3;

/// Bus address with CAD0 and CAD1 low, as inside the MPU-9250.
pub(super) const ADDRESS: u8 = 0x0C;
/// WIA, the identity (§8.3.1).
const WIA: u8 = 0x00;
const IDENTITY: u8 = 0x48;
/// ST1, the data, ST2 (§8.3.3 to §8.3.5).
const ST1: u8 = 0x02;
const READING: Registers = Registers::new(ST1, 8);
/// ST1: data ready, data overrun.
const ST1_READY: u8 = 1 << 0;
const ST1_RESERVED: u8 = !0b11;
/// ST2: sensor overflow, and 16-bit output as CNTL1 sets it.
const ST2_OVERFLOW: u8 = 1 << 3;
const ST2_16_BIT: u8 = 1 << 4;
const ST2_RESERVED: u8 = !(ST2_OVERFLOW | ST2_16_BIT);
/// CNTL1: output width and mode (§8.3.6).
const CNTL1: u8 = 0x0A;
const POWER_DOWN: u8 = 0x00;
/// 16 bits, continuous mode 2: 100 Hz.
const CONTINUOUS_100_HZ: u8 = 0x16;
/// Period of that mode, µs.
const PERIOD_US: u32 = 10_000;
/// Time of a measurement, µs: typical (§5.3.2).
const MEASUREMENT_US: u32 = 7_200;
const SELF_TEST_16_BIT: u8 = 0x18;
const FUSE_ACCESS: u8 = 0x1F;
/// CNTL2: soft reset (§8.3.7).
const CNTL2: u8 = 0x0B;
const SOFT_RESET: u8 = 0x01;
/// ASTC: the field of the self-test (§8.3.8).
const ASTC: u8 = 0x0C;
const SELF_FIELD: u8 = 0x40;
/// ASAX to ASAZ, the sensitivity adjustments (§8.3.11).
const ASAX: u8 = 0x10;
/// µT per count with 16 bits (§5.3.2).
const UT_PER_COUNT: f32 = 0.15;

const CONFIGURATION: [Step; 6] = [
    Step::Write(CNTL2, SOFT_RESET),
    Step::Write(CNTL1, FUSE_ACCESS),
    Step::Trim(ASAX),
    // Each change of mode goes through power-down (§6.3).
    Step::Write(CNTL1, POWER_DOWN),
    Step::Write(CNTL1, CONTINUOUS_100_HZ),
    Step::Verify(CNTL1, CONTINUOUS_100_HZ),
];

/// Self-test with its limits for 16 bits (§9.4.4).
static SELF_TEST: SelfTestPlan = SelfTestPlan {
    steps: &[
        Step::Write(CNTL1, POWER_DOWN),
        Step::Write(ASTC, SELF_FIELD),
        Step::Write(CNTL1, SELF_TEST_16_BIT),
    ],
    limits: [[-200.0, 200.0], [-200.0, 200.0], [-3200.0, -800.0]],
};

static FACTS: Facts = Facts {
    identification: Registers::new(WIA, 2),
    identity: &[IDENTITY],
    configuration: &CONFIGURATION,
    setting: (CNTL1, CONTINUOUS_100_HZ),
    reading: READING,
    mean_age_us: mean_age_us(PERIOD_US, MEASUREMENT_US),
    ut_per_count: UT_PER_COUNT,
    self_test: Some(&SELF_TEST),
};

/// AK8963.
pub(super) struct Ak8963;

impl Part for Ak8963 {
    fn facts(&self) -> &'static Facts {
        &FACTS
    }

    fn status(&self, bytes: &Bytes) -> Status {
        let &[st1, .., st2, _] = bytes;
        let is_possible = st1 & ST1_RESERVED == 0 && st2 & ST2_RESERVED == 0;
        if !is_possible || st2 & ST2_16_BIT == 0 {
            Status::Garbled
        } else if st1 & ST1_READY == 0 {
            Status::NotReady
        } else if st2 & ST2_OVERFLOW != 0 {
            Status::Overflow
        } else {
            Status::Ready
        }
    }

    fn counts(&self, bytes: &Bytes) -> [i16; 3] {
        let &[_, xl, xh, yl, yh, zl, zh, _, _] = bytes;
        little_endian([xl, xh, yl, yh, zl, zh])
    }

    /// Applies H·((ASA − 128)·0.5/128 + 1) (§8.3.11).
    fn adjust(&self, counts: [i16; 3], trims: [u8; 3]) -> [f32; 3] {
        let [x, y, z] = counts.map(f32::from);
        let [tx, ty, tz] = trims.map(|trim| (f32::from(trim) - 128.0) / 256.0 + 1.0);
        [x * tx, y * ty, z * tz]
    }

    fn to_module_axes(&self, vector: Vector3) -> Vector3 {
        Vector3::new(vector.y, vector.x, -vector.z)
    }
}
