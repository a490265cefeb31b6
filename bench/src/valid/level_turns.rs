//! Level turns without a rest: gravity and the turn's acceleration together read like a rest in a
//! tilted attitude, and the turn like a bias. The attitude must not be `VALID` and wrong.
//!
//! The readings come from the geometry of a coordinated turn, with noise and an offset.

use aplomb::attitude::Vector3;
use aplomb::estimator::Sample;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::geometry::Quaternion;
use aplomb_models::motion::truth::up_in_body;
use aplomb_models::random::Random;
use aplomb_recordings::simulated::CONFIG;

use super::{Allowed, Judged, seeds};
use crate::parallel;

const PERIOD_US: u64 = 5_000;
const SECONDS: u64 = 120;
const GRAVITY_M_S2: f64 = 9.80665;

/// Returns how many samples were `VALID`, how many of them wrong, and what the promise allowed.
fn valid_and_wrong(seed: u64) -> (u32, u32, Allowed) {
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor = CONFIG.with_sample_rate_divider((PERIOD_US / 1_000 - 1) as u8);
    let mut pipeline = Pipeline::new(&settings);
    let mut random = Random::new(seed, "level turn");
    let mut draw = |low: f64, high: f64| random.uniform(low, high);
    let (bank_rad, speed_m_s) = (draw(15.0, 60.0).to_radians(), draw(8.0, 30.0));
    // Gusts, so that the readings are not those of a rest.
    let (gust_rad, gust_rad_s) = (draw(4.0, 8.0).to_radians(), draw(2.0, 4.0));
    let offset_rad_s = [(); 3].map(|()| draw(-20.0, 20.0).to_radians());
    let (mut yaw_rad, mut valid, mut wrong) = (0.0, 0, 0);
    let mut allowed = Allowed::default();
    for index in 0..SECONDS * 1_000_000 / PERIOD_US {
        let t_us = index * PERIOD_US;
        let phase = gust_rad_s * t_us as f64 * 1.0e-6;
        let roll_rad = bank_rad + gust_rad * phase.sin();
        let yaw_rate = GRAVITY_M_S2 * roll_rad.tan() / speed_m_s;
        let rates = [
            gust_rad * gust_rad_s * phase.cos(),
            yaw_rate * roll_rad.sin(),
            yaw_rate * roll_rad.cos(),
        ];
        let [p, q, r] = std::array::from_fn(|axis| {
            (rates[axis] + offset_rad_s[axis] + draw(-0.003, 0.003)) as f32
        });
        let force_m_s2 = (-GRAVITY_M_S2 / roll_rad.cos()) as f32;
        let noise = [(); 3].map(|()| draw(-0.05, 0.05) as f32);
        let force = Vector3::new(noise[0], noise[1], force_m_s2 + noise[2]);
        let mut sample = Sample::default();
        sample.t_us = t_us;
        sample.specific_force_m_s2 = force;
        sample.angular_rate_rad_s = Vector3::new(p, q, r);
        let snapshot = pipeline.update_sample(&sample);
        let attitude = Quaternion::from_euler(roll_rad, 0.0, yaw_rad);
        let judged = Judged::new(&snapshot, up_in_body(attitude));
        valid += u32::from(judged.is_valid);
        wrong += u32::from(judged.is_wrong);
        allowed.add(&judged);
        yaw_rad += yaw_rate * PERIOD_US as f64 * 1.0e-6;
    }
    (valid, wrong, allowed)
}

#[test]
fn a_level_turn_without_a_rest_is_never_wrong_and_valid() {
    let seeds = seeds(850_000..850_200);
    let turns = parallel::map(&seeds, |seed| valid_and_wrong(*seed));
    let wrong = turns.iter().filter(|(_, wrong, _)| *wrong > 0).count();
    let valid = turns.iter().filter(|(valid, ..)| *valid > 0).count();
    println!(
        "{} level turns: {wrong} VALID and wrong, {valid} VALID at times",
        seeds.len()
    );
    assert_eq!(wrong, 0);
    assert!(valid > 100, "a promise that is hardly made: {valid}");
    let allowed: Allowed = turns.iter().map(|(.., allowed)| *allowed).sum();
    allowed.check("level turns", 150.0);
}
