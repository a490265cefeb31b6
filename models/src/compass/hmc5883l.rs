//! The HMC5883L's register file, from the Honeywell datasheet, form 900405 revision E.

use super::chip::{Chip, Conversion, to_counts};

/// Counts per gauss by the gain bits of configuration register B.
const GAINS: [f64; 8] = [1370.0, 1090.0, 820.0, 660.0, 440.0, 390.0, 330.0, 230.0];
/// Output rates in continuous mode by bits 4:2 of configuration register A, Hz.
const RATES_HZ: [f64; 8] = [0.75, 1.5, 3.0, 7.5, 15.0, 30.0, 75.0, 75.0];
/// Noise of one sample, gauss: 2 milligauss.
const NOISE_GAUSS: f64 = 0.002;
/// Field of the self-test, gauss: along X and Y, and along Z.
const SELF_TEST_GAUSS: [f64; 3] = [1.16, 1.16, 1.08];
/// Time of a single measurement, ns.
const MEASUREMENT_NS: u64 = 6_000_000;

/// The chip.
pub struct Hmc5883l {
    /// True for the clone whose status stays zero.
    is_clone: bool,
    config_a: u8,
    config_b: u8,
    mode: u8,
    /// Gain of the measurement under way: a change counts from the second one on.
    gain: usize,
    next_ns: Option<u64>,
    /// Data registers: X, Z, Y.
    data: [i16; 3],
    /// Data registers that have been read since the last measurement, as bits.
    read: u8,
    /// True if the mode register has been read, which locks the data too (table 17).
    is_mode_read: bool,
    is_data_ready: bool,
}

impl Hmc5883l {
    /// A chip, or its clone.
    pub fn new(is_clone: bool) -> Self {
        let mut chip = Self {
            is_clone,
            config_a: 0x10,
            config_b: 0x20,
            mode: 0x01,
            gain: 1,
            next_ns: None,
            data: [0; 3],
            read: 0,
            is_mode_read: false,
            is_data_ready: false,
        };
        chip.start(0);
        chip
    }

    /// Starts to measure, after a write to the mode or a configuration register. In continuous
    /// mode the first measurement takes two periods (table 12).
    fn start(&mut self, now_ns: u64) {
        self.next_ns = match self.mode & 3 {
            0 => Some(now_ns + 2 * self.period_ns()),
            1 => Some(now_ns + MEASUREMENT_NS),
            _ => None,
        };
    }

    fn period_ns(&self) -> u64 {
        (1e9 / RATES_HZ[usize::from(self.config_a >> 2 & 7)]) as u64
    }

    fn is_locked(&self) -> bool {
        self.read != 0 || self.is_mode_read
    }

    fn unlock(&mut self) {
        (self.read, self.is_mode_read) = (0, false);
    }

    /// Takes a new value of a configuration register.
    fn configure(&mut self, now_ns: u64) {
        // A single measurement that is over does not begin again.
        if self.mode == 0 {
            self.start(now_ns);
        }
    }
}

impl Chip for Hmc5883l {
    fn address(&self) -> u8 {
        0x1E
    }

    fn start_up_ns(&self) -> u64 {
        50_000_000
    }

    fn next(&self, register: u8) -> u8 {
        // Register access: after the last data register the pointer returns to the first.
        match register {
            0x08 => 0x03,
            0x0C => 0x00,
            other => other.wrapping_add(1),
        }
    }

    fn read(&mut self, register: u8) -> u8 {
        match register {
            0x00 => self.config_a,
            0x01 => self.config_b,
            0x02 => {
                self.is_mode_read = true;
                self.mode
            }
            0x03..=0x08 => {
                let nth = usize::from(register) - 3;
                self.read |= 1 << nth;
                if self.read == 0x3F {
                    self.unlock();
                }
                let bytes = self.data.map(i16::to_be_bytes).concat();
                bytes[nth]
            }
            0x09 if self.is_clone => 0x00,
            0x09 => u8::from(self.is_data_ready) | u8::from(self.is_locked()) << 1,
            0x0A => b'H',
            0x0B => b'4',
            0x0C => b'3',
            _ => 0x00,
        }
    }

    fn write(&mut self, register: u8, value: u8, now_ns: u64) {
        match register {
            0x00 => {
                // The lock ends when the register changes (table 17).
                if self.config_a != value & 0x7F {
                    self.unlock();
                }
                self.config_a = value & 0x7F;
                self.configure(now_ns);
            }
            0x01 => {
                self.config_b = value & 0xE0;
                self.configure(now_ns);
            }
            0x02 => {
                if self.mode != value & 0x03 {
                    self.unlock();
                }
                self.mode = value & 0x03;
                self.start(now_ns);
            }
            _ => {}
        }
    }

    fn is_output(&self, register: u8) -> bool {
        (0x03..=0x09).contains(&register)
    }

    fn is_identity(&self, register: u8) -> bool {
        (0x0A..=0x0C).contains(&register)
    }

    fn next_conversion_ns(&self) -> Option<u64> {
        self.next_ns
    }

    fn convert(&mut self, conversion: &mut Conversion<'_>) {
        let Some(now_ns) = self.next_ns.take() else {
            return;
        };
        if self.mode == 0 {
            self.next_ns = Some(now_ns + self.period_ns());
        } else {
            self.mode |= 2;
        }
        let gain = std::mem::replace(&mut self.gain, usize::from(self.config_b >> 5));
        if conversion.is_never_ready || conversion.is_frozen || self.is_locked() {
            return;
        }
        let samples = f64::from(1_u8 << (self.config_a >> 5 & 3));
        let bias = match self.config_a & 3 {
            1 => 1.0,
            2 => -1.0,
            _ => 0.0,
        };
        let mut counts = [0; 3];
        for (axis, count) in counts.iter_mut().enumerate() {
            let gauss = if bias == 0.0 {
                conversion.field_ut[axis] / 100.0
            } else {
                // The external field is subtracted.
                bias * SELF_TEST_GAUSS[axis]
            };
            let noise = NOISE_GAUSS * (conversion.normal)() / samples.sqrt();
            let (value, is_beyond) = to_counts((gauss + noise) * GAINS[gain], -2048, 2047);
            *count = if is_beyond { -4096 } else { value };
        }
        let [x, y, z] = counts;
        self.data = [x, z, y];
        self.is_data_ready = true;
    }
}
