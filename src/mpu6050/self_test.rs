//! Self-test: the response of each axis to its built-in deflection, compared with the factory's.
//!
//! The test runs with the gyroscope at ±250 °/s and the accelerometer at ±8 g. The response STR
//! is the reading with self-test on minus the reading with it off. The factory trim FT follows from
//! the trim codes. An axis passes with |(STR − FT)/FT| ≤ 14 % (register map §4.1, product
//! specification §6.1 and §6.2). Widely copied code compares the trim codes with FT and never
//! measures a response; this does.
//!
//! The MPU-6500 family keeps other codes in other registers, and many clones keep none. The result
//! reports that and does not fail.

use core::fmt;

/// Largest deviation of a response from its factory trim, as a share of the trim (register map
/// §4.1).
pub const TOLERANCE: f32 = 0.14;

/// Result of a self-test.
///
/// ```
/// use aplomb::mpu6050::{AxisTest, SelfTest};
///
/// let axis = AxisTest { response_counts: 2200.0, trim_counts: Some(2000.0) };
/// let test = SelfTest { gyroscope: [axis; 3], accelerometer: [axis; 3], has_moved: false };
/// assert_eq!(test.has_passed(), Some(true));
/// assert!(test.to_string().starts_with("passed; gyroscope x +10 %"));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SelfTest {
    /// Gyroscope about x, y, z.
    pub gyroscope: [AxisTest; 3],
    /// Accelerometer along x, y, z.
    pub accelerometer: [AxisTest; 3],
    /// The sensor moved during the test, so that the responses mean little.
    pub has_moved: bool,
}

/// Result of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisTest {
    /// Response STR, counts at the range of the test.
    pub response_counts: f32,
    /// Factory trim FT, counts at the range of the test; `None` if the chip keeps no trim code.
    pub trim_counts: Option<f32>,
}

impl AxisTest {
    /// Returns (STR − FT)/FT; `None` without a trim code.
    pub fn deviation(&self) -> Option<f32> {
        self.trim_counts
            .map(|trim| (self.response_counts - trim) / trim)
    }

    /// Returns whether the deviation is within ±14 %; `None` without a trim code.
    pub fn has_passed(&self) -> Option<bool> {
        self.deviation()
            .map(|deviation| deviation.abs() <= TOLERANCE)
    }
}

impl SelfTest {
    /// Converts the trim codes of SELF_TEST_X, _Y, _Z and _A (register map §4.1) to factory trims
    /// in counts: gyroscope, accelerometer.
    pub(super) fn trims(registers: [u8; 4]) -> [[Option<f32>; 3]; 2] {
        let [x, y, z, a] = registers;
        let gyroscope = [x, y, z].map(|register| register & 0x1F);
        let accelerometer = [
            (x >> 3) & 0x1C | (a >> 4) & 0x03,
            (y >> 3) & 0x1C | (a >> 2) & 0x03,
            (z >> 3) & 0x1C | a & 0x03,
        ];
        let [gx, gy, gz] = gyroscope.map(gyroscope_trim_counts);
        [
            [gx, gy.map(|trim| -trim), gz],
            accelerometer.map(accelerometer_trim_counts),
        ]
    }

    /// Returns whether every axis passes; `None` if the chip keeps no trim codes.
    pub fn has_passed(&self) -> Option<bool> {
        let axes = || self.gyroscope.iter().chain(&self.accelerometer);
        let has_trim = axes().any(|axis| axis.trim_counts.is_some());
        has_trim.then(|| axes().all(|axis| axis.has_passed() != Some(false)))
    }
}

impl fmt::Display for SelfTest {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match self.has_passed() {
            None => {
                return formatter.write_str(
                    "this chip keeps no factory trim (a clone or a successor): \
                     nothing to compare with",
                );
            }
            Some(true) => "passed",
            Some(false) if self.has_moved => "FAILED: it moved, keep it still and repeat",
            Some(false) => "FAILED",
        };
        formatter.write_str(verdict)?;
        for (name, axes) in [
            ("; gyroscope", &self.gyroscope),
            ("; accelerometer", &self.accelerometer),
        ] {
            formatter.write_str(name)?;
            for (letter, axis) in ["x", "y", "z"].into_iter().zip(axes) {
                match axis.deviation() {
                    // Whole percent, rounded away from zero at the half.
                    Some(deviation) => {
                        let percent = deviation * 100.0;
                        let rounded = (percent + if percent < 0.0 { -0.5 } else { 0.5 }) as i32;
                        write!(formatter, " {letter} {rounded:+} %")?;
                    }
                    None => write!(formatter, " {letter} without trim")?,
                }
            }
        }
        formatter.write_str(" of factory trim (14 % allowed)")
    }
}

/// Returns FT = 25·131·1.046^(code − 1) counts at ±250 °/s (register map §4.1); Y is
/// negative.
fn gyroscope_trim_counts(code: u8) -> Option<f32> {
    power(25.0 * 131.0, 1.046, code)
}

/// Returns FT = 4096·0.34·(0.92/0.34)^((code − 1)/30) counts at ±8 g (register map §4.1).
fn accelerometer_trim_counts(code: u8) -> Option<f32> {
    /// (0.92/0.34)^(1/30).
    const STEP: f32 = 1.033_737_4;
    power(4096.0 * 0.34, STEP, code)
}

/// Returns first·step^(code − 1); `None` for a code of zero.
fn power(first: f32, step: f32, code: u8) -> Option<f32> {
    (code > 0).then(|| (1..code).fold(first, |product, _| product * step))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trims_are_those_of_the_register_map() {
        // Codes 11, 14, 12 and 15, 17, 13: 01111 10001 01101 split into three upper and two lower
        // bits.
        let registers = [0b011_01011, 0b100_01110, 0b011_01100, 0b11_01_01];
        let [gyroscope, accelerometer] = SelfTest::trims(registers);
        for (found, (code, sign)) in gyroscope
            .into_iter()
            .zip([(11, 1.0), (14, -1.0), (12, 1.0)])
        {
            let expected = sign * 25.0 * 131.0 * 1.046_f64.powi(code - 1);
            assert!((f64::from(found.unwrap()) / expected - 1.0).abs() < 1e-5);
        }
        for (found, code) in accelerometer.into_iter().zip([15, 17, 13]) {
            let expected = 4096.0 * 0.34 * (0.92_f64 / 0.34).powf(f64::from(code - 1) / 30.0);
            assert!((f64::from(found.unwrap()) / expected - 1.0).abs() < 1e-5);
        }
        assert_eq!(SelfTest::trims([0; 4]), [[None; 3]; 2]);
        let [_, [_, _, largest]] = SelfTest::trims([0, 0, 0xFF, 0xFF]);
        assert!((largest.unwrap() - 4096.0 * 0.92).abs() < 0.5);
    }

    #[test]
    fn the_verdict_names_axes_and_reports_missing_trims() {
        let axis = |response_counts, trim| AxisTest {
            response_counts,
            trim_counts: Some(trim),
        };
        let mut test = SelfTest {
            gyroscope: [
                axis(5000.0, 5000.0),
                axis(-5500.0, -5000.0),
                axis(4400.0, 5000.0),
            ],
            accelerometer: [axis(2000.0, 2000.0); 3],
            has_moved: false,
        };
        assert_eq!(test.has_passed(), Some(true));
        assert_eq!(
            test.to_string(),
            "passed; gyroscope x +0 % y +10 % z -12 %; accelerometer x +0 % y +0 % z +0 % \
             of factory trim (14 % allowed)"
        );
        test.accelerometer[1] = axis(0.0, 2000.0);
        assert_eq!(test.has_passed(), Some(false));
        assert!(test.to_string().starts_with("FAILED; gyroscope"));
        test.has_moved = true;
        let moved = "FAILED: it moved, keep it still and repeat; gyroscope";
        assert!(test.to_string().starts_with(moved));
        test.gyroscope[1] = axis(5000.0, -5000.0);
        assert_eq!(
            test.gyroscope[1].has_passed(),
            Some(false),
            "the wrong sign"
        );
        let none = AxisTest {
            response_counts: 100.0,
            trim_counts: None,
        };
        let test = SelfTest {
            gyroscope: [none; 3],
            accelerometer: [none; 3],
            has_moved: false,
        };
        assert_eq!(test.has_passed(), None);
        assert!(test.to_string().contains("no factory trim"));
    }
}
