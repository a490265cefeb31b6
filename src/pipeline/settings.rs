//! Settings of a pipeline: sensor configuration, part, mount and calibration.

use core::fmt;

use crate::calibration::{
    AccelerometerCorrection, Calibration, ImplausibleCalibration, Mount, NoiseModel, SensorSetup,
};
use crate::estimator::LONGEST_DELAY_US;
use crate::estimator::kalman::{AccelerometerKnowledge, GyroscopeKnowledge};
use crate::health::MonitoredSensor;
use crate::mpu6050::{Config, LowPass, Part};
use crate::serialize::StateVisitor;

/// Share of a period that the clock may be off: 2 %, twice the error of the sensor's clock
/// (product specification §6.6).
const CLOCK_TOLERANCE: f32 = 0.02;

/// Settings of a [`Pipeline`](super::Pipeline).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settings {
    /// Configuration of the sensor. Its full scales are the scales of the bytes. It has to be the
    /// one that the sensor was given: after a mismatch wrong rates are flagged `VALID`.
    pub sensor: Config,
    /// Part, which determines the temperature scale.
    pub part: &'static Part,
    /// Mount of the sensor, unless `calibration` has one. Default: chip face up, X forward.
    pub mount: Mount,
    /// Calibration of the sensor, which has passed [`Calibration::check`]. Default: none. It
    /// corrects bursts. It corrects readings in SI units only by
    /// [`Pipeline::calibrated_sample`](super::Pipeline::calibrated_sample).
    pub calibration: Calibration,
    /// Delay of the sensor in µs: age of a sample's content at the sample's time, up to
    /// [`LONGEST_DELAY_US`]. Default: `None`, the gyroscope's delay in the low-pass filter of
    /// `sensor` in `part`, because the time is that of the data-ready edge. A longer delay, such as
    /// one in ns, is not used, and counts as zero; [`check`](Self::check) reports it.
    pub sensor_delay_us: Option<u32>,
    /// True if the caller reads the sensor's full scales back while
    /// [`Pipeline::awaits_scale_check`](super::Pipeline::awaits_scale_check) is true, and then
    /// reports [`BoardFlags::SCALES_VERIFIED`](crate::health::BoardFlags::SCALES_VERIFIED).
    /// Default: `false`.
    pub verifies_scales: bool,
}

impl Settings {
    /// Creates the settings for this part with this configuration, which the sensor was given.
    ///
    /// ```no_run
    /// use aplomb::mpu6050::{Config, Error, LowPass, Mpu6050};
    /// use aplomb::pipeline::{Pipeline, Settings};
    /// use embedded_hal::{delay::DelayNs, i2c::I2c};
    ///
    /// fn start<I2C: I2c>(
    ///     sensor: &mut Mpu6050<I2C>,
    ///     delay: &mut impl DelayNs,
    /// ) -> Result<Pipeline, Error<I2C::Error>> {
    ///     let config = Config::DEFAULT.with_low_pass(LowPass::Hertz98);
    ///     sensor.configure(&config, delay)?;
    ///     Ok(Pipeline::new(&Settings::for_sensor(sensor.part(), &config)))
    /// }
    /// ```
    pub const fn for_sensor(part: &'static Part, config: &Config) -> Self {
        Self {
            sensor: *config,
            ..Self::new(part)
        }
    }

    /// Creates the settings for `rate_hz` samples in SI units a second, 4 to 8,000, of any sensor.
    /// Each sample is of its time: the delay is zero.
    ///
    /// The rate decides which step is a pause, so a lower one than the real rate hides pauses, and
    /// a higher one makes each step a pause. The full scales are ±16 g and ±2000 °/s; the flag
    /// `VIBRATION` needs that of the accelerometer, in `sensor`. The part has no effect.
    ///
    /// ```
    /// use aplomb::attitude::Vector3;
    /// use aplomb::calibration::Mount;
    /// use aplomb::estimator::Sample;
    /// use aplomb::health::Flags;
    /// use aplomb::pipeline::{Pipeline, Settings};
    ///
    /// let mut pipeline = Pipeline::new(&Settings::for_samples(200.0));
    /// let full_scale_rad_s = 2_000_f32.to_radians();
    /// for index in 0..400 {
    ///     let (t_us, force_m_s2, rate_rad_s) = (5_000 * index, [0.0, 0.0, 9.81], [0.0; 3]);
    ///     let body = |vector: [f32; 3]| Mount::Z_UP.to_body(Vector3::from(vector));
    ///     let mut sample = Sample::new(t_us, body(force_m_s2), body(rate_rad_s));
    ///     sample.is_rate_saturated = rate_rad_s.iter().any(|rate| rate.abs() >= full_scale_rad_s);
    ///     let snapshot = pipeline.update_sample(&sample);
    ///     assert!(index < 390 || snapshot.flags.contains(Flags::VALID));
    /// }
    /// ```
    pub fn for_samples(rate_hz: f32) -> Self {
        let mut settings = Self::new(&Part::MPU_6050);
        settings.sensor_delay_us = Some(0);
        let sensor = &mut settings.sensor;
        if rate_hz > f32::from(sensor.low_pass.output_rate_hz()) * (1.0 + CLOCK_TOLERANCE) {
            sensor.low_pass = LowPass::Hertz256;
        }
        let periods = f32::from(sensor.low_pass.output_rate_hz()) / rate_hz;
        // Rounded up: a shorter period would make steps pauses. The cast saturates.
        sensor.sample_rate_divider = libm::ceilf(periods - CLOCK_TOLERANCE - 1.0) as u8;
        settings
    }

    /// Creates the settings for this part with the default configuration.
    pub const fn new(part: &'static Part) -> Self {
        Self {
            sensor: Config::DEFAULT,
            part,
            mount: Mount::Z_UP,
            calibration: Calibration::NONE,
            sensor_delay_us: None,
            verifies_scales: false,
        }
    }

    /// Checks settings that come from outside: the calibration, and the delay.
    ///
    /// # Errors
    ///
    /// Returns an [`ImplausibleSettings`] if no working sensor has these settings.
    ///
    /// ```
    /// use aplomb::mpu6050::Part;
    /// use aplomb::pipeline::{ImplausibleSettings, Settings};
    ///
    /// let mut settings = Settings::new(&Part::MPU_6050);
    /// assert_eq!(settings.check(), Ok(()));
    /// settings.sensor_delay_us = Some(1_900_000); // 1.9 ms in ns
    /// assert_eq!(settings.check(), Err(ImplausibleSettings::SensorDelay));
    /// ```
    pub fn check(&self) -> Result<(), ImplausibleSettings> {
        (self.calibration.check()).map_err(ImplausibleSettings::Calibration)?;
        match self.sensor_delay_us {
            Some(delay_us) if delay_us > LONGEST_DELAY_US => Err(ImplausibleSettings::SensorDelay),
            _ => Ok(()),
        }
    }

    /// Returns the mount in use: the calibration's, or else that of the settings.
    pub fn mount(&self) -> Mount {
        self.calibration.mount.unwrap_or(self.mount)
    }

    /// Returns the knowledge of the accelerometer's offset that the calibration implies.
    pub(super) fn accelerometer_knowledge(&self) -> AccelerometerKnowledge {
        let Some(AccelerometerCorrection { matrix, .. }) = self.calibration.accelerometer else {
            return AccelerometerKnowledge::Factory;
        };
        // Neither six poses nor a flight show the cross-axis terms.
        let has_cross_axis_terms = [matrix.xy, matrix.xz, matrix.yz] != [0.0; 3];
        if has_cross_axis_terms {
            AccelerometerKnowledge::Calibrated
        } else {
            AccelerometerKnowledge::SixPoses
        }
    }

    /// Returns the knowledge of the gyroscope's scale that the calibration implies.
    pub(super) fn gyroscope_knowledge(&self) -> GyroscopeKnowledge {
        if self.calibration.gyroscope_matrix.is_some() {
            GyroscopeKnowledge::Calibrated
        } else {
            GyroscopeKnowledge::Factory
        }
    }

    /// Returns the sensor's scales, and its noise behind the low-pass filter.
    pub fn noise_model(&self) -> NoiseModel {
        let sensor = &self.sensor;
        NoiseModel::new(&SensorSetup {
            gyroscope_counts_per_degree_s: sensor.gyroscope_range.counts_per_degree_s(),
            accelerometer_counts_per_g: sensor.accelerometer_range.counts_per_g(),
            gyroscope_bandwidth_hz: sensor.low_pass.gyroscope_bandwidth_hz().into(),
            accelerometer_bandwidth_hz: sensor.low_pass.accelerometer_bandwidth_hz().into(),
            sample_rate_hz: sensor.sample_rate_hz(),
        })
    }

    /// Returns the sensor's properties for the monitor.
    pub(super) fn monitored_sensor(&self) -> MonitoredSensor {
        let (sensor, temperature) = (&self.sensor, &self.part.temperature);
        MonitoredSensor {
            sample_rate_hz: sensor.sample_rate_hz(),
            bandwidth_hz: sensor.low_pass.gyroscope_bandwidth_hz(),
            counts_per_g: sensor.accelerometer_range.counts_per_g(),
            counts_per_degree_s: sensor.gyroscope_range.counts_per_degree_s(),
            celsius_per_count: temperature.celsius_per_count,
            celsius_at_zero: temperature.celsius_at_zero,
        }
    }

    /// Returns the delay of the sensor, in µs.
    pub(super) fn delay_us(&self) -> u32 {
        let gyroscope_us = self.part.gyroscope_delay_us(self.sensor.low_pass).into();
        match self.sensor_delay_us {
            Some(delay_us) if delay_us > LONGEST_DELAY_US => 0,
            Some(delay_us) => delay_us,
            None => gyroscope_us,
        }
    }

    /// Visits every field but the gyroscope's matrix, as
    /// [`Calibration::visit_state`](Calibration::visit_state) does.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        self.sensor.visit_state(visitor);
        let mut who_am_i = self.part.who_am_i;
        visitor.u8(&mut who_am_i);
        match Part::from_who_am_i(who_am_i) {
            Some(part) => self.part = part,
            None => visitor.reject(),
        }
        self.mount.visit_state(visitor);
        self.calibration.visit_state(visitor);
        visitor.bool(&mut self.verifies_scales);
        // Unused. Logs of revision 2 and before have the samples of a start-up average here, and
        // their settings are read too.
        visitor.u16(&mut 0);
        visitor.optional(&mut self.sensor_delay_us, 0, |visitor, delay_us| {
            visitor.u32(delay_us);
        });
    }
}

/// Reason why no working sensor has these settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ImplausibleSettings {
    /// No sensor has the calibration.
    Calibration(ImplausibleCalibration),
    /// The delay exceeds [`LONGEST_DELAY_US`]. It is in µs.
    SensorDelay,
}

impl fmt::Display for ImplausibleSettings {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Calibration(reason) => reason.fmt(formatter),
            Self::SensorDelay => write!(
                formatter,
                "the sensor's delay exceeds {LONGEST_DELAY_US} microseconds: check its unit"
            ),
        }
    }
}

impl core::error::Error for ImplausibleSettings {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::Vector3;

    #[test]
    fn the_configuration_of_the_sensor_is_in_the_settings() {
        let config = Config::DEFAULT.with_low_pass(LowPass::Hertz20);
        let settings = Settings::for_sensor(&Part::MPU_6050, &config);
        assert_eq!(settings.sensor, config);
        assert_eq!(
            Settings::for_sensor(&Part::MPU_6050, &Config::DEFAULT),
            Settings::new(&Part::MPU_6050)
        );
    }

    #[test]
    fn every_temperature_that_a_part_reports_is_plausible() {
        use crate::calibration::TemperatureModel;
        for part in &crate::mpu6050::PARTS {
            for counts in [i16::MIN, i16::MAX] {
                let celsius = crate::mpu6050::TemperatureCounts(counts).to_celsius(part);
                let model = TemperatureModel {
                    reference_celsius: celsius,
                    offset_rad_s: Vector3::ZERO,
                    slope_rad_s_per_celsius: Vector3::ZERO,
                    curvature_rad_s_per_celsius2: Vector3::ZERO,
                    coldest_celsius: celsius,
                    warmest_celsius: celsius,
                };
                let mut calibration = Calibration::NONE;
                calibration.temperature = Some(model);
                assert_eq!(calibration.check(), Ok(()), "{} {celsius}", part.name);
            }
        }
    }

    #[test]
    fn the_delay_is_that_of_the_part() {
        for (who_am_i, delay_us) in [(0x68, 1_900), (0x70, 2_900), (0x98, 2_900)] {
            let part = Part::from_who_am_i(who_am_i).unwrap();
            assert_eq!(Settings::new(part).delay_us(), delay_us, "{}", part.name);
        }
    }

    #[test]
    fn samples_of_any_rate_have_no_delay_and_a_period_that_is_no_pause() {
        for (rate_hz, nominal_hz) in [
            (4.0, 4.0),
            (20.0, 20.0),
            (50.0, 50.0),
            (99.9, 100.0),
            (100.1, 100.0),
            (200.0, 200.0),
            (333.3, 1000.0 / 3.0),
            (400.0, 1000.0 / 3.0),
            (999.0, 1000.0),
            (1_001.0, 1000.0),
            (1_600.0, 1600.0),
            (2_000.0, 2000.0),
            (3_200.0, 8000.0 / 3.0),
            (8_000.0, 8000.0),
            // Out of range: the nearest.
            (1.0, 1000.0 / 256.0),
            (0.0, 1000.0 / 256.0),
            (32_000.0, 8000.0),
        ] {
            let settings = Settings::for_samples(rate_hz);
            assert_eq!(settings.delay_us(), 0);
            assert_eq!(settings.sensor.sample_rate_hz(), nominal_hz, "{rate_hz}");
            assert_eq!(settings.check(), Ok(()));
        }
        for rate_hz in [f32::NAN, f32::INFINITY, -1.0] {
            assert!(Settings::for_samples(rate_hz).sensor.sample_rate_hz() >= 1000.0 / 256.0);
        }
    }

    #[test]
    fn a_delay_in_another_unit_is_reported() {
        let mut settings = Settings::new(&Part::MPU_6050);
        for (delay_us, is_plausible) in [
            (0, true),
            (LONGEST_DELAY_US, true),
            (LONGEST_DELAY_US + 1, false),
            (1_900_000, false),
            (u32::MAX, false),
        ] {
            settings.sensor_delay_us = Some(delay_us);
            assert_eq!(settings.check().is_ok(), is_plausible, "{delay_us}");
            // The compass's age goes by it too.
            let used_us = if is_plausible { delay_us } else { 0 };
            assert_eq!(settings.delay_us(), used_us);
        }
        let error = settings.check().expect_err("a delay of 71 minutes");
        assert!(error.to_string().contains("100000 microseconds"), "{error}");
        settings.sensor_delay_us = None;
        let gravity_m_s2 = Vector3::new(0.0, 0.0, 9.8);
        settings.calibration.accelerometer = Some(AccelerometerCorrection {
            offset_m_s2: gravity_m_s2,
            ..AccelerometerCorrection::NONE
        });
        let reason = ImplausibleCalibration::Accelerometer;
        let error = ImplausibleSettings::Calibration(reason);
        assert_eq!(settings.check(), Err(error));
        assert_eq!(error.to_string(), reason.to_string());
    }

    /// No filter of a part is slower.
    #[test]
    fn the_limit_of_the_delay_is_above_that_of_every_part() {
        for part in &crate::mpu6050::PARTS {
            for low_pass in LowPass::ALL {
                let force_us = part.accelerometer_delay_us(low_pass);
                let rate_us = part.gyroscope_delay_us(low_pass);
                assert!(force_us.max(rate_us.into()) < LONGEST_DELAY_US);
            }
        }
    }
}
