//! Options for reading a recording, shared by `replay` and `plot`.

use std::error::Error;
use std::path::PathBuf;

use aplomb::calibration::Mount;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb_recordings::flight_log::{Flight, FlightLog};
use aplomb_recordings::form::Form;
use aplomb_recordings::log::Lines;
use aplomb_recordings::units::{RowOptions, knowledge};

use crate::device::FilterName;
use crate::input::Counts;
use crate::source::{Bursts, Log, LogOptions, Logged, Source};

/// Largest delay: no low-pass filter or bus is slower, and no turn lasts longer.
const LONGEST_DELAY_US: i64 = 1_000_000;

/// Options for reading a recording.
#[derive(clap::Args)]
pub struct Reading {
    /// The recording
    pub input: PathBuf,
    /// Filter: kalman, axis-kalman, classic [default: kalman]
    #[arg(long, value_name = "NAME")]
    filter: Option<FilterName>,
    /// Body's forward and down axes in sensor axes, for example +x-z [default: z-up]
    #[arg(long, allow_hyphen_values = true)]
    mount: Option<Mount>,
    /// Delay of the samples, in microseconds: attitudes are extrapolated by it (logs: 0 by
    /// default; bursts: the delay of the sensor's low-pass filter)
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(..=LONGEST_DELAY_US)
    )]
    sensor_delay_us: Option<u32>,
    /// Knowledge of the accelerometer's offset: factory, six-poses, calibrated [default:
    /// calibrated for SI units, factory for bursts and register counts]
    #[arg(long, value_name = "KNOWLEDGE", value_parser = knowledge)]
    accelerometer: Option<AccelerometerKnowledge>,
    /// Number of the flight, in a flight log with several starts of the module, counted from 1
    #[arg(long, value_name = "N")]
    pub flight: Option<usize>,
    #[command(flatten)]
    counts: Counts,
    #[command(flatten)]
    rows: RowOptions,
}

/// Kind of input, as far as it decides on options.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A log or bursts.
    Recording,
    /// A flight log.
    FlightLog,
    /// Attitudes, perhaps compared with a truth in the sensor's axes.
    Attitudes {
        /// Compared with a truth.
        has_truth: bool,
    },
}

impl Kind {
    /// Returns the options that mean something for this kind.
    fn takes(self) -> &'static [&'static str] {
        match self {
            Self::Recording => &[
                "--filter",
                "--mount",
                "--sensor-delay-us",
                "--accelerometer",
                "--raw",
                "--accel-range",
                "--gyro-range",
                "--time-unit",
                "--force-unit",
                "--rate-unit",
                "--bad-rows",
            ],
            Self::FlightLog => &["--filter", "--flight"],
            Self::Attitudes { has_truth: true } => &["--mount"],
            Self::Attitudes { has_truth: false } => &[],
        }
    }

    /// Returns why it takes no others.
    fn reason(self) -> &'static str {
        match self {
            Self::Recording => "it holds one flight",
            Self::FlightLog => "a flight log brings its mount, its ranges and its delay",
            Self::Attitudes { .. } => "these are attitudes, which a filter has made already",
        }
    }
}

impl Reading {
    /// Refuses options that mean nothing for this kind of input.
    pub fn check(&self, kind: Kind) -> Result<(), String> {
        let own = [
            ("--filter", self.filter.is_some()),
            ("--mount", self.mount.is_some()),
            ("--sensor-delay-us", self.sensor_delay_us.is_some()),
            ("--accelerometer", self.accelerometer.is_some()),
            ("--flight", self.flight.is_some()),
        ];
        let given = own
            .into_iter()
            .chain(self.counts.given())
            .chain(self.rows.given());
        let unused = given.filter(|(name, is_given)| *is_given && !kind.takes().contains(name));
        let unused: Vec<&str> = unused.map(|(name, _)| name).collect();
        if unused.is_empty() {
            return Ok(());
        }
        Err(format!(
            "{}: {} would change nothing: {}",
            self.input.display(),
            unused.join(" "),
            kind.reason()
        ))
    }

    /// Opens a log or bursts. The header is the next line.
    pub fn open(&self, mut lines: Lines) -> Result<Box<dyn Source>, Box<dyn Error>> {
        self.check(Kind::Recording)?;
        let form = Form::read(&mut lines)?;
        self.counts.check(form, &self.rows)?;
        Ok(match form {
            Form::Bursts => {
                let (mount, config) = (self.mount(), self.counts.config());
                let delay_us = self.sensor_delay_us;
                let mut bursts = Bursts::new(lines, self.filter(), mount, config, delay_us);
                if let Some(knowledge) = self.accelerometer {
                    bursts.set_accelerometer_knowledge(knowledge);
                }
                Box::new(bursts)
            }
            Form::Log(columns) => {
                let options = LogOptions {
                    columns,
                    filter: self.filter(),
                    mount: self.mount(),
                    delay_us: self.sensor_delay_us.unwrap_or(0),
                    ranges: self.counts.ranges(),
                    accelerometer: self.accelerometer,
                    rows: self.rows,
                };
                Box::new(Log::new(lines, options)?)
            }
        })
    }

    /// Opens a flight of a flight log.
    pub fn open_flight(&self, log: &FlightLog, flight: &Flight) -> Result<Logged, String> {
        self.check(Kind::FlightLog)?;
        Logged::new(log, flight, self.filter())
            .map_err(|reason| format!("{}: {reason}", self.input.display()))
    }

    /// Returns the mount of the options, or the default.
    pub fn mount(&self) -> Mount {
        self.mount.unwrap_or(Mount::Z_UP)
    }

    /// Returns the filter of the options, or the default.
    pub fn filter(&self) -> FilterName {
        self.filter.unwrap_or_default()
    }
}
