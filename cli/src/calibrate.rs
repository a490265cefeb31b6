//! `aplomb calibrate`: calibration of the accelerometer, of the gyroscope's scale and of a compass
//! from a recording, with the device's own rule and the library's fits.
//!
//! The firmware's stationary detector finds the rests, and its collector collects them. A recording
//! without rests may hold slow moments, in which the specific force is nearly gravity. The program
//! uses them if there are enough in every direction, and the output names this rule. Half of the
//! poses are held out, to report the residual on poses that the fit has not seen. The turns between
//! the rests show the gyroscope's scale and cross-axis terms.

mod compass;
mod gyroscope;
mod samples;

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use aplomb::attitude::Vector3;
use aplomb::calibration::accelerometer::{self, AccelerometerFit, FitError, PoseCollector};
use aplomb::calibration::gyroscope::GyroscopeFit;
use aplomb::calibration::{
    ImuReading, NoiseModel, SensorSetup, StationaryDetector, StationaryMean, StationaryProgress,
    SymmetricMatrix,
};
use aplomb::mpu6050::{Config, LowPass, Part};
use aplomb::pipeline::Settings;
use aplomb::units::STANDARD_GRAVITY_M_S2;
use aplomb_recordings::flight_log;
use aplomb_recordings::form::Form;
use aplomb_recordings::log::Rows;
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::terminal::print_line;
use aplomb_recordings::units::RowOptions;

use crate::count_options::CountOptions;
use crate::i2c::I2cOptions;
use crate::progress;

use compass::CompassFound;
use gyroscope::{GyroscopeSummary, Turns};
use samples::{Sample, finest_config, read_bursts, read_rows, to_samples};

/// Length of a rest, s. The device wants a second, which a recording made by hand seldom has.
const REST_S: f64 = 0.5;
/// Length of a slow moment, s: three periods of a hand's tremor (about 10 Hz) average out.
const SLOW_S: f64 = 0.3;
/// Fewest rows of a slow moment.
const LEAST_ROWS: usize = 10;
/// Largest spread of a slow moment's rates (standard deviation of the worst axis), °/s.
const SLOW_SPREAD_DEGREES_S: f64 = 10.0;
/// Fewest slow moments: each is only nearly at rest.
const LEAST_SLOW_POSES: usize = 24;

/// Find the calibration of accelerometer, gyroscope and compass in a recording that shows the
/// sensor from many sides.
///
/// INPUT is a recording (t_us,ax,ay,az,gx,gy,gz[,…]; microseconds, m/s², rad/s, or counts with
/// --raw) or a bursts.csv, plain or gzipped. Lay the sensor on each of its six sides for two
/// seconds; a dozen poses, edges included, show the cross-axis terms too. The turns between them
/// then show the scale and the cross-axis terms of the gyroscope.
///
/// With the columns mx,my,mz (µT) the compass is calibrated too: turn the sensor slowly to and fro
/// about all axes for 30 s, each side down once, away from iron. One fit with the filter's
/// attitudes finds hard iron, soft iron and gains. It is refused if over a fifth of the directions
/// is missing, or if the readings contradict the motion.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb calibrate poses.csv
  aplomb calibrate counts.csv --raw --accel-range 2 --gyro-range 250 --json
  aplomb calibrate --draw-poses poses.png
  aplomb calibrate --i2c /dev/i2c-1 --json > calibration.json

JSON: rule (rest or slow), poses, offset_m_s2, matrix (what corrects: times reading less offset),
cross_axis_fitted, residual_before_g, residual_after_g, and held_out: fitted and held_out poses,
residual_before_g and residual_after_g of those held out; accelerometer_refused instead, if only
the compass was found. gyroscope (turns, matrix, residual_before_deg, residual_after_deg), or
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
    /// Age of the compass's readings against the samples of their rows, in microseconds
    #[arg(
        long,
        value_name = "N",
        default_value_t = 0,
        value_parser = clap::value_parser!(u32).range(..=1_000_000)
    )]
    compass_delay_us: u32,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Draw the poses to hold the sensor in into this PNG file
    #[arg(long, value_name = "OUT.png")]
    draw_poses: Option<PathBuf>,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
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
    let compass = compass::find(&recording, options.compass_delay_us)
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

/// Returns the results as JSON. At least one is there.
fn json(
    accelerometer: &Result<Found, String>,
    compass: Option<&Result<CompassFound, String>>,
) -> serde_json::Result<String> {
    serde_json::to_string(&Results {
        accelerometer: accelerometer.as_ref().ok().map(Found::summary),
        accelerometer_refused: accelerometer.as_ref().err(),
        compass: compass.and_then(|found| found.as_ref().ok()),
        compass_refused: compass.and_then(|found| found.as_ref().err()),
    })
}

/// Results in the form of the JSON.
#[derive(serde::Serialize)]
struct Results<'a> {
    #[serde(flatten)]
    accelerometer: Option<Summary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    accelerometer_refused: Option<&'a String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    compass: Option<&'a CompassFound>,
    #[serde(skip_serializing_if = "Option::is_none")]
    compass_refused: Option<&'a String>,
}

/// Recording as register counts.
struct Recording {
    settings: Settings,
    samples: Vec<Sample>,
}

impl Recording {
    fn read(path: &Path, options: &Options) -> Result<Self, Box<dyn Error>> {
        if flight_log::is_flight_log(path) {
            let name = path.display();
            return Err(format!(
                "{name}: it is a flight log. Make bursts of it, and calibrate from them with the \
                 --accel-range and --gyro-range that `convert` prints: aplomb convert {name} \
                 poses-bursts.csv"
            )
            .into());
        }
        let mut lines = progress::lines(path)?;
        let form = Form::read(&mut lines)?;
        options.counts.check(form, &options.rows)?;
        let mut config = options.counts.config();
        let samples = match form {
            Form::Bursts => read_bursts(&mut lines)?,
            Form::Log(columns) => {
                let is_raw = options.counts.raw;
                let rows = read_rows(Rows::new(lines, columns, options.rows, is_raw)?)?;
                if !is_raw {
                    config = finest_config(&rows)
                        .map_err(|reason| format!("{}: {reason}", path.display()))?;
                }
                to_samples(&rows, &config, is_raw)
                    .map_err(|(line, reason)| format!("{}:{line}: {reason}", path.display()))?
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
        Self { settings, samples }
    }

    /// Finds the calibration of the accelerometer, and of the gyroscope's scale. The error is the
    /// reason why there is none.
    fn accelerometer(&self, report: &mut String) -> Result<Found, String> {
        let rested = self.rests();
        let error = match accelerometer::fit(rested.collector.readings()) {
            Ok(fit) => {
                rested.describe(report);
                return Ok(Found {
                    rule: "rest",
                    poses: rested.collector.readings().to_vec(),
                    fit,
                    gyroscope: rested.turns.fit(&fit),
                });
            }
            Err(error) => error,
        };
        let slow = self.slow_moments();
        let why = rested.refusal(&error, self);
        let fit = slow.fit().map_err(|reason| format!("{why}; {reason}"))?;
        *report += &format!(
            "{why}\ninstead: {} slow moments of {SLOW_S} s with a gyroscope spread of at most \
             {SLOW_SPREAD_DEGREES_S} °/s, of {}\n",
            slow.poses.len(),
            slow.windows,
        );
        Ok(Found {
            rule: "slow",
            poses: slow.poses,
            fit,
            gyroscope: Err("slow moments are no reference for turns: lay it still".to_owned()),
        })
    }

    fn duration_s(&self) -> f64 {
        match (self.samples.first(), self.samples.last()) {
            (Some(first), Some(last)) => last.t_us.abs_diff(first.t_us) as f64 * 1e-6,
            _ => 0.0,
        }
    }

    fn rows_in(&self, seconds: f64) -> usize {
        let rate = self.samples.len() as f64 / self.duration_s().max(1e-6);
        ((rate * seconds) as usize).clamp(LEAST_ROWS, usize::from(u16::MAX))
    }

    /// Returns the rests by the device's rule.
    fn rests(&self) -> Rested {
        let rate_hz = self.samples.len() as f64 / self.duration_s().max(1e-6);
        let sensor = &self.settings.sensor;
        let noise = NoiseModel::new(&SensorSetup {
            gyroscope_counts_per_degree_s: sensor.gyroscope_range.counts_per_degree_s(),
            accelerometer_counts_per_g: sensor.accelerometer_range.counts_per_g(),
            // The log does not name its filter; the widest one has the most noise.
            gyroscope_bandwidth_hz: LowPass::Hertz256.gyroscope_bandwidth_hz().into(),
            accelerometer_bandwidth_hz: LowPass::Hertz256.accelerometer_bandwidth_hz().into(),
            sample_rate_hz: rate_hz as f32,
        });
        let rows = self.rows_in(REST_S) as u16;
        let mut detector = StationaryDetector::new(&noise, rows);
        let mut rested = Rested {
            collector: PoseCollector::new(&noise),
            turns: Turns::new(&noise),
            rests: 0,
            repeated: 0,
            refused: Vec::new(),
            moved: Vec::new(),
            taken: Vec::new(),
        };
        for sample in &self.samples {
            rested.turns.update(sample);
            let reading = ImuReading {
                gyroscope: sample.raw.gyroscope.0,
                accelerometer: sample.raw.accelerometer.0,
                temperature_celsius: sample.raw.temperature.to_celsius(self.settings.part),
            };
            match detector.update(&reading) {
                StationaryProgress::Collecting => {}
                StationaryProgress::Moved(reason) => count(&mut rested.moved, &reason.to_string()),
                StationaryProgress::Done(mean) => rested.take(sample.t_us, &mean),
            }
        }
        rested
    }

    /// Returns the moments in which the specific force is nearly gravity.
    fn slow_moments(&self) -> SlowMoments {
        let per_degree_s = f64::from(self.settings.sensor.gyroscope_range.counts_per_degree_s());
        let per_g = f64::from(self.settings.sensor.accelerometer_range.counts_per_g());
        let mut slow = SlowMoments {
            windows: 0,
            calmest_degrees_s: f64::INFINITY,
            poses: Vec::new(),
        };
        for window in self.samples.chunks_exact(self.rows_in(SLOW_S)) {
            slow.windows += 1;
            let [gyroscope, accelerometer] = [
                statistics(window.iter().map(|sample| sample.raw.gyroscope.0)),
                statistics(window.iter().map(|sample| sample.raw.accelerometer.0)),
            ];
            let spread = gyroscope.sigma.iter().copied().fold(0.0, f64::max) / per_degree_s;
            slow.calmest_degrees_s = slow.calmest_degrees_s.min(spread);
            let is_saturated = window.iter().any(|sample| {
                sample.raw.gyroscope.is_saturated() || sample.raw.accelerometer.is_saturated()
            });
            if spread <= SLOW_SPREAD_DEGREES_S && !is_saturated {
                let [x, y, z] = accelerometer.mean.map(|mean| (mean / per_g) as f32);
                slow.poses.push(Vector3::new(x, y, z));
            }
        }
        slow
    }
}

struct Statistics {
    mean: [f64; 3],
    sigma: [f64; 3],
}

fn statistics(counts: impl Iterator<Item = [i16; 3]> + Clone) -> Statistics {
    let number = counts.clone().count().max(1) as f64;
    let mean = [0, 1, 2].map(|axis| {
        counts
            .clone()
            .map(|counts| f64::from(counts[axis]))
            .sum::<f64>()
            / number
    });
    let sigma = [0, 1, 2].map(|axis| {
        let squares = counts
            .clone()
            .map(|counts| (f64::from(counts[axis]) - mean[axis]).powi(2));
        (squares.sum::<f64>() / number).sqrt()
    });
    Statistics { mean, sigma }
}

/// Rests by the device's rule.
struct Rested {
    collector: PoseCollector,
    turns: Turns,
    rests: usize,
    repeated: usize,
    refused: Vec<(String, usize)>,
    moved: Vec<(String, usize)>,
    taken: Vec<String>,
}

impl Rested {
    fn take(&mut self, t_us: i64, mean: &StationaryMean) {
        self.rests += 1;
        self.turns.finish(mean);
        match self.collector.add(mean) {
            Ok(accepted) => {
                let pose = accepted
                    .pose
                    .map_or_else(|| "between sides".to_owned(), |pose| pose.to_string());
                self.taken.push(format!(
                    "pose {} at {:.1} s: {pose}",
                    accepted.count,
                    t_us as f64 * 1e-6
                ));
            }
            Err(accelerometer::PoseError::Repeated { .. }) => self.repeated += 1,
            Err(reason) => count(&mut self.refused, &reason.to_string()),
        }
    }

    fn describe(&self, report: &mut String) {
        for line in &self.taken {
            *report += line;
            *report += "\n";
        }
        if self.repeated > 0 {
            *report += &format!("refused {} rests: a pose again\n", self.repeated);
        }
        for (reason, number) in &self.refused {
            *report += &format!("refused {number} rests: {reason}\n");
        }
        for (reason, number) in &self.moved {
            *report += &format!("not at rest {number} times: {reason}\n");
        }
    }

    /// Returns why the device's rule finds no calibration.
    fn refusal(&self, error: &FitError, recording: &Recording) -> String {
        if self.rests == 0 {
            let calmest = recording.slow_moments().calmest_degrees_s;
            let most = self.moved.iter().max_by_key(|(_, number)| *number);
            let most = most.map_or(String::new(), |(reason, number)| {
                format!(" ({reason}, {number} times)")
            });
            return format!(
                "too restless for the device's rule: it never rests for {REST_S} s; \
                 in the calmest {SLOW_S} s the gyroscope spreads by {calmest:.1} °/s{most}"
            );
        }
        let moved: usize = self.moved.iter().map(|(_, number)| number).sum();
        format!(
            "its {} rests of {REST_S} s are not enough: {error} \
             (moved {moved} times, a pose again {} times)",
            self.rests, self.repeated
        )
    }
}

/// Moments that are nearly at rest.
struct SlowMoments {
    windows: usize,
    calmest_degrees_s: f64,
    poses: Vec<Vector3>,
}

impl SlowMoments {
    fn fit(&self) -> Result<AccelerometerFit, String> {
        let which = format!(
            "its {} slow moments (gyroscope spread of at most {SLOW_SPREAD_DEGREES_S} °/s \
             for {SLOW_S} s) do not serve either",
            self.poses.len(),
        );
        if self.poses.len() < LEAST_SLOW_POSES {
            return Err(format!("{which}: {LEAST_SLOW_POSES} are needed"));
        }
        accelerometer::fit(&self.poses).map_err(|error| format!("{which}: {error}"))
    }
}

/// Calibration that was found.
struct Found {
    rule: &'static str,
    poses: Vec<Vector3>,
    fit: AccelerometerFit,
    gyroscope: Result<GyroscopeFit, String>,
}

/// Fit on every other pose, and its residual on the rest.
#[derive(serde::Serialize)]
struct HeldOut {
    fitted: usize,
    held_out: usize,
    #[serde(rename = "residual_before_g")]
    before_g: f32,
    #[serde(rename = "residual_after_g")]
    after_g: f32,
}

impl Found {
    fn held_out(&self) -> Option<HeldOut> {
        let half = |first: usize| -> Vec<Vector3> {
            self.poses.iter().skip(first).step_by(2).copied().collect()
        };
        let (fitted, held_out) = (half(0), half(1));
        let fit = accelerometer::fit(&fitted).ok()?;
        let correction = fit.correction;
        Some(HeldOut {
            fitted: fitted.len(),
            held_out: held_out.len(),
            before_g: rms(held_out.iter().map(|pose| pose.norm())),
            after_g: rms(held_out.iter().map(|pose| {
                let force = correction.apply(pose.scale(STANDARD_GRAVITY_M_S2));
                force.norm() / STANDARD_GRAVITY_M_S2
            })),
        })
    }

    fn describe(&self, report: &mut String) {
        let correction = &self.fit.correction;
        let offset = correction.offset_m_s2.scale(1000.0 / STANDARD_GRAVITY_M_S2);
        let SymmetricMatrix {
            xx,
            yy,
            zz,
            xy,
            xz,
            yz,
        } = correction.matrix;
        *report += &format!("{}\n", self.fit);
        *report += &format!(
            "offset {:+.1} {:+.1} {:+.1} mg, scale {xx:.4} {yy:.4} {zz:.4}, \
             cross-axis xy {xy:+.4} xz {xz:+.4} yz {yz:+.4}\n",
            offset.x, offset.y, offset.z,
        );
        match self.held_out() {
            Some(HeldOut {
                fitted,
                held_out,
                before_g,
                after_g,
            }) => {
                *report += &format!(
                    "held out: fitted on {fitted} poses, residual of the other {held_out}: \
                     {:.2} mg before, {:.2} mg after, {:.2} times better\n",
                    1000.0 * before_g,
                    1000.0 * after_g,
                    before_g / after_g,
                );
            }
            None => {
                *report += "held out: half of the poses are too few to fit\n";
            }
        }
        gyroscope::describe(&self.gyroscope, report);
    }

    fn summary(&self) -> Summary {
        let fit = &self.fit;
        let offset = fit.correction.offset_m_s2;
        let m = fit.correction.matrix;
        Summary {
            rule: self.rule,
            poses: fit.poses,
            offset_m_s2: [offset.x, offset.y, offset.z],
            matrix: [[m.xx, m.xy, m.xz], [m.xy, m.yy, m.yz], [m.xz, m.yz, m.zz]],
            cross_axis_fitted: fit.has_cross_axis,
            residual_before_g: fit.residual_before_g,
            residual_after_g: fit.residual_after_g,
            held_out: self.held_out(),
            gyroscope: self.gyroscope.as_ref().ok().map(GyroscopeSummary::of),
            gyroscope_refused: self.gyroscope.as_ref().err().cloned(),
        }
    }
}

/// Calibration in the form of the JSON.
#[derive(serde::Serialize)]
struct Summary {
    rule: &'static str,
    poses: usize,
    offset_m_s2: [f32; 3],
    matrix: [[f32; 3]; 3],
    cross_axis_fitted: bool,
    residual_before_g: f32,
    residual_after_g: f32,
    held_out: Option<HeldOut>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gyroscope: Option<GyroscopeSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gyroscope_refused: Option<String>,
}

fn rms(norms: impl Iterator<Item = f32>) -> f32 {
    let (mut sum, mut number) = (0.0, 0);
    for norm in norms {
        sum += (norm - 1.0) * (norm - 1.0);
        number += 1;
    }
    (sum / number.max(1) as f32).sqrt()
}

fn count(counts: &mut Vec<(String, usize)>, reason: &str) {
    match counts.iter_mut().find(|(known, _)| known == reason) {
        Some((_, number)) => *number += 1,
        None => counts.push((reason.to_owned(), 1)),
    }
}
