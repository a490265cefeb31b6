//! Options for register counts.

use aplomb::mpu6050::{AccelerometerRange, Config, GyroscopeRange};
use aplomb_recordings::form::Form;
use aplomb_recordings::units::RowOptions;

/// Options that give register counts their meaning.
#[derive(clap::Args)]
pub struct CountOptions {
    /// The recording's values are register counts of a sensor with these ranges
    #[arg(long, requires_all = ["accel_range", "gyro_range"])]
    pub raw: bool,
    /// Accelerometer range of counts in g: 2, 4, 8 or 16 (bursts: 16 by default)
    #[arg(long, value_name = "G")]
    accel_range: Option<AccelerometerRange>,
    /// Gyroscope range of counts in degrees per second: 250, 500, 1000 or 2000
    /// (bursts: 2000 by default)
    #[arg(long, value_name = "DPS")]
    gyro_range: Option<GyroscopeRange>,
}

impl CountOptions {
    /// Refuses options that mean nothing for this form.
    pub fn check(&self, form: Form, rows: &RowOptions) -> Result<(), &'static str> {
        let has_units = rows.force_unit.is_some() || rows.rate_unit.is_some();
        let has_row_options = rows.given().iter().any(|(_, is_given)| *is_given);
        let has_ranges = self.accel_range.is_some() || self.gyro_range.is_some();
        match form {
            Form::Bursts if self.raw => Err("--raw is for recordings: bursts are raw in any case"),
            Form::Bursts if has_row_options => Err(
                "--time-unit, --force-unit, --rate-unit, --field-unit and --bad-rows are for \
                 recordings, not for bursts",
            ),
            Form::Log(_) if self.raw && has_units => {
                Err("--raw gives the values their units: leave out --force-unit and --rate-unit")
            }
            Form::Log(_) if has_ranges && !self.raw => {
                Err("--accel-range and --gyro-range give counts their meaning: \
                 add --raw, if the recording holds counts")
            }
            _ => Ok(()),
        }
    }

    /// Returns the options, and whether they were given.
    pub fn given(&self) -> [(&'static str, bool); 3] {
        [
            ("--raw", self.raw),
            ("--accel-range", self.accel_range.is_some()),
            ("--gyro-range", self.gyro_range.is_some()),
        ]
    }

    /// Returns the ranges, if both were given.
    pub fn ranges(&self) -> Option<(AccelerometerRange, GyroscopeRange)> {
        self.accel_range.zip(self.gyro_range)
    }

    /// Returns the sensor's configuration, with the default ranges if none were given.
    pub fn config(&self) -> Config {
        Config::DEFAULT
            .with_accelerometer_range(self.accel_range.unwrap_or_default())
            .with_gyroscope_range(self.gyro_range.unwrap_or_default())
    }
}
