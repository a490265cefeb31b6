//! Reads the sensor's 14 data registers at each data-ready edge, one interrupt per bus event and no waiting.
//!
//! ```text
//! edge ─ START ─ SB: address+W ─ ADDR: pointer ─ BTF: START again ─ SB: address+R ─ ADDR: DMA on ─ transfer complete: STOP
//! ```
//!
//! The order of register accesses is the reference manual's (RM0090, 27.3.3 master transmitter and
//! receiver, 27.3.7 DMA). A burst takes 384 µs at 400 kHz. Every step is under the alarm: a burst
//! that has not ended [`BURST_DEADLINE_US`] after its edge, in whatever step, is aborted; and so is
//! the wait for an edge that does not come within [`SILENCE_DEADLINE_US`]. After
//! [`FAILURES_IN_A_ROW`] failures, or one that leaves the bus in an unknown state, the reader stops
//! and the idle task recovers the bus and configures the sensor again.
//!
//! DMA fills one slot while the attitude task reads the other: nothing is copied. An edge that comes
//! while a burst runs, a failed burst, and a burst that ends before the attitude task is done with
//! the last one are counted, and reach the next good burst as `missed_before`.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, compiler_fence};

use embedded_hal::delay::DelayNs;
use stm32f4xx_hal::pac::{DMA1, EXTI, I2C1, dma1, i2c1};

use super::clocks;
use super::sensor_bus::with_clock;
use super::timebase::{self, Timebase};
use crate::fault::{BurstFailure, BurstFault, BurstStep};
use crate::mpu6050::registers::Register;
use crate::mpu6050::{BURST_LENGTH, Burst};

/// Longest time from the edge to the end of its burst, in microseconds: twice what the bus needs.
pub const BURST_DEADLINE_US: u32 = 800;
/// Longest time without an edge, in microseconds: ten periods at the default 1 kHz.
pub const SILENCE_DEADLINE_US: u32 = 10_000;
/// Failed bursts in a row after which the sensor is configured again.
pub const FAILURES_IN_A_ROW: u8 = 3;

/// The reader. All of its methods run at one priority, so none interrupts another.
pub struct BurstReader {
    step: BurstStep,
    filling: u8,
    captured_at_us: u64,
    missed: u8,
    failures_in_a_row: u8,
}

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
            filling: 0,
            captured_at_us: 0,
            missed: 0,
            failures_in_a_row: 0,
        };
        reader.arm_dma();
        reader
    }

    /// EXTI1: starts the burst of this edge.
    #[inline(always)]
    pub fn on_data_ready(&mut self, timebase: &Timebase) {
        exti().pr().write(|w| w.pr1().clear_bit_by_one());
        if self.step != BurstStep::Idle {
            self.missed = self.missed.saturating_add(1);
            return;
        }
        let count = timebase.captured();
        self.captured_at_us = timebase.extend_capture(count);
        timebase::set_burst_alarm(count.wrapping_add(BURST_DEADLINE_US));
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
        let address = LINK.address.load(Ordering::Relaxed);
        match self.step {
            BurstStep::Start if status.sb().bit() => {
                i2c.dr().write(|w| w.dr().set(address << 1));
                self.step = BurstStep::AddressWrite;
            }
            BurstStep::AddressWrite if status.addr().bit() => {
                i2c.sr2().read();
                i2c.dr()
                    .write(|w| w.dr().set(Register::AccelerometerXHigh as u8));
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
            _ => {}
        }
    }

    /// DMA1 stream 0: the 14 bytes are there. True if a burst is ready for the attitude task.
    #[inline(always)]
    pub fn on_transfer_complete(&mut self) -> bool {
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
        i2c1()
            .cr1()
            .write(|w| w.pe().set_bit().ack().set_bit().stop().set_bit());
        timebase::set_burst_alarm((self.captured_at_us as u32).wrapping_add(SILENCE_DEADLINE_US));
        self.step = BurstStep::Idle;
        self.failures_in_a_row = 0;
        let handed_over = !HANDOVER.held.load(Ordering::Relaxed);
        if handed_over {
            // SAFETY: `held` is false, so the attitude task reads neither slot until the line below.
            let burst = unsafe { &mut *HANDOVER.slot(self.filling).get() };
            burst.captured_at_us = self.captured_at_us;
            burst.missed_before = self.missed;
            self.missed = 0;
            compiler_fence(Ordering::Release);
            HANDOVER.ready.store(self.filling, Ordering::Relaxed);
            HANDOVER.held.store(true, Ordering::Relaxed);
            self.filling ^= 1;
        } else {
            self.missed = self.missed.saturating_add(1);
        }
        self.arm_dma();
        handed_over
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

    /// The alarm: a burst took too long, or no edge came.
    pub fn on_alarm(&mut self) {
        if !is_enabled() {
            return;
        }
        let fault = match self.step {
            BurstStep::Idle => BurstFault::NoDataReady,
            _ => BurstFault::Deadline,
        };
        self.fail(fault);
    }

    fn fail(&mut self, fault: BurstFault) {
        LINK.record(BurstFailure {
            fault,
            step: self.step,
        });
        i2c1().cr2().write(|w| with_clock(w));
        i2c1()
            .cr1()
            .write(|w| w.pe().set_bit().stop().bit(self.step != BurstStep::Idle));
        self.missed = self.missed.saturating_add(1);
        self.failures_in_a_row = self.failures_in_a_row.saturating_add(1);
        self.step = BurstStep::Idle;
        self.arm_dma();
        timebase::set_burst_alarm(timebase::now().wrapping_add(SILENCE_DEADLINE_US));
        let bus_is_known = fault == BurstFault::NotAcknowledged;
        if !bus_is_known || self.failures_in_a_row >= FAILURES_IN_A_ROW {
            self.failures_in_a_row = 0;
            disable();
        }
    }

    /// Readies the stream for the next burst. It moves nothing until the I2C asks, in step `Data`.
    #[inline(always)]
    fn arm_dma(&self) {
        let stream = dma1().st(0);
        if stream.cr().read().en().bit() {
            stream.cr().reset();
            while stream.cr().read().en().bit() {} // Ends with the byte in flight (RM0090, 10.3, DMA transfer suspension).
            clear_dma_flags();
        }
        let address =
            HANDOVER.slot(self.filling).get() as u32 + core::mem::offset_of!(Burst, bytes) as u32;
        // SAFETY: the slot lives for ever, and the attitude task reads the other one.
        stream.m0ar().write(|w| unsafe { w.m0a().bits(address) });
        stream.ndtr().write(|w| w.ndt().set(BURST_LENGTH as u16));
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
}

/// Lends the ready burst to `work`, and gives its slot back afterwards. Only the attitude task calls this.
pub fn with_burst<R>(work: impl FnOnce(&Burst) -> R) -> Option<R> {
    if !HANDOVER.held.load(Ordering::Relaxed) {
        return None;
    }
    compiler_fence(Ordering::Acquire);
    let ready = HANDOVER.ready.load(Ordering::Relaxed);
    // SAFETY: while `held` is true the reader neither writes this slot nor points DMA at it.
    let result = work(unsafe { &*HANDOVER.slot(ready).get() });
    compiler_fence(Ordering::Release);
    HANDOVER.held.store(false, Ordering::Relaxed);
    Some(result)
}

/// Lets edges through to the reader, for the sensor at `address`. Called by the idle task with the reader disabled, the bus free and the sensor configured.
pub fn enable(address: u8) {
    LINK.address.store(address, Ordering::Relaxed);
    timebase::set_burst_alarm(timebase::now().wrapping_add(SILENCE_DEADLINE_US));
    LINK.enabled.store(true, Ordering::Release);
    exti().pr().write(|w| w.pr1().clear_bit_by_one());
    exti().imr().write(|w| w.mr1().set_bit());
}

/// Stops the reader, so that the idle task can use the bus or stall the core. A burst that runs comes to its end first.
pub fn pause() {
    exti().imr().reset();
    timebase::Delay.delay_us(BURST_DEADLINE_US);
    LINK.enabled.store(false, Ordering::Release);
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

fn disable() {
    exti().imr().reset();
    LINK.enabled.store(false, Ordering::Release);
}

/// What the reader shares with tasks of lower priority.
struct Link {
    address: AtomicU8,
    enabled: AtomicBool,
    /// Count (16 bits), fault and step (8 bits each) in one word, so that no reader sees half of it.
    failures: AtomicU32,
}

impl Link {
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
};

/// Two slots: DMA fills one while the attitude task reads the other.
struct Handover {
    slots: [UnsafeCell<Burst>; 2],
    /// The slot of the last complete burst.
    ready: AtomicU8,
    /// Whether the attitude task still needs that slot.
    held: AtomicBool,
}

impl Handover {
    /// The slot of this number, which is 0 or 1.
    fn slot(&self, number: u8) -> &UnsafeCell<Burst> {
        &self.slots[usize::from(number & 1)]
    }
}

// SAFETY: the reader writes a slot, or lets DMA write it, only while `held` keeps the attitude task away from it.
unsafe impl Sync for Handover {}

const NO_BURST: Burst = Burst {
    bytes: [0; BURST_LENGTH],
    captured_at_us: 0,
    missed_before: 0,
};

static HANDOVER: Handover = Handover {
    slots: [const { UnsafeCell::new(NO_BURST) }; 2],
    ready: AtomicU8::new(0),
    held: AtomicBool::new(false),
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
