//! Frozen data among samples in SI units, such as those of a recording.
//!
//! Registers have a known resolution and noise, samples do not: a table may hold few digits, or a
//! simulation without noise. Therefore an axis counts only once it has shown noise. A window of 25
//! samples without motion shows an axis's noise if the axis reverses eight times and reads three
//! values. Weak noise between two digits reads only two. Each such window adds one to a score, each
//! other one subtracts three, and eight is the proof. Half a digit of noise is enough for it, and
//! repeats a whole window once in 10⁷ times.
//!
//! - An axis that has proved its noise and repeats its value is stuck, by the windows of
//!   [`StuckAxis`].
//! - Once all axes have proved theirs, samples that repeat as a whole are frozen: after the time
//!   that holds for bursts, and four times the longest of two repetitions in a row before. A
//!   recording whose values are held for several rows stays unflagged.
//!
//! Without 200 samples of rest, 1/bandwidth apart, nothing is flagged: 1.1 s of a fast recording,
//! and 4 s at 50 Hz.

use super::stuck_axis::{MOTION_DEGREES_S, MOTION_G, StuckAxis, Values, WINDOW_SAMPLES};
use crate::attitude::Vector3;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Accelerometer, gyroscope.
const AXES: usize = 6;
/// All axes, a bit each.
const ALL_AXES: u8 = 0b11_1111;
/// Axes of the accelerometer, a bit each.
const FORCE_AXES: u8 = 0b00_0111;

/// Change over a window that noise does not reach, m/s² and rad/s.
const MOTION: [f32; AXES] = {
    let force = MOTION_G * STANDARD_GRAVITY_M_S2;
    let rate = radians(MOTION_DEGREES_S);
    [force, force, force, rate, rate, rate]
};

/// Reversals of an axis in a window that show its noise. Noise of a fine resolution has 16 of 25
/// samples, motion one or two.
const NOISE_REVERSALS: u8 = 8;
/// Score that proves the noise of an axis.
const PROVEN: u8 = 8;
/// Loss of score with a window that shows no noise.
const LOSS: u8 = 3;

/// Time of identical samples that are frozen, s. A logger may write a sample for a few rows.
const FROZEN_S: f32 = 0.099;
/// Fewest compared samples that repeat within it.
const FEWEST_FROZEN: u16 = 5;

/// Repetitions that are no fault, as a multiple of those of held values.
const HELD: u16 = 4;

/// Sampling of a sensor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sampling {
    /// Sample rate, Hz.
    pub(crate) rate_hz: f32,
    /// Bandwidth of the low-pass filter, Hz.
    pub(crate) bandwidth_hz: u16,
}

/// Monitor of samples in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct SampleMonitor {
    is_frozen: bool,
    samples_to_next: u8,
    /// Last sample that was compared.
    last: [f32; AXES],
    /// Compared samples in a row that repeat it.
    repetitions: u16,
    /// Repetitions of the value before.
    repetitions_before: u16,
    /// Most repetitions of two values in a row: each value is held for so long.
    held: u16,
    noise: Noise,
    stuck_axis: StuckAxis<Axes>,
}

impl SampleMonitor {
    /// Creates a monitor without a sample.
    pub(crate) fn new() -> Self {
        Self {
            is_frozen: false,
            samples_to_next: 1,
            last: [0.0; AXES],
            repetitions: 0,
            repetitions_before: 0,
            held: 0,
            noise: Noise::default(),
            stuck_axis: StuckAxis::with_gap(1),
        }
    }

    /// Takes force (m/s²) and rates (rad/s), and whether each of them reads full scale. Returns
    /// whether the sample is frozen, or one of its axes is.
    #[inline]
    pub(crate) fn is_frozen(
        &mut self,
        values: [&Vector3; 2],
        is_saturated: [bool; 2],
        sampling: impl Fn() -> Sampling,
    ) -> bool {
        self.samples_to_next -= 1;
        if self.samples_to_next == 0 {
            self.compare(values, is_saturated, sampling());
        }
        self.is_frozen
    }

    /// Compares a sample with the last one. The samples of a repetition are all compared once it
    /// is frozen, to see its end at once.
    #[inline(never)]
    fn compare(
        &mut self,
        [force, rates]: [&Vector3; 2],
        is_saturated: [bool; 2],
        sampling: Sampling,
    ) {
        let values = [force.x, force.y, force.z, rates.x, rates.y, rates.z];
        // Samples between have no noise of their own.
        let gap = ((sampling.rate_hz / f32::from(sampling.bandwidth_hz)) as u8).max(1);
        let frozen_samples = (FROZEN_S * sampling.rate_hz) as u16 / u16::from(gap);
        let held = self.held.saturating_mul(HELD);
        let limit = frozen_samples.max(FEWEST_FROZEN).max(held);
        if difference(&self.last, &values) == 0 {
            self.repetitions = self.repetitions.saturating_add(1);
        } else {
            if !self.is_repeated(limit) {
                let both = self.repetitions.min(self.repetitions_before);
                self.held = self.held.max(both);
                self.repetitions_before = self.repetitions;
            }
            self.repetitions = 0;
            self.last = values;
            self.check_axes(values, is_saturated);
        }
        let is_repeated = self.is_repeated(limit);
        self.samples_to_next = if is_repeated { 1 } else { gap };
        self.is_frozen = is_repeated || self.stuck_axis.is_stuck();
    }

    fn is_repeated(&self, limit: u16) -> bool {
        self.repetitions >= limit && self.noise.unproven() == 0
    }

    /// Checks the axes of a sample that does not repeat the last one.
    fn check_axes(&mut self, values: [f32; AXES], is_saturated: [bool; 2]) {
        // The estimator rejects what is no number.
        if values.iter().all(|value| value.is_finite()) {
            if self.noise.unproven() != 0 {
                self.noise.update(&values);
            }
            let excused = self.noise.unproven() | saturated(is_saturated);
            self.stuck_axis.update(&Axes { values, excused });
        }
    }
}

/// Axes of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Axes {
    values: [f32; AXES],
    /// Axes whose repetition means nothing, a bit each.
    excused: u8,
}

impl Values for Axes {
    const AXES: u8 = ALL_AXES;

    type Motion = ();

    fn add_changed(&self, later: &Self, changed: &mut u8) {
        *changed |= difference(&self.values, &later.values);
    }

    fn add_excused(&self, last: &Self, (): &(), changed: &mut u8) -> bool {
        *changed |= self.excused | last.excused;
        has_moved(&self.values, &last.values)
    }
}

/// Proof that each axis has noise of more than its resolution.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Noise {
    first: [f32; AXES],
    last: [f32; AXES],
    /// Second value of each axis in the window, once it has one.
    second: [Option<f32>; AXES],
    /// Axes that have read a third value, a bit each.
    third: u8,
    samples_to_end: u8,
    /// Axes whose last change was upwards, a bit each.
    is_rising: u8,
    reversals: [u8; AXES],
    scores: [u8; AXES],
}

impl Noise {
    fn update(&mut self, values: &[f32; AXES]) {
        if self.samples_to_end == 0 {
            if !has_moved(&self.first, values) {
                self.score();
            }
            (self.first, self.reversals) = (*values, [0; AXES]);
            (self.second, self.third) = ([None; AXES], 0);
            self.samples_to_end = WINDOW_SAMPLES;
        }
        let axes = self.reversals.iter_mut().zip(values).zip(&self.last);
        for (axis, ((reversals, value), last)) in axes.enumerate() {
            let is_rising = value > last;
            if value != last && is_rising != (self.is_rising >> axis & 1 != 0) {
                self.is_rising ^= 1 << axis;
                *reversals += 1;
            }
            if *value != self.first[axis] {
                let second = *self.second[axis].get_or_insert(*value);
                self.third |= u8::from(*value != second) << axis;
            }
        }
        self.last = *values;
        self.samples_to_end -= 1;
    }

    /// Scores a window without motion. A proof is final.
    fn score(&mut self) {
        let axes = self.scores.iter_mut().zip(self.reversals);
        for (axis, (score, reversals)) in axes.enumerate() {
            if *score < PROVEN {
                let has_third = self.third >> axis & 1 != 0;
                *score = if reversals < NOISE_REVERSALS || !has_third {
                    score.saturating_sub(LOSS)
                } else {
                    *score + 1
                };
            }
        }
    }

    /// Returns the axes that have not proved their noise, a bit each.
    fn unproven(&self) -> u8 {
        let scores = self.scores.iter().enumerate();
        scores.fold(0, |axes, (axis, score)| {
            axes | u8::from(*score < PROVEN) << axis
        })
    }
}

/// Returns the axes that differ in a bit, a bit each.
fn difference(first: &[f32; AXES], later: &[f32; AXES]) -> u8 {
    let pairs = first.iter().zip(later).enumerate();
    pairs.fold(0, |axes, (axis, (first, later))| {
        axes | u8::from(first.to_bits() != later.to_bits()) << axis
    })
}

/// Returns whether an axis moves from one sample to another.
fn has_moved(first: &[f32; AXES], last: &[f32; AXES]) -> bool {
    let pairs = first.iter().zip(last).zip(MOTION);
    pairs
        .into_iter()
        .any(|((first, last), motion)| (last - first).abs() > motion)
}

/// Returns the axes of the sensors that read full scale, a bit each.
fn saturated([force, rates]: [bool; 2]) -> u8 {
    let mut axes = 0;
    if force {
        axes |= FORCE_AXES;
    }
    if rates {
        axes |= ALL_AXES & !FORCE_AXES;
    }
    axes
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f32 = 286.0;
    const SAMPLING: Sampling = Sampling {
        rate_hz: RATE_HZ,
        bandwidth_hz: 188,
    };

    /// Random numbers (a linear congruence with the multiplier of Numerical Recipes).
    struct Random(u32);

    impl Random {
        /// Returns a number of mean 0 and σ 1: the sum of twelve uniform ones.
        fn normal(&mut self) -> f32 {
            (0..12).fold(-6.0, |sum, _| {
                self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum + (self.0 >> 8) as f32 / 16_777_216.0
            })
        }
    }

    /// Recording of a sensor that rests for four seconds, and then swings about its forward axis.
    #[derive(Clone, Copy)]
    struct Swing {
        /// Noise of the rates, rad/s; ten times as much of the force, m/s².
        noise: f32,
        /// Digits of the rates, rad/s; ten times as much of the force, m/s².
        digit: f32,
        /// Rows for which each sample is held.
        rows: u32,
        /// Axes that repeat their value from eight to twelve seconds.
        stuck: &'static [usize],
    }

    /// Noise of an MPU-6050, in fine digits.
    const USUAL: Swing = Swing {
        noise: 0.001,
        digit: 1.0e-6,
        rows: 1,
        stuck: &[],
    };

    impl Swing {
        /// Returns the first and the last time of a frozen row, s; `None` without one.
        fn frozen_s(&self) -> Option<(f32, f32)> {
            let mut random = Random(1);
            let mut monitor = SampleMonitor::new();
            let sampling = Sampling {
                rate_hz: RATE_HZ * self.rows as f32,
                ..SAMPLING
            };
            let mut held = [0.0; AXES];
            let mut frozen = None;
            for index in 0..16 * 286 {
                let t_s = index as f32 / RATE_HZ;
                let turned_s = (t_s - 4.0).max(0.0);
                let (angle, rate) = (0.5 * libm::sinf(4.0 * turned_s), turned_s.min(1.0) * 2.0);
                let motion = [
                    0.0,
                    9.81 * libm::sinf(angle),
                    9.81 * libm::cosf(angle),
                    rate * libm::cosf(4.0 * turned_s),
                    0.0,
                    0.0,
                ];
                for (axis, value) in motion.into_iter().enumerate() {
                    let scale = if axis < 3 { 10.0 } else { 1.0 };
                    let digit = self.digit * scale;
                    let noisy = value + self.noise * scale * random.normal();
                    if !((8.0..12.0).contains(&t_s) && self.stuck.contains(&axis)) {
                        held[axis] = libm::roundf(noisy / digit) * digit;
                    }
                }
                let [ax, ay, az, gx, gy, gz] = held;
                let values = [Vector3::new(ax, ay, az), Vector3::new(gx, gy, gz)];
                for _ in 0..self.rows {
                    if monitor.is_frozen([&values[0], &values[1]], [false; 2], || sampling) {
                        frozen = Some((frozen.map_or(t_s, |(first, _)| first), t_s));
                    }
                }
            }
            frozen
        }
    }

    #[test]
    fn a_stuck_axis_is_frozen_from_two_windows_in_motion_to_two_after_its_end() {
        let cases: [&[usize]; 7] = [&[0], &[1], &[2], &[3], &[4], &[5], &[3, 4, 5]];
        for stuck in cases {
            // The digits of registers, which noise of one digit fills too.
            for digit in [1.0e-6, 0.001] {
                let swing = Swing {
                    stuck,
                    digit,
                    ..USUAL
                };
                let (first_s, last_s) = swing.frozen_s().expect("a frozen axis");
                assert!((8.08..8.27).contains(&first_s), "{stuck:?}: {first_s}");
                assert!((11.9..12.2).contains(&last_s), "{stuck:?}: {last_s}");
            }
        }
    }

    #[test]
    fn samples_that_repeat_as_a_whole_are_frozen_after_a_tenth_of_a_second() {
        for rows in 1..=3 {
            let swing = Swing {
                rows,
                stuck: &[0, 1, 2, 3, 4, 5],
                ..USUAL
            };
            let (first_s, last_s) = swing.frozen_s().expect("frozen samples");
            assert!((8.09..8.12).contains(&first_s), "{rows}: {first_s}");
            assert!((11.98..12.0).contains(&last_s), "{rows}: {last_s}");
        }
    }

    /// Returns the first frozen sample of a sensor at rest whose samples repeat over these ranges.
    fn first_frozen(repeats: &[core::ops::Range<u32>]) -> Option<u32> {
        let mut random = Random(3);
        let mut monitor = SampleMonitor::new();
        let mut values = [Vector3::ZERO; 2];
        (0..4_000).find(|index| {
            if !repeats.iter().any(|range| range.contains(index)) {
                let [x, y, z, p, q, r] = [0; AXES].map(|_| 0.001 * random.normal());
                values = [Vector3::new(x, y, z - 9.81), Vector3::new(p, q, r)];
            }
            monitor.is_frozen([&values[0], &values[1]], [false; 2], || SAMPLING)
        })
    }

    #[test]
    fn a_repetition_before_does_not_delay_the_flag() {
        // A tenth of a second is 28 samples.
        let soon = 3_026..3_032;
        let none = 0..0;
        for before in [none, 0..300, 2_000..2_025, 2_975..2_999] {
            let frozen = first_frozen(&[before.clone(), 3_000..3_300]).expect("a freeze");
            assert!(soon.contains(&frozen), "{before:?}: {frozen}");
        }
    }

    #[test]
    fn little_noise_between_two_digits_is_no_proof() {
        let mut random = Random(4);
        let mut monitor = SampleMonitor::new();
        for index in 0..6_000 {
            // From between two digits to the middle of one.
            let offset = if index < 3_000 { 3.5 } else { 3.0 };
            let [x, y, z, p, q, r] =
                [0; AXES].map(|_| libm::roundf(offset + 0.15 * random.normal()) * 0.001);
            let values = [Vector3::new(x, y, z - 9.81), Vector3::new(p, q, r)];
            let is_frozen = monitor.is_frozen([&values[0], &values[1]], [false; 2], || SAMPLING);
            assert!(!is_frozen, "{index}");
        }
    }

    #[test]
    fn recordings_that_repeat_values_by_themselves_are_not_frozen() {
        for rows in [1, 2, 3, 10] {
            assert_eq!(Swing { rows, ..USUAL }.frozen_s(), None, "{rows} rows");
        }
        for digit in [0.001, 0.003, 0.01, 0.03, 0.1] {
            assert_eq!(Swing { digit, ..USUAL }.frozen_s(), None, "digit {digit}");
        }
        // A simulation, where two axes rest and the whole sample repeats for four seconds.
        assert_eq!(
            Swing {
                noise: 0.0,
                ..USUAL
            }
            .frozen_s(),
            None
        );
    }

    #[test]
    fn an_axis_at_full_scale_repeats_it() {
        let mut monitor = SampleMonitor::new();
        let mut random = Random(2);
        for index in 0..2_000 {
            let noise = [0; 6].map(|_| 0.001 * random.normal());
            let is_turning = index > 1_000;
            let force = Vector3::new(noise[0], noise[1] - 9.81, noise[2]);
            let gx = if is_turning { 4.36 } else { noise[3] };
            let gz = if is_turning {
                0.1 * index as f32
            } else {
                noise[5]
            };
            let values = [force, Vector3::new(gx, noise[4], gz)];
            assert!(
                !monitor.is_frozen([&values[0], &values[1]], [false, is_turning], || SAMPLING),
                "{index}"
            );
        }
    }

    #[test]
    fn values_that_are_no_numbers_prove_nothing() {
        let mut monitor = SampleMonitor::new();
        for value in [f32::NAN, f32::INFINITY, f32::MAX, -f32::MAX].repeat(300) {
            let vector = Vector3::new(value, value, value);
            assert!(!monitor.is_frozen([&vector; 2], [false; 2], || SAMPLING));
        }
        assert_eq!(monitor.noise.unproven(), ALL_AXES);
    }
}
