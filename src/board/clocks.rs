//! Starts the clocks: from the crystal if it answers, else from the internal oscillator.
//!
//! The HAL's `freeze` waits for ever for a dead crystal, so the crystal is asked first, with a limit.

use stm32f4xx_hal::pac::{RCC, rcc};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{Config, Rcc};

use super::boards::BOARD;
use crate::fault::ClockSource;

/// How often the ready flag is read before the crystal counts as absent. At the 16 MHz of reset a
/// reading takes at least 4 cycles, so this waits for 25 ms or more; crystals start within 2 ms
/// (STM32F405 datasheet, table "HSE oscillator characteristics").
const CRYSTAL_READINGS: u32 = 100_000;

/// Runs the core at [`BOARD`]'s frequency and says from what.
pub fn start(rcc: RCC) -> (Rcc, ClockSource) {
    let source = if crystal_answers(&rcc) {
        ClockSource::Crystal
    } else {
        ClockSource::InternalOscillator
    };
    let config = match source {
        ClockSource::Crystal if BOARD.crystal_is_external_clock => {
            Config::hse(BOARD.crystal_hz.Hz()).bypass_hse_oscillator()
        }
        ClockSource::Crystal => Config::hse(BOARD.crystal_hz.Hz()),
        ClockSource::InternalOscillator => Config::hsi(),
    };
    let config = config
        .sysclk(BOARD.core_hz.Hz())
        .pclk1(BOARD.peripheral_hz.Hz());
    (rcc.freeze(config), source)
}

/// Switches on the clocks that `change` asks for. Only for init, before any interrupt is enabled.
pub(super) fn enable(change: impl FnOnce(&rcc::RegisterBlock)) {
    // SAFETY: nothing else writes RCC at that time.
    change(unsafe { &*RCC::ptr() });
    // A peripheral answers two cycles after its clock begins (errata sheet ES0182, "Delay after an RCC peripheral clock enabling").
    cortex_m::asm::dsb();
}

/// Whether the HSE input becomes ready in time; it is switched off again if not.
fn crystal_answers(rcc: &RCC) -> bool {
    rcc.cr()
        .modify(|_, w| w.hsebyp().bit(BOARD.crystal_is_external_clock));
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    for _ in 0..CRYSTAL_READINGS {
        if rcc.cr().read().hserdy().bit_is_set() {
            return true;
        }
    }
    rcc.cr().modify(|_, w| w.hseon().clear_bit());
    rcc.cr().modify(|_, w| w.hsebyp().clear_bit());
    false
}
