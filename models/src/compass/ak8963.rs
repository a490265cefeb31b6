//! The AK8963's register file, from its datasheet MS1356-E-02 (sections 6, 8 and 9).

use super::chip::{Chip, Conversion, to_counts};
use crate::random::Random;

/// Sensitivity with 16 and with 14 bits, µT per count (section 5.3.2).
const FINE_UT: f64 = 0.15;
const COARSE_UT: f64 = 0.6;
/// Sum of the absolute field components at which HOFL is set, µT (section 6.4.3.6).
const OVERFLOW_UT: f64 = 4912.0;
/// Noise, µT.
const NOISE_UT: f64 = 0.4;
/// Time of a measurement, ns (section 5.3.2: 7.2 ms typically).
const MEASUREMENT_NS: u64 = 7_200_000;
/// Field of the self-test along Z, counts.
const SELF_TEST_COUNTS: f64 = -1_600.0;

/// Modes (section 6.3).
const POWER_DOWN: u8 = 0x0;
const SINGLE: u8 = 0x1;
const CONTINUOUS_8_HZ: u8 = 0x2;
const CONTINUOUS_100_HZ: u8 = 0x6;
const SELF_TEST: u8 = 0x8;
const FUSE_ACCESS: u8 = 0xF;

/// The chip.
pub struct Ak8963 {
    trims: [u8; 3],
    mode: u8,
    is_16_bit: bool,
    has_self_field: bool,
    next_ns: Option<u64>,
    now_ns: u64,
    is_data_ready: bool,
    is_overrun: bool,
    /// True from the first data register that was read to ST2.
    is_locked: bool,
    data: [i16; 3],
    is_overflow: bool,
}

impl Ak8963 {
    /// A chip with the trims of a seed.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, "compass trims");
        Self {
            trims: [0; 3].map(|_| random.uniform(160.0, 192.0) as u8),
            mode: POWER_DOWN,
            is_16_bit: false,
            has_self_field: false,
            next_ns: None,
            now_ns: 0,
            is_data_ready: false,
            is_overrun: false,
            is_locked: false,
            data: [0; 3],
            is_overflow: false,
        }
    }

    fn period_ns(&self) -> Option<u64> {
        match self.mode {
            CONTINUOUS_8_HZ => Some(125_000_000),
            CONTINUOUS_100_HZ => Some(10_000_000),
            _ => None,
        }
    }

    fn enter(&mut self, mode: u8, now_ns: u64) {
        self.mode = mode;
        self.is_data_ready = false;
        self.is_locked = false;
        let measures = matches!(
            mode,
            SINGLE | CONTINUOUS_8_HZ | CONTINUOUS_100_HZ | SELF_TEST
        );
        self.next_ns = measures.then_some(now_ns + MEASUREMENT_NS);
    }
}

impl Chip for Ak8963 {
    fn address(&self) -> u8 {
        0x0C
    }

    fn start_up_ns(&self) -> u64 {
        // Section 5.3.3: usable 50 ms after power-up.
        50_000_000
    }

    fn next(&self, register: u8) -> u8 {
        // Section 7.2.2: 00H to 0CH and 10H to 12H, each around.
        match register {
            0x0C => 0x00,
            0x12 => 0x10,
            other => other.wrapping_add(1),
        }
    }

    fn read(&mut self, register: u8) -> u8 {
        match register {
            0x00 => 0x48,
            0x01 => 0x9A,
            0x02 => u8::from(self.is_data_ready) | u8::from(self.is_overrun) << 1,
            0x03..=0x08 => {
                self.is_locked = true;
                let [x, y, z] = self.data.map(i16::to_le_bytes);
                [x, y, z].concat()[usize::from(register) - 3]
            }
            0x09 => {
                self.is_locked = false;
                self.is_data_ready = false;
                self.is_overrun = false;
                u8::from(self.is_overflow) << 3 | u8::from(self.is_16_bit) << 4
            }
            0x0A => self.mode | u8::from(self.is_16_bit) << 4,
            0x0C => u8::from(self.has_self_field) << 6,
            0x10..=0x12 if self.mode == FUSE_ACCESS => self.trims[usize::from(register) - 0x10],
            _ => 0x00,
        }
    }

    fn write(&mut self, register: u8, value: u8, now_ns: u64) {
        match register {
            0x0A => {
                self.is_16_bit = value & 0x10 != 0;
                let mode = value & 0x0F;
                // Section 6.3: a mode is left through power-down alone.
                if mode == POWER_DOWN || self.mode == POWER_DOWN {
                    self.enter(mode, now_ns);
                }
            }
            0x0B if value & 1 != 0 => {
                let trims = self.trims;
                *self = Self {
                    trims,
                    ..Self::new(0)
                };
            }
            0x0C => self.has_self_field = value & 0x40 != 0,
            _ => {}
        }
    }

    fn is_output(&self, register: u8) -> bool {
        (0x02..=0x09).contains(&register)
    }

    fn is_identity(&self, register: u8) -> bool {
        register == 0x00
    }

    fn next_conversion_ns(&self) -> Option<u64> {
        self.next_ns
    }

    fn convert(&mut self, conversion: &mut Conversion<'_>) {
        self.now_ns = self.next_ns.take().unwrap_or(self.now_ns);
        self.next_ns = self.period_ns().map(|period_ns| self.now_ns + period_ns);
        let is_single = matches!(self.mode, SINGLE | SELF_TEST);
        let is_self_test = self.mode == SELF_TEST && self.has_self_field;
        if is_single {
            self.mode = POWER_DOWN;
        }
        // The chip's X is the package's Y, and its Z points the other way (MPU-9250 PS 9.1).
        let [x, y, z] = conversion.field_ut;
        let along = [y, x, -z];
        self.is_overrun |= self.is_data_ready;
        self.is_data_ready = !conversion.is_never_ready;
        if self.is_locked || conversion.is_frozen {
            return;
        }
        self.is_overflow = along.iter().map(|part| part.abs()).sum::<f64>() >= OVERFLOW_UT;
        let per_count = if self.is_16_bit { FINE_UT } else { COARSE_UT };
        let highest = if self.is_16_bit { 32_760 } else { 8_190 };
        for (axis, (data, field)) in self.data.iter_mut().zip(along).enumerate() {
            // Section 8.3.11: what is read times this factor is the field.
            let adjustment = (f64::from(self.trims[axis]) - 128.0) * 0.5 / 128.0 + 1.0;
            let noisy = field + NOISE_UT * (conversion.normal)();
            // The bit generates the field (section 8.3.8); no mode is excepted.
            let own = if self.has_self_field && axis == 2 {
                SELF_TEST_COUNTS
            } else {
                0.0
            };
            let counts = if is_self_test {
                own
            } else {
                own + noisy / per_count / adjustment
            };
            *data = to_counts(counts, -highest, highest).0;
        }
    }
}
