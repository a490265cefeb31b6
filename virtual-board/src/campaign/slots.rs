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
/// bytes after the flight. A save is answered, unless `may_be_silent`.
pub(super) fn check(
    slots: &[u8],
    lines: &[UartLine],
    may_be_silent: bool,
    failures: &mut Vec<String>,
) {
    let mut slots = Slots(slots.to_vec());
    let found = storage::load(&mut slots).record;
    let rate_hz = found.map(|record| record.preferences.rate_hz);
    let reports = |text: &str| lines.iter().any(|line| line.text.contains(text));
    let allowed: &[u16] = match (reports("done save"), reports("failed save")) {
        (true, _) => &[SAVED_HZ],
        (_, true) => &[STORED_HZ],
        _ => &[STORED_HZ, SAVED_HZ],
    };
    if allowed.len() > 1 && !may_be_silent {
        failures.push("the save had no answer: neither done nor failed".into());
    }
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
        for (bytes, message, is_sound, may_be_silent) in [
            (&old, "", true, true),
            (&new, "", true, true),
            (&old, "", false, false),
            (&new, "", false, false),
            (&lost, "", false, true),
            (&old, "# done save: stored", false, false),
            (&new, "# done save: stored", true, false),
            (&old, "# failed save: the supply", true, false),
            (&new, "# failed save: the supply", false, false),
        ] {
            let mut failures = Vec::new();
            check(bytes, &[line(message)], may_be_silent, &mut failures);
            assert_eq!(failures.is_empty(), is_sound, "{message}: {failures:?}");
        }
    }
}
