//! Steady acceleration on a straight line: a car, a train, an aeroplane on its runway. The readings
//! are those of a rest in another attitude. Armed, the attitude must not be `VALID` and wrong.
//!
//! The readings come from the geometry, with noise and an offset.

use aplomb::attitude::Vector3;
use aplomb::estimator::Sample;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::geometry::Quaternion;
use aplomb_models::motion::truth::up_in_body;
use aplomb_models::random::Random;
use aplomb_recordings::simulated::CONFIG;

use super::{Allowed, Judged, seeds};
use crate::parallel;
use crate::promise::larger;

const PERIOD_US: u64 = 5_000;
const GRAVITY_M_S2: f64 = 9.80665;
/// Times of the acceleration's begin and end, and of the recording's end, s.
const BEGIN_S: f64 = 15.0;
const END_S: f64 = 45.0;
const SECONDS: u64 = 75;
/// Rises of the acceleration, s.
const ONSETS_S: [f64; 4] = [0.5, 3.0, 10.0, 20.0];
/// Accelerations, m/s²: a train, a car, a take-off, a sports car.
const ACCELERATIONS_M_S2: [f64; 5] = [0.5, 1.0, 2.0, 3.0, 4.0];
/// Longest mean time of such rides for which the attitude is not `VALID`, ms, and largest mean
/// error that the promise allows, degrees.
const BOUNDS: [(u64, f64); 5] = [
    (2_000, 47.0),
    (2_500, 80.0),
    (6_000, 112.0),
    (13_500, 114.0),
    (19_000, 116.0),
];

/// Outcome of a ride.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    /// Time for which the attitude was `VALID` and wrong, ms.
    wrong_ms: u64,
    not_valid_ms: u64,
    largest_deg: f64,
    allowed: Allowed,
}

fn ride(
    seed: u64,
    (acceleration_m_s2, onset_s): (f64, f64),
    knowledge: AccelerometerKnowledge,
) -> Outcome {
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor = CONFIG.with_sample_rate_divider((PERIOD_US / 1_000 - 1) as u8);
    let mut pipeline = Pipeline::new(&settings);
    pipeline.set_accelerometer_knowledge(knowledge);
    let mut random = Random::new(seed, "straight");
    let mut draw = |low: f64, high: f64| random.uniform(low, high);
    let attitude = Quaternion::from_euler(draw(-0.3, 0.3), draw(-0.3, 0.3), draw(-3.0, 3.0));
    let heading_rad = draw(-3.0, 3.0);
    let offset_rad_s = [(); 3].map(|()| draw(-2.0, 2.0).to_radians());
    let noise_m_s2 = draw(0.02, 0.3);
    let up = up_in_body(attitude);
    let mut outcome = Outcome::default();
    for index in 0..SECONDS * 1_000_000 / PERIOD_US {
        let t_us = index * PERIOD_US;
        let time_s = t_us as f64 * 1.0e-6;
        let rise = ((time_s - BEGIN_S) / onset_s).clamp(0.0, 1.0);
        let fall = ((END_S - time_s) / onset_s.min(2.0)).clamp(0.0, 1.0);
        let acceleration = acceleration_m_s2 * rise.min(fall);
        let earth = [
            acceleration * heading_rad.cos(),
            acceleration * heading_rad.sin(),
            -GRAVITY_M_S2,
        ];
        let body = attitude.conjugate().rotate(earth);
        let force = body.map(|axis| (axis + draw(-noise_m_s2, noise_m_s2)) as f32);
        let rate = offset_rad_s.map(|offset| (offset + draw(-0.003, 0.003)) as f32);
        let mut sample = Sample::default();
        sample.t_us = t_us;
        sample.specific_force_m_s2 = Vector3::new(force[0], force[1], force[2]);
        sample.angular_rate_rad_s = Vector3::new(rate[0], rate[1], rate[2]);
        let snapshot = pipeline.update_sample(&sample);
        // The rest before has measured the offset.
        pipeline.set_armed(time_s > BEGIN_S - 1.0);
        if time_s < BEGIN_S {
            continue;
        }
        let judged = Judged::new(&snapshot, up);
        let period_ms = PERIOD_US / 1_000;
        outcome.wrong_ms += u64::from(judged.is_wrong) * period_ms;
        outcome.not_valid_ms += u64::from(!judged.is_valid) * period_ms;
        outcome.largest_deg = larger(outcome.largest_deg, judged.error_deg);
        outcome.allowed.add(&judged);
    }
    outcome
}

#[test]
fn a_steady_acceleration_is_never_wrong_and_valid_while_armed() {
    let mut cases = Vec::new();
    for seed in seeds(870_000..870_006) {
        for onset_s in ONSETS_S {
            for acceleration in ACCELERATIONS_M_S2 {
                for knowledge in [
                    AccelerometerKnowledge::Calibrated,
                    AccelerometerKnowledge::Factory,
                ] {
                    cases.push((seed, (acceleration, onset_s), knowledge));
                }
            }
        }
    }
    let outcomes = parallel::map(&cases, |(seed, motion, knowledge)| {
        ride(*seed, *motion, *knowledge)
    });
    for (acceleration, (most_ms, allowed_deg)) in ACCELERATIONS_M_S2.into_iter().zip(BOUNDS) {
        let of_case = cases.iter().zip(&outcomes);
        let of_case = of_case.filter(|((_, (own, _), _), _)| *own == acceleration);
        let (mut rides, mut wrong, mut not_valid_ms) = (0_u32, 0_u32, 0);
        let (mut largest_deg, mut allowed) = (0.0, Vec::new());
        for (_, outcome) in of_case {
            rides += 1;
            wrong += u32::from(outcome.wrong_ms > 0);
            not_valid_ms += outcome.not_valid_ms;
            largest_deg = larger(largest_deg, outcome.largest_deg);
            allowed.push(outcome.allowed);
        }
        let not_valid_ms = not_valid_ms / u64::from(rides);
        println!(
            "{acceleration} m/s²: {wrong} of {rides} rides VALID and wrong; not VALID for \
             {not_valid_ms} ms, largest error {largest_deg:.1}°"
        );
        // A promise that is never made would be kept too.
        assert!(
            not_valid_ms < most_ms,
            "{acceleration} m/s²: {not_valid_ms} ms"
        );
        let allowed: Allowed = allowed.into_iter().sum();
        allowed.check(&format!("{acceleration} m/s²"), allowed_deg);
    }
    for (case, outcome) in cases.iter().zip(&outcomes) {
        assert_eq!(outcome.wrong_ms, 0, "{case:?}: {outcome:?}");
    }
}
