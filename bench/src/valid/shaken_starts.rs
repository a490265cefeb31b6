//! Starts in vibration, after a power cut or a pause in flight: one sample's specific force then
//! does not show where down is. The attitude must not be `VALID` and wrong.

use aplomb::attitude::BodyVector;
use aplomb::calibration::GyroscopeOffset;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::units::STANDARD_GRAVITY_M_S2;
use aplomb_models::motion::Motion;
use aplomb_models::motion::quadrotor::{Flight, Quadrotor, REST_S};
use aplomb_models::motion::route::Route;
use aplomb_models::motion::vibration::{Strength, Vibrating};
use aplomb_models::random::Random;
use aplomb_models::sensor::SensorErrors;
use aplomb_recordings::simulated::samples_with;

use super::{Allowed, Judged, seeds};
use crate::parallel;
use crate::recording::Recording;
use crate::simulated::recording;

/// Length of a flight, s, and of the time after a start that counts, µs.
const SECONDS: u64 = 20;
const JUDGED_US: u64 = 8_000_000;
/// Times between which a start happens: the vehicle has taken off, and the vibration has grown.
const STARTS_S: [f64; 2] = [4.5, 11.5];
/// Lengths of a pause that hides the tilt, s.
const PAUSES_S: [f64; 2] = [0.3, 2.0];
/// Strength, g root mean square on each axis, and frequency, Hz, of the vibration.
const STRENGTHS_G: [f64; 2] = [0.7, 5.0];
const FREQUENCIES_HZ: [f64; 2] = [50.0, 250.0];
/// Time after a start with a known offset in which most attitudes have to be `VALID`, µs, and
/// their share.
const VALID_WITHIN_US: u64 = 300_000;
const LEAST_VALID_SHARE: f64 = 0.95;

/// Knowledge at a start.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Start {
    /// The gyroscope's offset is stored.
    Stored,
    /// Nothing.
    Unknown,
    /// The filter has run since before the take-off. No sample arrives for a time before the start.
    Pause,
}

#[derive(Default)]
struct Outcome {
    is_wrong: bool,
    is_valid_in_time: bool,
    allowed: Allowed,
}

/// Flies, and judges the time after the start.
fn fly(start: Start, seed: u64) -> Outcome {
    let mut random = Random::new(seed, "shaken starts");
    let flight = shaken(seed, &mut random);
    let from_us = (random.uniform(STARTS_S[0], STARTS_S[1]) * 1.0e6) as u64;
    let pause_us = (random.uniform(PAUSES_S[0], PAUSES_S[1]) * 1.0e6) as u64;
    let mut settings = Settings::new(&Part::MPU_6050);
    if start == Start::Stored {
        settings.calibration.gyroscope = Some(GyroscopeOffset {
            offset_rad_s: settings.mount.to_sensor(BodyVector::ZERO),
            temperature_celsius: 25.0,
        });
    }
    let mut pipeline = Pipeline::new(&settings);
    let mut outcome = Outcome::default();
    for (sample, up) in flight.samples.iter().zip(&flight.true_up) {
        let since_us = sample.t_us.checked_sub(from_us);
        let is_read = start == Start::Pause && sample.t_us + pause_us < from_us;
        if since_us.is_none() && !is_read {
            continue;
        }
        let snapshot = pipeline.update_sample(sample);
        let (Some(since_us), Some(up)) = (since_us, *up) else {
            continue;
        };
        if since_us > JUDGED_US {
            break;
        }
        let judged = Judged::new(&snapshot, up);
        outcome.is_wrong |= judged.is_wrong;
        outcome.allowed.add(&judged);
        outcome.is_valid_in_time |= judged.is_valid && since_us < VALID_WITHIN_US;
    }
    outcome
}

/// Simulates a flight or a hover in vibration. The gyroscope has no offset.
fn shaken(seed: u64, random: &mut Random) -> Recording {
    let mut flight = Flight::by_seed(seed);
    if random.uniform(0.0, 1.0) < 0.5 {
        flight.route = Route::hover();
    }
    let strength_g = random.uniform(STRENGTHS_G[0], STRENGTHS_G[1]);
    let strength = Strength {
        force_rms_m_s2: strength_g * f64::from(STANDARD_GRAVITY_M_S2),
        frequency_hz: random.uniform(FREQUENCIES_HZ[0], FREQUENCIES_HZ[1]),
        lever_m: 0.1,
        start_s: REST_S,
        growth_s: 1.0,
    };
    let motion: Box<dyn Motion> = Box::new(Vibrating::new(Quadrotor::new(flight), strength, seed));
    let typical = SensorErrors::typical(seed);
    let mut errors = SensorErrors::none();
    errors.accelerometer.noise_density = typical.accelerometer.noise_density;
    errors.gyroscope.noise_density = typical.gyroscope.noise_density;
    let samples = samples_with(motion, seed, errors, SECONDS);
    recording("shaken", format!("flight {seed}"), samples)
}

#[test]
fn a_start_in_vibration_is_never_wrong_and_valid() {
    let seeds = seeds(640_000..640_100);
    for (start, allowed_deg) in [
        (Start::Stored, 61.0),
        (Start::Pause, 69.0),
        (Start::Unknown, 105.0),
    ] {
        let outcomes = parallel::map(&seeds, |seed| fly(start, *seed));
        let wrong = outcomes.iter().filter(|outcome| outcome.is_wrong).count();
        let in_time = outcomes.iter().filter(|outcome| outcome.is_valid_in_time);
        let (starts, in_time) = (outcomes.len(), in_time.count());
        println!("{start:?}: of {starts} starts {wrong} wrong and VALID, {in_time} soon VALID");
        assert_eq!(wrong, 0, "{start:?}");
        let share = in_time as f64 / starts as f64;
        assert!(
            start == Start::Unknown || share >= LEAST_VALID_SHARE,
            "{start:?}: {share}"
        );
        let allowed: Allowed = outcomes.iter().map(|outcome| outcome.allowed).sum();
        allowed.check(&format!("{start:?}"), allowed_deg);
    }
}
