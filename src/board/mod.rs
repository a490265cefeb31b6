//! The STM32F4 side: clocks, the time base, the sensor's bus, the burst reader and the UART, at
//! register level where timing matters.
//!
//! Pins and DMA streams are the same on every board (see ARCHITECTURE.md); what differs stands in
//! [`boards`]. This is the only module with `unsafe`: each block says why it is sound. The unit of
//! ownership is the peripheral, and where two owners share one (DMA1's clear registers, the
//! sensor's bus) the hand-over rule stands beside the code.
//!
//! | interrupt | priority | does | deadline |
//! |---|---|---|---|
//! | EXTI1, I2C1, DMA1 stream 0, TIM5 | 4 | one step of a burst, or the time base | a step per byte time, 22 µs; none takes 1 µs |
//! | attitude (SPI3's vector) | 3 | decode, calibrate, filter, publish | before the next burst ends, 1 ms |
//! | telemetry (software task) | 1 | text and log, 50 times a second | none: it drops lines rather than wait |
//! | idle | 0 | configures the sensor, and again after a fault | none |

pub mod attitude_task;
pub mod boards;
pub mod burst_reader;
pub mod clocks;
pub mod crash;
pub mod flash;
pub mod handover;
pub mod pins;
pub mod publish;
pub mod retained;
pub mod sensor;
pub mod sensor_bus;
pub mod timebase;
pub mod uart;
pub mod watchdog;
