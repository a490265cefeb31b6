//! What the attitude task does when the attitude is out: nobody waits for it.

use super::{burst_reader, clocks, publish, retained, timebase, watchdog};
use crate::estimator::kalman::Kalman;
use crate::fault::FaultClass;
use crate::health::Flags;
use crate::pipeline::{Aftermath, Pipeline, Snapshot};

/// So many stocktakings apart is what the filter knows kept for a start after a reset: 0.2 s. An even number, so that no sample
/// has this and settings to read back.
const STOCKTAKINGS_TO_A_KEEPING: u32 = 18;
const _: () = assert!(STOCKTAKINGS_TO_A_KEEPING.is_multiple_of(2));

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
    /// So many stocktakings are left to a keeping.
    stocktakings: u32,
    is_watching: bool,
    last_flags: Flags,
    /// After a sample with just these there is nothing to do.
    steady_flags: Flags,
}

/// Flags that no sample has.
const NEVER: Flags = Flags::from_bits(1 << 30);

impl Upkeep {
    /// Before the first sample.
    pub const fn new() -> Self {
        Self {
            stocktakings: STOCKTAKINGS_TO_A_KEEPING / 2,
            is_watching: false,
            last_flags: Flags::NONE,
            steady_flags: NEVER,
        }
    }

    /// After a sample. Gives the flags before and now if they differ.
    #[inline(always)]
    pub fn after_sample(
        &mut self,
        pipeline: &mut Pipeline<Kalman>,
        aftermath: Aftermath,
    ) -> Option<(Flags, Flags)> {
        if aftermath.is_just(self.steady_flags) {
            return None;
        }
        self.look(pipeline, aftermath)
    }

    #[inline(never)]
    fn look(
        &mut self,
        pipeline: &mut Pipeline<Kalman>,
        aftermath: Aftermath,
    ) -> Option<(Flags, Flags)> {
        if aftermath.has_taken_stock() {
            self.every_so_often(pipeline);
        }
        let flags = aftermath.flags();
        if flags == self.steady_flags && !pipeline.is_suspect() {
            return None;
        }
        self.look_closer(pipeline, flags)
    }

    #[cold]
    #[inline(never)]
    fn look_closer(
        &mut self,
        pipeline: &mut Pipeline<Kalman>,
        flags: Flags,
    ) -> Option<(Flags, Flags)> {
        let is_odd = pipeline.is_suspect() | flags.contains(Flags::POLLED);
        if is_odd {
            self.check_now(pipeline);
        }
        self.is_watching = is_odd;
        // What is suspect is not valid, so that other flags than those of a valid attitude tell it at once, and else a stocktaking.
        self.steady_flags = if is_odd { NEVER } else { flags };
        self.note(flags)
    }

    #[inline(always)]
    fn every_so_often(&mut self, pipeline: &Pipeline<Kalman>) {
        watchdog::samples_go_on();
        watchdog::attitude_goes_on();
        retained::show_variance(pipeline.shown_variance_rad2());
        // Should the NMI that says so not have come.
        if clocks::have_fallen_back() {
            timebase::raise_burst_alarm();
        }
        // Every 22 ms: so every 44 ms at the full scales, and every 88 ms at the others.
        if self.stocktakings & 1 != 0 {
            burst_reader::request_check();
        }
        let (left, is_due) = self.stocktakings.overflowing_sub(1);
        self.stocktakings = left;
        if is_due {
            self.stocktakings = STOCKTAKINGS_TO_A_KEEPING - 1;
            Self::keep(pipeline);
        }
    }

    #[inline(never)]
    fn keep(pipeline: &Pipeline<Kalman>) {
        if let Some(known) = pipeline.known_with(publish::attitude()) {
            retained::keep(&known);
        }
    }

    /// Where something is odd, settings are read back after every sample.
    fn check_now(&mut self, pipeline: &mut Pipeline<Kalman>) {
        // What was read back before the rate jumped says nothing.
        if burst_reader::take_verified() && self.is_watching {
            pipeline.confirm_scales();
        }
        burst_reader::request_check();
    }

    /// After a snapshot without a sample.
    pub fn after_silence(&mut self, snapshot: &Snapshot) -> Option<(Flags, Flags)> {
        watchdog::attitude_goes_on();
        self.steady_flags = NEVER;
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
