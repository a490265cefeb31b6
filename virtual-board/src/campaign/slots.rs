//! The calibration slots of a flight with a `save`: the record before it, and the one after it.

use aplomb::attitude::Quaternion;
use aplomb::calibration::Mount;
use aplomb::settings::{Record, storage};

use crate::flight::UartLine;
use crate::slots::Slots;

/// Rate of the telemetry in the record before a save, Hz.
const STORED_HZ: u16 = 25;
/// Rate of the telemetry in the record that a save stores, Hz.
pub(super) const SAVED_HZ: u16 = 40;

/// Returns slots with the record before a save.
pub(super) fn with_record() -> Vec<u8> {
    Slots::with_record(&record_with(STORED_HZ)).0
}

/// Returns a record with this rate. Calibration, preferences and settings of the compass differ
/// from the defaults, and change no flight: the level by 0.06°, the declination by as much.
fn record_with(rate_hz: u16) -> Record {
    let mut record = Record::default();
    record.calibration.mount = Some(Mount::Z_UP);
    record.calibration.level = Some(Quaternion {
        w: 1.0,
        x: 5.0e-4,
        y: 0.0,
        z: 0.0,
    });
    record.preferences.rate_hz = rate_hz;
    record.compass.mount = Some(Mount::Z_UP);
    record.compass.declination_rad = 1.0e-3;
    record
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
    let reports = |text: &str| lines.iter().any(|line| line.text.contains(text));
    let allowed: &[u16] = match (reports("done save"), reports("failed save")) {
        (true, _) => &[SAVED_HZ],
        (_, true) => &[STORED_HZ],
        _ => &[STORED_HZ, SAVED_HZ],
    };
    if allowed.len() > 1 && !may_be_silent {
        failures.push("the save had no answer: neither done nor failed".into());
    }
    let is_allowed = |&rate_hz: &u16| found == Some(record_with(rate_hz));
    if !allowed.iter().any(is_allowed) {
        failures.push(format!(
            "the slots hold {found:?}, allowed is the record of before with a rate of {allowed:?}"
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
        let saved = |record: &Record| {
            let mut slots = Slots(old.clone());
            storage::save(&mut slots, record).unwrap();
            slots.0
        };
        let new = saved(&record_with(SAVED_HZ));
        let mut without_level = record_with(SAVED_HZ);
        without_level.calibration.level = None;
        let (lost, poorer) = (Slots::erased().0, saved(&without_level));
        for (bytes, message, is_sound, may_be_silent) in [
            (&old, "", true, true),
            (&new, "", true, true),
            (&old, "", false, false),
            (&new, "", false, false),
            (&lost, "", false, true),
            (&poorer, "# done save: stored", false, false),
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
