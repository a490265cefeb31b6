//! Attitude from an MPU-6050: the part of `aplomb` that runs anywhere.
//!
//! One sample makes one trip, always in the same direction:
//!
//! ```text
//! Burst ─► decode ─► calibrate and align ─► estimate ─► health ─► Snapshot ─► telemetry
//!        (mpu6050)  (calibration)           (estimator)  (health)  (pipeline)
//! ```
//!
//! [`pipeline::Pipeline`] is the whole trip in one call. It has no clock, no bus and no memory of
//! its own beyond the struct, so the same bytes give the same attitude, to the bit, in the firmware,
//! in an emulator and on a computer: every operation is either plain `f32` arithmetic or comes from
//! `libm`, and nothing depends on the platform's mathematics library.
//!
//! | module | what it knows |
//! |---|---|
//! | [`units`] | constants, and the extension of a 32-bit microsecond counter to 64 bits |
//! | [`attitude`] | vectors, quaternions, Euler angles, the two frames |
//! | [`mpu6050`] | registers, settings, the 14-byte burst, the configuring driver |
//! | [`calibration`] | rest, and what is made of it: offsets, poses, level, mount, temperature |
//! | [`estimator`] | one file per filter |
//! | [`fault`] | what can go wrong between the sensor's pins and the pipeline |
//! | [`health`] | the flags that travel with every attitude |
//! | [`pipeline`] | the order of the steps |
//! | [`state`] | a filter's memory as bytes, for logs that replay to the bit |
//! | [`telemetry`] | one file per output format, encoder and decoder together |
//!
//! Body axes are forward-right-down, earth axes are north-east-down ("north" being the heading at
//! start, since nothing here sees a compass). Angles are radians inside and degrees in text.

#![cfg_attr(not(test), no_std)]
#![deny(missing_docs)]
#![deny(unsafe_code)]

pub mod attitude;
pub mod calibration;
pub mod console;
pub mod estimator;
pub mod fault;
pub mod health;
pub mod mpu6050;
pub mod pipeline;
pub mod state;
pub mod telemetry;
pub mod units;

/// The firmware's hardware: pins, clocks, DMA and the burst state machine.
#[cfg(all(target_os = "none", feature = "rtic-app"))]
#[allow(unsafe_code)]
pub mod board;

/// Compiles the README's example with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
