//! The record in use, saved or not, in memory that a crash or the watchdog leaves as it is.

use aplomb::board::retained::{self, RECORD_LENGTH};
use aplomb::settings::Record;
use aplomb::settings::storage::{self, LONGEST_RECORD};

const _: () = assert!(LONGEST_RECORD == RECORD_LENGTH);

/// Returns the record that was in use before a reset. Without one, the kept tilt is about unknown
/// axes, and is forgotten.
pub fn at_start() -> Option<Record> {
    let record = get();
    if record.is_none() {
        retained::keep(None);
    }
    record
}

/// Returns the record in use.
#[inline(never)]
pub fn get() -> Option<Record> {
    storage::from_bytes(&retained::record()).record
}

/// Keeps this record. Call it only in init or in the telemetry task: the supervisor reads it.
#[inline(never)]
pub fn keep(record: &Record) {
    let bytes = storage::to_bytes(record);
    retained::keep_record(&bytes.unwrap_or([0; LONGEST_RECORD]));
}
