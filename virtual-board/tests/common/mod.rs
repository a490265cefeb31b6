//! Shared code of the virtual board's tests.

use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

use virtual_board::flight::Run;
use virtual_board::profile::ProcessorPool;

/// Processors that have translated the images of this test program's flights.
#[allow(dead_code, reason = "not every test file flies with it")]
pub static POOL: LazyLock<Arc<ProcessorPool>> = LazyLock::new(Arc::default);

/// Returns a run of the firmware with a processor from [`POOL`]: the same flight in less time, but
/// without the memory protection unit and without an account of instructions.
#[allow(dead_code, reason = "not every test file flies it")]
pub fn pooled_run() -> Run {
    Run::new(firmware()).pool(&POOL)
}

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
