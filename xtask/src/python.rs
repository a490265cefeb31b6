//! `cargo xtask python`: installs the Python package into a folder of its own, and tests it against
//! the program `aplomb`, to the bit.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::{build, recordings, step};

/// Packages of the tests. The last one is the filter to compare the speed with.
const PACKAGES: [&str; 3] = ["numpy", "pytest", "vqf"];
/// Folder of the tests' Python.
const FOLDER: &str = "python-tests";
/// Packages that run the notebook.
const NOTEBOOK: [&str; 3] = ["nbclient", "ipykernel", "matplotlib"];
/// Recording that the notebook draws, if it is there.
const DRAWN: &str = "tumvi/room1.csv.gz";
/// Checks the version that `python/pyproject.toml` asks for.
const IS_NEW_ENOUGH: &str = "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))";
const NO_PYTHON: &str = "python3 of version 3.10 or later, with venv, is not installed";

/// Installs and tests the package. Without Python it says so, and passes.
pub fn run() -> Result<(), String> {
    step::timed("the Python package", || {
        let Some(python) = find() else {
            step::skip("the Python package with its lint", NO_PYTHON);
            return Ok(());
        };
        lint()?;
        let python = virtual_environment(&python)?;
        let folder = step::target_folder().join(FOLDER);
        let install = |packages: &[&str]| step::run(pip(&python, "install").args(packages));
        install(&PACKAGES)?;
        if let Err(reason) = install(&NOTEBOOK) {
            let packages = NOTEBOOK.join(", ");
            let reason = format!("{packages} cannot be installed: {reason}");
            step::skip("the notebook", &reason);
        }
        install(&["./python"])?;
        let program = build::program()?;
        let mut test = step::command(&python);
        test.args([
            "-m",
            "pytest",
            "-q",
            "-rs",
            "-s",
            "-p",
            "no:cacheprovider",
            "python/tests",
        ]);
        test.env("APLOMB", program)
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .env("APLOMB_OUTPUT", &folder);
        let recordings = recordings::folder();
        if recordings.is_dir() {
            test.env("APLOMB_LOGS", &recordings);
            test.env("APLOMB_RECORDING", recordings.join(DRAWN));
        }
        step::run(&mut test)?;
        eprintln!("   {}", folder.join("compare_vqf.png").display());
        Ok(())
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

/// Makes the wheel and the archive of its sources in this folder. Without Python it says so.
pub fn package(folder: &Path) -> Result<(), String> {
    step::timed("the Python wheel and its sources", || {
        let Some(python) = find() else {
            step::skip("the Python wheel and its sources", NO_PYTHON);
            return Ok(());
        };
        let python = virtual_environment(&python)?;
        step::run(pip(&python, "install").arg("maturin"))?;
        // The wheel is built from the archive of the sources, which shows that it is whole.
        let mut maturin = step::command(&python);
        maturin.args(["-m", "maturin", "build", "--release", "--sdist"]);
        maturin.args(["--manifest-path", "python/Cargo.toml", "--out"]);
        maturin.arg(folder).arg("--target-dir");
        step::run(maturin.arg(step::target_folder().join("python")))
    })
}

/// Returns the Python of a virtual environment in the target folder.
pub fn virtual_environment(python: &Path) -> Result<PathBuf, String> {
    let folder = step::target_folder().join(FOLDER);
    step::run(step::command(python).args(["-m", "venv"]).arg(&folder))?;
    Ok(folder.join(if cfg!(windows) {
        "Scripts/python"
    } else {
        "bin/python"
    }))
}

/// Returns the command of pip in a virtual environment, with this subcommand.
pub fn pip(python: &Path, subcommand: &str) -> Command {
    let mut pip = step::command(python);
    pip.args(["-m", "pip", subcommand]);
    pip.args(["--quiet", "--disable-pip-version-check"]);
    pip
}

/// Returns the first Python that is new enough.
pub fn find() -> Option<PathBuf> {
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
