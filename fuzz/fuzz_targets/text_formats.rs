//! Any bytes as what the module sends in text, as a teapot packet, and as a line of `bursts.csv`.

#![no_main]

#[path = "../bodies/text_formats.rs"]
mod text_formats;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| text_formats::run(bytes));
