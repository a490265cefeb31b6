//! The folder of public recordings, which is no part of the project.

use std::path::{Path, PathBuf};

/// Names the folder of recordings if it is not the usual one.
pub const VARIABLE: &str = "APLOMB_RECORDINGS";
const USUAL_FOLDER: &str = "../shared/data";

/// Returns the reason for which work is skipped that needs this recording, or this folder of them.
pub fn absence(path: &Path) -> String {
    let path = path.display();
    format!("there is no {path}; {VARIABLE} may name the folder of recordings")
}

/// Sets that tests use.
const SETS: [&str; 4] = ["broad", "mpu6050-raw", "tumvi", "xio"];

/// Returns the sets that are not in the folder, though the folder is there.
pub fn missing_sets(folder: &Path) -> Vec<&'static str> {
    let is_missing = |set: &&str| folder.is_dir() && !folder.join(set).is_dir();
    SETS.into_iter().filter(is_missing).collect()
}

/// Returns the folder of recordings, which need not exist.
pub fn folder() -> PathBuf {
    match std::env::var_os(VARIABLE) {
        Some(folder) => PathBuf::from(folder),
        None => crate::root().join(USUAL_FOLDER),
    }
}
