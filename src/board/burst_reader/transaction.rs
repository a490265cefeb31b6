//! Purpose of the present steps on the bus.

/// Transaction that the present steps perform.
#[derive(Clone, Copy)]
pub(super) enum Transaction {
    /// Reads a burst.
    Burst,
    /// Reads some of the sensor's settings back.
    SettingsCheck,
    /// Reads registers of the compass.
    CompassRead,
    /// Writes a setting of the compass.
    CompassWrite {
        /// Events of the write that have come.
        events: u8,
    },
}

impl Transaction {
    /// Returns whether the steps read a burst. Also true between two transactions.
    #[inline(always)]
    pub(super) const fn is_burst(self) -> bool {
        matches!(self, Self::Burst)
    }

    /// Returns whether the compass is on the bus, instead of the sensor.
    #[inline(always)]
    pub(super) const fn is_of_compass(self) -> bool {
        matches!(self, Self::CompassRead | Self::CompassWrite { .. })
    }
}
