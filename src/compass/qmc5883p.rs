//! QMC5883P, the compass of newer GY-87 boards. Its registers are not those of the QMC5883L.
//!
//! Register numbers are those of the QST datasheet 13-52-19, revision C (§9).
//!
//! Reading the status clears the data-ready flag, so a reading runs from the data to the status.

use super::part::{Bytes, Facts, Part, Registers, Status, Step, little_endian, mean_age_us};
use super::qmc5883l::status_of;

/// Bus address.
pub(super) const ADDRESS: u8 = 0x2C;
/// Chip identity (§9.2.1).
const IDENTIFICATION: Registers = Registers::new(0x00, 2);
const IDENTITY: u8 = 0x80;
/// Data, X, Y, Z, little-endian; two unused registers; status (§9.2.2, §9.2.3).
const READING: Registers = Registers::new(0x01, 9);
const STATUS_RESERVED: u8 = !0b11;
/// Control register 1: oversampling, rate, mode (§9.2.4).
const CONTROL_1: u8 = 0x0A;
/// Both oversampling ratios 8, 100 Hz, continuous.
const CONTINUOUS_100_HZ: u8 = 0xCB;
/// Period at that rate, µs. The samples are taken to fill it.
const PERIOD_US: u32 = 10_000;
/// Control register 2: soft reset, range, set and reset.
const CONTROL_2: u8 = 0x0B;
const SOFT_RESET: u8 = 0x80;
/// ±8 gauss, set and reset on.
const RANGE_8_GAUSS: u8 = 0x08;
/// Signs of the axes; the datasheet's examples write 0x06 (§7.1). It promises no read-back.
const AXIS_SIGNS: u8 = 0x29;
const SIGNS: u8 = 0x06;
/// µT per count at ±8 gauss: 3750 counts per gauss (§2, table 2).
const UT_PER_COUNT: f32 = 100.0 / 3750.0;

const CONFIGURATION: [Step; 6] = [
    Step::Write(CONTROL_2, SOFT_RESET),
    Step::Write(CONTROL_2, RANGE_8_GAUSS),
    Step::Write(AXIS_SIGNS, SIGNS),
    Step::Write(CONTROL_1, CONTINUOUS_100_HZ),
    Step::Verify(CONTROL_2, RANGE_8_GAUSS),
    Step::Verify(CONTROL_1, CONTINUOUS_100_HZ),
];

static FACTS: Facts = Facts {
    identification: IDENTIFICATION,
    identity: &[IDENTITY],
    configuration: &CONFIGURATION,
    setting: (CONTROL_1, CONTINUOUS_100_HZ),
    reading: READING,
    mean_age_us: mean_age_us(PERIOD_US, PERIOD_US),
    ut_per_count: UT_PER_COUNT,
    self_test: None,
};

/// QMC5883P.
pub(super) struct Qmc5883p;

impl Part for Qmc5883p {
    fn facts(&self) -> &'static Facts {
        &FACTS
    }

    fn status(&self, bytes: &Bytes) -> Status {
        let &[.., status] = bytes;
        status_of(status, STATUS_RESERVED)
    }

    fn counts(&self, bytes: &Bytes) -> [i16; 3] {
        let &[xl, xh, yl, yh, zl, zh, ..] = bytes;
        little_endian([xl, xh, yl, yh, zl, zh])
    }
}
