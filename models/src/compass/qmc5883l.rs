//! The QMC5883L's register file, from the QST datasheet, revision 1.0 (section 9).

use super::chip::{Chip, Conversion, to_counts};

/// Output rates by bits 3:2 of control register 1, Hz.
const RATES_HZ: [f64; 4] = [10.0, 50.0, 100.0, 200.0];
/// Noise, gauss: 2 milligauss.
const NOISE_GAUSS: f64 = 0.002;

/// The chip.
#[derive(Default)]
pub struct Qmc5883l {
    control_1: u8,
    control_2: u8,
    period: u8,
    next_ns: Option<u64>,
    data: [i16; 3],
    is_data_ready: bool,
    is_overflow: bool,
    is_skipped: bool,
    /// True once register 0 was read: some chips give no identity before.
    is_awake: bool,
}

impl Qmc5883l {
    fn period_ns(&self) -> u64 {
        (1e9 / RATES_HZ[usize::from(self.control_1 >> 2 & 3)]) as u64
    }
}

impl Chip for Qmc5883l {
    fn address(&self) -> u8 {
        0x0D
    }

    fn start_up_ns(&self) -> u64 {
        350_000
    }

    fn next(&self, register: u8) -> u8 {
        // Section 9.2.4: with ROL_PNT the pointer rolls over among 00H to 06H.
        if register == 0x06 && self.control_2 & 0x40 != 0 {
            0x00
        } else {
            register.wrapping_add(1)
        }
    }

    fn read(&mut self, register: u8) -> u8 {
        match register {
            0x00..=0x05 => {
                self.is_awake = true;
                self.is_data_ready = false;
                self.data.map(i16::to_le_bytes).concat()[usize::from(register)]
            }
            0x06 => {
                let skipped = std::mem::take(&mut self.is_skipped);
                u8::from(self.is_data_ready)
                    | u8::from(self.is_overflow) << 1
                    | u8::from(skipped) << 2
            }
            0x09 => self.control_1,
            0x0A => self.control_2,
            0x0B => self.period,
            0x0C if self.is_awake => 0x01,
            0x0D if self.is_awake => 0xFF,
            _ => 0x00,
        }
    }

    fn write(&mut self, register: u8, value: u8, now_ns: u64) {
        match register {
            0x09 => {
                self.control_1 = value & 0xDF;
                let is_continuous = value & 3 == 1;
                self.next_ns = is_continuous.then(|| now_ns + self.period_ns());
            }
            0x0A if value & 0x80 != 0 => {
                *self = Self {
                    is_awake: self.is_awake,
                    ..Self::default()
                };
            }
            0x0A => self.control_2 = value & 0x41,
            0x0B => self.period = value,
            _ => {}
        }
    }

    fn is_output(&self, register: u8) -> bool {
        register <= 0x06
    }

    fn is_identity(&self, register: u8) -> bool {
        register == 0x0D
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
        self.is_skipped |= self.is_data_ready;
        self.is_data_ready = true;
        if conversion.is_frozen {
            return;
        }
        let (gauss, per_gauss) = if self.control_1 >> 4 & 1 == 0 {
            (2.0, 12_000.0)
        } else {
            (8.0, 3_000.0)
        };
        self.is_overflow = false;
        for (data, field_ut) in self.data.iter_mut().zip(conversion.field_ut) {
            let field = field_ut / 100.0 + NOISE_GAUSS * (conversion.normal)();
            self.is_overflow |= field.abs() > gauss;
            *data = to_counts(field * per_gauss, i16::MIN, i16::MAX).0;
        }
    }
}
