//! `aplomb calibrate`: calibration of the accelerometer, of the gyroscope's scale and of a compass
//! from a recording, with the device's own rule and the library's fits.
//!
//! The firmware's stationary detector finds the rests, and its collector collects them. A recording
//! without rests may hold nearly still moments, in which the specific force is nearly gravity. The
//! program uses them if there are enough in every direction, and if a fit to half of them improves
//! the others. The output names this rule. The turns between the rests show the gyroscope's scale
//! and cross-axis terms.

mod accelerometer;
mod compass;
mod gyroscope;
mod report;
mod samples;

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use aplomb::calibration::Calibration;
use aplomb::mpu6050::{Config, Part};
use aplomb::pipeline::Settings;
use aplomb_recordings::flight_log;
use aplomb_recordings::form::Form;
use aplomb_recordings::log::Rows;
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::rate::median_step_us;
use aplomb_recordings::terminal::{print_line, print_message};
use aplomb_recordings::units::RowOptions;

use crate::burst_rows::BurstRows;
use crate::count_options::CountOptions;
use crate::i2c::I2cOptions;
use crate::progress;
use crate::usage::Usage;

use report::json;
use samples::{Sample, find_plateaus, finest_config, read_bursts, read_rows, to_samples};

/// Fewest rows of a rest.
const LEAST_ROWS: usize = 10;
/// Shortest pause of a recording, µs, and in steps between its rows.
const SHORTEST_PAUSE_US: u64 = 100_000;
const SHORTEST_PAUSE_STEPS: u64 = 5;

/// Find the calibration of accelerometer, gyroscope and compass in a recording that shows the
/// sensor from many sides.
///
/// INPUT is a recording (t_us,ax,ay,az,gx,gy,gz[,…]; microseconds, m/s², rad/s, or counts with
/// --raw) or a bursts.csv, plain or gzipped. Lay the sensor on each of its six sides for two
/// seconds; a dozen poses, edges included, show the cross-axis terms too. The turns between them
/// then show the scale and the cross-axis terms of the gyroscope.
///
/// With the columns mx,my,mz (µT) the compass is calibrated too: lay it still for 3 s, then
/// turn it slowly to and fro about all axes for 30 s, each side down once, away from iron. One
/// fit with the filter's attitudes finds hard iron, soft iron and gains. It is refused if over a
/// fifth of the directions is missing, or if the readings contradict the motion.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb calibrate poses.csv
  aplomb calibrate counts.csv --raw --accel-range 2 --gyro-range 250 --json
  aplomb calibrate --draw-poses poses.png
  aplomb calibrate --i2c /dev/i2c-1 --json > calibration.json

JSON: rule (rest or nearly_still), poses, offset_m_s2, matrix (what corrects: times reading less
offset), cross_axis_fitted, residual_before_g, residual_after_g, and held_out: fitted and held_out
poses, residual_before_g and residual_after_g of those held out; accelerometer_refused instead, if
only the compass was found. gyroscope (turns, matrix, residual_before_deg, residual_after_deg), or
gyroscope_refused. With a compass: compass (readings, matrix times reading less hard_iron_ut is
the field in sensor axes; strength_ut, dip_deg, residual_ut, is_mount_that_of_the_imu), or
compass_refused.")]
pub struct Options {
    /// The recording
    #[arg(required_unless_present_any = ["draw_poses", "i2c"])]
    #[arg(conflicts_with_all = ["I2cOptions", "seconds"])]
    input: Option<PathBuf>,
    #[command(flatten)]
    sensor: I2cOptions,
    /// Time to lay that sensor in its poses
    #[arg(
        long,
        value_name = "S",
        requires = "i2c",
        default_value_t = 60,
        value_parser = clap::value_parser!(u64).range(10..=3_600)
    )]
    seconds: u64,
    #[command(flatten)]
    counts: CountOptions,
    #[command(flatten)]
    rows: RowOptions,
    /// Age of the compass's readings against the samples of their rows, in microseconds [default:
    /// 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=1_000_000))]
    compass_delay_us: Option<u32>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Draw the poses to hold the sensor in into this PNG file
    #[arg(long, value_name = "OUT.png")]
    draw_poses: Option<PathBuf>,
}

impl Options {
    /// Refuses options that mean nothing without a recording.
    fn check(&self) -> Result<(), Usage> {
        if self.input.is_some() {
            return Ok(());
        }
        let is_on_bus = self.sensor.i2c.is_some();
        let own = [
            ("--compass-delay-us", self.compass_delay_us.is_some()),
            ("--sensor-mount", self.sensor.mount.is_some()),
            ("--calibration", self.sensor.calibration.is_some()),
            ("--json", self.json && !is_on_bus),
        ];
        let given = self.counts.given().into_iter().chain(self.rows.given());
        let mut unused = given.chain(own).filter(|(_, is_given)| *is_given);
        let reason = match is_on_bus {
            true => "a sensor on a bus is calibrated from its own counts, in its own axes",
            false => "there is no recording",
        };
        match unused.next() {
            Some((name, _)) => Err(format!("{name} would change nothing: {reason}").into()),
            None => Ok(()),
        }
    }

    /// Refuses the options of a compass where there is none.
    fn check_compass(&self, form: Form) -> Result<(), Usage> {
        let has_compass = matches!(form, Form::Log(columns) if columns.has_compass());
        let is_given = self.compass_delay_us.is_some() || self.rows.field_unit.is_some();
        if is_given && !has_compass {
            return Err(
                "--compass-delay-us and --field-unit would change nothing: the recording has no \
                 compass"
                    .into(),
            );
        }
        Ok(())
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    options.check()?;
    if let Some(path) = &options.draw_poses {
        let inputs: Vec<&Path> = options.input.iter().map(PathBuf::as_path).collect();
        OutputFile::write(path, &inputs, &crate::poses::draw().png())?;
    }
    let Some(input) = options.input.as_ref().or(options.sensor.i2c.as_ref()) else {
        return Ok(());
    };
    let recording = match &options.input {
        Some(input) => Recording::read(input, options)?,
        None => {
            let (samples, config) = options.sensor.collect(options.seconds)?;
            let to_sample = |(t_us, raw)| Sample {
                t_us,
                raw,
                field_ut: None,
            };
            Recording::new(config, samples.into_iter().map(to_sample).collect())
        }
    };
    let mut report = format!(
        "{}: {} rows, {:.1} s\n",
        input.display(),
        recording.samples.len(),
        recording.duration_s(),
    );
    let accelerometer = recording
        .accelerometer(&mut report)
        .map_err(|reason| format!("{}: {reason}", input.display()));
    let sensors = (accelerometer.as_ref()).map_or(Calibration::NONE, report::Found::calibration);
    let compass = compass::find(&recording, options.compass_delay_us.unwrap_or(0), &sensors)
        .map(|found| found.map_err(|reason| format!("compass: {reason}")));
    match (&accelerometer, &compass) {
        (Err(reason), None) => return Err(reason.clone().into()),
        (Err(reason), Some(Err(other))) => return Err(format!("{reason}; {other}").into()),
        _ => {}
    }
    if options.json {
        print_line(&json(&accelerometer, compass.as_ref())?);
        return Ok(());
    }
    match &accelerometer {
        Ok(found) => found.describe(&mut report),
        Err(reason) => writeln!(report, "{reason}")?,
    }
    match &compass {
        Some(Ok(found)) => write!(report, "{found}")?,
        Some(Err(reason)) => writeln!(report, "{reason}")?,
        None => {}
    }
    print_line(report.trim_end());
    Ok(())
}

/// Recording as register counts.
struct Recording {
    settings: Settings,
    samples: Vec<Sample>,
    /// Usual time from row to row, µs: pauses of the logger leave it alone.
    step_us: u64,
}

impl Recording {
    fn read(path: &Path, options: &Options) -> Result<Self, Box<dyn Error>> {
        if flight_log::is_flight_log(path) {
            let name = path.display();
            return Err(format!(
                "{name}: it is a flight log. Make bursts of it, and calibrate from them: aplomb \
                 convert {name} poses-bursts.csv"
            )
            .into());
        }
        let mut lines = progress::lines(path)?;
        let form = Form::read(&mut lines)?;
        options.counts.check(form, &options.rows)?;
        options.check_compass(form)?;
        let mut config = options.counts.ranges.config(lines.stated());
        let samples = match form {
            Form::Bursts => read_bursts(BurstRows::new(lines, options.rows.bad_rows))?,
            Form::Log(columns) => {
                let is_raw = options.counts.raw;
                let rows = read_rows(Rows::new(lines, columns, options.rows, is_raw)?)?;
                let at_line = |(line, reason)| format!("{}:{line}: {reason}", path.display());
                let mut clipped = None;
                if !is_raw {
                    config = finest_config(&rows).map_err(at_line)?;
                    if let Some((plateaus, message)) = find_plateaus(&rows) {
                        print_message(&format!("warning: {}: {message}", path.display()));
                        clipped = Some(plateaus);
                    }
                }
                to_samples(&rows, &config, is_raw, clipped).map_err(at_line)?
            }
        };
        if samples.len() < LEAST_ROWS {
            return Err(format!(
                "{}: {} rows are too few to find a rest in",
                path.display(),
                samples.len()
            )
            .into());
        }
        Ok(Self::new(config, samples))
    }

    fn new(config: Config, samples: Vec<Sample>) -> Self {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.sensor = config;
        let times_us: Vec<i64> = samples.iter().map(|sample| sample.t_us).collect();
        let step_us = median_step_us(&times_us).max(1);
        Self {
            settings,
            samples,
            step_us,
        }
    }

    fn duration_s(&self) -> f64 {
        match (self.samples.first(), self.samples.last()) {
            (Some(first), Some(last)) => last.t_us.abs_diff(first.t_us) as f64 * 1e-6,
            _ => 0.0,
        }
    }

    /// Returns whether the recording pauses between these times.
    fn is_pause(&self, before_us: i64, after_us: i64) -> bool {
        let shortest_us = SHORTEST_PAUSE_US.max(self.step_us.saturating_mul(SHORTEST_PAUSE_STEPS));
        before_us.abs_diff(after_us) > shortest_us
    }

    /// Returns the length of the longest pause and the time of its start, s.
    fn longest_pause_s(&self) -> Option<(f64, f64)> {
        let pairs = self.samples.windows(2);
        let steps_us = pairs.map(|pair| (pair[0].t_us, pair[1].t_us));
        let pauses_us =
            steps_us.filter(|(before_us, after_us)| self.is_pause(*before_us, *after_us));
        let (before_us, after_us) =
            pauses_us.max_by_key(|(before_us, after_us)| before_us.abs_diff(*after_us))?;
        let length_us = before_us.abs_diff(after_us);
        Some((length_us as f64 * 1e-6, before_us as f64 * 1e-6))
    }
}
