//! Simulated flights, for when no recordings are at hand: a quadrotor with vibration and wind, and an MPU-6050 whose
//! gyroscope nobody calibrated.
//!
//! Filters are tuned on flights with seeds below [`FIRST_EVALUATION_SEED`], and judged on those from there on.

use aplomb::calibration::Mount;
use aplomb::estimator::Sample;
use aplomb::mpu6050::{Config, LowPass, RawSample};
use virtual_board::motion::Motion;
use virtual_board::motion::geometry::{Quaternion, scale};
use virtual_board::motion::quadrotor::Quadrotor;
use virtual_board::random::Random;
use virtual_board::sensor::SensorErrors;
use virtual_board::sensor::clock::TICKS_PER_SECOND;
use virtual_board::sensor::identity::Identity;
use virtual_board::sensor::signal_path::{Settings, SignalPath};

use crate::parallel;
use crate::recording::{Recording, Reference};

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

/// The flights of these seeds.
pub fn flights(seeds: std::ops::Range<u64>) -> Vec<Recording> {
    let seeds: Vec<u64> = seeds.collect();
    parallel::map_with_bar("simulating", &seeds, |seed| flight(*seed))
}

/// The flight of this seed, as the default settings of the sensor record it at 1 kHz, counts as they would be read.
pub fn flight(seed: u64) -> Recording {
    let mut motion = Quadrotor::by_seed(seed);
    let mut sensor = SignalPath::new(
        seed,
        virtual_board::motion::Mount::Z_UP,
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
    let mut recording = Recording {
        set: "simulated".to_owned(),
        name: format!("flight {seed}"),
        delay_us: u32::from(LowPass::gyroscope_delay_us(CONFIG.low_pass)),
        reference: Reference::Truth,
        samples: Vec::new(),
        true_up: Vec::new(),
    };
    for tick in 1..=SECONDS * TICKS_PER_SECOND as u64 {
        let time_s = tick as f64 / TICKS_PER_SECOND;
        let truth = motion.at(time_s);
        let is_due = tick.is_multiple_of(TICKS_PER_SAMPLE);
        sensor.convert(&truth, time_s, is_due);
        if is_due {
            let counts = sensor.counts();
            let raw = RawSample {
                accelerometer: aplomb::mpu6050::AccelerometerCounts(counts.accelerometer),
                gyroscope: aplomb::mpu6050::GyroscopeCounts(counts.gyroscope),
                ..RawSample::default()
            };
            recording.samples.push(Sample {
                t_us: tick * 1_000_000 / TICKS_PER_SECOND as u64,
                specific_force_m_s2: Mount::Z_UP
                    .to_body(raw.accelerometer.to_m_s2(CONFIG.accelerometer_range)),
                angular_rate_rad_s: Mount::Z_UP
                    .to_body(raw.gyroscope.to_rad_s(CONFIG.gyroscope_range)),
                is_rate_saturated: raw.gyroscope.is_saturated(),
                is_force_saturated: raw.accelerometer.is_saturated(),
            });
            recording
                .true_up
                .push(truth.attitude.filter(|_| truth.scored).map(up_in_body));
        }
    }
    recording
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
    virtual_board::motion::truth::up_in_body(body_to_earth)
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
