//! Any bytes in the calibration slots.

#![no_main]

#[path = "../bodies/checksums.rs"]
mod checksums;
#[path = "../bodies/stored_record.rs"]
mod stored_record;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| stored_record::run(bytes));
