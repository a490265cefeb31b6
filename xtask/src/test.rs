//! Every check and test of the project, in the order in which a mistake shows soonest.

use std::path::Path;
use std::time::Instant;

use crate::build::{self, BOARDS, Firmware};
use crate::setup::{self, Toolchain};
use crate::{agree, api, cost, examples, faults, package, panics, results, rigs, size, step};

/// Runs all of it.
pub fn run() -> Result<(), String> {
    let start = Instant::now();
    eprintln!("   for this computer: {}", Toolchain::Own.compiler());
    step::timed("formatting", || {
        component("rustfmt", "fmt")?;
        cargo(&["fmt", "--all", "--", "--check"])?;
        examples::check_format()
    })?;
    step::timed("figures on the pages", results::check)?;
    step::timed("lints, host", || {
        component("clippy", "clippy")?;
        let mut clippy = host_cargo("clippy");
        step::run(clippy.args(["--workspace", "--all-targets", "--", "-D", "warnings"]))
    })?;
    step::timed("host tests", || {
        let mut test = host_cargo("test");
        step::run(test.args([
            "-p",
            "aplomb",
            "-p",
            "xtask",
            "--features",
            "aplomb/mavlink",
        ]))?;
        examples::run_on_host()
    })?;
    step::timed("tests of the program `aplomb`", || {
        // Whole recordings run through every filter, which takes minutes without optimisation.
        step::run(host_cargo("test").args(["--profile", "host", "-p", "aplomb-cli"]))
    })?;
    step::timed("documentation", || {
        let mut doc = host_cargo("doc");
        doc.env("RUSTDOCFLAGS", "-D warnings");
        step::run(doc.args(["--no-deps", "--lib", "-p", "aplomb", "-p", "virtual-board"]))
    })?;
    step::timed("the package", package::check)?;
    step::timed("licences and sources of dependencies", check_dependencies)?;

    let toolchain = Toolchain::for_target()?;
    eprintln!("   for the target: {}", toolchain.compiler());
    step::timed("lints, target", || {
        for board in BOARDS {
            step::run(toolchain.cargo("clippy").args([
                "--release",
                "--lib",
                "--bin",
                "flight",
                "--features",
                &board.feature(),
                "--",
                "-D",
                "warnings",
            ]))?;
        }
        let mut clippy = toolchain.cargo("clippy");
        clippy.args(["--release", "--example", "rtic", "--example", "polling"]);
        clippy.args(["--features", &build::Board::default().feature()]);
        step::run(clippy.args(["--", "-D", "warnings"]))?;
        rigs::lint(&toolchain)?;
        // The library alone, as someone else's firmware uses it.
        step::run(toolchain.cargo("clippy").args([
            "--release",
            "--lib",
            "--features",
            "defmt",
            "--",
            "-D",
            "warnings",
        ]))
    })?;
    step::timed("documentation, target", || {
        // What docs.rs shows.
        let mut doc = toolchain.cargo("rustdoc");
        doc.args(["--release", "--lib", "--features"]);
        doc.arg(build::Board::default().feature());
        step::run(doc.args(["--", "-D", "warnings"]))
    })?;
    step::timed("the public API", || api::check(&toolchain, false))?;
    step::timed("nothing in the library panics", || {
        rigs::prove_no_panic(&toolchain)
    })?;
    let kalman_flash_bytes = step::timed("the size of the Kalman filter alone", || {
        let added = size::check_kalman(&toolchain)?;
        eprintln!("   {added} bytes of flash");
        Ok(added)
    })?;
    let mut images = Vec::new();
    for board in BOARDS {
        let elf = Firmware { board, mount: None }.build(&toolchain)?;
        let sizes = size::check(&elf)?;
        panics::check(&elf)?;
        eprintln!("   {} bytes of flash, {} of RAM", sizes.flash, sizes.ram);
        images.push((board, elf));
    }

    let examples = step::timed("examples", || examples::build(&toolchain))?;

    let virtual_board = build::virtual_board()?;
    step::timed("figures of the firmware", || {
        results::hold(&virtual_board, &images, kalman_flash_bytes)
    })?;
    step::timed("virtual board tests", || {
        let mut test = host_cargo("test");
        test.args(["--profile", "host", "-p", "virtual-board"]);
        for (board, elf) in &images {
            let name = board.name.to_uppercase().replace('-', "_");
            test.env(format!("APLOMB_FLIGHT_ELF_{name}"), elf);
        }
        test.env("APLOMB_FLIGHT_ELF", &images[0].1);
        for (name, elf) in &examples {
            test.env(format!("APLOMB_EXAMPLE_{name}"), elf);
        }
        step::run(&mut test)
    })?;
    step::timed("flights with faults by chance", || {
        faults::short(&virtual_board, &images[0].1)
    })?;
    agree::run(&toolchain, &virtual_board, &images[0].1)?;
    cost::run()?;
    eprintln!("\nall passed in {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// Runs cargo-deny where it is installed: to build it takes five minutes of CPU.
fn check_dependencies() -> Result<(), String> {
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
    eprintln!(
        "   skipped: cargo-deny is not installed; `cargo install cargo-deny --locked` installs it"
    );
    Ok(())
}

/// A cargo command on this computer. The emulator asks for a newer compiler than it needs.
pub fn host_cargo(subcommand: &str) -> std::process::Command {
    let mut command = step::command(Path::new("cargo"));
    command.args([subcommand, "--ignore-rust-version"]);
    command
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
