//! Shared code of the virtual board's tests.

use std::path::PathBuf;

/// The firmware image for the default board, which `cargo xtask test` builds and names.
pub fn firmware() -> PathBuf {
    match std::env::var_os("APLOMB_FLIGHT_ELF") {
        Some(path) => path.into(),
        None => panic!(
            "APLOMB_FLIGHT_ELF does not name the firmware image: \
             run `cargo xtask test`, which builds it"
        ),
    }
}
