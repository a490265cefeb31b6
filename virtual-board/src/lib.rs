//! An emulated STM32F4 board with a modelled MPU-6050, on which aplomb's firmware image flies
//! unchanged.
//!
//! | module | contents |
//! |---|---|
//! | [`kit`], [`fitted`], [`wires`] | the sensor and the compass on their wires |
//! | [`faults`], [`schedule`] | the faults, and their times |
//! | [`mcu`], [`exti`], [`i2c`], [`bus_step`], [`dma`] | the microcontroller |
//! | [`crystal`], [`regulator`] | its clock and its supply |
//! | [`board`] | the boards and their cores |
//! | [`image`] | the firmware image |
//! | [`profile`] | the number of instructions that each interrupt executes |
//! | [`probe`] | a debug probe that reads the log |
//! | [`recorder`] | the record of a run |
//! | [`flight`], [`summary`], [`cycles`] | a run, its figures, and an estimate in cycles |
//! | [`campaign`] | random flights with random faults, and their rules |
//! | [`port`] | the UART for other programs: standard streams, pseudo-terminal, TCP |
//! | [`outputs`], [`plot`] | the files that a flight leaves |
//!
//! The sensor and the motion are those of `aplomb-models`.
//!
//! # Findings and what they fail
//!
//! - Note, in [`checks`]: a rule that the present access breaks. It becomes a violation.
//! - Violation, in [`flight::Outcome`]: a broken rule, or an access or an interrupt that leads
//!   nowhere. It fails `fly`. It fails a campaign's flight, unless a fault of the case explains it.
//! - Issue, in [`flight::Outcome`]: a violation, a reset, or a gap in the account of instructions.
//!   It fails a test that asks for no issues. `fly` prints it as a warning.
//! - Failure, in [`campaign::Report`]: a violation, or another rule of the [`campaign`] that the
//!   flight breaks. It fails the campaign, and a test that judges a case.
//!
//! `fly` also fails if the firmware publishes no attitude.

pub mod board;
pub mod bus_step;
pub mod campaign;
pub mod checks;
pub mod crystal;
pub mod cycles;
mod delegate;
pub mod dma;
pub mod error;
pub mod exti;
pub mod faults;
pub mod fitted;
mod fitted_compass;
pub mod flash;
pub mod flight;
pub mod i2c;
pub mod image;
pub mod kit;
pub mod mcu;
pub mod outputs;
pub mod plot;
pub mod port;
pub mod probe;
pub mod profile;
pub mod ram;
pub mod recorder;
pub mod regulator;
pub mod schedule;
pub mod script;
pub mod slots;
pub mod summary;
mod watchdog;
pub mod wires;

pub use error::Error;
