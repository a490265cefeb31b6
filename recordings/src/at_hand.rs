//! Folder of public recordings, which are no part of the project: tests use those at hand.

use std::path::{Path, PathBuf};

/// Environment variable that names the folder if it is not the usual one.
pub const VARIABLE: &str = "APLOMB_RECORDINGS";
/// Usual folder, seen from this crate.
const USUAL_FOLDER: &str = "../../shared/data";

/// Returns the folder of all sets, which need not exist.
#[must_use]
pub fn folder() -> PathBuf {
    match std::env::var_os(VARIABLE) {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join(USUAL_FOLDER),
    }
}

/// Returns the folder of a set of recordings for a test; says that the test is skipped if there is
/// none.
#[must_use]
pub fn set(name: &str) -> Option<PathBuf> {
    let set = folder().join(name);
    if set.is_dir() {
        return Some(set);
    }
    let set = set.display();
    eprintln!("skipped: there is no {set}; {VARIABLE} may name the folder of recordings");
    None
}
