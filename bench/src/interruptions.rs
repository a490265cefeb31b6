//! Interruptions in flight: pauses without a sample, and false full-scale readings.

use aplomb::estimator::Sample;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::random::Random;

use crate::parallel;
use crate::recording::Recording;
use crate::simulated;
use crate::valid::Judged;

/// Length of a flight, s.
const SECONDS: u64 = 30;
/// Times between which an interruption begins, µs: the vehicle has taken off, and flies on.
const BEGIN_US: [f64; 2] = [4.0e6, 14.0e6];
/// Full scale of the gyroscope, rad/s, and of the accelerometer, m/s².
const FULL_SCALE_RAD_S: f32 = 34.9;
const FULL_SCALE_M_S2: f32 = 156.9;

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// No samples.
    Pause,
    /// The gyroscope's forward axis reads full scale.
    RateX,
    /// The gyroscope's down axis reads full scale.
    RateZ,
    /// The accelerometer's forward axis reads full scale.
    ForceX,
}

impl Kind {
    /// Shortest and longest duration, s.
    const fn durations_s(self) -> [f64; 2] {
        match self {
            Self::Pause => [0.005, 2.0],
            Self::RateX | Self::RateZ => [0.001, 3.0],
            Self::ForceX => [0.001, 0.1],
        }
    }

    /// Returns the sample as it arrives during the interruption.
    fn disturb(self, sample: &Sample, sign: f32) -> Option<Sample> {
        let mut sample = *sample;
        match self {
            Self::Pause => return None,
            Self::RateX => sample.angular_rate_rad_s.x = sign * FULL_SCALE_RAD_S,
            Self::RateZ => sample.angular_rate_rad_s.z = sign * FULL_SCALE_RAD_S,
            Self::ForceX => sample.specific_force_m_s2.x = sign * FULL_SCALE_M_S2,
        }
        sample.is_rate_saturated = matches!(self, Self::RateX | Self::RateZ);
        sample.is_force_saturated = matches!(self, Self::ForceX);
        Some(sample)
    }
}

/// Flight with one interruption.
#[derive(Default)]
struct Outcome {
    /// Samples with a truth.
    judged: u32,
    /// `VALID` ones of these.
    valid: u32,
    /// `VALID` ones that were wrong.
    wrong: u32,
}

fn fly(flight: &Recording, kind: Kind, random: &mut Random) -> Outcome {
    let [earliest, latest] = BEGIN_US;
    let from_us = random.uniform(earliest, latest) as u64;
    let [shortest, longest] = kind.durations_s();
    let duration_s = random.uniform(shortest.ln(), longest.ln()).exp();
    let until_us = from_us + (duration_s * 1.0e6) as u64;
    let sign = if random.uniform(0.0, 1.0) < 0.5 {
        -1.0
    } else {
        1.0
    };
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let rows = flight.samples.iter().zip(&flight.true_up);
    let mut outcome = Outcome::default();
    for (sample, up) in rows {
        let arrives = if (from_us..until_us).contains(&sample.t_us) {
            kind.disturb(sample, sign)
        } else {
            Some(*sample)
        };
        let Some(arrives) = arrives else { continue };
        let snapshot = pipeline.update_sample(&arrives);
        // The truth begins at take-off.
        let Some(up) = *up else { continue };
        let judged = Judged::new(&snapshot, up);
        outcome.judged += 1;
        outcome.valid += u32::from(judged.is_valid);
        outcome.wrong += u32::from(judged.is_wrong);
    }
    outcome
}

#[test]
fn an_interruption_in_flight_keeps_the_promise() {
    const KINDS: [Kind; 4] = [Kind::Pause, Kind::RateX, Kind::RateZ, Kind::ForceX];
    // Seeds that nothing was tuned on.
    let seeds: Vec<u64> = (750_000..750_200).collect();
    let flights = parallel::map(&seeds, |seed| {
        let flight = simulated::flight_for(*seed, SECONDS);
        let mut random = Random::new(*seed, "interruptions");
        KINDS.map(|kind| [(); 2].map(|()| fly(&flight, kind, &mut random)))
    });
    for (index, kind) in KINDS.into_iter().enumerate() {
        let outcomes = flights.iter().flat_map(|kinds| &kinds[index]);
        let wrong = outcomes.clone().filter(|outcome| outcome.wrong > 0).count();
        let sum = |count: fn(&Outcome) -> u32| outcomes.clone().map(count).sum::<u32>();
        let valid = f64::from(sum(|it| it.valid)) / f64::from(sum(|it| it.judged));
        println!(
            "{kind:?}: {wrong} of {} VALID and wrong, {:.2} % VALID",
            2 * flights.len(),
            100.0 * valid
        );
        assert_eq!(wrong, 0, "{kind:?}");
        assert!(valid > 0.9, "{kind:?}: {valid}");
    }
}
