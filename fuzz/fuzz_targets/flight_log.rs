//! Any bytes as a flight log.

#![no_main]

#[path = "../bodies/checksums.rs"]
mod checksums;
#[path = "../bodies/flight_log.rs"]
mod flight_log;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| flight_log::run(bytes));
