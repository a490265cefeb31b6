//! Converts counts in sensor axes to SI units in body axes: scale, correction, mount and level in
//! one affine map per sensor.

use super::{Pipeline, Settings};
use crate::attitude::{BodyVector, Vector3};
use crate::calibration::{AccelerometerCorrection, Matrix3};
use crate::estimator::Sample;
use crate::mpu6050::RawSample;

/// Affine maps of both sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Alignment {
    accelerometer: Affine,
    gyroscope: Affine,
}

impl Alignment {
    /// Creates the maps for these settings, which remove this gyroscope offset (rad/s in sensor
    /// axes).
    pub(super) fn new(settings: &Settings, gyroscope_offset_rad_s: Vector3) -> Self {
        let (sensor, calibration) = (&settings.sensor, &settings.calibration);
        let correction = calibration
            .accelerometer
            .unwrap_or(AccelerometerCorrection::NONE);
        let mut accelerometer = Affine::new(
            settings,
            &correction.matrix.to_matrix(),
            sensor.accelerometer_range.m_s2_per_count(),
        );
        accelerometer.remove(correction.offset_m_s2);
        let matrix = calibration.gyroscope_matrix.unwrap_or(Matrix3::IDENTITY);
        let mut gyroscope =
            Affine::new(settings, &matrix, sensor.gyroscope_range.rad_s_per_count());
        gyroscope.remove(gyroscope_offset_rad_s);
        Self {
            accelerometer,
            gyroscope,
        }
    }

    /// Sets the gyroscope offset to remove, rad/s in sensor axes.
    pub(super) fn set_gyroscope_offset(&mut self, offset_rad_s: Vector3) {
        self.gyroscope.remove(offset_rad_s);
    }

    /// Returns the removed gyroscope offset, rad/s in body axes.
    pub(super) fn gyroscope_offset_rad_s(&self) -> Vector3 {
        -self.gyroscope.offset
    }

    /// Returns the removed accelerometer offset, m/s² in body axes.
    pub(super) fn accelerometer_offset_m_s2(&self) -> Vector3 {
        -self.accelerometer.offset
    }

    /// Sets the accelerometer's offset so that these counts become this force, m/s² in body axes.
    pub(super) fn set_accelerometer_zero(&mut self, counts: Vector3, force_m_s2: Vector3) {
        self.accelerometer.offset = force_m_s2 - self.accelerometer.linear(counts);
    }

    /// Returns the sample of these counts.
    #[inline]
    pub(super) fn apply(&self, raw: &RawSample, t_us: u64) -> Sample {
        Sample {
            t_us,
            specific_force_m_s2: self.accelerometer.apply(raw.accelerometer.0),
            angular_rate_rad_s: self.gyroscope.apply(raw.gyroscope.0),
            is_rate_saturated: raw.gyroscope.is_saturated(),
            is_force_saturated: raw.accelerometer.is_saturated(),
        }
    }
}

/// Turns a vector from sensor axes to body axes, by the mount and the level.
#[inline]
fn to_body(settings: &Settings, in_sensor: Vector3) -> Vector3 {
    let BodyVector(mounted) = settings.mount().to_body(in_sensor);
    let level = settings.calibration.level;
    level.map_or(mounted, |level| level.rotate(mounted))
}

impl Pipeline {
    /// Returns the sample for [`update_sample`](Self::update_sample) of readings in sensor axes:
    /// specific force in m/s², angular rate in rad/s. Applies the calibration, the mount and the
    /// level as [`update`](Self::update) does with a burst.
    ///
    /// Readings have no temperature: a stored gyroscope offset counts as measured at the present
    /// one. The caller sets the flags of saturation.
    ///
    /// ```
    /// use aplomb::attitude::Vector3;
    /// use aplomb::calibration::AccelerometerCorrection;
    /// use aplomb::mpu6050::Part;
    /// use aplomb::pipeline::{Pipeline, Settings};
    ///
    /// let mut settings = Settings::new(&Part::MPU_6050);
    /// settings.calibration.accelerometer = Some(AccelerometerCorrection {
    ///     offset_m_s2: Vector3::new(0.0, 1.2, 0.0),
    ///     ..AccelerometerCorrection::NONE
    /// });
    /// let mut pipeline = Pipeline::new(&settings);
    /// // Face up and level: the sensor reads its offset, and gravity along z.
    /// let reading = Vector3::new(0.0, 1.2, 9.81);
    /// let sample = pipeline.calibrated_sample(1_000, reading, Vector3::ZERO);
    /// assert_eq!(sample.specific_force_m_s2, Vector3::new(0.0, 0.0, -9.81));
    /// assert!(pipeline.update_sample(&sample).euler().roll_rad.abs() < 1e-3);
    /// ```
    pub fn calibrated_sample(
        &self,
        t_us: u64,
        specific_force_m_s2: Vector3,
        angular_rate_rad_s: Vector3,
    ) -> Sample {
        let (settings, offset) = (&self.settings, self.gyroscope_offset_rad_s);
        let calibration = &settings.calibration;
        let correction = calibration
            .accelerometer
            .unwrap_or(AccelerometerCorrection::NONE);
        let matrix = calibration.gyroscope_matrix.unwrap_or(Matrix3::IDENTITY);
        let force = to_body(settings, correction.apply(specific_force_m_s2));
        let rate = to_body(settings, matrix.times(angular_rate_rad_s - offset));
        Sample::new(t_us, BodyVector(force), BodyVector(rate))
    }
}

/// Affine map: units = Σ column · count + offset.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Affine {
    /// One count along each sensor axis, in units along the body's axes.
    columns: [Vector3; 3],
    offset: Vector3,
    counts_per_unit: f32,
}

impl Affine {
    /// Creates the map from counts with this unit, by this matrix in sensor axes, the mount and the
    /// level. One function for both sensors, because its code is large.
    #[inline(never)]
    fn new(settings: &Settings, matrix: &Matrix3, per_count: f32) -> Self {
        let columns = Matrix3::IDENTITY
            .rows
            .map(|axis| to_body(settings, matrix.times(axis)).scale(per_count));
        Self {
            columns,
            offset: Vector3::ZERO,
            counts_per_unit: 1.0 / per_count,
        }
    }

    /// Sets the reading that becomes zero, in units along the sensor's axes.
    fn remove(&mut self, reading: Vector3) {
        self.offset = -self.linear(reading.scale(self.counts_per_unit));
    }

    #[inline]
    fn apply(&self, [x, y, z]: [i16; 3]) -> Vector3 {
        self.linear(Vector3::new(f32::from(x), f32::from(y), f32::from(z))) + self.offset
    }

    /// Returns the linear part of the map: Σ column · count.
    #[inline]
    fn linear(&self, counts: Vector3) -> Vector3 {
        let [x, y, z] = self.columns;
        x.scale(counts.x) + y.scale(counts.y) + z.scale(counts.z)
    }
}
