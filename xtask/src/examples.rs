//! The examples: those for the target are built, and the virtual board's tests fly them; the one
//! for the computer runs.

use std::path::PathBuf;
use std::process::Command;

use crate::build::Board;
use crate::setup::{TARGET, Toolchain};
use crate::step::{self, target_folder};

/// Embassy's example is a workspace of its own.
const EMBASSY: &str = "examples/embassy";

/// The line of the example `host` for the largest roll of its motion, 29.8 degrees.
const HOST_LINE: &str = "  6.0 s  roll  29.8";

/// The first line of the example `host` on the log of a sensor that lies face up.
const LEVEL_LINE: &str = "0.0 s  roll   0.00  pitch   0.00";

/// Builds RTIC's, the polling one and Embassy's. Returns the names and the ELF files of those that
/// are flown. The polling one is not: it polls a bus and a pin, so its emulation takes fifty times
/// the flown time.
pub fn build(toolchain: &Toolchain) -> Result<[(&'static str, PathBuf); 2], String> {
    let feature = Board::default().feature();
    let mut cargo = toolchain.cargo("build");
    cargo.args(["--profile", "firmware", "--features", &feature]);
    step::run(cargo.args(["--example", "rtic", "--example", "polling"]))?;

    let target = target_folder();
    let of_embassy = target.join("embassy");
    let mut cargo = toolchain.cargo("build");
    cargo.current_dir(crate::root().join(EMBASSY));
    step::run(cargo.args(["--release", "--target-dir"]).arg(&of_embassy))?;
    Ok([
        ("RTIC", target.join(TARGET).join("firmware/examples/rtic")),
        (
            "EMBASSY",
            of_embassy.join(TARGET).join("release/aplomb-embassy"),
        ),
    ])
}

/// Returns RTIC's ELF file among those that [`build`] has built.
pub fn rtic<'a>(examples: &'a [(&str, PathBuf)]) -> Result<&'a PathBuf, String> {
    let rtic = examples.iter().find(|(name, _)| *name == "RTIC");
    let (_, elf) = rtic.ok_or("there is no example for RTIC")?;
    Ok(elf)
}

/// Checks the format of those that `cargo fmt --all` does not see.
pub fn check_format() -> Result<(), String> {
    let mut cargo = step::command("cargo".as_ref());
    cargo.current_dir(crate::root().join(EMBASSY));
    step::run(cargo.args(["fmt", "--check"]))
}

/// Runs the one for the computer and checks its output.
pub fn run_on_host() -> Result<(), String> {
    // With the features of the tests, so that the library is not built twice.
    let mut build = step::host_cargo("build");
    build.args(["--quiet", "--release", "--workspace"]);
    step::run(build.args(["--example", "host"]))?;
    let output = step::output(&mut host()).ok_or("the example `host` failed")?;
    if !output.contains(HOST_LINE) {
        return Err(format!(
            "the example `host` does not print `{HOST_LINE}`:\n{output}"
        ));
    }
    // A log of the project has the sensor's Z axis up.
    let mut with_log = host();
    with_log.arg("cli/tests/data/roll.csv");
    let output = step::output(&mut with_log).ok_or("the example `host` failed on a log")?;
    if output.contains(LEVEL_LINE) {
        return Ok(());
    }
    Err(format!(
        "the example `host` does not begin with `{LEVEL_LINE}` on a log:\n{output}"
    ))
}

/// Returns the command that runs the one for the computer.
fn host() -> Command {
    step::command(&target_folder().join("release/examples/host"))
}
