//! `aplomb-bench --leave-one-out`: accuracy of a tuning on a set of recordings that it never saw.
//!
//! For each set in turn, a search tunes the library's filter on the other sets, and the filter is
//! judged on that one. The search starts with every number of the default tuning doubled or halved
//! at random. It changes one number at a time by a factor, in both directions, and keeps
//! improvements. Without an improvement it takes a smaller factor. The cost is the product of the
//! sets' mean errors, so every set has an equal weight. Simulated flights for tuning and for
//! judging have different seeds. Their sensors are calibrated in twelve poses, as those of the
//! recordings are by their makers: the prior of a factory accelerometer is no number of the tuning.
//!
//! The search runs twice. The first run keeps the numbers of the sensor's known errors, because the
//! default has them from datasheets and not from recordings. The second run searches every number:
//! sets of calibrated sensors do not show the errors of other sensors.

use std::fmt::Write as _;

use aplomb::estimator::kalman::{AccelerometerKnowledge, Tuning};
use aplomb_models::random::Random;
use aplomb_recordings::score::{mean, median};

use crate::filter::Filter;
use crate::parallel;
use crate::recording::Recording;
use crate::simulated::{self, EVALUATION_SEEDS, TUNING_SEEDS};

/// Factor by which a number starts too large or too small.
const START_FACTOR: f32 = 2.0;
/// Factors of the search, largest first.
const FACTORS: [f32; 2] = [2.0, 1.4];
/// Most rounds through all numbers for each factor.
const MOST_ROUNDS: usize = 5;
/// Least share by which a change has to improve the product. A smaller one is chance.
const LEAST_GAIN: f64 = 5e-4;

/// Numbers of [`Tuning`] that are known properties of such sensors.
const SENSOR: [&str; 5] = [
    "start_tilt_rad",
    "gyroscope_bias_rad_s",
    "start_velocity_m_s",
    "gyroscope_bias_walk",
    "parameter_memory_s",
];

/// Returns the numbers of a tuning that decide on accuracy, without those that only cost time.
fn numbers(tuning: &mut Tuning) -> [(&'static str, &mut f32); 21] {
    // Every field has a name here, so that the compiler reports a new one.
    let Tuning {
        start_tilt_rad,
        gyroscope_bias_rad_s,
        start_velocity_m_s,
        rate_noise,
        rate_noise_per_rate,
        gyroscope_bias_walk,
        parameter_memory_s,
        force_noise,
        force_noise_per_velocity,
        velocity_noise,
        velocity_noise_per_velocity,
        velocity_noise_limit,
        velocity_average_s,
        velocity_smoothing_s,
        coupling,
        prior_gate_sigma,
        stationary_after_s,
        stationary_rate_rad_s,
        stationary_force_m_s2,
        stationary_velocity_noise,
        stationary_rate_noise,
        covariance_period_s: _,
        earth_period_s: _,
    } = tuning;
    [
        ("start_tilt_rad", start_tilt_rad),
        ("gyroscope_bias_rad_s", gyroscope_bias_rad_s),
        ("start_velocity_m_s", start_velocity_m_s),
        ("rate_noise", rate_noise),
        ("rate_noise_per_rate", rate_noise_per_rate),
        ("gyroscope_bias_walk", gyroscope_bias_walk),
        ("parameter_memory_s", parameter_memory_s),
        ("force_noise", force_noise),
        ("force_noise_per_velocity", force_noise_per_velocity),
        ("velocity_noise", velocity_noise),
        ("velocity_noise_per_velocity", velocity_noise_per_velocity),
        ("velocity_noise_limit", velocity_noise_limit),
        ("velocity_average_s", velocity_average_s),
        ("velocity_smoothing_s", velocity_smoothing_s),
        ("coupling", coupling),
        ("prior_gate_sigma", prior_gate_sigma),
        ("stationary_after_s", stationary_after_s),
        ("stationary_rate_rad_s", stationary_rate_rad_s),
        ("stationary_force_m_s2", stationary_force_m_s2),
        ("stationary_velocity_noise", stationary_velocity_noise),
        ("stationary_rate_noise", stationary_rate_noise),
    ]
}

/// Set to tune on and to judge on: the same recordings, except for flights.
struct Set {
    name: String,
    to_tune: Vec<Recording>,
    to_judge: Option<Vec<Recording>>,
}

impl Set {
    fn to_judge(&self) -> &[Recording] {
        self.to_judge.as_deref().unwrap_or(&self.to_tune)
    }
}

/// Leaves out every set once, then none, and returns the report.
pub fn run(recordings: Vec<Recording>) -> String {
    let mut sets: Vec<Set> = Vec::new();
    for recording in recordings {
        match sets.iter_mut().find(|set| set.name == recording.set) {
            Some(set) => set.to_tune.push(recording),
            None => sets.push(Set {
                name: recording.set.clone(),
                to_tune: vec![recording],
                to_judge: None,
            }),
        }
    }
    sets.push(Set {
        name: "simulated".to_owned(),
        to_tune: simulated::flights(TUNING_SEEDS, AccelerometerKnowledge::Calibrated),
        to_judge: Some(simulated::flights(
            EVALUATION_SEEDS,
            AccelerometerKnowledge::Calibrated,
        )),
    });
    let before: Vec<Vec<f64>> = sets
        .iter()
        .map(|set| errors(set.to_judge(), &Tuning::DEFAULT))
        .collect();
    let mut text = String::from(
        "\nInclination error in degrees, median/mean over the recordings of a set, \
         with the default tuning and with one that was\n\
         searched on the other sets alone, \
         from a start that is off by a factor of two in every number searched\n",
    );
    for (title, kept) in [
        ("what is known of the sensor stays", &SENSOR[..]),
        ("every number is searched", &[]),
    ] {
        let _ = writeln!(
            text,
            "\n{title}\n{:<18}{:>11}{:>16}{:>10}   largest changes from the default",
            "left out", "default", "others' tuning", "change"
        );
        for (left_out, (set, before)) in sets.iter().zip(&before).enumerate() {
            let others = sets.iter().enumerate();
            let others = others.filter(|(other, _)| *other != left_out);
            let others: Vec<&Set> = others.map(|(_, other)| other).collect();
            let found = search(&format!("without {}", set.name), &others, kept);
            let after = errors(set.to_judge(), &found);
            line(&mut text, &set.name, before, &after, &changes(&found));
        }
        let found = search("with all", &sets.iter().collect::<Vec<_>>(), kept);
        let mut note = changes(&found);
        for (set, before) in sets.iter().zip(&before) {
            let after = errors(set.to_judge(), &found);
            let name = format!("none: {}", set.name);
            line(&mut text, &name, before, &after, &note);
            note.clear();
        }
    }
    text
}

fn line(text: &mut String, name: &str, before: &[f64], after: &[f64], note: &str) {
    let both = |errors: &[f64]| format!("{:.2}/{:.2}", median(errors), mean(errors));
    let change = 100.0 * (mean(after) / mean(before) - 1.0);
    let line = format!(
        "{name:<18}{:>11}{:>16}{change:>+8.0} %   {note}",
        both(before),
        both(after)
    );
    let _ = writeln!(text, "{}", line.trim_end());
}

/// Returns the errors of the recordings, ascending.
fn errors(recordings: &[Recording], tuning: &Tuning) -> Vec<f64> {
    // A filter borrows its tuning for ever. A search leaks some hundred kilobytes.
    let tuning: &'static Tuning = Box::leak(Box::new(*tuning));
    let mut errors = parallel::map(recordings, |recording| {
        let filter = Filter::with_tuning(tuning, recording.delay_us);
        recording.rms(filter.with_knowledge(recording.accelerometer))
    });
    errors.sort_by(f64::total_cmp);
    errors
}

/// Returns the logarithm of the product of the sets' mean errors.
fn cost(sets: &[&Set], tuning: &Tuning) -> f64 {
    let means = sets
        .iter()
        .map(|set| mean(&errors(&set.to_tune, tuning)).ln());
    means.sum()
}

fn search(what: &str, sets: &[&Set], kept: &[&str]) -> Tuning {
    let mut random = Random::new(1, "start of the search for a tuning");
    let mut tuning = Tuning::DEFAULT;
    let mut searched = Vec::new();
    for (index, (name, number)) in numbers(&mut tuning).into_iter().enumerate() {
        let doubled = random.uniform(0.0, 1.0) < 0.5;
        if kept.contains(&name) {
            continue;
        }
        searched.push(index);
        *number *= if doubled {
            START_FACTOR
        } else {
            1.0 / START_FACTOR
        };
    }
    let rounds = FACTORS.len() * MOST_ROUNDS;
    let bar = parallel::bar(what, (rounds * searched.len()) as u64);
    let mut least = cost(sets, &tuning);
    for factor in FACTORS {
        for round in 0..MOST_ROUNDS {
            let mut is_better = false;
            for index in &searched {
                is_better |= improve(&mut tuning, *index, factor, &mut least, sets);
                bar.inc(1);
            }
            if !is_better {
                bar.inc(((MOST_ROUNDS - 1 - round) * searched.len()) as u64);
                break;
            }
        }
    }
    bar.finish_and_clear();
    tuning
}

/// Tries a larger and a smaller value of one number, and returns whether one was better.
fn improve(tuning: &mut Tuning, index: usize, factor: f32, least: &mut f64, sets: &[&Set]) -> bool {
    for factor in [factor, 1.0 / factor] {
        let mut candidate = *tuning;
        if let Some((_, number)) = numbers(&mut candidate).into_iter().nth(index) {
            *number *= factor;
        }
        let cost = cost(sets, &candidate);
        if cost < *least - LEAST_GAIN {
            (*tuning, *least) = (candidate, cost);
            return true;
        }
    }
    false
}

/// Returns the largest changes from the default as text.
fn changes(tuning: &Tuning) -> String {
    let (mut tuning, mut default) = (*tuning, Tuning::DEFAULT);
    let pairs = numbers(&mut tuning).into_iter().zip(numbers(&mut default));
    let mut factors: Vec<(&str, f32)> = pairs
        .map(|((name, new), (_, old))| (name, *new / *old))
        .collect();
    factors.sort_by(|left, right| right.1.ln().abs().total_cmp(&left.1.ln().abs()));
    let largest = factors.iter().take(4);
    let largest: Vec<String> = largest
        .map(|(name, factor)| format!("{name} ×{factor:.2}"))
        .collect();
    largest.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_a_number_of_the_tuning() {
        let mut tuning = Tuning::DEFAULT;
        let names = numbers(&mut tuning).map(|(name, _)| name);
        assert!(SENSOR.iter().all(|kept| names.contains(kept)));
    }

    #[test]
    fn a_search_finds_back_to_a_good_tuning() {
        let flights = Set {
            name: "simulated".to_owned(),
            to_tune: vec![simulated::flight(1)],
            to_judge: None,
        };
        let sets = [&flights];
        let mut wrong = Tuning::DEFAULT;
        wrong.velocity_noise_per_velocity *= 0.2;
        let mut least = cost(&sets, &wrong);
        let start = least;
        let index = numbers(&mut wrong)
            .iter()
            .position(|(name, _)| *name == "velocity_noise_per_velocity")
            .unwrap();
        assert!(improve(&mut wrong, index, 2.0, &mut least, &sets));
        assert!(
            least < start
                && wrong.velocity_noise_per_velocity
                    > 0.3 * Tuning::DEFAULT.velocity_noise_per_velocity
        );
        assert_eq!(least, cost(&sets, &wrong));
        assert!(changes(&wrong).starts_with("velocity_noise_per_velocity ×0.40"));
    }
}
