//! QMC5883L, which most boards sold as HMC5883L carry, marked 5883L or DB5883.
//!
//! Register numbers are those of the QST datasheet, revision 1.0 (§9).
//!
//! Reading a data register clears the data-ready flag. Therefore a reading starts at the status,
//! and the pointer rolls over from there to the data (ROL_PNT, §9.2.4).

use super::part::{Bytes, Facts, Part, Registers, Status, Step, little_endian, mean_age_us};

/// Bus address.
pub(super) const ADDRESS: u8 = 0x0D;
/// Status, then by roll-over the data, X, Y, Z, little-endian (§9.2.1, §9.2.2).
const READING: Registers = Registers::new(0x06, 7);
const STATUS_READY: u8 = 1 << 0;
const STATUS_OVERFLOW: u8 = 1 << 1;
const STATUS_RESERVED: u8 = !0b111;
/// Control register 1: oversampling, range, rate, mode (§9.2.4).
const CONTROL_1: u8 = 0x09;
/// 512 samples, ±8 gauss, 100 Hz, continuous.
const CONTINUOUS_100_HZ: u8 = 0x19;
/// Period at that rate, µs. The samples are taken to fill it.
const PERIOD_US: u32 = 10_000;
/// Control register 2: soft reset, roll-over of the pointer, interrupt off.
const CONTROL_2: u8 = 0x0A;
const SOFT_RESET: u8 = 0x80;
const ROLL_OVER_NO_INTERRUPT: u8 = 0x41;
/// SET/RESET period: "recommended to be written by 0x01" (§9.2.5).
const SET_RESET_PERIOD: u8 = 0x0B;
/// Undocumented register that reads 0x01, then the chip identity (§9.2.6).
const IDENTIFICATION: Registers = Registers::new(0x0C, 2);
const IDENTITY: [u8; 2] = [0x01, 0xFF];
/// µT per count at ±8 gauss: 3000 counts per gauss (§2, table 2).
const UT_PER_COUNT: f32 = 100.0 / 3000.0;

const CONFIGURATION: [Step; 7] = [
    Step::Write(CONTROL_2, SOFT_RESET),
    Step::Write(SET_RESET_PERIOD, 0x01),
    Step::Write(CONTROL_2, ROLL_OVER_NO_INTERRUPT),
    Step::Write(CONTROL_1, CONTINUOUS_100_HZ),
    Step::Verify(SET_RESET_PERIOD, 0x01),
    Step::Verify(CONTROL_2, ROLL_OVER_NO_INTERRUPT),
    Step::Verify(CONTROL_1, CONTINUOUS_100_HZ),
];

static FACTS: Facts = Facts {
    identification: IDENTIFICATION,
    identity: &IDENTITY,
    configuration: &CONFIGURATION,
    setting: (CONTROL_1, CONTINUOUS_100_HZ),
    reading: READING,
    mean_age_us: mean_age_us(PERIOD_US, PERIOD_US),
    ut_per_count: UT_PER_COUNT,
    self_test: None,
};

/// QMC5883L.
pub(super) struct Qmc5883l;

impl Part for Qmc5883l {
    fn facts(&self) -> &'static Facts {
        &FACTS
    }

    fn status(&self, bytes: &Bytes) -> Status {
        let &[status, ..] = bytes;
        status_of(status, STATUS_RESERVED)
    }

    fn counts(&self, bytes: &Bytes) -> [i16; 3] {
        let &[_, xl, xh, yl, yh, zl, zh, ..] = bytes;
        little_endian([xl, xh, yl, yh, zl, zh])
    }
}

/// Returns the condition by a status register of this family.
pub(super) const fn status_of(status: u8, reserved: u8) -> Status {
    if status & reserved != 0 {
        Status::Garbled
    } else if status & STATUS_READY == 0 {
        Status::NotReady
    } else if status & STATUS_OVERFLOW != 0 {
        Status::Overflow
    } else {
        Status::Ready
    }
}
