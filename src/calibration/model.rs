//! The calibration of one sensor: data, and how each part corrects a reading.
//!
//! All of it is in SI units and the sensor's own axes, so that a new mount or full scale leaves it
//! valid. A part that was never measured is `None`, and the pipeline does without it.

use super::level;
use super::matrix::{Matrix3, SymmetricMatrix};
use super::mount::Mount;
use crate::attitude::{BodyVector, Quaternion, Vector3};
use crate::serialize::StateVisitor;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Temperature of the die as long as none was measured and nothing is stored, °C.
const ROOM_CELSIUS: f32 = 25.0;

/// Knowledge about one sensor and its place in the vehicle. The default is no knowledge.
/// [`check`](Self::check) finds numbers that no sensor has.
///
/// ```
/// use aplomb::calibration::{Calibration, Mount};
///
/// let mut calibration = Calibration::NONE;
/// calibration.mount = Some(Mount::Z_DOWN);
/// assert!(calibration.gyroscope.is_none());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Calibration {
    /// Mount of the sensor.
    pub mount: Option<Mount>,
    /// Gyroscope offset at rest.
    pub gyroscope: Option<GyroscopeOffset>,
    /// Gyroscope offset over the die temperature.
    pub temperature: Option<TemperatureModel>,
    /// Accelerometer offset, scale and cross-axis terms.
    pub accelerometer: Option<AccelerometerCorrection>,
    /// Small rotation from the mounted sensor's axes to the body's, found by
    /// [`level::trim`](super::level::trim).
    pub level: Option<Quaternion>,
    /// Gyroscope scale and cross-axis terms: rate = matrix · (reading − offset), in sensor axes.
    /// Inverse scale on the diagonal. The axes are those of the corrected accelerometer, so the
    /// matrix need not be symmetric.
    pub gyroscope_matrix: Option<Matrix3>,
}

impl Calibration {
    /// No knowledge.
    pub const NONE: Self = Self {
        mount: None,
        gyroscope: None,
        temperature: None,
        accelerometer: None,
        level: None,
        gyroscope_matrix: None,
    };

    /// Returns the most likely die temperature before one is measured, °C: that of the stored
    /// offset.
    pub(crate) fn usual_celsius(&self) -> f32 {
        match (&self.gyroscope, &self.temperature) {
            (Some(stored), _) => stored.temperature_celsius,
            (None, Some(model)) => model.reference_celsius,
            (None, None) => ROOM_CELSIUS,
        }
    }

    /// Returns whether the gyroscope's offset is stored, at one temperature or over a range of
    /// them.
    pub(crate) const fn has_gyroscope_offset(&self) -> bool {
        self.gyroscope.is_some() || self.temperature.is_some()
    }

    /// Adds an offset to the accelerometer's correction, m/s² in body axes: one that the filter
    /// has found in motion. `mount` is the one in use.
    ///
    /// The level trim turns with it: where the body was level, it stays level. A trim that would
    /// exceed 15° stays as it is.
    ///
    /// ```
    /// use aplomb::attitude::Vector3;
    /// use aplomb::calibration::{Calibration, Mount};
    ///
    /// let mut calibration = Calibration::NONE;
    /// calibration.add_accelerometer_offset(Vector3::new(0.2, 0.1, 0.0), Mount::Z_UP);
    /// let correction = calibration.accelerometer.expect("added");
    /// // The sensor's Y axis points to the left.
    /// assert_eq!(correction.offset_m_s2, Vector3::new(0.2, -0.1, 0.0));
    /// ```
    pub fn add_accelerometer_offset(&mut self, offset_m_s2: Vector3, mount: Mount) {
        let to_mounted = self.level.unwrap_or(Quaternion::IDENTITY).conjugate();
        let mounted = to_mounted.rotate(offset_m_s2);
        let mut correction = self.accelerometer.unwrap_or(AccelerometerCorrection::NONE);
        // The matrix is within a few percent of 1, so its effect on the offset is negligible.
        let change = mount.to_sensor(BodyVector(mounted));
        correction.offset_m_s2 = correction.offset_m_s2 + change;
        self.set_accelerometer(correction, mount);
    }

    /// Replaces the gyroscope's offset. A temperature model shifts by what the new one differs from
    /// it, because within its range it counts alone. Where it has faded to half, it shifts by half.
    ///
    /// ```
    /// use aplomb::attitude::Vector3;
    /// use aplomb::calibration::{Calibration, GyroscopeOffset, TemperatureModel};
    ///
    /// let mut calibration = Calibration::NONE;
    /// calibration.temperature = Some(TemperatureModel {
    ///     reference_celsius: 25.0,
    ///     offset_rad_s: Vector3::ZERO,
    ///     slope_rad_s_per_celsius: Vector3::new(0.001, 0.0, 0.0),
    ///     curvature_rad_s_per_celsius2: Vector3::ZERO,
    ///     coldest_celsius: 15.0,
    ///     warmest_celsius: 40.0,
    /// });
    /// calibration.set_gyroscope_offset(GyroscopeOffset {
    ///     offset_rad_s: Vector3::new(0.03, 0.0, 0.0),
    ///     temperature_celsius: 35.0,
    /// });
    /// let model = calibration.temperature.expect("it stays");
    /// assert!((model.offset_at(35.0).0.x - 0.03).abs() < 1e-6);
    /// assert!((model.offset_at(25.0).0.x - 0.02).abs() < 1e-6);
    /// ```
    pub fn set_gyroscope_offset(&mut self, measured: GyroscopeOffset) {
        self.gyroscope = Some(measured);
        if let Some(model) = &mut self.temperature {
            let (expected_rad_s, weight) = model.offset_at(measured.temperature_celsius);
            let difference = measured.offset_rad_s - expected_rad_s;
            model.offset_rad_s = model.offset_rad_s + difference.scale(weight);
        }
    }

    /// Replaces the accelerometer's correction. `mount` is the one in use.
    ///
    /// The level trim turns with it: where the body was level, it stays level. A trim that would
    /// exceed 15° stays as it is.
    ///
    /// ```
    /// use aplomb::attitude::Vector3;
    /// use aplomb::calibration::{AccelerometerCorrection, Calibration, Mount, level};
    ///
    /// // The trim has hidden an offset of 0.5 m/s².
    /// let mut calibration = Calibration::NONE;
    /// calibration.level = Some(level::trim(Vector3::new(0.5, 0.0, -9.81))?);
    /// let correction = AccelerometerCorrection {
    ///     offset_m_s2: Vector3::new(0.5, 0.0, 0.0),
    ///     ..AccelerometerCorrection::NONE
    /// };
    /// calibration.set_accelerometer(correction, Mount::Z_UP);
    /// let trim = calibration.level.expect("there was one").to_euler();
    /// assert!(trim.pitch_rad.abs() < 1e-3);
    /// # Ok::<(), level::LevelError>(())
    /// ```
    pub fn set_accelerometer(&mut self, correction: AccelerometerCorrection, mount: Mount) {
        let before = self.accelerometer.replace(correction);
        let Some(level) = self.level else {
            return;
        };
        let up = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
        let when_level = mount.to_sensor(BodyVector(level.conjugate().rotate(up)));
        // The former correction's inverse. Its matrix is within a few percent of 1, so each round
        // leaves a few percent of the error.
        let before = before.unwrap_or(AccelerometerCorrection::NONE);
        let mut reading = when_level;
        for _ in 0..3 {
            reading = reading + when_level - before.apply(reading);
        }
        let BodyVector(mounted) = mount.to_body(correction.apply(reading));
        self.level = level::trim(mounted).ok().or(self.level);
    }

    /// Visits every field but the gyroscope's matrix, which flight logs of format 1 do not have.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.optional(&mut self.mount, Mount::Z_UP, |visitor, mount| {
            mount.visit_state(visitor);
        });
        let gyroscope = GyroscopeOffset {
            offset_rad_s: Vector3::ZERO,
            temperature_celsius: 0.0,
        };
        visitor.optional(&mut self.gyroscope, gyroscope, |visitor, gyroscope| {
            visitor.vector(&mut gyroscope.offset_rad_s);
            visitor.f32(&mut gyroscope.temperature_celsius);
        });
        let model = TemperatureModel {
            reference_celsius: 0.0,
            offset_rad_s: Vector3::ZERO,
            slope_rad_s_per_celsius: Vector3::ZERO,
            curvature_rad_s_per_celsius2: Vector3::ZERO,
            coldest_celsius: 0.0,
            warmest_celsius: 0.0,
        };
        visitor.optional(&mut self.temperature, model, |visitor, model| {
            visitor.f32(&mut model.reference_celsius);
            visitor.vector(&mut model.offset_rad_s);
            visitor.vector(&mut model.slope_rad_s_per_celsius);
            visitor.vector(&mut model.curvature_rad_s_per_celsius2);
            visitor.f32(&mut model.coldest_celsius);
            visitor.f32(&mut model.warmest_celsius);
        });
        visitor.optional(
            &mut self.accelerometer,
            AccelerometerCorrection::NONE,
            |visitor, correction| {
                visitor.vector(&mut correction.offset_m_s2);
                let m = &mut correction.matrix;
                for element in [
                    &mut m.xx, &mut m.yy, &mut m.zz, &mut m.xy, &mut m.xz, &mut m.yz,
                ] {
                    visitor.f32(element);
                }
            },
        );
        visitor.optional(&mut self.level, Quaternion::IDENTITY, |visitor, level| {
            visitor.quaternion(level);
        });
    }

    /// Visits the gyroscope's matrix.
    pub fn visit_gyroscope_matrix(&mut self, visitor: &mut impl StateVisitor) {
        visitor.optional(
            &mut self.gyroscope_matrix,
            Matrix3::IDENTITY,
            |visitor, matrix| {
                for row in &mut matrix.rows {
                    visitor.vector(row);
                }
            },
        );
    }
}

/// Gyroscope offset (zero-rate output) that was measured at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeOffset {
    /// Offset, rad/s in sensor axes.
    pub offset_rad_s: Vector3,
    /// Mean die temperature of the measurement, °C.
    pub temperature_celsius: f32,
}

/// Correction of an accelerometer: force = matrix · (reading − offset).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AccelerometerCorrection {
    /// Offset, m/s² in sensor axes.
    pub offset_m_s2: Vector3,
    /// Inverse scale on the diagonal, cross-axis terms beside it; no unit.
    pub matrix: SymmetricMatrix,
}

impl AccelerometerCorrection {
    /// No correction.
    pub const NONE: Self = Self {
        offset_m_s2: Vector3::ZERO,
        matrix: SymmetricMatrix::IDENTITY,
    };

    /// Returns whether poses have shown the scale too. Without it the offset is what the filter has
    /// found in motion.
    pub fn is_from_poses(&self) -> bool {
        self.matrix != SymmetricMatrix::IDENTITY
    }

    /// Corrects a reading; both are m/s² in sensor axes.
    pub fn apply(&self, reading_m_s2: Vector3) -> Vector3 {
        self.matrix.times(reading_m_s2 - self.offset_m_s2)
    }
}

/// Distance from the measured range up to which a [`TemperatureModel`] has full weight, °C.
pub(super) const TRUSTED_BEYOND_CELSIUS: f32 = 5.0;
/// Distance from the measured range at which its weight has fallen to zero, °C.
const FADED_BEYOND_CELSIUS: f32 = 15.0;

/// Gyroscope offset as a parabola of the die temperature, per axis, over a measured range.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureModel {
    /// Reference temperature of the parabola, °C.
    pub reference_celsius: f32,
    /// Offset at the reference, rad/s in sensor axes.
    pub offset_rad_s: Vector3,
    /// Slope at the reference, rad/s per °C.
    pub slope_rad_s_per_celsius: Vector3,
    /// Factor of (T − reference)², rad/s per °C².
    pub curvature_rad_s_per_celsius2: Vector3,
    /// Lowest measured temperature, °C.
    pub coldest_celsius: f32,
    /// Highest measured temperature, °C.
    pub warmest_celsius: f32,
}

impl TemperatureModel {
    /// Returns the offset at a die temperature in °C, rad/s in sensor axes, and its weight.
    ///
    /// The weight is 1 within the measured range and 5 °C beyond, and falls to 0 at 15 °C beyond.
    /// More than 5 °C beyond the range, the offset keeps its value. A temperature that is not
    /// finite has weight 0.
    #[inline(never)]
    pub fn offset_at(&self, celsius: f32) -> (Vector3, f32) {
        let held = celsius
            .max(self.coldest_celsius - TRUSTED_BEYOND_CELSIUS)
            .min(self.warmest_celsius + TRUSTED_BEYOND_CELSIUS);
        let faded = (celsius - held).abs() / (FADED_BEYOND_CELSIUS - TRUSTED_BEYOND_CELSIUS);
        let t = held - self.reference_celsius;
        let offset = self.offset_rad_s
            + self.slope_rad_s_per_celsius.scale(t)
            + self.curvature_rad_s_per_celsius2.scale(t * t);
        (offset, (1.0 - faded).max(0.0))
    }
}
