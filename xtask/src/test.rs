//! Every check and test of the project, in the order in which a mistake shows soonest.

use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::build::{self, BOARDS, Board, Firmware};
use crate::setup::{self, Toolchain};
use crate::{
    agree, api, c_library, cost, examples, faults, package, panics, python, recordings, results,
    rigs, size, step, tools,
};

/// Runs all checks and tests.
pub fn run() -> Result<(), String> {
    let start = Instant::now();
    eprintln!("   for this computer: {}", Toolchain::Own.compiler());
    check_on_host()?;
    let toolchain = Toolchain::for_target()?;
    eprintln!("   for the target: {}", toolchain.compiler());
    let kalman_flash_bytes = check_for_target(&toolchain)?;
    let images = build_images(&toolchain)?;
    let without_compass = build_without_compass(&toolchain)?;
    let minimal = build_minimal(&toolchain)?;
    let examples = step::timed("examples", || examples::build(&toolchain))?;
    let virtual_board = build::virtual_board()?;
    step::timed("figures of the firmware", || {
        let mut flash_bytes = vec![("kalman_flash_bytes", kalman_flash_bytes)];
        for (key, elf) in [
            ("without_compass_flash_bytes", &without_compass),
            ("minimal_flash_bytes", &minimal),
            ("rtic_flash_bytes", examples::rtic(&examples)?),
        ] {
            flash_bytes.push((key, size::measure(elf)?.flash));
        }
        results::hold(&virtual_board, &images, &flash_bytes)
    })?;
    test_on_host(&images, &without_compass, &minimal, &examples)?;
    step::timed("random flights with random faults", || {
        faults::fly_default(&virtual_board, &images[0].1)
    })?;
    agree::run(&toolchain, &virtual_board, &images[0].1)?;
    cost::run()?;
    c_library::check()?;
    python::run()?;
    eprintln!("\n{}", step::summary(start));
    Ok(())
}

/// Checks format, lints, documentation, package and dependencies on this computer.
fn check_on_host() -> Result<(), String> {
    step::timed("formatting", || {
        component("rustfmt", "fmt")?;
        cargo(&["fmt", "--all", "--", "--check"])?;
        examples::check_format()
    })?;
    step::timed("figures on the pages", results::check)?;
    step::timed("lints, host", || {
        component("clippy", "clippy")?;
        let mut clippy = step::host_cargo("clippy");
        clippy.args(["--release", "--workspace", "--all-targets"]);
        step::run(clippy.args(["--", "-D", "warnings"]))
    })?;
    step::timed("documentation", || {
        let mut doc = step::host_cargo("doc");
        doc.env("RUSTDOCFLAGS", "-D warnings");
        step::run(doc.args(["--release", "--no-deps", "--lib", "--workspace"]))
    })?;
    step::timed("the package", package::check)?;
    step::timed("licences and sources of dependencies", check_dependencies)
}

/// Checks lints, documentation, public API, panics and the filter's size for the target. Returns
/// the flash of the Kalman filter alone, in bytes.
fn check_for_target(toolchain: &Toolchain) -> Result<u64, String> {
    step::timed("lints, target", || lint_for_target(toolchain))?;
    step::timed("documentation, target", || {
        // What docs.rs shows.
        let mut doc = toolchain.cargo("rustdoc");
        doc.args(["--profile", "firmware", "--lib", "--features"]);
        doc.arg(Board::default().features());
        step::run(doc.args(["--", "-D", "warnings"]))
    })?;
    step::timed("the public API", || api::check(toolchain, false))?;
    step::timed("nothing in the library panics", || {
        rigs::prove_no_panic(toolchain)
    })?;
    step::timed("the size of the Kalman filter alone", || {
        let added = size::check_kalman(toolchain)?;
        eprintln!("   {added} bytes of flash");
        Ok(added)
    })
}

/// Lints the firmware, the examples, the programs under `rigs/` and the library alone.
fn lint_for_target(toolchain: &Toolchain) -> Result<(), String> {
    let clippy = |arguments: &[&str]| {
        let mut clippy = toolchain.cargo("clippy");
        clippy.args(["--profile", "firmware"]).args(arguments);
        step::run(clippy.args(["--", "-D", "warnings"]))
    };
    for board in BOARDS {
        clippy(&["--lib", "--bin", "flight", "--features", &board.features()])?;
    }
    let board = Board::default().feature();
    clippy(&["--bin", "flight", "--features", &board])?;
    clippy(&[
        "--example",
        "rtic",
        "--example",
        "polling",
        "--features",
        &board,
    ])?;
    rigs::lint(toolchain)?;
    // The library alone, as someone else's firmware uses it.
    clippy(&["--lib", "--features", "defmt"])
}

/// Builds the firmware of each board and checks its size and its panics.
fn build_images(toolchain: &Toolchain) -> Result<Vec<(Board, PathBuf)>, String> {
    let mut images = Vec::new();
    for board in BOARDS {
        let elf = Firmware::full(board).build(toolchain)?;
        let sizes = size::check(&elf)?;
        panics::check(&elf)?;
        eprintln!("   {} bytes of flash, {} of RAM", sizes.flash, sizes.ram);
        images.push((board, elf));
    }
    Ok(images)
}

/// Builds the firmware without compass of the default board and checks its size and its panics.
fn build_without_compass(toolchain: &Toolchain) -> Result<PathBuf, String> {
    let elf = Firmware::without_compass(Board::default()).build(toolchain)?;
    let sizes = size::check_without_compass(&elf)?;
    panics::check(&elf)?;
    eprintln!("   {} bytes of flash, {} of RAM", sizes.flash, sizes.ram);
    Ok(elf)
}

/// Builds the minimal firmware of the default board and checks its size and its panics.
fn build_minimal(toolchain: &Toolchain) -> Result<PathBuf, String> {
    let elf = Firmware::minimal(Board::default()).build(toolchain)?;
    let sizes = size::check_minimal(&elf)?;
    panics::check(&elf)?;
    eprintln!("   {} bytes of flash, {} of RAM", sizes.flash, sizes.ram);
    Ok(elf)
}

/// Runs all tests of the workspace; the virtual board's with these images and examples.
fn test_on_host(
    images: &[(Board, PathBuf)],
    without_compass: &Path,
    minimal: &Path,
    examples: &[(&str, PathBuf)],
) -> Result<(), String> {
    step::timed("tests", || {
        let folder = recordings::folder();
        if !folder.is_dir() {
            step::skip("tests with recordings", &recordings::absence(&folder));
        }
        for set in recordings::missing_sets(&folder) {
            let work = format!("tests with recordings of {set}");
            step::skip(&work, &recordings::absence(&folder.join(set)));
        }
        tools::report_absent()?;
        let mut test = step::host_cargo("test");
        // Each test runs in the folder of its package.
        let folder = std::path::absolute(&folder).map_err(|error| error.to_string())?;
        test.env(recordings::VARIABLE, folder);
        test.args(["--release", "--workspace"]);
        for (board, elf) in images {
            let name = board.name.to_uppercase().replace('-', "_");
            test.env(format!("APLOMB_FLIGHT_ELF_{name}"), elf);
        }
        test.env("APLOMB_FLIGHT_ELF", &images[0].1);
        test.env("APLOMB_FLIGHT_ELF_WITHOUT_COMPASS", without_compass);
        test.env("APLOMB_FLIGHT_ELF_MINIMAL", minimal);
        for (name, elf) in examples {
            test.env(format!("APLOMB_EXAMPLE_{name}"), elf);
        }
        step::run(&mut test)
    })?;
    step::timed("the example for this computer", examples::run_on_host)
}

/// Runs cargo-deny where it is installed: to build it takes five minutes of CPU.
pub fn check_dependencies() -> Result<(), String> {
    if step::is_installed("cargo-deny") {
        return cargo(&[
            "deny",
            "--workspace",
            "check",
            "licenses",
            "bans",
            "sources",
        ]);
    }
    step::skip(
        "licences and sources of dependencies",
        "cargo-deny is not installed; `cargo install cargo-deny --locked` installs it",
    );
    Ok(())
}

fn cargo(arguments: &[&str]) -> Result<(), String> {
    step::run(step::command(Path::new("cargo")).args(arguments))
}

/// Makes sure that a part of the Rust toolchain is there.
fn component(name: &str, subcommand: &str) -> Result<(), String> {
    let is_there = || {
        step::output(step::command(Path::new("cargo")).args([subcommand, "--version"])).is_some()
    };
    if is_there() {
        return Ok(());
    }
    if setup::may_download() {
        step::run(step::command(Path::new("rustup")).args(["component", "add", name]))?;
    }
    if is_there() {
        Ok(())
    } else {
        Err(format!(
            "{name} is missing: run `rustup component add {name}`, then this again"
        ))
    }
}
