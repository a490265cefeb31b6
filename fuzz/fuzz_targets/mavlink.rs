//! Any bytes from a ground station.

#![no_main]

#[path = "../bodies/mavlink.rs"]
mod mavlink;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| mavlink::run(bytes));
