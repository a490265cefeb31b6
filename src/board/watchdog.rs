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

/// Shortest time without progress after which the processor is reset, in ms. A hang of any part
/// ends after 1 to 2.8 times this limit. The longest wait of the idle task is 100 ms.
pub const LIMIT_MS: u32 = 200;

/// Highest frequency of the oscillator, in kHz.
const FASTEST_KHZ: u32 = 47;

/// Value of PR for a division by 64 (RM0090, 21.4.2).
const PRESCALER: u8 = 4;
const DIVISION: u32 = 64;

/// Polls of the status until a new limit must have arrived. At 168 MHz a poll takes at least
/// 4 cycles, so they take 1 ms or more. Five cycles of the slowest oscillator are 0.3 ms (RM0090,
/// 21.4.4).
const CROSSING_POLLS: u32 = 50_000;

/// Progress since the watchdog was last fed.
static SAMPLES: AtomicBool = AtomicBool::new(false);
static ATTITUDE: AtomicBool = AtomicBool::new(false);

/// Starts the watchdog, which cannot be stopped again.
pub fn start(watchdog: &IWDG, debugger: &DBGMCU) {
    debugger
        .apb1_fz()
        .modify(|_, w| w.dbg_iwdg_stop().set_bit());
    // SAFETY: the keys of RM0090, 21.4.1: start, then open the other registers.
    watchdog.kr().write(|w| unsafe { w.key().bits(0xCCCC) });
    set_limit_ms(LIMIT_MS);
}

/// Sets the shortest time without progress before a reset, in ms, up to 5,000. Needed around work
/// that stops everything, such as erasing flash; set [`LIMIT_MS`] afterwards.
pub fn set_limit_ms(limit_ms: u32) {
    let ticks = limit_ms.saturating_mul(FASTEST_KHZ).div_ceil(DIVISION);
    let watchdog = watchdog();
    // A feed in between would close the registers again.
    cortex_m::interrupt::free(|_| {
        // SAFETY: the key that opens the registers, and values of their widths (RM0090, 21.4).
        unsafe {
            watchdog.kr().write(|w| w.key().bits(0x5555));
            watchdog.pr().write(|w| w.pr().bits(PRESCALER));
            watchdog
                .rlr()
                .write(|w| w.rl().bits(ticks.min(0xFFF) as u16));
        }
    });
    // The limit reaches the counter within five cycles of its oscillator. A feed before that would
    // reload the old limit.
    for _ in 0..CROSSING_POLLS {
        let status = watchdog.sr().read();
        if status.pvu().bit_is_clear() && status.rvu().bit_is_clear() {
            break;
        }
    }
    feed();
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
