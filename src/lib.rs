//! Estimates attitude from an MPU-6050, on any processor.
//!
//! One sample makes one trip, always in the same direction:
//!
//! ```text
//! Burst -> decode -> calibrate and align -> estimate -> health -> Snapshot -> telemetry
//!        (mpu6050)  (calibration)           (estimator)  (health)  (pipeline)
//! ```
//!
//! [`pipeline::Pipeline`] is the whole trip in one call. It has no clock, no bus and no memory
//! beyond the struct. Therefore the same bytes give the same attitude, to the bit, in the firmware,
//! in an emulator and on a computer. Every operation is plain `f32` arithmetic or comes from
//! `libm`, never from the platform's mathematics library.
//!
//! The module [`pipeline`] begins with an example.
//!
//! # Samples in SI units, without an MPU-6050
//!
//! [`Pipeline::update_sample`](pipeline::Pipeline::update_sample) needs a time, a specific force
//! and an angular rate in body axes. It returns the same snapshot, with its flags. The
//! [`estimator`] alone lacks [much of that](estimator::Estimator):
//!
//! ```
//! use aplomb::attitude::BodyVector;
//! use aplomb::estimator::Sample;
//! use aplomb::health::Flags;
//! use aplomb::pipeline::{Pipeline, Settings};
//!
//! # let force_m_s2 = BodyVector::new(0.0, -4.903, -8.493);
//! # let samples = (0..2_000).map(|n| (1_000 * n, force_m_s2, BodyVector::ZERO));
//! let mut pipeline = Pipeline::new(&Settings::for_samples(1_000.0)); // samples a second
//! for (t_us, force_m_s2, rate_rad_s) in samples {
//!     let snapshot = pipeline.update_sample(&Sample::new(t_us, force_m_s2, rate_rad_s));
//!     if snapshot.flags.contains(Flags::VALID) {
//!         println!("{:?} ± {} rad", snapshot.euler(), snapshot.tilt_sigma_rad());
//!     }
//! }
//! # let latest = pipeline.stale(2_000_000, Default::default());
//! # assert!((latest.euler().roll_rad.to_degrees() - 30.0).abs() < 0.1);
//! ```
//!
//! # Programs, features and modules
//!
//! Whole programs are in `examples/`: with RTIC and this crate's burst reader, with Embassy and
//! asynchronous I2C, with any `embedded-hal` bus, and on a computer. [`mpu6050::Mpu6050`] finds,
//! configures and reads the sensor over a blocking bus; [`mpu6050::Step`] is what any other bus has
//! to write.
//!
//! | feature | adds | brings |
//! |---|---|---|
//! | none | all modules below but two: `no_std`, no allocation | no HAL, no linker script |
//! | `mavlink` | `telemetry::mavlink` | the `mavlink` crate |
//! | `defmt` | `defmt::Format` on public types of data | `defmt` |
//! | `board-…` | `board` (target only), and the firmware | `stm32f4xx-hal`, RTIC, `defmt` |
//! | `full` | commands, MAVLink and flight log in the firmware | `mavlink` |
//! | `compass` | `full`, and a compass and its heading in the firmware | – |
//!
//! | module | contents |
//! |---|---|
//! | [`units`] | constants, and the extension of a 32-bit microsecond counter to 64 bits |
//! | [`attitude`] | vectors, quaternions, Euler angles, the two frames |
//! | [`mpu6050`] | registers, settings, the 14-byte burst, the configuring driver |
//! | [`compass`] | drivers of four compass parts, and the session that supervises them |
//! | [`calibration`] | stationary detector and fits: offsets, poses, level, mount, temperature |
//! | [`settings`] | content of the flash: the calibration and the outputs' preferences |
//! | [`estimator`] | the gate, the Kalman filter and the tutorial's filters |
//! | [`fault`] | classes of faults, causes of a reset, layout of the health report |
//! | [`health`] | the flags of every attitude, and the monitor that sets them |
//! | [`pipeline`] | the order of the steps |
//! | [`serialize`] | visits every field of a state: flight logs that replay to the bit |
//! | [`telemetry`] | one file per output format, encoder and decoder together |
//! | [`console`] | commands over a serial line |
//! | `board` | pins, clocks and DMA of an STM32F4, the burst reader |
//!
//! Body axes are forward-right-down, earth axes are north-east-down. "North" is the heading at
//! start; a compass adds a heading beside it ([`estimator::heading`]). Angles are radians inside,
//! and degrees in text.

#![cfg_attr(not(test), no_std)]
#![deny(missing_docs)]
#![warn(missing_debug_implementations)]
#![cfg_attr(
    not(test),
    warn(clippy::expect_used, clippy::panic, clippy::unwrap_used)
)]

pub mod attitude;
pub mod calibration;
pub mod compass;
pub mod console;
pub mod estimator;
pub mod fault;
pub mod health;
pub mod mpu6050;
pub mod pipeline;
pub mod serialize;
pub mod settings;
pub mod telemetry;
pub mod units;

#[cfg(all(target_os = "none", feature = "firmware"))]
#[allow(
    unsafe_code,
    missing_debug_implementations,
    reason = "registers are raw memory, and their owners have nothing to print"
)]
pub mod board;

/// Compiles the README's example with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
