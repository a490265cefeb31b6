//! What the tests of the program share: running it, files of their own, and golden files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs `aplomb` with these arguments.
pub fn aplomb<A: AsRef<std::ffi::OsStr>>(arguments: &[A]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .args(arguments)
        .output()
        .expect("the program runs")
}

/// A path in a folder of the test's own.
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

/// Holds `contents` to the golden file of this name; `APLOMB_BLESS=1` writes it instead.
pub fn assert_golden(name: &str, contents: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name);
    if std::env::var_os("APLOMB_BLESS").is_some() {
        std::fs::write(&path, contents).expect("the golden file can be written");
        return;
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    for (number, (line, expected)) in contents.lines().zip(expected.lines()).enumerate() {
        assert_eq!(line, expected, "{}:{}", path.display(), number + 1);
    }
    assert_eq!(
        contents.lines().count(),
        expected.lines().count(),
        "{}: run with APLOMB_BLESS=1 if the change is meant",
        path.display()
    );
}
