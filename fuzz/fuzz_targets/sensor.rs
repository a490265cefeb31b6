//! Any answers of whatever sits on the bus.

#![no_main]

#[path = "../bodies/sensor.rs"]
mod sensor;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| sensor::run(bytes));
