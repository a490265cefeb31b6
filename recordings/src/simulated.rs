//! Simulated sensor data: a motion, as an MPU-6050 with the default settings and an uncalibrated
//! gyroscope measures it at 1 kHz.

use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::{AccelerometerCounts, Burst, Config, GyroscopeCounts, RawSample};
use aplomb_models::motion::geometry::{Quaternion, scale};
use aplomb_models::motion::{self, Motion, Truth};
use aplomb_models::random::Random;
use aplomb_models::sensor::SensorErrors;
use aplomb_models::sensor::clock::TICKS_PER_SECOND;
use aplomb_models::sensor::errors::Poses;
use aplomb_models::sensor::identity::Identity;
use aplomb_models::sensor::signal_path::{Settings, SignalPath};

use crate::motion::truth_of;
use crate::number;

/// Configuration of the simulated sensor.
pub const CONFIG: Config = Config::DEFAULT;

/// Mount of the simulated sensor.
pub const MOUNT: motion::Mount = motion::Mount::Z_UP;

/// Zero-rate offset of the gyroscope, °/s; the seed decides its direction.
pub const BIAS_DEGREES_S: f64 = 4.0;

/// Header of a log of simulated samples.
pub const LOG_HEADER: &str = "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov";

/// Header of a log of simulated samples with a compass.
pub const COMPASS_LOG_HEADER: &str = "t_us,ax,ay,az,gx,gy,gz,mx,my,mz,qw,qx,qy,qz,mov";

const TICKS_PER_SAMPLE: u64 = 8;

/// Sample of the simulated sensor, with its truth.
#[derive(Clone, Copy, Debug)]
pub struct Simulated {
    /// Time, µs.
    pub t_us: u64,
    /// Register counts.
    pub raw: RawSample,
    /// Truth at this time.
    pub truth: Truth,
}

impl Simulated {
    /// Returns the burst of this sample. None before it is missing.
    pub fn burst(&self) -> Burst {
        Burst {
            bytes: self.raw.encode(),
            captured_at_us: self.t_us,
            missed_before: 0,
        }
    }

    /// Appends the sample as a row of a log with [`LOG_HEADER`].
    pub fn write_row(&self, line: &mut Vec<u8>) {
        self.write_measured(line);
        self.write_truth(line);
    }

    /// Appends the sample with a reading of the compass, if there is a new one, as a row of a log
    /// with [`COMPASS_LOG_HEADER`]. The reading is in µT and sensor axes.
    pub fn write_row_with_field(&self, line: &mut Vec<u8>, field_ut: Option<[f64; 3]>) {
        self.write_measured(line);
        match field_ut {
            Some([x, y, z]) => line.extend_from_slice(format!(",{x:.2},{y:.2},{z:.2}").as_bytes()),
            None => line.extend_from_slice(b",,,"),
        }
        self.write_truth(line);
    }

    fn write_measured(&self, line: &mut Vec<u8>) {
        let force = self.raw.accelerometer.to_m_s2(CONFIG.accelerometer_range);
        let rates = self.raw.gyroscope.to_rad_s(CONFIG.gyroscope_range);
        line.extend_from_slice(self.t_us.to_string().as_bytes());
        for value in [force.x, force.y, force.z, rates.x, rates.y, rates.z] {
            line.push(b',');
            number::append(line, value);
        }
    }

    fn write_truth(&self, line: &mut Vec<u8>) {
        let truth = match self.truth.attitude {
            Some(attitude) => {
                let Quaternion { w, x, y, z } = truth_of(attitude, MOUNT);
                format!(",{w},{x},{y},{z}")
            }
            None => ",,,,".to_owned(),
        };
        line.extend_from_slice(truth.as_bytes());
        line.extend_from_slice(if self.truth.scored { b",1\n" } else { b",0\n" });
    }
}

/// Simulates a motion for `seconds`, with a sensor that is not calibrated. The seed decides its
/// errors and its noise.
pub fn samples(
    motion: Box<dyn Motion>,
    seed: u64,
    seconds: u64,
) -> impl Iterator<Item = Simulated> {
    samples_with(
        motion,
        seed,
        errors(seed, AccelerometerKnowledge::Factory),
        seconds,
    )
}

/// Simulates a motion for `seconds`, with a sensor of these errors. The seed decides its noise.
pub fn samples_with(
    mut motion: Box<dyn Motion>,
    seed: u64,
    errors: SensorErrors,
    seconds: u64,
) -> impl Iterator<Item = Simulated> {
    let mut sensor = SignalPath::new(
        seed,
        MOUNT,
        errors,
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
                accelerometer: AccelerometerCounts(counts.accelerometer),
                gyroscope: GyroscopeCounts(counts.gyroscope),
                ..RawSample::default()
            },
            truth,
        })
    })
}

/// Returns the errors of the sensor of this seed, calibrated in the poses of this knowledge. Its
/// gyroscope has an offset of [`BIAS_DEGREES_S`].
pub fn errors(seed: u64, accelerometer: AccelerometerKnowledge) -> SensorErrors {
    let mut random = Random::new(seed, "uncalibrated gyroscope");
    let direction = [0; 3].map(|_| random.normal());
    let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
    let mut errors = SensorErrors::typical(seed);
    errors.gyroscope.offset = scale(direction, BIAS_DEGREES_S.to_radians() / length);
    match accelerometer {
        AccelerometerKnowledge::Factory => errors,
        AccelerometerKnowledge::SixPoses => errors.calibrated_in(Poses::Six),
        AccelerometerKnowledge::Calibrated => errors.calibrated_in(Poses::Twelve),
    }
}
