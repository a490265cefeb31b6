//! Attitude task: one burst becomes one published snapshot, and housekeeping follows.
//!
//! Deadline: the end of the next burst, 1 ms. The snapshot is published within a few microseconds;
//! no task waits for the housekeeping.

use super::handover::{self, ReceivedBurst};
use super::{burst_reader, clocks, publish, retained, timebase, watchdog};
use crate::fault::FaultClass;
use crate::health::Flags;
use crate::pipeline::{Pipeline, Snapshot};

/// Samples between two rounds of housekeeping: 22 ms. The settings of the sensor are all read back
/// within 88 ms.
const HOUSEKEEPING_SAMPLES: u8 = 22;
/// Rounds between two copies of the warm-start state: 0.2 s.
const WARM_START_ROUNDS: u8 = 9;

/// Flags that are counted when they appear, with their classes.
const COUNTED: [(Flags, FaultClass); 6] = [
    (Flags::FROZEN, FaultClass::Frozen),
    (Flags::REJECTED, FaultClass::Rejected),
    (Flags::GYROSCOPE_SATURATED, FaultClass::Saturated),
    (Flags::ACCELEROMETER_SATURATED, FaultClass::Saturated),
    (Flags::TEMPERATURE, FaultClass::Temperature),
    (Flags::MISSED, FaultClass::SamplesMissed),
];

/// Change of the flags.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FlagChange {
    /// Flags before the change.
    pub before: Flags,
    /// Flags after the change.
    pub now: Flags,
}

/// State of the attitude task.
pub struct AttitudeTask {
    samples_to_housekeeping: u8,
    rounds_to_warm_start: u8,
    flags: Flags,
}

impl AttitudeTask {
    /// Creates the state before the first sample.
    pub const fn new() -> Self {
        Self {
            samples_to_housekeeping: HOUSEKEEPING_SAMPLES,
            rounds_to_warm_start: WARM_START_ROUNDS,
            flags: Flags::empty(),
        }
    }

    /// Publishes the snapshot of the burst that the reader offers, or a stale one if no sample
    /// comes.
    ///
    /// `after_publication` gets the burst after its snapshot is published. Returns the flags if
    /// they have changed.
    #[inline]
    pub fn run(
        &mut self,
        pipeline: &mut Pipeline,
        after_publication: impl FnOnce(&ReceivedBurst),
    ) -> Option<FlagChange> {
        let updated = handover::take(|received| {
            let snapshot = pipeline.update(&received.burst, received.flags);
            publish::publish(&snapshot);
            after_publication(received);
            snapshot
        });
        if let Some(snapshot) = updated {
            self.keep_house(pipeline, &snapshot);
            return self.take_flags(snapshot.flags);
        }
        let (t_us, board) = burst_reader::take_stale()?;
        let snapshot = pipeline.stale(t_us, board);
        publish::publish(&snapshot);
        watchdog::report_attitude();
        self.take_flags(snapshot.flags)
    }

    /// Requests checks of the sensor's settings, and does the periodic work.
    #[inline(always)]
    fn keep_house(&mut self, pipeline: &Pipeline, snapshot: &Snapshot) {
        if pipeline.awaits_scale_check() || snapshot.flags.contains(Flags::POLLED) {
            burst_reader::request_check();
        }
        self.samples_to_housekeeping -= 1;
        if self.samples_to_housekeeping == 0 {
            self.samples_to_housekeeping = HOUSEKEEPING_SAMPLES;
            self.run_round(pipeline, snapshot);
        }
    }

    #[inline(never)]
    fn run_round(&mut self, pipeline: &Pipeline, snapshot: &Snapshot) {
        watchdog::report_samples();
        watchdog::report_attitude();
        burst_reader::request_check();
        // The NMI of a failed crystal may be missing.
        if clocks::have_fallen_back() {
            timebase::raise_burst_alarm();
        }
        self.rounds_to_warm_start -= 1;
        if self.rounds_to_warm_start == 0 {
            self.rounds_to_warm_start = WARM_START_ROUNDS;
            if let Some(start) = pipeline.warm_start(snapshot) {
                retained::keep(&start);
            }
        }
    }

    #[inline(always)]
    fn take_flags(&mut self, flags: Flags) -> Option<FlagChange> {
        if flags == self.flags {
            return None;
        }
        Some(self.change_flags(flags))
    }

    #[cold]
    #[inline(never)]
    fn change_flags(&mut self, now: Flags) -> FlagChange {
        let before = core::mem::replace(&mut self.flags, now);
        for (flag, class) in COUNTED {
            if now.contains(flag) && !before.contains(flag) {
                retained::count(class);
            }
        }
        FlagChange { before, now }
    }
}

impl Default for AttitudeTask {
    fn default() -> Self {
        Self::new()
    }
}
