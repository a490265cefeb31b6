//! Command `measure`, and its figures as text.

use core::fmt;

use super::answer::{Decimal, Kind, Reply, Triple};
use super::command::Measure;
use super::module::Module;
use crate::attitude::Vector3;
use crate::health::WorkFigures;
use crate::mpu6050::{Config, Part, TemperatureCounts};
use crate::units::{STANDARD_GRAVITY_M_S2, degrees};

/// Runs `measure`.
pub(super) fn run(what: Measure, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
    match what {
        Measure::On => {
            module.set_measuring(true);
            reply.ok(format_args!(
                "measure: on; \"measure show\" prints the figures, \"measure off\" ends it"
            ))
        }
        Measure::Show => {
            let part = module
                .state()
                .sensor
                .map_or(&Part::MPU_6050, |(part, _)| part);
            let text = WorkText(&module.work_figures(), part);
            reply.ok(format_args!("measure: {text}"))
        }
        Measure::Off => {
            module.set_measuring(false);
            reply.ok(format_args!("measure: off"))
        }
    }
}

/// Figures as text: names with units, each with its mean and maximum, or what its name says.
struct WorkText<'a>(&'a WorkFigures, &'static Part);

impl fmt::Display for WorkText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let WorkFigures { core, samples, .. } = self.0;
        let (cycles, interrupts) = (&core.sample_cycles, &core.interrupt_cycles);
        let (latency_us, period_us) = (&samples.edge_to_attitude_us, &samples.period_us);
        let seconds = core.elapsed_us as f32 * 1e-6;
        // Each number follows its text. Whole numbers below 2^24 are exact.
        for (text, number, decimals) in [
            ("seconds=", seconds, 1),
            (" samples=", samples.count() as f32, 0),
            (" missed=", samples.missed as f32, 0),
            (" cycles=", cycles.mean(), 2),
            (",", cycles.most() as f32, 0),
            (" interrupt_cycles=", interrupts.mean(), 2),
            (",", interrupts.most() as f32, 0),
            (" edge_to_attitude_us=", latency_us.mean(), 2),
            (",", latency_us.most() as f32, 0),
            (" load_percent=", self.0.load_percent(), 3),
            (" period_us=", period_us.mean(), 3),
            (",", period_us.least() as f32, 0),
            (",", period_us.most() as f32, 0),
            (" period_sigma_us=", period_us.deviation(), 2),
            (" core_mhz=", self.0.core_mhz as f32, 0),
            (" stack_bytes=", self.0.stack_used_bytes as f32, 0),
            (",", self.0.stack_bytes as f32, 0),
        ] {
            write!(formatter, "{text}{}", Decimal(number, decimals))?;
        }
        let [ax, ay, az, temperature, gx, gy, gz] = &samples.counts;
        let (accelerometer, gyroscope) = ([ax, ay, az], [gx, gy, gz]);
        for (text, axes, is_mean, scale) in [
            (" accel_mg=", accelerometer, true, mg_per_count()),
            (" accel_sigma_mg=", accelerometer, false, mg_per_count()),
            (" gyro_dps=", gyroscope, true, dps_per_count()),
            (" gyro_sigma_dps=", gyroscope, false, dps_per_count()),
        ] {
            let [x, y, z] = axes.map(|axis| {
                let counts = if is_mean {
                    axis.mean()
                } else {
                    axis.deviation()
                };
                scale * counts
            });
            write!(formatter, "{text}{}", Triple(Vector3::new(x, y, z), 3))?;
        }
        let celsius = TemperatureCounts(temperature.mean() as i16).to_celsius(self.1);
        write!(formatter, " temperature_c={}", Decimal(celsius, 1))
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
