//! Words that the burst reader shares with the supervisor, the attitude task and telemetry: one
//! atomic each.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use embedded_hal::delay::DelayNs;
use stm32f4xx_hal::pac::{EXTI, Interrupt};

use super::super::delay::Delay;
use super::super::sensor::Ready;
use super::super::timebase;
use super::BURST_DEADLINE_US;
use crate::fault::BurstFailure;
use crate::health::BoardFlags;
use crate::mpu6050::{Check, Config, Part};

/// Number of checks of the settings: each round of housekeeping reads one.
pub(super) const CHECKS: usize = 4;

/// Set-up of the reader for the configured sensor.
pub(super) struct Setup {
    /// Settings to read back, in turn. The even entries are the full scales, because those scale
    /// the attitude.
    pub(super) checks: [Check; CHECKS],
    /// Sample period.
    pub(super) period_us: u32,
}

impl Setup {
    const fn new(config: &Config, part: &Part, period_us: u32) -> Self {
        let [scales, interrupt, power] = Check::all(config, part);
        Self {
            checks: [scales, interrupt, scales, power],
            period_us,
        }
    }

    /// Returns the shortest time between two edges of the sensor. A sooner edge is a glitch.
    ///
    /// The sensor's clock is accurate to 1 % (product specification §6.6), a clone's to 5 %. The
    /// core's internal oscillator is up to 8 % slow (STM32F405 datasheet, HSI characteristics). So
    /// a sixteenth covers the clone, and three sixteenths cover both.
    pub(super) fn shortest_period_us(&self, has_internal_clock: bool) -> u32 {
        let sixteenths = if has_internal_clock { 3 } else { 1 };
        self.period_us - self.period_us * sixteenths / 16
    }
}

struct SetupCell(UnsafeCell<Setup>);

// SAFETY: the supervisor writes the set-up while the reader is disabled, and the reader reads it
// while enabled.
unsafe impl Sync for SetupCell {}

static SETUP: SetupCell = SetupCell(UnsafeCell::new(Setup::new(
    &Config::DEFAULT,
    &Part::MPU_6050,
    1_000,
)));

pub(super) fn setup() -> &'static Setup {
    // SAFETY: see `SetupCell`. A disabled reader does not depend on the contents.
    unsafe { &*SETUP.0.get() }
}

/// Shared words.
pub(super) struct Link {
    /// Address of the sensor.
    pub(super) address: AtomicU8,
    /// True if the reader runs.
    pub(super) is_enabled: AtomicBool,
    /// True if the supervisor needs the bus.
    pub(super) is_pause_wanted: AtomicBool,
    /// True if a check of settings has found a wrong one.
    pub(super) has_wrong_setting: AtomicBool,
    /// Count (16 bits), fault and step (8 bits each) of failures in one word, so that no task reads
    /// half of it.
    failures: AtomicU32,
    /// Flags from the supervisor for the next burst.
    pending_flags: AtomicU32,
    is_stale: AtomicBool,
    stale_low: AtomicU32,
    stale_high: AtomicU32,
    stale_flags: AtomicU32,
}

pub(super) static LINK: Link = Link {
    address: AtomicU8::new(0),
    is_enabled: AtomicBool::new(false),
    is_pause_wanted: AtomicBool::new(false),
    has_wrong_setting: AtomicBool::new(false),
    failures: AtomicU32::new(0),
    pending_flags: AtomicU32::new(0),
    is_stale: AtomicBool::new(false),
    stale_low: AtomicU32::new(0),
    stale_high: AtomicU32::new(0),
    stale_flags: AtomicU32::new(0),
};

impl Link {
    /// Counts a failure. Only the reader calls this.
    pub(super) fn record(&self, failure: BurstFailure) {
        let count = (self.failures.load(Ordering::Relaxed) as u16).wrapping_add(1);
        let [count_low, count_high] = count.to_le_bytes();
        let fault = failure.fault as u8;
        let packed = u32::from_le_bytes([count_low, count_high, fault, failure.step as u8]);
        self.failures.store(packed, Ordering::Relaxed);
    }

    /// Takes the supervisor's flags for the next burst. Only the reader calls this, while the
    /// supervisor waits.
    pub(super) fn take_pending_flags(&self) -> BoardFlags {
        let flags = BoardFlags::from_bits_truncate(self.pending_flags.load(Ordering::Relaxed));
        self.pending_flags.store(0, Ordering::Relaxed);
        flags
    }

    /// Requests a stale snapshot at this time. Only the reader calls this.
    pub(super) fn request_stale(&self, t_us: u64, flags: BoardFlags) {
        self.stale_low.store(t_us as u32, Ordering::Relaxed);
        self.stale_high
            .store((t_us >> 32) as u32, Ordering::Relaxed);
        self.stale_flags.store(flags.bits(), Ordering::Relaxed);
        self.is_stale.store(true, Ordering::Release);
    }
}

/// Takes the request for a stale snapshot: its time in µs since boot, and the board's conditions.
/// Only the attitude task calls this.
pub fn take_stale() -> Option<(u64, BoardFlags)> {
    if !LINK.is_stale.load(Ordering::Acquire) {
        return None;
    }
    LINK.is_stale.store(false, Ordering::Relaxed);
    let low = LINK.stale_low.load(Ordering::Relaxed);
    let high = LINK.stale_high.load(Ordering::Relaxed);
    let flags =
        LINK.stale_flags.load(Ordering::Relaxed) | LINK.pending_flags.load(Ordering::Relaxed);
    Some((
        u64::from(high) << 32 | u64::from(low),
        BoardFlags::from_bits_truncate(flags),
    ))
}

/// Requests a transaction now: the transfer with the compass that waits, or else a check of some
/// settings. Only the attitude task calls this, after a burst, when the bus is free.
///
/// The request pends the interrupt of SPI1, an unused peripheral. The application binds that
/// interrupt, at the priority of the others that share the reader, to
/// [`on_transaction_request`](super::BurstReader::on_transaction_request).
pub fn request_transaction() {
    cortex_m::peripheral::NVIC::pend(Interrupt::SPI1);
}

/// Flags the next burst, and stale snapshots until then, with [`BoardFlags::SENSOR_RESET`]: the
/// sensor has lost its settings.
pub fn flag_sensor_reset() {
    LINK.pending_flags
        .fetch_or(BoardFlags::SENSOR_RESET.bits(), Ordering::Relaxed);
}

/// Takes the finding of a check between two bursts: true if a setting was wrong. Only the
/// supervisor calls this, while the reader is disabled.
pub fn take_wrong_setting() -> bool {
    let is_wrong = LINK.has_wrong_setting.load(Ordering::Relaxed);
    LINK.has_wrong_setting.store(false, Ordering::Relaxed);
    is_wrong
}

/// Enables the reader. The supervisor calls this while the reader is disabled, the bus is free, and
/// the sensor runs with these settings.
pub fn enable(ready: &Ready, config: &Config) {
    let period_us = (1.0e6 / config.sample_rate_hz()) as u32;
    // SAFETY: the reader is disabled, and reads its set-up only while enabled.
    unsafe {
        *SETUP.0.get() = Setup::new(config, ready.part, period_us);
    }
    LINK.address.store(ready.address, Ordering::Relaxed);
    // A fault may have disabled the reader before it handled the request.
    LINK.is_pause_wanted.store(false, Ordering::Relaxed);
    LINK.is_enabled.store(true, Ordering::Release);
    // The alarm makes the reader load the set-up, and then unmask the edges.
    timebase::raise_burst_alarm();
}

/// Stops the reader, so that the supervisor can use the bus or stall the core. A burst under way
/// ends first.
pub fn pause() {
    exti().imr().reset();
    LINK.is_pause_wanted.store(true, Ordering::Relaxed);
    Delay.delay_us(BURST_DEADLINE_US);
    timebase::raise_burst_alarm();
    timebase::sleep_until(|| !is_enabled());
}

/// Returns whether the reader runs. A fault that needs the bus recovered disables it until the next
/// [`enable`].
pub fn is_enabled() -> bool {
    LINK.is_enabled.load(Ordering::Acquire)
}

/// Returns the number of failed bursts, failed checks and missing edges since boot, which wraps at
/// 65,536, and the last failure.
pub fn failures() -> (u16, Option<BurstFailure>) {
    let packed = LINK.failures.load(Ordering::Relaxed);
    let [count_low, count_high, fault, step] = packed.to_le_bytes();
    (
        u16::from_le_bytes([count_low, count_high]),
        BurstFailure::from_codes(fault, step),
    )
}

pub(super) fn exti() -> &'static stm32f4xx_hal::pac::exti::RegisterBlock {
    // SAFETY: line 1 is the only line in use, and each write here is one store.
    unsafe { &*EXTI::ptr() }
}
