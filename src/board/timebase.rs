//! Time base of the firmware, TIM5: microseconds since boot, in 32 bits that wrap every 71.6
//! minutes.
//!
//! - Channel 2 captures the INT pin's rising edge, so a sample's time does not depend on interrupt
//!   latency.
//! - Channel 1's compare is the burst reader's alarm: a burst that does not end, or an edge that
//!   does not come.
//! - Channel 3's compare paces the telemetry.
//! - Channel 4's compare wakes the idle task from a delay.
//!
//! Each interrupt extends the count to 64 bits, at least 50 times a second.

use core::sync::atomic::{AtomicU32, Ordering};

use stm32f4xx_hal::pac::TIM5;

use super::boards::BOARD;
use super::clocks;
use crate::units::CounterExtender;

/// Causes of a TIM5 interrupt. Several may come at once.
pub struct Alarms {
    /// True if the burst reader's alarm has expired.
    pub burst: bool,
    /// True if the telemetry task is due.
    pub telemetry: bool,
}

/// Time base. All methods run at the burst reader's priority.
pub struct Timebase {
    timer: TIM5,
    extender: CounterExtender,
}

/// Flags of the status register: update, compare, trigger, and captures missed (RM0090, 18.4.5).
const FLAGS: u32 = 0b1_1110_0101_1111;

/// Time from one telemetry tick to the next, in µs. Written by the telemetry task, read by the
/// interrupt.
static TELEMETRY_PERIOD_US: AtomicU32 = AtomicU32::new(20_000);

/// Sets the time between telemetry ticks in µs, from the next tick on.
pub fn set_telemetry_period_us(period_us: u32) {
    // No rate needs more than a thousand ticks a second.
    TELEMETRY_PERIOD_US.store(period_us.max(1_000), Ordering::Relaxed);
}

impl Timebase {
    /// Starts the count at zero.
    pub fn start(timer: TIM5) -> Self {
        clocks::enable(|rcc| {
            rcc.apb1enr().modify(|_, w| w.tim5en().set_bit());
        });
        let ticks_per_us = 2 * BOARD.apb1_hz / 1_000_000;
        timer
            .psc()
            .write(|w| w.psc().set((ticks_per_us - 1) as u16));
        timer.arr().write(|w| w.arr().set(u32::MAX));
        // Channel 2: input, no filter, rising edge. Channels 1, 3 and 4: compare, no output.
        timer.ccmr1_input().write(|w| w.cc2s().ti2());
        timer.ccer().write(|w| w.cc2e().set_bit());
        timer.ccr1().write(|w| w.ccr().set(u32::MAX));
        timer.egr().write(|w| w.ug().set_bit());
        timer.sr().reset();
        timer
            .dier()
            .write(|w| w.cc1ie().set_bit().cc3ie().set_bit().cc4ie().set_bit());
        timer.cr1().write(|w| w.cen().set_bit());
        // Relative to the first count, so that tests may start it just before it wraps.
        let count = timer.cnt().read().cnt().bits();
        let first = count.wrapping_add(TELEMETRY_PERIOD_US.load(Ordering::Relaxed));
        timer.ccr3().write(|w| w.ccr().set(first));
        Self {
            timer,
            extender: CounterExtender::new(count),
        }
    }

    /// Returns the count at the last rising edge of the INT pin.
    pub fn captured(&self) -> u32 {
        self.timer.ccr2().read().ccr().bits()
    }

    /// Returns a recent count as microseconds since boot.
    #[inline(always)]
    pub fn extend(&mut self, count: u32) -> u64 {
        self.extender.extend(count)
    }

    /// Serves the interrupt.
    pub fn on_interrupt(&mut self) -> Alarms {
        let status = self.timer.sr().read();
        // SAFETY: writing zero clears a flag, and writing one has no effect (RM0090, 18.4.5).
        self.timer
            .sr()
            .write(|w| unsafe { w.bits(FLAGS & !status.bits()) });
        let now = self.timer.cnt().read().cnt().bits();
        self.extender.extend(now);
        let mut is_burst_alarm = status.cc1if().bit_is_set();
        if status.cc3if().bit_is_set() {
            let due = self.timer.ccr3().read().ccr().bits();
            let period_us = TELEMETRY_PERIOD_US.load(Ordering::Relaxed);
            let next = due.wrapping_add(period_us);
            // After a long stall of the core the next tick may be in the past. Its compare would
            // come an hour later.
            let next = if has_passed(next, now) {
                now.wrapping_add(period_us)
            } else {
                next
            };
            self.timer.ccr3().write(|w| w.ccr().set(next));
            // The burst reader's alarm may be in the past for that reason too; the reader always
            // sets it again.
            is_burst_alarm |= has_passed(self.timer.ccr1().read().ccr().bits(), now);
        }
        Alarms {
            burst: is_burst_alarm,
            telemetry: status.cc3if().bit_is_set(),
        }
    }
}

/// Returns whether the counter has reached `count` at `now`. The two must lie within half a turn of
/// each other.
fn has_passed(count: u32, now: u32) -> bool {
    now.wrapping_sub(count) < 1 << 31
}

/// Sets the burst reader's alarm to a count. Called by the reader, and by the idle task while the
/// reader is disabled.
pub fn set_burst_alarm(count: u32) {
    // SAFETY: the time base itself never writes this channel.
    unsafe { &*TIM5::ptr() }
        .ccr1()
        .write(|w| w.ccr().set(count));
}

/// Returns whether the burst reader's alarm was set to now or earlier, and not
/// [raised](raise_burst_alarm).
pub fn burst_alarm_is_due() -> bool {
    // SAFETY: reading these has no side effect.
    let timer = unsafe { &*TIM5::ptr() };
    has_passed(timer.ccr1().read().ccr().bits(), now())
}

/// Triggers the burst reader's alarm at once.
pub fn raise_burst_alarm() {
    // SAFETY: in a store to this register only the ones have an effect (RM0090, 18.4.6).
    unsafe { &*TIM5::ptr() }.egr().write(|w| w.cc1g().set_bit());
}

/// Returns the present count, for callers that do not own the time base.
pub fn now() -> u32 {
    // SAFETY: reading the count has no side effect.
    unsafe { &*TIM5::ptr() }.cnt().read().cnt().bits()
}

/// Returns whether `limit_us` have passed since the count was `start`. Valid for limits up to 71
/// minutes.
pub fn elapsed(start: u32, limit_us: u32) -> bool {
    now().wrapping_sub(start) >= limit_us
}

/// Sets the count that ends a delay's sleep, by channel 4's compare.
#[inline(always)]
pub(super) fn set_wake_up(count: u32) {
    // SAFETY: only the idle task writes this channel, through this function.
    unsafe { &*TIM5::ptr() }
        .ccr4()
        .write(|w| w.ccr().set(count));
}

/// Sleeps between interrupts until `condition` holds. Only the idle task calls this.
pub fn sleep_until(condition: impl Fn() -> bool) {
    loop {
        // An interrupt that comes between the check and the sleep stays pending and ends the sleep.
        let done = cortex_m::interrupt::free(|_| {
            let done = condition();
            if !done {
                cortex_m::asm::wfi();
            }
            done
        });
        if done {
            return;
        }
    }
}
