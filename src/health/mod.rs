//! Health of an attitude: its flags, and the monitor that sets them.
//!
//! [`Flags::VALID`] is a promise: the tilt is wrong by no more than the larger of 5° and six of
//! its own σ. Therefore σ grows while samples are missing. An attitude is not `VALID`
//!
//! - with one of the flags [`Flags::INVALIDATING`];
//! - while the rates could come from a changed full scale, which has not been read back yet;
//! - while its σ exceeds 30°. While the gyroscope's offset is unknown, σ is much larger.
//!
//! ```
//! use aplomb::health::{Flags, Monitor, MonitoredSensor};
//!
//! let mut monitor = Monitor::new(&MonitoredSensor::MPU_6050);
//! assert_eq!(monitor.inspect(&[0xFF; 14], -1), Flags::REJECTED);
//! ```

mod flag_report;
mod flags;
mod monitor;
mod monitored_sensor;
#[cfg(not(feature = "firmware"))]
mod sample_monitor;
mod stuck_axis;
mod vibration;
mod work_figures;

pub use flag_report::FlagReport;
pub use flags::{BoardFlags, Flags, UnknownFlag};
pub use monitor::{DEGRADED_TILT_RAD, LOST_TILT_RAD, Monitor};
pub use monitored_sensor::MonitoredSensor;
#[cfg(not(feature = "firmware"))]
pub(crate) use sample_monitor::{SampleMonitor, Sampling};
pub(crate) use vibration::Vibration;
pub use work_figures::{CoreFigures, STACK_PATTERN, SampleFigures, Statistics, WorkFigures};
