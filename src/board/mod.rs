//! STM32F4 drivers: clocks, time base, sensor bus, burst reader and UART, at register level where
//! timing matters.
//!
//! Pins and DMA streams are the same on every board: see `pins.rs` and the README. [`boards`] holds
//! the differences. Only this module contains `unsafe`; each block
//! gives the reason why it is sound. The unit of ownership is the peripheral. Where two owners
//! share one (DMA1's clear registers, the sensor's bus), a comment beside the code gives the
//! hand-over rule.
//!
//! | interrupt | priority | does | deadline |
//! |---|---|---|---|
//! | EXTI1, I2C1, DMA1 stream 0, TIM5 | 4 | a burst's step, or the time base | byte time, 22 µs |
//! | attitude (SPI3's vector) | 3 | decode, calibrate, filter, publish | next burst's end, 1 ms |
//! | telemetry (software task) | 1 | text and log, 50 to 1000 times a second | none: drops lines |
//! | idle | 0 | configures the sensor, and again after a fault | none |

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
pub mod retained;
pub mod sensor;
pub mod sensor_bus;
pub mod stack_guard;
mod supply;
pub mod timebase;
pub mod uart;
pub mod watchdog;
