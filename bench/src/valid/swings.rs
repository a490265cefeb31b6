//! Loads on a rope, and buoys on a swell, after a rest and without one. The force always points
//! along the body's vertical axis. So near the largest rate of each swing the readings are those of
//! a rest, with another offset. The attitude must not be `VALID` and wrong.
//!
//! The readings come from the pendulum's equation and from the slope of deep-water waves, with
//! noise and an offset.

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

const PERIOD_US: u64 = 10_000;
const SECONDS: u64 = 180;
/// Length of the rest, s.
const REST_S: f64 = 5.0;
/// Time from the rest to the full swing, s.
const GROWTH_S: f64 = 10.0;
const GRAVITY_M_S2: f64 = 9.80665;

/// Swing about the forward axis: angle (rad), rate (rad/s) and force upwards (m/s²).
struct Swing {
    angle_rad: f64,
    rate_rad_s: f64,
    force_m_s2: f64,
}

/// Returns the swings of a load, sample by sample.
fn load(random: &mut Random) -> impl FnMut(f64) -> Swing + use<> {
    let turns_rad_s = std::f64::consts::TAU / random.uniform(4.0, 9.0);
    let amplitude_rad = random.uniform(5.0, 15.0).to_radians();
    let length_m = GRAVITY_M_S2 / (turns_rad_s * turns_rad_s);
    let (mut angle, mut rate) = (0.0_f64, 0.0_f64);
    move |t_s| {
        let step_s = PERIOD_US as f64 * 1.0e-6;
        let push = if (REST_S..REST_S + 1.0).contains(&t_s) {
            amplitude_rad * turns_rad_s
        } else {
            0.0
        };
        if t_s > REST_S {
            rate += (push - turns_rad_s * turns_rad_s * angle.sin()) * step_s;
            angle += rate * step_s;
        }
        Swing {
            angle_rad: angle,
            rate_rad_s: rate,
            force_m_s2: GRAVITY_M_S2 * angle.cos() + length_m * rate * rate,
        }
    }
}

/// Returns the swings of a buoy, which follows the slope of five waves.
fn buoy(random: &mut Random) -> impl FnMut(f64) -> Swing + use<> {
    let period_s = random.uniform(4.0, 9.0);
    let waves = [0.75, 0.9, 1.0, 1.15, 1.35].map(|factor| {
        let slope_rad = random.uniform(1.0, 4.0).to_radians();
        let phase_rad = random.uniform(0.0, std::f64::consts::TAU);
        (
            slope_rad,
            factor * std::f64::consts::TAU / period_s,
            phase_rad,
        )
    });
    move |t_s| {
        let share = ((t_s - REST_S) / GROWTH_S).clamp(0.0, 1.0);
        let sum = |part: &dyn Fn(f64, f64) -> f64| {
            let parts = waves.map(|(slope, turns, phase)| slope * part(turns * t_s + phase, turns));
            share * parts.iter().sum::<f64>()
        };
        let growing = if share > 0.0 && share < 1.0 {
            sum(&|phase, _| phase.sin()) / (share * GROWTH_S)
        } else {
            0.0
        };
        Swing {
            angle_rad: sum(&|phase, _| phase.sin()),
            rate_rad_s: sum(&|phase, turns| turns * phase.cos()) + growing,
            force_m_s2: GRAVITY_M_S2 * (1.0 + sum(&|phase, _| phase.cos())),
        }
    }
}

/// Returns for how many samples the attitude was `VALID`, and `VALID` and wrong, and what the
/// promise allowed. The sensor is switched on at this time, s.
fn valid_and_wrong(
    mut swing: impl FnMut(f64) -> Swing,
    on_s: f64,
    random: &mut Random,
) -> (u32, u32, Allowed) {
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor = CONFIG.with_sample_rate_divider((PERIOD_US / 1_000 - 1) as u8);
    let mut pipeline = Pipeline::new(&settings);
    let offset_rad_s = [(); 3].map(|()| random.uniform(-5.0, 5.0).to_radians());
    let (mut valid, mut wrong, mut allowed) = (0, 0, Allowed::default());
    for index in 0..SECONDS * 1_000_000 / PERIOD_US {
        let t_us = index * PERIOD_US;
        let t_s = t_us as f64 * 1.0e-6;
        let Swing {
            angle_rad,
            rate_rad_s,
            force_m_s2,
        } = swing(t_s);
        if t_s < on_s {
            continue;
        }
        let mut reading = |value: f64, sigma: f64| (value + sigma * random.normal()) as f32;
        let [x, y, z] = offset_rad_s;
        let rates = Vector3::new(
            reading(rate_rad_s + x, 0.001),
            reading(y, 0.001),
            reading(z, 0.001),
        );
        let force = Vector3::new(
            reading(0.0, 0.05),
            reading(0.0, 0.05),
            reading(-force_m_s2, 0.05),
        );
        let mut sample = Sample::default();
        sample.t_us = t_us;
        sample.specific_force_m_s2 = force;
        sample.angular_rate_rad_s = rates;
        let snapshot = pipeline.update_sample(&sample);
        let attitude = Quaternion::from_euler(angle_rad, 0.0, 0.0);
        let judged = Judged::new(&snapshot, up_in_body(attitude));
        valid += u32::from(judged.is_valid);
        wrong += u32::from(judged.is_wrong);
        allowed.add(&judged);
    }
    (valid, wrong, allowed)
}

/// Outcome of many swings.
struct Outcome {
    /// Number that were `VALID` and wrong, and for how long together.
    wrong: usize,
    wrong_s: f64,
    /// Share of the samples that were `VALID`.
    valid: f64,
    allowed: Allowed,
}

/// Judges loads or buoys. The sensor is switched on between the two times `on_s`, s.
fn judge(is_buoy: bool, seeds: &[u64], on_s: [f64; 2]) -> Outcome {
    let swings = parallel::map(seeds, |seed| {
        let random = &mut Random::new(*seed, "swing");
        let [first_s, last_s] = on_s;
        let on_s = Random::new(*seed, "on").uniform(first_s, last_s);
        if is_buoy {
            valid_and_wrong(buoy(random), on_s, random)
        } else {
            valid_and_wrong(load(random), on_s, random)
        }
    });
    let sum =
        |part: fn(&(u32, u32, Allowed)) -> u32| f64::from(swings.iter().map(part).sum::<u32>());
    let samples = seeds.len() as u64 * SECONDS * 1_000_000 / PERIOD_US;
    let outcome = Outcome {
        wrong: swings.iter().filter(|(_, wrong, _)| *wrong > 0).count(),
        wrong_s: sum(|(_, wrong, _)| *wrong) * PERIOD_US as f64 * 1.0e-6,
        allowed: swings.iter().map(|(.., allowed)| *allowed).sum(),
        valid: sum(|(valid, ..)| *valid) / samples as f64,
    };
    println!(
        "{} {}, from {on_s:?} s on: {} VALID and wrong, for {:.1} s; {:.3} VALID",
        seeds.len(),
        if is_buoy { "buoys" } else { "loads" },
        outcome.wrong,
        outcome.wrong_s,
        outcome.valid
    );
    outcome
}

#[test]
fn a_load_or_a_buoy_that_swings_after_a_rest_is_hardly_ever_wrong_and_valid() {
    // Before revision 27: 67 loads for 4,587 s, 117 buoys for 4,182 s. Now 1 buoy for 4 s.
    for (is_buoy, most, longest_s) in [(false, 0, 0.0), (true, 1, 4.2)] {
        let outcome = judge(is_buoy, &seeds(860_000..860_120), [0.0, 0.0]);
        assert!(outcome.wrong <= most && outcome.wrong_s <= longest_s);
        assert!(outcome.valid > 0.98, "a promise that is hardly made");
        outcome.allowed.check("swings", 17.5);
    }
}

/// Before revision 30: 47 loads for 204 s, 93 buoys for 375 s. Now 9 loads for 20 s, 11 buoys for
/// 33 s. Eight other sets of seeds had 2 to 12 loads for 3 to 25 s, and 10 to 17 buoys for 24 to
/// 60 s. The bounds are three σ above the mean of all nine.
#[test]
fn a_start_on_a_swing_is_hardly_ever_wrong_and_valid() {
    for (is_buoy, most, longest_s) in [(false, 17, 36.0), (true, 21, 78.0)] {
        let full_swing_s = REST_S + GROWTH_S;
        let on_s = [full_swing_s, full_swing_s + 10.0];
        let outcome = judge(is_buoy, &seeds(862_000..862_120), on_s);
        assert!(outcome.wrong <= most && outcome.wrong_s <= longest_s);
        assert!(outcome.valid > 0.78, "a promise that is hardly made");
        outcome.allowed.check("starts on a swing", 95.0);
    }
}
