//! The layout of the workspace that a machine can check: which crate may depend on which, files and functions of a readable
//! length, and no two files that import each other.

use std::fs;
use std::path::{Path, PathBuf};

#[test]
fn the_models_know_nothing_of_what_they_judge() {
    let manifest = fs::read_to_string(root().join("models/Cargo.toml")).expect("a manifest");
    let (dependencies, _) = manifest
        .split_once("[dev-dependencies]")
        .expect("tests compare the models with the library");
    assert!(
        !dependencies.contains("path = "),
        "a model that shares code with what it judges cannot disagree with it"
    );
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).to_owned()
}
