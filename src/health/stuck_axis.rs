//! An axis that repeats its value while another axis changes: it is stuck.
//!
//! The monitor compares one sample in every 1/bandwidth of the low-pass filter, because those
//! between have no noise of their own. It judges windows of 25 such samples: 0.13 s at 188 Hz.
//!
//! The noise of the product specification (§6.1, ±2000 °/s) repeats a gyroscope axis through a
//! window once in 10¹¹ times at 188 Hz, in 40,000 at 42 Hz and in 110 at 20 Hz. So there is no
//! check below 42 Hz, and only a window with motion shows a stuck axis.
//!
//! `SampleMonitor` has the same windows for samples in SI units.

use super::monitored_sensor::MonitoredSensor;
use crate::serialize::StateVisitor;

/// Words of a burst: accelerometer, temperature, gyroscope.
const WORDS: usize = 7;

/// Samples of a window.
pub(super) const WINDOW_SAMPLES: u8 = 25;

/// Change over a window that noise does not reach: six σ of two readings' difference at 188 Hz
/// (product specification §6.1, §6.2). At ±16 g and ±2000 °/s they are 128 and 16 counts.
pub(super) const MOTION_G: f32 = 0.0625;
pub(super) const MOTION_DEGREES_S: f32 = 0.977;

/// Narrowest low-pass filter that leaves enough noise, Hz.
const NARROWEST_HZ: u16 = 42;

/// Values of a sample: those of a burst, or of a sample in SI units.
pub(super) trait Values: Copy + Default {
    /// Axes, a bit each.
    const AXES: u8;

    /// Changes that noise does not reach, unless they are constants.
    type Motion: Copy + Default;

    /// Adds the axes that differ from those of a later sample, a bit each.
    fn add_changed(&self, later: &Self, changed: &mut u8);

    /// Adds the axes that repeat for another reason than a fault, a bit each. `last` is the last
    /// sample of the window. Returns whether an axis has moved since the first one.
    fn add_excused(&self, last: &Self, motion: &Self::Motion, changed: &mut u8) -> bool;
}

impl Values for [u8; 14] {
    /// All words but the temperature.
    const AXES: u8 = 0b111_0111;

    type Motion = MotionCounts;

    #[inline]
    fn add_changed(&self, later: &Self, changed: &mut u8) {
        for (word, (first, counts)) in words(self).zip(words(later)).enumerate() {
            *changed |= u8::from(first != counts) << word;
        }
    }

    #[inline]
    fn add_excused(&self, last: &Self, motion: &MotionCounts, changed: &mut u8) -> bool {
        let MotionCounts { force, rate } = *motion;
        let motion: [u16; WORDS] = [force, force, force, u16::MAX, rate, rate, rate];
        let mut has_moved = false;
        let pairs = words(self).zip(words(last));
        for (word, ((first, last), motion)) in pairs.zip(motion).enumerate() {
            has_moved |= last.abs_diff(first) > motion;
            // A turn faster than full scale repeats it too.
            let is_full_scale = first == i16::MAX || first <= -i16::MAX;
            *changed |= u8::from(is_full_scale) << word;
        }
        has_moved
    }
}

/// Changes of counts that noise does not reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct MotionCounts {
    force: u16,
    rate: u16,
}

/// Windows over the six axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct StuckAxis<V: Values = [u8; 14]> {
    /// Samples from one that counts to the next; 0 without a check.
    gap: u8,
    samples_to_next: u16,
    samples_to_end: u8,
    /// Axes that have changed in this window, a bit each.
    changed: u8,
    is_stuck: bool,
    /// Values at the beginning of the window.
    first: V,
    motion: V::Motion,
}

impl StuckAxis {
    /// Creates the windows for the bursts of this sensor.
    pub(super) fn new(sensor: &MonitoredSensor) -> Self {
        let gap = if sensor.bandwidth_hz < NARROWEST_HZ {
            0
        } else {
            ((sensor.sample_rate_hz / f32::from(sensor.bandwidth_hz)) as u8).max(1)
        };
        let motion = MotionCounts {
            force: (MOTION_G * sensor.counts_per_g) as u16,
            rate: (MOTION_DEGREES_S * sensor.counts_per_degree_s) as u16,
        };
        Self {
            motion,
            ..Self::with_gap(gap)
        }
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.u8(&mut self.gap);
        visitor.u16(&mut self.samples_to_next);
        visitor.u8(&mut self.samples_to_end);
        visitor.u8(&mut self.changed);
        visitor.bool(&mut self.is_stuck);
        visitor.bytes(&mut self.first);
        visitor.u16(&mut self.motion.force);
        visitor.u16(&mut self.motion.rate);
    }
}

impl<V: Values> StuckAxis<V> {
    /// Creates the windows for one sample in each `gap`; none with 0.
    pub(super) fn with_gap(gap: u8) -> Self {
        Self {
            gap,
            samples_to_next: u16::from(gap),
            samples_to_end: 0,
            changed: V::AXES,
            is_stuck: false,
            first: V::default(),
            motion: V::Motion::default(),
        }
    }

    /// Takes a sample that does not repeat the one before.
    #[inline]
    pub(super) fn update(&mut self, values: &V) {
        self.samples_to_next = self.samples_to_next.wrapping_sub(1);
        if self.samples_to_next == 0 && self.gap > 0 {
            self.take(values);
        }
    }

    /// Returns whether an axis is stuck. This begins with the end of a window in which one axis
    /// repeats and another moves. It ends with the first window in which no axis does so.
    pub(super) const fn is_stuck(&self) -> bool {
        self.is_stuck
    }

    /// Takes a sample of the window, or the first one of the next. Once all axes have changed, the
    /// rest of the window needs no comparison.
    #[cold]
    #[inline(never)]
    fn take(&mut self, values: &V) {
        if self.samples_to_end == 0 {
            self.judge(values);
            self.samples_to_end = WINDOW_SAMPLES;
            self.changed = 0;
            self.first = *values;
        } else {
            self.first.add_changed(values, &mut self.changed);
        }
        self.samples_to_end -= 1;
        self.samples_to_next = u16::from(self.gap);
        if self.have_all_changed() {
            self.samples_to_next *= 1 + u16::from(self.samples_to_end);
            self.samples_to_end = 0;
        }
    }

    fn have_all_changed(&self) -> bool {
        self.changed & V::AXES == V::AXES
    }

    /// Judges the window that ends with this sample. In a window without motion an unchanged axis
    /// proves nothing; only a change of every axis clears the state.
    fn judge(&mut self, last: &V) {
        if self.have_all_changed() {
            self.is_stuck = false;
            return;
        }
        let has_moved = self
            .first
            .add_excused(last, &self.motion, &mut self.changed);
        let is_one_stuck = !self.have_all_changed();
        if has_moved || !is_one_stuck {
            self.is_stuck = is_one_stuck;
        }
    }
}

/// Returns the words of a burst, counts.
fn words(bytes: &[u8; 14]) -> impl Iterator<Item = i16> {
    let words = bytes.as_chunks::<2>().0.iter();
    words.map(|word| i16::from_be_bytes(*word))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns whether an axis is stuck after this many samples at 1 kHz. Each axis moves by a
    /// count per sample, but for this one, which reads `value`.
    fn is_stuck(axis: Option<usize>, value: i16, bandwidth_hz: u16, samples: i16) -> bool {
        let mut stuck_axis = StuckAxis::new(&MonitoredSensor {
            bandwidth_hz,
            ..MonitoredSensor::MPU_6050
        });
        for time in 0..samples {
            let mut bytes = [0; 14];
            for (word, bytes) in bytes.as_chunks_mut::<2>().0.iter_mut().enumerate() {
                let counts = if axis == Some(word) { value } else { time };
                *bytes = counts.to_be_bytes();
            }
            stuck_axis.update(&bytes);
        }
        stuck_axis.is_stuck()
    }

    #[test]
    fn an_axis_that_repeats_its_value_in_motion_is_stuck() {
        for (bandwidth_hz, gap) in [(256, 3), (188, 5), (98, 10), (42, 23)] {
            let detection = 26 * gap;
            assert!(!is_stuck(None, 0, bandwidth_hz, 3 * detection));
            let temperature = Some(3);
            assert!(!is_stuck(temperature, 7, bandwidth_hz, detection));
            for axis in [0, 1, 2, 4, 5, 6].map(Some) {
                assert!(!is_stuck(axis, 7, bandwidth_hz, detection - 1));
                assert!(is_stuck(axis, 7, bandwidth_hz, detection));
                for full_scale in [i16::MIN, -i16::MAX, i16::MAX] {
                    assert!(!is_stuck(axis, full_scale, bandwidth_hz, detection));
                }
            }
        }
    }

    #[test]
    fn noise_of_a_quiet_sensor_at_a_small_range_is_no_motion() {
        let mut stuck_axis = StuckAxis::new(&MonitoredSensor {
            bandwidth_hz: 42,
            counts_per_g: 16_384.0,
            counts_per_degree_s: 131.0,
            ..MonitoredSensor::MPU_6050
        });
        for time in 0..10_000_u32 {
            // Up to 18 mg of noise, and an axis of the gyroscope that repeats its value.
            let noise = (time.wrapping_mul(2_654_435_761) >> 16) as i16 % 300;
            let words = [noise, -noise, noise / 2, 0, 7, noise / 16, noise / 12];
            let mut bytes = [0; 14];
            for (bytes, word) in bytes.as_chunks_mut::<2>().0.iter_mut().zip(words) {
                *bytes = word.to_be_bytes();
            }
            stuck_axis.update(&bytes);
            assert!(!stuck_axis.is_stuck(), "{time}");
        }
    }

    #[test]
    fn a_low_pass_filter_that_leaves_no_noise_has_no_check() {
        for bandwidth_hz in [20, 10, 5] {
            assert!(!is_stuck(Some(4), 7, bandwidth_hz, i16::MAX));
        }
    }
}
