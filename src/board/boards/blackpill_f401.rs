//! "Black Pill" with an STM32F401CC (or CE) and a 25 MHz crystal: 84 MHz, APB1 42 MHz at most
//! (STM32F401xB/C datasheet, "General operating conditions").

use super::Board;

/// Board of this image.
pub const BOARD: Board = Board {
    name: "blackpill-f401",
    crystal_hz: 25_000_000,
    crystal_is_external_clock: false,
    core_hz: 84_000_000,
    apb1_hz: 42_000_000,
};
