//! Unobserved motion during frozen data and under lost settings: inflates the filter's tilt.

use crate::estimator::{Estimator, Sample};
use crate::health::Flags;
use crate::serialize::StateVisitor;
use crate::units::{SECONDS_PER_MICROSECOND, radians};

/// σ per axis of the tilt from the loss of the sensor's settings until its detection, rad.
const WRONG_SETTINGS_TILT_RAD: f32 = radians(5.0);

/// Flags of samples that hide motion from the filter.
const HIDING: Flags = Flags::FROZEN.union(Flags::SENSOR_RESET);

/// Frozen data, and their duration.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct UnseenMotion {
    frozen_s: f32,
    /// Duration of frozen data before they are flagged.
    unflagged_s: f32,
}

impl UnseenMotion {
    /// Creates the state for samples at this rate, which are flagged as frozen after this many
    /// repetitions.
    pub(super) fn new(sample_rate_hz: f32, frozen_samples: u8) -> Self {
        Self {
            frozen_s: 0.0,
            unflagged_s: f32::from(frozen_samples) / sample_rate_hz,
        }
    }

    /// Inflates the filter's tilt for the motion that a sample with these flags hides.
    #[inline]
    pub(super) fn inflate(&mut self, estimator: &mut Estimator, sample: &Sample, flags: Flags) {
        if flags.intersects(HIDING) || self.frozen_s > 0.0 {
            self.inflate_for(estimator, sample, flags);
        }
    }

    #[cold]
    #[inline(never)]
    fn inflate_for(&mut self, estimator: &mut Estimator, sample: &Sample, flags: Flags) {
        let last_t_us = estimator.last_t_us().unwrap_or(sample.t_us);
        let filter = estimator.filter_mut();
        if flags.contains(Flags::FROZEN) {
            filter.interrupt_rest();
            let step_us = sample.t_us.saturating_sub(last_t_us);
            let step_us = u32::try_from(step_us).unwrap_or(u32::MAX);
            let step_s = if self.frozen_s > 0.0 {
                step_us as f32 * SECONDS_PER_MICROSECOND
            } else {
                self.unflagged_s
            };
            let before = filter.pause_variance_rad2(self.frozen_s);
            self.frozen_s += step_s;
            let after = filter.pause_variance_rad2(self.frozen_s);
            filter.inflate_tilt(after - before);
        } else {
            self.frozen_s = 0.0;
        }
        if flags.contains(Flags::SENSOR_RESET) {
            filter.inflate_motion(WRONG_SETTINGS_TILT_RAD * WRONG_SETTINGS_TILT_RAD);
        }
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.f32(&mut self.frozen_s);
        visitor.f32(&mut self.unflagged_s);
    }
}
