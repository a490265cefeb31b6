//! Options for reading a recording, shared by `replay` and `plot`.

use std::error::Error;
use std::path::{Path, PathBuf};

use aplomb::calibration::{Calibration, CompassCorrection, Mount};
use aplomb::estimator::LONGEST_DELAY_US;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::Part;
use aplomb::pipeline::Settings;
use aplomb::units::radians;
use aplomb_recordings::flight_log::{Flight, FlightLog};
use aplomb_recordings::form::Form;
use aplomb_recordings::log::Lines;
use aplomb_recordings::terminal::print_message;
use aplomb_recordings::units::{RowOptions, knowledge};

use crate::any_pipeline::FilterName;
use crate::arming::Arming;
use crate::burst_rows::BurstRows;
use crate::calibration_file::CalibrationFile;
use crate::count_options::CountOptions;
use crate::source::{BurstSource, CompassOptions, FlightSource, LogOptions, LogSource, Source};
use crate::usage::Usage;

/// Largest delay of a compass, µs: none is slower.
const LONGEST_COMPASS_DELAY_US: i64 = 1_000_000;

/// Options for reading a recording.
#[derive(clap::Args)]
pub struct ReadOptions {
    /// The recording
    pub input: PathBuf,
    /// Filter: kalman, axis-kalman, classic [default: kalman]
    #[arg(long, value_name = "NAME")]
    filter: Option<FilterName>,
    /// Body's forward and down axes in sensor axes, for example +x-z [default: z-up]
    #[arg(long, allow_hyphen_values = true)]
    mount: Option<Mount>,
    /// Delay of the samples, in microseconds: attitudes are extrapolated by it (SI units: 0 by
    /// default; bursts: the delay of the sensor's low-pass filter)
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(..=i64::from(LONGEST_DELAY_US))
    )]
    sensor_delay_us: Option<u32>,
    /// Knowledge of the accelerometer's offset: factory, six-poses, calibrated [default: what the
    /// recording states in a line such as `# --accelerometer factory`, else calibrated for SI
    /// units, factory for bursts and register counts]. A calibrated sensor has a
    /// calibrated gyroscope too. If unsure, choose factory: calibrated for a factory chip makes
    /// sigma up to two times too small, factory for a calibrated one costs a tenth of the accuracy
    #[arg(long, value_name = "KNOWLEDGE", value_parser = knowledge)]
    accelerometer: Option<AccelerometerKnowledge>,
    /// The calibration of the sensors, for a recording that has none yet: what `aplomb calibrate`
    /// prints as JSON
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Knowledge of the compass's hard iron: factory, hard-iron, calibrated [default: factory]
    #[arg(long, value_name = "KNOWLEDGE", value_parser = compass_knowledge)]
    compass: Option<CompassKnowledge>,
    /// Age of the compass's readings against the samples of their rows, in microseconds [default:
    /// 0]
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(..=LONGEST_COMPASS_DELAY_US)
    )]
    compass_delay_us: Option<u32>,
    /// Declination, in degrees, east positive: the heading is then from true north [default: 0]
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, value_parser = declination)]
    declination: Option<f32>,
    /// Time from which on the filter is armed, in seconds after the first row, for recordings that
    /// do not hold the state. Armed as in flight, a steady turn is no rest; but a rest shows
    /// nothing either, so give the take-off
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true, value_parser = armed_from)]
    armed_from: Option<f64>,
    /// Number of the flight, in a flight log with several starts of the module, counted from 1
    #[arg(long, value_name = "N")]
    pub flight: Option<usize>,
    #[command(flatten)]
    counts: CountOptions,
    #[command(flatten)]
    rows: RowOptions,
}

/// Parses what is known of a compass's hard iron.
pub fn compass_knowledge(name: &str) -> Result<CompassKnowledge, &'static str> {
    CompassKnowledge::from_name(name).ok_or("it is factory, hard-iron or calibrated")
}

/// Parses a declination in degrees.
fn declination(text: &str) -> Result<f32, &'static str> {
    match text.parse::<f32>() {
        Ok(degrees) if degrees.abs() <= 180.0 => Ok(degrees),
        _ => Err("it is a number of degrees from -180 to 180"),
    }
}

/// Parses a time after the first row, s.
fn armed_from(text: &str) -> Result<f64, &'static str> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds >= 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("it is a number of seconds from 0 on"),
    }
}

/// Kind of input, as far as it decides on options.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A recording in SI units or counts, or bursts.
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
                "--calibration",
                "--compass",
                "--compass-delay-us",
                "--declination",
                "--armed-from",
                "--raw",
                "--accel-range",
                "--gyro-range",
                "--time-unit",
                "--force-unit",
                "--rate-unit",
                "--field-unit",
                "--bad-rows",
            ],
            Self::FlightLog => &["--filter", "--flight"],
            Self::Attitudes { has_truth: true } => &["--mount", "--time-unit"],
            Self::Attitudes { has_truth: false } => &[],
        }
    }

    /// Returns why it takes no others.
    fn reason(self) -> &'static str {
        match self {
            Self::Recording => "it holds one flight",
            Self::FlightLog => "a flight log brings its mount, ranges, delay and arming",
            Self::Attitudes { .. } => "these are attitudes, which a filter has made already",
        }
    }
}

impl ReadOptions {
    /// Refuses options that mean nothing for this kind of input.
    pub fn check(&self, kind: Kind) -> Result<(), Usage> {
        let own = [
            ("--filter", self.filter.is_some()),
            ("--mount", self.mount.is_some()),
            ("--sensor-delay-us", self.sensor_delay_us.is_some()),
            ("--accelerometer", self.accelerometer.is_some()),
            ("--calibration", self.calibration.is_some()),
            ("--compass", self.compass.is_some()),
            ("--compass-delay-us", self.compass_delay_us.is_some()),
            ("--declination", self.declination.is_some()),
            ("--armed-from", self.armed_from.is_some()),
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
        )
        .into())
    }

    /// Returns the files that are read: no output replaces one.
    pub fn inputs(&self) -> Vec<&Path> {
        let calibration = self.calibration.as_deref();
        [self.input.as_path()]
            .into_iter()
            .chain(calibration)
            .collect()
    }

    /// Returns the unit of times and the other options for rows.
    pub fn rows(&self) -> &RowOptions {
        &self.rows
    }

    /// Opens a recording or bursts. The header is the next line.
    pub fn open(&self, mut lines: Lines) -> Result<Box<dyn Source>, Box<dyn Error>> {
        self.check(Kind::Recording)?;
        let form = Form::read(&mut lines)?;
        self.counts.check(form, &self.rows)?;
        self.check_compass(form)?;
        self.check_armed(form)?;
        let arming = Arming::new(self.armed_from);
        let stated = *lines.stated();
        if !matches!(form, Form::Bursts) && stated.has_ranges() {
            let name = lines.name();
            print_message(&format!(
                "warning: {name}: the full scales in its comments change nothing: SI units have \
                 none, and counts need --accel-range and --gyro-range"
            ));
        }
        let (calibration, compass) = self.calibration(form, stated.accelerometer)?;
        let accelerometer = match calibration.accelerometer {
            Some(_) => None,
            None => self.accelerometer.or(stated.accelerometer),
        };
        Ok(match form {
            Form::Bursts => {
                let mut settings = Settings::new(&Part::MPU_6050);
                settings.mount = self.mount();
                settings.sensor_delay_us = self.sensor_delay_us;
                settings.sensor = self.counts.ranges.config(&stated);
                settings.calibration = calibration;
                let rows = BurstRows::new(lines, self.rows.bad_rows);
                let mut bursts = BurstSource::new(rows, self.filter(), settings);
                bursts.set_arming(arming);
                if let Some(knowledge) = accelerometer {
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
                    calibration,
                    accelerometer,
                    compass: CompassOptions {
                        knowledge: match compass {
                            Some(_) => CompassKnowledge::Calibrated,
                            None => self.compass.unwrap_or_default(),
                        },
                        correction: compass.unwrap_or(CompassCorrection::NONE),
                        delay_us: self.compass_delay_us.unwrap_or(0),
                        declination_rad: radians(self.declination.unwrap_or(0.0)),
                    },
                    arming,
                    rows: self.rows,
                };
                Box::new(LogSource::new(lines, options)?)
            }
        })
    }

    /// Refuses the options of a compass where there is none, or for a filter that has none.
    fn check_compass(&self, form: Form) -> Result<(), Usage> {
        let mut is_given =
            self.compass.is_some() || self.compass_delay_us.is_some() || self.declination.is_some();
        let reason = match form {
            Form::Log(columns) if columns.has_compass() => {
                if self.filter() == FilterName::Kalman {
                    return Ok(());
                }
                "this filter has no heading: leave --filter out"
            }
            Form::Log(_) => {
                is_given |= self.rows.field_unit.is_some();
                "the recording has no compass: its header lacks mx,my,mz"
            }
            Form::Bursts => "bursts have no compass",
        };
        if is_given {
            let input = self.input.display();
            return Err(format!(
                "{input}: --compass, --compass-delay-us, --declination and --field-unit would \
                 change nothing: {reason}"
            )
            .into());
        }
        Ok(())
    }

    /// Reads the calibration of the options; none is the default. Refuses one that would change
    /// nothing, or that contradicts another option or the knowledge that the recording states.
    fn calibration(
        &self,
        form: Form,
        stated: Option<AccelerometerKnowledge>,
    ) -> Result<(Calibration, Option<CompassCorrection>), Box<dyn Error>> {
        let Some(path) = &self.calibration else {
            return Ok((Calibration::NONE, None));
        };
        let CalibrationFile { sensors, compass } = CalibrationFile::read(path)?;
        let refuse =
            |reason: &str| Err(Usage::from(format!("{}: {reason}", path.display())).into());
        // Twelve poses calibrate the gyroscope too, six the accelerometer alone.
        let is_corrected = match stated {
            Some(AccelerometerKnowledge::Calibrated) => sensors != Calibration::NONE,
            Some(AccelerometerKnowledge::SixPoses) => sensors.accelerometer.is_some(),
            Some(AccelerometerKnowledge::Factory) | None => false,
        };
        if is_corrected {
            return refuse(
                "the recording states in its first lines that it is calibrated already, and would \
                 be corrected twice: leave --calibration out, or, if the statement is wrong, write \
                 `# --accelerometer factory` in its place",
            );
        }
        if sensors != Calibration::NONE && self.accelerometer.is_some() {
            return refuse(
                "it states what is known of the accelerometer: leave --accelerometer out",
            );
        }
        if compass.is_some() && self.compass.is_some() {
            return refuse(
                "it calibrates the compass too: leave --compass out, or, if the recording's field \
                 is calibrated already, leave \"compass\" out of the file",
            );
        }
        let has_compass = matches!(form, Form::Log(columns) if columns.has_compass());
        if sensors == Calibration::NONE && !has_compass {
            return refuse("it calibrates a compass alone, and the recording has none");
        }
        Ok((sensors, compass))
    }

    /// Refuses `--armed-from` where the recording has the state, or the filter has none.
    fn check_armed(&self, form: Form) -> Result<(), Usage> {
        let reason = match form {
            _ if self.armed_from.is_none() => return Ok(()),
            _ if self.filter() != FilterName::Kalman => {
                "--armed-from would change nothing: this filter cannot be armed"
            }
            Form::Log(columns) if columns.has_armed() => {
                "its column armed holds the armed state: leave out --armed-from"
            }
            Form::Log(_) | Form::Bursts => return Ok(()),
        };
        Err(format!("{}: {reason}", self.input.display()).into())
    }

    /// Opens a flight of a flight log.
    pub fn open_flight(
        &self,
        log: &FlightLog,
        flight: &Flight,
    ) -> Result<FlightSource, Box<dyn Error>> {
        self.check(Kind::FlightLog)?;
        let source = FlightSource::new(log, flight, self.filter());
        source.map_err(|reason| format!("{}: {reason}", self.input.display()).into())
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
