//! Shared code of the virtual board's tests.

use std::path::PathBuf;

/// Returns the firmware image for the default board, which `cargo xtask test` builds and names.
pub fn firmware() -> PathBuf {
    image("APLOMB_FLIGHT_ELF")
}

/// Returns the image of the build without commands, MAVLink and flight log.
#[allow(dead_code, reason = "not every test file flies it")]
pub fn minimal_firmware() -> PathBuf {
    image("APLOMB_FLIGHT_ELF_MINIMAL")
}

fn image(variable: &str) -> PathBuf {
    match std::env::var_os(variable) {
        Some(path) => path.into(),
        None => panic!(
            "{variable} does not name the firmware image: \
             run `cargo xtask test`, which builds it"
        ),
    }
}
