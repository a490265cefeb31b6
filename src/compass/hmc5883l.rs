//! HMC5883L, the compass of old GY-86 and GY-87 boards and of many GPS modules.
//!
//! Register numbers and limits are those of the Honeywell datasheet, form 900405 revision E.
//!
//! The data registers keep a measurement until all six are read. A reading comes every 20 ms and a
//! measurement every 13 ms, so each reading is a new one, and its status needs no check. A read of
//! the mode register locks the data registers too (table 17, LOCK). The first measurement comes
//! 27 ms after a change of the settings, and the first after a change of the gain has the old gain.
//!
//! A clone that is marked DA5883 has the same registers, but its status never shows a measurement.

use super::part::{Bytes, Facts, Part, Registers, SelfTestPlan, Status, Step, mean_age_us};

/// Bus address.
pub(super) const ADDRESS: u8 = 0x1E;
/// Configuration register A: samples per output, rate, bias.
const CONFIG_A: u8 = 0x00;
/// Mean of eight samples, 75 Hz, no bias.
const EIGHT_SAMPLES_75_HZ: u8 = 0x78;
/// Period at that rate, µs, to 0.1 ms. The eight samples are taken to fill it.
const PERIOD_US: u32 = 13_300;
/// Mean of eight samples, 75 Hz, positive bias: a field of about 1.1 gauss.
const POSITIVE_BIAS: u8 = 0x79;
/// Configuration register B: gain.
const CONFIG_B: u8 = 0x01;
/// ±2.5 gauss, 660 counts per gauss: room for a strong hard iron.
const GAIN_660: u8 = 0x60;
/// Mode register.
const MODE: u8 = 0x02;
const CONTINUOUS: u8 = 0x00;
/// Data registers: X, Z, Y, big-endian.
const READING: Registers = Registers::new(0x03, 6);
/// Status register: bit 0 is set while a measurement waits.
const STATUS: u8 = 0x09;
const STATUS_READY: u8 = 1 << 0;
/// Identification registers A to C.
const IDENTIFICATION: Registers = Registers::new(0x0A, 3);
const IDENTITY: [u8; 3] = *b"H43";
/// Counts of an axis that overflows.
const OVERFLOW: i16 = -4096;
/// Counts that 12 bits can hold.
const COUNTS: core::ops::RangeInclusive<i16> = -2048..=2047;
/// µT per count: 100 µT are a gauss.
const UT_PER_COUNT: f32 = 100.0 / 660.0;

const CONFIGURATION: [Step; 9] = [
    Step::Write(CONFIG_A, EIGHT_SAMPLES_75_HZ),
    Step::Write(CONFIG_B, GAIN_660),
    Step::Write(MODE, CONTINUOUS),
    // Both read the mode register, which locks the data registers.
    Step::Verify(CONFIG_B, GAIN_660),
    Step::Verify(MODE, CONTINUOUS),
    // Unlocks them.
    Step::Drop(READING),
    Step::Genuine(STATUS, STATUS_READY),
    // This measurement may be the first, and have the old gain. The next reading is a new one.
    Step::Drop(READING),
    Step::Verify(CONFIG_A, EIGHT_SAMPLES_75_HZ),
];

/// Self-test with its limits at 660 counts per gauss: 243·660/390 and 575·660/390.
static SELF_TEST: SelfTestPlan = SelfTestPlan {
    steps: &[
        Step::Write(CONFIG_A, POSITIVE_BIAS),
        Step::Write(CONFIG_B, GAIN_660),
        Step::Write(MODE, CONTINUOUS),
        // The first measurements still have the old settings.
        Step::Verify(CONFIG_A, POSITIVE_BIAS),
        Step::Verify(CONFIG_A, POSITIVE_BIAS),
        Step::Verify(CONFIG_A, POSITIVE_BIAS),
    ],
    limits: [[411.0, 973.0]; 3],
};

static FACTS: Facts = Facts {
    identification: IDENTIFICATION,
    identity: &IDENTITY,
    configuration: &CONFIGURATION,
    // Not the gain, because the register after it is the mode.
    setting: (CONFIG_A, EIGHT_SAMPLES_75_HZ),
    reading: READING,
    mean_age_us: mean_age_us(PERIOD_US, PERIOD_US),
    ut_per_count: UT_PER_COUNT,
    self_test: Some(&SELF_TEST),
};

/// HMC5883L.
pub(super) struct Hmc5883l;

impl Part for Hmc5883l {
    fn facts(&self) -> &'static Facts {
        &FACTS
    }

    fn status(&self, bytes: &Bytes) -> Status {
        let counts = self.counts(bytes);
        if counts.contains(&OVERFLOW) {
            Status::Overflow
        } else if counts.iter().all(|count| COUNTS.contains(count)) {
            Status::Ready
        } else {
            Status::Garbled
        }
    }

    fn counts(&self, bytes: &Bytes) -> [i16; 3] {
        let &[xh, xl, zh, zl, yh, yl, ..] = bytes;
        [
            i16::from_be_bytes([xh, xl]),
            i16::from_be_bytes([yh, yl]),
            i16::from_be_bytes([zh, zl]),
        ]
    }
}
