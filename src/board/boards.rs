//! What differs from board to board: the crystal and the clock that the chip is rated for.

/// One board.
pub struct Board {
    /// The name that `--board` takes.
    pub name: &'static str,
    /// The frequency at the HSE input, in hertz.
    pub crystal_hz: u32,
    /// Whether another chip drives the HSE input (Nucleo boards: the debugger's clock) instead of a crystal.
    pub crystal_is_external_clock: bool,
    /// The core clock, in hertz.
    pub core_hz: u32,
    /// The APB1 bus clock, in hertz: the I2C's input. The timers on it run at twice this.
    pub peripheral_hz: u32,
}

/// The board that this image is built for.
#[cfg(any(feature = "board-stm32f405", feature = "qemu"))]
pub const BOARD: Board = Board {
    name: "stm32f405",
    crystal_hz: 8_000_000,
    crystal_is_external_clock: false,
    core_hz: 168_000_000,
    peripheral_hz: 42_000_000,
};

/// The board that this image is built for.
#[cfg(feature = "board-blackpill-f411")]
pub const BOARD: Board = Board {
    name: "blackpill-f411",
    crystal_hz: 25_000_000,
    crystal_is_external_clock: false,
    core_hz: 100_000_000,
    peripheral_hz: 50_000_000,
};

/// The board that this image is built for.
#[cfg(feature = "board-nucleo-f411")]
pub const BOARD: Board = Board {
    name: "nucleo-f411",
    crystal_hz: 8_000_000,
    crystal_is_external_clock: true,
    core_hz: 100_000_000,
    peripheral_hz: 50_000_000,
};
