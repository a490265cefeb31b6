//! An emulated STM32F4 board with a modelled MPU-6050, on which aplomb's firmware image flies unchanged.
//!
//! | module | what it is |
//! |---|---|
//! | [`motion`] | where the board really is: a simulated flight, or a recording |
//! | [`sensor`] | the MPU-6050, register by register |
//! | [`fitted`], [`wires`] | the sensor on its wires |
//! | [`faults`], [`schedule`] | what can go wrong, and when |
//! | [`mcu`], [`exti`], [`i2c`], [`dma`], [`crystal`] | the microcontroller, and what rigless's model of it lacks |
//! | [`board`] | the boards and their cores |
//! | [`image`] | the firmware image |
//! | [`profile`] | which interrupt executes how many instructions |
//! | [`probe`] | a debug probe that reads the log |
//! | [`recorder`] | what is noted during a run |
//! | [`flight`], [`summary`] | a run, and its figures |
//! | [`campaign`] | flights by chance with faults by chance, and what must hold in them |
//! | [`outputs`], [`plot`] | the files that a flight leaves |
//! | [`picture`], [`chart`], [`timeline`] | pictures, as PNG and SVG; charts over time, in fixed memory |
//!
//! The motion and the sensor need no emulator, and share no code with the library and the driver that they judge.

#![deny(unsafe_code)]

pub mod motion;
pub mod random;
pub mod sensor;

#[cfg(feature = "emulator")]
pub mod board;
#[cfg(feature = "emulator")]
pub mod campaign;
#[cfg(feature = "picture")]
pub mod chart;
#[cfg(feature = "emulator")]
pub mod crystal;
#[cfg(feature = "emulator")]
mod delegate;
#[cfg(feature = "emulator")]
pub mod dma;
#[cfg(feature = "emulator")]
pub mod error;
#[cfg(feature = "emulator")]
pub mod exti;
#[cfg(feature = "emulator")]
pub mod faults;
#[cfg(feature = "emulator")]
pub mod fitted;
#[cfg(feature = "emulator")]
pub mod flash;
#[cfg(feature = "emulator")]
pub mod flight;
#[cfg(feature = "emulator")]
pub mod i2c;
#[cfg(feature = "emulator")]
pub mod image;
#[cfg(feature = "emulator")]
pub mod mcu;
#[cfg(feature = "emulator")]
pub mod outputs;
#[cfg(feature = "picture")]
pub mod picture;
#[cfg(feature = "emulator")]
pub mod plot;
#[cfg(feature = "emulator")]
pub mod probe;
#[cfg(feature = "emulator")]
pub mod profile;
#[cfg(feature = "emulator")]
pub mod recorder;
#[cfg(feature = "emulator")]
pub mod schedule;
#[cfg(feature = "emulator")]
pub mod script;
#[cfg(feature = "emulator")]
pub mod summary;
#[cfg(feature = "picture")]
pub mod timeline;
#[cfg(feature = "emulator")]
pub mod wires;

#[cfg(feature = "emulator")]
pub use error::Error;
