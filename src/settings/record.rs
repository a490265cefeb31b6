//! The record: everything that is stored.

use super::compass::CompassSettings;
use super::preferences::Preferences;
use crate::calibration::Calibration;
use crate::compass::Choice;

/// Everything that is stored. The default is no calibration and the default preferences.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Record {
    /// Calibration of the sensor.
    pub calibration: Calibration,
    /// Preferences of the outputs.
    pub preferences: Preferences,
    /// Settings of the compass.
    pub compass: CompassSettings,
}

impl Record {
    /// Creates the default record, with this choice of the compass.
    pub fn with_compass(choice: Choice) -> Self {
        Self {
            compass: CompassSettings::new(choice),
            ..Self::default()
        }
    }
}
