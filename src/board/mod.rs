//! STM32F4 drivers: clocks, time base, sensor bus, burst reader and UART, at register level where
//! timing matters.
//!
//! Pins and DMA streams are the same on every board: see `pins.rs` and the README. [`boards`] holds
//! the differences. This is the only module of the library with `unsafe`; each block gives the
//! reason why it is sound. The unit of ownership is the peripheral. Where two owners share one
//! (DMA1's clear registers, the sensor's bus), a comment beside the code gives the hand-over rule.
//! The tasks, their priorities and deadlines are in `src/bin/flight/main.rs`.

pub mod attitude_task;
pub mod boards;
pub mod burst_reader;
pub mod clocks;
pub mod compass;
pub mod crash;
pub mod delay;
pub mod flash;
pub mod heading;
pub mod measure;
pub mod pins;
mod publication;
pub mod retained;
pub mod sensor;
pub mod sensor_bus;
pub mod stack_guard;
mod supply;
pub mod timebase;
pub mod uart;
pub mod watchdog;
