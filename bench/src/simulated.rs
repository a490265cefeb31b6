//! Simulated flights as recordings, for computers without recordings.
//!
//! Filters are tuned on flights with seeds below [`FIRST_EVALUATION_SEED`], and judged on those
//! from there on.

use std::ops::Range;

use aplomb::calibration::Mount;
use aplomb::estimator::Sample;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::LowPass;
use aplomb_models::compass::Magnetism;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::truth::up_in_body;
use aplomb_models::sensor::SensorErrors;
use aplomb_recordings::motion::truth_of;
use aplomb_recordings::simulated::{CONFIG, MOUNT, Simulated, errors, samples_with};
use aplomb_recordings::simulated_compass::{COMPASS_DELAY_US, SimulatedCompass};

use crate::compass::Compass;
use crate::parallel;
use crate::recording::{Recording, Reference};

/// First seed of flights for judging. Smaller seeds are for tuning.
pub const FIRST_EVALUATION_SEED: u64 = 1_000;

/// Seeds of the flights that filters are tuned on.
pub const TUNING_SEEDS: Range<u64> = 1..13;

/// Seeds of the flights that filters are judged on.
pub const EVALUATION_SEEDS: Range<u64> = FIRST_EVALUATION_SEED..FIRST_EVALUATION_SEED + 24;

// Filters are not judged on the flights that they were tuned on.
const _: () = assert!(TUNING_SEEDS.end <= FIRST_EVALUATION_SEED);

/// Length of a flight, s.
const SECONDS: u64 = 60;

/// Simulates the flights of these seeds, with sensors calibrated in the poses of this knowledge.
pub fn flights(seeds: Range<u64>, accelerometer: AccelerometerKnowledge) -> Vec<Recording> {
    let seeds: Vec<u64> = seeds.collect();
    parallel::map_with_bar("simulating", &seeds, |seed| {
        flight_with(*seed, SECONDS, accelerometer)
    })
}

/// Simulates the flight of this seed.
pub fn flight(seed: u64) -> Recording {
    flight_for(seed, SECONDS)
}

/// Simulates the flight of this seed for `seconds`.
pub fn flight_for(seed: u64, seconds: u64) -> Recording {
    flight_with(seed, seconds, AccelerometerKnowledge::Factory)
}

fn flight_with(seed: u64, seconds: u64, accelerometer: AccelerometerKnowledge) -> Recording {
    let motion = Box::new(Quadrotor::by_seed(seed));
    let flown = samples_with(motion, seed, errors(seed, accelerometer), seconds);
    Recording {
        accelerometer,
        ..recording("simulated", format!("flight {seed}"), flown)
    }
}

/// Simulates the flight of this seed with a compass in this field, of which this is known. The
/// sensor has these errors.
pub fn flight_with_compass(
    seed: u64,
    errors: SensorErrors,
    magnetism: Magnetism,
    knowledge: CompassKnowledge,
) -> Recording {
    let motion = Box::new(Quadrotor::by_seed(seed));
    let mut chip = SimulatedCompass::new(seed, magnetism);
    let mut compass = Compass {
        mount: Mount::Z_UP,
        delay_us: COMPASS_DELAY_US,
        knowledge,
        ..Compass::default()
    };
    let flown = samples_with(motion, seed, errors, SECONDS).inspect(|simulated| {
        let truth = simulated.truth;
        let field_ut = chip.read(simulated.t_us, &truth);
        let attitude = truth.attitude.filter(|_| truth.scored);
        compass.add_reading(field_ut, attitude.map(|attitude| truth_of(attitude, MOUNT)));
    });
    let recording = recording("simulated", format!("flight {seed}"), flown);
    Recording {
        compass: Some(compass),
        ..recording
    }
}

/// Returns the recording of a simulated sensor.
pub fn recording(set: &str, name: String, samples: impl Iterator<Item = Simulated>) -> Recording {
    let mut recording = Recording {
        set: set.to_owned(),
        name,
        delay_us: u32::from(LowPass::gyroscope_delay_us(CONFIG.low_pass)),
        reference: Reference::Truth,
        accelerometer: AccelerometerKnowledge::Factory,
        samples: Vec::new(),
        known_up: Vec::new(),
        true_up: Vec::new(),
        compass: None,
        clipping: None,
    };
    for simulated in samples {
        let (raw, truth) = (simulated.raw, simulated.truth);
        let force = raw.accelerometer.to_m_s2(CONFIG.accelerometer_range);
        let rates = raw.gyroscope.to_rad_s(CONFIG.gyroscope_range);
        let mount = Mount::Z_UP;
        let mut sample = Sample::new(simulated.t_us, mount.to_body(force), mount.to_body(rates));
        sample.is_rate_saturated = raw.gyroscope.is_saturated();
        sample.is_force_saturated = raw.accelerometer.is_saturated();
        recording.samples.push(sample);
        let up = truth.attitude.map(up_in_body);
        recording.known_up.push(up);
        recording.true_up.push(up.filter(|_| truth.scored));
    }
    recording
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb_recordings::simulated::BIAS_DEGREES_S;

    #[test]
    fn a_flight_has_the_bias_the_motion_and_the_truth() {
        let recording = flight(FIRST_EVALUATION_SEED);
        assert_eq!(recording.samples.len(), 60_000);
        assert_eq!(recording.true_up.len(), 60_000);
        // At rest on the ground the gyroscope shows its offset, and no row counts.
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
