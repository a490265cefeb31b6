//! The tutorial's pipeline: a start-up average of the offsets, then one of the [classic
//! filters](crate::estimator::classic).
//!
//! This pipeline serves for comparison, and reproduces the tutorial's numbers. Its snapshots are
//! never [`Flags::VALID`], because these filters have no σ. The default pipeline does not use this
//! module.
//!
//! ```
//! use aplomb::estimator::classic::Tutorial;
//! use aplomb::mpu6050::{Burst, Part, RawSample};
//! use aplomb::pipeline::Settings;
//! use aplomb::pipeline::classic::{ClassicPipeline, Zero};
//!
//! let settings = Settings::new(&Part::MPU_6050);
//! let mut pipeline = ClassicPipeline::new(&settings, Tutorial::new(), 1_000, Zero::BothSensors);
//! let snapshot = pipeline.update(&Burst {
//!     bytes: RawSample::default().encode(),
//!     captured_at_us: 1_000,
//!     missed_before: 0,
//! });
//! println!("{}", pipeline.filter().angles().roll_deg);
//! ```

use super::alignment::Alignment;
use super::offset::StoredOffset;
use super::{Settings, Snapshot, flags_of};
use crate::attitude::Vector3;
use crate::calibration::{ImuReading, StationaryDetector, StationaryMean, StationaryProgress};
use crate::estimator::{Estimator, Filter, Sample};
use crate::health::{Flags, Monitor};
use crate::mpu6050::{Burst, RawSample};
use crate::units::STANDARD_GRAVITY_M_S2;

/// Offsets that the start-up average removes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Zero {
    /// Offset of the gyroscope.
    Gyroscope,
    /// Offsets of both sensors. The tutorial assumes a level table, so any difference from one g
    /// upwards is offset.
    BothSensors,
}

/// All steps from a burst to a snapshot, with a classic filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClassicPipeline<F> {
    settings: Settings,
    alignment: Alignment,
    monitor: Monitor,
    estimator: Estimator<F>,
    zero: Zero,
    average: Option<StationaryDetector>,
}

impl<F: Filter> ClassicPipeline<F> {
    /// Creates a pipeline that first averages `averaging_samples` at rest. With zero it removes no
    /// offsets.
    pub fn new(settings: &Settings, filter: F, averaging_samples: u16, zero: Zero) -> Self {
        let stored = StoredOffset::at(&settings.calibration, settings.calibration.usual_celsius());
        let average = (averaging_samples > 0).then(|| {
            StationaryDetector::new(&settings.noise_model(), averaging_samples)
                .with_expected_offset(stored.offset_rad_s, stored.sigma_rad_s)
        });
        Self {
            settings: *settings,
            alignment: Alignment::new(settings, stored.offset_rad_s),
            monitor: Monitor::new(&settings.monitored_sensor()),
            estimator: Estimator::with_filter(filter),
            zero,
            average,
        }
    }

    /// Processes one burst, and returns the attitude at its time. The snapshot carries
    /// [`Flags::CALIBRATING`] until the average is complete. With the next sample filter and yaw
    /// restart.
    pub fn update(&mut self, burst: &Burst) -> Snapshot {
        let raw = RawSample::decode(&burst.bytes);
        let mut flags = self.monitor.inspect(&burst.bytes, raw.temperature.0);
        flags.set(Flags::MISSED, burst.missed_before > 0);
        let sample = self.alignment.apply(&raw, burst.captured_at_us);
        let mut snapshot = self.process(&sample, flags);
        let average = self.average(&raw);
        if !average.is_empty() {
            snapshot.flags |= average | Flags::DEGRADED;
        }
        snapshot
    }

    /// Processes one calibrated sample in body axes, and returns the attitude at its time. No
    /// offset is averaged.
    pub fn update_sample(&mut self, sample: &Sample) -> Snapshot {
        self.process(sample, Flags::empty())
    }

    fn process(&mut self, sample: &Sample, mut flags: Flags) -> Snapshot {
        flags.set(Flags::GYROSCOPE_SATURATED, sample.is_rate_saturated);
        flags.set(Flags::ACCELEROMETER_SATURATED, sample.is_force_saturated);
        let estimate = if flags.contains(Flags::REJECTED) {
            self.estimator.estimate()
        } else {
            self.estimator.update(sample)
        };
        flags |= flags_of(estimate.issues);
        flags.set(Flags::DEGRADED, flags.intersects(Flags::DEGRADING));
        Snapshot {
            t_us: sample.t_us,
            attitude: estimate.attitude,
            body_rates_rad_s: estimate.body_rates_rad_s,
            flags,
            tilt_variance_rad2: f32::INFINITY,
        }
    }

    /// Returns the filter.
    pub const fn filter(&self) -> &F {
        self.estimator.filter()
    }

    /// Returns the removed gyroscope offset, rad/s in body axes. It is zero until the average is
    /// complete.
    pub fn gyroscope_offset_body_rad_s(&self) -> Vector3 {
        self.alignment.gyroscope_offset_rad_s()
    }

    fn average(&mut self, raw: &RawSample) -> Flags {
        let Some(average) = &mut self.average else {
            return Flags::empty();
        };
        let celsius = raw.temperature.to_celsius(self.settings.part);
        match average.update(&ImuReading {
            gyroscope: raw.gyroscope.0,
            accelerometer: raw.accelerometer.0,
            temperature_celsius: celsius,
        }) {
            StationaryProgress::Collecting => Flags::CALIBRATING,
            StationaryProgress::Moved(_) => Flags::CALIBRATING | Flags::MOVED,
            StationaryProgress::Done(at_rest) => {
                self.average = None;
                self.remove_offsets(&at_rest);
                Flags::CALIBRATING
            }
        }
    }

    fn remove_offsets(&mut self, at_rest: &StationaryMean) {
        let offset_rad_s = self
            .settings
            .noise_model()
            .gyroscope_rad_s(at_rest.gyroscope_counts);
        self.alignment.set_gyroscope_offset(offset_rad_s);
        if self.zero == Zero::BothSensors {
            let gravity = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
            self.alignment
                .set_accelerometer_zero(at_rest.accelerometer_counts, gravity);
        }
        self.estimator.restart();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::Mount;
    use crate::estimator::classic::{AxisKalman, Tutorial};
    use crate::mpu6050::{AccelerometerCounts, GyroscopeCounts, TemperatureCounts};
    use crate::pipeline::tests::{LEVEL, burst, force, settings};

    fn averaging<F: Filter>(filter: F, zero: Zero, mount: Mount) -> ClassicPipeline<F> {
        let settings = Settings {
            mount,
            ..settings()
        };
        ClassicPipeline::new(&settings, filter, 1000, zero)
    }

    #[test]
    fn the_average_ends_with_the_thousandth_sample_and_removes_the_offset() {
        let mut pipeline = averaging(AxisKalman::new(), Zero::Gyroscope, Mount::Z_UP);
        let offset = Vector3::new(5.0, -3.0, 10.0);
        let mut last = Snapshot::default();
        for index in 0..2000_u64 {
            let t_us = 7_000 + index * 1000;
            last = pipeline.update(&burst(Mount::Z_UP, t_us, LEVEL, offset));
            assert_eq!(last.t_us, t_us);
            let calibrating = index < 1000;
            assert_eq!(
                last.flags.contains(Flags::CALIBRATING),
                calibrating,
                "{index}"
            );
            let rate = last.body_rates_rad_s.z.to_degrees();
            let expected = if calibrating { 10.0 } else { 0.0 };
            assert!((rate - expected).abs() < 1e-4, "{index}: {rate}");
            if index == 1000 {
                assert_eq!(last.euler().yaw_rad, 0.0);
            }
        }
        let angles = last.euler();
        assert!(angles.yaw_rad.abs() < 1e-5, "{angles:?}");
        assert!(angles.roll_rad.abs() < 1e-5 && angles.pitch_rad.abs() < 1e-5);
        let removed = pipeline
            .gyroscope_offset_body_rad_s()
            .scale(16.4_f32.to_degrees());
        assert!((removed - Vector3::new(82.0, -49.0, 164.0)).norm() < 1e-3);
    }

    #[test]
    fn motion_restarts_the_average_and_is_flagged_once() {
        let mut pipeline = averaging(AxisKalman::new(), Zero::Gyroscope, Mount::Z_UP);
        let mut moved = Vec::new();
        let mut done = None;
        for index in 0..2000_u64 {
            let rate = if index == 520 { 50.0 } else { 0.0 };
            let rate = Vector3::new(0.0, rate, 0.0);
            let flags = pipeline
                .update(&burst(Mount::Z_UP, index * 1000, LEVEL, rate))
                .flags;
            if flags.contains(Flags::MOVED) {
                assert!(flags.contains(Flags::CALIBRATING));
                moved.push(index);
            }
            if !flags.contains(Flags::CALIBRATING) {
                done.get_or_insert(index);
            }
        }
        assert_eq!(moved, [601]);
        assert_eq!(done, Some(1602));
    }

    /// Returns roll after a start on a table that is tilted by 4°, in degrees.
    fn roll_on_a_tilted_table<F: Filter>(filter: F, zero: Zero, mount: Mount) -> f32 {
        let mut pipeline = averaging(filter, zero, mount);
        let mut last = Snapshot::default();
        for index in 0..1500_u64 {
            let table = force(4.0, -3.0);
            last = pipeline.update(&burst(mount, index * 1000, table, Vector3::ZERO));
        }
        // The simulated sensor has no noise.
        assert_eq!(last.flags, Flags::FROZEN | Flags::DEGRADED);
        last.euler().roll_rad.to_degrees()
    }

    #[test]
    fn the_tutorial_assumes_a_level_table() {
        for mount in [Mount::Z_UP, Mount::Z_DOWN] {
            let roll = roll_on_a_tilted_table(Tutorial::new(), Zero::BothSensors, mount);
            assert!(roll.abs() < 0.05, "{mount}: {roll}");
            let roll = roll_on_a_tilted_table(AxisKalman::new(), Zero::Gyroscope, mount);
            assert!((roll - 4.0).abs() < 0.05, "{mount}: {roll}");
        }
    }

    #[test]
    fn the_classic_chip_face_down_at_2_g_reads_its_tutorial_counts() {
        // Level, face down, ±2 g and ±250 °/s: z reads −16384 and some offset, which is
        // removed.
        let mut settings = Settings {
            mount: Mount::Z_DOWN,
            ..settings()
        };
        settings.sensor.accelerometer_range = crate::mpu6050::AccelerometerRange::G2;
        settings.sensor.gyroscope_range = crate::mpu6050::GyroscopeRange::Degrees250;
        let mut pipeline = ClassicPipeline::new(&settings, Tutorial::new(), 10, Zero::BothSensors);
        let mut update = |t_us, accelerometer, gyroscope| {
            let sample = RawSample {
                accelerometer: AccelerometerCounts(accelerometer),
                temperature: TemperatureCounts(0),
                gyroscope: GyroscopeCounts(gyroscope),
            };
            let snapshot = pipeline.update(&Burst {
                bytes: sample.encode(),
                captured_at_us: t_us,
                missed_before: 0,
            });
            let sample = pipeline.alignment.apply(&sample, t_us);
            (snapshot, sample, pipeline.filter().angles())
        };
        for index in 0..10 {
            update(index * 1000, [300, -200, -16000], [-158, 40, 0]);
        }
        // One degree per second about x; 30° of roll.
        let accelerometer = [300, -200 - 8192, -16000 + 16384 - 14189];
        let (_, sample, _) = update(10_000, accelerometer, [-158 + 131, 40, 0]);
        let force_g = sample
            .specific_force_m_s2
            .scale(1.0 / STANDARD_GRAVITY_M_S2);
        assert!(
            (force_g - Vector3::new(0.0, -0.5, -0.866_03)).norm() < 1e-4,
            "{force_g:?}"
        );
        assert!((sample.angular_rate_rad_s.x.to_degrees() - 1.0).abs() < 1e-4);
        for index in 11..10_000 {
            update(index * 1000, accelerometer, [-158, 40, 0]);
        }
        let (snapshot, _, angles) = update(10_000_000, accelerometer, [-158, 40, 0]);
        assert!((angles.roll_deg - 30.0).abs() < 0.01, "{angles:?}");
        assert!(angles.pitch_deg.abs() < 0.03, "{angles:?}");
        assert!((snapshot.euler().roll_rad.to_degrees() - 30.0).abs() < 0.01);
    }

    #[test]
    fn a_sensor_that_returns_zeros_never_calibrates() {
        let mut pipeline = averaging(AxisKalman::new(), Zero::Gyroscope, Mount::Z_UP);
        for index in 0..5000_u64 {
            let flags = pipeline
                .update(&Burst {
                    bytes: [0; 14],
                    captured_at_us: index * 1000,
                    missed_before: 0,
                })
                .flags;
            assert!(flags.contains(Flags::CALIBRATING | Flags::REJECTED));
        }
    }
}
