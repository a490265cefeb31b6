//! Motion that no sample shows: pauses and false readings at full scale, in a swing and at rest.
//!
//! They turn the tilt unseen. The filter's later corrections must not be taken for a changed bias:
//! a known bias stays known, and the attitude `VALID`.

use aplomb::estimator::Sample;
use aplomb::health::Flags;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::swing::Swing;
use aplomb_models::random::Random;
use aplomb_recordings::simulated::samples;

use crate::parallel;
use crate::recording::Recording;
use crate::simulated;
use crate::valid::Judged;

/// Length of a flight, s, and of the rest at its beginning.
const SECONDS: u64 = 14;
const REST_S: f64 = 2.0;
/// Time of the event, s: in the rest once the bias is known, and in the swing.
const EVENT_S: [f64; 2] = [1.6, 4.5];
/// Time after an event in which the attitude may be invalid, µs.
const RECOVERY_US: u64 = 250_000;
/// Full scale of the gyroscope, as a rate, °/s.
const FULL_SCALE_DEGREES_S: f32 = 2_000.0;

/// Cause that hides the motion.
#[derive(Debug, Clone, Copy)]
enum Event {
    /// No samples come.
    Pause,
    /// A fault makes the readings of this axis full scale.
    FullScale(u32),
}

/// Outcome of a flight.
struct Outcome {
    seed: u64,
    event: Event,
    start_us: u64,
    end_us: u64,
    /// Samples that were not `VALID` after the recovery.
    invalid: u32,
    /// Samples that were `VALID` and wrong.
    wrong: u32,
}

fn fly(seed: u64) -> Outcome {
    let mut random = Random::new(seed, "unseen motion");
    let mut uniform = |low: f64, high: f64| random.uniform(low, high);
    let start_s = uniform(EVENT_S[0], EVENT_S[1]);
    let (event, length_s) = if seed.is_multiple_of(2) {
        (Event::Pause, uniform(0.05, 0.45))
    } else {
        let axis = uniform(0.0, 3.0) as u32;
        (Event::FullScale(axis), uniform(0.002, 0.06))
    };
    let swing = Swing::by_seed(seed, REST_S);
    let flown = samples(Box::new(swing), seed, SECONDS);
    let flight: Recording = simulated::recording("swing", seed.to_string(), flown);
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let start_us = (start_s * 1e6) as u64;
    let end_us = start_us + (length_s * 1e6) as u64;
    let mut outcome = Outcome {
        seed,
        event,
        start_us,
        end_us,
        invalid: 0,
        wrong: 0,
    };
    for (sample, true_up) in flight.samples.iter().zip(&flight.true_up) {
        let mut sample = *sample;
        if (start_us..end_us).contains(&sample.t_us) {
            match event {
                Event::Pause => continue,
                Event::FullScale(axis) => saturate(&mut sample, axis),
            }
        }
        let snapshot = pipeline.update_sample(&sample);
        if let Some(true_up) = true_up {
            outcome.wrong += u32::from(Judged::new(&snapshot, *true_up).is_wrong);
        }
        if sample.t_us >= end_us + RECOVERY_US {
            outcome.invalid += u32::from(!snapshot.flags.contains(Flags::VALID));
        }
    }
    outcome
}

fn saturate(sample: &mut Sample, axis: u32) {
    let rate = &mut sample.angular_rate_rad_s;
    let reading = match axis {
        0 => &mut rate.x,
        1 => &mut rate.y,
        _ => &mut rate.z,
    };
    *reading = FULL_SCALE_DEGREES_S.to_radians();
    sample.is_rate_saturated = true;
}

#[test]
fn unseen_motion_costs_no_knowledge_of_the_bias() {
    // Seeds that nothing was tuned on.
    let seeds: Vec<u64> = (61_000..61_400).collect();
    let outcomes = parallel::map(&seeds, |seed| fly(*seed));
    let failed = |outcome: &&Outcome| outcome.invalid > 0 || outcome.wrong > 0;
    let failed: Vec<&Outcome> = outcomes.iter().filter(failed).collect();
    for outcome in &failed {
        let Outcome { seed, event, .. } = outcome;
        println!(
            "seed {seed}, {event:?} from {} to {} us: {} samples not valid, {} wrong and valid",
            outcome.start_us, outcome.end_us, outcome.invalid, outcome.wrong
        );
    }
    assert!(failed.is_empty(), "{} of {}", failed.len(), outcomes.len());
}
