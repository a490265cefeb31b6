//! Check of the sensor's settings between two bursts: reads a few of them back.
//!
//! The check takes the same steps as a burst, but DMA writes elsewhere. A wrong setting disables
//! the reader, and the supervisor configures the sensor again.

use core::cell::UnsafeCell;
use core::sync::atomic::Ordering;

use super::link::{CHECKS, LINK, setup};
use super::{BURST_DEADLINE_US, BurstReader, Transaction, dma};
use crate::board::timebase::{self, Timebase};
use crate::health::BoardFlags;
use crate::mpu6050::{Check, SettingsState};

/// Bytes that a check reads.
struct CheckedBytes(UnsafeCell<[u8; Check::LONGEST]>);

// SAFETY: DMA writes it during a check, and the reader reads it when that has ended.
unsafe impl Sync for CheckedBytes {}

static CHECKED: CheckedBytes = CheckedBytes(UnsafeCell::new([0; Check::LONGEST]));

impl BurstReader {
    /// Starts the next check. The bus is free.
    #[inline(always)]
    pub(super) fn start_check(&mut self) {
        let check = self.check();
        self.transaction = Transaction::SettingsCheck;
        self.pointer = check.first.address();
        timebase::set_burst_alarm(timebase::now().wrapping_add(BURST_DEADLINE_US));
        dma::prepare(CHECKED.0.get() as u32, check.length as u16);
        self.send_start();
    }

    /// Compares the settings that were read back, and returns to bursts.
    #[inline(always)]
    pub(super) fn end_check(&mut self, timebase: &mut Timebase) {
        // SAFETY: the transfer into these bytes is complete.
        let bytes = unsafe { &*CHECKED.0.get() };
        let is_intact = self.check().evaluate(bytes) == SettingsState::Intact;
        let is_of_scales = self.next_check.is_multiple_of(2);
        if is_intact && is_of_scales {
            self.flags |= BoardFlags::SCALES_VERIFIED;
        }
        self.next_check = self.next_check.wrapping_add(1);
        self.resume_bursts(is_intact, timebase);
        if !is_intact {
            // The supervisor checks again, and counts the fault.
            LINK.has_wrong_setting.store(true, Ordering::Relaxed);
            self.disable();
        }
    }

    #[inline(always)]
    fn check(&self) -> &'static Check {
        &setup().checks[usize::from(self.next_check) % CHECKS]
    }
}
