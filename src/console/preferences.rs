//! Check that the UART can carry a format at a rate.

use super::command::{BAUD_RATES, RATES_HZ};
use crate::settings::Preferences;
use crate::telemetry;

/// Returns preferences that the UART can carry: the given ones, with defaults for impossible
/// values.
///
/// ```
/// use aplomb::console::usable_preferences;
/// use aplomb::settings::Preferences;
///
/// let mut preferences = Preferences::default();
/// preferences.baud = 1;
/// assert_eq!(usable_preferences(preferences).baud, 115_200);
/// ```
pub fn usable_preferences(preferences: Preferences) -> Preferences {
    let defaults = Preferences::default();
    let baud = if BAUD_RATES.contains(&preferences.baud) {
        preferences.baud
    } else {
        defaults.baud
    };
    // The flight log needs a high baud rate.
    let format = if telemetry::largest_rate_hz(preferences.format, baud) > 0 {
        preferences.format
    } else {
        defaults.format
    };
    let max_hz = telemetry::largest_rate_hz(format, baud).min(u32::from(*RATES_HZ.end()));
    Preferences {
        format,
        rate_hz: preferences
            .rate_hz
            .max(*RATES_HZ.start())
            .min(max_hz as u16),
        baud,
    }
}
