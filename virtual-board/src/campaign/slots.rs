//! The calibration slots of a flight with a `save`: the record before it, and the one after it.

use aplomb::settings::{Record, storage};

use crate::flight::UartLine;
use crate::slots::Slots;

/// Rate of the telemetry in the record before a save, Hz.
const STORED_HZ: u16 = 25;
/// Rate of the telemetry in the record that a save stores, Hz.
pub(super) const SAVED_HZ: u16 = 40;

/// Returns slots with a stored record.
pub(super) fn with_record() -> Vec<u8> {
    let mut record = Record::default();
    record.preferences.rate_hz = STORED_HZ;
    Slots::with_record(&record).0
}

/// Checks that a save leaves the old record or the new one, as its message reports. `slots` are the
/// bytes after the flight.
pub(super) fn check(slots: &[u8], lines: &[UartLine], failures: &mut Vec<String>) {
    let mut slots = Slots(slots.to_vec());
    let found = storage::load(&mut slots).record;
    let rate_hz = found.map(|record| record.preferences.rate_hz);
    let reports = |text: &str| lines.iter().any(|line| line.text.contains(text));
    let allowed: &[u16] = match (reports("done save"), reports("failed save")) {
        (true, _) => &[SAVED_HZ],
        (_, true) => &[STORED_HZ],
        _ => &[STORED_HZ, SAVED_HZ],
    };
    if !rate_hz.is_some_and(|rate_hz| allowed.contains(&rate_hz)) {
        failures.push(format!(
            "the slots hold a record with a rate of {rate_hz:?}, allowed are {allowed:?}"
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_record_and_one_that_its_message_denies_fail() {
        let line = |text: &str| UartLine {
            at_ns: 0,
            text: text.into(),
        };
        let old = with_record();
        let mut saved = Slots(old.clone());
        let mut record = storage::load(&mut saved).record.unwrap();
        record.preferences.rate_hz = SAVED_HZ;
        storage::save(&mut saved, &record).unwrap();
        let (new, lost) = (saved.0, Slots::erased().0);
        for (bytes, message, is_sound) in [
            (&old, "", true),
            (&new, "", true),
            (&lost, "", false),
            (&old, "# done save: stored", false),
            (&new, "# done save: stored", true),
            (&old, "# failed save: the supply", true),
            (&new, "# failed save: the supply", false),
        ] {
            let mut failures = Vec::new();
            check(bytes, &[line(message)], &mut failures);
            assert_eq!(failures.is_empty(), is_sound, "{message}: {failures:?}");
        }
    }
}
