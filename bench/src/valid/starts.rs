//! Starts in the middle of recordings and simulated flights: the rule of the flag `VALID`, where it
//! is hardest to keep.
//!
//! The truth is that of the recordings and of the simulation. The comparison uses no more of
//! the library than its quaternion.

use std::ops::Range;

use aplomb::attitude::Vector3;
use aplomb::health::Flags;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};

use super::{Judged, seeds};
use crate::folders::recordings_of;
use crate::parallel;
use crate::recording::Recording;
use crate::simulated;

/// Times of the starts, s: the first one at rest in most recordings, the others anywhere.
const STARTS_S: [u64; 5] = [0, 10, 25, 40, 55];
/// Additional gyroscope offsets, °/s: the largest that the datasheet allows (product specification
/// §6.1).
const OFFSETS_DEGREES_S: [[f32; 3]; 5] = [
    [0.0, 0.0, 0.0],
    [20.0, 0.0, 0.0],
    [0.0, -20.0, 0.0],
    [0.0, 0.0, 20.0],
    [0.0, 0.0, -20.0],
];
/// Seeds of flights without other use.
const SEEDS: Range<u64> = 2_051..2_054;
/// Length of those flights, s: within minutes a filter can become sure of a wrong attitude.
const FLIGHT_S: u64 = 240;

/// Time in which an attitude has to become valid, µs, and the share of the starts in which it has
/// to.
const VALID_WITHIN_US: u64 = 30_000_000;
const LEAST_VALID_SHARE: f64 = 0.8;

/// Outcome of one start.
struct Outcome {
    name: String,
    samples: u32,
    valid: u32,
    is_valid_in_time: bool,
    wrong: u32,
}

fn start(recording: &Recording, start_s: u64, offset_degrees_s: [f32; 3]) -> Outcome {
    let [x, y, z] = offset_degrees_s.map(f32::to_radians);
    let offset = Vector3::new(x, y, z);
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor_delay_us = Some(recording.delay_us);
    let mut steps_us: Vec<u64> = recording
        .samples
        .windows(2)
        .map(|pair| pair[1].t_us.saturating_sub(pair[0].t_us))
        .collect();
    steps_us.sort_unstable();
    let period_us = steps_us[steps_us.len() / 2];
    settings.sensor.sample_rate_divider = (period_us.div_ceil(1_000) - 1) as u8;
    let mut pipeline = Pipeline::new(&settings);
    pipeline.set_accelerometer_knowledge(recording.accelerometer);
    let mut outcome = Outcome {
        name: format!(
            "{}/{} from {start_s} s with {offset_degrees_s:?} °/s",
            recording.set, recording.name
        ),
        samples: 0,
        valid: 0,
        is_valid_in_time: false,
        wrong: 0,
    };
    for (sample, up) in recording.samples.iter().zip(&recording.true_up) {
        if sample.t_us < start_s * 1_000_000 {
            continue;
        }
        let mut shifted = *sample;
        shifted.angular_rate_rad_s = sample.angular_rate_rad_s + offset;
        let snapshot = pipeline.update_sample(&shifted);
        outcome.samples += 1;
        let is_valid = snapshot.flags.contains(Flags::VALID);
        outcome.valid += u32::from(is_valid);
        outcome.is_valid_in_time |= is_valid && sample.t_us < start_s * 1_000_000 + VALID_WITHIN_US;
        let Some(up) = up else { continue };
        outcome.wrong += u32::from(Judged::new(&snapshot, *up).is_wrong);
    }
    outcome
}

fn starts(recordings: &[Recording]) -> Vec<Outcome> {
    let mut cases = Vec::new();
    for recording in recordings {
        let end_us = recording.samples.last().map_or(0, |sample| sample.t_us);
        for start_s in STARTS_S {
            if start_s * 1_000_000 + 15_000_000 < end_us {
                cases.extend(OFFSETS_DEGREES_S.map(|offset| (recording, start_s, offset)));
            }
        }
    }
    parallel::map(&cases, |(recording, start_s, offset)| {
        start(recording, *start_s, *offset)
    })
}

/// Asserts that no start is wrong and valid at once, and that most are valid soon.
fn hold_to_the_rule(outcomes: &[Outcome]) {
    let wrong: Vec<String> = outcomes
        .iter()
        .filter(|outcome| outcome.wrong > 0)
        .map(|outcome| format!("{}: {} samples", outcome.name, outcome.wrong))
        .collect();
    let in_time = outcomes.iter().filter(|outcome| outcome.is_valid_in_time);
    let (starts, in_time) = (outcomes.len(), in_time.count());
    let wrong_starts = wrong.len();
    println!("{starts} starts: {wrong_starts} wrong and valid, {in_time} valid within 30 s");
    assert!(wrong.is_empty(), "wrong and valid: {wrong:#?}");
    let share = in_time as f64 / starts as f64;
    assert!(starts == 0 || share >= LEAST_VALID_SHARE, "{share}");
}

#[test]
fn a_start_in_flight_is_never_wrong_and_valid() {
    let flights: Vec<Recording> = seeds(SEEDS)
        .into_iter()
        .map(|seed| simulated::flight_for(seed, FLIGHT_S))
        .collect();
    let outcomes = starts(&flights);
    hold_to_the_rule(&outcomes);
    // Flags that are never valid would be useless: from rest they are valid after a second or two.
    let share = |outcome: &Outcome| f64::from(outcome.valid) / f64::from(outcome.samples);
    let rarely_valid: Vec<String> = outcomes
        .iter()
        .filter(|outcome| outcome.name.contains("from 0 s") && share(outcome) <= 0.99)
        .map(|outcome| format!("{}: {}", outcome.name, share(outcome)))
        .collect();
    assert!(rarely_valid.is_empty(), "rarely valid: {rarely_valid:#?}");
}

#[test]
fn a_start_in_a_recording_is_never_wrong_and_valid() {
    let sets = ["broad", "tumvi"].map(|set| recordings_of(&[set]).unwrap_or_default());
    hold_to_the_rule(&starts(&sets.concat()));
}
