//! Tests of the rules of ARCHITECTURE.md: allowed imports, allowed places of `unsafe`, and the
//! reserved part of a chip's flash map.

#[path = "layout/tree.rs"]
mod tree;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use tree::{files_below, read, root};

/// Folders of the workspace's code.
const FOLDERS: [&str; 13] = [
    "src",
    "bench/src",
    "c",
    "cli/src",
    "fuzz",
    "models",
    "plot",
    "python/src",
    "recordings/src",
    "rigs",
    "virtual-board/src",
    "xtask/src",
    "examples",
];

/// Parts of the library, each with the parts that it may import. `A → [B]` reads "A may import
/// B".
const MAY_IMPORT: [(&str, &[&str]); 15] = [
    ("units", &[]),
    ("attitude", &["units"]),
    ("serialize", &["attitude"]),
    ("fault", &["units"]),
    ("mpu6050", &["units", "attitude", "serialize"]),
    ("compass", &["units", "attitude"]),
    ("calibration", &["units", "attitude", "serialize"]),
    (
        "settings",
        &["units", "attitude", "mpu6050", "compass", "calibration"],
    ),
    ("estimator", &["units", "attitude", "serialize"]),
    ("health", &["units", "attitude", "serialize"]),
    (
        "pipeline",
        &[
            "units",
            "attitude",
            "serialize",
            "mpu6050",
            "calibration",
            "estimator",
            "health",
        ],
    ),
    (
        "telemetry",
        &[
            "units",
            "attitude",
            "serialize",
            "fault",
            "mpu6050",
            "compass",
            "calibration",
            "settings",
            "estimator",
            "health",
            "pipeline",
        ],
    ),
    (
        "console",
        &[
            "units",
            "attitude",
            "fault",
            "mpu6050",
            "compass",
            "calibration",
            "settings",
            "estimator",
            "health",
            "pipeline",
            "telemetry",
        ],
    ),
    (
        "board",
        &[
            "units",
            "attitude",
            "fault",
            "mpu6050",
            "compass",
            "calibration",
            "estimator",
            "health",
            "pipeline",
        ],
    ),
    ("lib", &[]),
];

#[test]
fn imports_run_one_way() {
    let allowed: BTreeMap<&str, &[&str]> = MAY_IMPORT.into_iter().collect();
    let mut imports_seen = 0;
    for (path, contents) in rust_files("src") {
        let part = part_of(&path);
        if part == "bin" {
            continue;
        }
        let may = allowed
            .get(part.as_str())
            .unwrap_or_else(|| panic!("{} belongs to no part of the table", path.display()));
        for (number, line) in contents.lines().enumerate() {
            for imported in imports(line) {
                imports_seen += 1;
                assert!(
                    imported == part || may.contains(&imported.as_str()),
                    "{}:{}: `{part}` may not import `{imported}`",
                    path.display(),
                    number + 1,
                );
            }
        }
    }
    assert!(
        imports_seen > 20,
        "the search finds imports at all: {imports_seen}"
    );
}

#[test]
fn only_bins_import_the_board() {
    for (path, contents) in rust_files("src") {
        let is_bin = part_of(&path) == "bin";
        let uses_board = contents.contains("aplomb::board");
        assert!(!uses_board || is_bin, "{} uses the board", path.display());
    }
}

/// Compares the list of `unsafe` in the docs with the code: each reason with its files.
#[test]
fn unsafe_is_listed_with_its_reasons() {
    let mut list = String::from(
        "# `unsafe`, and why it is sound\n\n\
         Written by `APLOMB_BLESS=1 cargo test --test architecture`; \
         the test fails if it is old.\n\n\
         | file | why |\n|---|---|\n",
    );
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = ["c/src", "rigs/src", "src"].map(rust_files).concat();
    for (path, contents) in files {
        let path = path.strip_prefix(root).unwrap_or(&path);
        let lines: Vec<&str> = contents.lines().map(str::trim).collect();
        for (index, line) in lines.iter().enumerate() {
            let Some(start) = line.strip_prefix("// SAFETY: ") else {
                continue;
            };
            let mut reason = start.to_owned();
            for more in &lines[index + 1..] {
                let Some(more) = more.strip_prefix("// ") else {
                    break;
                };
                reason.push(' ');
                reason.push_str(more);
            }
            list.push_str(&format!("| `{}` | {reason} |\n", path.display()));
        }
    }
    let file = root.join("docs/unsafe.md");
    if std::env::var_os("APLOMB_BLESS").is_some() {
        fs::write(&file, &list).expect("docs/unsafe.md can be written");
    }
    let committed = fs::read_to_string(&file).unwrap_or_default();
    assert_eq!(committed, list, "bless docs/unsafe.md anew");
}

#[test]
fn unsafe_is_only_in_the_board_and_gives_its_reason() {
    let mut blocks = 0;
    for folder in FOLDERS {
        for (path, contents) in rust_files(folder) {
            let lines: Vec<&str> = contents.lines().collect();
            for (index, line) in lines.iter().enumerate() {
                let code = line.split("//").next().unwrap_or_default();
                // The body of an `unsafe fn` needs blocks of its own.
                let opens = ["unsafe {", "unsafe impl"]
                    .iter()
                    .any(|form| code.contains(form));
                if !opens {
                    continue;
                }
                blocks += 1;
                let place = format!("{}:{}", path.display(), index + 1);
                assert!(
                    !["src", "c"].contains(&folder)
                        || (folder == "src" && part_of(&path) == "board")
                        || path.ends_with("c/src/state.rs"),
                    "{place}: unsafe outside the board, and outside the memory of C"
                );
                let reason = lines[index.saturating_sub(8)..=index]
                    .iter()
                    .any(|before| before.contains("SAFETY:"));
                assert!(
                    reason,
                    "{place}: say why it is sound in a comment `SAFETY:`"
                );
            }
        }
    }
    assert!(
        blocks > 5,
        "the search finds unsafe blocks at all: {blocks}"
    );
}

#[test]
fn writing_firmware_never_erases_the_whole_chip() {
    // An erase of the whole chip would erase the stored calibration too.
    for file in ["Embed.toml", ".cargo/config.toml", "xtask/src/main.rs"] {
        let contents = read(file);
        assert!(contents.contains("probe-rs") || contents.contains("[default.flashing]"));
        for asks in ["chip-erase", "do_chip_erase = true", "probe-rs erase"] {
            assert!(!contents.contains(asks), "{file} asks for `{asks}`");
        }
    }
}

#[test]
fn every_package_takes_the_lints_of_the_workspace() {
    let manifest = read("Cargo.toml");
    let members = manifest
        .lines()
        .find_map(|line| line.strip_prefix("members = ["))
        .expect("the members stand in one line");
    let members = members.split('"').skip(1).step_by(2);
    let mut packages = 0;
    for folder in members.chain(["."]) {
        packages += 1;
        let file = root().join(folder).join("Cargo.toml");
        let manifest = fs::read_to_string(&file).expect("every member has a manifest");
        assert!(
            manifest.contains("\n[lints]\nworkspace = true\n"),
            "{}: add `[lints]` with `workspace = true`",
            file.display()
        );
    }
    assert!(packages > 3, "the search finds members at all: {packages}");
}

#[test]
fn every_module_has_a_header() {
    for folder in FOLDERS {
        for (path, contents) in rust_files(folder) {
            assert!(
                contents.starts_with("//! "),
                "{}: begin with a header",
                path.display()
            );
        }
    }
}

/// Returns the parts named in a line of code after `crate::` or `aplomb::`.
fn imports(line: &str) -> Vec<String> {
    let code = line.split("//").next().unwrap_or_default();
    ["crate::", "aplomb::"]
        .iter()
        .flat_map(|prefix| {
            code.match_indices(prefix)
                .map(|(at, _)| &code[at + prefix.len()..])
        })
        .map(|rest| {
            rest.chars()
                .take_while(|c| c.is_ascii_alphanumeric() || *c == '_')
                .collect::<String>()
        })
        .filter(|name| MAY_IMPORT.iter().any(|(part, _)| part == name))
        .collect()
}

/// Returns the part of a file: the first name below `src`.
fn part_of(path: &Path) -> String {
    let below = path.strip_prefix(root().join("src")).unwrap_or(path);
    let first = below.iter().next().unwrap_or_default().to_string_lossy();
    first.trim_end_matches(".rs").to_owned()
}

/// Returns the Rust files below a folder, sorted by their paths.
fn rust_files(folder: &str) -> Vec<(PathBuf, String)> {
    let files = files_below(folder, &["rs"]).into_iter();
    let mut files: Vec<_> = files
        .map(|(path, text)| (root().join(path), text))
        .collect();
    files.sort();
    files
}
