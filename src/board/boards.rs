//! Differences between the boards: the crystal, and the chip's rated clocks. One file for each
//! board.
//!
//! Pins, alternate functions and DMA streams are the same on all boards. They follow the
//! datasheets' tables "Alternate function mapping" and the manuals' tables "DMA1 request mapping".
//! I2C1 is on PB8 and PB9 (AF4), TIM5 channel 2 on PA1 (AF2), USART2 on PA2 and PA3 (AF7). I2C1_RX
//! is on DMA1 stream 0, channel 1, USART2 on streams 5 and 6, channel 4. The flash sectors are
//! equal up to the first 64 KiB. Register sections are cited from RM0090 (STM32F405); RM0368
//! (F401), RM0383 (F411) and RM0390 (F446) have the same registers.

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

/// Board: its name and clocks.
pub struct Board {
    /// Name, as the value of `--board`.
    pub name: &'static str,
    /// Frequency at the HSE input, in hertz.
    pub crystal_hz: u32,
    /// True if another chip drives the HSE input (Nucleo boards: the debugger's clock) instead of a
    /// crystal.
    pub crystal_is_external_clock: bool,
    /// Core clock, in hertz.
    pub core_hz: u32,
    /// APB1 bus clock, in hertz: whole megahertz, which divide to the 400 kHz of I2C1
    /// (`sensor_bus.rs`). USART2 divides it to the baud rate (`uart.rs`). TIM5 counts twice the
    /// frequency (`timebase.rs`).
    pub apb1_hz: u32,
}
