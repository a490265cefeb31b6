//! Builds the programs under `rigs/`: for QEMU, or only to be linked and looked at.

use std::path::PathBuf;
use std::process::Command;

use crate::setup::Toolchain;
use crate::{build, step};

const PROFILE: &str = "rigs";

/// Builds the application for QEMU.
pub fn qemu(toolchain: &Toolchain) -> Result<PathBuf, String> {
    step::run(cargo(toolchain, PROFILE, "qemu").args(["--bin", "qemu"]))?;
    build::keep(PROFILE, "qemu", "qemu")
}

/// Builds the application that counts instructions, with one filter.
pub fn cost(toolchain: &Toolchain, filter: &str) -> Result<PathBuf, String> {
    let mut cargo = cargo(toolchain, PROFILE, "cost");
    cargo.args(["--quiet", "--bin", "cost"]);
    step::run(cargo.env("APLOMB_COST_FILTER", filter))?;
    build::keep(PROFILE, "cost", "cost")
}

/// Builds an empty image and one with the default filter in addition, optimised as the firmware is.
pub fn empty_and_kalman(toolchain: &Toolchain) -> Result<[PathBuf; 2], String> {
    let mut cargo = cargo(toolchain, "firmware", "bare");
    step::run(cargo.args(["--quiet", "--bin", "empty", "--bin", "kalman"]))?;
    let keep = |program| build::keep("firmware", program, program);
    Ok([keep("empty")?, keep("kalman")?])
}

/// Builds the proof that nothing in the library panics.
pub fn prove_no_panic(toolchain: &Toolchain) -> Result<(), String> {
    let mut cargo = cargo(toolchain, PROFILE, "bare");
    step::run(cargo.args(["--bin", "no_panic"])).map_err(|error| {
        format!(
            "{error}: if the linker misses `a_panic_is_reachable`, \
             something in the library can panic"
        )
    })
}

/// Lints all of them, with the firmware's profile: its dependencies are checked already.
pub fn lint(toolchain: &Toolchain) -> Result<(), String> {
    let mut clippy = toolchain.cargo("clippy");
    clippy.args([
        "--profile",
        "firmware",
        "-p",
        "aplomb-rigs",
        "--lib",
        "--bins",
    ]);
    clippy.args(["--features", "bare,qemu,cost"]);
    step::run(clippy.args(["--", "-D", "warnings"]))
}

fn cargo(toolchain: &Toolchain, profile: &str, feature: &str) -> Command {
    let mut cargo = toolchain.cargo("build");
    cargo.args(["--profile", profile, "-p", "aplomb-rigs"]);
    cargo.args(["--features", feature]);
    cargo
}
