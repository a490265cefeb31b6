//! Supply voltage, compared by the power controller with a threshold (PVD).
//!
//! The flash takes 32 bits at a time from 2.7 V on (RM0090, 3.6.2). The detector's level 5 lies
//! just above: 2.84 V when the voltage falls, 2.93 V when it rises (STM32F405 datasheet, table
//! "Embedded reset and power control block characteristics"). The other chips have the same levels.

use stm32f4xx_hal::pac::{PWR, pwr};

use super::clocks;

/// PLS for 2.84 V (RM0090, 5.4.1).
const LEVEL: u8 = 0b101;

/// Starts the comparison. Only for init, before any interrupt.
pub(super) fn watch() {
    clocks::enable(|rcc| {
        rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    });
    // SAFETY: the field takes any value.
    power()
        .cr()
        .modify(|_, w| unsafe { w.pls().bits(LEVEL).pvde().set_bit() });
}

/// Returns whether the supply is too low to change the flash.
pub(super) fn is_low() -> bool {
    power().csr().read().pvdo().bit_is_set()
}

fn power() -> &'static pwr::RegisterBlock {
    // SAFETY: init alone writes these registers, and reading them has no side effect.
    unsafe { &*PWR::ptr() }
}
