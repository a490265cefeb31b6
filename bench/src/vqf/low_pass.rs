//! Low-pass filter of the specific force, and of all other signals that VQF smooths.
//!
//! It is a Butterworth filter of second order. It begins with the mean of the first samples, so
//! that its start does not hang on one of them. All is `f64`: at 1 kHz and 3 s the coefficients'
//! sum is 10⁻⁷, and `f32` would change the gain at zero frequency by a quarter.

use std::f64::consts::SQRT_2;

/// Low-pass filter of `N` signals with common coefficients.
pub struct LowPass<const N: usize> {
    /// Factors of the input now, one and two samples ago.
    feedforward: [f64; 3],
    /// Factors of the output one and two samples ago.
    feedback: [f64; 2],
    /// Number of the first samples whose mean counts.
    averaged: u32,
    state: State<N>,
}

enum State<const N: usize> {
    /// Sum of the first samples, and their number.
    Averaging([f64; N], u32),
    /// Contributions of the past to the next two outputs, for each signal.
    Running([[f64; 2]; N]),
}

impl<const N: usize> LowPass<N> {
    /// Creates a filter of this time constant, s, for samples that are `step_s` apart.
    ///
    /// The time constant is that of the envelope of the step response, so the cut-off frequency is
    /// √2 / (2π τ). A time constant below half a step means no filter.
    pub fn new(time_s: f64, step_s: f64) -> Self {
        let (mut feedforward, mut feedback) = ([1.0, 0.0, 0.0], [0.0, 0.0]);
        if time_s >= 0.5 * step_s {
            // Bilinear transform of 1 / (s² + √2 s + 1), with the cut-off frequency prewarped.
            let warped = (step_s / (SQRT_2 * time_s)).tan();
            let square = warped * warped;
            let divisor = 1.0 + SQRT_2 * warped + square;
            let share = square / divisor;
            feedforward = [share, 2.0 * share, share];
            feedback = [
                2.0 * (square - 1.0) / divisor,
                (1.0 - SQRT_2 * warped + square) / divisor,
            ];
        }
        // The rounding keeps a time of a whole number of steps exact.
        let averaged = ((time_s / step_s - 1e-6).ceil() as u32).max(1);
        Self {
            feedforward,
            feedback,
            averaged,
            state: State::Averaging([0.0; N], 0),
        }
    }

    /// Takes one sample, and returns the output.
    pub fn update(&mut self, input: [f64; N]) -> [f64; N] {
        match &mut self.state {
            State::Averaging(sum, count) => {
                for (sum, input) in sum.iter_mut().zip(input) {
                    *sum += input;
                }
                *count += 1;
                let mean = sum.map(|sum| sum / f64::from(*count));
                if *count >= self.averaged {
                    self.state = State::Running(mean.map(|mean| self.settled(mean)));
                }
                mean
            }
            State::Running(past) => {
                let ([now, one, two], [back_one, back_two]) = (self.feedforward, self.feedback);
                let mut output = input;
                for (signal, past) in output.iter_mut().zip(past) {
                    let input = *signal;
                    *signal = now * input + past[0];
                    past[0] = one * input - back_one * *signal + past[1];
                    past[1] = two * input - back_two * *signal;
                }
                output
            }
        }
    }

    /// Returns the state in which a constant input comes out unchanged.
    fn settled(&self, level: f64) -> [f64; 2] {
        let last = (self.feedforward[2] - self.feedback[1]) * level;
        [(1.0 - self.feedforward[0]) * level, last]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The gain at zero frequency is one, also where a step is a 3000th of the time constant.
    #[test]
    fn a_new_level_is_reached_after_a_mean_of_the_first_samples() {
        for (time_s, step_s) in [(3.0, 0.001), (3.0, 0.005), (0.5, 0.0035), (0.05, 0.01)] {
            let mut filter = LowPass::<2>::new(time_s, step_s);
            for index in 0..filter.averaged {
                let [mean, _] = filter.update([f64::from(index), 0.0]);
                assert!((mean - 0.5 * f64::from(index)).abs() < 1e-9);
            }
            let mut output = [0.0; 2];
            for _ in 0..(40.0 * time_s / step_s) as u32 {
                output = filter.update([9.81, -1.0]);
            }
            assert!(
                (output[0] - 9.81).abs() < 1e-6,
                "{time_s} {step_s} {output:?}"
            );
            assert!(
                (output[1] + 1.0).abs() < 1e-6,
                "{time_s} {step_s} {output:?}"
            );
        }
    }
}
