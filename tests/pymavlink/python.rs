//! Python with pymavlink, for tests against an independent implementation.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Version for which the tests are written.
const PYMAVLINK: &str = "pymavlink==2.4.50";

/// Returns the Python of a virtual environment in this folder with pymavlink, and installs it if
/// necessary. If that fails, reports it and returns `None`.
pub fn with_pymavlink(folder: &Path) -> Option<PathBuf> {
    let folder = folder.join("pymavlink");
    let python = folder.join("bin/python");
    let has_it = || {
        let import = ["-c", "import pymavlink.dialects.v20.common"];
        python.exists() && runs(Command::new(&python).args(import))
    };
    if !has_it() {
        runs(Command::new("python3").args(["-m", "venv"]).arg(&folder));
        runs(Command::new(&python).args(["-m", "pip", "install", "--quiet", PYMAVLINK]));
    }
    if !has_it() {
        eprintln!(
            "SKIPPED: pymavlink cannot be installed here; \
             it needs Python 3 with venv and pip, and the network"
        );
        return None;
    }
    Some(python)
}

fn runs(command: &mut Command) -> bool {
    command.output().is_ok_and(|output| output.status.success())
}
