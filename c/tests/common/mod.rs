//! Programs in C, linked with the library of this test.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Warnings of every compiler, all of them errors.
pub const WARNINGS: [&str; 6] = [
    "-Wall",
    "-Wextra",
    "-Wsign-conversion",
    "-pedantic",
    "-Werror",
    "-O1",
];

/// Libraries that the static library needs.
pub const SYSTEM: [&str; 3] = ["-lpthread", "-ldl", "-lm"];

/// Returns the static library that this test was built with.
pub fn library() -> PathBuf {
    let folder = std::env::current_exe().expect("a test has a path");
    let folder = folder.parent().expect("a test is in a folder");
    let files = std::fs::read_dir(folder).expect("the folder can be read");
    let is_library = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("libaplomb_c") && name.ends_with(".a")
    };
    let libraries = files.flatten().map(|entry| entry.path()).filter(is_library);
    let newest = libraries.max_by_key(|path| path.metadata().and_then(|data| data.modified()).ok());
    newest.expect("cargo builds the static library with the test")
}

/// Returns a path for a program.
pub fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// Compiles this source with gcc. Without gcc prints so, and returns `None`.
pub fn program_of_gcc(name: &str, source: &str) -> Option<PathBuf> {
    if Command::new("gcc").arg("--version").output().is_err() {
        eprintln!("skipped: gcc is not installed");
        return None;
    }
    let (folder, program) = (Path::new(env!("CARGO_MANIFEST_DIR")), file(name));
    let mut gcc = Command::new("gcc");
    gcc.args(WARNINGS)
        .args(["-std=c99", "-I"])
        .arg(folder.join("include"));
    gcc.arg(folder.join(source)).arg(library()).args(SYSTEM);
    let output = gcc.arg("-o").arg(&program).output().expect("gcc runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    Some(program)
}
