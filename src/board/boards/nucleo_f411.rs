//! Nucleo-F411RE, clocked with 8 MHz by its debugger: 100 MHz, APB1 50 MHz at most (STM32F411xC/E
//! datasheet, "General operating conditions").

use super::Board;

/// Board of this image.
pub const BOARD: Board = Board {
    name: "nucleo-f411",
    crystal_hz: 8_000_000,
    crystal_is_external_clock: true,
    core_hz: 100_000_000,
    apb1_hz: 50_000_000,
};
