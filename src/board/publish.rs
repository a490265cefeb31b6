//! Publication of the latest snapshot for telemetry, debuggers and the virtual board.
//!
//! The attitude task is the only writer. It increments `sequence` last, so a reader of lower
//! priority that finds the same count before and after its copy holds one whole snapshot. A
//! debugger, which halts the core, reads the symbol `APLOMB_SNAPSHOT`: the snapshot at offset 0,
//! the count at 44.

use core::mem::offset_of;
use core::sync::atomic::{AtomicU32, Ordering, fence};

use crate::attitude::{Quaternion, Vector3};
use crate::health::Flags;
use crate::pipeline::Snapshot;

/// Words of a snapshot.
const WORDS: usize = 11;

#[repr(C)]
struct Published {
    /// Snapshot, word by word.
    words: [AtomicU32; WORDS],
    sequence: AtomicU32,
}

const _: () = assert!(offset_of!(Published, sequence) == 44);
// The order of the words below.
const _: () = assert!(offset_of!(Snapshot, attitude) == 8 && offset_of!(Quaternion, z) == 12);
const _: () = assert!(offset_of!(Snapshot, body_rates_rad_s) == 24 && offset_of!(Vector3, z) == 8);
const _: () = assert!(offset_of!(Snapshot, tilt_variance_rad2) == 4 * (WORDS - 1));

/// Number of publications, zero until the first.
#[unsafe(no_mangle)]
static APLOMB_SNAPSHOT: Published = Published {
    words: [const { AtomicU32::new(0) }; WORDS],
    sequence: AtomicU32::new(0),
};

/// Publishes a snapshot. Only the attitude task calls this.
#[inline(always)]
pub fn publish(snapshot: &Snapshot) {
    let (q, rates) = (&snapshot.attitude, &snapshot.body_rates_rad_s);
    let [low, high, qw, qx, qy, qz, p, q_rate, r, flags, variance] = &APLOMB_SNAPSHOT.words;
    let store = |place: &AtomicU32, word: u32| place.store(word, Ordering::Relaxed);
    store(low, snapshot.t_us as u32);
    store(high, (snapshot.t_us >> 32) as u32);
    store(qw, q.w.to_bits());
    store(qx, q.x.to_bits());
    store(qy, q.y.to_bits());
    store(qz, q.z.to_bits());
    store(p, rates.x.to_bits());
    store(q_rate, rates.y.to_bits());
    store(r, rates.z.to_bits());
    store(flags, snapshot.flags.bits());
    store(variance, snapshot.tilt_variance_rad2.to_bits());
    let sequence = APLOMB_SNAPSHOT.sequence.load(Ordering::Relaxed);
    APLOMB_SNAPSHOT
        .sequence
        .store(sequence.wrapping_add(1), Ordering::Release);
}

/// Returns the latest snapshot and its number; `None` before the first. Only for tasks of lower
/// priority than the writer.
pub fn latest() -> Option<(Snapshot, u32)> {
    loop {
        let before = APLOMB_SNAPSHOT.sequence.load(Ordering::Acquire);
        if before == 0 {
            return None;
        }
        let words = APLOMB_SNAPSHOT
            .words
            .each_ref()
            .map(|word| word.load(Ordering::Relaxed));
        // The copy is complete before the count is read again.
        fence(Ordering::Acquire);
        if APLOMB_SNAPSHOT.sequence.load(Ordering::Relaxed) == before {
            return Some((snapshot_of(words), before));
        }
    }
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
