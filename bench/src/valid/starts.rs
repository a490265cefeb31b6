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

use super::{Allowed, Judged, seeds};
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

/// Time in which an attitude has to become valid, µs.
const VALID_WITHIN_US: u64 = 30_000_000;

/// Outcome of one start.
struct Outcome {
    name: String,
    samples: u32,
    valid: u32,
    is_valid_in_time: bool,
    wrong: u32,
    allowed: Allowed,
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
        allowed: Allowed::default(),
    };
    for (sample, up) in recording.samples.iter().zip(&recording.known_up) {
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
        let judged = Judged::new(&snapshot, *up);
        outcome.wrong += u32::from(judged.is_wrong);
        outcome.allowed.add(&judged);
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

/// Asserts that this many starts are judged, that none is wrong and valid at once, and that so many
/// are valid soon. The promise allows at most this error, degrees, on average.
fn hold_to_the_rule(outcomes: &[Outcome], starts: usize, least_in_time: usize, allowed_deg: f64) {
    let wrong: Vec<String> = outcomes
        .iter()
        .filter(|outcome| outcome.wrong > 0)
        .map(|outcome| format!("{}: {} samples", outcome.name, outcome.wrong))
        .collect();
    let in_time = outcomes.iter().filter(|outcome| outcome.is_valid_in_time);
    let in_time = in_time.count();
    let wrong_starts = wrong.len();
    println!("{starts} starts: {wrong_starts} wrong and valid, {in_time} valid within 30 s");
    assert_eq!(outcomes.len(), starts);
    assert!(wrong.is_empty(), "wrong and valid: {wrong:#?}");
    assert!(in_time >= least_in_time, "{in_time}, not {least_in_time}");
    let allowed: Allowed = outcomes.iter().map(|outcome| outcome.allowed).sum();
    allowed.check("starts", allowed_deg);
}

#[test]
fn a_start_in_flight_is_never_wrong_and_valid() {
    let flights: Vec<Recording> = seeds(SEEDS)
        .into_iter()
        .map(|seed| simulated::flight_for(seed, FLIGHT_S))
        .collect();
    let outcomes = starts(&flights);
    hold_to_the_rule(&outcomes, 75, 70, 108.0);
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
    // Set, number of starts, least number that are `VALID` in time, mean error that the promise
    // allows, degrees. In the rooms of TUM-VI the sensor does not rest.
    for (set, number, least_in_time, allowed_deg) in
        [("broad", 350, 344, 23.0), ("tumvi", 75, 74, 122.0)]
    {
        if let Some(recordings) = recordings_of(&[set]) {
            hold_to_the_rule(&starts(&recordings), number, least_in_time, allowed_deg);
        }
    }
}
