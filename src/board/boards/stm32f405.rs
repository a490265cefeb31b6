//! Any board with an STM32F405 and an 8 MHz crystal: 168 MHz, APB1 42 MHz at most (STM32F405
//! datasheet, "General operating conditions").

use super::Board;

/// Board of this image.
pub const BOARD: Board = Board {
    name: "stm32f405",
    crystal_hz: 8_000_000,
    crystal_is_external_clock: false,
    core_hz: 168_000_000,
    apb1_hz: 42_000_000,
};
