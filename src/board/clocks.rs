//! Starts the clocks: from the crystal if it starts, else from the internal oscillator.
//!
//! The HAL's `freeze` waits forever for a dead crystal, so the crystal is checked first, with a
//! limit.

use stm32f4xx_hal::pac::rcc::pllcfgr::PLLP;
#[cfg(feature = "board-stm32f405")]
use stm32f4xx_hal::pac::{DBGMCU, FLASH};
use stm32f4xx_hal::pac::{RCC, rcc};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{Config, Rcc};

use super::boards::BOARD;
use crate::fault::ClockSource;

/// Polls of the ready flag before the crystal counts as absent. At the 16 MHz of reset a poll
/// takes at least 4 cycles, so they take 25 ms or more. Crystals start within 2 ms (STM32F405
/// datasheet, table "HSE oscillator characteristics").
const CRYSTAL_POLLS: u32 = 100_000;

/// Runs the core at [`BOARD`]'s frequency, and returns the source of the clock.
pub fn start(rcc: RCC) -> (Rcc, ClockSource) {
    let source = if crystal_starts(&rcc) {
        ClockSource::Crystal
    } else {
        ClockSource::InternalOscillator
    };
    #[cfg(not(feature = "board-stm32f405"))]
    prepare_voltage();
    let config = match source {
        ClockSource::Crystal if BOARD.crystal_is_external_clock => {
            Config::hse(BOARD.crystal_hz.Hz()).bypass_hse_oscillator()
        }
        ClockSource::Crystal => Config::hse(BOARD.crystal_hz.Hz()),
        ClockSource::InternalOscillator => Config::hsi(),
    };
    let config = config.sysclk(BOARD.core_hz.Hz()).pclk1(BOARD.apb1_hz.Hz());
    let rcc = rcc.freeze(config);
    #[cfg(feature = "board-stm32f405")]
    stop_prefetch_on_revision_a();
    (rcc, source)
}

/// Switches the flash's prefetch off on revision A of the STM32F405, which does not support it
/// (errata sheet ES0182, "ART accelerator prefetch queue instruction is not supported"). The HAL
/// switches it on for every revision.
#[cfg(feature = "board-stm32f405")]
fn stop_prefetch_on_revision_a() {
    // SAFETY: reading this register has no side effect.
    let identity = unsafe { &*DBGMCU::ptr() }.idcode().read();
    let (device, revision) = (identity.dev_id().bits(), identity.rev_id().bits());
    if device == REVISION_A_DEVICE || (device == STM32F405 && revision == REVISION_A) {
        // SAFETY: only init, before any interrupt, writes this register.
        unsafe { &*FLASH::ptr() }
            .acr()
            .modify(|_, w| w.prften().clear_bit());
    }
}

/// DEV_ID and REV_ID of DBGMCU_IDCODE (RM0090, 38.6.1).
#[cfg(feature = "board-stm32f405")]
const STM32F405: u16 = 0x413;
#[cfg(feature = "board-stm32f405")]
const REVISION_A: u16 = 0x1000;
/// DEV_ID of revision A: that of the STM32F2 (errata sheet ES0182, "MCU device ID is incorrect").
#[cfg(feature = "board-stm32f405")]
const REVISION_A_DEVICE: u16 = 0x411;

/// Switches the power controller's clock on, which [`voltage_is_ready`] needs, and selects the
/// regulator's scale. The scale takes effect with the PLL, and must be selected while the PLL is
/// off: before `freeze`.
#[cfg(not(feature = "board-stm32f405"))]
fn prepare_voltage() {
    enable(|rcc| {
        rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    });
    if NEEDS_SCALE_1 {
        // SAFETY: only init, before any interrupt, writes this register, and 0b11 is scale 1.
        unsafe {
            (*stm32f4xx_hal::pac::PWR::ptr())
                .cr()
                .modify(|_, w| w.vos().bits(0b11));
        }
    }
}

/// True if the regulator starts at a scale that is too low for the core's clock. Chips of up to
/// 100 MHz start at scale 2, for up to 84 MHz (RM0383, 5.4.1). Faster chips start at scale 1.
#[cfg(not(feature = "board-stm32f405"))]
const NEEDS_SCALE_1: bool = BOARD.core_hz > 84_000_000 && BOARD.core_hz <= 100_000_000;

/// Returns whether the regulator's voltage suffices for the core with the PLL on. Only the
/// STM32F405 keeps its scale while the PLL is off.
#[cfg(not(feature = "board-stm32f405"))]
fn voltage_is_ready() -> bool {
    // SAFETY: reading this register has no side effect.
    unsafe { &*stm32f4xx_hal::pac::PWR::ptr() }
        .csr()
        .read()
        .vosrdy()
        .bit_is_set()
}

/// Enables the hardware's monitor of the crystal (RM0090, 6.2.7). If the crystal stops, the core
/// continues from the internal oscillator at 16 MHz, and an NMI comes. [`restore`] then restores
/// the frequencies.
pub fn watch_crystal() {
    // SAFETY: only init, before any interrupt, writes this register, and later `restore`.
    let rcc = unsafe { &*RCC::ptr() };
    rcc.cr().modify(|_, w| w.csson().set_bit());
}

/// Returns whether the core has lost its crystal and runs from the bare internal oscillator.
#[inline(always)]
pub fn have_fallen_back() -> bool {
    // SAFETY: reading this register has no side effect.
    !unsafe { &*RCC::ptr() }.cfgr().read().sws().is_pll()
}

/// Restores [`BOARD`]'s frequency of the core, timers and buses from the internal oscillator. Waits
/// for the PLL, 0.3 ms at most (STM32F405 datasheet, table "Main PLL characteristics"). Runs once,
/// after the crystal has failed.
#[cold]
#[inline(never)]
pub fn restore() {
    // SAFETY: init has ended, so the only writers are this function and the NMI. Only the NMI can
    // interrupt this function, and its one store clears a flag in a register of its own.
    let rcc = unsafe { &*RCC::ptr() };
    acknowledge_failure();
    super::retained::count(crate::fault::FaultClass::ClockFailed);
    rcc.cr().modify(|_, w| w.pllon().clear_bit());
    // 16 MHz / 16, times N, / P; the division for USB does not matter, but must be 2 or more.
    // SAFETY: N is 336 to 400, within the 192 to 432 that the manual allows (RM0090, 6.3.2; the
    // same in RM0368, RM0383 and RM0390).
    rcc.pllcfgr().write(|w| unsafe {
        w.pllsrc()
            .hsi()
            .pllm()
            .bits(16)
            .plln()
            .bits(PLL_MULTIPLIER)
            .pllp()
            .variant(PLL_DIVISION)
            .pllq()
            .bits(8)
    });
    rcc.cr().modify(|_, w| w.pllon().set_bit());
    for _ in 0..PLL_POLLS {
        #[cfg(not(feature = "board-stm32f405"))]
        if !voltage_is_ready() {
            continue;
        }
        if rcc.cr().read().pllrdy().bit_is_set() {
            rcc.cfgr().modify(|_, w| w.sw().pll());
            return;
        }
    }
}

/// N and P of the PLL at 1 MHz. Slower cores divide by four, so that the multiplied frequency is
/// 192 MHz or more.
const PLL_MULTIPLIER: u16 = match PLL_DIVISION {
    PLLP::Div2 => 2 * (BOARD.core_hz / 1_000_000) as u16,
    _ => 4 * (BOARD.core_hz / 1_000_000) as u16,
};
const PLL_DIVISION: PLLP = if BOARD.core_hz > 108_000_000 {
    PLLP::Div2
} else {
    PLLP::Div4
};
const _: () = assert!(PLL_MULTIPLIER >= 192 && PLL_MULTIPLIER <= 432);

/// Polls of the PLL's ready flag: 0.3 ms at 16 MHz and 4 cycles each.
const PLL_POLLS: u32 = 1_200;

/// Clears the crystal's failure, so that its NMI ends. The NMI's handler and `restore` call this.
pub fn acknowledge_failure() {
    // SAFETY: the bit clears a flag, and no other bit of this register is in use.
    unsafe { &*RCC::ptr() }.cir().write(|w| w.cssc().set_bit());
}

/// Switches on the clocks that `change` selects. Only for init, before any interrupt is enabled.
pub(super) fn enable(change: impl FnOnce(&rcc::RegisterBlock)) {
    // SAFETY: nothing else writes RCC at that time.
    change(unsafe { &*RCC::ptr() });
    // A peripheral answers two cycles after its clock begins (errata sheet ES0182, "Delay after an
    // RCC peripheral clock enabling").
    cortex_m::asm::dsb();
}

/// Returns whether the HSE input becomes ready in time. If not, switches it off again.
fn crystal_starts(rcc: &RCC) -> bool {
    rcc.cr()
        .modify(|_, w| w.hsebyp().bit(BOARD.crystal_is_external_clock));
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    for _ in 0..CRYSTAL_POLLS {
        if rcc.cr().read().hserdy().bit_is_set() {
            return true;
        }
    }
    rcc.cr().modify(|_, w| w.hseon().clear_bit());
    rcc.cr().modify(|_, w| w.hsebyp().clear_bit());
    false
}
