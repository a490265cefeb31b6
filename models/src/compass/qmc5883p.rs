//! The QMC5883P's register file, from the QST datasheet 13-52-19, revision C (sections 7 and 9).

use super::chip::{Chip, Conversion, to_counts};

/// Output rates by bits 3:2 of control register 1, Hz.
const RATES_HZ: [f64; 4] = [10.0, 50.0, 100.0, 200.0];
/// Full scale in gauss and counts per gauss, by bits 3:2 of control register 2.
const RANGES: [(f64, f64); 4] = [
    (30.0, 1_000.0),
    (12.0, 2_500.0),
    (8.0, 3_750.0),
    (2.0, 15_000.0),
];
/// Noise, gauss: 2 milligauss.
const NOISE_GAUSS: f64 = 0.002;

/// The chip.
#[derive(Default)]
pub struct Qmc5883p {
    control_1: u8,
    control_2: u8,
    next_ns: Option<u64>,
    data: [i16; 3],
    is_data_ready: bool,
    is_overflow: bool,
}

impl Qmc5883p {
    fn period_ns(&self) -> u64 {
        (1e9 / RATES_HZ[usize::from(self.control_1 >> 2 & 3)]) as u64
    }
}

impl Chip for Qmc5883p {
    fn address(&self) -> u8 {
        0x2C
    }

    fn start_up_ns(&self) -> u64 {
        250_000
    }

    fn read(&mut self, register: u8) -> u8 {
        match register {
            0x00 => 0x80,
            0x01..=0x06 => self.data.map(i16::to_le_bytes).concat()[usize::from(register) - 1],
            0x09 => {
                let ready = std::mem::take(&mut self.is_data_ready);
                u8::from(ready) | u8::from(self.is_overflow) << 1
            }
            0x0A => self.control_1,
            0x0B => self.control_2,
            // The signs of the axes (0x29) are not in the register map: no read-back.
            _ => 0x00,
        }
    }

    fn write(&mut self, register: u8, value: u8, now_ns: u64) {
        match register {
            0x0A => {
                self.control_1 = value;
                let measures = value & 3 != 0;
                self.next_ns = measures.then(|| now_ns + self.period_ns());
            }
            0x0B if value & 0x80 != 0 => {
                *self = Self { ..Self::default() };
            }
            0x0B => self.control_2 = value & 0x4F,
            _ => {}
        }
    }

    fn is_output(&self, register: u8) -> bool {
        (0x01..=0x09).contains(&register)
    }

    fn is_identity(&self, register: u8) -> bool {
        register == 0x00
    }

    fn next_conversion_ns(&self) -> Option<u64> {
        self.next_ns
    }

    fn convert(&mut self, conversion: &mut Conversion<'_>) {
        let Some(now_ns) = self.next_ns else { return };
        self.next_ns = Some(now_ns + self.period_ns());
        if conversion.is_never_ready {
            return;
        }
        self.is_data_ready = true;
        if conversion.is_frozen {
            return;
        }
        let (gauss, per_gauss) = RANGES[usize::from(self.control_2 >> 2 & 3)];
        self.is_overflow = false;
        for (data, field_ut) in self.data.iter_mut().zip(conversion.field_ut) {
            let field = field_ut / 100.0 + NOISE_GAUSS * (conversion.normal)();
            self.is_overflow |= field.abs() > gauss;
            *data = to_counts(field * per_gauss, i16::MIN, i16::MAX).0;
        }
    }
}
