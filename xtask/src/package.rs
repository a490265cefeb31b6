//! The package for the registry: it is complete, holds nothing else, and the library alone brings
//! no firmware.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::setup::TARGET;
use crate::step;

/// The contents of the package: these files, and these folders with files of this kind.
const FILES: [&str; 10] = [
    ".cargo_vcs_info.json",
    "CHANGELOG.md",
    "Cargo.lock",
    "Cargo.toml",
    "Cargo.toml.orig",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "build.rs",
    "memory.x",
];
const FOLDERS: [(&str, &str); 3] = [("src/", ".rs"), ("examples/", ".rs"), ("boards/", ".x")];

/// Every crate that the library alone builds with: the traits it implements, its mathematics, and
/// their dependencies. The macro crates are those with which `cobs` derives its error.
const CRATES_OF_THE_LIBRARY: [&str; 18] = [
    "aplomb",
    "byteorder",
    "bitflags",
    "cobs",
    "crc",
    "crc-catalog",
    "embedded-hal",
    "embedded-storage",
    "hash32",
    "heapless",
    "libm",
    "proc-macro2",
    "quote",
    "stable_deref_trait",
    "syn",
    "thiserror",
    "thiserror-impl",
    "unicode-ident",
];

/// Packages that a release publishes, each after those that it needs.
pub const PUBLISHED: [&str; 5] = [
    "aplomb",
    "aplomb-models",
    "aplomb-plot",
    "aplomb-recordings",
    "aplomb-cli",
];

/// Packs the library and the program with the packages it needs, and builds each from its package,
/// as `cargo publish` would.
pub fn publish_dry_run() -> Result<(), String> {
    forget_earlier_runs()?;
    let mut publish = step::command(Path::new("cargo"));
    publish.args(["publish", "--dry-run", "--allow-dirty", "--quiet"]);
    for package in PUBLISHED {
        publish.args(["-p", package]);
    }
    step::run(&mut publish)
}

/// Removes what an earlier dry run unpacked and built: cargo would take it for the present
/// packages of the same version. Its registry of a dry run has no host in its name.
fn forget_earlier_runs() -> Result<(), String> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let user = || std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".cargo"));
    let home = home.or_else(user).unwrap_or_default();
    let of_dry_runs = starting_with(&home.join("registry/src"), "-");
    let mut earlier = starting_with(&step::target_folder().join("debug/.fingerprint"), "aplomb-");
    for registry in of_dry_runs {
        earlier.extend(starting_with(&registry, "aplomb-"));
    }
    for folder in earlier {
        std::fs::remove_dir_all(&folder)
            .map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    Ok(())
}

/// Returns the entries of a folder whose names start with this text.
fn starting_with(folder: &Path, start: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let starts = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(start)
    };
    entries.map(|entry| entry.path()).filter(starts).collect()
}

/// Packages the crate, builds what is in the package, and checks the lists.
pub fn check() -> Result<(), String> {
    let mut list = cargo("package");
    let listed = step::output(list.args(["--list", "--allow-dirty"]))
        .ok_or("`cargo package --list` failed")?;
    check_files(&listed)?;
    step::run(cargo("package").args(["--quiet", "--allow-dirty"]))?;
    for target in [None, Some(TARGET)] {
        let mut tree = cargo("tree");
        tree.args(["-e", "normal", "--no-default-features"]);
        tree.args(["--prefix", "none", "-f", "{p}"]);
        if let Some(target) = target {
            tree.args(["--target", target]);
        }
        check_crates(&step::output(&mut tree).ok_or("`cargo tree` failed")?)?;
    }
    Ok(())
}

fn cargo(subcommand: &str) -> Command {
    let mut cargo = step::command(Path::new("cargo"));
    cargo.args([subcommand, "-p", "aplomb"]);
    cargo
}

fn check_files(listed: &str) -> Result<(), String> {
    let belongs = |file: &&str| {
        let in_folder =
            |&(folder, kind): &(&str, &str)| file.starts_with(folder) && file.ends_with(kind);
        FILES.contains(file) || FOLDERS.iter().any(in_folder)
    };
    if let Some(extra) = listed.lines().find(|file| !belongs(file)) {
        return Err(format!(
            "`{extra}` would be in the package: see `include` in Cargo.toml"
        ));
    }
    // Without a repository there is no first one.
    let mut files = FILES.iter().skip(1);
    let missing = files.find(|file| !listed.lines().any(|line| line == **file));
    let mut folders = FOLDERS.iter().map(|(folder, _)| folder);
    let empty = folders.find(|folder| !listed.lines().any(|line| line.starts_with(**folder)));
    match missing.or(empty) {
        Some(missing) => Err(format!("`{missing}` would be missing in the package")),
        None => Ok(()),
    }
}

fn check_crates(tree: &str) -> Result<(), String> {
    let names = tree
        .lines()
        .filter_map(|line| line.split_whitespace().next());
    let mut names = names.peekable();
    if names.peek() != Some(&"aplomb") {
        return Err("`cargo tree` does not begin with the library".into());
    }
    match names.find(|name| !CRATES_OF_THE_LIBRARY.contains(name)) {
        Some(extra) => Err(format!(
            "the library alone depends on `{extra}`: \
             make it optional, or add it to the list in xtask/src/package.rs"
        )),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_belong_into_the_package_is_named() {
        let whole = FILES.join("\n") + "\nsrc/lib.rs\nexamples/host.rs\nboards/a.x";
        assert_eq!(check_files(&whole), Ok(()));
        for extra in [
            "docs/fly.png",
            "src/a.png",
            "tests/qemu.rs",
            "examples/embassy/Cargo.lock",
        ] {
            let error = check_files(&format!("{whole}\n{extra}")).unwrap_err();
            assert!(error.contains(extra), "{error}");
        }
        for missing in ["memory.x", "LICENSE-MIT", "boards/a.x"] {
            let error = check_files(&whole.replace(missing, "README.md")).unwrap_err();
            assert!(error.contains("missing"), "{error}");
        }
    }

    #[test]
    fn a_crate_of_the_firmware_is_named() {
        let library = "aplomb v0.1.0 (/a)\nlibm v0.2.16\nheapless v0.9.3\nlibm v0.2.16 (*)";
        assert_eq!(check_crates(library), Ok(()));
        let error = check_crates(&format!("{library}\nstm32f4xx-hal v0.23.0")).unwrap_err();
        assert!(error.contains("`stm32f4xx-hal`"), "{error}");
        assert!(check_crates("").is_err());
    }
}
