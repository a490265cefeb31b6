//! From what the sensor says to what it means: how it is mounted, what is wrong with it, and what of that is stored.
//!
//! [`rest`] decides whether the sensor rests and averages what it reads; everything else is made of such
//! averages: the gyroscope's offset, [`accelerometer`]'s poses, [`level`] and the mount, and the points of
//! [`temperature`].

pub mod accelerometer;
mod encoding;
pub mod level;
mod mount;
mod record;
pub mod rest;
pub mod storage;
pub mod temperature;

pub use mount::{Axis, Mount};
pub use record::{
    AccelerometerCorrection, Calibration, GyroscopeOffset, OutputFormat, Preferences, Record,
    TemperatureModel,
};
pub use rest::{AtRest, MotionReason, RestProgress, RestScale, RestWatch};
