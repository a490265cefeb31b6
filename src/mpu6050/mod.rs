//! Driver of the MPU-6050 and its successors.
//!
//! | module | job |
//! |---|---|
//! | [`registers`] | the datasheet's register map, and nothing else |
//! | `config` | settings and their scales |
//! | `steps` | writes that configure the sensor |
//! | `check` | registers that are read back, and their expected values |
//! | `part` | table of supported chips |
//! | `burst` | the 14 bytes of one sample |
//! | `driver` | blocking configuration over any `embedded-hal` bus |
//! | `error` | errors of the driver |
//! | `self_test` | result of the sensor's self-test |
//!
//! Reading samples at speed is the board's job; it only has to hand over a [`Burst`]. An
//! asynchronous bus needs [`Step`], [`Check`] and [`Burst`] alone: `examples/embassy` shows how.
//!
//! "Register map" means RM-MPU-6000A revision 4.2, "product specification" PS-MPU-6000A 3.4.
//!
//! ```
//! use aplomb::mpu6050::{Config, RawSample};
//!
//! let config = Config::default();
//! // 14 bytes as the bus delivers them: 1 g along Z, 0 counts of temperature, 10 °/s about X.
//! let sample = RawSample::decode(&[0, 0, 0, 0, 8, 0, 0, 0, 0, 164, 0, 0, 0, 0]);
//! let force = sample.accelerometer.to_m_s2(config.accelerometer_range);
//! let rate = sample.gyroscope.to_rad_s(config.gyroscope_range);
//! assert!((force.z - 9.807).abs() < 1e-3);
//! assert!((rate.x.to_degrees() - 10.0).abs() < 1e-3);
//! ```

mod burst;
mod check;
mod config;
mod driver;
mod error;
mod part;
pub mod registers;
mod self_test;
mod steps;

pub use burst::{
    AccelerometerCounts, BURST_LENGTH, Burst, GyroscopeCounts, RawSample, TemperatureCounts,
};
pub use check::{Check, ReadBack, SettingsState};
pub use config::{AccelerometerRange, Config, GyroscopeRange, LowPass, ParseRangeError};
pub use driver::Mpu6050;
pub use error::{Error, Operation, ProbeFailure};
pub use part::{PARTS, Part, Temperature};
pub use registers::ADDRESSES;
pub use self_test::{AxisTest, SelfTest, TOLERANCE as SELF_TEST_TOLERANCE};
pub use steps::{Step, Steps};
