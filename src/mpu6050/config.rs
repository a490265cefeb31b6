//! Settings of the sensor: full scales, low-pass filter, sample rate.

use crate::state::Exchange;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// The accelerometer's full scale.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AccelerometerRange {
    /// ±2 g, 16384 counts per g.
    G2 = 0,
    /// ±4 g, 8192 counts per g.
    G4 = 1,
    /// ±8 g, 4096 counts per g.
    G8 = 2,
    /// ±16 g, 2048 counts per g: what a vibrating airframe needs.
    #[default]
    G16 = 3,
}

impl AccelerometerRange {
    /// Every range, smallest first.
    pub const ALL: [Self; 4] = [Self::G2, Self::G4, Self::G8, Self::G16];

    /// AFS_SEL (register map §4.5).
    pub const fn bits(self) -> u8 {
        self as u8
    }

    /// Sensitivity in counts per g (product specification §6.2).
    pub const fn counts_per_g(self) -> f32 {
        match self {
            Self::G2 => 16384.0,
            Self::G4 => 8192.0,
            Self::G8 => 4096.0,
            Self::G16 => 2048.0,
        }
    }

    /// m/s² per count.
    pub const fn m_s2_per_count(self) -> f32 {
        STANDARD_GRAVITY_M_S2 / self.counts_per_g()
    }
}

/// The gyroscope's full scale.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GyroscopeRange {
    /// ±250 °/s, 131 counts per °/s.
    Degrees250 = 0,
    /// ±500 °/s, 65.5 counts per °/s.
    Degrees500 = 1,
    /// ±1000 °/s, 32.8 counts per °/s.
    Degrees1000 = 2,
    /// ±2000 °/s, 16.4 counts per °/s: saturation ruins an attitude, resolution hardly matters.
    #[default]
    Degrees2000 = 3,
}

impl GyroscopeRange {
    /// Every range, smallest first.
    pub const ALL: [Self; 4] = [
        Self::Degrees250,
        Self::Degrees500,
        Self::Degrees1000,
        Self::Degrees2000,
    ];

    /// FS_SEL (register map §4.4).
    pub const fn bits(self) -> u8 {
        self as u8
    }

    /// Sensitivity in counts per °/s (product specification §6.1).
    pub const fn counts_per_degree_s(self) -> f32 {
        match self {
            Self::Degrees250 => 131.0,
            Self::Degrees500 => 65.5,
            Self::Degrees1000 => 32.8,
            Self::Degrees2000 => 16.4,
        }
    }

    /// rad/s per count.
    pub const fn rad_s_per_count(self) -> f32 {
        radians(1.0) / self.counts_per_degree_s()
    }
}

/// The digital low-pass filter, named by the gyroscope's bandwidth in hertz.
///
/// Bandwidths and delays are the MPU-6050's (register map §4.3). The MPU-6500 family takes the same
/// settings with bandwidths within 6 Hz and delays that are longer, up to twice as long at the
/// narrow end.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LowPass {
    /// Gyroscope 256 Hz, 0.98 ms; accelerometer 260 Hz. The filter runs at 8 kHz.
    Hertz256 = 0,
    /// Gyroscope 188 Hz, 1.9 ms; accelerometer 184 Hz, 2.0 ms.
    #[default]
    Hertz188 = 1,
    /// Gyroscope 98 Hz, 2.8 ms; accelerometer 94 Hz, 3.0 ms.
    Hertz98 = 2,
    /// Gyroscope 42 Hz, 4.8 ms; accelerometer 44 Hz, 4.9 ms.
    Hertz42 = 3,
    /// Gyroscope 20 Hz, 8.3 ms; accelerometer 21 Hz, 8.5 ms.
    Hertz20 = 4,
    /// Gyroscope 10 Hz, 13.4 ms; accelerometer 10 Hz, 13.8 ms.
    Hertz10 = 5,
    /// Gyroscope 5 Hz, 18.6 ms; accelerometer 5 Hz, 19.0 ms.
    Hertz5 = 6,
}

impl LowPass {
    /// Every setting, widest first.
    pub const ALL: [Self; 7] = [
        Self::Hertz256,
        Self::Hertz188,
        Self::Hertz98,
        Self::Hertz42,
        Self::Hertz20,
        Self::Hertz10,
        Self::Hertz5,
    ];

    /// DLPF_CFG (register map §4.3).
    pub const fn bits(self) -> u8 {
        self as u8
    }

    /// The rate at which the filter puts out samples, before the divider, in hertz.
    pub const fn output_rate_hz(self) -> u16 {
        match self {
            Self::Hertz256 => 8000,
            _ => 1000,
        }
    }

    /// The gyroscope's bandwidth in hertz.
    pub const fn gyroscope_bandwidth_hz(self) -> u16 {
        match self {
            Self::Hertz256 => 256,
            Self::Hertz188 => 188,
            Self::Hertz98 => 98,
            Self::Hertz42 => 42,
            Self::Hertz20 => 20,
            Self::Hertz10 => 10,
            Self::Hertz5 => 5,
        }
    }

    /// The accelerometer's bandwidth in hertz.
    pub const fn accelerometer_bandwidth_hz(self) -> u16 {
        match self {
            Self::Hertz256 => 260,
            Self::Hertz188 => 184,
            Self::Hertz98 => 94,
            Self::Hertz42 => 44,
            Self::Hertz20 => 21,
            Self::Hertz10 => 10,
            Self::Hertz5 => 5,
        }
    }

    /// By how much the gyroscope lags the motion, in microseconds.
    pub const fn gyroscope_delay_us(self) -> u16 {
        match self {
            Self::Hertz256 => 980,
            Self::Hertz188 => 1900,
            Self::Hertz98 => 2800,
            Self::Hertz42 => 4800,
            Self::Hertz20 => 8300,
            Self::Hertz10 => 13400,
            Self::Hertz5 => 18600,
        }
    }

    /// By how much the accelerometer lags the motion, in microseconds.
    pub const fn accelerometer_delay_us(self) -> u16 {
        match self {
            Self::Hertz256 => 0,
            Self::Hertz188 => 2000,
            Self::Hertz98 => 3000,
            Self::Hertz42 => 4900,
            Self::Hertz20 => 8500,
            Self::Hertz10 => 13800,
            Self::Hertz5 => 19000,
        }
    }
}

/// What the sensor is told. The default is 1 kHz, ±16 g, ±2000 °/s, 188 Hz.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// The accelerometer's full scale.
    pub accelerometer_range: AccelerometerRange,
    /// The gyroscope's full scale.
    pub gyroscope_range: GyroscopeRange,
    /// The low-pass filter in front of both.
    pub low_pass: LowPass,
    /// SMPLRT_DIV: samples come at the filter's output rate over this plus one.
    pub sample_rate_divider: u8,
}

impl Config {
    /// The default settings, for constants.
    pub const DEFAULT: Self = Self {
        accelerometer_range: AccelerometerRange::G16,
        gyroscope_range: GyroscopeRange::Degrees2000,
        low_pass: LowPass::Hertz188,
        sample_rate_divider: 0,
    };

    /// Is shown to `state`, or set by it.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        fn choose<T: Copy>(value: &mut T, bits: u8, all: &[T], state: &mut impl Exchange) {
            let mut index = bits.into();
            state.index(&mut index, all.len());
            if let Some(chosen) = all.get(index) {
                *value = *chosen;
            }
        }
        let bits = self.accelerometer_range.bits();
        choose(
            &mut self.accelerometer_range,
            bits,
            &AccelerometerRange::ALL,
            state,
        );
        let bits = self.gyroscope_range.bits();
        choose(&mut self.gyroscope_range, bits, &GyroscopeRange::ALL, state);
        let bits = self.low_pass.bits();
        choose(&mut self.low_pass, bits, &LowPass::ALL, state);
        state.byte(&mut self.sample_rate_divider);
    }

    /// The nominal sample rate in hertz; the sensor's own clock is within 1 % of it
    /// (product specification §6.6). Above 1 kHz the accelerometer repeats its samples.
    pub fn sample_rate_hz(&self) -> f32 {
        f32::from(self.low_pass.output_rate_hz()) / (f32::from(self.sample_rate_divider) + 1.0)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_scale_fits_the_counts_of_an_i16() {
        for (index, range) in AccelerometerRange::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(range.bits()), index);
            assert_eq!(range.counts_per_g() * (2 << index) as f32, 32768.0);
        }
        for (index, range) in GyroscopeRange::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(range.bits()), index);
            let full_scale = range.counts_per_degree_s() * (250 << index) as f32;
            assert!((32700.0..=32800.0).contains(&full_scale), "{full_scale}");
        }
    }

    #[test]
    fn a_narrower_filter_lags_more() {
        for (index, low_pass) in LowPass::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(low_pass.bits()), index);
        }
        for pair in LowPass::ALL.windows(2) {
            let (wide, narrow) = (pair[0], pair[1]);
            assert!(wide.gyroscope_bandwidth_hz() > narrow.gyroscope_bandwidth_hz());
            assert!(wide.accelerometer_bandwidth_hz() > narrow.accelerometer_bandwidth_hz());
            assert!(wide.gyroscope_delay_us() < narrow.gyroscope_delay_us());
            assert!(wide.accelerometer_delay_us() < narrow.accelerometer_delay_us());
        }
    }

    #[test]
    fn the_default_is_one_kilohertz() {
        assert_eq!(Config::default().sample_rate_hz(), 1000.0);
        let fast = Config {
            low_pass: LowPass::Hertz256,
            sample_rate_divider: 7,
            ..Config::default()
        };
        assert_eq!(fast.sample_rate_hz(), 1000.0);
        let slow = Config {
            sample_rate_divider: 255,
            ..Config::default()
        };
        assert_eq!(slow.sample_rate_hz(), 1000.0 / 256.0);
    }
}
