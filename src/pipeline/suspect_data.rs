//! Suspect data: spurious full-scale readings, frozen data, and samples under lost settings.
//! Inflates the filter's tilt for the motion that they hide.
//!
//! Frozen data count as a pause: the filter does not get them.

use crate::attitude::Vector3;
use crate::estimator::arithmetic::square;
use crate::estimator::kalman::{HIDDEN_SHARE, Kalman, LARGEST_HIDDEN_TURN_RAD, LONG_STEP_S};
use crate::estimator::{Estimator, Sample};
use crate::health::Flags;
use crate::serialize::StateVisitor;
use crate::units::{SECONDS_PER_MICROSECOND, radians};

/// σ per axis of the tilt from the loss of the sensor's settings until its detection, rad.
const WRONG_SETTINGS_TILT_RAD: f32 = radians(5.0);

/// Largest angular acceleration of a body, rad/s²: a small quadrotor reaches 500. A gyroscope that
/// reaches full scale faster is at fault, or was hit.
const LARGEST_ACCELERATION_RAD_S2: f32 = 1_000.0;
/// Longest time for which a blow may turn the body at full scale, s.
const BLOW_S: f32 = 10.0e-3;
/// Largest rate that a sensor of this family reads, with a margin, rad/s.
const LARGEST_SENSOR_RATE_RAD_S: f32 = 100.0;
/// Longest step to a jump of the rate, µs. A longer one is a pause: the filter itself adds the
/// change of the rate to σ.
const LONGEST_JUMP_US: u32 = (LONG_STEP_S * 1.0e6) as u32;
const _: () = assert!(LONGEST_JUMP_US == 15_000);

/// Spurious full-scale readings, with their duration, and frozen data.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct SuspectData {
    /// Duration of frozen data before they are flagged.
    unflagged_s: f32,
    /// Duration of the present spurious full-scale reading, zero without one.
    spurious_s: f32,
    /// Flags of the samples that were skipped since the last one that the filter has had.
    skipped: Flags,
}

impl SuspectData {
    /// Creates the state for samples at this rate, which are flagged as frozen after this many
    /// repetitions.
    pub(super) fn new(sample_rate_hz: f32, frozen_samples: u8) -> Self {
        Self {
            unflagged_s: f32::from(frozen_samples) / sample_rate_hz,
            spurious_s: 0.0,
            skipped: Flags::empty(),
        }
    }

    /// Returns whether a sample needs [`replace_spurious_rate`](Self::replace_spurious_rate).
    #[inline]
    pub(super) fn may_be_spurious(&self, sample: &Sample) -> bool {
        sample.is_rate_saturated || self.spurious_s > 0.0
    }

    /// Returns the sample with the last rate in place of a spurious full-scale reading, and
    /// inflates the filter's tilt for what it hides. `last` is the sample before, as the filter
    /// had it.
    #[cold]
    #[inline(never)]
    pub(super) fn replace_spurious_rate(
        &mut self,
        estimator: &mut Estimator,
        last: &Sample,
        sample: &Sample,
    ) -> Sample {
        let step_us = sample.t_us.saturating_sub(last.t_us);
        let step_s = step_us as f32 * SECONDS_PER_MICROSECOND;
        let (rate, before) = (sample.angular_rate_rad_s, last.angular_rate_rad_s);
        let largest = before.norm() + LARGEST_ACCELERATION_RAD_S2 * step_s;
        let was_spurious_s = core::mem::replace(&mut self.spurious_s, 0.0);
        let hold = |rate: f32, before: f32| if rate.abs() < largest { rate } else { before };
        let held = Vector3::new(
            hold(rate.x, before.x),
            hold(rate.y, before.y),
            hold(rate.z, before.z),
        );
        let is_spurious = held != rate && (was_spurious_s > 0.0 || !rate.is_within(largest));
        let filter = estimator.filter_mut();
        // No sensor of this family gives a larger rate. The estimator then gets it as it is, and
        // rejects it beyond a limit of its own.
        if sample.is_rate_saturated && is_spurious && rate.is_within(LARGEST_SENSOR_RATE_RAD_S) {
            self.spurious_s = was_spurious_s + step_s;
            let blow =
                |spurious_s: f32| square(HIDDEN_SHARE * rate.norm() * spurious_s.min(BLOW_S));
            let hidden = |spurious_s| blow(spurious_s) + filter.pause_variance_rad2(spurious_s);
            let added = hidden(self.spurious_s) - hidden(was_spurious_s);
            filter.interrupt_rest();
            filter.inflate_tilt(added);
            return Sample {
                angular_rate_rad_s: held,
                is_rate_saturated: false,
                ..*sample
            };
        }
        // If the rate has changed meanwhile, it did so steadily.
        let turn_rad2 = square(0.5 * (rate - before).norm() * was_spurious_s);
        if filter.pause_variance_rad2(was_spurious_s) > square(LARGEST_HIDDEN_TURN_RAD) {
            filter.lose_tilt();
        } else {
            inflate_hidden_turn(filter, turn_rad2);
        }
        *sample
    }

    /// Notes the flags of a sample that the filter does not get.
    pub(super) fn skip(&mut self, flags: Flags) {
        self.skipped |= flags;
    }

    /// Inflates the filter's tilt for motion that was hidden before this sample, by lost settings
    /// or frozen data. `last` is the last sample that the filter has had.
    #[inline]
    pub(super) fn inflate(
        &mut self,
        estimator: &mut Estimator,
        last: &Sample,
        sample: &Sample,
        flags: Flags,
    ) {
        if !self.skipped.is_empty() || flags.contains(Flags::SENSOR_RESET) {
            self.inflate_for(estimator.filter_mut(), last, sample, flags);
        }
    }

    #[cold]
    #[inline(never)]
    fn inflate_for(&mut self, filter: &mut Kalman, last: &Sample, sample: &Sample, flags: Flags) {
        let skipped = core::mem::replace(&mut self.skipped, Flags::empty());
        // Blank data, which repeat too, were rejected from the first one on.
        if skipped.contains(Flags::FROZEN) && !skipped.contains(Flags::REJECTED) {
            filter.interrupt_rest();
            // The rate may have been false from the first repetition on. The filter itself takes
            // the time from the flag on for a pause.
            let change = sample.angular_rate_rad_s - last.angular_rate_rad_s;
            inflate_hidden_turn(filter, square(change.norm() * self.unflagged_s));
        }
        if (flags | skipped).contains(Flags::SENSOR_RESET) {
            filter.inflate_motion(WRONG_SETTINGS_TILT_RAD * WRONG_SETTINGS_TILT_RAD);
        }
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.f32(&mut self.unflagged_s);
        visitor.f32(&mut self.spurious_s);
        let mut skipped = self.skipped.bits();
        visitor.u32(&mut skipped);
        self.skipped = Flags::from_bits_truncate(skipped);
    }
}

/// Inflates the tilt for a jump of the rate since the sample before: the filter has turned by it,
/// and it may be false.
#[cold]
#[inline(never)]
pub(super) fn inflate_jump(estimator: &mut Estimator, last: &Sample, sample: &Sample) {
    let step_us = sample.t_us.wrapping_sub(last.t_us) as u32;
    if step_us <= LONGEST_JUMP_US {
        let step_s = step_us as f32 * SECONDS_PER_MICROSECOND;
        let change = sample.angular_rate_rad_s - last.angular_rate_rad_s;
        let turn_rad2 = change.dot(change) * square(step_s);
        let filter = estimator.filter_mut();
        if turn_rad2 > square(LARGEST_HIDDEN_TURN_RAD) {
            filter.lose_tilt();
        } else {
            filter.inflate_turn(turn_rad2);
        }
    }
}

/// Inflates the tilt for a hidden turn of this variance per axis, rad². After a large one gravity
/// shows the tilt better.
pub(super) fn inflate_hidden_turn(filter: &mut Kalman, turn_rad2: f32) {
    if turn_rad2 > square(LARGEST_HIDDEN_TURN_RAD) {
        filter.lose_tilt();
    } else {
        filter.inflate_tilt(turn_rad2);
    }
}
