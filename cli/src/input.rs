//! What recordings have in common: their headers, and what register counts mean.

use std::error::Error;

use aplomb::mpu6050::{AccelerometerRange, Config, GyroscopeRange};
use aplomb::telemetry::bursts;
use aplomb_recordings::log::{Lines, LogError, LogFault, column_count};

/// The form of a text, by its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A bursts.csv.
    Bursts,
    /// A log of so many columns.
    Log(usize),
}

/// Reads the header of a text, which is the next line.
pub fn header(lines: &mut Lines) -> Result<String, Box<dyn Error>> {
    match lines.next_line() {
        // What a module sends before its first frame are messages.
        Ok(Some(header)) if !header.contains('\0') && !header.starts_with('#') => {
            return Ok(header.to_owned());
        }
        Ok(None) => return Err(lines.refuse_file(LogFault::Empty).into()),
        Ok(Some(_))
        | Err(LogError {
            reason: LogFault::NotText,
            ..
        }) => {}
        Err(error) => return Err(error.into()),
    }
    Err(format!(
        "{}: it is no table. A flight log has to be a file, not standard input; `replay` and `plot` take it, and `convert` makes a table of it",
        lines.place()
    )
    .into())
}

impl Form {
    /// Reads the header, which is the next line.
    pub fn read(lines: &mut Lines) -> Result<Self, Box<dyn Error>> {
        let header = header(lines)?;
        if header == bursts::HEADER {
            return Ok(Self::Bursts);
        }
        if let Some(columns) = column_count(&header) {
            return Ok(Self::Log(columns));
        }
        let fault = LogFault::Header(header);
        Err(format!("{}; or {} for bursts", lines.refuse(fault), bursts::HEADER).into())
    }
}

/// What register counts mean.
#[derive(clap::Args)]
pub struct Counts {
    /// The log's values are register counts of a sensor with these ranges
    #[arg(long, requires_all = ["accel_range", "gyro_range"])]
    pub raw: bool,
    /// Accelerometer range of counts in g: 2, 4, 8 or 16 (bursts: 16 unless told otherwise)
    #[arg(long, value_name = "G", value_parser = parse_accelerometer_range)]
    accel_range: Option<AccelerometerRange>,
    /// Gyroscope range of counts in degrees per second: 250, 500, 1000 or 2000 (bursts: 2000 unless told otherwise)
    #[arg(long, value_name = "DPS", value_parser = parse_gyroscope_range)]
    gyro_range: Option<GyroscopeRange>,
}

impl Counts {
    /// Refuses options that mean nothing for this form.
    pub fn check(&self, form: Form) -> Result<(), &'static str> {
        let has_ranges = self.accel_range.is_some() || self.gyro_range.is_some();
        match form {
            Form::Bursts if self.raw => Err("--raw is for logs: bursts are raw in any case"),
            Form::Log(_) if has_ranges && !self.raw => Err(
                "--accel-range and --gyro-range give counts their meaning: add --raw, if the log holds counts",
            ),
            _ => Ok(()),
        }
    }

    /// The options, and whether they were given.
    pub fn given(&self) -> [(&'static str, bool); 3] {
        [
            ("--raw", self.raw),
            ("--accel-range", self.accel_range.is_some()),
            ("--gyro-range", self.gyro_range.is_some()),
        ]
    }

    /// The ranges, if both were told.
    pub fn ranges(&self) -> Option<(AccelerometerRange, GyroscopeRange)> {
        self.accel_range.zip(self.gyro_range)
    }

    /// The sensor's settings, with the usual ranges if none were told.
    pub fn config(&self) -> Config {
        Config::DEFAULT
            .with_accelerometer_range(self.accel_range.unwrap_or_default())
            .with_gyroscope_range(self.gyro_range.unwrap_or_default())
    }
}

/// The range of this name in g.
pub fn parse_accelerometer_range(text: &str) -> Result<AccelerometerRange, &'static str> {
    match text {
        "2" => Ok(AccelerometerRange::G2),
        "4" => Ok(AccelerometerRange::G4),
        "8" => Ok(AccelerometerRange::G8),
        "16" => Ok(AccelerometerRange::G16),
        _ => Err("choose 2, 4, 8 or 16"),
    }
}

/// The range of this name in degrees per second.
pub fn parse_gyroscope_range(text: &str) -> Result<GyroscopeRange, &'static str> {
    match text {
        "250" => Ok(GyroscopeRange::Degrees250),
        "500" => Ok(GyroscopeRange::Degrees500),
        "1000" => Ok(GyroscopeRange::Degrees1000),
        "2000" => Ok(GyroscopeRange::Degrees2000),
        _ => Err("choose 250, 500, 1000 or 2000"),
    }
}
