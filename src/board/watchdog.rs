//! Independent watchdog: resets the processor unless samples, attitude and telemetry all make
//! progress.
//!
//! Each of the three reports its progress in its own task. The telemetry task has the lowest
//! priority of them. It feeds the watchdog only if all three have reported since the last time.
//! Without a sensor, the idle task's attempts to find it count as samples, because a reset would
//! not help.
//!
//! The watchdog runs from its own oscillator, at 17 to 47 kHz (STM32F405 datasheet, table "LSI
//! oscillator characteristics"). Only a debugger's halt stops it.

use core::sync::atomic::{AtomicBool, Ordering};

use stm32f4xx_hal::pac::{DBGMCU, IWDG};

use super::timebase;

/// Shortest time without progress after which the processor is reset, in ms. A hang of any part
/// ends after 1 to 2.8 times this limit. The longest wait of the idle task is 100 ms.
pub const LIMIT_MS: u32 = 200;

/// Highest frequency of the oscillator, in kHz.
const FASTEST_KHZ: u32 = 47;

/// Value of PR for a division by 64 (RM0090, 21.4.2).
const PRESCALER: u8 = 4;
const DIVISION: u32 = 64;

/// Longest wait until the counter has a new limit, in µs. RM0090, 21.4.4, allows five cycles of
/// the oscillator, 0.3 ms. ST's HAL and Zephyr allow six cycles of the prescaler's output, 23 ms.
const CROSSING_US: u32 = 100_000;

/// Progress since the watchdog was last fed.
static SAMPLES: AtomicBool = AtomicBool::new(false);
static ATTITUDE: AtomicBool = AtomicBool::new(false);

/// Starts the watchdog, which cannot be stopped again. Its limit is 350 ms or more until
/// [`set_limit_ms`].
pub fn start(watchdog: &IWDG, debugger: &DBGMCU) {
    debugger
        .apb1_fz()
        .modify(|_, w| w.dbg_iwdg_stop().set_bit());
    // The idle task sleeps. Without this bit the core's clock stops then, and a debug probe may not
    // attach (RM0090, 38.16.1).
    debugger.cr().modify(|_, w| w.dbg_sleep().set_bit());
    // SAFETY: the key that starts the counter (RM0090, 21.4.1).
    watchdog.kr().write(|w| unsafe { w.key().bits(0xCCCC) });
}

/// Sets the shortest time without progress before a reset, in ms, up to 5,000. Needed around work
/// that stops everything, such as erasing flash; set [`LIMIT_MS`] afterwards. The time base must
/// run. Returns false if the counter does not have the limit after 0.1 s.
#[inline(always)]
pub fn set_limit_ms(limit_ms: u32) -> bool {
    let ticks = limit_ms.saturating_mul(FASTEST_KHZ).div_ceil(DIVISION);
    set_ticks(ticks.min(0xFFF) as u16)
}

#[inline(never)]
fn set_ticks(ticks: u16) -> bool {
    let watchdog = watchdog();
    // A feed in between would close the registers again.
    cortex_m::interrupt::free(|_| {
        // SAFETY: the key that opens the registers, and values of their widths (RM0090, 21.4).
        unsafe {
            watchdog.kr().write(|w| w.key().bits(0x5555));
            watchdog.pr().write(|w| w.pr().bits(PRESCALER));
            watchdog.rlr().write(|w| w.rl().bits(ticks));
        }
    });
    // A feed before the limit has arrived reloads the old one.
    let start = timebase::now();
    loop {
        // Before the status, which may change in a stall of the core.
        let is_late = timebase::elapsed(start, CROSSING_US);
        let has_arrived = watchdog.sr().read().bits() == 0;
        if has_arrived || is_late {
            feed();
            return has_arrived;
        }
    }
}

/// Reports that samples come, or that the idle task recovers the sensor.
#[inline(always)]
pub fn report_samples() {
    SAMPLES.store(true, Ordering::Relaxed);
}

/// Reports that the attitude task has published.
#[inline(always)]
pub fn report_attitude() {
    ATTITUDE.store(true, Ordering::Relaxed);
}

/// Reports that the telemetry task runs. Feeds the watchdog if the other two have reported too.
pub fn report_telemetry() {
    if SAMPLES.load(Ordering::Relaxed) && ATTITUDE.load(Ordering::Relaxed) {
        SAMPLES.store(false, Ordering::Relaxed);
        ATTITUDE.store(false, Ordering::Relaxed);
        feed();
    }
}

fn feed() {
    // SAFETY: the key that reloads the counter (RM0090, 21.4.1).
    watchdog().kr().write(|w| unsafe { w.key().bits(0xAAAA) });
}

fn watchdog() -> &'static stm32f4xx_hal::pac::iwdg::RegisterBlock {
    // SAFETY: each use is an independent store, and only this file uses the watchdog.
    unsafe { &*IWDG::ptr() }
}
