//! The errors of one particular MPU-6050, drawn within the datasheet's limits.
//!
//! Limits are from the product specification r3.4, sections 6.1 (gyroscope) and 6.2
//! (accelerometer). The datasheet gives tolerances, not distributions; the standard deviations are
//! chosen so that a typical chip is well inside them, as chips in the field are. Not modelled:
//! nonlinearity (0.2 % and 0.5 %), scale drift with temperature, 1/f noise.

use crate::motion::Vector;
use crate::motion::geometry::{add, dot, scale};
use crate::motion::truth::STANDARD_GRAVITY_M_S2;
use crate::random::Random;

/// The errors of one sensor's three axes, in its own unit: m/s² or rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisErrors {
    /// Row i gives output i: scale errors on the diagonal (1 is perfect), cross-axis sensitivity
    /// beside it.
    pub sensitivity: [Vector; 3],
    /// Output at zero input and 25 °C.
    pub offset: Vector,
    /// Change of the offset per °C.
    pub offset_per_c: Vector,
    /// Change of that change: the offset's factor of (T − 25 °C)², per °C².
    pub offset_per_c2: Vector,
    /// One-sided noise density, per √Hz.
    pub noise_density: f64,
}

/// All that is wrong with one chip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorErrors {
    /// In m/s².
    pub accelerometer: AxisErrors,
    /// In rad/s.
    pub gyroscope: AxisErrors,
    /// Gyroscope output per specific force along the same axis, rad/s per m/s².
    pub rate_per_specific_force: Vector,
    /// Excess of the chip's temperature over the air's, once warm, °C.
    pub self_heating_c: f64,
    /// Time constant of the warm-up, s.
    pub self_heating_time_s: f64,
    /// Zero-rate error at the moment of waking, rad/s; it dies away within the datasheet's 30 ms.
    pub start_up_rate: Vector,
}

/// Poses of a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Poses {
    /// Six: offset and scale of the accelerometer.
    Six,
    /// Twelve: offset, scale and cross-axis terms of the accelerometer, and from the turns between
    /// them the gyroscope's scale and cross-axis terms.
    Twelve,
}

/// Share of the errors that a calibration leaves, with a margin. In `tests/calibration.rs` twelve
/// poses leave 0.07° of 4.2° of inclination, and 0.13 % of 3.7 % of the rate (medians of two
/// hundred chips).
const CALIBRATED_SHARE: f64 = 0.05;

/// Temperature at which the datasheet states its offsets, °C.
const REFERENCE_TEMPERATURE_C: f64 = 25.0;

/// "ZRO settling to ±1 °/s of final: 30 ms" (section 6.1), from at most 20 °/s: e^−3 = 1/20.
const START_UP_TIME_CONSTANT_S: f64 = 0.010;

impl AxisErrors {
    /// A perfect sensor.
    pub const NONE: Self = Self {
        sensitivity: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        offset: [0.0; 3],
        offset_per_c: [0.0; 3],
        offset_per_c2: [0.0; 3],
        noise_density: 0.0,
    };

    /// The true input as this sensor feels it, without noise.
    fn distort(&self, input: Vector, warmer_by_c: f64) -> Vector {
        let drift = add(
            scale(self.offset_per_c, warmer_by_c),
            scale(self.offset_per_c2, warmer_by_c * warmer_by_c),
        );
        let offset = add(self.offset, drift);
        let [x, y, z] = &self.sensitivity;
        add([dot(*x, input), dot(*y, input), dot(*z, input)], offset)
    }
}

impl SensorErrors {
    /// A perfect chip: what remains is its registers' resolution and range.
    #[must_use]
    pub const fn none() -> Self {
        Self {
            accelerometer: AxisErrors::NONE,
            gyroscope: AxisErrors::NONE,
            rate_per_specific_force: [0.0; 3],
            self_heating_c: 0.0,
            self_heating_time_s: 1.0,
            start_up_rate: [0.0; 3],
        }
    }

    /// A chip off the reel.
    #[must_use]
    pub fn typical(seed: u64) -> Self {
        let mut random = Random::new(seed, "sensor errors");
        let milli_g = STANDARD_GRAVITY_M_S2 * 1e-3;
        let degree = 1.0_f64.to_radians();
        let mut each =
            |sigma: f64, bounds: Vector| bounds.map(|bound| random.within_tolerance(sigma, bound));
        let accelerometer_offset = each(18.0, [50.0, 50.0, 80.0]);
        // ±35 mg (Z ±60 mg) over 0 to 70 °C.
        let accelerometer_drift = each(0.2, [0.5, 0.5, 0.86]);
        let gyroscope_offset = each(3.0, [20.0; 3]);
        // ±20 °/s over −40 to 85 °C.
        let gyroscope_drift = each(0.05, [0.16; 3]);
        let rate_per_g = each(0.05, [0.1; 3]);
        let start_up_rate = each(10.0, [20.0; 3]);
        // Scale ±3 %, cross-axis ±2 %, the same for both sensors.
        let mut sensitivity = || {
            [0, 1, 2].map(|row| {
                [0, 1, 2].map(|column| {
                    if row == column {
                        1.0 + random.within_tolerance(0.01, 0.03)
                    } else {
                        random.within_tolerance(0.007, 0.02)
                    }
                })
            })
        };
        Self {
            accelerometer: AxisErrors {
                sensitivity: sensitivity(),
                offset: scale(accelerometer_offset, milli_g),
                offset_per_c: scale(accelerometer_drift, milli_g),
                offset_per_c2: [0.0; 3],
                noise_density: 0.4 * milli_g,
            },
            gyroscope: AxisErrors {
                sensitivity: sensitivity(),
                offset: scale(gyroscope_offset, degree),
                offset_per_c: scale(gyroscope_drift, degree),
                offset_per_c2: [0.0; 3],
                noise_density: 0.005 * degree,
            },
            rate_per_specific_force: scale(rate_per_g, degree / STANDARD_GRAVITY_M_S2),
            // 3.9 mA at 3.3 V, and a small board that warms with it: a few degrees in a few
            // minutes.
            self_heating_c: random.uniform(2.0, 6.0),
            self_heating_time_s: random.uniform(60.0, 180.0),
            start_up_rate: scale(start_up_rate, degree),
        }
    }

    /// Returns the chip after a calibration in these poses at 25 °C. The turns between twelve
    /// poses calibrate the gyroscope's scale and cross-axis terms too.
    #[must_use]
    pub fn calibrated_in(mut self, poses: Poses) -> Self {
        let accelerometer = &mut self.accelerometer;
        accelerometer.offset = scale(accelerometer.offset, CALIBRATED_SHARE);
        for (row, sensitivity) in accelerometer.sensitivity.iter_mut().enumerate() {
            for (column, factor) in sensitivity.iter_mut().enumerate() {
                let perfect = AxisErrors::NONE.sensitivity[row][column];
                if row == column || poses == Poses::Twelve {
                    *factor = perfect + CALIBRATED_SHARE * (*factor - perfect);
                }
            }
        }
        if poses == Poses::Twelve {
            for (row, sensitivity) in self.gyroscope.sensitivity.iter_mut().enumerate() {
                for (column, factor) in sensitivity.iter_mut().enumerate() {
                    let perfect = AxisErrors::NONE.sensitivity[row][column];
                    *factor = perfect + CALIBRATED_SHARE * (*factor - perfect);
                }
            }
        }
        self
    }

    /// Returns a chip from anywhere within the datasheet's tolerance, its limits as likely as its
    /// middle. Its offset follows temperature in a curve. Such a chip is worse than those on sale.
    #[must_use]
    pub fn anywhere_in_tolerance(seed: u64) -> Self {
        let mut random = Random::new(seed, "sensor errors, uniform");
        let milli_g = STANDARD_GRAVITY_M_S2 * 1e-3;
        let degree = 1.0_f64.to_radians();
        let mut each = |bounds: Vector| bounds.map(|bound| random.uniform(-bound, bound));
        let accelerometer_offset = scale(each([50.0, 50.0, 80.0]), milli_g);
        let accelerometer_drift = scale(each([0.5, 0.5, 0.86]), milli_g);
        let gyroscope_offset = scale(each([20.0; 3]), degree);
        // Together ±19 °/s between −40 and 85 °C; the datasheet has ±20.
        let gyroscope_drift = scale(each([0.16; 3]), degree);
        let gyroscope_curve = scale(each([0.002; 3]), degree);
        let rate_per_g = scale(each([0.1; 3]), degree / STANDARD_GRAVITY_M_S2);
        let mut sensitivity = || {
            [0, 1, 2].map(|row| {
                [0, 1, 2].map(|column| {
                    if row == column {
                        1.0 + random.uniform(-0.03, 0.03)
                    } else {
                        random.uniform(-0.02, 0.02)
                    }
                })
            })
        };
        let typical = Self::typical(seed);
        Self {
            accelerometer: AxisErrors {
                sensitivity: sensitivity(),
                offset: accelerometer_offset,
                offset_per_c: accelerometer_drift,
                ..typical.accelerometer
            },
            gyroscope: AxisErrors {
                sensitivity: sensitivity(),
                offset: gyroscope_offset,
                offset_per_c: gyroscope_drift,
                offset_per_c2: gyroscope_curve,
                ..typical.gyroscope
            },
            rate_per_specific_force: rate_per_g,
            ..typical
        }
    }

    /// The chip's temperature after `awake_s` seconds of operation in air of `air_c`.
    #[must_use]
    pub fn chip_temperature_c(&self, air_c: f64, awake_s: f64) -> f64 {
        air_c + self.self_heating_c * (1.0 - libm::exp(-awake_s / self.self_heating_time_s))
    }

    /// Returns the specific force that the accelerometer senses, without noise.
    #[must_use]
    pub fn distort_specific_force(&self, specific_force_m_s2: Vector, chip_c: f64) -> Vector {
        self.accelerometer
            .distort(specific_force_m_s2, chip_c - REFERENCE_TEMPERATURE_C)
    }

    /// Returns the rates that the gyroscope senses, without noise.
    #[must_use]
    pub fn distort_rates(
        &self,
        rates_rad_s: Vector,
        specific_force_m_s2: Vector,
        chip_c: f64,
        awake_s: f64,
    ) -> Vector {
        let rates = self
            .gyroscope
            .distort(rates_rad_s, chip_c - REFERENCE_TEMPERATURE_C);
        let settling = libm::exp(-awake_s / START_UP_TIME_CONSTANT_S);
        let forced = |axis: usize| self.rate_per_specific_force[axis] * specific_force_m_s2[axis];
        let sensed = |axis| rates[axis] + forced(axis) + self.start_up_rate[axis] * settling;
        [sensed(0), sensed(1), sensed(2)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_perfect_chip_changes_nothing() {
        let errors = SensorErrors::none();
        let vector = [1.0, -2.0, 3.0];
        assert_eq!(errors.distort_specific_force(vector, 40.0), vector);
        assert_eq!(errors.distort_rates(vector, [9.0; 3], 40.0, 0.0), vector);
        assert_eq!(errors.chip_temperature_c(25.0, 1000.0), 25.0);
    }

    #[test]
    fn every_chip_is_within_the_datasheets_limits_and_not_all_are_good() {
        let milli_g = STANDARD_GRAVITY_M_S2 * 1e-3;
        let chips: Vec<SensorErrors> = (0..500).map(SensorErrors::typical).collect();
        for chip in &chips {
            for axis in 0..3 {
                let bound_mg = if axis == 2 { 80.0 } else { 50.0 };
                assert!(chip.accelerometer.offset[axis].abs() <= bound_mg * milli_g);
                assert!(chip.gyroscope.offset[axis].abs() <= 20.0_f64.to_radians());
                assert!(chip.gyroscope.offset_per_c[axis].abs() <= 0.16_f64.to_radians());
                assert!(chip.start_up_rate[axis].abs() <= 20.0_f64.to_radians());
                for sensor in [&chip.accelerometer, &chip.gyroscope] {
                    assert!((sensor.sensitivity[axis][axis] - 1.0).abs() <= 0.03);
                    assert!(sensor.sensitivity[axis][(axis + 1) % 3].abs() <= 0.02);
                }
            }
        }
        let spread = |value: fn(&SensorErrors) -> f64| {
            (chips.iter().map(|chip| value(chip).powi(2)).sum::<f64>() / chips.len() as f64).sqrt()
        };
        let gyroscope_dps = spread(|chip| chip.gyroscope.offset[0].to_degrees());
        assert!((gyroscope_dps - 3.0).abs() < 0.3, "{gyroscope_dps}");
        let accelerometer_mg = spread(|chip| chip.accelerometer.offset[2]) / milli_g;
        assert!((accelerometer_mg - 18.0).abs() < 2.0, "{accelerometer_mg}");
    }

    #[test]
    fn the_chip_warms_up_and_its_offset_goes_along() {
        let errors = SensorErrors::typical(5);
        assert_eq!(errors.chip_temperature_c(25.0, 0.0), 25.0);
        let warm = errors.chip_temperature_c(25.0, 1e4);
        assert!((warm - 25.0 - errors.self_heating_c).abs() < 1e-9);
        let cold_rate = errors.distort_rates([0.0; 3], [0.0; 3], 25.0, 10.0);
        let warm_rate = errors.distort_rates([0.0; 3], [0.0; 3], warm, 10.0);
        let expected = errors.gyroscope.offset_per_c[0] * errors.self_heating_c;
        assert!((warm_rate[0] - cold_rate[0] - expected).abs() < 1e-12);
    }

    #[test]
    fn a_chip_from_anywhere_reaches_its_limits_and_drifts_in_a_curve() {
        let chips: Vec<SensorErrors> = (0..500).map(SensorErrors::anywhere_in_tolerance).collect();
        let largest = |value: fn(&SensorErrors) -> f64| {
            chips
                .iter()
                .map(|chip| value(chip).abs())
                .fold(0.0, f64::max)
        };
        let offset_dps = largest(|chip| chip.gyroscope.offset[0].to_degrees());
        assert!((19.0..=20.0).contains(&offset_dps), "{offset_dps}");
        let cross = largest(|chip| chip.accelerometer.sensitivity[0][2]);
        assert!((0.019..=0.02).contains(&cross), "{cross}");
        for chip in &chips {
            let rate = |celsius| chip.distort_rates([0.0; 3], [0.0; 3], celsius, 10.0)[1];
            for celsius in [-40.0, 85.0] {
                assert!((rate(celsius) - rate(25.0)).to_degrees().abs() <= 20.0);
            }
            let bend = rate(35.0) + rate(15.0) - 2.0 * rate(25.0);
            assert!((bend - 200.0 * chip.gyroscope.offset_per_c2[1]).abs() < 1e-12);
        }
    }

    #[test]
    fn noise_and_linear_acceleration_sensitivity_are_the_datasheets() {
        let milli_g = STANDARD_GRAVITY_M_S2 * 1e-3;
        for seed in 0..50 {
            let errors = SensorErrors::typical(seed);
            assert!((errors.accelerometer.noise_density / milli_g - 0.4).abs() < 1e-12);
            assert!((errors.gyroscope.noise_density.to_degrees() - 0.005).abs() < 1e-12);
            // 0.1 °/s per g at most, and not nothing.
            let force = [0.0, STANDARD_GRAVITY_M_S2, 0.0];
            let with = errors.distort_rates([0.0; 3], force, 25.0, 10.0);
            let without = errors.distort_rates([0.0; 3], [0.0; 3], 25.0, 10.0);
            let change_dps = (with[1] - without[1]).to_degrees().abs();
            assert!(change_dps > 0.0 && change_dps <= 0.1, "{change_dps}");
            assert_eq!((with[0], with[2]), (without[0], without[2]));
        }
    }

    #[test]
    fn the_zero_rate_output_settles_to_1_degree_per_second_in_30_ms() {
        for seed in 0..50 {
            let errors = SensorErrors::typical(seed);
            for axis in 0..3 {
                let late = errors.distort_rates([0.0; 3], [0.0; 3], 25.0, 0.030)[axis];
                let settled = errors.distort_rates([0.0; 3], [0.0; 3], 25.0, 10.0)[axis];
                assert!((late - settled).to_degrees().abs() <= 1.0);
            }
        }
    }

    #[test]
    fn a_calibration_leaves_a_twentieth_and_six_poses_leave_the_cross_axis_terms() {
        let chip = SensorErrors::typical(1);
        let six = chip.calibrated_in(Poses::Six).accelerometer;
        let twelve = chip.calibrated_in(Poses::Twelve).accelerometer;
        let factory = chip.accelerometer;
        for calibrated in [six, twelve] {
            assert!((calibrated.offset[2] - 0.05 * factory.offset[2]).abs() < 1e-12);
            let scale_error = calibrated.sensitivity[1][1] - 1.0;
            assert!((scale_error - 0.05 * (factory.sensitivity[1][1] - 1.0)).abs() < 1e-12);
            assert_eq!(calibrated.offset_per_c, factory.offset_per_c);
        }
        let cross = factory.sensitivity[0][1];
        assert_eq!(six.sensitivity[0][1], cross);
        assert!((twelve.sensitivity[0][1] - 0.05 * cross).abs() < 1e-12);
        let rates = |chip: SensorErrors| chip.gyroscope.sensitivity;
        assert_eq!(rates(chip.calibrated_in(Poses::Six)), rates(chip));
        let cross = rates(chip.calibrated_in(Poses::Twelve))[2][0];
        assert!((cross - 0.05 * rates(chip)[2][0]).abs() < 1e-12);
    }
}
