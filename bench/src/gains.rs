//! `aplomb-bench --scan-gains`: the best gains of the filters of others on these recordings.
//!
//! Every gain is tried on every recording with truth. The best has the least mean error, with equal
//! weights for all sets.

use std::fmt::Write as _;

use aplomb_recordings::score::mean;

use crate::filter::{Choice, Filter};
use crate::parallel;
use crate::peers::Gains;
use crate::recording::Recording;

/// Candidates for a gain: six steps a decade.
const GAIN: [f32; 22] = [
    0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5,
    0.7, 1.0, 1.5, 2.0, 3.0, 5.0,
];
const INTEGRAL_GAIN: [f32; 6] = [0.0, 0.0001, 0.0003, 0.001, 0.003, 0.01];
const REJECTION_DEGREES: [f32; 7] = [0.0, 10.0, 20.0, 45.0, 60.0, 90.0, 120.0];
const TIME_S: [f32; 8] = [1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0];

/// Number of the best that are shown.
const SHOWN: usize = 3;

/// Scans, and returns the report.
pub fn scan(recordings: &[Recording]) -> String {
    let mut sets: Vec<&str> = recordings.iter().map(|one| one.set.as_str()).collect();
    sets.dedup();
    let mut text = String::from(
        "\nThe best gains over these recordings: mean error in degrees, every set weighing alike, \
         and of each set\n",
    );
    for choice in Choice::PEERS {
        let mut results = parallel::map_with_bar(choice.name(), &candidates(choice), |gains| {
            let of_set = |set: &&str| {
                let of_set = recordings.iter().filter(|one| one.set == *set);
                let rms: Vec<f64> = of_set.map(|one| rms(one, choice, *gains)).collect();
                mean(&rms)
            };
            let means: Vec<f64> = sets.iter().map(of_set).collect();
            (mean(&means), means, *gains)
        });
        results.sort_by(|left, right| left.0.total_cmp(&right.0));
        let in_use = choice.gains();
        let _ = writeln!(text, "\n{}", choice.name());
        for (rank, (error, means, gains)) in results.iter().enumerate() {
            let is_in_use = Some(*gains) == in_use;
            if rank < SHOWN || is_in_use {
                let means = sets
                    .iter()
                    .zip(means)
                    .fold(String::new(), |text, (set, mean)| {
                        format!("{text}  {set} {mean:.3}")
                    });
                let mark = if is_in_use { "  <- in use" } else { "" };
                let _ = writeln!(text, "  {gains:?}  {error:.3}{means}{mark}");
            }
        }
    }
    text
}

fn rms(recording: &Recording, choice: Choice, gains: Gains) -> f64 {
    let step_s = recording.step_s();
    recording.rms(Filter::with_gains(
        choice,
        step_s,
        recording.delay_us,
        Some(gains),
    ))
}

/// Returns the candidates, the gains in use included.
fn candidates(choice: Choice) -> Vec<Gains> {
    let pairs = |first: &[f32], second: &[f32]| -> Vec<Gains> {
        let pairs = first
            .iter()
            .flat_map(|first| second.iter().map(|second| [*first, *second]));
        pairs.collect()
    };
    let mut candidates = match choice {
        Choice::Kalman | Choice::AxisKalman | Choice::Classic => Vec::new(),
        Choice::Mahony => pairs(&GAIN, &INTEGRAL_GAIN),
        Choice::Madgwick => pairs(&GAIN, &[0.0]),
        Choice::Fusion => pairs(&GAIN, &REJECTION_DEGREES),
        Choice::Vqf => pairs(&TIME_S, &[0.0]),
    };
    candidates.extend(choice.gains().filter(|gains| !candidates.contains(gains)));
    candidates
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::flight;

    #[test]
    fn gains_make_a_difference_and_those_in_use_are_tried() {
        let recording = flight(1);
        for choice in Choice::PEERS {
            let candidates = candidates(choice);
            assert!(candidates.contains(&choice.gains().unwrap()));
            let errors = [candidates[0], candidates[candidates.len() - 1]]
                .map(|gains| rms(&recording, choice, gains));
            assert!(errors.iter().all(|error| error.is_finite()));
            assert_ne!(errors[0], errors[1], "{}", choice.name());
        }
    }
}
