//! Nucleo-F446RE, clocked with 8 MHz by its debugger: 168 MHz, APB1 42 MHz (STM32F446xC/E
//! datasheet, "General operating conditions"). Its 180 MHz would need the regulator's over-drive,
//! and an APB1 clock that does not divide to 400 kHz on the sensor's bus.

use super::Board;

/// Board of this image.
pub const BOARD: Board = Board {
    name: "nucleo-f446",
    crystal_hz: 8_000_000,
    crystal_is_external_clock: true,
    core_hz: 168_000_000,
    apb1_hz: 42_000_000,
};
