//! Settings: everything that the module keeps in flash.
//!
//! A [`Record`] holds the calibration and the [`Preferences`] of the outputs. [`storage`] writes it
//! to flash such that a power cut at any moment leaves the old record or the new one.
//!
//! ```
//! use aplomb::settings::{OutputFormat, Record};
//!
//! let mut record = Record::default();
//! record.preferences.format = "teleplot".parse()?;
//! record.preferences.rate_hz = 100;
//! assert_eq!(record.preferences.format, OutputFormat::Teleplot);
//! # Ok::<(), aplomb::settings::ParseOutputFormatError>(())
//! ```

mod compass;
mod encoding;
mod preferences;
mod record;
pub mod storage;

pub use compass::CompassSettings;
pub use preferences::{OutputFormat, ParseOutputFormatError, Preferences};
pub use record::Record;
