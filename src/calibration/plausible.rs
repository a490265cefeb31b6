//! Limits of a calibration: no working sensor exceeds them. The fits keep them too.

use core::fmt;
use core::ops::RangeInclusive;

use super::compass::CompassCorrection;
use super::level;
use super::matrix::Matrix3;
use super::model::{
    AccelerometerCorrection, Calibration, TRUSTED_BEYOND_CELSIUS, TemperatureModel,
};
use super::stationary::MAX_ZERO_RATE_RAD_S;
use crate::attitude::Vector3;
use crate::serialize::StateVisitor;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Largest offset of an accelerometer, m/s²: 80 mg, 60 mg over temperature (product specification
/// §6.2), and a margin.
const MAX_OFFSET_M_S2: f32 = 0.2 * STANDARD_GRAVITY_M_S2;
/// Largest scale error or cross-axis term of an accelerometer (ibidem) or a gyroscope (§6.1): 3 %
/// and 2 %, and a margin.
const MAX_MATRIX_ERROR: f32 = 0.1;
/// Mean gains of a compass's matrix, whose readings are in µT.
const COMPASS_GAINS: RangeInclusive<f32> = 0.1..=10.0;
/// Least volume of what a compass's matrix makes of a cube, as a share of the cube with its mean
/// gain. Soft iron that doubles one axis and halves another leaves 0.4.
const LEAST_COMPASS_VOLUME: f32 = 0.1;
/// Die temperatures that a part can report, °C: 16 bits of its register, rounded outwards.
const REPORTED_CELSIUS: RangeInclusive<f32> = -80.0..=135.0;

/// Reason why no working sensor has a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ImplausibleCalibration {
    /// A number is not finite.
    NotFinite,
    /// The offset of the accelerometer exceeds 0.2 g, or an element of its matrix differs by more
    /// than 0.1 from the identity.
    Accelerometer,
    /// The offset of the gyroscope exceeds the largest one at any temperature, 41 °/s.
    GyroscopeOffset,
    /// The temperature model gives an offset of the gyroscope above 41 °/s within its range.
    TemperatureModelOffset,
    /// The temperature model's coldest temperature is above its warmest, its reference is not
    /// between them, or no part can report one of them.
    TemperatureModelRange,
    /// An element of the gyroscope's matrix differs by more than 0.1 from the identity.
    GyroscopeMatrix,
    /// The level is no unit quaternion, or tilts by more than 15°.
    Level,
}

impl fmt::Display for ImplausibleCalibration {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::NotFinite => "a number of the calibration is not finite",
            Self::Accelerometer => {
                "no accelerometer has an offset above 0.2 g, or a matrix more than 0.1 from the \
                 identity"
            }
            Self::GyroscopeOffset => "no gyroscope has an offset above 41 degrees per second",
            Self::TemperatureModelOffset => {
                "the temperature model gives a gyroscope's offset above 41 degrees per second"
            }
            Self::TemperatureModelRange => {
                "the temperature model's reference has to be between its coldest and its warmest \
                 temperature, and all three from -80 to 135 degrees Celsius"
            }
            Self::GyroscopeMatrix => "no gyroscope has a matrix more than 0.1 from the identity",
            Self::Level => "the level has to be a unit quaternion that tilts by 15 degrees at most",
        })
    }
}

impl core::error::Error for ImplausibleCalibration {}

impl Calibration {
    /// Checks numbers that come from outside.
    ///
    /// # Errors
    ///
    /// Returns an [`ImplausibleCalibration`] if no working sensor has this calibration.
    ///
    /// ```
    /// use aplomb::attitude::Vector3;
    /// use aplomb::calibration::{Calibration, ImplausibleCalibration, Matrix3};
    ///
    /// let mut calibration = Calibration::NONE;
    /// assert_eq!(calibration.check(), Ok(()));
    /// let forgotten = Matrix3 { rows: [Vector3::ZERO; 3] };
    /// calibration.gyroscope_matrix = Some(forgotten);
    /// assert_eq!(calibration.check(), Err(ImplausibleCalibration::GyroscopeMatrix));
    /// ```
    pub fn check(&self) -> Result<(), ImplausibleCalibration> {
        let is_gyroscope = |matrix: &Matrix3| {
            let rows = matrix.rows.iter().zip(Matrix3::IDENTITY.rows);
            let mut rows = rows;
            rows.all(|(row, axis)| (*row - axis).is_within(MAX_MATRIX_ERROR))
        };
        let (gyroscope, matrix) = (&self.gyroscope, &self.gyroscope_matrix);
        let temperature = &self.temperature;
        let parts = [
            (self.is_finite(), ImplausibleCalibration::NotFinite),
            (
                (self.accelerometer.as_ref()).is_none_or(AccelerometerCorrection::is_plausible),
                ImplausibleCalibration::Accelerometer,
            ),
            (
                gyroscope.is_none_or(|it| it.offset_rad_s.is_within(MAX_ZERO_RATE_RAD_S)),
                ImplausibleCalibration::GyroscopeOffset,
            ),
            (
                (temperature.as_ref()).is_none_or(TemperatureModel::has_plausible_range),
                ImplausibleCalibration::TemperatureModelRange,
            ),
            (
                (temperature.as_ref()).is_none_or(TemperatureModel::has_plausible_offset),
                ImplausibleCalibration::TemperatureModelOffset,
            ),
            (
                matrix.as_ref().is_none_or(is_gyroscope),
                ImplausibleCalibration::GyroscopeMatrix,
            ),
            (
                self.level.as_ref().is_none_or(level::is_trim),
                ImplausibleCalibration::Level,
            ),
        ];
        let wrong = parts.into_iter().find(|(is_right, _)| !is_right);
        wrong.map_or(Ok(()), |(_, error)| Err(error))
    }

    /// Returns whether all numbers are finite.
    fn is_finite(&self) -> bool {
        let (mut visited, mut finite) = (*self, Finite(true));
        visited.visit_state(&mut finite);
        visited.visit_gyroscope_matrix(&mut finite);
        finite.0
    }
}

impl CompassCorrection {
    /// Returns whether a compass can have this correction: its numbers are finite, its mean gain
    /// is a tenth to ten, and the matrix keeps three axes apart. A matrix of zeros, or one with two
    /// equal rows, gives a field that does not turn with the body.
    ///
    /// ```
    /// use aplomb::attitude::Vector3;
    /// use aplomb::calibration::CompassCorrection;
    ///
    /// assert!(CompassCorrection::NONE.is_plausible());
    /// let forgotten = CompassCorrection { matrix: [Vector3::ZERO; 3], ..CompassCorrection::NONE };
    /// assert!(!forgotten.is_plausible());
    /// ```
    pub fn is_plausible(&self) -> bool {
        let Vector3 { x, y, z } = self.hard_iron_ut;
        let [a, b, c] = self.matrix;
        let mean_gain = libm::sqrtf((a.dot(a) + b.dot(b) + c.dot(c)) / 3.0);
        // Mirrored axes, as some compasses have, are right. A NaN fails both comparisons.
        let volume = a.cross(b).dot(c).abs();
        [x, y, z].iter().all(|it| it.is_finite())
            && COMPASS_GAINS.contains(&mean_gain)
            && volume >= LEAST_COMPASS_VOLUME * mean_gain * mean_gain * mean_gain
    }
}

impl AccelerometerCorrection {
    /// Returns whether a working sensor can have this correction.
    pub(super) fn is_plausible(&self) -> bool {
        let m = self.matrix;
        let errors = [m.xx - 1.0, m.yy - 1.0, m.zz - 1.0, m.xy, m.xz, m.yz];
        self.offset_m_s2.is_within(MAX_OFFSET_M_S2)
            && errors.iter().all(|error| error.abs() <= MAX_MATRIX_ERROR)
    }
}

impl TemperatureModel {
    /// Returns whether the temperatures have their order, and a part can report them.
    fn has_plausible_range(&self) -> bool {
        let ordered = [
            self.coldest_celsius,
            self.reference_celsius,
            self.warmest_celsius,
        ];
        ordered.is_sorted() && ordered.iter().all(|it| REPORTED_CELSIUS.contains(it))
    }

    /// Returns whether a working gyroscope can have the offsets that the model gives. Those at both
    /// ends of its use and in the middle bound a parabola in between.
    fn has_plausible_offset(&self) -> bool {
        let coldest = self.coldest_celsius - TRUSTED_BEYOND_CELSIUS;
        let warmest = self.warmest_celsius + TRUSTED_BEYOND_CELSIUS;
        let middle = 0.5 * (coldest + warmest);
        [coldest, self.reference_celsius, middle, warmest]
            .into_iter()
            .all(|celsius| {
                let (offset, _) = self.offset_at(celsius);
                offset.is_within(MAX_ZERO_RATE_RAD_S)
            })
    }
}

/// Visitor that finds numbers that are not finite.
struct Finite(bool);

impl StateVisitor for Finite {
    fn bytes(&mut self, _: &mut [u8]) {}

    fn reject(&mut self) {}

    fn f32(&mut self, value: &mut f32) {
        self.0 &= value.is_finite();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{EulerAngles, Quaternion};
    use crate::calibration::{GyroscopeOffset, SymmetricMatrix, TemperatureModel};
    use crate::units::radians;

    fn level(roll_degrees: f32) -> Option<Quaternion> {
        Some(Quaternion::from_euler(EulerAngles {
            roll_rad: radians(roll_degrees),
            ..EulerAngles::default()
        }))
    }

    /// Checks a calibration after this change.
    fn check(change: impl FnOnce(&mut Calibration)) -> Result<(), ImplausibleCalibration> {
        let mut calibration = Calibration {
            gyroscope: Some(GyroscopeOffset {
                offset_rad_s: Vector3::new(radians(20.0), 0.0, radians(-40.0)),
                temperature_celsius: 25.0,
            }),
            temperature: Some(TemperatureModel {
                reference_celsius: 25.0,
                offset_rad_s: Vector3::ZERO,
                slope_rad_s_per_celsius: Vector3::ZERO,
                curvature_rad_s_per_celsius2: Vector3::ZERO,
                coldest_celsius: 20.0,
                warmest_celsius: 40.0,
            }),
            accelerometer: Some(AccelerometerCorrection {
                offset_m_s2: Vector3::new(1.9, -1.9, 0.0),
                matrix: SymmetricMatrix {
                    xx: 1.09,
                    yz: -0.09,
                    ..SymmetricMatrix::IDENTITY
                },
            }),
            level: level(15.0),
            // The largest matrix of the console.
            gyroscope_matrix: Some(Matrix3::from_ten_thousandths([999; 9])),
            ..Calibration::NONE
        };
        change(&mut calibration);
        calibration.check()
    }

    /// Checks the calibration with this change of its temperature model.
    fn check_model(
        change: impl FnOnce(&mut TemperatureModel),
    ) -> Result<(), ImplausibleCalibration> {
        check(|it| change(it.temperature.as_mut().expect("a model")))
    }

    #[test]
    fn a_temperature_model_has_the_offsets_and_temperatures_of_a_sensor() {
        use ImplausibleCalibration::{NotFinite, TemperatureModelOffset, TemperatureModelRange};
        let along_x = |x| Vector3::new(x, 0.0, 0.0);
        // 40 °/s at the reference; 20 °/s more at the warm end of the use, 20 °C away.
        let large = radians(40.0);
        let steep = radians(1.0);
        for (offset, slope, curvature, expected) in [
            (large, 0.0, 0.0, Ok(())),
            (1.5, 0.0, 0.0, Err(TemperatureModelOffset)),
            (0.0, steep, 0.0, Ok(())),
            (large, steep, 0.0, Err(TemperatureModelOffset)),
            // Beyond the cold end, 10 °C from the reference.
            (large, -steep, 0.0, Err(TemperatureModelOffset)),
            (0.0, 3.0, 0.0, Err(TemperatureModelOffset)),
            (0.0, 0.0, 0.01, Err(TemperatureModelOffset)),
            // Zero at both ends of the use, 38 °/s at the reference, and 43 °/s in the middle.
            (
                0.95 * large,
                1.9 * steep,
                -0.19 * steep,
                Err(TemperatureModelOffset),
            ),
            (0.0, f32::NAN, 0.0, Err(NotFinite)),
        ] {
            let found = check_model(|model| {
                model.offset_rad_s = along_x(offset);
                model.slope_rad_s_per_celsius = along_x(slope);
                model.curvature_rad_s_per_celsius2 = along_x(curvature);
            });
            assert_eq!(found, expected, "{offset} {slope} {curvature}");
        }
        for (coldest, reference, warmest, expected) in [
            (25.0, 25.0, 25.0, Ok(())),
            (-40.0, -40.0, 85.0, Ok(())),
            (40.0, 30.0, 20.0, Err(TemperatureModelRange)),
            (20.0, 19.0, 40.0, Err(TemperatureModelRange)),
            (20.0, 41.0, 40.0, Err(TemperatureModelRange)),
            (-273.0, 20.0, 40.0, Err(TemperatureModelRange)),
            (20.0, 30.0, 300.0, Err(TemperatureModelRange)),
            (20.0, f32::NAN, 40.0, Err(NotFinite)),
        ] {
            let found = check_model(|model| {
                model.coldest_celsius = coldest;
                model.reference_celsius = reference;
                model.warmest_celsius = warmest;
            });
            assert_eq!(found, expected, "{coldest} {reference} {warmest}");
        }
    }

    #[test]
    fn the_limits_are_those_of_the_fits() {
        use ImplausibleCalibration::{
            Accelerometer, GyroscopeMatrix, GyroscopeOffset, Level, NotFinite,
        };
        assert_eq!(check(|_| {}), Ok(()));
        let accelerometer = |offset: f32, xx: f32, xy: f32| {
            check(|it| {
                it.accelerometer = Some(AccelerometerCorrection {
                    offset_m_s2: Vector3::new(0.0, 0.0, offset),
                    matrix: SymmetricMatrix {
                        xx,
                        xy,
                        ..SymmetricMatrix::IDENTITY
                    },
                });
            })
        };
        assert_eq!(accelerometer(2.0, 1.0, 0.0), Err(Accelerometer));
        assert_eq!(accelerometer(0.0, 0.0, 0.0), Err(Accelerometer));
        assert_eq!(accelerometer(0.0, 1.0, 0.11), Err(Accelerometer));
        assert_eq!(accelerometer(f32::INFINITY, 1.0, 0.0), Err(NotFinite));
        let matrix = |xy| {
            check(|it| {
                let mut matrix = Matrix3::IDENTITY;
                matrix.rows[0].y = xy;
                it.gyroscope_matrix = Some(matrix);
            })
        };
        assert_eq!(matrix(-0.11), Err(GyroscopeMatrix));
        assert_eq!(matrix(f32::NAN), Err(NotFinite));
        let offset = |offset_rad_s, temperature_celsius| {
            check(|it| {
                it.gyroscope = Some(crate::calibration::GyroscopeOffset {
                    offset_rad_s,
                    temperature_celsius,
                });
            })
        };
        assert_eq!(
            offset(Vector3::new(1.0, 0.0, 0.0), 25.0),
            Err(GyroscopeOffset)
        );
        assert_eq!(offset(Vector3::ZERO, f32::NAN), Err(NotFinite));
        for wrong in [
            level(16.0),
            level(180.0),
            Some(Quaternion::new(0.0, 0.0, 0.0, 0.0)),
        ] {
            assert_eq!(check(|it| it.level = wrong), Err(Level));
        }
        let not_finite = Some(Quaternion::new(f32::NAN, 0.0, 0.0, 0.0));
        assert_eq!(check(|it| it.level = not_finite), Err(NotFinite));
    }

    #[test]
    fn a_compass_keeps_three_axes_apart() {
        let is_plausible = |rows: [[f32; 3]; 3], iron_ut: f32| {
            let correction = CompassCorrection {
                matrix: rows.map(|[x, y, z]| Vector3::new(x, y, z)),
                hard_iron_ut: Vector3::new(0.0, iron_ut, 0.0),
            };
            correction.is_plausible()
        };
        let diagonal = |x, y, z| [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
        for right in [
            diagonal(1.0, 1.0, 1.0),
            diagonal(2.0, 1.0, 0.5),
            // A wrong scale of a driver; a compass with mirrored axes.
            diagonal(0.25, 0.25, 0.25),
            diagonal(4.0, 4.0, 4.0),
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            [[1.1, 0.3, -0.2], [0.3, 0.9, 0.1], [-0.2, 0.1, 1.2]],
        ] {
            assert!(is_plausible(right, -1_500.0), "{right:?}");
            assert!(!is_plausible(right, f32::NAN), "{right:?}");
        }
        for wrong in [
            [[0.0; 3]; 3],
            diagonal(1.0, 1.0, 0.0),
            diagonal(100.0, 100.0, 100.0),
            diagonal(0.01, 0.01, 0.01),
            diagonal(1.0, 1.0, f32::NAN),
            diagonal(1.0, 1.0, f32::INFINITY),
            [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]],
        ] {
            assert!(!is_plausible(wrong, 0.0), "{wrong:?}");
        }
    }
}
