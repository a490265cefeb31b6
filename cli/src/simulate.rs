//! `aplomb simulate`: a simulated motion with its truth, as a recording.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb_models::motion::Motion;
use aplomb_models::motion::geometry::Quaternion;
use aplomb_models::motion::poses::Poses;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::Swing;
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::simulated::{LOG_HEADER, errors, samples_with};
use aplomb_recordings::terminal::print_line;

use crate::progress;
use aplomb_recordings::units::knowledge;

/// Seed without `--seed`. The filter was tuned on smaller seeds.
const SEED: u64 = 1_000;

/// Length without `--seconds`, s.
const SECONDS: u64 = 60;

/// Time in each pose, s.
const POSE_S: f64 = 3.0;

/// Kinds of motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// A quadrotor with vibration and wind, on a course of manoeuvres
    Flight,
    /// Rest for 3 s, then a swing to and fro
    Swing,
    /// Rest on a level table
    Rest,
    /// Three seconds on each of the six sides, then in six poses between them
    Poses,
}

impl Kind {
    /// Returns the motion of this seed.
    pub fn motion(self, seed: u64) -> Box<dyn Motion> {
        match self {
            Self::Flight => Box::new(Quadrotor::by_seed(seed)),
            Self::Swing => Box::new(Swing::by_seed(seed, 3.0)),
            Self::Rest => Box::new(Rest::level()),
            Self::Poses => {
                let degrees = [
                    [180.0, 0.0],
                    [90.0, 0.0],
                    [-90.0, 0.0],
                    [0.0, 90.0],
                    [0.0, -90.0],
                    [45.0, 0.0],
                    [-45.0, 0.0],
                    [0.0, 45.0],
                    [0.0, -45.0],
                    [135.0, 20.0],
                    [-135.0, -20.0],
                ];
                let poses = degrees.iter().zip(1..).map(|([roll, pitch], nth)| {
                    let [roll, pitch] = [roll, pitch].map(|angle: &f64| angle.to_radians());
                    (
                        f64::from(nth) * POSE_S,
                        Quaternion::from_euler(roll, pitch, 0.0),
                    )
                });
                Box::new(Poses::new(&poses.collect::<Vec<_>>()))
            }
        }
    }
}

/// Write a simulated motion with its truth as a recording.
///
/// The sensor has the errors of a typical one: noise, and a gyroscope offset of 4 degrees per
/// second, and an accelerometer that is not calibrated, or as --accelerometer states. It lies face
/// up, X forward. One seed is one motion, to the last bit. The log has 1000 rows a second
/// (t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov; microseconds, m/s², rad/s; truth sensor to earth with
/// z up; mov 1 where rows count), as `replay`, `plot`, `aplomb-bench` and `cargo xtask fly --log`
/// read it. Samples are 1900 microseconds late, as a real sensor's are: --sensor-delay-us 1900.
/// Give `replay` and `plot` the same --accelerometer.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb simulate --seed 7 --output flight.csv.gz
  aplomb replay flight.csv.gz --sensor-delay-us 1900 --accelerometer factory
  aplomb simulate --kind poses --seconds 36 --output poses.csv && aplomb calibrate poses.csv")]
pub struct Options {
    /// Motion
    #[arg(long, value_enum, default_value_t = Kind::Flight)]
    kind: Kind,
    /// Seed of the motion and of the sensor
    #[arg(long, value_name = "N", default_value_t = SEED)]
    seed: u64,
    /// Duration
    #[arg(
        long,
        value_name = "S",
        default_value_t = SECONDS,
        value_parser = clap::value_parser!(u64).range(1..=86_400)
    )]
    seconds: u64,
    /// Calibration of the simulated accelerometer: factory, six-poses, calibrated
    #[arg(long, value_name = "KNOWLEDGE", default_value = "factory", value_parser = knowledge)]
    accelerometer: AccelerometerKnowledge,
    /// The log to write; zipped if its name ends with .gz
    #[arg(long, value_name = "OUT.csv[.gz]")]
    output: PathBuf,
}

/// Writes the log.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let mut file = OutputFile::create(&options.output, &[])?;
    let rows = options.seconds * 1_000;
    let bar = progress::bar("simulating", rows);
    let mut line = format!("{LOG_HEADER}\n").into_bytes();
    let motion = options.kind.motion(options.seed);
    let errors = errors(options.seed, options.accelerometer);
    for sample in samples_with(motion, options.seed, errors, options.seconds) {
        file.write_all(&line).map_err(|error| file.failed(&error))?;
        line.clear();
        sample.write_row(&mut line);
        bar.inc(1);
    }
    file.write_all(&line).map_err(|error| file.failed(&error))?;
    bar.finish_and_clear();
    file.finish()?;
    print_line(&format!(
        "{}: {rows} rows, {}.0 s, seed {}",
        options.output.display(),
        options.seconds,
        options.seed
    ));
    Ok(())
}
