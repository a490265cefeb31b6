//! Slow, steady turns: readings that look like those of rest. The attitude must not be `VALID` and
//! wrong, and a gyroscope bias that a rest has shown stays known.

use aplomb::health::BoardFlags;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::slow_turn::SlowTurn;
use aplomb_models::motion::truth::up_in_body;
use aplomb_recordings::simulated::samples;

use super::{Allowed, Judged, seeds};
use crate::parallel;

const SECONDS: u64 = 36;

/// Returns the `VALID` samples, and those of them that were wrong, as shares of all, and what the
/// promise allowed.
fn valid_and_wrong(seed: u64, from_s: f64) -> ([f64; 2], Allowed) {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let (mut judged, mut valid, mut wrong) = (0, 0, 0);
    let mut allowed = Allowed::default();
    for simulated in samples(Box::new(SlowTurn::by_seed(seed, from_s)), seed, SECONDS) {
        let snapshot = pipeline.update(&simulated.burst(), BoardFlags::empty());
        let Some(attitude) = simulated.truth.attitude else {
            continue;
        };
        let result = Judged::new(&snapshot, up_in_body(attitude));
        judged += 1;
        valid += u32::from(result.is_valid);
        wrong += u32::from(result.is_wrong);
        allowed.add(&result);
    }
    let shares = [valid, wrong].map(|count| f64::from(count) / f64::from(judged));
    (shares, allowed)
}

#[test]
fn a_slow_turn_is_no_rest() {
    // The turn's begin, and the mean error that the promise allows, degrees. Without a rest before
    // it there is no known bias until the turn has ended.
    const BEGINS: [(f64, f64); 3] = [(2.0, 9.5), (0.4, 44.0), (-8.0, 44.0)];
    let seeds = seeds(830_000..830_100);
    for (from_s, allowed_deg) in BEGINS {
        let turns = parallel::map(&seeds, |seed| valid_and_wrong(*seed, from_s));
        let wrong = turns.iter().filter(|([_, wrong], _)| *wrong > 0.0).count();
        let valid = turns.iter().map(|([valid, _], _)| valid).sum::<f64>() / turns.len() as f64;
        println!("from {from_s} s on: {wrong} VALID and wrong, {valid:.3} VALID");
        assert_eq!(wrong, 0, "from {from_s} s on");
        assert!(valid > 0.97, "from {from_s} s on: {valid}");
        let allowed: Allowed = turns.iter().map(|(_, allowed)| *allowed).sum();
        allowed.check(&format!("from {from_s} s on"), allowed_deg);
    }
}
