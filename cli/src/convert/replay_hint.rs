//! Options for `replay` that give a converted flight the attitudes of the flight itself.

use aplomb::calibration::Mount;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::{Config, Part};
use aplomb::pipeline::{CompassReading, Settings};
use aplomb::units::degrees;
use aplomb_recordings::units::knowledge_name;

use super::Kind;

/// Settings with which the bursts of the input have to be replayed.
pub(super) struct Replayed {
    /// Settings of the flight. Of a table of bursts they are the defaults.
    settings: Settings,
    /// Knowledge of accelerometer and gyroscope. The output has the sensor's own values, so no
    /// calibration of the flight counts.
    knowledge: AccelerometerKnowledge,
    /// The input is a flight log.
    is_flight: bool,
}

impl Replayed {
    /// Returns the settings of a flight.
    pub(super) const fn of_flight(settings: Settings) -> Self {
        Self {
            settings,
            knowledge: AccelerometerKnowledge::Factory,
            is_flight: true,
        }
    }

    /// Returns the settings of bursts with this configuration and this knowledge.
    pub(super) fn of_bursts(config: Config, knowledge: AccelerometerKnowledge) -> Self {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.sensor = config;
        Self {
            settings,
            knowledge,
            is_flight: false,
        }
    }

    /// Returns the mount of the sensor, if it is known.
    pub(super) fn mount(&self) -> Option<Mount> {
        self.is_flight.then(|| self.settings.mount())
    }

    /// Returns the delay of the samples, µs.
    fn delay_us(&self) -> u32 {
        let Settings { part, sensor, .. } = &self.settings;
        let part_us = part.gyroscope_delay_us(sensor.low_pass).into();
        self.settings.sensor_delay_us.unwrap_or(part_us)
    }

    /// Returns the options to replay an output of this kind with. A flight log needs none.
    pub(super) fn options(&self, into: Kind, readings: &mut Readings) -> Option<String> {
        let mut options = String::new();
        if let Some(mount) = self.mount() {
            options += &format!(" --mount {}", mount.name());
        }
        let sensor = &self.settings.sensor;
        match into {
            Kind::FlightLog => return None,
            Kind::Bursts => {
                options += &format!(
                    " --accel-range {} --gyro-range {}",
                    sensor.accelerometer_range, sensor.gyroscope_range
                );
            }
            Kind::Csv => {}
        }
        let (delay_us, knowledge) = (self.delay_us(), knowledge_name(self.knowledge));
        options += &format!(" --sensor-delay-us {delay_us} --accelerometer {knowledge}");
        if into == Kind::Csv && readings.count > 0 {
            options += &readings.options();
        }
        Some(options.trim_start().to_owned())
    }

    /// Returns the lines that name these options, and what no option restores.
    pub(super) fn lines(&self, into: Kind, options: &str, readings: &Readings) -> Vec<String> {
        let has_compass = into == Kind::Csv && readings.count > 0;
        let mut lines = vec![format!("replay it with {options}")];
        if self.is_flight {
            lines.extend(self.calibration(has_compass));
        }
        if has_compass {
            lines.extend(readings.change());
        }
        lines
    }

    /// Returns the lines on the flight's calibration.
    fn calibration(&self, has_compass: bool) -> Vec<String> {
        let calibration = &self.settings.calibration;
        let in_file = calibration.accelerometer.is_some() || calibration.gyroscope_matrix.is_some();
        let parts = [
            (
                "the gyroscope's offset",
                calibration.gyroscope.is_some() || calibration.temperature.is_some(),
            ),
            ("the accelerometer", calibration.accelerometer.is_some()),
            (
                "the gyroscope's matrix",
                calibration.gyroscope_matrix.is_some(),
            ),
            ("the level", calibration.level.is_some()),
        ];
        let parts = parts.into_iter().filter(|(_, is_there)| *is_there);
        let parts: Vec<&str> = parts.map(|(name, _)| name).collect();
        let flown = match parts.is_empty() {
            true => "the flight had no calibration".to_owned(),
            false => format!(
                "the flight's calibration is not in them: {}",
                parts.join(", ")
            ),
        };
        let mut lines = vec![format!("its values are the sensor's own; {flown}")];
        if in_file {
            let compass = if has_compass {
                ", without a compass, whose readings are calibrated"
            } else {
                ""
            };
            lines.push(format!(
                "if `aplomb calibrate` has written it to a file: --calibration FILE in place of \
                 --accelerometer{compass}"
            ));
        }
        lines
    }
}

/// Readings of a compass in the output.
#[derive(Default)]
pub(super) struct Readings {
    pub(super) count: usize,
    /// Knowledge of the last reading.
    knowledge: CompassKnowledge,
    /// Ages of the readings against the samples' motion, µs.
    ages_us: Vec<u32>,
    /// Declination of the last reading, and the last other one before it.
    declination_deg: f32,
    other_declination_deg: Option<f32>,
}

impl Readings {
    /// Counts a reading of the input with these settings.
    pub(super) fn add(&mut self, reading: &CompassReading, replayed: &Replayed) {
        self.knowledge = reading.knowledge;
        let motion_us = (reading.sample_t_us as u32).wrapping_sub(replayed.delay_us());
        let age_us = motion_us.wrapping_sub(reading.measured_us) as i32;
        self.ages_us.push(age_us.max(0).unsigned_abs());
        // The module takes hundredths of a degree. The sum makes 0 of -0.
        let declination_deg = (degrees(reading.declination_rad) * 100.0).round() / 100.0 + 0.0;
        let before_deg = std::mem::replace(&mut self.declination_deg, declination_deg);
        if self.count > 0 && before_deg != declination_deg {
            self.other_declination_deg = Some(before_deg);
        }
        self.count += 1;
    }

    /// Returns the options for the compass. There is at least one reading.
    fn options(&mut self) -> String {
        let middle = self.ages_us.len() / 2;
        let age_us = *self.ages_us.select_nth_unstable(middle).1;
        let (knowledge, declination_deg) = (self.knowledge.name(), self.declination_deg);
        format!(
            " --compass {knowledge} --compass-delay-us {age_us} --declination {declination_deg}"
        )
    }

    /// Returns a line on a declination that changed.
    fn change(&self) -> Option<String> {
        let (before_deg, last_deg) = (self.other_declination_deg?, self.declination_deg);
        Some(format!(
            "the declination changed within the flight, from {before_deg} to {last_deg} degrees: \
             --declination states the last, and the headings before differ from the flight's"
        ))
    }
}
