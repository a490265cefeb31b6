//! `aplomb simulate`: a simulated motion with its truth, as a recording.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb_models::compass::{EarthField, Magnetism, PassingMagnet};
use aplomb_models::motion::Motion;
use aplomb_models::motion::poses::Poses;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::Swing;
use aplomb_recordings::log::ACCELEROMETER_COMMENT;
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::simulated::{COMPASS_LOG_HEADER, LOG_HEADER, errors, samples_with};
use aplomb_recordings::simulated_compass::{COMPASS_DELAY_US, SimulatedCompass};
use aplomb_recordings::terminal::print_line;

use crate::progress;
use crate::read_options::compass_knowledge;
use crate::usage::Usage;
use aplomb_recordings::units::{knowledge, knowledge_name};

/// Seed without `--seed`. The filter was tuned on smaller seeds.
const SEED: u64 = 1_000;

/// Length without `--seconds`, s.
const SECONDS: u64 = 60;

/// Time in each pose, s.
const POSE_S: f64 = 3.0;

/// Field of the motors' currents in a hover, µT: a compass some 10 cm from the power leads.
const MOTORS_UT: f64 = 3.0;

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
            Self::Poses => Box::new(Poses::twelve(POSE_S)),
        }
    }
}

/// Write a simulated motion with its truth as a recording.
///
/// The sensor has the errors of a typical one: noise, a gyroscope offset of 4 degrees per second,
/// and scales and an accelerometer offset that are not calibrated, or as --accelerometer states. It
/// lies face up, X forward. One seed is one motion, to the last bit. The recording has 1000 rows a
/// second (t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov; microseconds, m/s², rad/s; truth sensor to
/// earth with z up; mov 1 where rows count), as `replay`, `plot`, `aplomb-bench` and `cargo xtask
/// fly --log` read it. Its first line, such as `# --accelerometer factory`, states the knowledge
/// for them. Samples are 1900 microseconds late, as a real sensor's are: give `replay` and `plot`
/// --sensor-delay-us 1900.
///
/// With --compass it also has the columns mx,my,mz (µT, empty where there is no new reading;
/// 100 readings a second). The field is the earth's, with hard and soft iron, the motors'
/// currents, noise and lag. Magnetic north is the truth's y.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb simulate --seed 7 --output flight.csv.gz
  aplomb replay flight.csv.gz --sensor-delay-us 1900
  aplomb simulate --kind poses --seconds 36 --output poses.csv && aplomb calibrate poses.csv
  aplomb simulate --compass calibrated --magnet 30 --output magnet.csv
  aplomb replay magnet.csv --compass calibrated --compass-delay-us 2100 \\
    --sensor-delay-us 1900")]
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
    /// Calibration of the simulated sensor: factory, six-poses, calibrated (twelve poses, whose
    /// turns calibrate the gyroscope's scale too)
    #[arg(long, value_name = "KNOWLEDGE", default_value = "factory", value_parser = knowledge)]
    accelerometer: AccelerometerKnowledge,
    /// Add a compass: factory (hard iron of some 20 µT per axis, gains that differ by some 10 %),
    /// hard-iron (some 4 µT and 10 % are left) or calibrated (0.5 µT and 1 % are left)
    #[arg(long, value_name = "KNOWLEDGE", value_parser = compass_knowledge)]
    compass: Option<CompassKnowledge>,
    /// Place on earth, which decides the field: berlin, oslo, denver, singapore, rio, sydney
    /// [default: berlin]
    #[arg(long, value_name = "NAME", requires = "compass", value_parser = place)]
    place: Option<EarthField>,
    /// A magnet passes by, closest at this time
    #[arg(
        long,
        value_name = "S",
        requires = "compass",
        value_parser = clap::value_parser!(u64).range(..=86_400)
    )]
    magnet: Option<u64>,
    /// The recording to write; zipped if its name ends with .gz
    #[arg(long, value_name = "OUT.csv[.gz]")]
    output: PathBuf,
}

/// Parses the name of a place.
fn place(name: &str) -> Result<EarthField, String> {
    EarthField::of(name).ok_or_else(|| {
        let names = EarthField::PLACES.map(|(name, _)| name);
        format!("choose one of {}", names.join(", "))
    })
}

impl Options {
    /// Returns the field at the compass, if there is one.
    fn magnetism(&self) -> Option<Magnetism> {
        let magnetism = match self.compass? {
            CompassKnowledge::Factory => Magnetism::typical(self.seed),
            CompassKnowledge::HardIron => Magnetism::without_most_hard_iron(self.seed),
            CompassKnowledge::Calibrated => Magnetism::calibrated(self.seed),
        };
        let closest_s = self.magnet.map(|seconds| seconds as f64);
        Some(Magnetism {
            earth: self.place.unwrap_or_default(),
            magnet: closest_s.map(|closest_s| PassingMagnet::passing(self.seed, closest_s)),
            ..magnetism.with_motors(self.seed, MOTORS_UT)
        })
    }
}

/// Describes a simulated compass.
fn describe(magnetism: &Magnetism) -> String {
    let EarthField {
        strength_ut,
        dip_deg,
        ..
    } = magnetism.earth;
    let [x, y, z] = magnetism.hard_iron_ut;
    format!(
        "compass: field {strength_ut} µT, dip {dip_deg}°, hard iron {x:.1},{y:.1},{z:.1} µT in \
         body axes, motors {MOTORS_UT} µT in a hover; --compass-delay-us {COMPASS_DELAY_US}"
    )
}

/// Writes the recording.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    if let Some(closest_s) = options.magnet.filter(|at_s| *at_s > options.seconds) {
        let reason = format!(
            "--magnet {closest_s} is after the end: the recording takes {} s (--seconds)",
            options.seconds
        );
        return Err(Usage::from(reason).into());
    }
    let mut file = OutputFile::create(&options.output, &[])?;
    let rows = options.seconds * 1_000;
    let bar = progress::bar("simulating", rows);
    let magnetism = options.magnetism();
    let compass = magnetism.clone();
    let mut compass = compass.map(|magnetism| SimulatedCompass::new(options.seed, magnetism));
    let header = match compass {
        Some(_) => COMPASS_LOG_HEADER,
        None => LOG_HEADER,
    };
    let knowledge = knowledge_name(options.accelerometer);
    let mut line = format!("{ACCELEROMETER_COMMENT}{knowledge}\n{header}\n").into_bytes();
    let motion = options.kind.motion(options.seed);
    let errors = errors(options.seed, options.accelerometer);
    for sample in samples_with(motion, options.seed, errors, options.seconds) {
        file.write_all(&line).map_err(|error| file.failed(&error))?;
        line.clear();
        match &mut compass {
            Some(compass) => {
                let field_ut = compass.read(sample.t_us, &sample.truth);
                sample.write_row_with_field(&mut line, field_ut);
            }
            None => sample.write_row(&mut line),
        }
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
    if let Some(magnetism) = &magnetism {
        print_line(&describe(magnetism));
    }
    Ok(())
}
