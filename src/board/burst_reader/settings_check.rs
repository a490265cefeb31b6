//! Check of the sensor's settings between two bursts: reads a few of them back.
//!
//! The check takes the same steps as a burst, but DMA writes elsewhere. A wrong setting disables
//! the reader, and the supervisor configures the sensor again. The request for a check starts a
//! transfer with the compass instead, if there is one.

use core::cell::UnsafeCell;
use core::sync::atomic::Ordering;

use super::link::{CHECKS, LINK, setup};
use super::{
    BURST_DEADLINE_US, BurstReader, Mode, POLL_AFTER_CHECK_US, SILENCE_DEADLINE_US, Transaction,
    dma, i2c1, is_enabled, send_stop,
};
use crate::board::timebase::{self, Timebase};
use crate::compass;
use crate::fault::BurstStep;
use crate::health::BoardFlags;
use crate::mpu6050::{Check, SettingsState};

/// Bytes that a check reads.
struct CheckedBytes(UnsafeCell<[u8; Check::LONGEST]>);

// SAFETY: DMA writes it during a check, and the reader reads it when that has ended.
unsafe impl Sync for CheckedBytes {}

static CHECKED: CheckedBytes = CheckedBytes(UnsafeCell::new([0; Check::LONGEST]));

impl BurstReader {
    /// Ends a read of settings or of the compass. Compares settings that were read back, and starts
    /// the burst of an edge that has come meanwhile.
    #[inline(never)]
    pub(super) fn end_other_read(&mut self, timebase: &mut Timebase) {
        if compass::IS_BUILT_IN && self.transaction.is_of_compass() {
            self.end_compass_read();
            self.resume_bursts(true, timebase);
            return;
        }
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
            self.disable();
        }
    }

    /// Returns to bursts, with the one of an edge that has come meanwhile.
    pub(super) fn resume_bursts(&mut self, is_intact: bool, timebase: &mut Timebase) {
        self.return_to_bursts();
        let is_edge_waiting = core::mem::take(&mut self.is_edge_waiting);
        if is_edge_waiting && is_intact {
            self.start_burst(timebase.captured(), timebase);
            return;
        }
        send_stop();
        self.await_next_burst();
    }

    /// Sets the alarm for the next edge, or for the next burst without one.
    pub(super) fn await_next_burst(&mut self) {
        let next_us = match self.mode {
            Mode::Polling => POLL_AFTER_CHECK_US,
            Mode::Starting | Mode::Edges => SILENCE_DEADLINE_US - BURST_DEADLINE_US,
        };
        timebase::set_burst_alarm(timebase::now().wrapping_add(next_us));
    }

    /// Handles SPI1, which [`request_check`](super::request_check) pends. If the bus is free,
    /// starts the requested transfer with the compass, or else a check of some settings.
    pub fn on_transfer_request(&mut self) {
        let is_free = self.step == BurstStep::Idle
            && i2c1().sr2().read().busy().bit_is_clear()
            && i2c1().cr1().read().stop().bit_is_clear();
        if !is_free || !is_enabled() || LINK.is_pause_wanted.load(Ordering::Relaxed) {
            return;
        }
        if compass::IS_BUILT_IN && self.start_transfer() {
            return;
        }
        let check = self.check();
        self.transaction = Transaction::SettingsCheck;
        self.pointer = check.first.address();
        timebase::set_burst_alarm(timebase::now().wrapping_add(BURST_DEADLINE_US));
        dma::prepare(CHECKED.0.get() as u32, check.length as u16);
        self.send_start();
    }

    #[inline(always)]
    fn check(&self) -> &'static Check {
        &setup().checks[usize::from(self.next_check) % CHECKS]
    }
}
