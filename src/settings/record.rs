//! The record: everything that is stored.

use super::preferences::Preferences;
use crate::calibration::Calibration;

/// Everything that is stored. The default is no calibration and the default preferences.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Record {
    /// Calibration of the sensor.
    pub calibration: Calibration,
    /// Preferences of the outputs.
    pub preferences: Preferences,
}
