//! `cargo xtask python`: installs the Python package into a folder of its own, and tests it against
//! the program `aplomb`, to the bit.

use std::path::{Path, PathBuf};

use crate::{build, step};

/// Packages of the tests. The last one is the filter to compare the speed with.
const PACKAGES: [&str; 3] = ["numpy", "pytest", "vqf"];
/// Checks the version that `python/pyproject.toml` asks for.
const IS_NEW_ENOUGH: &str = "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))";

/// Installs and tests the package. Without Python it says so, and passes.
pub fn run() -> Result<(), String> {
    step::timed("the Python package", || {
        let Some(python) = python() else {
            eprintln!("   skipped: python3 of version 3.10 or later, with venv, is not installed");
            return Ok(());
        };
        lint()?;
        let folder = step::target_folder().join("python-tests");
        step::run(step::command(&python).args(["-m", "venv"]).arg(&folder))?;
        let python = folder.join(if cfg!(windows) {
            "Scripts/python"
        } else {
            "bin/python"
        });
        let pip = |arguments: &[&str]| {
            let mut pip = step::command(&python);
            pip.args([
                "-m",
                "pip",
                "install",
                "--quiet",
                "--disable-pip-version-check",
            ]);
            step::run(pip.args(arguments))
        };
        pip(&PACKAGES)?;
        pip(&["./python"])?;
        let program = build::program()?;
        let mut test = step::command(&python);
        test.args([
            "-m",
            "pytest",
            "-q",
            "-s",
            "-p",
            "no:cacheprovider",
            "python/tests",
        ]);
        test.env("APLOMB", program)
            .env("PYTHONDONTWRITEBYTECODE", "1");
        step::run(&mut test)
    })
}

/// Checks the form of the package's code, and lints it. It is a workspace of its own.
fn lint() -> Result<(), String> {
    let cargo = |subcommand: &str| {
        let mut cargo = step::command(Path::new("cargo"));
        cargo.args([subcommand, "--manifest-path", "python/Cargo.toml"]);
        cargo
    };
    step::run(cargo("fmt").arg("--check"))?;
    let mut clippy = cargo("clippy");
    clippy.args(["--quiet", "--release", "--target-dir"]);
    clippy.arg(step::target_folder().join("python"));
    step::run(clippy.args(["--", "-D", "warnings"]))
}

/// Returns the first Python that is new enough.
fn python() -> Option<PathBuf> {
    let names = [
        "python3",
        "python3.13",
        "python3.12",
        "python3.11",
        "python3.10",
    ];
    let is_usable = |name: &&&str| {
        let mut check = step::command(Path::new(name));
        step::output(check.args(["-c", IS_NEW_ENOUGH])).is_some()
    };
    names.iter().find(is_usable).map(PathBuf::from)
}
