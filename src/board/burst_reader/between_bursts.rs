//! Transactions between two bursts: starts a transfer with the compass or a check of the sensor's
//! settings, and returns to bursts at its end.

use core::sync::atomic::Ordering;

use super::link::LINK;
use super::{
    BURST_DEADLINE_US, BurstReader, Mode, POLL_AFTER_CHECK_US, SILENCE_DEADLINE_US, i2c1,
    is_enabled, send_stop,
};
use crate::board::timebase::{self, Timebase};
use crate::compass;
use crate::fault::BurstStep;

/// Latest start of a transaction after an edge, in µs. The longest reads nine bytes of a compass,
/// in 300 µs. One that overlaps the next edge would delay its burst, and a sensor may answer that
/// with the registers of the edge before: it renews them only while its bus is idle (register map,
/// 4.17).
const LATEST_START_US: u32 = 650;

impl BurstReader {
    /// Handles SPI1, which `request_transaction` in `link.rs` pends. If the bus is free, and will
    /// be at the next edge, starts the requested transfer with the compass, or else a check of some
    /// settings.
    pub fn on_transaction_request(&mut self) {
        let is_free = self.step == BurstStep::Idle
            && i2c1().sr2().read().busy().bit_is_clear()
            && i2c1().cr1().read().stop().bit_is_clear();
        let is_late = timebase::elapsed(self.captured_at_us as u32, LATEST_START_US);
        if !is_free || is_late || !is_enabled() || LINK.is_pause_wanted.load(Ordering::Relaxed) {
            return;
        }
        if compass::IS_BUILT_IN && self.start_transfer() {
            return;
        }
        self.start_check();
    }

    /// Ends a read of settings or of the compass, and starts the burst of an edge that has come
    /// meanwhile.
    #[inline(never)]
    pub(super) fn end_other_read(&mut self, timebase: &mut Timebase) {
        if compass::IS_BUILT_IN && self.transaction.is_of_compass() {
            self.end_compass_read();
            self.resume_bursts(true, timebase);
            return;
        }
        self.end_check(timebase);
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
            Mode::Disabled | Mode::FirstEdge | Mode::Edges => {
                SILENCE_DEADLINE_US - BURST_DEADLINE_US
            }
        };
        timebase::set_burst_alarm(timebase::now().wrapping_add(next_us));
    }
}
