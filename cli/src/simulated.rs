//! Simulated motions, for when no recordings are at hand, seen by an MPU-6050 whose gyroscope nobody calibrated; and
//! `aplomb simulate`, which writes them.
//!
//! Filters are tuned on flights with seeds below [`FIRST_EVALUATION_SEED`], and judged on those from there on.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use aplomb::calibration::Mount;
use aplomb::estimator::Sample;
use aplomb::mpu6050::{Config, LowPass, RawSample};
use aplomb_models::motion::geometry::{Quaternion, scale};
use aplomb_models::motion::poses::Poses;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::Swing;
use aplomb_models::motion::{self, Motion, Truth};
use aplomb_models::random::Random;
use aplomb_models::sensor::SensorErrors;
use aplomb_models::sensor::clock::TICKS_PER_SECOND;
use aplomb_models::sensor::identity::Identity;
use aplomb_models::sensor::signal_path::{Settings, SignalPath};
use aplomb_recordings::motion::truth_of;

use crate::output::OutputFile;
use crate::recording::{Recording, Reference};
use crate::{number, parallel};

/// Seeds from here on are for judging; smaller ones are for tuning.
pub const FIRST_EVALUATION_SEED: u64 = 1_000;

/// What filters are tuned on.
pub const TUNING_SEEDS: std::ops::Range<u64> = 1..13;
/// What they are judged on.
pub const EVALUATION_SEEDS: std::ops::Range<u64> = FIRST_EVALUATION_SEED..FIRST_EVALUATION_SEED + 8;

// What is tuned on is not judged on.
const _: () = assert!(TUNING_SEEDS.end <= FIRST_EVALUATION_SEED);

/// The gyroscope's zero-rate offset in °/s, in a direction by the seed.
const BIAS_DEGREES_S: f64 = 4.0;
const SECONDS: u64 = 60;
const TICKS_PER_SAMPLE: u64 = 8;
const CONFIG: Config = Config::DEFAULT;
const MOUNT: motion::Mount = motion::Mount::Z_UP;

/// The flights of these seeds.
pub fn flights(seeds: std::ops::Range<u64>) -> Vec<Recording> {
    let seeds: Vec<u64> = seeds.collect();
    parallel::map_with_bar("simulating", &seeds, |seed| flight(*seed))
}

/// What moves.
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

/// The time in each pose, s.
const POSE_S: f64 = 3.0;

impl Kind {
    fn motion(self, seed: u64) -> Box<dyn Motion> {
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

/// What the sensor says at one time, and what is true.
struct Simulated {
    t_us: u64,
    raw: RawSample,
    truth: Truth,
}

/// A motion as the default settings of the sensor record it at 1 kHz, counts as they would be read.
fn samples(kind: Kind, seed: u64, seconds: u64) -> impl Iterator<Item = Simulated> {
    let mut motion = kind.motion(seed);
    let mut sensor = SignalPath::new(
        seed,
        MOUNT,
        errors(seed),
        Identity::of(0x68),
        Settings {
            gyroscope_range: CONFIG.gyroscope_range.bits(),
            accelerometer_range: CONFIG.accelerometer_range.bits(),
            gyroscope_filter: CONFIG.low_pass.bits(),
            accelerometer_filter: CONFIG.low_pass.bits(),
            gyroscope_self_test: [false; 3],
            accelerometer_self_test: [false; 3],
        },
    );
    (1..=seconds * TICKS_PER_SECOND as u64).filter_map(move |tick| {
        let time_s = tick as f64 / TICKS_PER_SECOND;
        let truth = motion.at(time_s);
        let is_due = tick.is_multiple_of(TICKS_PER_SAMPLE);
        sensor.convert(&truth, time_s, is_due);
        let counts = is_due.then(|| sensor.counts())?;
        Some(Simulated {
            t_us: tick * 1_000_000 / TICKS_PER_SECOND as u64,
            raw: RawSample {
                accelerometer: aplomb::mpu6050::AccelerometerCounts(counts.accelerometer),
                gyroscope: aplomb::mpu6050::GyroscopeCounts(counts.gyroscope),
                ..RawSample::default()
            },
            truth,
        })
    })
}

/// The flight of this seed.
pub fn flight(seed: u64) -> Recording {
    flight_for(seed, SECONDS)
}

/// The same for so many seconds.
pub fn flight_for(seed: u64, seconds: u64) -> Recording {
    let mut recording = Recording {
        set: "simulated".to_owned(),
        name: format!("flight {seed}"),
        delay_us: u32::from(LowPass::gyroscope_delay_us(CONFIG.low_pass)),
        reference: Reference::Truth,
        samples: Vec::new(),
        true_up: Vec::new(),
    };
    for Simulated { t_us, raw, truth } in samples(Kind::Flight, seed, seconds) {
        recording.samples.push(Sample {
            t_us,
            specific_force_m_s2: Mount::Z_UP
                .to_body(raw.accelerometer.to_m_s2(CONFIG.accelerometer_range)),
            angular_rate_rad_s: Mount::Z_UP.to_body(raw.gyroscope.to_rad_s(CONFIG.gyroscope_range)),
            is_rate_saturated: raw.gyroscope.is_saturated(),
            is_force_saturated: raw.accelerometer.is_saturated(),
        });
        recording
            .true_up
            .push(truth.attitude.filter(|_| truth.scored).map(up_in_body));
    }
    recording
}

/// Write a simulated motion with its truth as a log.
///
/// The sensor has the errors of a typical one (noise, a gyroscope offset of 4 degrees per second, which nobody calibrated) and lies
/// face up, X forward. One seed is one motion, to the last bit. The log has 1000 rows a second
/// (t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov; microseconds, m/s², rad/s; truth sensor to earth with z up; mov 1 where rows count), as `replay`,
/// `plot`, `bench` and `cargo xtask fly --log` read it. Samples are 1900 microseconds late, as a real sensor's are: --sensor-delay-us 1900.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb simulate --seed 7 --output flight.csv.gz
  aplomb replay flight.csv.gz --sensor-delay-us 1900
  aplomb simulate --kind poses --seconds 36 --output poses.csv && aplomb calibrate poses.csv")]
pub struct Options {
    /// Which motion
    #[arg(long, value_enum, default_value_t = Kind::Flight)]
    kind: Kind,
    /// Which of them, and which sensor
    #[arg(long, value_name = "N", default_value_t = FIRST_EVALUATION_SEED)]
    seed: u64,
    /// How long
    #[arg(long, value_name = "S", default_value_t = SECONDS, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: u64,
    /// The log to write; zipped if its name ends with .gz
    #[arg(long, value_name = "OUT.csv[.gz]")]
    output: PathBuf,
}

/// Writes a log.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let mut file = OutputFile::create(&options.output, &[])?;
    let rows = options.seconds * 1_000;
    let bar = parallel::bar("simulating", rows);
    let mut line = Vec::from("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov\n");
    for sample in samples(options.kind, options.seed, options.seconds) {
        file.write_all(&line).map_err(|error| file.failed(&error))?;
        line.clear();
        sample.write(&mut line)?;
        bar.inc(1);
    }
    file.write_all(&line).map_err(|error| file.failed(&error))?;
    bar.finish_and_clear();
    file.finish()?;
    crate::say(&format!(
        "{}: {rows} rows, {}.0 s, seed {}",
        options.output.display(),
        options.seconds,
        options.seed
    ));
    Ok(())
}

impl Simulated {
    /// As a row of a log.
    fn write(&self, line: &mut Vec<u8>) -> std::io::Result<()> {
        let force = self.raw.accelerometer.to_m_s2(CONFIG.accelerometer_range);
        let rates = self.raw.gyroscope.to_rad_s(CONFIG.gyroscope_range);
        write!(line, "{}", self.t_us)?;
        for value in [force.x, force.y, force.z, rates.x, rates.y, rates.z] {
            line.push(b',');
            number::append(line, value);
        }
        match self.truth.attitude {
            Some(attitude) => {
                let Quaternion { w, x, y, z } = truth_of(attitude, MOUNT);
                write!(line, ",{w},{x},{y},{z}")?;
            }
            None => line.extend_from_slice(b",,,,"),
        }
        writeln!(line, ",{}", u8::from(self.truth.scored))
    }
}

fn errors(seed: u64) -> SensorErrors {
    let mut random = Random::new(seed, "uncalibrated gyroscope");
    let direction = [0; 3].map(|_| random.normal());
    let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
    let mut errors = SensorErrors::typical(seed);
    errors.gyroscope.offset = scale(direction, BIAS_DEGREES_S.to_radians() / length);
    errors
}

fn up_in_body(body_to_earth: Quaternion) -> [f64; 3] {
    motion::truth::up_in_body(body_to_earth)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_has_the_bias_the_motion_and_the_truth() {
        let recording = flight(FIRST_EVALUATION_SEED);
        assert_eq!(recording.samples.len(), 60_000);
        assert_eq!(recording.true_up.len(), 60_000);
        // At rest on the ground the gyroscope shows its offset, and nothing counts.
        let at_rest = recording.samples[1_500].angular_rate_rad_s.norm();
        let at_rest = f64::from(at_rest).to_degrees();
        // Gravity and warmth add to it.
        assert!((at_rest - BIAS_DEGREES_S).abs() < 1.0, "{at_rest}");
        assert_eq!(recording.true_up[1_500], None);
        let scored = recording.true_up.iter().flatten().count();
        assert!(scored > 50_000, "{scored}");
        let fastest = recording
            .samples
            .iter()
            .map(|sample| sample.angular_rate_rad_s.norm())
            .fold(0.0, f32::max);
        assert!(fastest > 1.0, "{fastest} rad/s");
        assert_ne!(recording.samples[30_000], flight(7).samples[30_000]);
    }
}
