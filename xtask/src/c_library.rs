//! `cargo xtask c`: the C library for this computer and for Cortex-M cores.
//!
//! Each core's program processes bursts, and prints a checksum of all attitudes, in QEMU. All cores
//! and this computer have to print the same. No program may hold a panic.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::setup::{self, Toolchain};
use crate::{qemu, step};

/// Core with the options of its compiler and its machine in QEMU.
pub struct Core {
    name: &'static str,
    target: &'static str,
    /// Options of the C compiler.
    pub options: &'static [&'static str],
    machine: &'static str,
}

/// Cores of the programs; the first one counts instructions.
pub const CORES: [Core; 3] = [
    Core {
        name: "cortex-m4f",
        target: setup::TARGET,
        options: &["-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"],
        machine: "mps2-an386",
    },
    Core {
        name: "cortex-m7",
        target: setup::TARGET,
        options: &["-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"],
        machine: "mps2-an500",
    },
    Core {
        name: "cortex-m0plus",
        target: "thumbv6m-none-eabi",
        options: &["-mcpu=cortex-m0plus", "-mfloat-abi=soft"],
        machine: "microbit",
    },
];

pub const COMPILER: &str = "arm-none-eabi-gcc";
/// Options for every program.
const OPTIONS: [&str; 5] = ["-std=c99", "-Os", "-Wall", "-Wextra", "-pedantic"];

/// Builds the library for this computer and runs its tests, then for the cores.
pub fn run() -> Result<(), String> {
    let mut build = step::host_cargo("build");
    step::run(build.args(["--release", "-p", "aplomb-c"]))?;
    let folder = step::target_folder();
    eprintln!("   {}", folder.join("release/libaplomb_c.a").display());
    eprintln!("   {}", crate::root().join("c/include/aplomb.h").display());
    let mut test = step::host_cargo("test");
    step::run(test.args(["--release", "-p", "aplomb-c"]))?;
    check()
}

/// Checks the library on the cores, and its unsafe code with Miri.
pub fn check() -> Result<(), String> {
    run_for_cores()?;
    step::timed("the C library in Miri", miri)
}

/// Runs the tests of the boundary in Miri, which finds undefined behaviour. Without Miri it says
/// so.
fn miri() -> Result<(), String> {
    let miri = |arguments: &[&str]| {
        let mut cargo = step::command(Path::new("cargo"));
        cargo.args(["+nightly", "miri"]).args(arguments);
        cargo
    };
    if step::output(&mut miri(&["--version"])).is_none() {
        step::skip(
            "the C library in Miri",
            "Miri is not installed; `rustup +nightly component add miri` installs it",
        );
        return Ok(());
    }
    let folder = step::target_folder().join("miri");
    let mut test = miri(&["test", "--ignore-rust-version", "-p", "aplomb-c", "--lib"]);
    step::run(test.arg("--target-dir").arg(folder))
}

/// Builds the library for the cores, and runs a program on each.
fn run_for_cores() -> Result<(), String> {
    step::timed("the C library on Cortex-M cores", || {
        let libraries: Vec<PathBuf> = CORES
            .iter()
            .map(|core| library(core, "firmware"))
            .collect::<Result<_, _>>()?;
        if !step::is_installed(COMPILER) {
            step::skip(
                "programs with the C library on Cortex-M cores",
                &format!("{COMPILER} is not installed"),
            );
            return Ok(());
        }
        setup::qemu()?;
        let mut checksums = Vec::from_iter(on_this_computer()?);
        for (core, library) in CORES.iter().zip(&libraries) {
            let program = link(core, library)?;
            check_panics(&program)?;
            let found = in_qemu(core, &program)?;
            checksums.push((core.name, found.clone()));
            compare(&checksums)?;
            let bytes = flash(&program)?;
            eprintln!("   {}: {found}; program of {bytes} bytes", core.name);
        }
        Ok(())
    })
}

/// Builds the library for this computer, whose target is `host`, and for the cores. Returns each
/// target with its library.
pub fn build(host: &str) -> Result<Vec<(String, PathBuf)>, String> {
    let mut cargo = step::host_cargo("build");
    step::run(cargo.args(["--quiet", "--release", "-p", "aplomb-c"]))?;
    let here = step::target_folder().join("release/libaplomb_c.a");
    let mut found = vec![(host.to_owned(), here)];
    for core in &CORES {
        if found.iter().all(|(target, _)| target != core.target) {
            found.push((core.target.to_owned(), library(core, "firmware")?));
        }
    }
    Ok(found)
}

/// Builds the library for a core with this profile.
pub fn library(core: &Core, profile: &str) -> Result<PathBuf, String> {
    let mut cargo = Toolchain::for_any(core.target)?.cargo_for(core.target, "build");
    cargo.args(["--quiet", "--profile", profile, "-p", "aplomb-c"]);
    step::run(&mut cargo)?;
    let folder = step::target_folder().join(core.target).join(profile);
    Ok(folder.join("libaplomb_c.a"))
}

/// Returns a compiler's command with the program's options, to write this file.
fn compile(compiler: &str, output: &Path) -> Command {
    let mut command = step::command(Path::new(compiler));
    command.args(OPTIONS).args(["-Werror", "-I", "c/include"]);
    command.args(["-o"]).arg(output).arg("c/tests/c/checksum.c");
    command
}

/// Returns a path for a program.
pub fn program(name: &str) -> Result<PathBuf, String> {
    let folder = step::target_folder().join("c");
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    Ok(folder.join(name))
}

/// Fails unless all checksums are equal.
fn compare(checksums: &[(&str, String)]) -> Result<(), String> {
    for pair in checksums.windows(2) {
        let [(before, expected), (name, found)] = pair else {
            continue;
        };
        if found != expected {
            return Err(format!("{name}: {found}, but {before}: {expected}"));
        }
    }
    Ok(())
}

/// Returns this computer's name and its checksum; `None` without a compiler.
fn on_this_computer() -> Result<Option<(&'static str, String)>, String> {
    if !step::is_installed("gcc") {
        step::skip(
            "the cores' comparison with this computer",
            "gcc is not installed",
        );
        return Ok(None);
    }
    let mut build = step::host_cargo("build");
    step::run(build.args(["--quiet", "--release", "-p", "aplomb-c"]))?;
    let program = program("host")?;
    let mut gcc = compile("gcc", &program);
    gcc.arg(step::target_folder().join("release/libaplomb_c.a"));
    step::run(gcc.args(["-lpthread", "-ldl", "-lm"]))?;
    let output = step::output(&mut Command::new(&program));
    output
        .map(|checksum| Some(("this computer", checksum)))
        .ok_or_else(|| format!("{} failed", program.display()))
}

/// Links the program for a core.
fn link(core: &Core, library: &Path) -> Result<PathBuf, String> {
    let program = program(core.name)?;
    let mut gcc = compile(COMPILER, &program);
    gcc.args(core.options)
        .args(["-mthumb", "-nostdlib", "-Wl,--gc-sections,-z,noexecstack"]);
    gcc.args(["-T", "c/tests/c/core.ld", "c/tests/c/core.c"])
        .arg(library);
    step::run(gcc.arg("-lgcc"))?;
    Ok(program)
}

/// Fails if the program holds a panic.
fn check_panics(program: &Path) -> Result<(), String> {
    let symbols = step::output(Command::new("arm-none-eabi-nm").arg(program))
        .ok_or("arm-none-eabi-nm failed")?;
    if !symbols.contains("aplomb_update_burst") {
        return Err(format!("{}: there is no library in it", program.display()));
    }
    match symbols.lines().find(|line| line.contains("panicking")) {
        Some(symbol) => Err(format!("{}: can panic: {symbol}", program.display())),
        None => Ok(()),
    }
}

/// Runs the program in QEMU, and returns what it prints.
fn in_qemu(core: &Core, program: &Path) -> Result<String, String> {
    let output = qemu::run_on(core.machine, program)?;
    let printed = [output.stdout, output.stderr].concat();
    let printed = String::from_utf8_lossy(&printed).trim().to_owned();
    if printed.starts_with("checksum ") {
        Ok(printed)
    } else {
        Err(format!("{}: {printed}", core.name))
    }
}

/// Returns the bytes of code and constants.
pub fn flash(program: &Path) -> Result<u64, String> {
    let text = step::output(Command::new("arm-none-eabi-size").arg(program));
    let text = text.ok_or("arm-none-eabi-size failed")?;
    let bytes = text
        .lines()
        .nth(1)
        .and_then(|line| line.split_whitespace().next());
    let bytes = bytes.and_then(|bytes| bytes.parse().ok());
    bytes.ok_or_else(|| format!("no size in {text}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cores_are_compared_with_each_other_without_this_computer() {
        let all = |last: &str| {
            let checksums = ["1", "1", last].map(|number| format!("checksum {number}"));
            let names = CORES.iter().map(|core| core.name);
            names.zip(checksums).collect::<Vec<_>>()
        };
        assert_eq!(compare(&all("1")), Ok(()));
        let error = compare(&all("2")).unwrap_err();
        let expected = "cortex-m0plus: checksum 2, but cortex-m7: checksum 1";
        assert_eq!(error, expected);
    }
}
