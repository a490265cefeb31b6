//! What the attitude task does when the attitude is out: nobody waits for it.

use super::{burst_reader, retained, watchdog};
use crate::estimator::kalman::Kalman;
use crate::fault::FaultClass;
use crate::health::Flags;
use crate::pipeline::{Pipeline, Snapshot};

/// So many samples apart are two looks at the sensor's settings: 8 ms, and 16 between two at the full
/// scales. A power of two.
const CHECK_PERIOD: u32 = 8;
/// So many samples apart is what the filter knows kept for a start after a reset. A power of two.
const KEEP_PERIOD: u32 = 128;

/// The flags whose coming is counted, with their classes.
const COUNTED: [(Flags, FaultClass); 6] = [
    (Flags::FROZEN, FaultClass::Frozen),
    (Flags::REJECTED, FaultClass::Rejected),
    (Flags::GYROSCOPE_SATURATED, FaultClass::Saturated),
    (Flags::ACCELEROMETER_SATURATED, FaultClass::Saturated),
    (Flags::TEMPERATURE, FaultClass::Temperature),
    (Flags::MISSED, FaultClass::SamplesMissed),
];

/// The state of it.
pub struct Upkeep {
    number: u32,
    last_flags: Flags,
}

impl Upkeep {
    /// Before the first sample.
    pub const fn new() -> Self {
        Self {
            number: 0,
            last_flags: Flags::NONE,
        }
    }

    /// After a sample. Gives the flags before and now if they differ.
    #[inline(always)]
    pub fn after_sample(
        &mut self,
        pipeline: &Pipeline<Kalman>,
        flags: Flags,
    ) -> Option<(Flags, Flags)> {
        watchdog::samples_go_on();
        watchdog::attitude_goes_on();
        retained::show(flags, pipeline.last_tilt_variance_rad2());
        self.number = self.number.wrapping_add(1);
        let is_due = self.number % CHECK_PERIOD == 0;
        if is_due || pipeline.is_suspect() || flags.contains(Flags::POLLED) {
            burst_reader::request_check();
        }
        if self.number % KEEP_PERIOD == 0
            && let Some(known) = pipeline.known()
        {
            retained::keep(&known);
        }
        self.note(flags)
    }

    /// After a snapshot without a sample, at `t_us`.
    pub fn after_silence(
        &mut self,
        pipeline: &Pipeline<Kalman>,
        snapshot: &Snapshot,
    ) -> Option<(Flags, Flags)> {
        watchdog::attitude_goes_on();
        let variance = pipeline.tilt_variance_rad2(snapshot.t_us);
        retained::show(snapshot.flags, variance);
        self.note(snapshot.flags)
    }

    #[inline(always)]
    fn note(&mut self, flags: Flags) -> Option<(Flags, Flags)> {
        if flags == self.last_flags {
            return None;
        }
        Some(self.change(flags))
    }

    #[cold]
    #[inline(never)]
    fn change(&mut self, flags: Flags) -> (Flags, Flags) {
        let last = core::mem::replace(&mut self.last_flags, flags);
        for (flag, class) in COUNTED {
            if flags.contains(flag) && !last.contains(flag) {
                retained::count(class);
            }
        }
        (last, flags)
    }
}

impl Default for Upkeep {
    fn default() -> Self {
        Self::new()
    }
}
