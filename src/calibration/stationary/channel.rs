//! Statistics of one sensor's three axes: exact sums over a window and over the windows before.

use super::super::axis::Axis;
use super::super::noise::{
    MEASURED_NOISE_SIGMA, MeasuredNoise, NOISE_TOLERANCE, ROUNDING_VARIANCE,
    chi_squared_per_freedom,
};
use crate::attitude::Vector3;

/// Test limit in standard deviations: one sample of 3.5 million lies beyond it, on one side.
const LIMIT_SIGMA: f32 = 5.0;
/// Shortest series of windows that can show a trend.
pub(super) const MIN_TREND_WINDOWS: u16 = 3;

/// The largest sum, 65535 samples of −32768, fits its integer.
const _: () = assert!((u16::MAX as i64) * (i16::MIN as i64) >= i32::MIN as i64);

/// Positions of the closed windows on the time line, in windows, weighted with their samples.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Positions {
    pub(super) windows: u16,
    samples: f32,
    sum: f32,
    squares: f32,
}

impl Positions {
    pub(super) const NONE: Self = Self {
        windows: 0,
        samples: 0.0,
        sum: 0.0,
        squares: 0.0,
    };

    pub(super) fn add(&mut self, samples: f32, position: f32) {
        self.windows += 1;
        self.samples += samples;
        self.sum += samples * position;
        self.squares += samples * position * position;
    }
}

/// Sums of three axes.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Channel {
    /// σ of one sample by the datasheet, counts.
    sigma: f32,
    /// Samples per independent sample.
    correlation: f32,
    /// First sample of the open window.
    first: [i16; 3],
    /// Σd of the open window, with d the difference from its first sample.
    difference_sum: [i32; 3],
    /// Σd² of the open window.
    square_sum: [u64; 3],
    /// Axes that read full scale in the open window.
    pub(super) is_saturated: [bool; 3],
    /// Σx of the closed windows.
    sum: [i32; 3],
    /// Σ(x − mean of the window)² of the closed windows.
    deviation: [f32; 3],
    /// Mean of the first closed window.
    reference: [f32; 3],
    /// Σn·(mean − reference) of the closed windows.
    change_sum: [f32; 3],
    /// Σn·(mean − reference)·position of the closed windows.
    moment_sum: [f32; 3],
    /// Noise of each axis, which outlives a restart.
    noise: [MeasuredNoise; 3],
}

/// Statistics of one closed window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    /// Mean, counts.
    pub(super) mean: [f32; 3],
    /// Σ(x − mean)², counts².
    deviation: [f32; 3],
    /// Σx, counts.
    sum: [i32; 3],
}

impl Channel {
    pub(super) const fn new(sigma: f32, correlation: f32) -> Self {
        Self {
            sigma,
            correlation,
            first: [0; 3],
            difference_sum: [0; 3],
            square_sum: [0; 3],
            is_saturated: [false; 3],
            sum: [0; 3],
            deviation: [0.0; 3],
            reference: [0.0; 3],
            change_sum: [0.0; 3],
            moment_sum: [0.0; 3],
            noise: [MeasuredNoise::NONE; 3],
        }
    }

    /// Clears all sums and keeps the measured noise.
    #[inline(never)]
    pub(super) fn restart(&mut self) {
        let noise = self.noise;
        *self = Self {
            noise,
            ..Self::new(self.sigma, self.correlation)
        };
    }

    /// Adds a sample to the open window; `is_first` opens a new one.
    pub(super) fn add(&mut self, counts: [i16; 3], is_first: bool) {
        if is_first {
            self.first = counts;
            self.difference_sum = [0; 3];
            self.square_sum = [0; 3];
            self.is_saturated = [false; 3];
        }
        let sums = self.difference_sum.iter_mut().zip(&mut self.square_sum);
        let axes = counts.iter().zip(&self.first).zip(&mut self.is_saturated);
        for (((count, first), is_saturated), (sum, square_sum)) in axes.zip(sums) {
            let difference = i32::from(*count) - i32::from(*first);
            *sum += difference;
            let magnitude = difference.unsigned_abs();
            // At most 65535, whose square fits.
            *square_sum += u64::from(magnitude * magnitude);
            *is_saturated |= count.unsigned_abs() >= i16::MAX.unsigned_abs();
        }
    }

    /// Closes the window after this many samples and returns its statistics.
    pub(super) fn close(&mut self, samples: u16) -> Window {
        let mut window = Window {
            mean: [0.0; 3],
            deviation: [0.0; 3],
            sum: [0; 3],
        };
        let sums = self
            .difference_sum
            .iter()
            .zip(&self.square_sum)
            .zip(&self.first);
        let out = window
            .mean
            .iter_mut()
            .zip(&mut window.deviation)
            .zip(&mut window.sum);
        for (((difference, square), first), ((mean, deviation), sum)) in sums.zip(out) {
            let n = i64::from(samples);
            // n·Σd² − (Σd)² is exact and not negative.
            let scaled = n * *square as i64 - i64::from(*difference) * i64::from(*difference);
            *deviation = scaled as f32 / f32::from(samples);
            *mean = f32::from(*first) + *difference as f32 / f32::from(samples);
            *sum = i32::from(*first) * i32::from(samples) + difference;
        }
        window
    }

    /// Returns the first axis whose variance is beyond the noise; the other axes update their
    /// noise.
    pub(super) fn noisy_axis(&mut self, window: &Window, samples: u16) -> Option<Axis> {
        let freedom = (f32::from(samples) / self.correlation - 1.0).max(1.0);
        let upper = chi_squared_per_freedom(freedom, LIMIT_SIGMA);
        let lower = chi_squared_per_freedom(freedom, -MEASURED_NOISE_SIGMA);
        let datasheet = self.sigma * self.sigma;
        let mut is_noisy = [false; 3];
        let axes = window.deviation.iter().zip(&mut self.noise);
        for ((deviation, measured), is_noisy) in axes.zip(&mut is_noisy) {
            let variance = deviation / (f32::from(samples) - 1.0).max(1.0);
            let noise = measured
                .upper_limit()
                .max(datasheet)
                .min(NOISE_TOLERANCE * NOISE_TOLERANCE * datasheet);
            *is_noisy = variance > upper * noise;
            if !*is_noisy {
                measured.update(variance, freedom, lower);
            }
        }
        first_axis(is_noisy)
    }

    /// Returns the first axis whose mean differs from that of the `before` samples in earlier
    /// windows.
    pub(super) fn drifting_axis(&self, window: &Window, samples: u16, before: u16) -> Option<Axis> {
        if before == 0 {
            return None;
        }
        let mut is_drifting = [false; 3];
        let axes = window.mean.iter().zip(&self.sum).zip(&self.deviation);
        for (((mean, sum), deviation), is_drifting) in axes.zip(&mut is_drifting) {
            let mean_before = *sum as f32 / f32::from(before);
            let noise = self.variance(*deviation, before) * self.correlation;
            let variance = noise * (1.0 / f32::from(samples) + 1.0 / f32::from(before))
                + 2.0 * ROUNDING_VARIANCE;
            let difference = mean - mean_before;
            *is_drifting = difference * difference > LIMIT_SIGMA * LIMIT_SIGMA * variance;
        }
        first_axis(is_drifting)
    }

    /// Adds a window at this position, in windows, to the closed ones.
    pub(super) fn join(&mut self, window: &Window, samples: u16, position: f32) {
        if position < 1.0 {
            self.reference = window.mean;
        }
        for (sum, window) in self.sum.iter_mut().zip(window.sum) {
            *sum += window;
        }
        for (deviation, window) in self.deviation.iter_mut().zip(window.deviation) {
            *deviation += window;
        }
        let samples = f32::from(samples);
        let axes = window.mean.iter().zip(&self.reference);
        let sums = self.change_sum.iter_mut().zip(&mut self.moment_sum);
        for ((mean, reference), (change_sum, moment_sum)) in axes.zip(sums) {
            let change = samples * (mean - reference);
            *change_sum += change;
            *moment_sum += change * position;
        }
    }

    /// Returns the first axis whose window means lie on a slope: the least-squares line through
    /// them, each window weighted with its samples.
    pub(super) fn trending_axis(&self, positions: &Positions, window_samples: u16) -> Option<Axis> {
        let Positions {
            windows,
            samples,
            sum,
            squares,
        } = *positions;
        let spread = squares - sum * sum / samples;
        if windows < MIN_TREND_WINDOWS || spread <= 0.0 {
            return None;
        }
        let mut is_trending = [false; 3];
        let sums = self.change_sum.iter().zip(&self.moment_sum);
        let axes = sums.zip(&self.deviation).zip(&mut is_trending);
        for (((change_sum, moment_sum), deviation), is_trending) in axes {
            let slope = (moment_sum - change_sum * sum / samples) / spread;
            let noise = (deviation / samples).max(self.sigma * self.sigma) * self.correlation;
            let rounding = ROUNDING_VARIANCE * f32::from(window_samples);
            let variance = (noise + rounding) / spread;
            *is_trending = slope * slope > LIMIT_SIGMA * LIMIT_SIGMA * variance;
        }
        first_axis(is_trending)
    }

    /// Returns the variance of one sample: the measured one, at least the datasheet's.
    fn variance(&self, deviation: f32, samples: u16) -> f32 {
        (deviation / (f32::from(samples) - 1.0).max(1.0)).max(self.sigma * self.sigma)
    }

    /// Returns the variance of the mean on the noisiest axis, counts².
    pub(super) fn mean_variance(&self, samples: u16) -> f32 {
        let [x, y, z] = self.deviation;
        let variance = self.variance(x.max(y).max(z), samples);
        variance * self.correlation / f32::from(samples.max(1)) + ROUNDING_VARIANCE
    }

    /// Returns the mean of the closed windows, counts.
    pub(super) fn mean(&self, samples: u16) -> Vector3 {
        let [x, y, z] = self.sum.map(|sum| {
            // An `f32` has 24 bits, so the whole part and the rest are divided apart.
            let (sum, samples) = (sum, i32::from(samples.max(1)));
            (sum / samples) as f32 + (sum % samples) as f32 / samples as f32
        });
        Vector3::new(x, y, z)
    }

    /// Returns the σ of one sample within the closed windows, counts.
    pub(super) fn sigma(&self, samples: u16, windows: u16) -> Vector3 {
        let freedom = (f32::from(samples) - f32::from(windows)).max(1.0);
        let [x, y, z] = self
            .deviation
            .map(|deviation| libm::sqrtf(deviation / freedom));
        Vector3::new(x, y, z)
    }
}

/// Returns the first axis whose element is true.
pub(super) fn first_axis(is: [bool; 3]) -> Option<Axis> {
    Axis::ALL
        .into_iter()
        .zip(is)
        .find_map(|(axis, is)| is.then_some(axis))
}
