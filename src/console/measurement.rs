//! Text of the answer to `measure show`.

use core::fmt;

use super::answer::{Decimal, Triple};
use crate::attitude::Vector3;
use crate::health::{Measurement, Statistics};
use crate::mpu6050::{Config, Part, TemperatureCounts};
use crate::units::{STANDARD_GRAVITY_M_S2, degrees};

/// Figures as text: names with units, each with its mean and maximum, or what its name says.
pub(super) struct MeasurementText<'a>(pub(super) &'a Measurement, pub(super) &'static Part);

impl fmt::Display for MeasurementText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Measurement { core, samples, .. } = self.0;
        let period_us = &samples.period_us;
        write!(
            formatter,
            "seconds={} samples={} missed={} cycles={} interrupt_cycles={} \
             edge_to_attitude_us={} load_percent={} period_us={},{},{} period_sigma_us={} \
             core_mhz={} stack_bytes={},{}",
            Decimal(core.elapsed_us as f32 * 1e-6, 1),
            samples.edge_to_attitude_us.count(),
            samples.missed,
            MeanAndMost(&core.sample_cycles),
            MeanAndMost(&core.interrupt_cycles),
            MeanAndMost(&samples.edge_to_attitude_us),
            Decimal(self.0.load_percent(), 3),
            Decimal(period_us.mean(), 3),
            period_us.least(),
            period_us.most(),
            Decimal(period_us.deviation(), 2),
            self.0.core_mhz,
            self.0.stack_used_bytes,
            self.0.stack_bytes,
        )?;
        let [ax, ay, az, temperature, gx, gy, gz] = &samples.counts;
        let triple = |axes: [&Statistics; 3], of: fn(&Statistics) -> f32, scale: f32| {
            let [x, y, z] = axes.map(|axis| scale * of(axis));
            Triple(Vector3::new(x, y, z), 3)
        };
        let (accelerometer, gyroscope) = ([ax, ay, az], [gx, gy, gz]);
        let (mg, dps) = (mg_per_count(), dps_per_count());
        write!(
            formatter,
            " accel_mg={} accel_sigma_mg={} gyro_dps={} gyro_sigma_dps={} temperature_c={}",
            triple(accelerometer, Statistics::mean, mg),
            triple(accelerometer, Statistics::deviation, mg),
            triple(gyroscope, Statistics::mean, dps),
            triple(gyroscope, Statistics::deviation, dps),
            Decimal(
                TemperatureCounts(temperature.mean() as i16).to_celsius(self.1),
                1
            ),
        )
    }
}

/// Mean and maximum.
struct MeanAndMost<'a>(&'a Statistics);

impl fmt::Display for MeanAndMost<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{},{}", Decimal(self.0.mean(), 2), self.0.most())
    }
}

/// Returns the accelerometer's scale in the firmware's range, mg.
fn mg_per_count() -> f32 {
    let range = Config::DEFAULT.accelerometer_range;
    range.m_s2_per_count() * 1_000.0 / STANDARD_GRAVITY_M_S2
}

/// Returns the gyroscope's scale in the firmware's range, °/s.
fn dps_per_count() -> f32 {
    degrees(Config::DEFAULT.gyroscope_range.rad_s_per_count())
}
