//! Starts the clocks: from the crystal if it answers, else from the internal oscillator.
//!
//! The HAL's `freeze` waits for ever for a dead crystal, so the crystal is asked first, with a
//! limit.

use stm32f4xx_hal::pac::rcc::pllcfgr::PLLP;
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
    #[cfg(not(feature = "board-stm32f405"))]
    prepare_voltage();
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

/// Switches the power controller's clock on, without which [`voltage_is_ready`] never is, and
/// selects the regulator's scale 1 on an STM32F411, which begins at scale 2, good for 84 MHz
/// (RM0383, 5.4.1); the other chips begin with what their clock needs. The scale comes with the
/// PLL, and can be selected before it is on: so before `freeze`.
#[cfg(not(feature = "board-stm32f405"))]
fn prepare_voltage() {
    enable(|rcc| {
        rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    });
    #[cfg(any(feature = "board-blackpill-f411", feature = "board-nucleo-f411"))]
    // SAFETY: only init, before any interrupt, writes this register, and 0b11 is scale 1.
    unsafe {
        (*stm32f4xx_hal::pac::PWR::ptr())
            .cr()
            .modify(|_, w| w.vos().bits(0b11));
    }
}

/// Returns whether the regulator gives what the core needs with the PLL on. The STM32F405 alone
/// keeps its scale while the PLL is off.
#[cfg(not(feature = "board-stm32f405"))]
fn voltage_is_ready() -> bool {
    // SAFETY: reading this register has no side effect.
    unsafe { &*stm32f4xx_hal::pac::PWR::ptr() }
        .csr()
        .read()
        .vosrdy()
        .bit_is_set()
}

/// Has the hardware watch the crystal: if it stops, the core goes on from the internal oscillator,
/// at 16 MHz, and an NMI comes (RM0090, 6.2.7). [`restore`] then brings the frequencies back.
pub fn watch_crystal() {
    // SAFETY: only init, before any interrupt, writes this register, and `restore`, which comes
    // later.
    let rcc = unsafe { &*RCC::ptr() };
    rcc.cr().modify(|_, w| w.csson().set_bit());
}

/// Returns whether the core has lost its crystal and runs from the bare internal oscillator.
#[inline(always)]
pub fn have_fallen_back() -> bool {
    // SAFETY: reading this register has no side effect.
    !unsafe { &*RCC::ptr() }.cfgr().read().sws().is_pll()
}

/// Runs the core, and with it every timer and bus, at [`BOARD`]'s frequency again, from the
/// internal oscillator. Waits for the PLL, 0.3 ms at most (STM32F405 datasheet, table "Main PLL
/// characteristics"): once, when the crystal has died.
#[cold]
#[inline(never)]
pub fn restore() {
    // SAFETY: init is long over, so the only writers are this, which nothing interrupts but the
    // NMI, and the NMI, which writes another register.
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
    for _ in 0..PLL_READINGS {
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

/// The PLL is asked so often whether it is ready: 0.3 ms at 16 MHz and 4 cycles each.
const PLL_READINGS: u32 = 1_200;

/// Clears the crystal's failure, so that its NMI ends. For the NMI's handler.
pub fn acknowledge_failure() {
    // SAFETY: the bit clears a flag, and no other of this register is in use.
    unsafe { &*RCC::ptr() }.cir().write(|w| w.cssc().set_bit());
}

/// Switches on the clocks that `change` asks for. Only for init, before any interrupt is enabled.
pub(super) fn enable(change: impl FnOnce(&rcc::RegisterBlock)) {
    // SAFETY: nothing else writes RCC at that time.
    change(unsafe { &*RCC::ptr() });
    // A peripheral answers two cycles after its clock begins (errata sheet ES0182, "Delay after an
    // RCC peripheral clock enabling").
    cortex_m::asm::dsb();
}

/// Returns whether the HSE input becomes ready in time; it is switched off again if not.
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
