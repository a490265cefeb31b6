//! The MPU-6050 and its successors: what they are told, and what they say.
//!
//! `registers` is the datasheet's map and nothing else, `config` the settings and their scales, `steps` the
//! writes that set them, `check` what is read back of them, `part` the table of chips, `burst` the 14 bytes of one sample, and `driver`
//! the blocking configuration over any `embedded-hal` bus, `self_test` what its self-test says. Reading samples at speed is the
//! board's business; it only has to hand over a [`Burst`]. An asynchronous bus needs [`Step`], [`Check`] and [`Burst`] alone:
//! `examples/embassy` shows how.
//!
//! "Register map" means RM-MPU-6000A revision 4.2, "product specification" PS-MPU-6000A 3.4.

mod burst;
mod check;
mod config;
mod driver;
mod part;
pub mod registers;
mod self_test;
mod steps;

pub use burst::{
    AccelerometerCounts, BURST_LENGTH, Burst, GyroscopeCounts, RawSample, TemperatureCounts,
};
pub use check::{Check, Condition};
pub use config::{AccelerometerRange, Config, GyroscopeRange, LowPass};
pub use driver::{ADDRESSES, Error, Mpu6050, Operation, ProbeFailure};
pub use part::{PARTS, Part, Temperature};
pub use self_test::{AxisTest, SelfTest, TOLERANCE as SELF_TEST_TOLERANCE};
pub use steps::{Step, Steps};
