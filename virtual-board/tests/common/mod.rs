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

/// Returns the image of the build without compass.
#[allow(dead_code, reason = "not every test file flies it")]
pub fn firmware_without_compass() -> PathBuf {
    image("APLOMB_FLIGHT_ELF_WITHOUT_COMPASS")
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
