//! Reads the sensor's 14 data registers at each data-ready edge, one interrupt per bus event and no waiting.
//!
//! ```text
//! edge ─ START ─ SB: address+W ─ ADDR: pointer ─ BTF: START again ─ SB: address+R ─ ADDR: DMA on ─ transfer complete: STOP
//! ```
//!
//! The order of register accesses is the reference manual's (RM0090, 27.3.3 master transmitter and
//! receiver, 27.3.7 DMA). A burst takes 384 µs at 400 kHz. Every step is under the alarm: a burst
//! that has not ended [`BURST_DEADLINE_US`] after its edge, in whatever step, is aborted. After
//! [`FAILURES_IN_A_ROW`] failures, or one that leaves the bus in an unknown state, the reader stops
//! and the idle task recovers the bus; meanwhile the alarm has the attitude task say that no sample comes.
//!
//! What there is to say of a burst is one word, zero in the usual case, which one comparison tells.
//!
//! An edge that does not come within [`SILENCE_DEADLINE_US`] is done without: bursts are then started
//! by the alarm, one a sample period, until edges come again. An edge that comes too soon after the last
//! one is a glitch, or a sensor that has forgotten its sample rate; it starts nothing.
//!
//! Between bursts the attitude task may ask for a check: the same steps read a few of the sensor's
//! settings back, which are compared with what they should be. One that differs stops the reader, and
//! the idle task sets the sensor up again.
//!
//! DMA fills one slot while the attitude task reads the other: nothing is copied. An edge that comes
//! while a burst runs, a failed burst, and a burst that ends before the attitude task is done with
//! the last one are counted, and reach the next good burst as `missed_before`.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, compiler_fence};

use embedded_hal::delay::DelayNs;
use stm32f4xx_hal::pac::{DMA1, EXTI, I2C1, Interrupt, dma1, i2c1};

use super::sensor::Ready;
use super::sensor_bus::with_clock;
use super::timebase::{self, Timebase};
use super::{clocks, pins, retained};
use crate::fault::{BurstFailure, BurstFault, BurstStep, FaultClass};
use crate::health::Flags;
use crate::mpu6050::registers::Register;
use crate::mpu6050::{BURST_LENGTH, Burst, Check, Condition, Config, Part};

/// Longest time from the edge to the end of its burst, in microseconds: twice what the bus needs.
pub const BURST_DEADLINE_US: u32 = 800;
/// Longest time without an edge, in microseconds: three periods at the default 1 kHz.
pub const SILENCE_DEADLINE_US: u32 = 3_000;
/// How often it is said that no sample comes, in microseconds.
const STALE_PERIOD_US: u32 = 5_000;
/// Failed bursts in a row after which the bus is recovered and the sensor looked at.
pub const FAILURES_IN_A_ROW: u8 = 3;
/// Where the remarks on a burst count the edges without one. With the other bits of a word it shares no flag that a board has.
const MISSED_SHIFT: u32 = 24;
const MISSED_MASK: u32 = 0xFF << MISSED_SHIFT;
const IS_CHECK: u32 = 1 << 8;
const HAS_REMARKS: u32 = 1 << 9;
const _: () = assert!(
    Flags::OF_BOARD.bits() & (MISSED_MASK | IS_CHECK | HAS_REMARKS | IS_READY | SLOT_MASK) == 0
);

/// The reader. All of its methods run at one priority, so none interrupts another.
pub struct BurstReader {
    step: BurstStep,
    /// What [`Handover::ready`] is when the slot that is being filled is: with the remarks on the burst before, where
    /// [`HAS_REMARKS`] is among those on the next.
    filling: u32,
    /// Where the steps under way read from.
    pointer: Register,
    /// When the edge of this burst, or of the last one, came; its low half is the timer's count.
    captured_at_us: u64,
    /// An edge that comes sooner after the last one than this is an odd one, in microseconds.
    shortest_period_us: u32,
    /// What there is to say of the next burst, none unless something is wrong: flags, how many edges have given
    /// none ([`MISSED_MASK`]), or that the steps under way read settings back ([`IS_CHECK`]).
    remarks: u32,
    /// What there is to say of every burst from now on.
    standing: Flags,
    mode: Mode,
    failures_in_a_row: u8,
    /// An edge has come during a check.
    edge_waits: bool,
    next_check: u8,
}

/// What the next edge means.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// It is the first since the reader was enabled.
    Starting,
    /// It starts the next burst.
    Edges,
    /// Edges are back, after the alarm has started the bursts.
    Polling,
}

/// A period that no edge keeps: every one is looked at.
const EVERY_EDGE_IS_ODD: u32 = u32::MAX;

impl BurstReader {
    /// Sets the DMA stream up. The reader starts when [`enable`] lets the first edge through.
    pub fn start() -> Self {
        clocks::enable(|rcc| {
            rcc.ahb1enr().modify(|_, w| w.dma1en().set_bit());
        });
        let stream = dma1().st(0);
        // SAFETY: the data register's address, as the manual asks (RM0090, 10.3.17).
        stream
            .par()
            .write(|w| unsafe { w.pa().bits(i2c1().dr().as_ptr() as u32) });
        let reader = Self {
            step: BurstStep::Idle,
            filling: IS_READY,
            pointer: Register::AccelerometerXHigh,
            captured_at_us: 0,
            shortest_period_us: EVERY_EDGE_IS_ODD,
            remarks: 0,
            standing: Flags::NONE,
            mode: Mode::Starting,
            failures_in_a_row: 0,
            edge_waits: false,
            next_check: 0,
        };
        reader.arm_dma();
        timebase::set_burst_alarm(timebase::now().wrapping_add(STALE_PERIOD_US));
        reader
    }

    /// EXTI1: starts the burst of this edge.
    #[inline(always)]
    pub fn on_data_ready(&mut self, timebase: &Timebase) {
        exti().pr().write(|w| w.pr1().clear_bit_by_one());
        let count = timebase.captured();
        let since = count.wrapping_sub(self.captured_at_us as u32);
        if self.step != BurstStep::Idle || since < self.shortest_period_us {
            self.on_odd_edge(timebase);
            return;
        }
        self.begin(count, timebase);
    }

    /// An edge that is not the next one of many.
    #[cold]
    #[inline(never)]
    fn on_odd_edge(&mut self, timebase: &Timebase) {
        let count = timebase.captured();
        let is_idle = self.step == BurstStep::Idle;
        match self.mode {
            Mode::Starting => {
                // The bus first: what is to be known of the sensor is not needed for that.
                self.begin_rarely(count, timebase);
                self.take_up();
                return;
            }
            // Where a burst is under way, it reads this edge's sample.
            Mode::Polling => self.return_to_edges(),
            Mode::Edges => {
                let since = count.wrapping_sub(self.captured_at_us as u32);
                if since < self.shortest_period_us {
                    retained::count(FaultClass::InterruptGlitch);
                    return;
                }
                if !is_idle && !self.is_check() {
                    self.miss();
                }
            }
        }
        if is_idle {
            self.begin_rarely(count, timebase);
        } else {
            self.edge_waits = self.is_check();
        }
    }

    /// The first edge, or none of it, after the idle task has made the sensor ready.
    fn take_up(&mut self) {
        self.return_to_edges();
        let kept = self.remarks & (MISSED_MASK | HAS_REMARKS);
        self.remarks = kept | self.standing.bits() | LINK.notes.load(Ordering::Relaxed);
        LINK.notes.store(0, Ordering::Relaxed);
    }

    fn return_to_edges(&mut self) {
        self.mode = Mode::Edges;
        self.shortest_period_us = setup().shortest_period_us;
        self.standing = self.standing.without(Flags::POLLED);
        // A burst under way was started by the timer all the same.
        if self.step == BurstStep::Idle {
            self.remarks &= !Flags::POLLED.bits();
        }
    }

    /// The steps under way read settings back.
    fn is_check(&self) -> bool {
        self.remarks & IS_CHECK != 0
    }

    /// An edge gives no burst.
    fn miss(&mut self) {
        if self.remarks & MISSED_MASK != MISSED_MASK {
            self.remarks += 1 << MISSED_SHIFT;
        }
    }

    /// There is this to say from now on.
    fn stand(&mut self, flag: Flags) {
        self.standing |= flag;
        self.remarks |= flag.bits();
    }

    /// Asks for the bus to read a burst.
    #[inline(always)]
    fn begin(&mut self, count: u32, timebase: &Timebase) {
        self.captured_at_us = timebase.extend_capture(count);
        timebase::set_burst_alarm(count.wrapping_add(BURST_DEADLINE_US));
        self.ask_for_bus();
    }

    /// The same, in one place for all but the usual way.
    #[inline(never)]
    fn begin_rarely(&mut self, count: u32, timebase: &Timebase) {
        self.begin(count, timebase);
    }

    #[inline(always)]
    fn ask_for_bus(&mut self) {
        i2c1()
            .cr2()
            .write(|w| with_clock(w).itevten().set_bit().iterren().set_bit());
        i2c1()
            .cr1()
            .write(|w| w.pe().set_bit().ack().set_bit().start().set_bit());
        self.step = BurstStep::Start;
    }

    /// I2C1 event: one step of the burst.
    #[inline(always)]
    pub fn on_bus_event(&mut self) {
        let i2c = i2c1();
        let status = i2c.sr1().read();
        match self.step {
            BurstStep::Start if status.sb().bit() => {
                let address = LINK.address.load(Ordering::Relaxed);
                i2c.dr().write(|w| w.dr().set(address << 1));
                self.step = BurstStep::AddressWrite;
            }
            BurstStep::AddressWrite if status.addr().bit() => {
                i2c.sr2().read();
                i2c.dr().write(|w| w.dr().set(self.pointer as u8));
                self.step = BurstStep::Pointer;
            }
            BurstStep::Pointer if status.btf().bit() => {
                // This read clears BTF, which would otherwise interrupt again until the start is on the bus.
                i2c.dr().read();
                i2c.cr1()
                    .write(|w| w.pe().set_bit().ack().set_bit().start().set_bit());
                self.step = BurstStep::RepeatedStart;
            }
            BurstStep::RepeatedStart if status.sb().bit() => {
                let address = LINK.address.load(Ordering::Relaxed);
                i2c.dr().write(|w| w.dr().set(address << 1 | 1));
                self.step = BurstStep::AddressRead;
            }
            BurstStep::AddressRead if status.addr().bit() => {
                // From here DMA takes the bytes; LAST answers the last one with NACK.
                i2c.cr2().write(|w| {
                    with_clock(w)
                        .iterren()
                        .set_bit()
                        .dmaen()
                        .set_bit()
                        .last()
                        .set_bit()
                });
                i2c.sr2().read();
                self.step = BurstStep::Data;
            }
            // Nothing is under way that an event could belong to: none interrupts again.
            BurstStep::Idle => {
                i2c.cr2().write(|w| with_clock(w));
            }
            _ => {}
        }
    }

    /// DMA1 stream 0: the bytes are there. True if a burst is ready for the attitude task.
    #[inline(always)]
    pub fn on_transfer_complete(&mut self, timebase: &Timebase) -> bool {
        let complete = dma1().lisr().read().tcif0().bit();
        clear_dma_flags();
        // Aborting a stream sets its flag too; such an interrupt finds another step here.
        if self.step != BurstStep::Data {
            return false;
        }
        if !complete {
            self.fail(BurstFault::Dma);
            return false;
        }
        timebase::set_burst_alarm((self.captured_at_us as u32).wrapping_add(SILENCE_DEADLINE_US));
        if self.remarks != 0 && !self.take_remarks(timebase) {
            return false;
        }
        i2c1()
            .cr1()
            .write(|w| w.pe().set_bit().ack().set_bit().stop().set_bit());
        self.step = BurstStep::Idle;
        let handed_over = HANDOVER.ready.load(Ordering::Relaxed) == NOTHING_READY;
        if handed_over {
            // SAFETY: nothing is ready, so the attitude task reads neither slot until the line below.
            let burst = unsafe { &mut *HANDOVER.slot(self.filling).get() };
            burst.captured_at_us = self.captured_at_us;
            burst.missed_before = (self.filling >> MISSED_SHIFT) as u8;
            compiler_fence(Ordering::Release);
            HANDOVER.ready.store(self.filling, Ordering::Relaxed);
            self.filling ^= SLOT_MASK;
        } else {
            self.note_late();
        }
        self.arm_dma();
        handed_over
    }

    /// A transfer is complete about which there is something to say. False if it was not a burst.
    #[cold]
    #[inline(never)]
    fn take_remarks(&mut self, timebase: &Timebase) -> bool {
        if self.is_check() {
            self.end_check(timebase);
            return false;
        }
        self.failures_in_a_row = 0;
        if self.mode == Mode::Polling {
            let next = (self.captured_at_us as u32).wrapping_add(setup().period_us);
            timebase::set_burst_alarm(next);
        }
        let remarks = self.remarks & (Flags::OF_BOARD.bits() | MISSED_MASK);
        self.filling = self.filling & (IS_READY | SLOT_MASK) | remarks;
        let is_to_clear = if remarks == 0 { 0 } else { HAS_REMARKS };
        self.remarks = self.standing.bits() | is_to_clear;
        true
    }

    #[cold]
    #[inline(never)]
    fn note_late(&mut self) {
        let remarks = self.filling & (Flags::OF_BOARD.bits() | MISSED_MASK);
        self.remarks |= remarks | Flags::LATE.bits();
        self.miss();
        retained::count(FaultClass::AttitudeLate);
    }

    /// The settings are read back: compares them, and gives the bus to an edge that has come meanwhile.
    #[inline(always)]
    fn end_check(&mut self, timebase: &Timebase) {
        // SAFETY: the transfer into these bytes is complete.
        let bytes = unsafe { &*CHECKED.bytes.get() };
        let is_intact = self.check().of(bytes) == Condition::Intact;
        if is_intact && self.next_check & 1 == SCALES_ARE_EVEN {
            LINK.are_scales_verified.store(true, Ordering::Relaxed);
        }
        self.next_check = self.next_check.wrapping_add(1);
        self.remarks &= !IS_CHECK;
        self.pointer = Register::AccelerometerXHigh;
        self.step = BurstStep::Idle;
        self.arm_dma();
        let edge_waits = core::mem::take(&mut self.edge_waits);
        if edge_waits && is_intact {
            self.begin_rarely(timebase.captured(), timebase);
            return;
        }
        i2c1()
            .cr1()
            .write(|w| w.pe().set_bit().ack().set_bit().stop().set_bit());
        let patience_us = match self.mode {
            Mode::Polling => POLL_AFTER_CHECK_US,
            _ => SILENCE_DEADLINE_US - BURST_DEADLINE_US,
        };
        timebase::set_burst_alarm(timebase::now().wrapping_add(patience_us));
        if !is_intact {
            // The idle task looks again and counts.
            self.disable();
        }
    }

    /// SPI1, a peripheral that is not used: [`request_check`] asks. Reads some settings back if the bus is free.
    pub fn on_check_request(&mut self) {
        let is_free = self.step == BurstStep::Idle
            && i2c1().sr2().read().busy().bit_is_clear()
            && i2c1().cr1().read().stop().bit_is_clear();
        if !is_free || !LINK.enabled.load(Ordering::Relaxed) {
            return;
        }
        let check = self.check();
        self.remarks |= IS_CHECK;
        self.pointer = check.first;
        timebase::set_burst_alarm(timebase::now().wrapping_add(BURST_DEADLINE_US));
        // Nobody reads the bytes of a check before it ends.
        arm_dma(CHECKED.bytes.get() as u32, check.length as u16);
        self.ask_for_bus();
    }

    #[inline(always)]
    fn check(&self) -> &'static Check {
        // A remainder that no place is beyond.
        &setup().checks[usize::from(self.next_check) % CHECKS]
    }

    /// I2C1 error: the sensor did not acknowledge, or the bus misbehaved.
    pub fn on_bus_error(&mut self) {
        let status = i2c1().sr1().read();
        // The error flags are cleared by writing zero; the other flags ignore writes.
        i2c1().sr1().reset();
        let fault = if status.af().bit() {
            BurstFault::NotAcknowledged
        } else if status.arlo().bit() {
            BurstFault::ArbitrationLost
        } else if status.berr().bit() {
            BurstFault::BusError
        } else {
            BurstFault::Overrun
        };
        if self.step != BurstStep::Idle {
            self.fail(fault);
        }
    }

    /// The alarm: a burst took too long, no edge came, or it is time to say that no
    /// sample comes. True if the attitude task has to say so.
    pub fn on_alarm(&mut self, timebase: &Timebase) -> bool {
        let has_restored = clocks::have_fallen_back();
        if has_restored {
            clocks::restore();
            self.stand(Flags::INTERNAL_CLOCK);
        }
        if !is_enabled() {
            timebase::set_burst_alarm(timebase::now().wrapping_add(STALE_PERIOD_US));
            let t_us = timebase.extend_capture(timebase::now());
            LINK.stale_low.store(t_us as u32, Ordering::Relaxed);
            LINK.stale_high
                .store((t_us >> 32) as u32, Ordering::Relaxed);
            let flags = self.remarks & Flags::OF_BOARD.bits() | self.standing.bits();
            LINK.stale_flags.store(flags, Ordering::Relaxed);
            LINK.is_stale.store(true, Ordering::Release);
            return true;
        }
        if LINK.pause_wanted.swap(false, Ordering::Relaxed) && self.step == BurstStep::Idle {
            self.disable();
            return false;
        }
        if has_restored && !timebase::burst_alarm_is_due() {
            return false;
        }
        if self.step != BurstStep::Idle {
            self.fail(BurstFault::Deadline);
            return false;
        }
        if self.mode == Mode::Starting {
            self.take_up();
            timebase::set_burst_alarm(timebase::now().wrapping_add(SILENCE_DEADLINE_US));
            return false;
        }
        if self.mode == Mode::Edges {
            self.poll_instead_of_edges();
        }
        self.begin_rarely(timebase::now(), timebase);
        false
    }

    fn poll_instead_of_edges(&mut self) {
        self.mode = Mode::Polling;
        self.shortest_period_us = EVERY_EDGE_IS_ODD;
        self.stand(Flags::POLLED);
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

    #[cold]
    #[inline(never)]
    fn fail(&mut self, fault: BurstFault) {
        let failure = BurstFailure {
            fault,
            step: self.step,
        };
        LINK.record(failure);
        retained::count(failure.class());
        self.remarks |= Flags::BUS_FAULT.bits();
        i2c1().cr2().write(|w| with_clock(w));
        i2c1()
            .cr1()
            .write(|w| w.pe().set_bit().stop().bit(self.step != BurstStep::Idle));
        if !self.is_check() {
            self.miss();
        }
        self.remarks &= !IS_CHECK;
        self.pointer = Register::AccelerometerXHigh;
        self.edge_waits = false;
        self.failures_in_a_row = self.failures_in_a_row.saturating_add(1);
        self.step = BurstStep::Idle;
        self.arm_dma();
        timebase::set_burst_alarm(timebase::now().wrapping_add(SILENCE_DEADLINE_US));
        let bus_is_known = fault == BurstFault::NotAcknowledged;
        if !bus_is_known || self.failures_in_a_row >= FAILURES_IN_A_ROW {
            self.failures_in_a_row = 0;
            self.disable();
        }
    }

    /// Leaves the bus to the idle task.
    fn disable(&mut self) {
        self.mode = Mode::Starting;
        self.shortest_period_us = EVERY_EDGE_IS_ODD;
        exti().imr().reset();
        LINK.enabled.store(false, Ordering::Release);
        // Which has it said at once that no sample comes.
        timebase::raise_burst_alarm();
    }

    /// Readies the stream for the next burst. It moves nothing until the I2C asks, in step `Data`.
    #[inline(always)]
    fn arm_dma(&self) {
        let address =
            HANDOVER.slot(self.filling).get() as u32 + core::mem::offset_of!(Burst, bytes) as u32;
        // The slot lives for ever, and the attitude task reads the other one.
        arm_dma(address, BURST_LENGTH as u16);
    }
}

/// Readies the stream for a transfer to this address, which must be the reader's to fill.
#[inline(always)]
fn arm_dma(address: u32, length: u16) {
    let stream = dma1().st(0);
    if stream.cr().read().en().bit() {
        stop_dma();
    }
    // SAFETY: see the two callers.
    stream.m0ar().write(|w| unsafe { w.m0a().bits(address) });
    stream.ndtr().write(|w| w.ndt().set(length));
    stream.cr().write(|w| {
        w.chsel()
            .set(1)
            .pl()
            .very_high()
            .minc()
            .set_bit()
            .tcie()
            .set_bit()
            .teie()
            .set_bit()
            .en()
            .set_bit()
    });
}

#[cold]
#[inline(never)]
fn stop_dma() {
    let stream = dma1().st(0);
    stream.cr().reset();
    // Ends with the byte in flight (RM0090, 10.3, DMA transfer suspension): well within the readings.
    for _ in 0..STOP_READINGS {
        if stream.cr().read().en().bit_is_clear() {
            break;
        }
    }
    clear_dma_flags();
}

/// The stream is asked so often whether it has stopped.
const STOP_READINGS: u32 = 1_000;

/// Lends the ready burst to `work`, with what else there is to say of it, and gives its slot back
/// afterwards. Only the attitude task calls this.
#[inline(always)]
pub fn with_burst<R>(work: impl FnOnce(&Burst, Flags) -> R) -> Option<R> {
    let ready = HANDOVER.ready.load(Ordering::Relaxed);
    if ready == NOTHING_READY {
        return None;
    }
    compiler_fence(Ordering::Acquire);
    let flags = Flags::from_bits(ready) & Flags::OF_BOARD;
    // SAFETY: while something is ready the reader neither writes this slot nor points DMA at it.
    let result = work(unsafe { &*HANDOVER.slot(ready).get() }, flags);
    compiler_fence(Ordering::Release);
    HANDOVER.ready.store(NOTHING_READY, Ordering::Relaxed);
    Some(result)
}

/// The time at which it was noticed that no sample comes, in microseconds since boot, and what there is to
/// say of it, if that is still to be said. Only the attitude task calls this.
pub fn take_stale() -> Option<(u64, Flags)> {
    if !LINK.is_stale.load(Ordering::Acquire) {
        return None;
    }
    LINK.is_stale.store(false, Ordering::Relaxed);
    let low = LINK.stale_low.load(Ordering::Relaxed);
    let high = LINK.stale_high.load(Ordering::Relaxed);
    let flags = LINK.stale_flags.load(Ordering::Relaxed) | LINK.notes.load(Ordering::Relaxed);
    Some((
        u64::from(high) << 32 | u64::from(low),
        Flags::from_bits(flags),
    ))
}

/// Asks the reader to read some settings back now. Only the attitude task calls this, when it is done
/// with a burst: then the bus is free. It pends SPI1, a peripheral that is not used: the application binds that interrupt, at the
/// priority of the others that share the reader, to [`BurstReader::on_check_request`]. Without it no setting is ever read back.
pub fn request_check() {
    cortex_m::peripheral::NVIC::pend(Interrupt::SPI1);
}

/// Whether the full scales have been read back, and are right, since this was asked last.
pub fn take_verified() -> bool {
    let is_verified = LINK.are_scales_verified.load(Ordering::Relaxed);
    LINK.are_scales_verified.store(false, Ordering::Relaxed);
    is_verified
}

/// Says with every snapshot that the sensor has lost its settings, until samples come again.
pub fn note_sensor_reset() {
    LINK.note(Flags::SENSOR_RESET);
}

/// Lets edges through to the reader. Called by the idle task with the reader disabled, the bus free and the sensor ready with these settings.
pub fn enable(ready: &Ready, config: &Config) {
    let period_us = (1.0e6 / config.sample_rate_hz()) as u32;
    // SAFETY: the reader is disabled, and looks at its set-up only when it runs.
    unsafe {
        *SETUP.0.get() = Setup {
            checks: in_turn(config, ready.part),
            period_us,
            shortest_period_us: period_us - period_us / 16,
        };
    }
    LINK.address.store(ready.address, Ordering::Relaxed);
    LINK.enabled.store(true, Ordering::Release);
    // At which the reader takes all this up, so that the first edge finds it ready.
    timebase::raise_burst_alarm();
    exti().pr().write(|w| w.pr1().clear_bit_by_one());
    exti().imr().write(|w| w.mr1().set_bit());
}

/// Stops the reader, so that the idle task can use the bus or stall the core. A burst that runs comes to its end first.
pub fn pause() {
    exti().imr().reset();
    timebase::Delay.delay_us(BURST_DEADLINE_US);
    LINK.pause_wanted.store(true, Ordering::Relaxed);
    timebase::raise_burst_alarm();
    timebase::sleep_until(|| !is_enabled());
}

/// Whether the reader runs. False after a fault that needs the bus recovered, until the next [`enable`].
pub fn is_enabled() -> bool {
    LINK.enabled.load(Ordering::Acquire)
}

/// How many bursts have failed since boot (it wraps at 65,536), and the last failure.
pub fn failures() -> (u16, Option<BurstFailure>) {
    let packed = LINK.failures.load(Ordering::Relaxed);
    let [count_low, count_high, fault, step] = packed.to_le_bytes();
    (
        u16::from_le_bytes([count_low, count_high]),
        BurstFailure::from_codes(fault, step),
    )
}

/// When the alarm starts the bursts: so long after a check the next one is due, in microseconds.
const POLL_AFTER_CHECK_US: u32 = 300;

/// The checks in their turn: the full scales come every other time, since they scale the attitude.
const fn in_turn(config: &Config, part: &Part) -> [Check; CHECKS] {
    let [scales, interrupt, power] = Check::all(config, part);
    [scales, interrupt, scales, power]
}

const CHECKS: usize = 4;
/// The full scales' turns are the even ones.
const SCALES_ARE_EVEN: u8 = 0;

/// What the reader has to know of the sensor.
struct Setup {
    checks: [Check; CHECKS],
    /// The sample period.
    period_us: u32,
    /// An edge that comes sooner after the last is none of the sensor's: its clock is right to 1 %
    /// (product specification §6.6), and a clone's to 5 %.
    shortest_period_us: u32,
}

struct SetupCell(UnsafeCell<Setup>);

// SAFETY: the idle task writes it while the reader is disabled, and the reader reads it while it runs.
unsafe impl Sync for SetupCell {}

static SETUP: SetupCell = SetupCell(UnsafeCell::new(Setup {
    checks: in_turn(&Config::DEFAULT, &Part::MPU_6050),
    period_us: 1_000,
    shortest_period_us: 938,
}));

fn setup() -> &'static Setup {
    // SAFETY: see `SetupCell`; what the reader does while it is disabled never depends on the contents.
    unsafe { &*SETUP.0.get() }
}

/// What a check has read.
struct Checked {
    bytes: UnsafeCell<[u8; Check::LONGEST]>,
}

// SAFETY: DMA writes it during a check, and the reader reads it when that has ended.
unsafe impl Sync for Checked {}

static CHECKED: Checked = Checked {
    bytes: UnsafeCell::new([0; Check::LONGEST]),
};

/// What the reader shares with tasks of lower priority.
struct Link {
    address: AtomicU8,
    enabled: AtomicBool,
    /// Count (16 bits), fault and step (8 bits each) in one word, so that no reader sees half of it.
    failures: AtomicU32,
    /// Flags for the next burst.
    notes: AtomicU32,
    /// The idle task wants the bus.
    pause_wanted: AtomicBool,
    are_scales_verified: AtomicBool,
    /// It is to be said that no sample comes, as of this time in microseconds since boot.
    is_stale: AtomicBool,
    stale_low: AtomicU32,
    stale_high: AtomicU32,
    stale_flags: AtomicU32,
}

impl Link {
    fn note(&self, flags: Flags) {
        self.notes.fetch_or(flags.bits(), Ordering::Relaxed);
    }

    fn record(&self, failure: BurstFailure) {
        let count = (self.failures.load(Ordering::Relaxed) as u16).wrapping_add(1);
        let [count_low, count_high] = count.to_le_bytes();
        let packed = [
            count_low,
            count_high,
            failure.fault as u8,
            failure.step as u8,
        ];
        self.failures
            .store(u32::from_le_bytes(packed), Ordering::Relaxed);
    }
}

static LINK: Link = Link {
    address: AtomicU8::new(0),
    enabled: AtomicBool::new(false),
    failures: AtomicU32::new(0),
    notes: AtomicU32::new(0),
    pause_wanted: AtomicBool::new(false),
    is_stale: AtomicBool::new(false),
    stale_low: AtomicU32::new(0),
    stale_high: AtomicU32::new(0),
    stale_flags: AtomicU32::new(0),
    are_scales_verified: AtomicBool::new(false),
};

/// Two slots: DMA fills one while the attitude task reads the other.
struct Handover {
    slots: [UnsafeCell<Burst>; 2],
    /// The burst that the attitude task still needs: [`IS_READY`], its slot by [`SLOT_MASK`], and the remarks on it.
    ready: AtomicU32,
}

const NOTHING_READY: u32 = 0;
const IS_READY: u32 = 1 << 1;
const SLOT_MASK: u32 = 1;

impl Handover {
    /// The slot that this state of `ready` is about.
    #[inline(always)]
    fn slot(&self, ready: u32) -> &UnsafeCell<Burst> {
        &self.slots[(ready & SLOT_MASK) as usize]
    }
}

// SAFETY: the reader writes a slot, or lets DMA write it, only while `ready` keeps the attitude task away from it.
unsafe impl Sync for Handover {}

const NO_BURST: Burst = Burst {
    bytes: [0; BURST_LENGTH],
    captured_at_us: 0,
    missed_before: 0,
};

static HANDOVER: Handover = Handover {
    slots: [const { UnsafeCell::new(NO_BURST) }; 2],
    ready: AtomicU32::new(NOTHING_READY),
};

fn clear_dma_flags() {
    dma1().lifcr().write(|w| {
        w.ctcif0()
            .set_bit()
            .chtif0()
            .set_bit()
            .cteif0()
            .set_bit()
            .cdmeif0()
            .set_bit()
            .cfeif0()
            .set_bit()
    });
}

fn i2c1() -> &'static i2c1::RegisterBlock {
    // SAFETY: while the reader is enabled it alone uses the bus; see `sensor_bus` for the rest of the time.
    unsafe { &*I2C1::ptr() }
}

fn dma1() -> &'static dma1::RegisterBlock {
    // SAFETY: this file writes stream 0 and its bits of the clear register alone, and the clear
    // registers ignore zeros, so it never disturbs the UART's stream 6.
    unsafe { &*DMA1::ptr() }
}

fn exti() -> &'static stm32f4xx_hal::pac::exti::RegisterBlock {
    // SAFETY: line 1 is the only line in use, and each write here is one store.
    unsafe { &*EXTI::ptr() }
}
