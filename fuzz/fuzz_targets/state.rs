//! Any bytes as what a filter remembers, from a flight log or from before a reset.

#![no_main]

#[path = "../bodies/state.rs"]
mod state;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| state::run(bytes));
