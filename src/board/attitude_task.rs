//! Attitude task: one burst becomes one published snapshot. The heading and housekeeping follow.
//!
//! Deadline: the end of the next burst, 1 ms. The snapshot is published within a few microseconds;
//! no task waits for heading and housekeeping.
//!
//! # Publication
//!
//! The task publishes the latest snapshot for telemetry, debuggers and the virtual board
//! (`publication.rs`). A debugger reads the symbol `APLOMB_SNAPSHOT`: the snapshot at offset 0, the
//! number of publications at 44.

use core::mem::offset_of;
use core::sync::atomic::{AtomicU32, Ordering};

use super::burst_reader::{self, ReceivedBurst};
use super::compass::CompassReader;
use super::publication::Publication;
use super::{clocks, retained, timebase, watchdog};
use crate::attitude::{Quaternion, Vector3};
use crate::compass;
use crate::fault::FaultClass;
use crate::health::Flags;
use crate::pipeline::{Pipeline, Snapshot};

/// Samples between two rounds of housekeeping without a compass: 22 ms. The settings of the sensor
/// are all read back within four rounds: 88 ms.
const HOUSEKEEPING_SAMPLES: u8 = 22;
/// Rounds between two copies of the warm-start state: 0.2 s without a compass, 0.09 s with one.
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
    /// True if the heading filter has to follow each sample.
    has_heading: bool,
    flags: Flags,
}

impl AttitudeTask {
    /// Creates the state before the first sample.
    pub const fn new() -> Self {
        Self {
            samples_to_housekeeping: HOUSEKEEPING_SAMPLES,
            rounds_to_warm_start: WARM_START_ROUNDS,
            has_heading: false,
            flags: Flags::empty(),
        }
    }

    /// Publishes the snapshot of the burst that the reader offers, or a stale one if no sample
    /// comes.
    ///
    /// `after_publication` gets the burst and its published flags. `compass` gets its phases, if
    /// there is one. Returns the flags if they have changed.
    #[inline]
    pub fn run(
        &mut self,
        pipeline: &mut Pipeline,
        mut compass: Option<&mut CompassReader>,
        after_publication: impl FnOnce(&ReceivedBurst, Flags),
    ) -> Option<FlagChange> {
        let updated = burst_reader::take(|received| {
            let snapshot = pipeline.update(&received.burst, received.flags);
            let mut flags = snapshot.flags;
            if burst_reader::is_bus_held() {
                // The rates of this burst may be false.
                flags.remove(Flags::VALID);
                flags |= Flags::BUS_FAULT | Flags::DEGRADED;
            }
            publish(&snapshot, flags);
            after_publication(received, flags);
            (snapshot, flags)
        });
        if let Some((snapshot, flags)) = updated {
            if compass::IS_BUILT_IN
                && self.has_heading
                && let Some(compass) = &mut compass
            {
                compass.update_heading(pipeline);
            }
            self.finish_sample(pipeline, compass, &snapshot);
            return self.update_flags(flags);
        }
        let (t_us, board) = burst_reader::take_stale()?;
        let snapshot = pipeline.stale(t_us, board);
        publish(&snapshot, snapshot.flags);
        watchdog::report_attitude();
        keep_state(pipeline, &snapshot);
        self.update_flags(snapshot.flags)
    }

    /// Requests checks of the sensor's settings, and does the periodic work.
    #[inline(always)]
    fn finish_sample(
        &mut self,
        pipeline: &mut Pipeline,
        compass: Option<&mut CompassReader>,
        snapshot: &Snapshot,
    ) {
        // Each condition sets `DEGRADED` too, so `VALID` alone needs neither test.
        if snapshot.flags != Flags::VALID
            && (pipeline.awaits_scale_check() || snapshot.flags.contains(Flags::POLLED))
        {
            burst_reader::request_transaction();
        }
        self.samples_to_housekeeping -= 1;
        if self.samples_to_housekeeping == 0 {
            self.run_housekeeping(pipeline, compass, snapshot);
        }
    }

    #[inline(never)]
    fn run_housekeeping(
        &mut self,
        pipeline: &mut Pipeline,
        compass: Option<&mut CompassReader>,
        snapshot: &Snapshot,
    ) {
        self.samples_to_housekeeping = HOUSEKEEPING_SAMPLES;
        // Without the feature the firmware has no code of the compass.
        if compass::IS_BUILT_IN
            && let Some(compass) = compass
        {
            let result = compass.run_phase(HOUSEKEEPING_SAMPLES, pipeline, snapshot);
            self.samples_to_housekeeping = result.samples;
            self.has_heading = compass.has_heading();
            if !result.is_housekeeping_due {
                return;
            }
        }
        watchdog::report_samples();
        watchdog::report_attitude();
        burst_reader::request_transaction();
        // The NMI of a failed crystal may be missing.
        if clocks::have_fallen_back() {
            timebase::raise_burst_alarm();
        }
        self.rounds_to_warm_start -= 1;
        if self.rounds_to_warm_start == 0 {
            self.rounds_to_warm_start = WARM_START_ROUNDS;
            keep_state(pipeline, snapshot);
        }
    }

    #[inline(always)]
    fn update_flags(&mut self, flags: Flags) -> Option<FlagChange> {
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

/// Keeps the state for a start after a reset.
#[inline(never)]
fn keep_state(pipeline: &Pipeline, latest: &Snapshot) {
    retained::keep(pipeline.warm_start(latest).as_ref());
}

impl Default for AttitudeTask {
    fn default() -> Self {
        Self::new()
    }
}

/// Words of a snapshot.
const WORDS: usize = 11;

// The order of the words below.
const _: () = assert!(offset_of!(Snapshot, attitude) == 8 && offset_of!(Quaternion, z) == 12);
const _: () = assert!(offset_of!(Snapshot, body_rates_rad_s) == 24 && offset_of!(Vector3, z) == 8);
const _: () = assert!(offset_of!(Snapshot, tilt_variance_rad2) == 4 * (WORDS - 1));

/// Latest snapshot, and the number of publications.
#[unsafe(no_mangle)]
static APLOMB_SNAPSHOT: Publication<WORDS> = Publication::new();

/// Publishes a snapshot with these flags. Only the attitude task calls this.
#[inline(always)]
fn publish(snapshot: &Snapshot, published: Flags) {
    let (q, rates) = (&snapshot.attitude, &snapshot.body_rates_rad_s);
    let store = |place: &AtomicU32, word: u32| place.store(word, Ordering::Relaxed);
    APLOMB_SNAPSHOT.publish(
        |[low, high, qw, qx, qy, qz, p, q_rate, r, flags, variance]| {
            store(low, snapshot.t_us as u32);
            store(high, (snapshot.t_us >> 32) as u32);
            store(qw, q.w.to_bits());
            store(qx, q.x.to_bits());
            store(qy, q.y.to_bits());
            store(qz, q.z.to_bits());
            store(p, rates.x.to_bits());
            store(q_rate, rates.y.to_bits());
            store(r, rates.z.to_bits());
            store(flags, published.bits());
            store(variance, snapshot.tilt_variance_rad2.to_bits());
        },
    );
}

/// Returns the number of publications since start, which may wrap.
pub(super) fn publications() -> u32 {
    APLOMB_SNAPSHOT.count()
}

/// Returns the latest snapshot and its number; `None` before the first. Only for tasks of lower
/// priority than the writer.
pub fn latest() -> Option<(Snapshot, u32)> {
    let (words, number) = APLOMB_SNAPSHOT.latest()?;
    Some((snapshot_of(words), number))
}

fn snapshot_of(words: [u32; WORDS]) -> Snapshot {
    let [low, high, numbers @ .., flags, variance] = words;
    let [w, x, y, z, p, q, r] = numbers.map(f32::from_bits);
    Snapshot {
        t_us: u64::from(high) << 32 | u64::from(low),
        attitude: Quaternion::new(w, x, y, z),
        body_rates_rad_s: Vector3::new(p, q, r),
        flags: Flags::from_bits_truncate(flags),
        tilt_variance_rad2: f32::from_bits(variance),
    }
}
