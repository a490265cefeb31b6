//! Configuration of the sensor: full scales, low-pass filter, sample rate.

use core::fmt;
use core::str::FromStr;

use crate::serialize::StateVisitor;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Full scale of the accelerometer. Its text is the number of g, such as `16`.
///
/// ```
/// use aplomb::mpu6050::AccelerometerRange;
///
/// let range: AccelerometerRange = "8".parse()?;
/// assert_eq!(range.counts_per_g(), 4096.0);
/// assert_eq!(range.to_string(), "8");
/// # Ok::<(), aplomb::mpu6050::ParseRangeError>(())
/// ```
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
    /// ±16 g, 2048 counts per g, for a vibrating airframe.
    #[default]
    G16 = 3,
}

impl AccelerometerRange {
    /// Every range, smallest first.
    pub const ALL: [Self; 4] = [Self::G2, Self::G4, Self::G8, Self::G16];

    /// Returns AFS_SEL (register map §4.5).
    pub const fn bits(self) -> u8 {
        self as u8
    }

    /// Returns the full scale, g.
    pub const fn full_scale_g(self) -> u16 {
        match self {
            Self::G2 => 2,
            Self::G4 => 4,
            Self::G8 => 8,
            Self::G16 => 16,
        }
    }

    /// Returns the sensitivity, counts per g (product specification §6.2).
    pub const fn counts_per_g(self) -> f32 {
        match self {
            Self::G2 => 16384.0,
            Self::G4 => 8192.0,
            Self::G8 => 4096.0,
            Self::G16 => 2048.0,
        }
    }

    /// Returns the scale, m/s² per count.
    pub const fn m_s2_per_count(self) -> f32 {
        STANDARD_GRAVITY_M_S2 / self.counts_per_g()
    }
}

impl fmt::Display for AccelerometerRange {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.full_scale_g().fmt(formatter)
    }
}

impl FromStr for AccelerometerRange {
    type Err = ParseRangeError;

    /// Parses the number of g: `2`, `4`, `8` or `16`.
    fn from_str(text: &str) -> Result<Self, ParseRangeError> {
        match text {
            "2" => Ok(Self::G2),
            "4" => Ok(Self::G4),
            "8" => Ok(Self::G8),
            "16" => Ok(Self::G16),
            _ => Err(ParseRangeError(Kind::Accelerometer)),
        }
    }
}

/// Full scale of the gyroscope. Its text is the number of °/s, such as `2000`.
///
/// ```
/// use aplomb::mpu6050::GyroscopeRange;
///
/// let range: GyroscopeRange = "250".parse()?;
/// assert_eq!(range.counts_per_degree_s(), 131.0);
/// assert_eq!(range.to_string(), "250");
/// # Ok::<(), aplomb::mpu6050::ParseRangeError>(())
/// ```
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

    /// Returns FS_SEL (register map §4.4).
    pub const fn bits(self) -> u8 {
        self as u8
    }

    /// Returns the full scale, °/s.
    pub const fn full_scale_degrees_s(self) -> u16 {
        match self {
            Self::Degrees250 => 250,
            Self::Degrees500 => 500,
            Self::Degrees1000 => 1000,
            Self::Degrees2000 => 2000,
        }
    }

    /// Returns the sensitivity, counts per °/s (product specification §6.1).
    pub const fn counts_per_degree_s(self) -> f32 {
        match self {
            Self::Degrees250 => 131.0,
            Self::Degrees500 => 65.5,
            Self::Degrees1000 => 32.8,
            Self::Degrees2000 => 16.4,
        }
    }

    /// Returns the scale, rad/s per count.
    pub const fn rad_s_per_count(self) -> f32 {
        radians(1.0) / self.counts_per_degree_s()
    }
}

impl fmt::Display for GyroscopeRange {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.full_scale_degrees_s().fmt(formatter)
    }
}

impl FromStr for GyroscopeRange {
    type Err = ParseRangeError;

    /// Parses the number of °/s: `250`, `500`, `1000` or `2000`.
    fn from_str(text: &str) -> Result<Self, ParseRangeError> {
        match text {
            "250" => Ok(Self::Degrees250),
            "500" => Ok(Self::Degrees500),
            "1000" => Ok(Self::Degrees1000),
            "2000" => Ok(Self::Degrees2000),
            _ => Err(ParseRangeError(Kind::Gyroscope)),
        }
    }
}

/// Text that names no full scale, or no low-pass filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParseRangeError(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Kind {
    Accelerometer,
    Gyroscope,
    LowPass,
}

impl fmt::Display for ParseRangeError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self.0 {
            Kind::Accelerometer => "the accelerometer's ranges are 2, 4, 8 and 16 g",
            Kind::Gyroscope => "the gyroscope's ranges are 250, 500, 1000 and 2000 °/s",
            Kind::LowPass => "the low-pass filters are 256, 188, 98, 42, 20, 10 and 5 Hz",
        })
    }
}

impl core::error::Error for ParseRangeError {}

/// Digital low-pass filter, named by the gyroscope's bandwidth in hertz, which is its text.
///
/// Bandwidths and delays are the MPU-6050's (register map §4.3). The MPU-6500 family takes the
/// same settings with bandwidths within 6 Hz. [`Part`](super::Part) has its longer delays.
///
/// ```
/// use aplomb::mpu6050::LowPass;
///
/// let low_pass: LowPass = "98".parse()?;
/// assert_eq!(low_pass.gyroscope_bandwidth_hz(), 98);
/// assert_eq!(low_pass.to_string(), "98");
/// # Ok::<(), aplomb::mpu6050::ParseRangeError>(())
/// ```
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

    /// Returns DLPF_CFG (register map §4.3).
    pub const fn bits(self) -> u8 {
        self as u8
    }

    /// Returns the filter's output rate before the divider, Hz.
    pub const fn output_rate_hz(self) -> u16 {
        match self {
            Self::Hertz256 => 8000,
            _ => 1000,
        }
    }

    /// Returns the gyroscope's bandwidth, Hz.
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

    /// Returns the accelerometer's bandwidth, Hz.
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

    /// Returns the gyroscope's delay, µs.
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

    /// Returns the accelerometer's delay, µs.
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

impl fmt::Display for LowPass {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.gyroscope_bandwidth_hz().fmt(formatter)
    }
}

impl FromStr for LowPass {
    type Err = ParseRangeError;

    /// Parses the gyroscope's bandwidth in Hz: `256`, `188`, `98`, `42`, `20`, `10` or `5`.
    fn from_str(text: &str) -> Result<Self, ParseRangeError> {
        match text {
            "256" => Ok(Self::Hertz256),
            "188" => Ok(Self::Hertz188),
            "98" => Ok(Self::Hertz98),
            "42" => Ok(Self::Hertz42),
            "20" => Ok(Self::Hertz20),
            "10" => Ok(Self::Hertz10),
            "5" => Ok(Self::Hertz5),
            _ => Err(ParseRangeError(Kind::LowPass)),
        }
    }
}

/// Configuration of the sensor. The default is 1 kHz, ±16 g, ±2000 °/s, 188 Hz.
///
/// ```
/// use aplomb::mpu6050::{AccelerometerRange, Config, LowPass};
///
/// const CONFIG: Config = Config::DEFAULT
///     .with_accelerometer_range(AccelerometerRange::G8)
///     .with_low_pass(LowPass::Hertz98)
///     .with_sample_rate_divider(4);
/// assert_eq!(CONFIG.sample_rate_hz(), 200.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Config {
    /// Full scale of the accelerometer. Default: ±16 g.
    pub accelerometer_range: AccelerometerRange,
    /// Full scale of the gyroscope. Default: ±2000 °/s.
    pub gyroscope_range: GyroscopeRange,
    /// Low-pass filter of both. Default: 188 Hz.
    pub low_pass: LowPass,
    /// SMPLRT_DIV: the sample rate is the filter's output rate divided by this plus one. Default:
    /// 0. The MPU-6500 family ignores it with [`LowPass::Hertz256`] (RM-MPU-6500A r2.1 §4.4).
    pub sample_rate_divider: u8,
}

impl Config {
    /// Default configuration, for constants.
    pub const DEFAULT: Self = Self {
        accelerometer_range: AccelerometerRange::G16,
        gyroscope_range: GyroscopeRange::Degrees2000,
        low_pass: LowPass::Hertz188,
        sample_rate_divider: 0,
    };

    /// Replaces the accelerometer's full scale.
    #[must_use]
    pub const fn with_accelerometer_range(mut self, range: AccelerometerRange) -> Self {
        self.accelerometer_range = range;
        self
    }

    /// Replaces the gyroscope's full scale.
    #[must_use]
    pub const fn with_gyroscope_range(mut self, range: GyroscopeRange) -> Self {
        self.gyroscope_range = range;
        self
    }

    /// Replaces the low-pass filter.
    #[must_use]
    pub const fn with_low_pass(mut self, low_pass: LowPass) -> Self {
        self.low_pass = low_pass;
        self
    }

    /// Replaces SMPLRT_DIV.
    #[must_use]
    pub const fn with_sample_rate_divider(mut self, divider: u8) -> Self {
        self.sample_rate_divider = divider;
        self
    }

    /// Visits every field.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        fn choose<T: Copy>(value: &mut T, bits: u8, all: &[T], visitor: &mut impl StateVisitor) {
            let mut index = bits.into();
            visitor.index(&mut index, all.len());
            if let Some(chosen) = all.get(index) {
                *value = *chosen;
            }
        }
        let bits = self.accelerometer_range.bits();
        choose(
            &mut self.accelerometer_range,
            bits,
            &AccelerometerRange::ALL,
            visitor,
        );
        let bits = self.gyroscope_range.bits();
        choose(
            &mut self.gyroscope_range,
            bits,
            &GyroscopeRange::ALL,
            visitor,
        );
        let bits = self.low_pass.bits();
        choose(&mut self.low_pass, bits, &LowPass::ALL, visitor);
        visitor.u8(&mut self.sample_rate_divider);
    }

    /// Returns the nominal sample rate, Hz. The sensor's clock is within 1 % of it (product
    /// specification §6.6). Above 1 kHz the accelerometer repeats its samples. A part of the
    /// MPU-6500 family has 8 kHz with [`LowPass::Hertz256`], whatever the divider.
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
    fn a_range_is_read_back_from_its_text() {
        for range in AccelerometerRange::ALL {
            assert_eq!(range.to_string().parse(), Ok(range));
        }
        for range in GyroscopeRange::ALL {
            assert_eq!(range.to_string().parse(), Ok(range));
        }
        for low_pass in LowPass::ALL {
            assert_eq!(low_pass.to_string().parse(), Ok(low_pass));
        }
        for text in ["", "3", "16 g", "-2", "+2", "2.0", "02000"] {
            let error = text.parse::<LowPass>().expect_err(text);
            assert!(error.to_string().contains("20, 10 and 5 Hz"), "{error}");
            let error = text.parse::<AccelerometerRange>().expect_err(text);
            assert!(error.to_string().contains("2, 4, 8 and 16 g"), "{error}");
            let error = text.parse::<GyroscopeRange>().expect_err(text);
            assert!(error.to_string().contains("1000 and 2000 °/s"), "{error}");
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
