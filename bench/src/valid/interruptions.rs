//! Interruptions in flight and in a swing: pauses without a sample, false readings at full scale,
//! frozen readings, and bit errors.
//!
//! They hide motion from the filter, or show one that did not happen. The attitude must not be
//! `VALID` and wrong afterwards, and a known gyroscope bias stays known.

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Part, RawSample};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::Motion;
use aplomb_models::motion::geometry::Vector;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::swing::Swing;
use aplomb_models::motion::truth::up_in_body;
use aplomb_models::random::Random;
use aplomb_recordings::simulated::{Simulated, samples};

use super::{Allowed, Judged, seeds};
use crate::parallel;

/// Length of a flight, s, and times between which an interruption begins: the vehicle has taken
/// off, and flies on.
const FLIGHT_S: u64 = 30;
const FLIGHT_BEGIN_S: [f64; 2] = [4.0, 14.0];
/// Length of a swing, s, and of the rest at its beginning.
const SWING_S: u64 = 14;
const REST_S: f64 = 2.0;
/// Times between which an interruption begins: in the rest once the bias is known, or in the swing.
const SWING_BEGIN_S: [f64; 2] = [1.6, 4.5];
/// Time after an interruption of a swing in which the attitude may be invalid, µs.
const RECOVERY_US: u64 = 250_000;

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// No samples.
    Pause,
    /// An axis of the gyroscope reads full scale.
    Rate(usize),
    /// An axis of the accelerometer reads full scale.
    Force(usize),
    /// No samples for all but the last part of the time, then an axis of the accelerometer reads
    /// full scale.
    PauseAndForce(usize),
    /// In this share of the samples one bit is wrong.
    BitErrors(f64),
    /// The readings repeat.
    Frozen,
    /// The readings repeat, and an axis of the gyroscope reads 300 °/s: as much as a self-test
    /// that a flipped register has switched on.
    FrozenFalse(usize),
    /// An axis of the gyroscope repeats its value.
    StuckRate(usize),
    /// An axis of the accelerometer repeats its value.
    StuckForce(usize),
}

/// Gyroscope counts of 300 °/s at the default range, 16.4 LSB/(°/s).
const FALSE_COUNTS: i16 = 4_920;

/// Samples of 1 ms that may be believed until data that repeat are flagged as frozen, and the least
/// number at any rate.
const UNNOTICED: usize = 22;
const FEWEST_UNNOTICED: usize = 5;

/// Longest time from a motion to the flag of an axis that is stuck, µs: two windows.
const STUCK_US: u64 = 260_000;

/// Interruption of a motion.
#[derive(Debug)]
struct Interruption {
    kind: Kind,
    from_us: u64,
    until_us: u64,
    is_negative: bool,
    random: Random,
}

/// Last part of [`Kind::PauseAndForce`], µs.
const FORCE_US: u64 = 50_000;

impl Interruption {
    /// Begins between these times, and lasts as long as one of these durations or in between, s.
    fn new(kind: Kind, begin_s: [f64; 2], durations_s: [f64; 2], random: &mut Random) -> Self {
        let begin_s = random.uniform(begin_s[0], begin_s[1]);
        let [shortest, longest] = durations_s.map(f64::ln);
        let duration_s = random.uniform(shortest, longest).exp();
        Self {
            kind,
            from_us: (begin_s * 1.0e6) as u64,
            until_us: ((begin_s + duration_s) * 1.0e6) as u64,
            is_negative: random.uniform(0.0, 1.0) < 0.5,
            random: random.clone(),
        }
    }

    /// Returns the counts that arrive instead of these; `None` in a pause. `last` arrived before.
    fn disturb(&mut self, raw: &RawSample, last: &RawSample, t_us: u64) -> Option<RawSample> {
        if !(self.from_us..self.until_us).contains(&t_us) {
            return Some(*raw);
        }
        let signed = |counts: i16| if self.is_negative { -counts } else { counts };
        let mut arrives = *raw;
        match self.kind {
            Kind::Pause => return None,
            Kind::Rate(axis) => arrives.gyroscope.0[axis] = signed(i16::MAX),
            Kind::Force(axis) => arrives.accelerometer.0[axis] = signed(i16::MAX),
            Kind::PauseAndForce(_) if t_us + FORCE_US < self.until_us => return None,
            Kind::PauseAndForce(axis) => arrives.accelerometer.0[axis] = signed(i16::MAX),
            Kind::BitErrors(share) => {
                let bit = self.random.uniform(0.0, 112.0) as usize;
                if self.random.uniform(0.0, 1.0) < share {
                    let mut bytes = raw.encode();
                    bytes[bit / 8] ^= 1 << (bit % 8);
                    arrives = RawSample::decode(&bytes);
                }
            }
            Kind::Frozen => arrives = *last,
            Kind::FrozenFalse(axis) => {
                arrives = *last;
                arrives.gyroscope.0[axis] = signed(FALSE_COUNTS);
            }
            Kind::StuckRate(axis) => arrives.gyroscope.0[axis] = last.gyroscope.0[axis],
            Kind::StuckForce(axis) => arrives.accelerometer.0[axis] = last.accelerometer.0[axis],
        }
        Some(arrives)
    }
}

/// Counts of an interrupted motion.
#[derive(Default)]
struct Outcome {
    /// Samples with a truth that counts.
    judged: u32,
    /// `VALID` ones of these.
    valid: u32,
    /// `VALID` ones of all samples with a truth that were wrong.
    wrong: u32,
    /// Samples that were not `VALID` after [`RECOVERY_US`].
    late: u32,
    allowed: Allowed,
}

fn simulate(motion: Box<dyn Motion>, seed: u64, seconds: u64) -> Vec<(Simulated, Option<Vector>)> {
    let with_truth = |simulated: Simulated| {
        let up = simulated.truth.attitude.map(up_in_body);
        (simulated, up)
    };
    samples(motion, seed, seconds).map(with_truth).collect()
}

/// Runs the pipeline at a rate of 1 kHz divided by `1 + divider`.
fn interrupt(
    motion: &[(Simulated, Option<Vector>)],
    divider: u8,
    mut interruption: Interruption,
) -> Outcome {
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor.sample_rate_divider = divider;
    settings.verifies_scales = true;
    let mut pipeline = Pipeline::new(&settings);
    let mut outcome = Outcome::default();
    let mut last = RawSample::default();
    let unnoticed = (UNNOTICED / (1 + usize::from(divider))).max(FEWEST_UNNOTICED);
    let mut flipped = 0;
    for (simulated, up) in motion.iter().step_by(1 + usize::from(divider)) {
        let t_us = simulated.t_us;
        let Some(raw) = interruption.disturb(&simulated.raw, &last, t_us) else {
            continue;
        };
        last = raw;
        let burst = Burst {
            bytes: raw.encode(),
            captured_at_us: t_us,
            missed_before: 0,
        };
        // A board reads the flipped register back, and reports no right scale.
        let is_flipped = raw != simulated.raw && matches!(interruption.kind, Kind::FrozenFalse(_));
        let board = if is_flipped {
            BoardFlags::empty()
        } else {
            BoardFlags::SCALES_VERIFIED
        };
        let snapshot = pipeline.update(&burst, board);
        flipped += usize::from(is_flipped);
        // A false rate is believed until the data are flagged as frozen. So is a stuck axis, for up
        // to two windows.
        let is_believed = match interruption.kind {
            Kind::FrozenFalse(_) => is_flipped && flipped <= unnoticed,
            Kind::StuckRate(_) | Kind::StuckForce(_) => {
                (interruption.from_us..interruption.from_us + STUCK_US).contains(&t_us)
            }
            _ => false,
        };
        let Some(up) = up.filter(|_| !is_believed) else {
            continue;
        };
        let judged = Judged::new(&snapshot, up);
        outcome.wrong += u32::from(judged.is_wrong);
        // The truth counts from take-off on.
        if !simulated.truth.scored {
            continue;
        }
        outcome.judged += 1;
        outcome.valid += u32::from(judged.is_valid);
        outcome.allowed.add(&judged);
        let is_due = t_us >= interruption.until_us + RECOVERY_US;
        outcome.late += u32::from(is_due && !judged.is_valid);
    }
    outcome
}

#[test]
fn an_interruption_in_flight_keeps_the_promise() {
    const KINDS: [(Kind, [f64; 2]); 11] = [
        (Kind::Pause, [0.005, 2.0]),
        (Kind::Rate(0), [0.001, 3.0]),
        (Kind::Rate(2), [0.001, 3.0]),
        (Kind::Force(0), [0.001, 0.1]),
        (Kind::Frozen, [0.005, 3.0]),
        (Kind::FrozenFalse(0), [0.03, 3.0]),
        (Kind::FrozenFalse(1), [0.03, 3.0]),
        (Kind::Force(1), [0.1, 3.0]),
        (Kind::PauseAndForce(2), [0.55, 2.0]),
        (Kind::BitErrors(0.02), [0.5, 10.0]),
        (Kind::BitErrors(0.3), [0.02, 3.0]),
    ];
    keep_the_promise(&KINDS, 0, 0.95, 57.0);
}

#[test]
fn a_stuck_axis_in_flight_keeps_the_promise() {
    const KINDS: [(Kind, [f64; 2]); 4] = [
        (Kind::StuckRate(0), [0.3, 10.0]),
        (Kind::StuckRate(2), [0.3, 10.0]),
        (Kind::StuckForce(0), [0.3, 10.0]),
        (Kind::StuckForce(2), [0.3, 10.0]),
    ];
    // Not valid while it is stuck.
    keep_the_promise(&KINDS, 0, 0.88, 57.0);
}

#[test]
fn an_interruption_at_100_samples_a_second_keeps_the_promise() {
    const KINDS: [(Kind, [f64; 2]); 4] = [
        (Kind::Pause, [0.03, 2.0]),
        (Kind::Frozen, [0.03, 3.0]),
        (Kind::FrozenFalse(1), [0.06, 3.0]),
        (Kind::BitErrors(0.02), [0.5, 10.0]),
    ];
    keep_the_promise(&KINDS, 9, 0.95, 58.0);
}

/// Checks flights with interruptions of these kinds, of this shortest and longest duration in s.
/// More than this share of the attitudes has to be `VALID`. The promise allows them at most this
/// error, degrees, on average.
fn keep_the_promise(kinds: &[(Kind, [f64; 2])], divider: u8, least_valid: f64, allowed_deg: f64) {
    let seeds = seeds(750_000..750_200);
    let flights = parallel::map(&seeds, |seed| {
        let flight = simulate(Box::new(Quadrotor::by_seed(*seed)), *seed, FLIGHT_S);
        let mut random = Random::new(*seed, "interruptions");
        let mut fly = |&(kind, durations_s)| {
            [(); 2].map(|()| {
                let (begin_s, random) = (FLIGHT_BEGIN_S, &mut random);
                let interruption = Interruption::new(kind, begin_s, durations_s, random);
                interrupt(&flight, divider, interruption)
            })
        };
        kinds.iter().map(&mut fly).collect::<Vec<_>>()
    });
    for (index, (kind, _)) in kinds.iter().enumerate() {
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
        assert!(valid > least_valid, "{kind:?}: {valid}");
        let allowed: Allowed = outcomes.map(|outcome| outcome.allowed).sum();
        allowed.check(&format!("{kind:?}"), allowed_deg);
    }
}

#[test]
fn an_interruption_of_a_swing_costs_no_knowledge_of_the_bias() {
    const KINDS: [(Kind, [f64; 2]); 6] = [
        (Kind::Pause, [0.05, 0.45]),
        (Kind::Rate(0), [0.002, 0.06]),
        (Kind::Rate(1), [0.002, 0.06]),
        (Kind::Rate(2), [0.002, 0.06]),
        (Kind::Frozen, [0.005, 1.0]),
        (Kind::FrozenFalse(1), [0.03, 1.0]),
    ];
    let seeds = seeds(61_000..61_200);
    let outcomes = parallel::map(&seeds, |seed| {
        let swing = simulate(Box::new(Swing::by_seed(*seed, REST_S)), *seed, SWING_S);
        let mut random = Random::new(*seed, "interruptions");
        let (mut failed, mut allowed) = (Vec::new(), Vec::new());
        for (kind, durations_s) in KINDS {
            let (begin_s, random) = (SWING_BEGIN_S, &mut random);
            let interruption = Interruption::new(kind, begin_s, durations_s, random);
            let text = format!("seed {seed}, {interruption:?}");
            let outcome = interrupt(&swing, 0, interruption);
            let Outcome { wrong, late, .. } = outcome;
            allowed.push(outcome.allowed);
            if wrong > 0 || late > 0 {
                failed.push(format!("{text}: {wrong} VALID and wrong, {late} late"));
            }
        }
        (failed, allowed.into_iter().sum::<Allowed>())
    });
    let allowed: Allowed = outcomes.iter().map(|(_, allowed)| *allowed).sum();
    let failed: Vec<&String> = outcomes.iter().flat_map(|(failed, _)| failed).collect();
    assert!(failed.is_empty(), "{}: {failed:#?}", failed.len());
    allowed.check("swings", 46.0);
}
