//! Passes bursts from the burst reader to the attitude task, without copying them.
//!
//! There are two slots. DMA fills one while the attitude task reads the other. The reader offers a
//! slot when its burst is complete. The attitude task takes the slot, and returns it afterwards.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU8, Ordering, compiler_fence};

use crate::health::BoardFlags;
use crate::mpu6050::{BURST_LENGTH, Burst};

/// Burst with the conditions that the board reports.
pub struct ReceivedBurst {
    /// Burst from the sensor.
    pub burst: Burst,
    /// Conditions that the board reports.
    pub flags: BoardFlags,
}

/// Index of a slot.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Slot {
    First = 0,
    Second = 1,
}

impl Slot {
    /// Returns the other slot.
    pub(super) const fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }

    /// Returns the memory that DMA fills with the burst's bytes.
    pub(super) fn bytes_address(self) -> u32 {
        let burst = core::mem::offset_of!(ReceivedBurst, burst);
        let bytes = core::mem::offset_of!(Burst, bytes);
        SLOTS.0[self as usize].get() as u32 + (burst + bytes) as u32
    }
}

struct Slots([UnsafeCell<ReceivedBurst>; 2]);

// SAFETY: the reader writes a slot, or lets DMA write it, only while `READY` excludes the attitude
// task from it.
unsafe impl Sync for Slots {}

static SLOTS: Slots = Slots([const { UnsafeCell::new(EMPTY) }; 2]);

const EMPTY: ReceivedBurst = ReceivedBurst {
    burst: Burst {
        bytes: [0; BURST_LENGTH],
        captured_at_us: 0,
        missed_before: 0,
    },
    flags: BoardFlags::empty(),
};

/// Slot that is ready for the attitude task, plus one; or [`NONE_READY`].
static READY: AtomicU8 = AtomicU8::new(NONE_READY);
const NONE_READY: u8 = 0;

/// Returns whether the attitude task has returned the slot that it took. Only the reader calls
/// this.
#[inline(always)]
pub(super) fn is_free() -> bool {
    READY.load(Ordering::Relaxed) == NONE_READY
}

/// Offers a slot, whose bytes DMA has filled, to the attitude task. Only the reader calls this, and
/// only while [`is_free`] holds.
#[inline(always)]
pub(super) fn offer(slot: Slot, captured_at_us: u64, missed_before: u8, flags: BoardFlags) {
    // SAFETY: no slot is ready, so the attitude task reads neither until the store below.
    let received = unsafe { &mut *SLOTS.0[slot as usize].get() };
    received.burst.captured_at_us = captured_at_us;
    received.burst.missed_before = missed_before;
    received.flags = flags;
    compiler_fence(Ordering::Release);
    READY.store(slot as u8 + 1, Ordering::Relaxed);
}

/// Lends the ready burst to `work`, and returns its slot afterwards. `None` if no burst is ready.
/// Only the attitude task calls this.
#[inline(always)]
pub(super) fn take<R>(work: impl FnOnce(&ReceivedBurst) -> R) -> Option<R> {
    let slot = match READY.load(Ordering::Relaxed) {
        NONE_READY => return None,
        1 => Slot::First,
        _ => Slot::Second,
    };
    compiler_fence(Ordering::Acquire);
    // SAFETY: while a slot is ready the reader neither writes it nor points DMA at it.
    let result = work(unsafe { &*SLOTS.0[slot as usize].get() });
    compiler_fence(Ordering::Release);
    READY.store(NONE_READY, Ordering::Relaxed);
    Some(result)
}
