//! Files of the workspace, for the tests that check its sources.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Folders of built files, and folders that git keeps or ignores.
const KEPT_OUT: [&str; 5] = ["target", ".git", "artifacts", "corpus", "coverage"];

/// Returns the root of the workspace.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the contents of a file, by its path from the root.
pub fn read(file: &str) -> String {
    fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

/// Returns all files below a folder with one of these endings: path from the root, and contents.
/// The empty name is the root.
pub fn files_below(folder: &str, endings: &[&str]) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(&folder)
            .unwrap_or_else(|error| panic!("cannot read {}: {error}", folder.display()));
        for entry in entries {
            let path = entry.expect("the folder can be listed").path();
            if path.is_dir() {
                if !KEPT_OUT.iter().any(|name| path.ends_with(name)) {
                    folders.push(path);
                }
                continue;
            }
            let ending = path.extension().and_then(|ending| ending.to_str());
            if ending.is_some_and(|ending| endings.contains(&ending)) {
                let text = fs::read_to_string(&path)
                    .unwrap_or_else(|error| panic!("cannot read {}: {error}", path.display()));
                let path = path.strip_prefix(root()).expect("it is below the root");
                let path = path.to_str().expect("names are ASCII").replace('\\', "/");
                found.insert(path, text);
            }
        }
    }
    found
}
