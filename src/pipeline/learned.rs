//! Calibration and state that a run has found, for the next one.

use core::f32::consts::PI;

use super::Pipeline;
use super::offset::STORED_SIGMA_RAD_S;
use crate::attitude::{BodyVector, Vector3};
use crate::calibration::{Calibration, GyroscopeOffset, Matrix3};
use crate::estimator::arithmetic::{larger, smaller, square};
use crate::estimator::kalman::WarmStart;
use crate::units::{SECONDS_PER_MICROSECOND, radians};

/// Rounds that invert a gyroscope's matrix, which is within 0.1 of the identity: each leaves at
/// most 0.3 of the error.
const ROUNDS: u8 = 6;
/// Smallest σ of a bias after a reset, rad/s. A larger one lets the accelerations of a flight move
/// the bias before the next rest.
const RESUMED_SIGMA_RAD_S: f32 = radians(0.05);

impl Pipeline {
    /// Returns the calibration in use, with the offsets that this run has found, for the next run.
    /// Offsets that are not certain stay as they are.
    ///
    /// The gyroscope's offset is certain once a rest has measured it, while its σ is at most
    /// 0.1 °/s. It belongs to the present [temperature](Self::temperature_celsius). The
    /// accelerometer's is
    /// [`certain_accelerometer_offset_m_s2`](Self::certain_accelerometer_offset_m_s2).
    ///
    /// ```
    /// use aplomb::attitude::{BodyVector, Vector3};
    /// use aplomb::estimator::Sample;
    /// use aplomb::mpu6050::Part;
    /// use aplomb::pipeline::{Pipeline, Settings};
    ///
    /// let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    /// assert_eq!(pipeline.learned_calibration().gyroscope, None);
    /// for index in 1..5_000_u64 {
    ///     let force = BodyVector::new(0.0, 0.0, -9.81);
    ///     let rate = BodyVector::new(0.0, 0.02, 0.0); // at rest: the offset
    ///     pipeline.update_sample(&Sample::new(1_000 * index, force, rate));
    /// }
    /// let learned = pipeline.learned_calibration().gyroscope.expect("it is certain");
    /// // The sensor's Y axis points to the left.
    /// assert!((learned.offset_rad_s.y + 0.02).abs() < 1e-3);
    /// ```
    pub fn learned_calibration(&self) -> Calibration {
        let mut learned = self.settings.calibration;
        let sigma_rad_s = self.kalman().kept_bias_sigma_rad_s();
        if sigma_rad_s.is_some_and(|sigma_rad_s| sigma_rad_s <= STORED_SIGMA_RAD_S) {
            learned.set_gyroscope_offset(GyroscopeOffset {
                offset_rad_s: self.gyroscope_offset_sensor_rad_s(),
                temperature_celsius: self.temperature_celsius,
            });
        }
        if let Some(offset_m_s2) = self.certain_accelerometer_offset_m_s2() {
            learned.add_accelerometer_offset(offset_m_s2, self.settings.mount());
        }
        learned
    }

    /// Continues like [`resume`](Self::resume) from a state that was kept up to `age_us` (µs)
    /// before `t_us`. Inflates σ, because the body may have turned since. Returns false, and
    /// changes nothing, if the state is damaged.
    ///
    /// ```
    /// use aplomb::attitude::BodyVector;
    /// use aplomb::estimator::Sample;
    /// use aplomb::health::{BoardFlags, Flags};
    /// use aplomb::mpu6050::Part;
    /// use aplomb::pipeline::{Pipeline, Settings};
    ///
    /// let settings = Settings::new(&Part::MPU_6050);
    /// let mut pipeline = Pipeline::new(&settings);
    /// let sample = |t_us| Sample::new(t_us, BodyVector::new(0.0, 0.0, -9.81), BodyVector::ZERO);
    /// for index in 1..3_000 {
    ///     pipeline.update_sample(&sample(1_000 * index));
    /// }
    /// let latest = pipeline.stale(3_000_000, BoardFlags::empty());
    /// let kept = pipeline.warm_start(&latest).expect("a rest has measured the bias");
    /// // After a reset the time begins anew.
    /// let mut pipeline = Pipeline::new(&settings);
    /// assert!(pipeline.resume_aged(&kept, 0, 300_000));
    /// let snapshot = pipeline.update_sample(&sample(1_000));
    /// assert!(snapshot.flags.contains(Flags::VALID));
    /// assert!(snapshot.tilt_sigma_rad() > latest.tilt_sigma_rad());
    /// ```
    pub fn resume_aged(&mut self, kept: &WarmStart, t_us: u64, age_us: u32) -> bool {
        let age_s = age_us as f32 * SECONDS_PER_MICROSECOND;
        // Both axes together.
        let turned_rad2 = 2.0 * self.kalman().pause_variance_rad2(age_s);
        let tilt_rad = libm::sqrtf(square(kept.tilt_sigma_rad) + turned_rad2);
        let start = WarmStart {
            tilt_sigma_rad: smaller(tilt_rad, PI),
            bias_sigma_rad_s: larger(kept.bias_sigma_rad_s, RESUMED_SIGMA_RAD_S),
            ..*kept
        };
        // A NaN would be gone from `start`.
        kept.is_plausible() && self.resume(&start, t_us)
    }

    /// Returns the gyroscope's whole offset, rad/s in sensor axes, before the gyroscope's matrix.
    fn gyroscope_offset_sensor_rad_s(&self) -> Vector3 {
        let calibration = &self.settings.calibration;
        let bias = BodyVector(match calibration.level {
            Some(level) => level.conjugate().rotate(self.kalman().bias_rad_s()),
            None => self.kalman().bias_rad_s(),
        });
        let in_sensor = self.settings.mount().to_sensor(bias);
        let matrix = calibration.gyroscope_matrix.unwrap_or(Matrix3::IDENTITY);
        let mut found = in_sensor;
        for _ in 0..ROUNDS {
            found = found + in_sensor - matrix.times(found);
        }
        self.gyroscope_offset_rad_s + found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Mount, level};
    use crate::mpu6050::Part;
    use crate::pipeline::Settings;

    /// The offset is that of the sensor, before matrix, mount and level.
    #[test]
    fn the_learned_offset_is_that_of_the_readings() {
        let mut settings = Settings::new(&Part::MPU_6050);
        let calibration = &mut settings.calibration;
        calibration.mount = Mount::parse("+y-z");
        calibration.level = level::trim(Vector3::new(1.5, -1.0, -9.6)).ok();
        calibration.gyroscope_matrix = Some(Matrix3 {
            rows: [
                Vector3::new(1.08, 0.03, -0.02),
                Vector3::new(0.01, 0.93, 0.04),
                Vector3::new(-0.03, 0.02, 1.05),
            ],
        });
        calibration.gyroscope = Some(GyroscopeOffset {
            offset_rad_s: Vector3::new(0.01, 0.01, 0.01),
            temperature_celsius: 30.0,
        });
        let offset = Vector3::new(0.03, -0.02, 0.025);
        let mut pipeline = Pipeline::new(&settings);
        for index in 1..5_000_u64 {
            let force = Vector3::new(0.0, 0.0, 9.81);
            let sample = pipeline.calibrated_sample(1_000 * index, force, offset);
            pipeline.update_sample(&sample);
        }
        let learned = pipeline.learned_calibration();
        let found = learned.gyroscope.expect("it is certain");
        let error = found.offset_rad_s - offset;
        assert!(error.dot(error) < 1e-8, "{:?}", found.offset_rad_s);
        assert_eq!(found.temperature_celsius, 30.0);
        // A run that starts with it has no bias left to find.
        settings.calibration = learned;
        let pipeline = Pipeline::new(&settings);
        let sample = pipeline.calibrated_sample(1_000, Vector3::ZERO, offset);
        let rate = sample.angular_rate_rad_s;
        assert!(rate.dot(rate) < 1e-8, "{rate:?}");
        assert_eq!(learned.check(), Ok(()));
    }

    /// With a smaller σ the accelerations of a flight could not move the bias.
    #[test]
    fn a_resumed_bias_has_a_least_sigma() {
        for (kept_deg_s, resumed_deg_s) in [(0.001, 0.05), (0.2, 0.2)] {
            let kept = WarmStart {
                attitude: crate::attitude::Quaternion::IDENTITY,
                tilt_sigma_rad: 0.01,
                bias_rad_s: Vector3::ZERO,
                bias_change_rad_s: Vector3::ZERO,
                bias_sigma_rad_s: radians(kept_deg_s),
                accelerometer_bias_m_s2: [0.0; 2],
                squared_velocity_m2_s2: 0.0,
            };
            let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
            assert!(pipeline.resume_aged(&kept, 0, 1_000));
            let ratio = pipeline.kalman().largest_bias_sigma_rad_s() / radians(resumed_deg_s);
            assert!((ratio - 1.0).abs() < 1.0e-3, "{kept_deg_s}: {ratio}");
        }
    }
}
