//! Order of the samples: samples that come late, and a clock that was set back.
//!
//! The estimator holds the attitude at a time that does not increase, and goes on from that time.
//! After a sample that comes late, it would count the time between twice. So the pipeline
//! ignores late samples. The firmware's clock only advances, so its build goes without.

use super::suspect_data::inflate_hidden_turn;
use crate::estimator::{Estimator, LONGEST_STEP_US};
use crate::mpu6050::Config;
use crate::units::SECONDS_PER_MICROSECOND;

/// Late samples in a row.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct SampleOrder {
    /// Time of the last late sample, µs; `None` if the last sample was not late.
    late_t_us: Option<u64>,
    /// Time in which these samples came, µs: their steps, each at least the sample period.
    late_us: u32,
}

impl SampleOrder {
    /// Creates the state before the first sample.
    pub(super) const fn new() -> Self {
        Self {
            late_t_us: None,
            late_us: 0,
        }
    }

    /// Returns whether a sample at `t_us` is late: not after the last accepted one, by at most
    /// 0.5 s. Such a sample shows nothing.
    ///
    /// Late samples may also show a clock that was set back by less. When time advances again after
    /// more than three of them, the filter's tilt is inflated for the motion in their time.
    #[inline]
    pub(super) fn is_late(
        &mut self,
        estimator: &mut Estimator,
        t_us: u64,
        sensor: &Config,
    ) -> bool {
        match estimator.last_t_us() {
            Some(last_t_us) if t_us <= last_t_us || self.late_t_us.is_some() => {
                self.check(estimator, t_us, last_t_us, sensor)
            }
            _ => false,
        }
    }

    #[cold]
    #[inline(never)]
    fn check(
        &mut self,
        estimator: &mut Estimator,
        t_us: u64,
        last_t_us: u64,
        sensor: &Config,
    ) -> bool {
        if t_us <= last_t_us && last_t_us - t_us <= LONGEST_STEP_US {
            let before_us = self.late_t_us.replace(t_us).unwrap_or(t_us);
            let step_us = t_us.saturating_sub(before_us) as u32;
            let period_us = (1e6 / sensor.sample_rate_hz()) as u32;
            self.late_us = self.late_us.saturating_add(step_us.max(period_us));
            return true;
        }
        let late = core::mem::replace(self, Self::new());
        let filter = estimator.filter_mut();
        if t_us <= last_t_us {
            // The clock was set back, and the time since the last sample is unknown.
            filter.lose_tilt();
        } else {
            let late_s = late.late_us as f32 * SECONDS_PER_MICROSECOND;
            let hidden_rad2 = filter.pause_variance_rad2(late_s);
            if hidden_rad2 > 0.0 {
                filter.interrupt_rest();
                inflate_hidden_turn(filter, hidden_rad2);
            }
        }
        false
    }
}
