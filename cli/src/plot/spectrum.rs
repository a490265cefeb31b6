//! Spectrum of vibration: the power spectral density of the specific force, by Welch's method.
//!
//! Pieces of equal length overlap by half. Each loses its mean and gets Hann's window. The spectrum
//! is the mean of their periodograms (P. D. Welch, IEEE Transactions on Audio and Electroacoustics
//! 15(2), 1967). Fixed memory, however long the recording.

use std::sync::Arc;

use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};

/// Samples of a piece: a resolution of about 1 Hz at 1 kHz.
pub const LENGTH: usize = 1024;

/// Lowest frequency of vibration, Hz. Slower motion is that of the body.
const VIBRATION_HZ: f64 = 20.0;

/// Longest step between samples, as a multiple of the mean. A longer one means missing samples.
const LONGEST_STEP: f64 = 2.5;

/// Collector of samples for their spectrum.
pub struct Welch {
    transform: Arc<dyn RealToComplex<f64>>,
    window: Vec<f64>,
    times_s: Vec<f64>,
    /// x, y and z of the present piece.
    axes: [Vec<f64>; 3],
    /// Sums of the squares of the transforms.
    powers: [Vec<f64>; 3],
    pieces: u32,
    /// Duration of all pieces, s.
    duration_s: f64,
}

/// Power spectral densities.
pub struct Spectrum {
    /// Step between two values, Hz.
    pub step_hz: f64,
    /// Densities of x, y and z from 0 Hz on, (m/s²)²/Hz.
    pub axes: [Vec<f64>; 3],
}

/// Values whose means are searched for peaks.
const SMOOTHED: usize = 9;
/// Least prominence of a peak: 10 dB, more than the noise of such a mean.
const LEAST_PROMINENCE: f64 = 10.0;

/// Vibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Frequency of the most prominent peak, if there is one.
    pub peak_hz: Option<f64>,
    /// Root mean square above `from_hz`, all axes together.
    pub rms_m_s2: f64,
    /// Lowest frequency of the root mean square.
    pub from_hz: f64,
}

impl Welch {
    /// Creates a collector without samples.
    pub fn new() -> Self {
        let transform = RealFftPlanner::new().plan_fft_forward(LENGTH);
        let hann = |nth: usize| {
            let phase = std::f64::consts::TAU * nth as f64 / LENGTH as f64;
            0.5 - 0.5 * phase.cos()
        };
        Self {
            transform,
            window: (0..LENGTH).map(hann).collect(),
            times_s: Vec::with_capacity(LENGTH),
            axes: Default::default(),
            powers: [(); 3].map(|()| vec![0.0; LENGTH / 2 + 1]),
            pieces: 0,
            duration_s: 0.0,
        }
    }

    /// Takes a sample. A value that is not finite, or time that goes back, begins a new piece.
    pub fn add(&mut self, time_s: f64, sample: [f64; 3]) {
        let goes_on = self.times_s.last().is_none_or(|last_s| *last_s < time_s);
        if !goes_on || sample.iter().any(|value| !value.is_finite()) {
            self.forget(self.times_s.len());
            return;
        }
        self.times_s.push(time_s);
        for (axis, value) in self.axes.iter_mut().zip(sample) {
            axis.push(value);
        }
        if self.times_s.len() == LENGTH {
            self.take_piece();
            self.forget(LENGTH / 2);
        }
    }

    fn forget(&mut self, samples: usize) {
        self.times_s.drain(..samples);
        for axis in &mut self.axes {
            axis.drain(..samples);
        }
    }

    fn take_piece(&mut self) {
        let steps = self.times_s.windows(2).map(|pair| pair[1] - pair[0]);
        let (total, longest) = steps.fold((0.0, 0.0), |(total, longest), step| {
            (total + step, f64::max(longest, step))
        });
        if longest > LONGEST_STEP * total / (LENGTH - 1) as f64 {
            return;
        }
        self.pieces += 1;
        self.duration_s += total;
        let mut transformed = self.transform.make_output_vec();
        for (axis, power) in self.axes.iter().zip(&mut self.powers) {
            let mean = axis.iter().sum::<f64>() / LENGTH as f64;
            let windowed = axis.iter().zip(&self.window);
            let mut windowed: Vec<f64> = windowed
                .map(|(value, window)| (value - mean) * window)
                .collect();
            // The lengths are those of the plan, so this does not fail.
            if self
                .transform
                .process(&mut windowed, &mut transformed)
                .is_err()
            {
                continue;
            }
            for (sum, value) in power.iter_mut().zip(&transformed) {
                *sum += Complex::norm_sqr(value);
            }
        }
    }

    /// Returns the spectrum; `None` without a whole piece.
    pub fn spectrum(&self) -> Option<Spectrum> {
        if self.pieces == 0 {
            return None;
        }
        let rate_hz = f64::from(self.pieces) * (LENGTH - 1) as f64 / self.duration_s;
        let window_power: f64 = self.window.iter().map(|window| window * window).sum();
        // Both halves of the spectrum in one.
        let factor = 2.0 / (rate_hz * window_power * f64::from(self.pieces));
        let axes = self.powers.each_ref();
        Some(Spectrum {
            step_hz: rate_hz / LENGTH as f64,
            axes: axes.map(|power| power.iter().map(|sum| sum * factor).collect()),
        })
    }
}

impl Spectrum {
    /// Returns the highest frequency, Hz.
    pub fn end_hz(&self) -> f64 {
        (LENGTH / 2) as f64 * self.step_hz
    }

    /// Returns the vibration; `None` if the samples are too slow to show it.
    pub fn vibration(&self) -> Option<Vibration> {
        let first = (VIBRATION_HZ / self.step_hz).ceil() as usize;
        let total = |index: usize| self.axes.iter().map(|axis| axis[index]).sum::<f64>();
        let fast: Vec<f64> = (first..LENGTH / 2).map(total).collect();
        if fast.is_empty() {
            return None;
        }
        let around = |index: usize| {
            index.saturating_sub(SMOOTHED / 2)..fast.len().min(index + SMOOTHED / 2 + 1)
        };
        let smooth: Vec<f64> = (0..fast.len())
            .map(|index| {
                let around = around(index);
                fast[around.clone()].iter().sum::<f64>() / around.len() as f64
            })
            .collect();
        let prominences = (0..smooth.len()).map(|index| (prominence(&smooth, index), index));
        let peak = prominences
            .max_by(|one, other| one.0.total_cmp(&other.0))
            .filter(|(prominence, _)| *prominence >= LEAST_PROMINENCE)
            .and_then(|(_, index)| around(index).max_by(|&a, &b| fast[a].total_cmp(&fast[b])));
        Some(Vibration {
            peak_hz: peak.map(|index| (first + index) as f64 * self.step_hz),
            rms_m_s2: (fast.iter().sum::<f64>() * self.step_hz).sqrt(),
            from_hz: first as f64 * self.step_hz,
        })
    }
}

/// Returns the prominence of a value: the factor down to the deepest point on the way to a higher
/// value, or to the end, on the side where it is less.
fn prominence(values: &[f64], index: usize) -> f64 {
    let value = values[index];
    let lowest = |walk: &mut dyn Iterator<Item = &f64>| {
        walk.take_while(|other| **other <= value)
            .fold(value, |low, other| low.min(*other))
    };
    let before = lowest(&mut values[..index].iter().rev());
    let after = lowest(&mut values[index..].iter());
    value / before.max(after).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns uniform white noise of this σ.
    fn noise(sigma: f64) -> impl FnMut() -> f64 {
        let mut random = 1_u32;
        move || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sigma * 12_f64.sqrt() * (f64::from(random) / f64::from(u32::MAX) - 0.5)
        }
    }

    #[test]
    fn a_sine_has_its_frequency_and_its_power() {
        let mut welch = Welch::new();
        for nth in 0..20_000 {
            let time_s = f64::from(nth) * 1e-3;
            let phase = std::f64::consts::TAU * 118.0 * time_s;
            welch.add(time_s, [0.0, 3.0 * phase.sin(), -9.8]);
        }
        let spectrum = welch.spectrum().unwrap();
        let vibration = spectrum.vibration().unwrap();
        assert!(
            (vibration.peak_hz.unwrap() - 118.0).abs() < 0.6,
            "{vibration:?}"
        );
        // The mean square of a sine is half its amplitude's square.
        let expected = (0.5 * 9.0_f64).sqrt();
        assert!(
            (vibration.rms_m_s2 - expected).abs() < 0.01 * expected,
            "{vibration:?}"
        );
        assert!((spectrum.end_hz() - 500.0).abs() < 1e-6);
        // Gravity is no vibration.
        assert!(spectrum.axes[2].iter().all(|power| *power < 1e-20));
    }

    #[test]
    fn the_density_of_white_noise_is_its_variance_over_half_the_rate() {
        let mut welch = Welch::new();
        let mut noise = noise(0.2);
        for nth in 0..200_000 {
            welch.add(f64::from(nth) * 5e-3, [noise(), 0.0, 0.0]);
        }
        let spectrum = welch.spectrum().unwrap();
        let inner = &spectrum.axes[0][2..LENGTH / 2];
        let mean = inner.iter().sum::<f64>() / inner.len() as f64;
        let expected = 0.04 / 100.0;
        assert!(
            (mean - expected).abs() < 0.02 * expected,
            "{mean} {expected}"
        );
    }

    #[test]
    fn a_slope_is_no_peak_and_one_on_a_slope_is() {
        let slope: Vec<f64> = (0..100).map(|nth| 1.0 / f64::from(nth + 1)).collect();
        assert_eq!(prominence(&slope, 0), 1.0);
        assert_eq!(prominence(&slope, 50), 1.0);
        let mut hill = slope.clone();
        hill[50] = 0.5;
        assert!((prominence(&hill, 50) - 0.5 * 50.0).abs() < 1e-9);
    }

    #[test]
    fn even_the_noise_of_one_piece_has_no_peak() {
        let mut noise = noise(0.2);
        for _ in 0..50 {
            let mut welch = Welch::new();
            for nth in 0..LENGTH {
                welch.add(nth as f64 * 1e-3, [noise(), noise(), noise()]);
            }
            assert_eq!(welch.spectrum().unwrap().vibration().unwrap().peak_hz, None);
        }
    }

    #[test]
    fn pieces_with_holes_do_not_count() {
        let mut welch = Welch::new();
        let mut add = |samples: std::ops::Range<u32>| {
            for nth in samples {
                welch.add(f64::from(nth) * 1e-3, [f64::from(nth % 2), 0.0, 0.0]);
            }
        };
        add(0..1_000);
        add(1_050..1_500);
        assert!(welch.spectrum().is_none());
        welch.add(1.5, [f64::NAN, 0.0, 0.0]);
        assert!(welch.times_s.is_empty());
        welch.add(1.0, [0.0; 3]);
        welch.add(0.5, [0.0; 3]);
        assert!(welch.times_s.is_empty(), "time went back");
    }

    #[test]
    fn slow_samples_show_no_vibration() {
        let mut welch = Welch::new();
        for nth in 0..3_000 {
            welch.add(f64::from(nth) * 0.05, [f64::from(nth % 3), 0.0, 0.0]);
        }
        assert_eq!(welch.spectrum().unwrap().vibration(), None);
    }
}
