//! Measurement of the firmware by itself: cycles, latency, load, and the use of the stack.
//!
//! While it is off, a measurement costs one test of a shared word per sample. While it is on, the
//! core takes its interrupts from a second vector table. All entries of that table point to
//! `measured`, which calls the handler of the first table between two readings of the cycle
//! counter (DWT; ARMv7-M architecture manual, C1.8). The idle task sleeps in [`run`] instead of its
//! own loop meanwhile.
//!
//! Each context counts its own cycles alone. `SPENT` counts the cycles of all handlers that have
//! returned, with the cost of measuring. So the difference of `SPENT` between two instants is the
//! time that interrupts took from the interrupted context. `calibrate` measures the cost of
//! measuring with an interrupt of its own, whose handler is empty. The core's own entry to a
//! handler and exit from it belong to that cost.

use core::arch::{asm, naked_asm};
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::interrupt;
use cortex_m::peripheral::{DCB, DWT, NVIC, SCB};
use cortex_m::register::basepri;
use stm32f4xx_hal::pac::Interrupt;

use super::attitude_task;
use super::boards::BOARD;
use super::timebase;
use crate::health::{CoreFigures, STACK_PATTERN, SampleFigures, WorkFigures};
use crate::mpu6050::{BURST_LENGTH, Burst};

/// Exceptions of the core, before the first interrupt.
const CORE_EXCEPTIONS: u32 = 16;
/// Interrupt of the calibration. No board uses line 0, and every chip has it.
const CALIBRATION: Interrupt = Interrupt::EXTI0;
/// Repetitions of a calibration, of which the mean counts.
const REPETITIONS: u32 = 64;
/// Units of a cycle in the counts: so a sum of all repetitions is their mean in units.
const UNITS: u32 = REPETITIONS;
/// DEMCR.TRCENA and DWT_CTRL.CYCCNTENA (architecture manual, C1.6.5 and C1.8.7).
const TRACE_ENABLED: u32 = 1 << 24;
const COUNTER_ENABLED: u32 = 1;

/// Vectors of the core and of the interrupts, as many as the largest chip has.
const VECTORS: usize = 16 + 97;

/// Burst of the calibration.
const NO_BURST: Burst = Burst {
    bytes: [0; BURST_LENGTH],
    captured_at_us: 0,
    missed_before: 0,
};

type Handler = unsafe extern "C" fn();

#[repr(C, align(512))]
struct VectorTable([Handler; VECTORS]);

unsafe extern "C" {
    /// First vector table (cortex-m-rt).
    static __vector_table: [u32; VECTORS];
    /// Lowest address of the stack, and the address after it (memory.x).
    static mut _stack_end: u32;
    static mut _stack_start: u32;
    fn NonMaskableInt();
    fn HardFault();
}

/// Vector table of a measurement. Faults keep their handlers.
static MEASURING: VectorTable = {
    let mut handlers: [Handler; VECTORS] = [measured; VECTORS];
    handlers[2] = NonMaskableInt;
    handlers[3] = HardFault;
    VectorTable(handlers)
};

/// Cycles of the handlers that have returned, measuring included. Wraps.
static SPENT: AtomicU32 = AtomicU32::new(0);
/// Everything that the core has executed, measuring excluded, in units of a cycle. Wraps.
static BUSY: AtomicU32 = AtomicU32::new(0);
/// The samples' interrupts, in units of a cycle. Wraps.
static INTERRUPTS: AtomicU32 = AtomicU32::new(0);
/// The attitude task, in units of a cycle. Wraps.
static ATTITUDE: AtomicU32 = AtomicU32::new(0);

/// Cycles of the calibration's handlers, from just before each call to just after.
static CALIBRATION_CYCLES: AtomicU32 = AtomicU32::new(0);
/// Cost within the readings about a handler, in units of a cycle.
static CALL_COST: AtomicU32 = AtomicU32::new(0);
/// Cost outside the readings of [`measured`], in cycles.
static ENTRY_COST: AtomicU32 = AtomicU32::new(0);
/// Cost of [`on_published`] outside its own readings, in cycles.
static PUBLICATION_COST: AtomicU32 = AtomicU32::new(0);
/// Cost of two readings in a row, in units of a cycle.
static READING_COST: AtomicU32 = AtomicU32::new(0);

/// Instant by the cycle counter.
#[derive(Clone, Copy)]
struct Instant {
    cycles: u32,
    spent: u32,
}

impl Instant {
    /// Returns the present instant.
    #[inline(always)]
    fn now() -> Self {
        interrupt::free(|_| Self::now_masked())
    }

    /// Returns the present instant, while no interrupt can come: between the two readings it would
    /// count as a part of the interrupted context.
    #[inline(always)]
    fn now_masked() -> Self {
        Self {
            cycles: DWT::cycle_count(),
            spent: SPENT.load(Ordering::Relaxed),
        }
    }

    /// Returns the cycles since an earlier instant, without those of interrupts in between.
    #[inline(always)]
    fn since(self, earlier: Self) -> u32 {
        let all = self.cycles.wrapping_sub(earlier.cycles);
        all.wrapping_sub(self.spent.wrapping_sub(earlier.spent))
    }
}

/// Counts at an edge.
#[derive(Clone, Copy)]
struct Edge {
    number: u32,
    interrupts: u32,
    attitude: u32,
    busy: u32,
    publications: u32,
    count: u32,
}

impl Edge {
    const NONE: Self = Self {
        number: 0,
        interrupts: 0,
        attitude: 0,
        busy: 0,
        publications: 0,
        count: 0,
    };
}

/// Figures, and what they are made from.
struct Figures {
    core: CoreFigures,
    samples: SampleFigures,
    /// State at the edge of the last published sample.
    last: Option<Edge>,
}

impl Figures {
    const NONE: Self = Self {
        core: CoreFigures::new(),
        samples: SampleFigures::new(),
        last: None,
    };
}

struct Owned<T>(UnsafeCell<T>);

// SAFETY: the interrupt of the edge alone writes `EDGE`, and the attitude task alone `FIGURES`.
// Others use them with all interrupts masked.
unsafe impl<T> Sync for Owned<T> {}

static EDGE: Owned<Edge> = Owned(UnsafeCell::new(Edge::NONE));
static FIGURES: Owned<Figures> = Owned(UnsafeCell::new(Figures::NONE));

/// Handler of all interrupts while a measurement runs: calls the right one, and counts its cycles.
#[unsafe(export_name = "APLOMB_MEASURED")]
unsafe extern "C" fn measured() {
    let start = Instant::now();
    let exception = exception_number();
    // SAFETY: the core has taken the exception that this function handles.
    unsafe { handler_of(exception)() };
    let call_cycles = Instant::now().since(start);
    credit(exception, call_cycles);
    let cycles = Instant::now().since(start);
    let entry_cost = ENTRY_COST.load(Ordering::Relaxed);
    SPENT.fetch_add(cycles.wrapping_add(entry_cost), Ordering::Relaxed);
}

/// Handler of one instruction.
#[unsafe(naked)]
unsafe extern "C" fn empty() {
    naked_asm!("bx lr")
}

/// Credits the cycles of a handler's call.
#[inline(never)]
fn credit(exception: u32, call_cycles: u32) {
    const IS_INTERRUPT: [u32; 6] = [
        exception_of(Interrupt::EXTI1),
        exception_of(Interrupt::I2C1_EV),
        exception_of(Interrupt::I2C1_ER),
        exception_of(Interrupt::SPI1),
        exception_of(Interrupt::DMA1_STREAM0),
        exception_of(Interrupt::TIM5),
    ];
    if exception == exception_of(CALIBRATION) {
        CALIBRATION_CYCLES.fetch_add(call_cycles, Ordering::Relaxed);
        return;
    }
    if exception == exception_of(Interrupt::EXTI1) {
        keep_edge();
    }
    let cost = CALL_COST.load(Ordering::Relaxed);
    let units = (call_cycles.wrapping_mul(UNITS)).wrapping_sub(cost);
    BUSY.fetch_add(units, Ordering::Relaxed);
    if exception == exception_of(Interrupt::SPI3) {
        ATTITUDE.fetch_add(units, Ordering::Relaxed);
    } else if IS_INTERRUPT.contains(&exception) {
        INTERRUPTS.fetch_add(units, Ordering::Relaxed);
    }
}

const fn exception_of(interrupt: Interrupt) -> u32 {
    CORE_EXCEPTIONS + interrupt as u32
}

/// Returns the number of the exception that runs.
#[inline(always)]
fn exception_number() -> u32 {
    let number: u32;
    // SAFETY: reading IPSR has no side effect.
    unsafe { asm!("mrs {}, IPSR", out(reg) number, options(nomem, nostack, preserves_flags)) };
    number & 0x1FF
}

/// Returns the handler of an exception, from the first vector table.
#[inline(always)]
fn handler_of(exception: u32) -> Handler {
    if exception == exception_of(CALIBRATION) {
        return empty;
    }
    let table = &raw const __vector_table;
    // SAFETY: the core takes no exception that the table of this chip lacks, and all entries that
    // it takes are addresses of handlers.
    unsafe {
        let entry = table.cast::<u32>().add(exception as usize).read();
        core::mem::transmute::<usize, Handler>(entry as usize)
    }
}

/// Keeps the counts at an edge.
#[inline(always)]
fn keep_edge() {
    // SAFETY: see `Owned`; only the interrupt of the edge calls this.
    let edge = unsafe { &mut *EDGE.0.get() };
    *edge = Edge {
        number: edge.number.wrapping_add(1),
        interrupts: INTERRUPTS.load(Ordering::Relaxed),
        attitude: ATTITUDE.load(Ordering::Relaxed),
        busy: BUSY.load(Ordering::Relaxed),
        publications: attitude_task::publications(),
        count: timebase::now(),
    };
}

impl CoreFigures {
    /// Credits the cycles between two edges to the sample that was published in between.
    fn add_window(&mut self, from: &Edge, to: &Edge) {
        let between = |count: fn(&Edge) -> u32| count(to).wrapping_sub(count(from));
        let cycles = |units: u32| (units / UNITS) as i32;
        let publications = between(|edge| edge.publications);
        if (between(|edge| edge.number), publications) == (1, 1) {
            let interrupts = between(|edge| edge.interrupts);
            let sample = interrupts.wrapping_add(between(|edge| edge.attitude));
            self.interrupt_cycles.add(cycles(interrupts + UNITS / 2));
            self.sample_cycles.add(cycles(sample + UNITS / 2));
        }
        self.busy_cycles += u64::from(between(|edge| edge.busy) / UNITS);
        self.elapsed_us += u64::from(between(|edge| edge.count));
    }
}

/// Adds a published sample. The attitude task calls this right after the publication.
#[cold]
#[inline(never)]
pub fn on_published(burst: &Burst) {
    let start = Instant::now();
    let since_edge_us = timebase::now().wrapping_sub(burst.captured_at_us as u32);
    // SAFETY: see `Owned`; all interrupts are masked.
    let edge = interrupt::free(|_| unsafe { *EDGE.0.get() });
    // SAFETY: see `Owned`; only the attitude task calls this.
    let figures = unsafe { &mut *FIGURES.0.get() };
    if edge.number != 0
        && let Some(last) = figures.last.replace(edge)
    {
        figures.core.add_window(&last, &edge);
    }
    figures.samples.add(
        burst.captured_at_us,
        since_edge_us,
        burst.missed_before,
        &burst.bytes,
    );
    // The attitude task did not need these cycles.
    let cycles = Instant::now().since(start);
    let cost = PUBLICATION_COST.load(Ordering::Relaxed);
    SPENT.fetch_add(cycles.wrapping_add(cost), Ordering::Relaxed);
}

/// Sleeps between interrupts until `condition` holds, and measures meanwhile. Only the idle task
/// calls this. `is_new` drops the figures so far.
pub fn run(is_new: bool, condition: impl Fn() -> bool) {
    enable_counter();
    use_table((&raw const MEASURING).addr());
    if is_new {
        calibrate();
    }
    interrupt::free(|_| {
        // SAFETY: see `Owned`; all interrupts are masked.
        let figures = unsafe { &mut *FIGURES.0.get() };
        if is_new {
            *figures = Figures::NONE;
        }
        figures.last = None;
        // SAFETY: see `Owned`; all interrupts are masked.
        unsafe { *EDGE.0.get() = Edge::NONE };
    });
    let reading_cost = READING_COST.load(Ordering::Relaxed);
    let mut woken = Instant::now();
    // As in `timebase::sleep_until`, whose cycles this measures.
    loop {
        interrupt::disable();
        if condition() {
            break;
        }
        let units = Instant::now_masked().since(woken).wrapping_mul(UNITS);
        BUSY.fetch_add(units.wrapping_sub(reading_cost), Ordering::Relaxed);
        cortex_m::asm::wfi();
        woken = Instant::now_masked();
        // SAFETY: the idle task runs outside of critical sections.
        unsafe { interrupt::enable() };
        cortex_m::asm::isb();
    }
    // SAFETY: the idle task runs outside of critical sections.
    unsafe { interrupt::enable() };
    use_table((&raw const __vector_table).addr());
}

fn enable_counter() {
    // SAFETY: the two bits start the cycle counter. No other code uses these registers.
    unsafe {
        (*DCB::PTR).demcr.modify(|bits| bits | TRACE_ENABLED);
        (*DWT::PTR).ctrl.modify(|bits| bits | COUNTER_ENABLED);
    }
}

/// Takes the vectors from this table from now on.
fn use_table(address: usize) {
    // SAFETY: both tables have a handler for every exception, and lie at a multiple of 512 bytes.
    unsafe { (*SCB::PTR).vtor.write(address as u32) };
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Measures the cost of measuring.
fn calibrate() {
    for cost in [&CALL_COST, &ENTRY_COST, &PUBLICATION_COST] {
        cost.store(0, Ordering::Relaxed);
    }
    let reading = sum(|| interrupt::free(|_| timed(|| {})));
    READING_COST.store(reading, Ordering::Relaxed);
    // The new measurement drops this sample.
    let publication = sum(|| interrupt::free(|_| timed(|| on_published(&NO_BURST))));
    PUBLICATION_COST.store(mean_difference(publication, reading), Ordering::Relaxed);
    NVIC::mask(CALIBRATION);
    let without = sum(|| alone(|| timed(request)));
    NVIC::unpend(CALIBRATION);
    // SAFETY: no critical section depends on this interrupt, and its handler is empty.
    unsafe { NVIC::unmask(CALIBRATION) };
    CALIBRATION_CYCLES.store(0, Ordering::Relaxed);
    let with = sum(|| alone(|| timed(request)));
    NVIC::mask(CALIBRATION);
    ENTRY_COST.store(mean_difference(with, without), Ordering::Relaxed);
    // The empty handler itself takes an instruction, which a real one has too.
    let calls = CALIBRATION_CYCLES.load(Ordering::Relaxed);
    CALL_COST.store(calls.wrapping_sub(UNITS), Ordering::Relaxed);
}

/// Returns the sum of all repetitions.
fn sum(work: impl Fn() -> u32) -> u32 {
    (0..REPETITIONS).fold(0, |sum, _| sum.wrapping_add(work()))
}

/// Returns the mean of the repetitions of one sum less that of another, in whole cycles.
fn mean_difference(sum: u32, other: u32) -> u32 {
    (sum.wrapping_sub(other) + REPETITIONS / 2) / REPETITIONS
}

/// Returns the cycles of this work, without those of interrupts, which can come only within it.
#[inline(always)]
fn timed(work: impl FnOnce()) -> u32 {
    let start = Instant::now_masked();
    work();
    Instant::now_masked().since(start)
}

/// Lets no interrupt come but that of the calibration, which has the highest priority.
fn alone<R>(work: impl FnOnce() -> R) -> R {
    // SAFETY: the idle task runs outside of critical sections, and no priority is 0 but that of
    // the calibration.
    unsafe { basepri::write(1 << 4) };
    let result = work();
    // SAFETY: no critical section is under way, so no priority has to stay masked.
    unsafe { basepri::write(0) };
    result
}

/// Requests the interrupt of the calibration, and waits until it has been handled if it is enabled.
#[inline(always)]
fn request() {
    NVIC::pend(CALIBRATION);
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Returns the figures of the last measurement.
pub fn figures() -> WorkFigures {
    let (core, samples) = interrupt::free(|_| {
        // SAFETY: see `Owned`; all interrupts are masked.
        let figures = unsafe { &*FIGURES.0.get() };
        (figures.core, figures.samples)
    });
    let (used, size) = stack_bytes();
    WorkFigures {
        core,
        samples,
        core_mhz: BOARD.core_hz / 1_000_000,
        stack_used_bytes: used,
        stack_bytes: size,
    }
}

/// Fills the unused stack with [`STACK_PATTERN`]. Called once, by init.
#[inline(never)]
pub fn fill_stack() {
    /// Room for this function's own frame, in words.
    const OWN_WORDS: usize = 16;
    let mut place = &raw mut _stack_end;
    let own = 0_u32;
    let end = (&raw const own).wrapping_sub(OWN_WORDS);
    while place.cast_const() < end {
        // SAFETY: the words lie in the stack, below this function's frame, and interrupts are off.
        unsafe {
            place.write_volatile(STACK_PATTERN);
            place = place.add(1);
        }
    }
}

/// Returns the bytes of the stack that were ever used, and its size.
fn stack_bytes() -> (u32, u32) {
    let (end, start) = (&raw const _stack_end, &raw const _stack_start);
    let mut place = end;
    // SAFETY: the words lie in the stack, and reading them has no side effect. Volatile, because
    // nothing else refers to the unused ones.
    while place < start && unsafe { place.read_volatile() } == STACK_PATTERN {
        place = place.wrapping_add(1);
    }
    let bytes = |from: *const u32| start.addr().wrapping_sub(from.addr()) as u32;
    (bytes(place), bytes(end))
}
