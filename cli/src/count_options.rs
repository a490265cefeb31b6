//! Options for register counts.

use aplomb::mpu6050::{AccelerometerRange, Config, GyroscopeRange};
use aplomb_recordings::form::Form;
use aplomb_recordings::log::Statements;
use aplomb_recordings::units::{BadRows, RowOptions};

use crate::usage::Usage;

/// Full scales of register counts.
#[derive(clap::Args)]
pub struct RangeOptions {
    /// Accelerometer range of counts in g: 2, 4, 8 or 16 [default: for bursts what they state in a
    /// line such as `# --accel-range 2`, else 16]
    #[arg(long, value_name = "G")]
    accel_range: Option<AccelerometerRange>,
    /// Gyroscope range of counts in degrees per second: 250, 500, 1000 or 2000 [default: for bursts
    /// what they state in a line such as `# --gyro-range 250`, else 2000]
    #[arg(long, value_name = "DPS")]
    gyro_range: Option<GyroscopeRange>,
}

impl RangeOptions {
    /// Returns the options, and whether they were given.
    pub fn given(&self) -> [(&'static str, bool); 2] {
        [
            ("--accel-range", self.accel_range.is_some()),
            ("--gyro-range", self.gyro_range.is_some()),
        ]
    }

    /// Returns the sensor's configuration: with the ranges of the options, else with those that the
    /// recording states, else with the default ones.
    pub fn config(&self, stated: &Statements) -> Config {
        let accelerometer = self.accel_range.or(stated.accelerometer_range);
        let gyroscope = self.gyro_range.or(stated.gyroscope_range);
        Config::DEFAULT
            .with_accelerometer_range(accelerometer.unwrap_or_default())
            .with_gyroscope_range(gyroscope.unwrap_or_default())
    }
}

/// Options that give register counts their meaning.
#[derive(clap::Args)]
pub struct CountOptions {
    /// The recording's values are register counts of a sensor with these ranges
    #[arg(long, requires_all = ["accel_range", "gyro_range"])]
    pub raw: bool,
    #[command(flatten)]
    pub ranges: RangeOptions,
}

impl CountOptions {
    /// Refuses options that mean nothing for this form.
    pub fn check(&self, form: Form, rows: &RowOptions) -> Result<(), Usage> {
        let has_units = rows.force_unit.is_some() || rows.rate_unit.is_some();
        let has_ranges = self.ranges.given().iter().any(|(_, is_given)| *is_given);
        let checked = match form {
            Form::Bursts if self.raw => Err("--raw is for recordings: bursts are raw in any case"),
            Form::Bursts => return check_rows_of_bursts(rows),
            Form::Log(_) if self.raw && has_units => {
                Err("--raw gives the values their units: leave out --force-unit and --rate-unit")
            }
            Form::Log(_) if has_ranges && !self.raw => {
                Err("--accel-range and --gyro-range give counts their meaning: \
                 add --raw, if the recording holds counts")
            }
            _ => Ok(()),
        };
        checked.map_err(Usage::from)
    }

    /// Returns the options, and whether they were given.
    pub fn given(&self) -> [(&'static str, bool); 3] {
        let [accelerometer, gyroscope] = self.ranges.given();
        [("--raw", self.raw), accelerometer, gyroscope]
    }

    /// Returns the ranges, if both were given.
    pub fn ranges(&self) -> Option<(AccelerometerRange, GyroscopeRange)> {
        self.ranges.accel_range.zip(self.ranges.gyro_range)
    }
}

/// Refuses options for rows that mean nothing for bursts.
pub fn check_rows_of_bursts(rows: &RowOptions) -> Result<(), Usage> {
    let mut given = rows.given().into_iter();
    let is_unit = |(name, is_given): &(&str, bool)| *is_given && *name != "--bad-rows";
    if let Some((name, _)) = given.find(is_unit) {
        return Err(format!("{name} is for recordings, not for bursts").into());
    }
    if rows.bad_rows == Some(BadRows::Keep) {
        return Err("--bad-rows keep is for recordings: of bursts skip leaves the bad out".into());
    }
    Ok(())
}
