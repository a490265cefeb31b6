//! "Black Pill" with an STM32F411CE and a 25 MHz crystal: 100 MHz, APB1 50 MHz at most
//! (STM32F411xC/E datasheet, "General operating conditions").

use super::Board;

/// Board of this image.
pub const BOARD: Board = Board {
    name: "blackpill-f411",
    crystal_hz: 25_000_000,
    crystal_is_external_clock: false,
    core_hz: 100_000_000,
    apb1_hz: 50_000_000,
};
