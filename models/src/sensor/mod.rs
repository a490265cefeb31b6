//! A register-accurate MPU-6050, as an I2C bus, an interrupt wire and the world's motion see it.
//!
//! Written from the register map (RM-MPU-6000A r4.2) and the product specification (PS-MPU-6000A
//! r3.4) alone: it shares nothing with the driver that it tests.
//!
//! - [`registers`]: what can be written, and what reads back after a reset;
//! - [`clock`]: when the converters sample, with the chip's own idea of a second;
//! - [`errors`], [`low_pass`], [`signal_path`]: from the motion to counts;
//! - [`interrupt`], [`bus`]: the INT pin and the I2C transaction;
//! - [`identity`]: clones and successors;
//! - [`model`]: the chip that puts them together.
//!
//! Not modelled: the FIFO (its count reads zero), the auxiliary I2C master, FSYNC, the motion
//! processor, nonlinearity.

pub mod bus;
pub mod clock;
pub mod errors;
pub mod identity;
pub mod interrupt;
pub mod low_pass;
pub mod model;
pub mod registers;
pub mod signal_path;
#[cfg(test)]
mod tests;

pub use bus::Burst;
pub use clock::ClockErrors;
pub use errors::SensorErrors;
pub use interrupt::PinLevel;
pub use model::{DataReady, OutputFault, Sensor, SensorConfig};
