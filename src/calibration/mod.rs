//! From what the sensor says to what it means: how it is mounted, what is wrong with it, and what of that is stored.

mod encoding;
mod mount;
mod record;
mod startup;
pub mod storage;

pub use mount::Mount;
pub use record::{
    AccelerometerCorrection, Calibration, GyroscopeOffset, OutputFormat, Preferences, Record,
    TemperatureModel,
};
pub use startup::{AtRest, Progress, StartupAverage, StartupScale};
