//! Settings of the compass: part, mount, correction, and declination of the place.

use crate::calibration::{CompassAlignment, CompassCorrection, Mount};
use crate::compass::Choice;

/// Settings of the compass. The default finds the compass by itself, mounted as the IMU is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct CompassSettings {
    /// Part.
    pub choice: Choice,
    /// Mount; `None` for that of the IMU.
    pub mount: Option<Mount>,
    /// Correction, if the compass was calibrated. Another mount leaves it invalid.
    pub correction: Option<CompassCorrection>,
    /// Declination of the place, rad, east positive: the heading is then from true north. 0 for
    /// the heading from magnetic north.
    pub declination_rad: f32,
}

impl CompassSettings {
    /// Creates the settings for this part.
    pub const fn new(choice: Choice) -> Self {
        Self {
            choice,
            mount: None,
            correction: None,
            declination_rad: 0.0,
        }
    }

    /// Returns the place in the vehicle, for an IMU with this mount.
    pub fn alignment(&self, imu_mount: Mount) -> CompassAlignment {
        CompassAlignment {
            mount: self.mount.unwrap_or(imu_mount),
            correction: self.correction,
        }
    }
}
