//! Calibration of one sensor: its offsets, scales, mount and temperature model, and their fits.
//!
//! | module | job |
//! |---|---|
//! | [`stationary`] | detects that the sensor is stationary, and averages its readings meanwhile |
//! | [`accelerometer`] | fits offset, scale and cross-axis terms to stationary poses |
//! | [`gyroscope`] | fits scale and cross-axis terms to turns between stationary poses |
//! | [`compass`] | fits hard and soft iron of a compass to readings in motion |
//! | [`level`] | finds the small rotation between the mounted sensor and the body |
//! | [`mount_finder`] | finds which of the 24 mounts the sensor has |
//! | [`temperature`] | fits the gyroscope's offset over the die temperature |
//!
//! All fits but the compass's start from the [`StationaryMean`]s of the detector. The gyroscope's
//! takes the turns between them too. The results are the fields of a [`Calibration`], in SI units
//! and sensor axes: a new mount or full scale leaves them valid.
//!
//! ```
//! use aplomb::calibration::{
//!     Calibration, ImuReading, NoiseModel, SensorSetup, StationaryDetector, StationaryProgress,
//! };
//!
//! // ±2000 °/s and ±16 g behind the 188 Hz filter, 1000 samples a second.
//! let noise = NoiseModel::new(&SensorSetup {
//!     gyroscope_counts_per_degree_s: 16.4,
//!     accelerometer_counts_per_g: 2048.0,
//!     gyroscope_bandwidth_hz: 188.0,
//!     accelerometer_bandwidth_hz: 184.0,
//!     sample_rate_hz: 1000.0,
//! });
//! let mut detector = StationaryDetector::new(&noise, 500);
//! let mut calibration = Calibration::NONE;
//! while calibration.gyroscope.is_none() {
//!     // Your readings come from the sensor.
//!     let reading = ImuReading {
//!         gyroscope: [33, -16, 8],
//!         accelerometer: [0, 0, 2048],
//!         temperature_celsius: 25.0,
//!     };
//!     match detector.update(&reading) {
//!         StationaryProgress::Collecting => {}
//!         StationaryProgress::Moved(reason) => println!("start over: {reason}"),
//!         StationaryProgress::Done(mean) => {
//!             calibration.set_gyroscope_offset(mean.gyroscope_offset(&noise));
//!         }
//!     }
//! }
//! let offset = calibration.gyroscope.unwrap().offset_rad_s;
//! assert!((offset.x.to_degrees() - 33.0 / 16.4).abs() < 1e-4);
//! ```

pub mod accelerometer;
mod axis;
mod cholesky;
pub mod compass;
mod gravity;
pub mod gyroscope;
pub mod level;
mod matrix;
mod model;
mod mount;
pub mod mount_finder;
mod noise;
mod plausible;
pub mod stationary;
pub mod temperature;

pub use axis::{Axis, ParseAxisError, SignedAxis};
pub use compass::{CompassAlignment, CompassCorrection};
pub use matrix::{Matrix3, SymmetricMatrix};
pub use model::{AccelerometerCorrection, Calibration, GyroscopeOffset, TemperatureModel};
pub use mount::{Mount, ParseMountError};
pub use noise::{NoiseModel, SensorSetup};
pub use plausible::ImplausibleCalibration;
pub use stationary::{
    ImuReading, MotionReason, StationaryDetector, StationaryMean, StationaryProgress,
};
