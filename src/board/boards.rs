//! What differs from board to board: the crystal and the clocks that the chip is rated for. One
//! file for each board.
//!
//! Pins, alternate functions and DMA streams are the same on all of them, as the datasheets' tables
//! "Alternate function mapping" and the manuals' tables "DMA1 request mapping" have them: I2C1 on
//! PB8 and PB9 (AF4), TIM5 channel 2 on PA1 (AF2), USART2 on PA2 and PA3 (AF7); I2C1_RX on DMA1
//! stream 0, channel 1, USART2 on streams 5 and 6, channel 4. So are the flash sectors up to the
//! first 64 KiB. Register sections are cited from RM0090 (STM32F405); RM0368 (F401), RM0383 (F411)
//! and RM0390 (F446) have the same registers.

#[cfg(feature = "board-blackpill-f401")]
mod blackpill_f401;
#[cfg(feature = "board-blackpill-f411")]
mod blackpill_f411;
#[cfg(feature = "board-nucleo-f411")]
mod nucleo_f411;
#[cfg(feature = "board-nucleo-f446")]
mod nucleo_f446;
#[cfg(feature = "board-stm32f405")]
mod stm32f405;

#[cfg(feature = "board-blackpill-f401")]
pub use blackpill_f401::BOARD;
#[cfg(feature = "board-blackpill-f411")]
pub use blackpill_f411::BOARD;
#[cfg(feature = "board-nucleo-f411")]
pub use nucleo_f411::BOARD;
#[cfg(feature = "board-nucleo-f446")]
pub use nucleo_f446::BOARD;
#[cfg(feature = "board-stm32f405")]
pub use stm32f405::BOARD;

/// One board.
pub struct Board {
    /// The name that `--board` takes.
    pub name: &'static str,
    /// The frequency at the HSE input, in hertz.
    pub crystal_hz: u32,
    /// True if another chip drives the HSE input (Nucleo boards: the debugger's clock) instead of a
    /// crystal.
    pub crystal_is_external_clock: bool,
    /// The core clock, in hertz.
    pub core_hz: u32,
    /// The APB1 bus clock, in hertz: the I2C's input. The timers on it run at twice this.
    pub peripheral_hz: u32,
}
