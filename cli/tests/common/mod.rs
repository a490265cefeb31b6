//! Shared parts of the tests: the program, files of a test, golden files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs `aplomb` with these arguments.
pub fn aplomb<A: AsRef<std::ffi::OsStr>>(arguments: &[A]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .args(arguments)
        .output()
        .expect("the program runs")
}

/// Returns a path in a folder of the test's own.
pub fn path(test: &str, name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test);
    std::fs::create_dir_all(&folder).expect("the target folder can be written");
    folder.join(name)
}

/// Writes a file of the test's own.
pub fn file(test: &str, name: &str, contents: impl AsRef<[u8]>) -> PathBuf {
    let path = path(test, name);
    std::fs::write(&path, contents).expect("the target folder can be written");
    path
}
