//! The library's public API, held to a list that is committed.
//!
//! rustdoc describes the library as JSON, once for this computer and once for the target, where
//! `aplomb::board` exists too. `tests/public_api.rs` makes the list of it and compares.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::{Command, ExitCode};

use crate::build::Board;
use crate::setup::{TARGET, Toolchain};
use crate::step;

/// Names the real rustdoc in a run of this program in its place.
const RUSTDOC: &str = "APLOMB_RUSTDOC";

/// Compares, or with `bless` writes the list anew.
pub fn check(toolchain: &Toolchain, bless: bool) -> Result<(), String> {
    let mut host = step::command("cargo".as_ref());
    host.args(["rustdoc", "--ignore-rust-version"]);
    // The profiles of the tests and of the firmware, so that no dependency is built again.
    host.arg("--release");
    let mut target = toolchain.cargo("rustdoc");
    target.args(["--profile", "firmware"]);
    describe(host, "mavlink,defmt")?;
    describe(target, &Board::default().features())?;
    let folder = step::target_folder();
    let described: Vec<PathBuf> = [folder.join("doc"), folder.join(TARGET).join("doc")]
        .iter()
        .map(|folder| folder.join("aplomb.json"))
        .collect();
    let described = std::env::join_paths(described)
        .map_err(|error| format!("the target folder's name is no part of a list: {error}"))?;
    // With the features of all tests: otherwise its dependencies would be built twice.
    let mut test = step::host_cargo("test");
    test.args(["--release", "--workspace", "--test", "public_api"]);
    test.args(["--", "--nocapture"]);
    test.env("APLOMB_RUSTDOC_JSON", described);
    if bless {
        test.env("APLOMB_BLESS", "1");
    }
    step::run(&mut test)
}

/// Has rustdoc write `aplomb.json`.
fn describe(mut cargo: Command, features: &str) -> Result<(), String> {
    let rustdoc = cargo
        .get_envs()
        .find_map(|(name, value)| (name == "RUSTDOC").then_some(value)?)
        .map_or_else(|| "rustdoc".into(), OsString::from);
    let this = std::env::current_exe()
        .map_err(|error| format!("cannot find this program's own file: {error}"))?;
    cargo.env(RUSTDOC, rustdoc).env("RUSTDOC", this);
    cargo.args(["--quiet", "-p", "aplomb", "--lib", "--features", features]);
    step::run(cargo.args(["--", "-Zunstable-options", "--output-format", "json"]))
}

/// Stands for rustdoc where cargo calls this program by that name.
///
/// JSON is an unstable format, which a stable rustdoc writes with `RUSTC_BOOTSTRAP`. Set for all of
/// cargo, the variable would rebuild every crate whose build script looks at it.
pub fn run_as_rustdoc() -> Option<ExitCode> {
    let rustdoc = std::env::var_os(RUSTDOC)?;
    let status = Command::new(rustdoc)
        .args(std::env::args_os().skip(1))
        .env("RUSTC_BOOTSTRAP", "1")
        .status();
    Some(match status {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    })
}
