//! Stationary detector: compares the readings with the sensor's own noise, and averages them while
//! nothing moves.
//!
//! # The test
//!
//! The product specification gives the noise as a density. Over the bandwidth B of the low-pass
//! filter it becomes a σ per sample. Neighbouring samples are correlated: at the sample rate f,
//! n samples are worth n·2B/f independent ones. The detector tests windows of about 32 independent
//! samples, or fewer if the average has not four such windows. A window is motion if
//!
//! - an axis reads full scale;
//! - the variance of an axis is beyond the χ² limit for the sensor's noise. Clones are noisier
//!   than the datasheet, so at first the limit allows four times its σ. From the first quiet
//!   window on, each axis is compared with its own noise (an F test, as the product of both χ²
//!   limits);
//! - the mean of an axis differs from the mean of the windows before by more than the standard
//!   error of the difference. A slow rotation about a level axis shows in the accelerometer long
//!   before its rate is distinguishable from a gyroscope offset;
//! - the gyroscope's mean is beyond the datasheet's zero-rate offset: a fast, steady rotation about
//!   the vertical;
//! - the accelerometer's mean is not about one g: free fall, or a sensor that returns zeros.
//!
//! At the end the means must not show a trend either. All limits lie at five standard deviations:
//! white noise exceeds them in less than one of ten thousand averages of 1000 samples.
//!
//! One motion reads like rest on these six axes: a steady rotation about the vertical, slower than
//! the datasheet's zero-rate offset. It ends up in the offset.
//!
//! # Cost
//!
//! No deadline: the detector runs after the attitude is out. A sample costs a few dozen
//! instructions, the last one of a window some hundred more. Sums are integer and exact.
//!
//! ```
//! use aplomb::attitude::Vector3;
//! use aplomb::calibration::{
//!     Axis, ImuReading, MotionReason, NoiseModel, SensorSetup, StationaryDetector,
//!     StationaryProgress,
//! };
//!
//! let noise = NoiseModel::new(&SensorSetup {
//!     gyroscope_counts_per_degree_s: 16.4,
//!     accelerometer_counts_per_g: 2048.0,
//!     gyroscope_bandwidth_hz: 188.0,
//!     accelerometer_bandwidth_hz: 184.0,
//!     sample_rate_hz: 1000.0,
//! });
//! // A stored offset of 0 ± 0.001 rad/s: a quarter of the samples is enough to confirm it.
//! let mut detector =
//!     StationaryDetector::new(&noise, 1000).with_expected_offset(Vector3::ZERO, 0.001);
//! let still = ImuReading { accelerometer: [0, 0, 2048], ..ImuReading::default() };
//! let samples = (1..).find(|_| detector.update(&still) != StationaryProgress::Collecting);
//! assert_eq!(samples, Some(258));
//!
//! let turning = ImuReading { gyroscope: [0, 900, 0], ..still };
//! let motion = (0..1000).map(|_| detector.update(&turning)).find_map(|progress| match progress {
//!     StationaryProgress::Moved(reason) => Some(reason),
//!     _ => None,
//! });
//! assert_eq!(motion, Some(MotionReason::SteadyRotation(Axis::Y)));
//! ```

mod channel;
#[cfg(test)]
mod tests;

use core::fmt;

use super::axis::Axis;
use super::gravity::{MAX_GRAVITY_G, MIN_GRAVITY_G};
use super::model::GyroscopeOffset;
use super::noise::{NoiseModel, ROUNDING_VARIANCE, WINDOW_INDEPENDENT};
use crate::attitude::Vector3;
use crate::units::radians;
use channel::{Channel, MIN_TREND_WINDOWS, Positions, Window, first_axis};

/// Longest window, in samples, so that its sums of squares fit their integers.
const MAX_WINDOW_SAMPLES: u16 = 4096;

/// Fewest windows of an average: a slow turn at a low rate shows only as a trend.
const FEWEST_WINDOWS: u16 = 4;

/// Zero-rate offset at 25 °C, °/s (product specification §6.1).
const ZERO_RATE_DEGREES_S: f32 = 20.0;
/// Change of the zero-rate offset from 25 °C to either end of the temperature range, °/s
/// (ibidem).
const ZERO_RATE_TEMPERATURE_DEGREES_S: f32 = 20.0;
/// Distance from 25 °C to an end of the temperature range, °C (ibidem).
const ZERO_RATE_TEMPERATURE_RANGE_CELSIUS: f32 = 60.0;
/// Margin for the sensitivity's own 3 % and the noise, °/s.
const ZERO_RATE_TOLERANCE_DEGREES_S: f32 = 1.0;
/// Largest zero-rate offset at any temperature, rad/s.
pub(super) const MAX_ZERO_RATE_RAD_S: f32 =
    radians(ZERO_RATE_DEGREES_S + ZERO_RATE_TEMPERATURE_DEGREES_S + ZERO_RATE_TOLERANCE_DEGREES_S);

/// Largest σ of an expected offset that can shorten the average, °/s.
const USEFUL_EXPECTATION_DEGREES_S: f32 = 0.5;
/// Largest difference from an expected offset, in standard deviations.
const EXPECTATION_SIGMA: f32 = 3.0;
/// Divisor of the number of samples once the expected offset is confirmed.
const EXPECTED_DIVISOR: u16 = 4;

/// One raw sample.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ImuReading {
    /// Gyroscope counts about sensor x, y, z.
    pub gyroscope: [i16; 3],
    /// Accelerometer counts along sensor x, y, z.
    pub accelerometer: [i16; 3],
    /// Die temperature, °C.
    pub temperature_celsius: f32,
}

/// Mean readings of a stationary sensor, in counts along the sensor's axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StationaryMean {
    /// Mean of the gyroscope: its zero-rate offset.
    pub gyroscope_counts: Vector3,
    /// Mean of the accelerometer: gravity, as mounted and as tilted, plus its offset.
    pub accelerometer_counts: Vector3,
    /// σ of one gyroscope sample.
    pub gyroscope_sigma_counts: Vector3,
    /// σ of one accelerometer sample.
    pub accelerometer_sigma_counts: Vector3,
    /// Mean die temperature, °C.
    pub temperature_celsius: f32,
    /// Number of samples.
    pub samples: u16,
}

impl StationaryMean {
    /// Returns the gyroscope's offset, as a calibration stores it.
    pub fn gyroscope_offset(&self, noise: &NoiseModel) -> GyroscopeOffset {
        GyroscopeOffset {
            offset_rad_s: noise.gyroscope_rad_s(self.gyroscope_counts),
            temperature_celsius: self.temperature_celsius,
        }
    }

    /// Returns the σ of that offset from noise alone, rad/s, of the noisiest axis.
    pub fn gyroscope_offset_sigma_rad_s(&self, noise: &NoiseModel) -> f32 {
        let sigma = self.gyroscope_sigma_counts;
        let sigma = sigma.x.max(sigma.y).max(sigma.z);
        let independent = (f32::from(self.samples) / noise.gyroscope_correlation).max(1.0);
        let variance =
            sigma * sigma / independent + ROUNDING_VARIANCE / f32::from(self.samples.max(1));
        libm::sqrtf(variance) * (radians(1.0) / noise.counts_per_degree_s)
    }

    /// Returns the uncorrected specific force, m/s² in sensor axes.
    pub fn specific_force_m_s2(&self, noise: &NoiseModel) -> Vector3 {
        noise.accelerometer_m_s2(self.accelerometer_counts)
    }
}

/// Reason why a window counts as motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum MotionReason {
    /// The gyroscope's readings about this axis vary more than its noise.
    Rotation(Axis),
    /// The accelerometer's readings along this axis vary more than its noise.
    Vibration(Axis),
    /// The accelerometer's mean along this axis changes.
    Tilt(Axis),
    /// The gyroscope reads a steady rate about this axis, larger than any zero-rate offset.
    SteadyRotation(Axis),
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
            Self::Rotation(axis) => ("it turned about ", axis),
            Self::Vibration(axis) => ("it vibrates along ", axis),
            Self::Tilt(axis) => ("it slowly tilts along ", axis),
            Self::SteadyRotation(axis) => ("it turns steadily about ", axis),
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

/// Effect of one sample on the average.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StationaryProgress {
    /// The sample joined the average; more are needed.
    Collecting,
    /// The sample closed a window with motion in it. The average starts over.
    Moved(MotionReason),
    /// The sample completed the average. The next one starts a new average.
    Done(StationaryMean),
}

/// Detects that the sensor is stationary, and averages its readings meanwhile.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StationaryDetector {
    noise: NoiseModel,
    samples: u16,
    window_samples: u16,
    expected: Option<ExpectedOffset>,
    /// Samples in the closed windows.
    count: u16,
    positions: Positions,
    /// Samples in the open window.
    window_count: u16,
    gyroscope: Channel,
    accelerometer: Channel,
    temperature_sum: f32,
}

/// Gyroscope offset known beforehand, in counts.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct ExpectedOffset {
    offset: Vector3,
    sigma: f32,
}

impl StationaryDetector {
    /// Creates a detector that averages this many stationary samples; 0 counts as 1.
    pub fn new(noise: &NoiseModel, samples: u16) -> Self {
        let correlation = noise
            .gyroscope_correlation
            .max(noise.accelerometer_correlation);
        let longest = (samples / FEWEST_WINDOWS).clamp(1, MAX_WINDOW_SAMPLES);
        let window_samples = (WINDOW_INDEPENDENT * correlation) as u16;
        Self {
            noise: *noise,
            samples: samples.max(1),
            window_samples: window_samples.clamp(1, longest),
            expected: None,
            count: 0,
            positions: Positions::NONE,
            window_count: 0,
            gyroscope: Channel::new(noise.gyroscope_sigma_counts, noise.gyroscope_correlation),
            accelerometer: Channel::new(
                noise.accelerometer_sigma_counts,
                noise.accelerometer_correlation,
            ),
            temperature_sum: 0.0,
        }
    }

    /// Shortens the average to a quarter if the readings confirm a known gyroscope offset.
    ///
    /// The full length buys, besides precision, the proof that nothing rotates slowly. A mean
    /// within 3 σ of the known offset is that proof. Offset and σ are rad/s in sensor axes; a σ
    /// above 0.5 °/s is too vague and changes nothing.
    #[must_use]
    pub fn with_expected_offset(mut self, offset_rad_s: Vector3, sigma_rad_s: f32) -> Self {
        let counts = self.noise.counts_per_degree_s / radians(1.0);
        if sigma_rad_s <= radians(USEFUL_EXPECTATION_DEGREES_S) {
            self.expected = Some(ExpectedOffset {
                offset: offset_rad_s.scale(counts),
                sigma: sigma_rad_s * counts,
            });
        }
        self
    }

    /// Adds one sample. The result reports motion at the end of a window, not before.
    pub fn update(&mut self, reading: &ImuReading) -> StationaryProgress {
        let is_first = self.window_count == 0;
        self.gyroscope.add(reading.gyroscope, is_first);
        self.accelerometer.add(reading.accelerometer, is_first);
        self.temperature_sum += reading.temperature_celsius;
        self.window_count += 1;
        let is_last = self.window_count >= self.samples - self.count;
        if self.window_count < self.window_samples && !is_last {
            return StationaryProgress::Collecting;
        }
        self.close_window(is_last)
    }

    /// Returns the share of the average that is collected, 0 to 100.
    pub fn progress_percent(&self) -> u8 {
        let done = u32::from(self.count) + u32::from(self.window_count);
        let percent = (100 * done).checked_div(u32::from(self.samples));
        percent.unwrap_or_default().min(100) as u8
    }

    /// Starts over, but keeps the measured noise.
    fn restart(&mut self) {
        self.count = 0;
        self.positions = Positions::NONE;
        self.window_count = 0;
        self.temperature_sum = 0.0;
        self.gyroscope.restart();
        self.accelerometer.restart();
    }

    /// Tests the open window, adds it to the average, and ends the average if it is complete.
    #[inline(never)]
    fn close_window(&mut self, is_last: bool) -> StationaryProgress {
        let samples = core::mem::take(&mut self.window_count);
        let gyroscope = self.gyroscope.close(samples);
        let accelerometer = self.accelerometer.close(samples);
        let before = self.count;
        self.count += samples;
        let temperature = self.temperature_sum / f32::from(self.count);
        let motion = self
            .saturation()
            .or_else(|| self.implausible_mean(&gyroscope, &accelerometer, temperature))
            .or_else(|| self.excess_variance(&gyroscope, &accelerometer, samples))
            .or_else(|| self.drift(&gyroscope, &accelerometer, samples, before));
        if let Some(reason) = motion {
            self.restart();
            return StationaryProgress::Moved(reason);
        }
        let position =
            (f32::from(before) + 0.5 * f32::from(samples)) / f32::from(self.window_samples);
        self.positions.add(f32::from(samples), position);
        self.gyroscope.join(&gyroscope, samples, position);
        self.accelerometer.join(&accelerometer, samples, position);
        if !is_last && !self.confirms_expectation() {
            return StationaryProgress::Collecting;
        }
        if let Some(reason) = self.trend() {
            self.restart();
            return StationaryProgress::Moved(reason);
        }
        let mean = StationaryMean {
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
        StationaryProgress::Done(mean)
    }

    fn saturation(&self) -> Option<MotionReason> {
        first_axis(self.gyroscope.is_saturated)
            .map(MotionReason::GyroscopeSaturated)
            .or_else(|| {
                let saturated = first_axis(self.accelerometer.is_saturated);
                saturated.map(MotionReason::AccelerometerSaturated)
            })
    }

    /// Finds a mean that no stationary sensor has.
    fn implausible_mean(
        &self,
        gyroscope: &Window,
        accelerometer: &Window,
        temperature_celsius: f32,
    ) -> Option<MotionReason> {
        let limit = zero_rate_limit_degrees_s(temperature_celsius) * self.noise.counts_per_degree_s;
        // A NaN fails every comparison.
        let is_offset = |mean: &f32| mean.abs() <= limit;
        if let Some(axis) = first_axis(gyroscope.mean.each_ref().map(|mean| !is_offset(mean))) {
            return Some(MotionReason::SteadyRotation(axis));
        }
        let [x, y, z] = accelerometer.mean;
        let g = self.noise.counts_per_g;
        let squared = (x * x + y * y + z * z) / (g * g);
        let is_gravity =
            (MIN_GRAVITY_G * MIN_GRAVITY_G..=MAX_GRAVITY_G * MAX_GRAVITY_G).contains(&squared);
        (!is_gravity).then_some(MotionReason::NoGravity)
    }

    fn excess_variance(
        &mut self,
        gyroscope: &Window,
        accelerometer: &Window,
        samples: u16,
    ) -> Option<MotionReason> {
        let rotation = self.gyroscope.noisy_axis(gyroscope, samples);
        rotation.map(MotionReason::Rotation).or_else(|| {
            let vibration = self.accelerometer.noisy_axis(accelerometer, samples);
            vibration.map(MotionReason::Vibration)
        })
    }

    /// Finds a mean that differs from the `before` samples in earlier windows.
    fn drift(
        &self,
        gyroscope: &Window,
        accelerometer: &Window,
        samples: u16,
        before: u16,
    ) -> Option<MotionReason> {
        let tilt = self
            .accelerometer
            .drifting_axis(accelerometer, samples, before);
        tilt.map(MotionReason::Tilt).or_else(|| {
            let rotation = self.gyroscope.drifting_axis(gyroscope, samples, before);
            rotation.map(MotionReason::Rotation)
        })
    }

    /// Finds a slope through the means of all windows.
    fn trend(&self) -> Option<MotionReason> {
        let [accelerometer, gyroscope] = [&self.accelerometer, &self.gyroscope]
            .map(|channel| channel.trending_axis(&self.positions, self.window_samples));
        accelerometer
            .map(MotionReason::Tilt)
            .or_else(|| gyroscope.map(MotionReason::Rotation))
    }

    /// Returns whether enough samples agree with the expected offset to end the average here.
    fn confirms_expectation(&self) -> bool {
        let Some(expected) = self.expected else {
            return false;
        };
        let has_trend = self.positions.windows >= MIN_TREND_WINDOWS;
        if !has_trend || self.count < self.samples / EXPECTED_DIVISOR {
            return false;
        }
        let error = self.gyroscope.mean_variance(self.count);
        let limit = EXPECTATION_SIGMA * libm::sqrtf(error + expected.sigma * expected.sigma);
        (self.gyroscope.mean(self.count) - expected.offset).is_within(limit)
    }
}

/// Returns the largest zero-rate offset that the datasheet allows at a die temperature, °/s.
fn zero_rate_limit_degrees_s(temperature_celsius: f32) -> f32 {
    let away = (temperature_celsius - 25.0).abs() / ZERO_RATE_TEMPERATURE_RANGE_CELSIUS;
    ZERO_RATE_DEGREES_S
        + ZERO_RATE_TEMPERATURE_DEGREES_S * away.min(1.0)
        + ZERO_RATE_TOLERANCE_DEGREES_S
}
