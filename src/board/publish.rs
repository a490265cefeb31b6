//! The latest snapshot, for every reader: the telemetry task, a debugger, the virtual board.
//!
//! One writer, the attitude task. It counts `sequence` up last, so a reader of lower priority that
//! finds the same count before and after its copy holds one whole snapshot. A debugger finds it
//! under the symbol `APLOMB_SNAPSHOT`: the snapshot at offset 0, the count at 40.

use core::cell::UnsafeCell;
use core::mem::{MaybeUninit, offset_of};
use core::sync::atomic::{AtomicU32, Ordering};

use crate::pipeline::Snapshot;

/// The place that the snapshots are published in.
#[repr(C)]
pub struct Published {
    snapshot: UnsafeCell<MaybeUninit<Snapshot>>,
    sequence: AtomicU32,
}

// SAFETY: `publish` has one caller, and `latest` discards a copy that a publication interrupted.
unsafe impl Sync for Published {}

const _: () = assert!(offset_of!(Published, sequence) == 40);

/// Zero until the first publication.
#[unsafe(no_mangle)]
static APLOMB_SNAPSHOT: Published = Published {
    snapshot: UnsafeCell::new(MaybeUninit::zeroed()),
    sequence: AtomicU32::new(0),
};

/// Publishes a snapshot and, before it, the variance of its tilt (rad²) where `retained` shows it. Only the
/// attitude task calls this.
#[inline(always)]
pub fn publish(snapshot: &Snapshot, tilt_variance_rad2: f32) {
    super::retained::show_variance(tilt_variance_rad2);
    // SAFETY: the attitude task is the only writer and cannot preempt itself; readers have lower
    // priority, so none is half-way while this runs except one that will see `sequence` change.
    unsafe {
        APLOMB_SNAPSHOT
            .snapshot
            .get()
            .write_volatile(MaybeUninit::new(*snapshot));
    }
    let sequence = APLOMB_SNAPSHOT.sequence.load(Ordering::Relaxed);
    APLOMB_SNAPSHOT
        .sequence
        .store(sequence.wrapping_add(1), Ordering::Release);
}

/// The latest snapshot and its number, or nothing before the first. For tasks of lower priority than the writer.
pub fn latest() -> Option<(Snapshot, u32)> {
    loop {
        let before = APLOMB_SNAPSHOT.sequence.load(Ordering::Acquire);
        if before == 0 {
            return None;
        }
        // SAFETY: the bytes are initialised once `sequence` is above zero, and plain numbers: a
        // torn copy is a valid value, which the comparison below throws away.
        let snapshot = unsafe { APLOMB_SNAPSHOT.snapshot.get().read_volatile().assume_init() };
        if APLOMB_SNAPSHOT.sequence.load(Ordering::Acquire) == before {
            return Some((snapshot, before));
        }
    }
}
