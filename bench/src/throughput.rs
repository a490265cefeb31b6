//! Throughput of each filter on this computer, in samples a second.
//!
//! All filters get the samples in memory and in their own axes; the steps of the peers are computed
//! beforehand. Only the update is measured: sample in, attitude out. The filters run in turn, so
//! that other load falls on all of them. Each figure is the median over the rounds, and a ratio is
//! the median of the rounds' ratios. On a busy computer the fastest rounds were disturbed least,
//! and are more reliable.

use std::fmt::Write as _;
use std::hint::black_box;
use std::time::Instant;

use aplomb::estimator::classic::{AxisKalman, Tutorial};
use aplomb::estimator::kalman::Kalman;
use aplomb::estimator::{Estimator, Filter, Sample};

use aplomb_recordings::score::median;

use crate::filter::Choice;
use crate::peers::{self, Fusion, Madgwick, Mahony, Step, Vqf, tilt};
use crate::recording::Recording;

/// Runs of each filter through the recording.
const ROUNDS: usize = 25;

/// Measures every filter, and returns the report.
pub fn measure(recording: &Recording) -> String {
    let step_s = recording.step_s();
    let samples = &recording.samples;
    let steps: Vec<Step> = samples
        .iter()
        .zip(samples.iter().skip(1))
        .map(|(before, after)| Step::new(before, after))
        .collect();
    let choices = Choice::ALL;
    // Seconds, by filter and round.
    let mut seconds = vec![Vec::new(); choices.len()];
    for _ in 0..ROUNDS {
        for (choice, seconds) in choices.iter().zip(&mut seconds) {
            let start = Instant::now();
            run(*choice, step_s, samples, &steps);
            seconds.push(start.elapsed().as_secs_f64());
        }
    }
    let ours = choices.first().map_or("", |choice| choice.name());
    let mut text = format!(
        "\nThroughput of the update alone on this computer, one core, {} samples in memory, \
         median of {ROUNDS} rounds\n\n",
        samples.len()
    );
    for (choice, of_this) in choices.iter().zip(&seconds) {
        let millions_per_s = samples.len() as f64 / middle(of_this.iter().copied()) * 1e-6;
        let of_ours = seconds.first().into_iter().flatten();
        let ratios = of_ours.clone().zip(of_this);
        let ratio = middle(ratios.map(|(ours, this)| ours / this));
        let of_fastest = fastest(of_ours) / fastest(of_this.iter());
        let _ = writeln!(
            text,
            "{:<12}{millions_per_s:>7.1} million/s, {ratio:.2} times {ours}; \
             by the fastest rounds {of_fastest:.2}",
            choice.name()
        );
    }
    text
}

fn fastest<'a>(seconds: impl Iterator<Item = &'a f64>) -> f64 {
    seconds.copied().fold(f64::INFINITY, f64::min)
}

fn middle(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.collect();
    numbers.sort_by(f64::total_cmp);
    median(&numbers)
}

fn run(choice: Choice, step_s: f32, samples: &[Sample], steps: &[Step]) {
    match choice {
        // The filter is the estimator's type, as in the firmware.
        Choice::Kalman => run_library(Kalman::new(), samples),
        Choice::AxisKalman => run_library(AxisKalman::new(), samples),
        Choice::Classic => run_library(Tutorial::new(), samples),
        Choice::Vqf => run_peer::<Vqf>(step_s, steps),
        Choice::Fusion => run_peer::<Fusion>(step_s, steps),
        Choice::Madgwick => run_peer::<Madgwick>(step_s, steps),
        Choice::Mahony => run_peer::<Mahony>(step_s, steps),
    }
}

fn run_library<F: Filter>(filter: F, samples: &[Sample]) {
    let mut estimator = Estimator::with_filter(filter);
    for sample in samples {
        black_box(estimator.update(black_box(sample)));
    }
}

fn run_peer<F: peers::Filter>(step_s: f32, steps: &[Step]) {
    let start = steps.first().map_or([0.0, 0.0, 1.0], |step| step.force);
    let mut filter = F::new(tilt(start), step_s, F::GAINS);
    for step in steps {
        filter.step(black_box(step));
        black_box(filter.attitude());
    }
}
