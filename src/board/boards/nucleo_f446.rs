//! Nucleo-F446RE, clocked with 8 MHz by its debugger: 180 MHz with the regulator's over-drive, which the HAL switches on, APB1 45 MHz
//! at most (STM32F446xC/E datasheet, "General operating conditions").

use super::Board;

/// The board that this image is built for.
pub const BOARD: Board = Board {
    name: "nucleo-f446",
    crystal_hz: 8_000_000,
    crystal_is_external_clock: true,
    core_hz: 180_000_000,
    peripheral_hz: 45_000_000,
};
