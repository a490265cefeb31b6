//! The independent watchdog: it resets the processor unless samples, attitude and telemetry all go
//! on.
//!
//! Each of the three says so in its own task; the telemetry task, of lowest priority of them, feeds
//! the watchdog only if all have said so since the last time. Where there is no sensor, the idle
//! task's tries to find it count as samples: a reset would not bring it back.
//!
//! The watchdog runs from its own oscillator, whose frequency is anything from 17 to 47 kHz
//! (STM32F405 datasheet, table "LSI oscillator characteristics"), and never stops but for a
//! debugger's halt.

use core::sync::atomic::{AtomicBool, Ordering};

use stm32f4xx_hal::pac::{DBGMCU, IWDG};

/// The shortest time without progress after which the processor is reset, in ms: a hang of any part
/// is over after this to 2.8 times this. The longest wait of the idle task is 100 ms.
pub const LIMIT_MS: u32 = 200;

/// The fastest that the oscillator may run, in kHz.
const FASTEST_KHZ: u32 = 47;

/// PR for a division by 64 (RM0090, 21.4.2).
const PRESCALER: u8 = 4;
const DIVISION: u32 = 64;

/// How often the status is read until a new limit has arrived. At 168 MHz a reading takes at least
/// 4 cycles, so this is 1 ms or more; five cycles of the slowest oscillator are 0.3 ms (RM0090,
/// 21.4.4).
const CROSSING_READINGS: u32 = 50_000;

/// What has to go on.
static SAMPLES: AtomicBool = AtomicBool::new(false);
static ATTITUDE: AtomicBool = AtomicBool::new(false);

/// Starts the watchdog; nothing stops it again.
pub fn start(watchdog: &IWDG, debugger: &DBGMCU) {
    debugger
        .apb1_fz()
        .modify(|_, w| w.dbg_iwdg_stop().set_bit());
    // SAFETY: the keys of RM0090, 21.4.1: start, then open the other registers.
    watchdog.kr().write(|w| unsafe { w.key().bits(0xCCCC) });
    allow_ms(LIMIT_MS);
}

/// Changes the limit: at least `limit_ms`, up to 5,000, go by without progress before the reset.
/// For work that stops everything, such as erasing flash; [`LIMIT_MS`] afterwards.
pub fn allow_ms(limit_ms: u32) {
    let ticks = limit_ms.saturating_mul(FASTEST_KHZ).div_ceil(DIVISION);
    let watchdog = watchdog();
    // SAFETY: the key that opens the registers, and values of their widths (RM0090, 21.4).
    unsafe {
        watchdog.kr().write(|w| w.key().bits(0x5555));
        watchdog.pr().write(|w| w.pr().bits(PRESCALER));
        watchdog
            .rlr()
            .write(|w| w.rl().bits(ticks.min(0xFFF) as u16));
    }
    // The limit reaches the counter within five cycles of its oscillator; fed before that it would
    // reload the old one.
    for _ in 0..CROSSING_READINGS {
        let status = watchdog.sr().read();
        if status.pvu().bit_is_clear() && status.rvu().bit_is_clear() {
            break;
        }
    }
    feed();
}

/// Samples come, or the idle task is busy bringing them back.
#[inline(always)]
pub fn samples_go_on() {
    SAMPLES.store(true, Ordering::Relaxed);
}

/// The attitude task has published.
#[inline(always)]
pub fn attitude_goes_on() {
    ATTITUDE.store(true, Ordering::Relaxed);
}

/// The telemetry task runs, and feeds the watchdog if the others have, too.
pub fn telemetry_goes_on() {
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
    // SAFETY: each use is a store that stands for itself, and only this file uses it.
    unsafe { &*IWDG::ptr() }
}
