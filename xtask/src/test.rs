//! Every check and test of the project, in the order in which a mistake shows soonest.

use std::path::Path;
use std::time::Instant;

use crate::build::{self, BOARDS, Firmware};
use crate::setup::{self, Toolchain};
use crate::{cost, faults, panics, size, step};

/// Seconds of simulated flight whose bursts QEMU replays.
const REPLAYED_SECONDS: &str = "10";

/// Runs all of it.
pub fn run() -> Result<(), String> {
    let start = Instant::now();
    step::timed("formatting", || {
        component("rustfmt", "fmt")?;
        cargo(&["fmt", "--all", "--", "--check"])
    })?;
    step::timed("lints, host", || {
        component("clippy", "clippy")?;
        let mut clippy = host_cargo("clippy");
        step::run(clippy.args(["--workspace", "--all-targets", "--", "-D", "warnings"]))
    })?;
    step::timed("host tests", || {
        step::run(host_cargo("test").args(["-p", "aplomb", "-p", "xtask"]))
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

    let toolchain = Toolchain::for_target()?;
    step::timed("lints, target", || {
        for features in BOARDS
            .map(|board| board.feature())
            .iter()
            .map(String::as_str)
            .chain(["qemu", "cost", "proof"])
        {
            let bin = match features {
                "qemu" | "cost" => features,
                "proof" => "no_panic",
                _ => "flight",
            };
            step::run(toolchain.cargo("clippy").args([
                "--release",
                "--lib",
                "--bin",
                bin,
                "--features",
                features,
                "--",
                "-D",
                "warnings",
            ]))?;
        }
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
    step::timed("nothing in the library panics", || {
        panics::prove_library(&toolchain)
    })?;
    let mut images = Vec::new();
    for board in BOARDS {
        let elf = Firmware { board, mount: None }.build(&toolchain)?;
        let sizes = size::check(&elf)?;
        panics::check(&elf)?;
        eprintln!("   {} bytes of flash, {} of RAM", sizes.flash, sizes.ram);
        images.push((board, elf));
    }

    let virtual_board = build::virtual_board()?;
    step::timed("virtual board tests", || {
        let mut test = host_cargo("test");
        test.args(["--profile", "host", "-p", "virtual-board"]);
        for (board, elf) in &images {
            let name = board.name.to_uppercase().replace('-', "_");
            test.env(format!("APLOMB_FLIGHT_ELF_{name}"), elf);
        }
        test.env("APLOMB_FLIGHT_ELF", &images[0].1);
        step::run(&mut test)
    })?;
    step::timed("flights with faults by chance", || {
        faults::short(&virtual_board, &images[0].1)
    })?;
    let flight = build::target_folder().join("fly-for-qemu");
    step::timed("a flight for QEMU to replay", || {
        let mut fly = step::command(&virtual_board);
        fly.args(["fly", "--seconds", REPLAYED_SECONDS, "--output"]);
        step::run(fly.arg(&flight).arg("--elf").arg(&images[0].1))
    })?;
    step::timed("QEMU tests", || {
        setup::qemu()?;
        let elf = build::qemu_application(&toolchain)?;
        let mut test = host_cargo("test");
        test.args(["-p", "aplomb", "--test", "qemu", "--", "--nocapture"]);
        test.env("APLOMB_QEMU_ELF", elf);
        step::run(test.env("APLOMB_BURSTS", flight.join("bursts.csv")))
    })?;
    cost::run()?;
    eprintln!("\nall passed in {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// A cargo command on this computer. The emulator asks for a newer compiler than it needs.
fn host_cargo(subcommand: &str) -> std::process::Command {
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
