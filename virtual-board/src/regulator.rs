//! The regulator of the core's supply, which limits the core's clock.

/// The regulator of the core's supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Regulator {
    /// PWR_CR after reset.
    pub reset: u64,
    /// The highest clock of the core by VOS, PWR_CR bits 15 and 14, MHz.
    pub limits_mhz: [u64; 4],
}

impl Regulator {
    /// The STM32F405's: bit 15 is reserved (RM0090, 5.4.1).
    pub const F405: Self = Self {
        reset: 0x4000,
        limits_mhz: [144, 168, 144, 168],
    };
    /// The STM32F401's (RM0368, 5.4.1).
    pub const F401: Self = Self {
        reset: 0x8000,
        limits_mhz: [60, 60, 84, 84],
    };
    /// The STM32F411's (RM0383, 5.4.1).
    pub const F411: Self = Self {
        reset: 0x8000,
        limits_mhz: [64, 64, 84, 100],
    };
    /// The STM32F446's, without over-drive (RM0390, 5.4.1).
    pub const F446: Self = Self {
        reset: 0xC000,
        limits_mhz: [120, 120, 144, 168],
    };
}
