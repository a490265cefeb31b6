//! Rest: whether the sensor stands still, decided by its own noise, and the mean of what it reads meanwhile.
//!
//! # The test
//!
//! The product specification gives the noise as a density; over the bandwidth of the set low-pass filter it
//! becomes a σ per sample, and neighbouring samples are correlated, so that n of them say as much as n·2B/f
//! independent ones (B the bandwidth, f the sample rate). Samples are judged in windows worth about
//! 32 independent ones. A window is motion if
//!
//! - an axis reads full scale;
//! - an axis's variance lies beyond the χ² limit for the sensor's noise. Clones are noisier than the datasheet,
//!   so at first the noise may be four times as large; from the first still window on, each axis is held to
//!   what it has shown that it can do (an F test, as the product of both sides' χ² limits);
//! - an axis's mean differs from the mean of the windows before by more than the standard error of that difference
//!   explains: a slow turn about a level axis shows in the accelerometer long before its gyroscope's rate
//!   could be told from an offset;
//! - the gyroscope's mean is beyond any zero-rate offset that the datasheet allows (a fast steady turn about the vertical),
//!   or the accelerometer's is not about one g (free fall, a sensor that returns zeros).
//!
//! At the end the means must not show a trend either. All limits lie at five standard deviations, which white
//! noise exceeds in less than one of ten thousand collections of 1000 samples.
//!
//! One motion looks exactly like rest to these six sensors: a steady turn about the vertical, slower than the
//! zero-rate offset that the datasheet allows. It ends up in the offset.
//!
//! Deadline: none, it runs after the attitude is out. A sample costs a few dozen instructions, the last one of a window some
//! hundred more. Sums are integer and exact.

use core::fmt;

use super::mount::Axis;
use super::record::GyroscopeOffset;
use crate::attitude::Vector3;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Independent samples that make a window: enough for its variance to be known within a quarter.
const WINDOW_INDEPENDENT: f32 = 32.0;
/// No window is longer, so that its sums of squares fit their integers.
const LONGEST_WINDOW: u16 = 4096;
/// Where the limits lie, in standard deviations: one sample of 3.5 million lies beyond, on one side.
const LIMIT_SIGMA: f32 = 5.0;
/// How far the noise that was learned may be off, in standard deviations: one of 4000 is farther, on one side.
const LEARNED_SIGMA: f32 = 3.5;
/// Degrees of freedom that are remembered of it: eight windows.
const LEARNED_FREEDOM: f32 = 8.0 * WINDOW_INDEPENDENT;
/// So many times the datasheet's noise a poor clone may have.
const NOISE_TOLERANCE: f32 = 4.0;

/// Gyroscope noise, °/s/√Hz (product specification §6.1).
const GYROSCOPE_NOISE_DEGREES_S: f32 = 0.005;
/// Accelerometer noise, g/√Hz (product specification §6.2).
const ACCELEROMETER_NOISE_G: f32 = 400.0e-6;
/// Rounding to whole counts is noise with this variance, in counts².
const ROUNDING_VARIANCE: f32 = 1.0 / 12.0;

/// Zero-rate offset at 25 °C, in °/s (product specification §6.1).
const ZERO_RATE_DEGREES_S: f32 = 20.0;
/// What temperature may add to it from 25 °C to either end of its range, in °/s and °C (ibidem).
const ZERO_RATE_TEMPERATURE_DEGREES_S: f32 = 20.0;
const ZERO_RATE_TEMPERATURE_RANGE_CELSIUS: f32 = 60.0;
/// For the sensitivity's own 3 % and the noise, in °/s.
const ZERO_RATE_TOLERANCE_DEGREES_S: f32 = 1.0;
/// What the accelerometer's mean may measure at rest, in g: 80 mg of offset on each axis and 3 % of
/// sensitivity (product specification §6.2) make 0.17 of error.
const LEAST_GRAVITY_G: f32 = 0.8;
const MOST_GRAVITY_G: f32 = 1.2;

/// An expected offset that is known no better than this does not shorten anything, °/s.
const USEFUL_EXPECTATION_DEGREES_S: f32 = 0.5;
/// With an expectation that holds, this part of the samples is enough.
const EXPECTED_SHARE: u16 = 4;

/// The largest sum, 65535 samples of −32768, fits its integer.
const _: () = assert!((u16::MAX as i64) * (i16::MIN as i64) >= i32::MIN as i64);

/// What a count is worth, and what noise there is to expect.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RestScale {
    /// Gyroscope counts per °/s.
    pub counts_per_degree_s: f32,
    /// Accelerometer counts per g.
    pub counts_per_g: f32,
    /// σ of one sample of the gyroscope by the datasheet, in counts.
    pub gyroscope_sigma_counts: f32,
    /// σ of one sample of the accelerometer by the datasheet, in counts.
    pub accelerometer_sigma_counts: f32,
    /// So many samples of the gyroscope say as much as one that is independent; at least 1.
    pub gyroscope_correlation: f32,
    /// The same of the accelerometer.
    pub accelerometer_correlation: f32,
}

impl RestScale {
    /// The noise that the datasheet lets expect behind these low-pass filters, both in Hz.
    pub fn new(
        [counts_per_degree_s, counts_per_g]: [f32; 2],
        [gyroscope_bandwidth_hz, accelerometer_bandwidth_hz]: [f32; 2],
        sample_rate_hz: f32,
    ) -> Self {
        let sigma = |density_counts: f32, bandwidth_hz: f32| {
            libm::sqrtf(density_counts * density_counts * bandwidth_hz + ROUNDING_VARIANCE)
        };
        let correlation = |bandwidth_hz: f32| (0.5 * sample_rate_hz / bandwidth_hz).max(1.0);
        Self {
            counts_per_degree_s,
            counts_per_g,
            gyroscope_sigma_counts: sigma(
                GYROSCOPE_NOISE_DEGREES_S * counts_per_degree_s,
                gyroscope_bandwidth_hz,
            ),
            accelerometer_sigma_counts: sigma(
                ACCELEROMETER_NOISE_G * counts_per_g,
                accelerometer_bandwidth_hz,
            ),
            gyroscope_correlation: correlation(gyroscope_bandwidth_hz),
            accelerometer_correlation: correlation(accelerometer_bandwidth_hz),
        }
    }

    /// Gyroscope counts in rad/s.
    pub fn rad_s(&self, gyroscope_counts: Vector3) -> Vector3 {
        gyroscope_counts.scale(radians(1.0) / self.counts_per_degree_s)
    }

    /// Accelerometer counts in m/s².
    pub fn m_s2(&self, accelerometer_counts: Vector3) -> Vector3 {
        accelerometer_counts.scale(STANDARD_GRAVITY_M_S2 / self.counts_per_g)
    }
}

/// The mean readings at rest, in counts along the sensor's axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AtRest {
    /// The gyroscope's zero-rate offset.
    pub gyroscope_counts: Vector3,
    /// The accelerometer's mean: gravity, as mounted and as tilted, plus its offset.
    pub accelerometer_counts: Vector3,
    /// σ of one sample of the gyroscope.
    pub gyroscope_sigma_counts: Vector3,
    /// σ of one sample of the accelerometer.
    pub accelerometer_sigma_counts: Vector3,
    /// The mean die temperature, °C.
    pub temperature_celsius: f32,
    /// How many samples that is.
    pub samples: u16,
}

impl AtRest {
    /// The gyroscope's offset, as it is stored.
    pub fn gyroscope_offset(&self, scale: &RestScale) -> GyroscopeOffset {
        GyroscopeOffset {
            offset_rad_s: scale.rad_s(self.gyroscope_counts),
            temperature_celsius: self.temperature_celsius,
        }
    }

    /// σ of that offset by the noise alone, rad/s: of the noisiest axis.
    pub fn gyroscope_offset_sigma_rad_s(&self, scale: &RestScale) -> f32 {
        let sigma = self.gyroscope_sigma_counts;
        let sigma = sigma.x.max(sigma.y).max(sigma.z);
        let independent = (f32::from(self.samples) / scale.gyroscope_correlation).max(1.0);
        let variance =
            sigma * sigma / independent + ROUNDING_VARIANCE / f32::from(self.samples.max(1));
        libm::sqrtf(variance) * (radians(1.0) / scale.counts_per_degree_s)
    }

    /// The specific force as the accelerometer reads it, uncorrected, m/s² in sensor axes.
    pub fn specific_force_m_s2(&self, scale: &RestScale) -> Vector3 {
        scale.m_s2(self.accelerometer_counts)
    }
}

/// Why that was no rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MotionReason {
    /// The gyroscope's readings about this axis vary more than its noise.
    Turned(Axis),
    /// The accelerometer's readings along this axis vary more than its noise.
    Vibrates(Axis),
    /// The accelerometer's mean along this axis changes.
    Tilted(Axis),
    /// The gyroscope reads a steady rate about this axis that no offset explains.
    Spins(Axis),
    /// The gyroscope reads full scale about this axis.
    GyroscopeSaturated(Axis),
    /// The accelerometer reads full scale along this axis.
    AccelerometerSaturated(Axis),
    /// The accelerometer does not read about one g.
    NoGravity,
}

impl fmt::Display for MotionReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (text, axis) = match *self {
            Self::Turned(axis) => ("it turned about ", axis),
            Self::Vibrates(axis) => ("it vibrates along ", axis),
            Self::Tilted(axis) => ("it slowly tilts along ", axis),
            Self::Spins(axis) => ("it turns steadily about ", axis),
            Self::GyroscopeSaturated(axis) => ("the gyroscope reads full scale about ", axis),
            Self::AccelerometerSaturated(axis) => {
                ("the accelerometer reads full scale along ", axis)
            }
            Self::NoGravity => return formatter.write_str("the accelerometer reads no gravity"),
        };
        formatter.write_str(text)?;
        formatter.write_str(axis.name())
    }
}

/// What a sample did to the collection.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum RestProgress {
    /// It joined; more are needed.
    Collecting,
    /// It completed a window in which the sensor moved: everything so far is thrown away.
    Moved(MotionReason),
    /// It was the last one.
    Done(AtRest),
}

/// The watch over rest. After [`RestProgress::Done`] it starts over.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RestWatch {
    scale: RestScale,
    samples: u16,
    window_samples: u16,
    expected: Option<Expected>,
    /// Samples in closed windows, and those windows.
    count: u16,
    positions: Positions,
    /// Samples in the open window.
    window_count: u16,
    gyroscope: Channel,
    accelerometer: Channel,
    temperature_sum: f32,
}

/// A gyroscope offset known beforehand, in counts.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Expected {
    offset: Vector3,
    sigma: f32,
}

impl RestWatch {
    /// A watch that wants this many samples at rest (none counts as one).
    pub fn new(scale: &RestScale, samples: u16) -> Self {
        let correlation = scale
            .gyroscope_correlation
            .max(scale.accelerometer_correlation);
        let window_samples = (WINDOW_INDEPENDENT * correlation) as u16;
        Self {
            scale: *scale,
            samples: samples.max(1),
            window_samples: window_samples.clamp(1, LONGEST_WINDOW),
            expected: None,
            count: 0,
            positions: Positions::NONE,
            window_count: 0,
            gyroscope: Channel::new(scale.gyroscope_sigma_counts, scale.gyroscope_correlation),
            accelerometer: Channel::new(
                scale.accelerometer_sigma_counts,
                scale.accelerometer_correlation,
            ),
            temperature_sum: 0.0,
        }
    }

    /// With an offset known beforehand: what the full length buys beyond precision is the proof that nothing turns
    /// slowly, and a reading that agrees with what is known is that proof. A quarter of the samples is
    /// then enough.
    #[must_use]
    pub fn expecting(mut self, offset_rad_s: Vector3, sigma_rad_s: f32) -> Self {
        let counts = self.scale.counts_per_degree_s / radians(1.0);
        if sigma_rad_s <= radians(USEFUL_EXPECTATION_DEGREES_S) {
            self.expected = Some(Expected {
                offset: offset_rad_s.scale(counts),
                sigma: sigma_rad_s * counts,
            });
        }
        self
    }

    /// Takes one sample, in counts along the sensor's axes, with the die temperature in °C.
    pub fn update(
        &mut self,
        gyroscope: [i16; 3],
        accelerometer: [i16; 3],
        temperature_celsius: f32,
    ) -> RestProgress {
        let is_first = self.window_count == 0;
        self.gyroscope.add(gyroscope, is_first);
        self.accelerometer.add(accelerometer, is_first);
        self.temperature_sum += temperature_celsius;
        self.window_count += 1;
        let is_last = self.window_count >= self.samples - self.count;
        if self.window_count < self.window_samples && !is_last {
            return RestProgress::Collecting;
        }
        self.close(is_last)
    }

    /// How much of it is done: 0 to 100.
    pub fn progress_percent(&self) -> u8 {
        let done = u32::from(self.count) + u32::from(self.window_count);
        let percent = (100 * done).checked_div(u32::from(self.samples));
        percent.unwrap_or_default().min(100) as u8
    }

    /// Starts over, but remembers how much noise the sensor has.
    fn restart(&mut self) {
        self.count = 0;
        self.positions = Positions::NONE;
        self.window_count = 0;
        self.temperature_sum = 0.0;
        self.gyroscope.restart();
        self.accelerometer.restart();
    }

    #[inline(never)]
    fn close(&mut self, is_last: bool) -> RestProgress {
        let samples = core::mem::take(&mut self.window_count);
        let gyroscope = self.gyroscope.close(samples);
        let accelerometer = self.accelerometer.close(samples);
        let before = self.count;
        self.count += samples;
        let temperature = self.temperature_sum / f32::from(self.count);
        let reason = self
            .saturation()
            .or_else(|| self.implausible(&gyroscope, &accelerometer, temperature))
            .or_else(|| {
                let noisy = self.gyroscope.noisy(&gyroscope, samples);
                noisy.map(MotionReason::Turned)
            })
            .or_else(|| {
                let noisy = self.accelerometer.noisy(&accelerometer, samples);
                noisy.map(MotionReason::Vibrates)
            })
            .or_else(|| {
                let drifting = self.accelerometer.drifting(&accelerometer, samples, before);
                drifting.map(MotionReason::Tilted)
            })
            .or_else(|| {
                let drifting = self.gyroscope.drifting(&gyroscope, samples, before);
                drifting.map(MotionReason::Turned)
            });
        if let Some(reason) = reason {
            self.restart();
            return RestProgress::Moved(reason);
        }
        let position =
            (f32::from(before) + 0.5 * f32::from(samples)) / f32::from(self.window_samples);
        self.positions.add(f32::from(samples), position);
        self.gyroscope.join(&gyroscope, samples, position);
        self.accelerometer.join(&accelerometer, samples, position);
        if !is_last && !self.is_as_expected() {
            return RestProgress::Collecting;
        }
        let [accelerometer, gyroscope] = [&self.accelerometer, &self.gyroscope]
            .map(|channel| channel.trending(&self.positions, self.window_samples));
        let trend = accelerometer
            .map(MotionReason::Tilted)
            .or_else(|| gyroscope.map(MotionReason::Turned));
        if let Some(reason) = trend {
            self.restart();
            return RestProgress::Moved(reason);
        }
        let at_rest = AtRest {
            gyroscope_counts: self.gyroscope.mean(self.count),
            accelerometer_counts: self.accelerometer.mean(self.count),
            gyroscope_sigma_counts: self.gyroscope.sigma(self.count, self.positions.windows),
            accelerometer_sigma_counts: self
                .accelerometer
                .sigma(self.count, self.positions.windows),
            temperature_celsius: temperature,
            samples: self.count,
        };
        self.restart();
        RestProgress::Done(at_rest)
    }

    fn saturation(&self) -> Option<MotionReason> {
        first_axis(self.gyroscope.is_saturated)
            .map(MotionReason::GyroscopeSaturated)
            .or_else(|| {
                let saturated = first_axis(self.accelerometer.is_saturated);
                saturated.map(MotionReason::AccelerometerSaturated)
            })
    }

    /// Means that no sensor at rest has.
    fn implausible(
        &self,
        gyroscope: &Window,
        accelerometer: &Window,
        temperature_celsius: f32,
    ) -> Option<MotionReason> {
        let limit = zero_rate_limit_degrees_s(temperature_celsius) * self.scale.counts_per_degree_s;
        // A NaN fails every comparison.
        let is_offset = |mean: &f32| mean.abs() <= limit;
        if let Some(axis) = first_axis(gyroscope.mean.each_ref().map(|mean| !is_offset(mean))) {
            return Some(MotionReason::Spins(axis));
        }
        let [x, y, z] = accelerometer.mean;
        let g = self.scale.counts_per_g;
        let squared = (x * x + y * y + z * z) / (g * g);
        let is_gravity = (LEAST_GRAVITY_G * LEAST_GRAVITY_G..=MOST_GRAVITY_G * MOST_GRAVITY_G)
            .contains(&squared);
        (!is_gravity).then_some(MotionReason::NoGravity)
    }

    /// Whether enough agrees with the offset known beforehand to stop here.
    fn is_as_expected(&self) -> bool {
        let Some(expected) = self.expected else {
            return false;
        };
        // Three windows are the least that show a trend.
        if self.positions.windows < 3 || self.count < self.samples / EXPECTED_SHARE {
            return false;
        }
        let error = self.gyroscope.mean_variance(self.count);
        let limit = 3.0 * libm::sqrtf(error + expected.sigma * expected.sigma);
        (self.gyroscope.mean(self.count) - expected.offset).is_within(limit)
    }
}

/// Where on the time line the closed windows lie, in windows; weighted with their samples.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Positions {
    windows: u16,
    samples: f32,
    sum: f32,
    squares: f32,
}

impl Positions {
    const NONE: Self = Self {
        windows: 0,
        samples: 0.0,
        sum: 0.0,
        squares: 0.0,
    };

    fn add(&mut self, samples: f32, position: f32) {
        self.windows += 1;
        self.samples += samples;
        self.sum += samples * position;
        self.squares += samples * position * position;
    }
}

/// Three axes of one kind.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Channel {
    /// By the datasheet, in counts.
    sigma: f32,
    correlation: f32,
    /// The window: its first sample, the sum of the differences from it, and that of their squares.
    first: [i16; 3],
    difference_sum: [i32; 3],
    square_sum: [u64; 3],
    is_saturated: [bool; 3],
    /// The windows before: sum, and squared deviations.
    sum: [i32; 3],
    deviation: [f32; 3],
    /// Of the first window the mean; of all windows n·(mean − reference), and that times their positions.
    reference: [f32; 3],
    change_sum: [f32; 3],
    moment_sum: [f32; 3],
    /// How much noise each axis has, which outlives a restart.
    learned: [Learned; 3],
}

/// The variance of an axis's noise as its still windows show it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Learned {
    variance: f32,
    freedom: f32,
}

impl Learned {
    const NOTHING: Self = Self {
        variance: f32::MAX,
        freedom: 0.0,
    };

    /// What it may be at most.
    fn most(&self) -> f32 {
        if self.freedom <= 0.0 {
            return f32::MAX;
        }
        self.variance / chi_squared_per_freedom(self.freedom, -LEARNED_SIGMA).max(0.01)
    }

    /// Takes a window's variance. What is quieter than noise can be (`least` of it) shows that there was more than noise before.
    fn update(&mut self, variance: f32, freedom: f32, least: f32) {
        if self.freedom <= 0.0 || variance < least * self.variance {
            *self = Self { variance, freedom };
            return;
        }
        let share = freedom / (self.freedom + freedom);
        self.variance += share * (variance - self.variance);
        self.freedom = (self.freedom + freedom).min(LEARNED_FREEDOM);
    }
}

/// What a window says.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Window {
    mean: [f32; 3],
    /// Σ(x − mean)².
    deviation: [f32; 3],
    sum: [i32; 3],
}

impl Channel {
    const fn new(sigma: f32, correlation: f32) -> Self {
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
            learned: [Learned::NOTHING; 3],
        }
    }

    fn restart(&mut self) {
        let learned = self.learned;
        *self = Self {
            learned,
            ..Self::new(self.sigma, self.correlation)
        };
    }

    fn add(&mut self, counts: [i16; 3], is_first: bool) {
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

    fn close(&mut self, samples: u16) -> Window {
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

    /// The first axis whose variance no noise explains; the others teach what noise there is.
    fn noisy(&mut self, window: &Window, samples: u16) -> Option<Axis> {
        let freedom = (f32::from(samples) / self.correlation - 1.0).max(1.0);
        let most = chi_squared_per_freedom(freedom, LIMIT_SIGMA);
        let least = chi_squared_per_freedom(freedom, -LEARNED_SIGMA);
        let datasheet = self.sigma * self.sigma;
        let mut is_noisy = [false; 3];
        let axes = window.deviation.iter().zip(&mut self.learned);
        for ((deviation, learned), is_noisy) in axes.zip(&mut is_noisy) {
            let variance = deviation / (f32::from(samples) - 1.0).max(1.0);
            let noise = learned
                .most()
                .max(datasheet)
                .min(NOISE_TOLERANCE * NOISE_TOLERANCE * datasheet);
            *is_noisy = variance > most * noise;
            if !*is_noisy {
                learned.update(variance, freedom, least);
            }
        }
        first_axis(is_noisy)
    }

    /// The first axis whose mean is not that of the windows before.
    fn drifting(&self, window: &Window, samples: u16, before: u16) -> Option<Axis> {
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

    fn join(&mut self, window: &Window, samples: u16, position: f32) {
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

    /// The first axis whose window means lie on a slope: a least-squares line, each window weighted with its samples.
    fn trending(&self, positions: &Positions, window_samples: u16) -> Option<Axis> {
        let Positions {
            windows,
            samples,
            sum,
            squares,
        } = *positions;
        let spread = squares - sum * sum / samples;
        if windows < 3 || spread <= 0.0 {
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

    /// The variance of one sample: what was seen, but no less than the datasheet's.
    fn variance(&self, deviation: f32, samples: u16) -> f32 {
        (deviation / (f32::from(samples) - 1.0).max(1.0)).max(self.sigma * self.sigma)
    }

    /// The variance of the mean of the noisiest axis.
    fn mean_variance(&self, samples: u16) -> f32 {
        let [x, y, z] = self.deviation;
        let variance = self.variance(x.max(y).max(z), samples);
        variance * self.correlation / f32::from(samples.max(1)) + ROUNDING_VARIANCE
    }

    fn mean(&self, samples: u16) -> Vector3 {
        let [x, y, z] = self.sum.map(|sum| {
            // An `f32` has 24 bits, so the whole part and the rest are divided apart.
            let (sum, samples) = (sum, i32::from(samples.max(1)));
            (sum / samples) as f32 + (sum % samples) as f32 / samples as f32
        });
        Vector3::new(x, y, z)
    }

    fn sigma(&self, samples: u16, windows: u16) -> Vector3 {
        let freedom = (f32::from(samples) - f32::from(windows)).max(1.0);
        let [x, y, z] = self
            .deviation
            .map(|deviation| libm::sqrtf(deviation / freedom));
        Vector3::new(x, y, z)
    }
}

/// The χ² quantile at so many standard deviations, over its degrees of freedom (Wilson and Hilferty, 1931).
fn chi_squared_per_freedom(freedom: f32, sigma: f32) -> f32 {
    let variance = 2.0 / (9.0 * freedom);
    let root = (1.0 - variance + sigma * libm::sqrtf(variance)).max(0.0);
    root * root * root
}

/// The largest zero-rate offset the datasheet allows at this temperature, in °/s.
fn zero_rate_limit_degrees_s(temperature_celsius: f32) -> f32 {
    let away = (temperature_celsius - 25.0).abs() / ZERO_RATE_TEMPERATURE_RANGE_CELSIUS;
    ZERO_RATE_DEGREES_S
        + ZERO_RATE_TEMPERATURE_DEGREES_S * away.min(1.0)
        + ZERO_RATE_TOLERANCE_DEGREES_S
}

fn first_axis(is: [bool; 3]) -> Option<Axis> {
    Axis::ALL
        .into_iter()
        .zip(is)
        .find_map(|(axis, is)| is.then_some(axis))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEVEL: [i16; 3] = [0, 0, 2048];
    /// Samples of a window at the default settings.
    const WINDOW: u32 = 86;

    /// ±250 °/s and ±2 g at 1 kHz and 188 Hz.
    fn fine() -> RestScale {
        RestScale::new([131.0, 16384.0], [188.0, 184.0], 1000.0)
    }

    /// ±2000 °/s and ±16 g, the default.
    fn coarse() -> RestScale {
        RestScale::new([16.4, 2048.0], [188.0, 184.0], 1000.0)
    }

    /// A small generator of noise: sums of twelve uniform numbers, or one.
    struct Noise(u32);

    impl Noise {
        fn uniform(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 >> 8) as f32 / (1 << 24) as f32 - 0.5
        }

        fn next(&mut self, amplitude: i16) -> i16 {
            (self.uniform() * (2.0 * f32::from(amplitude) + 1.0)).round() as i16
        }

        fn normal(&mut self) -> f32 {
            (0..12).map(|_| self.uniform()).sum()
        }

        /// What a sensor of this scale, so many times as noisy as its datasheet, reads.
        fn sample(&mut self, scale: &RestScale, times: f32) -> ([i16; 3], [i16; 3]) {
            let mut axes = |sigma: f32, mean: [f32; 3]| {
                mean.map(|mean| (mean + times * sigma * self.normal()).round() as i16)
            };
            let gyroscope = axes(scale.gyroscope_sigma_counts, [20.3, -30.8, 5.5]);
            let level = [0.2, -0.4, scale.counts_per_g];
            (gyroscope, axes(scale.accelerometer_sigma_counts, level))
        }
    }

    /// Feeds samples until something other than `Collecting` comes; its index and itself.
    fn first_event(
        watch: &mut RestWatch,
        mut sample: impl FnMut(u32) -> ([i16; 3], [i16; 3]),
    ) -> (u32, RestProgress) {
        for index in 0..100_000 {
            let (gyroscope, accelerometer) = sample(index);
            match watch.update(gyroscope, accelerometer, 25.0) {
                RestProgress::Collecting => {}
                event => return (index, event),
            }
        }
        panic!("nothing happened");
    }

    fn done(progress: RestProgress) -> AtRest {
        let RestProgress::Done(at_rest) = progress else {
            panic!("{progress:?}");
        };
        at_rest
    }

    #[test]
    fn the_classic_example_has_the_offset_minus_158_25() {
        // The readings have tenths, so a count here is a tenth of theirs.
        let tenths = [
            -1584, -1729, -1342, -1551, -1312, -1468, -1731, -1886, -1427, -1795,
        ];
        let scale = RestScale::new([1310.0, 16384.0], [188.0, 184.0], 1000.0);
        let mut watch = RestWatch::new(&scale, 10);
        let (index, event) = first_event(&mut watch, |index| {
            ([tenths[index as usize], 0, 0], [0, 0, -16384])
        });
        assert_eq!(index, 9);
        let at_rest = done(event);
        assert_eq!(at_rest.gyroscope_counts, Vector3::new(-1582.5, 0.0, 0.0));
        assert_eq!(at_rest.gyroscope_counts.x / 10.0, -158.25);
        // Face down, the classic accelerometer offset is the mean plus one g.
        assert_eq!(at_rest.accelerometer_counts.z + 16384.0, 0.0);
    }

    #[test]
    fn noise_of_the_sensor_is_rest_and_is_averaged_exactly() {
        let mut noise = Noise(1);
        let (mut gyroscope_sum, mut accelerometer_sum) = ([0_i64; 3], [0_i64; 3]);
        let mut watch = RestWatch::new(&coarse(), 1000);
        let (index, event) = first_event(&mut watch, |_| {
            // Three times the datasheet's noise; offsets of 12 °/s.
            let gyroscope = [200, -150, 7].map(|offset| offset + noise.next(5));
            let accelerometer = [40, -60, 2100].map(|mean| mean + noise.next(50));
            for axis in 0..3 {
                gyroscope_sum[axis] += i64::from(gyroscope[axis]);
                accelerometer_sum[axis] += i64::from(accelerometer[axis]);
            }
            (gyroscope, accelerometer)
        });
        assert_eq!(index, 999);
        let at_rest = done(event);
        let [gyroscope, accelerometer] = [gyroscope_sum, accelerometer_sum]
            .map(|sum| sum.map(|sum| (sum as f64 / 1000.0) as f32))
            .map(|[x, y, z]| Vector3::new(x, y, z));
        assert!((at_rest.gyroscope_counts - gyroscope).is_within(2e-5));
        assert!((at_rest.accelerometer_counts - accelerometer).is_within(2e-4));
        assert_eq!(at_rest.samples, 1000);
        assert!((at_rest.temperature_celsius - 25.0).abs() < 1e-3);
        // A uniform number of ±5.5 has σ = 11/√12.
        let sigma = at_rest.gyroscope_sigma_counts;
        assert!(
            (sigma - Vector3::new(3.18, 3.18, 3.18)).is_within(0.2),
            "{sigma:?}"
        );
    }

    #[test]
    fn a_sensor_within_its_datasheet_or_a_noisy_clone_is_not_taken_for_moving() {
        for (scale, times) in [
            (coarse(), 1.0),
            (fine(), 1.0),
            (coarse(), 3.5),
            (fine(), 3.5),
        ] {
            let mut noise = Noise(7);
            let mut watch = RestWatch::new(&scale, 1000);
            for _ in 0..100 {
                let (index, event) = first_event(&mut watch, |_| noise.sample(&scale, times));
                assert_eq!(index, 999, "{times}: {event:?}");
                let error = done(event).gyroscope_counts - Vector3::new(20.3, -30.8, 5.5);
                let sigma = times * scale.gyroscope_sigma_counts / 1000_f32.sqrt();
                assert!(error.is_within(5.0 * sigma + 0.05), "{error:?}");
            }
        }
    }

    #[test]
    fn a_vibrating_table_is_told_from_a_noisy_sensor_once_the_sensor_was_quiet() {
        let scale = coarse();
        let mut noise = Noise(3);
        let mut shaking = |index: u32, amplitude: f32| {
            let (gyroscope, [x, y, z]) = noise.sample(&scale, 1.0);
            let shake = amplitude * scale.counts_per_g * (index as f32 * 0.4).sin();
            (gyroscope, [x, y, z + shake as i16])
        };
        // 50 mg is more than any clone's noise; 25 mg could be a bad one's.
        let mut watch = RestWatch::new(&scale, 1000);
        let (index, event) = first_event(&mut watch, |index| shaking(index, 0.1));
        assert_eq!(index, WINDOW - 1);
        assert_eq!(event, RestProgress::Moved(MotionReason::Vibrates(Axis::Z)));
        let (_, event) = first_event(&mut RestWatch::new(&scale, 1000), |index| {
            shaking(index, 0.025)
        });
        assert!(matches!(event, RestProgress::Done(_)), "{event:?}");
        // The same after a quiet time is motion.
        let mut watch = RestWatch::new(&scale, 1000);
        let (index, event) = first_event(&mut watch, |index| {
            shaking(index, if index < 400 { 0.0 } else { 0.025 })
        });
        assert!(index < 400 + 2 * WINDOW, "{index}");
        assert_eq!(event, RestProgress::Moved(MotionReason::Vibrates(Axis::Z)));
    }

    #[test]
    fn a_short_movement_restarts_the_average_at_the_end_of_its_window() {
        let mut watch = RestWatch::new(&coarse(), 1000);
        // 50 °/s on one sample out of a thousand.
        let bump = |index: u32| ([if index == 640 { 820 } else { 0 }, 0, 0], LEVEL);
        let event = (
            8 * WINDOW - 1,
            RestProgress::Moved(MotionReason::Turned(Axis::X)),
        );
        assert_eq!(first_event(&mut watch, bump), event);
        assert_eq!(watch.progress_percent(), 0);
        // From here on a full average is needed again.
        let (index, event) = first_event(&mut watch, |_| ([3, 0, 0], LEVEL));
        assert_eq!(index, 999);
        assert_eq!(done(event).gyroscope_counts, Vector3::new(3.0, 0.0, 0.0));
    }

    #[test]
    fn progress_goes_from_nothing_to_everything() {
        let mut watch = RestWatch::new(&coarse(), 1000);
        assert_eq!(watch.progress_percent(), 0);
        for _ in 0..500 {
            watch.update([0; 3], LEVEL, 25.0);
        }
        assert_eq!(watch.progress_percent(), 50);
    }

    #[test]
    fn a_movement_in_the_short_last_window_counts_too() {
        let mut watch = RestWatch::new(&coarse(), 110);
        let bump = |index: u32| ([if index == 105 { 820 } else { 0 }, 0, 0], LEVEL);
        let (index, event) = first_event(&mut watch, bump);
        assert_eq!(index, 109);
        assert_eq!(event, RestProgress::Moved(MotionReason::Turned(Axis::X)));
    }

    #[test]
    fn a_knock_shows_in_the_accelerometer() {
        let mut watch = RestWatch::new(&coarse(), 1000);
        let knock = |index: u32| ([0; 3], [0, 0, if index == 10 { 3600 } else { 2048 }]);
        let (index, event) = first_event(&mut watch, knock);
        assert_eq!(index, WINDOW - 1);
        assert_eq!(event, RestProgress::Moved(MotionReason::Vibrates(Axis::Z)));
    }

    #[test]
    fn a_slow_turn_about_a_level_axis_shows_in_the_accelerometer() {
        let mut noise = Noise(5);
        let scale = coarse();
        for degrees_s in [0.5_f32, 1.0, 3.0, 10.0, 19.0] {
            let mut watch = RestWatch::new(&scale, 1000);
            let (_, event) = first_event(&mut watch, |index| {
                let angle = (degrees_s * index as f32 * 1e-3).to_radians();
                let ([x, y, z], _) = noise.sample(&scale, 1.0);
                let (_, force) = noise.sample(&scale, 1.0);
                let tilted = [0.0, 2048.0 * angle.sin(), 2048.0 * (angle.cos() - 1.0)];
                let mut force = force;
                for (axis, change) in force.iter_mut().zip(tilted) {
                    *axis += change.round() as i16;
                }
                ([x + (degrees_s * 16.4) as i16, y, z], force)
            });
            let tilted = RestProgress::Moved(MotionReason::Tilted(Axis::Y));
            let turned = RestProgress::Moved(MotionReason::Turned(Axis::Y));
            assert!(event == tilted || event == turned, "{degrees_s}: {event:?}");
        }
    }

    #[test]
    fn a_turn_that_begins_is_not_an_offset() {
        // 1 °/s about the vertical, from the middle on: the accelerometer sees nothing.
        let mut watch = RestWatch::new(&coarse(), 1000);
        let turn = |index: u32| ([0, 0, if index < 500 { 0 } else { 16 }], LEVEL);
        let (_, event) = first_event(&mut watch, turn);
        assert_eq!(event, RestProgress::Moved(MotionReason::Turned(Axis::Z)));
    }

    #[test]
    fn a_window_that_differs_from_those_before_is_motion_though_nothing_trends() {
        // Turned about the vertical by a tenth of a degree, in the middle: one window of eleven, still in itself.
        let mut watch = RestWatch::new(&coarse(), 946);
        let turn = |index: u32| ([0, 0, if index / WINDOW == 5 { 16 } else { 0 }], LEVEL);
        let (index, event) = first_event(&mut watch, turn);
        assert_eq!(index, 6 * WINDOW - 1);
        assert_eq!(event, RestProgress::Moved(MotionReason::Turned(Axis::Z)));
    }

    #[test]
    fn a_saturated_axis_is_refused_by_name() {
        let mut watch = RestWatch::new(&coarse(), 1000);
        let (_, event) = first_event(&mut watch, |_| ([0, -32768, 0], LEVEL));
        let reason = MotionReason::GyroscopeSaturated(Axis::Y);
        assert_eq!(event, RestProgress::Moved(reason));
        assert_eq!(reason.to_string(), "the gyroscope reads full scale about y");
        let (_, event) = first_event(&mut watch, |index| {
            ([0; 3], [if index == 3 { 32767 } else { 0 }, 0, 2048])
        });
        let reason = MotionReason::AccelerometerSaturated(Axis::X);
        assert_eq!(event, RestProgress::Moved(reason));
    }

    #[test]
    fn a_steady_turn_is_an_offset_only_within_the_datasheet() {
        let at = |degrees_s: f32, celsius: f32| {
            let mut watch = RestWatch::new(&coarse(), 100);
            let counts = (degrees_s * 16.4) as i16;
            let mut last = RestProgress::Collecting;
            for _ in 0..100 {
                last = watch.update([0, 0, counts], LEVEL, celsius);
            }
            matches!(last, RestProgress::Done(_))
        };
        assert!(at(20.0, 25.0));
        assert!(at(-20.0, 25.0));
        assert!(!at(22.0, 25.0));
        assert!(!at(-22.0, 25.0));
        // Heat and cold allow more, and no temperature allows everything.
        assert!(at(39.0, 85.0));
        assert!(at(-32.0, -15.0));
        assert!(!at(42.0, 85.0));
        assert!(!at(42.0, 3000.0));
        assert!(!at(42.0, f32::NAN));
        assert!(!at(1900.0, 25.0));
    }

    #[test]
    fn what_feels_no_gravity_is_not_at_rest() {
        for force in [[0, 0, 0], [0, 0, 1500], [1500, 1500, 1500], [-32000; 3]] {
            let mut watch = RestWatch::new(&coarse(), 1000);
            let (index, event) = first_event(&mut watch, |_| ([0; 3], force));
            assert_eq!(index, WINDOW - 1);
            assert_eq!(
                event,
                RestProgress::Moved(MotionReason::NoGravity),
                "{force:?}"
            );
        }
        // Any pose with one g will do, offsets included.
        for force in [
            [2048, 0, 0],
            [0, -2048, 0],
            [1182, -1182, 1182],
            [0, 0, 2300],
        ] {
            let mut watch = RestWatch::new(&coarse(), 1000);
            let (_, event) = first_event(&mut watch, |_| ([0; 3], force));
            assert!(matches!(event, RestProgress::Done(_)), "{force:?}");
        }
    }

    #[test]
    fn a_stored_offset_that_holds_shortens_the_rest_and_one_that_does_not_does_not() {
        let scale = coarse();
        let stored = |degrees_s: f32| Vector3::new(radians(degrees_s), 0.0, 0.0);
        let length = |offset: Vector3, sigma: f32| {
            let mut watch = RestWatch::new(&scale, 1000).expecting(offset, radians(sigma));
            let (index, event) = first_event(&mut watch, |_| ([33, 0, 0], LEVEL));
            assert!((done(event).gyroscope_counts.x - 33.0).abs() < 1e-6);
            index + 1
        };
        assert_eq!(length(stored(2.0), 0.1), 3 * WINDOW);
        assert_eq!(length(stored(3.0), 0.1), 1000);
        assert_eq!(
            length(stored(2.0), 1.0),
            1000,
            "too vague to prove anything"
        );
    }

    #[test]
    fn the_longest_average_of_the_largest_counts_is_exact() {
        // A scale at which large counts are a plausible offset and a plausible gravity.
        let scale = RestScale::new([32768.0 / 20.0, 32768.0], [188.0, 184.0], 1000.0);
        for extreme in [i16::MIN + 2, i16::MAX - 1] {
            let mut watch = RestWatch::new(&scale, u16::MAX);
            let (index, event) = first_event(&mut watch, |_| ([extreme; 3], [0, 0, extreme]));
            assert_eq!(index, u32::from(u16::MAX) - 1);
            let at_rest = done(event);
            let expected = f32::from(extreme);
            assert_eq!(
                at_rest.gyroscope_counts,
                Vector3::new(expected, expected, expected)
            );
            assert_eq!(at_rest.accelerometer_counts.z, f32::from(extreme));
        }
    }

    #[test]
    fn every_length_ends_on_its_last_sample() {
        for samples in [0, 1, 2, 85, 86, 87, 149, 172, 173, 1001] {
            let mut watch = RestWatch::new(&coarse(), samples);
            let (index, event) = first_event(&mut watch, |_| ([1; 3], LEVEL));
            assert_eq!(index, u32::from(samples.max(1)) - 1);
            assert!(matches!(event, RestProgress::Done(_)), "{samples}");
        }
    }

    #[test]
    fn narrow_filters_have_long_windows() {
        for (bandwidth, samples) in [(188.0, 86), (42.0, 380), (5.0, 3200), (0.1, 4096)] {
            let scale = RestScale::new([16.4, 2048.0], [bandwidth, bandwidth], 1000.0);
            let watch = RestWatch::new(&scale, 1000);
            assert!(watch.window_samples.abs_diff(samples) <= 2, "{bandwidth}");
        }
        let aliased = RestScale::new([16.4, 2048.0], [188.0, 184.0], 100.0);
        assert_eq!(aliased.gyroscope_correlation, 1.0);
    }

    #[test]
    fn the_approximation_of_the_quantiles_is_good() {
        // From tables: χ² with 30 degrees of freedom exceeds 59.70 in 0.1 % (z = 3.0902) of the cases and 11.59 in 99.9 %.
        assert!((30.0 * chi_squared_per_freedom(30.0, 3.0902) - 59.70).abs() < 0.2);
        assert!((30.0 * chi_squared_per_freedom(30.0, -3.0902) - 11.59).abs() < 0.2);
    }
}
