//! Alarm of the burst reader, which acts when no interrupt of the bus or the sensor does.
//!
//! The alarm is set for the deadline of a burst, for the silence after it, and for the next stale
//! snapshot. A lost crystal, the supervisor and the reader itself raise it at once.

use core::sync::atomic::Ordering;

use super::link::{LINK, exti, setup};
use super::{
    BurstReader, EXAMINE_EVERY_EDGE_US, Mode, SILENCE_DEADLINE_US, STALE_PERIOD_US, is_enabled,
};
use crate::board::timebase::{self, Timebase};
use crate::board::{clocks, pins, retained};
use crate::fault::{BurstFailure, BurstFault, BurstStep, FaultClass};
use crate::health::BoardFlags;

impl BurstReader {
    /// Handles the alarm: the crystal was lost, the reader was paused or enabled, a burst took too
    /// long, no edge came, or a stale snapshot is due. Returns whether the attitude task has to
    /// publish one.
    pub fn on_alarm(&mut self, timebase: &mut Timebase) -> bool {
        if clocks::have_fallen_back() {
            self.restore_clock();
        }
        if !is_enabled() {
            request_stale_snapshot(timebase, self.flags | self.latched_flags);
            return true;
        }
        if LINK.is_pause_wanted.load(Ordering::Relaxed) && self.step == BurstStep::Idle {
            self.disable();
            return false;
        }
        // An edge, or the end of a burst, may have set the alarm anew just after it was due.
        if self.mode != Mode::Disabled && !timebase::burst_alarm_is_due() {
            return false;
        }
        if self.step != BurstStep::Idle {
            self.fail(BurstFault::Deadline);
            return false;
        }
        match self.mode {
            Mode::Disabled => self.await_first_edge(),
            Mode::FirstEdge | Mode::Edges | Mode::Polling => self.start_without_edge(timebase),
        }
        false
    }

    /// Restores the clock after the loss of the crystal, and flags the times.
    #[inline(always)]
    fn restore_clock(&mut self) {
        clocks::restore();
        self.latch(BoardFlags::INTERNAL_CLOCK);
        if self.mode == Mode::Edges {
            self.set_shortest_period();
        }
    }

    /// Unmasks the edges, after the reader was enabled.
    fn await_first_edge(&mut self) {
        self.load_set_up();
        self.mode = Mode::FirstEdge;
        self.shortest_period_us = EXAMINE_EVERY_EDGE_US;
        exti().pr().write(|w| w.pr1().clear_bit_by_one());
        exti().imr().write(|w| w.mr1().set_bit());
        timebase::set_burst_alarm(timebase::now().wrapping_add(SILENCE_DEADLINE_US));
    }

    /// Starts a burst by time, because no edge came.
    fn start_without_edge(&mut self, timebase: &mut Timebase) {
        if self.mode != Mode::Polling {
            self.poll_instead_of_edges();
        }
        self.start_burst(timebase::now(), timebase);
    }

    fn poll_instead_of_edges(&mut self) {
        self.mode = Mode::Polling;
        self.shortest_period_us = EXAMINE_EVERY_EDGE_US;
        self.silence_us = setup().period_us;
        self.latch(BoardFlags::POLLED);
        retained::count(if pins::interrupt_is_high() {
            FaultClass::InterruptStuckHigh
        } else {
            FaultClass::InterruptMissing
        });
        LINK.record(BurstFailure {
            fault: BurstFault::NoDataReady,
            step: BurstStep::Idle,
        });
    }
}

/// Requests a stale snapshot with these flags, and sets the alarm for the next one.
fn request_stale_snapshot(timebase: &mut Timebase, flags: BoardFlags) {
    timebase::set_burst_alarm(timebase::now().wrapping_add(STALE_PERIOD_US));
    let t_us = timebase.extend(timebase::now());
    LINK.request_stale(t_us, flags);
}
