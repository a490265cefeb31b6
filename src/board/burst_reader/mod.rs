//! Reads the sensor's 14 data registers after each data-ready edge, by one interrupt per bus event.
//!
//! ```text
//! edge ─ START ─ SB: address+W ─ ADDR: pointer ─ BTF: START again
//!      ─ SB: address+R ─ ADDR: DMA on ─ transfer complete: STOP
//! ```
//!
//! The order of register accesses is the reference manual's (RM0090, 27.3.3 master transmitter and
//! receiver, 27.3.7 DMA). A burst takes 384 µs at 400 kHz.
//!
//! - **Deadlines.** The alarm bounds each burst: one that has not ended [`BURST_DEADLINE_US`] after
//!   its edge is aborted. After [`FAILURES_IN_A_ROW`] failures, or one that leaves the bus in an
//!   unknown state, the reader disables itself. The supervisor then recovers the bus, and meanwhile
//!   the alarm requests stale snapshots.
//! - **Unexpected events.** A fault can leave a flag set that no step clears. It is masked, so that
//!   the alarm gets its turn.
//! - **Missing edges.** If no edge comes within [`SILENCE_DEADLINE_US`], the alarm starts the
//!   bursts, one per sample period, until edges come again. An edge that comes too soon after the
//!   last one starts nothing: it is a glitch, or the sensor has lost its sample rate.
//! - **Settings.** Between bursts the attitude task may request a check: the same steps read a few
//!   of the sensor's settings back. A wrong one disables the reader, and the supervisor configures
//!   the sensor again.
//! - **Compass.** The attitude task may request a transfer with the compass instead: a read by the
//!   same steps, or the write of a setting. An attitude is never later because of it.
//! - **Buffers.** Bursts go to the attitude task without being copied. There are two buffers: DMA
//!   fills one while the attitude task reads the other.
//! - **Lost samples.** An edge without a burst of its own, a failed burst, and a burst that finds
//!   the attitude task busy are counted. The next good burst carries the count as
//!   `missed_before`.

mod alarm;
mod between_bursts;
mod compass_transfer;
mod dma;
mod link;
mod port;
mod settings_check;
mod transaction;

pub use compass_transfer::{CompassTransfers, set_compass_fault};
pub use link::{
    enable, failures, flag_sensor_reset, is_enabled, pause, request_transaction, take_stale,
    take_wrong_setting,
};
pub use port::is_bus_held;

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU8, Ordering, compiler_fence};

use super::retained;
use super::sensor_bus::with_clock;
use super::timebase::{self, Timebase};
use crate::compass;
use crate::fault::{BurstFailure, BurstFault, BurstStep, ClockSource, FaultClass};
use crate::health::BoardFlags;
use crate::mpu6050::registers::Register;
use crate::mpu6050::{BURST_LENGTH, Burst};
use link::{LINK, exti, setup};
use port::{enable_event_interrupts, i2c1, mask_unexpected_event, send_stop};
use transaction::Transaction;

/// Longest time from an edge to the end of its burst, in µs: twice what the bus needs.
pub const BURST_DEADLINE_US: u32 = 800;
/// Longest time without an edge, in µs: three periods at the default 1 kHz.
pub const SILENCE_DEADLINE_US: u32 = 3_000;
/// Failed bursts in a row after which the bus is recovered and the sensor checked.
pub const FAILURES_IN_A_ROW: u8 = 3;
/// Bursts that are taken back before the bus is recovered, whatever comes between them.
const MOST_WITHDRAWN: u8 = 3;
/// Period of stale snapshots while the reader is disabled, in µs.
const STALE_PERIOD_US: u32 = 5_000;
/// Time from a check to the next burst while the alarm starts the bursts, in µs.
const POLL_AFTER_CHECK_US: u32 = 300;
/// Longest time from the request of a STOP to its end, in µs: a byte that the port has begun to
/// clock may come before it.
const LONGEST_STOP_US: u32 = 30;
/// Shortest period while the reader is disabled, waits for its first edge, or polls: sends every
/// edge to `on_unexpected_edge`.
const EXAMINE_EVERY_EDGE_US: u32 = 0;

/// Burst reader. All its methods run at one priority, so none interrupts another.
pub struct BurstReader {
    step: BurstStep,
    transaction: Transaction,
    /// True if a bus error has been flagged while the sensor sent.
    is_suspect: bool,
    /// Bursts that were taken back since the reader was enabled.
    withdrawn: u8,
    /// First register of the present steps.
    pointer: u8,
    /// Buffer that DMA fills.
    buffer: BufferIndex,
    /// Time of the last edge. The low half is the timer's count.
    captured_at_us: u64,
    /// Shortest time to the next edge. A sooner one is examined.
    shortest_period_us: u32,
    /// Time from an edge to the alarm after its burst.
    silence_us: u32,
    /// Address of the chip, as the first byte on the bus: shifted, for writing.
    address_byte: u8,
    /// Conditions to report with the next burst.
    flags: BoardFlags,
    /// Conditions to report with every burst.
    latched_flags: BoardFlags,
    /// Samples lost before the next burst.
    missed: u8,
    mode: Mode,
    failures_in_a_row: u8,
    /// True if an edge has come during a transaction that is no burst.
    is_edge_waiting: bool,
    next_check: u8,
}

/// Meaning of the next edge.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// None: the reader is disabled, or the alarm has not unmasked the edges yet.
    Disabled,
    /// The start of the first burst: no sample before it is missed.
    FirstEdge,
    /// The start of the next burst.
    Edges,
    /// The return of the edges, after the alarm has started the bursts.
    Polling,
}

impl BurstReader {
    /// Creates a disabled reader with its DMA stream set up. [`enable`] starts it. Times by the
    /// internal oscillator are flagged with every burst.
    pub fn start(clock: ClockSource) -> Self {
        dma::start();
        let latched_flags = match clock {
            ClockSource::Crystal => BoardFlags::empty(),
            ClockSource::InternalOscillator => BoardFlags::INTERNAL_CLOCK,
        };
        let reader = Self {
            step: BurstStep::Idle,
            transaction: Transaction::Burst,
            is_suspect: false,
            withdrawn: 0,
            pointer: Register::AccelerometerXHigh.address(),
            buffer: BufferIndex::First,
            captured_at_us: 0,
            shortest_period_us: EXAMINE_EVERY_EDGE_US,
            silence_us: SILENCE_DEADLINE_US,
            address_byte: 0,
            flags: latched_flags,
            latched_flags,
            missed: 0,
            mode: Mode::Disabled,
            failures_in_a_row: 0,
            is_edge_waiting: false,
            next_check: 0,
        };
        reader.prepare_dma();
        timebase::set_burst_alarm(timebase::now().wrapping_add(STALE_PERIOD_US));
        reader
    }

    /// Handles EXTI1: starts the burst of this edge.
    #[inline(always)]
    pub fn on_data_ready(&mut self, timebase: &mut Timebase) {
        exti().pr().write(|w| w.pr1().clear_bit_by_one());
        let count = timebase.captured();
        let since_last = count.wrapping_sub(self.captured_at_us as u32);
        // The difference wraps, so this one comparison finds both an edge that is too early and one
        // that is too late.
        let beyond = since_last.wrapping_sub(self.shortest_period_us);
        if self.step != BurstStep::Idle || beyond > self.shortest_period_us / 2 {
            self.on_unexpected_edge(count, since_last, timebase);
            return;
        }
        self.start_burst(count, timebase);
    }

    /// Handles an edge that comes too soon, after missed ones, during a transaction, or as the
    /// first one.
    #[cold]
    #[inline(never)]
    fn on_unexpected_edge(&mut self, count: u32, since_last: u32, timebase: &mut Timebase) {
        match self.mode {
            // The edge was pending when the reader was disabled. The bus is the supervisor's.
            Mode::Disabled => return,
            // While polling, a burst under way reads this edge's sample.
            Mode::FirstEdge | Mode::Polling => self.return_to_edges(),
            Mode::Edges if since_last < self.shortest_period_us => {
                retained::count(FaultClass::InterruptGlitch);
                return;
            }
            // The next edge counts this one as missed.
            Mode::Edges if self.step != BurstStep::Idle && self.transaction.is_burst() => return,
            Mode::Edges => {
                let mut remaining_us = since_last;
                while remaining_us > self.shortest_period_us * 3 / 2 && self.missed < u8::MAX {
                    self.count_missed();
                    remaining_us = remaining_us.saturating_sub(setup().period_us);
                }
            }
        }
        if self.step == BurstStep::Idle {
            self.await_stop();
            self.start_burst(count, timebase);
        } else {
            self.is_edge_waiting = !self.transaction.is_burst();
        }
    }

    /// Waits for the STOP of the last transaction. Edges that return may come at any time, and a
    /// write of CR1 while STOP is pending makes the bit stick (RM0090, 27.6.1).
    fn await_stop(&self) {
        let since = timebase::now();
        while i2c1().cr1().read().stop().bit_is_set() && !timebase::elapsed(since, LONGEST_STOP_US)
        {
        }
    }

    /// Starts a burst for the edge with this count.
    #[inline(always)]
    fn start_burst(&mut self, count: u32, timebase: &mut Timebase) {
        self.captured_at_us = timebase.extend(count);
        timebase::set_burst_alarm(count.wrapping_add(BURST_DEADLINE_US));
        self.send_start();
    }

    #[inline(always)]
    fn send_start(&mut self) {
        i2c1()
            .cr1()
            .write(|w| w.pe().set_bit().ack().set_bit().start().set_bit());
        self.step = BurstStep::Start;
    }

    /// Handles an I2C1 event: one step of the burst.
    #[inline(always)]
    pub fn on_bus_event(&mut self) {
        let i2c = i2c1();
        let status = i2c.sr1().read();
        match self.step {
            BurstStep::Start if status.sb().bit() => {
                i2c.dr().write(|w| w.dr().set(self.address_byte));
                self.step = BurstStep::AddressWrite;
            }
            BurstStep::AddressWrite if status.addr().bit() => {
                i2c.sr2().read();
                i2c.dr().write(|w| w.dr().set(self.pointer));
                self.step = BurstStep::Pointer;
            }
            BurstStep::Pointer if status.btf().bit() => {
                // Reading DR clears BTF, which would otherwise interrupt again until the start is
                // on the bus.
                i2c.dr().read();
                i2c.cr1()
                    .write(|w| w.pe().set_bit().ack().set_bit().start().set_bit());
                self.step = BurstStep::RepeatedStart;
            }
            BurstStep::RepeatedStart if status.sb().bit() => {
                i2c.dr().write(|w| w.dr().set(self.address_byte | 1));
                self.step = BurstStep::AddressRead;
            }
            BurstStep::AddressRead if status.addr().bit() => {
                // From here DMA moves the bytes. LAST answers the last one with NACK.
                i2c.cr2().write(|w| {
                    with_clock(w)
                        .iterren()
                        .set_bit()
                        .dmaen()
                        .set_bit()
                        .last()
                        .set_bit()
                });
                dma::enable();
                i2c.sr2().read();
                self.step = BurstStep::Data;
            }
            // Bytes that came before a late STOP. This read clears BTF.
            BurstStep::Idle | BurstStep::Start if status.btf().bit() => {
                i2c.dr().read();
            }
            BurstStep::Setting if compass::IS_BUILT_IN => self.on_write_event(),
            _ => mask_unexpected_event(),
        }
    }

    /// Handles DMA1 stream 0: the bytes are in memory. Returns whether a burst is ready for the
    /// attitude task.
    #[inline(always)]
    pub fn on_transfer_complete(&mut self, timebase: &mut Timebase) -> bool {
        let is_complete = dma::take_complete();
        // Aborting a stream sets its flag too. Such an interrupt finds another step here.
        if self.step != BurstStep::Data {
            return false;
        }
        if !is_complete {
            self.fail(BurstFault::Dma);
            return false;
        }
        // Ends the DMA requests. The port clocks on until STOP, and such a byte must not become the
        // first one of the next burst.
        enable_event_interrupts();
        if !self.transaction.is_burst() {
            self.end_other_read(timebase);
            return false;
        }
        if self.is_suspect && self.take_suspicion() {
            self.fail(BurstFault::BusError);
            return false;
        }
        send_stop();
        self.step = BurstStep::Idle;
        self.failures_in_a_row = 0;
        let next_alarm = (self.captured_at_us as u32).wrapping_add(self.silence_us);
        timebase::set_burst_alarm(next_alarm);
        let is_free = is_free();
        if is_free {
            offer(self.buffer, self.captured_at_us, self.missed, self.flags);
            self.buffer = self.buffer.other();
            self.missed = 0;
            self.flags = self.latched_flags;
        } else {
            self.report_late();
        }
        self.prepare_dma();
        is_free
    }

    #[cold]
    #[inline(never)]
    fn report_late(&mut self) {
        self.flags |= BoardFlags::LATE;
        self.count_missed();
        retained::count(FaultClass::AttitudeLate);
    }

    /// Returns whether the sensor may have released the bus before the end of a suspect burst. The
    /// next burst is not suspect.
    #[cold]
    #[inline(never)]
    fn take_suspicion(&mut self) -> bool {
        self.is_suspect = false;
        // SAFETY: the transfer into this buffer is complete, and the buffer is not offered yet.
        unsafe { &*BUFFERS.0[self.buffer as usize].get() }.has_lost_end()
    }

    /// Takes a burst back whose last byte came with a bus error: if both interrupts are pending,
    /// that of the transfer comes first. The supervisor recovers the bus after
    /// [`MOST_WITHDRAWN`] such bursts.
    fn withdraw_lost_burst(&mut self) {
        let ready = usize::from(READY.load(Ordering::Relaxed));
        // `NONE_READY` and `TAKEN` are no buffer's.
        let Some(buffer) = BUFFERS.0.get(ready.wrapping_sub(1)) else {
            return;
        };
        // SAFETY: DMA does not write this buffer. The attitude task at most begins to read it.
        let received = unsafe { &*buffer.get() };
        // After a late attitude the last burst was not offered, but one before it.
        let was_offered = self.missed == 0;
        if received.has_lost_end() && was_offered {
            READY.store(NONE_READY, Ordering::Relaxed);
            self.missed = received.burst.missed_before.saturating_add(1);
            self.flags |= received.flags | BoardFlags::BUS_FAULT;
            self.withdrawn += 1;
            if self.withdrawn >= MOST_WITHDRAWN {
                self.disable();
            }
        }
    }

    /// Makes the next steps read a burst.
    fn return_to_bursts(&mut self) {
        self.transaction = Transaction::Burst;
        self.is_suspect = false;
        self.address_byte = LINK.address.load(Ordering::Relaxed) << 1;
        self.pointer = Register::AccelerometerXHigh.address();
        self.step = BurstStep::Idle;
        self.prepare_dma();
    }

    /// Handles an I2C1 error: the sensor did not acknowledge, or the bus failed.
    pub fn on_bus_error(&mut self) {
        let status = i2c1().sr1().read();
        // Writing zero clears the error flags. The other flags ignore writes.
        i2c1().sr1().reset();
        let fault = if status.af().bit() {
            BurstFault::NotAcknowledged
        } else if status.arlo().bit() {
            BurstFault::ArbitrationLost
        } else if status.berr().bit() {
            // The chip may flag a bus error that did not happen (errata): the transfer continues.
            // After a real one the sensor acknowledges nothing more, or releases the bus.
            retained::count(FaultClass::BusError);
            match self.step {
                BurstStep::Data => self.is_suspect = true,
                BurstStep::Idle => self.withdraw_lost_burst(),
                _ => {}
            }
            return;
        } else if status.ovr().bit() {
            BurstFault::Overrun
        } else {
            return;
        };
        if self.step != BurstStep::Idle {
            self.fail(fault);
        }
    }

    /// Loads the supervisor's set-up and flags, after the reader was enabled.
    fn load_set_up(&mut self) {
        self.withdrawn = 0;
        self.return_to_edges();
        enable_event_interrupts();
        self.address_byte = LINK.address.load(Ordering::Relaxed) << 1;
        self.flags.remove(BoardFlags::SCALES_VERIFIED);
        self.flags |= self.latched_flags | LINK.take_pending_flags();
    }

    fn return_to_edges(&mut self) {
        self.mode = Mode::Edges;
        self.set_shortest_period();
        self.silence_us = SILENCE_DEADLINE_US;
        self.latched_flags.remove(BoardFlags::POLLED);
        // A burst under way was still started by the timer.
        if self.step == BurstStep::Idle {
            self.flags.remove(BoardFlags::POLLED);
        }
    }

    #[inline(never)]
    fn set_shortest_period(&mut self) {
        let has_internal_clock = self.latched_flags.contains(BoardFlags::INTERNAL_CLOCK);
        self.shortest_period_us = setup().shortest_period_us(has_internal_clock);
    }

    /// Reports this condition with every burst from now on.
    fn latch(&mut self, flag: BoardFlags) {
        self.latched_flags |= flag;
        self.flags |= flag;
    }

    fn count_missed(&mut self) {
        self.missed = self.missed.saturating_add(1);
    }

    #[cold]
    #[inline(never)]
    fn fail(&mut self, fault: BurstFault) {
        if compass::IS_BUILT_IN && self.transaction.is_of_compass() && self.fail_transfer(fault) {
            return;
        }
        let failure = BurstFailure {
            fault,
            step: self.step,
        };
        LINK.record(failure);
        retained::count(failure.class());
        self.flags |= BoardFlags::BUS_FAULT;
        enable_event_interrupts();
        // After any other fault a START may be pending. The recovery then resets the port.
        let is_bus_known = matches!(fault, BurstFault::NotAcknowledged | BurstFault::BusError);
        if is_bus_known {
            send_stop();
        }
        if self.transaction.is_burst() {
            self.count_missed();
        }
        dma::stop();
        self.return_to_bursts();
        self.is_edge_waiting = false;
        self.failures_in_a_row = self.failures_in_a_row.saturating_add(1);
        timebase::set_burst_alarm(timebase::now().wrapping_add(SILENCE_DEADLINE_US));
        if !is_bus_known || self.failures_in_a_row >= FAILURES_IN_A_ROW {
            self.failures_in_a_row = 0;
            self.disable();
        }
    }

    /// Releases the bus to the supervisor. The alarm then publishes a stale snapshot immediately.
    fn disable(&mut self) {
        self.mode = Mode::Disabled;
        self.shortest_period_us = EXAMINE_EVERY_EDGE_US;
        exti().imr().reset();
        i2c1().cr2().write(|w| with_clock(w));
        LINK.is_enabled.store(false, Ordering::Release);
        timebase::raise_burst_alarm();
    }

    /// Prepares the stopped DMA for the next burst. The attitude task reads the other buffer.
    #[inline(always)]
    fn prepare_dma(&self) {
        dma::prepare(self.buffer.bytes_address(), BURST_LENGTH as u16);
    }
}

/// Burst with the conditions that the board reports.
pub struct ReceivedBurst {
    /// Burst from the sensor.
    pub burst: Burst,
    /// Conditions that the board reports.
    pub flags: BoardFlags,
}

impl ReceivedBurst {
    /// Returns whether the last byte is 0xFF, as after a sensor that has released the bus.
    const fn has_lost_end(&self) -> bool {
        self.burst.bytes[BURST_LENGTH - 1] == 0xFF
    }
}

/// Index of a burst buffer.
#[derive(Clone, Copy, PartialEq, Eq)]
enum BufferIndex {
    First = 0,
    Second = 1,
}

impl BufferIndex {
    /// Returns the other buffer.
    const fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }

    /// Returns the memory that DMA fills with the burst's bytes.
    fn bytes_address(self) -> u32 {
        let burst = core::mem::offset_of!(ReceivedBurst, burst);
        let bytes = core::mem::offset_of!(Burst, bytes);
        BUFFERS.0[self as usize].get() as u32 + (burst + bytes) as u32
    }
}

struct BurstBuffers([UnsafeCell<ReceivedBurst>; 2]);

// SAFETY: the reader writes a buffer, or lets DMA write it, only while `READY` excludes the
// attitude task from it.
unsafe impl Sync for BurstBuffers {}

static BUFFERS: BurstBuffers = BurstBuffers([const { UnsafeCell::new(EMPTY) }; 2]);

const EMPTY: ReceivedBurst = ReceivedBurst {
    burst: Burst {
        bytes: [0; BURST_LENGTH],
        captured_at_us: 0,
        missed_before: 0,
    },
    flags: BoardFlags::empty(),
};

/// Buffer that is ready for the attitude task, plus one; [`NONE_READY`]; or [`TAKEN`].
static READY: AtomicU8 = AtomicU8::new(NONE_READY);
const NONE_READY: u8 = 0;
/// The attitude task reads a buffer.
const TAKEN: u8 = 3;

/// Returns whether the attitude task has returned the buffer that it took. Only the reader calls
/// this.
#[inline(always)]
fn is_free() -> bool {
    READY.load(Ordering::Relaxed) == NONE_READY
}

/// Offers a buffer, whose bytes DMA has filled, to the attitude task. Only the reader calls this,
/// and only while [`is_free`] holds.
#[inline(always)]
fn offer(buffer: BufferIndex, captured_at_us: u64, missed_before: u8, flags: BoardFlags) {
    // SAFETY: no buffer is ready, so the attitude task reads neither until the store below.
    let received = unsafe { &mut *BUFFERS.0[buffer as usize].get() };
    received.burst.captured_at_us = captured_at_us;
    received.burst.missed_before = missed_before;
    received.flags = flags;
    compiler_fence(Ordering::Release);
    READY.store(buffer as u8 + 1, Ordering::Relaxed);
}

/// Lends the ready burst to `work`, and returns its buffer afterwards. `None` if no burst is ready.
/// Only the attitude task calls this.
#[inline(always)]
pub(super) fn take<R>(work: impl FnOnce(&ReceivedBurst) -> R) -> Option<R> {
    let buffer = match READY.load(Ordering::Relaxed) {
        NONE_READY => return None,
        1 => BufferIndex::First,
        _ => BufferIndex::Second,
    };
    READY.store(TAKEN, Ordering::Relaxed);
    compiler_fence(Ordering::Acquire);
    // SAFETY: while a buffer is ready the reader neither writes it nor points DMA at it.
    let result = work(unsafe { &*BUFFERS.0[buffer as usize].get() });
    compiler_fence(Ordering::Release);
    READY.store(NONE_READY, Ordering::Relaxed);
    Some(result)
}
