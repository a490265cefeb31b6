//! Compares the public API with `tests/golden/public-api.txt`, so that every change is visible.
//!
//! `cargo xtask api` runs rustdoc on the library and names the files in `APLOMB_RUSTDOC_JSON`.
//! Without that variable the test reports that it is skipped.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::{env, fs};

use public_api::Builder;

/// Format of Rust 1.95 and 1.96. Another compiler may list the same API differently.
const FORMAT: &str = "57";
const GOLDEN: &str = "tests/golden/public-api.txt";
const EXPLANATION: &str = "\
Every public item of the library, written by `cargo xtask api --bless`. First with the features
`mavlink` and `defmt` on a computer, then what a board adds for the target. `derived for` lists the
derived traits of a type; blanket implementations and auto traits are left out.
";

#[test]
fn the_public_api_is_the_one_that_is_committed() {
    let Some(described) = env::var_os("APLOMB_RUSTDOC_JSON") else {
        println!("skipped: APLOMB_RUSTDOC_JSON is not set; `cargo xtask api` sets it");
        return;
    };
    let files: Vec<PathBuf> = env::split_paths(&described).collect();
    for file in &files {
        let format = format_of(file);
        if format != FORMAT {
            println!(
                "skipped: this rustdoc writes JSON of format {format}, the list is of {FORMAT}"
            );
            return;
        }
    }
    let [host, target] = files.as_slice() else {
        panic!("APLOMB_RUSTDOC_JSON names two files, not {}", files.len());
    };
    let (host, target) = (list(host), list(target));
    let on_the_target: BTreeSet<&String> = target.iter().collect();
    for line in &host {
        assert!(on_the_target.contains(line), "not on the target: {line}");
    }
    let everywhere: BTreeSet<&String> = host.iter().collect();
    let mut text = format!("{EXPLANATION}\n{}\n\n", host.join("\n"));
    for line in target.iter().filter(|line| !everywhere.contains(line)) {
        text += &format!("{line}\n");
    }
    compare(&text);
}

/// Returns the format's version, which rustdoc writes near the end of its file.
fn format_of(file: &Path) -> String {
    let text = fs::read_to_string(file).expect("rustdoc has written its file");
    let (_, rest) = text
        .rsplit_once("\"format_version\":")
        .expect("rustdoc's file has a format");
    rest.chars().take_while(char::is_ascii_digit).collect()
}

/// Returns one line per item, with all derived traits of a type in one line.
fn list(file: &Path) -> Vec<String> {
    let items = |with_derived: bool| -> Vec<String> {
        let api = Builder::from_rustdoc_json(file)
            .omit_blanket_impls(true)
            .omit_auto_trait_impls(true)
            .omit_auto_derived_impls(!with_derived)
            .build()
            .expect("rustdoc's file can be read");
        api.items().map(ToString::to_string).collect()
    };
    let written: BTreeSet<String> = items(false).into_iter().collect();
    let all = items(true);
    let mut derived: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for line in all.iter().filter(|line| !written.contains(*line)) {
        if let Some((name, type_name)) = derived_trait(line) {
            derived.entry(type_name).or_default().push(name);
        }
    }
    let mut lines = Vec::new();
    for line in &all {
        if written.contains(line) {
            lines.push(line.clone());
        } else if let Some((_, type_name)) = derived_trait(line)
            && let Some(mut names) = derived.remove(type_name)
        {
            names.sort_unstable();
            lines.push(format!("derived for {type_name}: {}", names.join(", ")));
        }
    }
    lines
}

/// Returns the trait's name and the type of a line such as `impl core::clone::Clone for a::B`.
fn derived_trait(line: &str) -> Option<(&str, &str)> {
    let (path, type_name) = line
        .strip_prefix("impl")
        .and_then(|rest| rest.split_once(" for "))?;
    let name = path.rsplit("::").next()?;
    // The compiler's mark of a derived `PartialEq`.
    (name != "StructuralPartialEq").then_some((name, type_name))
}

fn compare(text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(GOLDEN);
    if env::var_os("APLOMB_BLESS").is_some() {
        fs::write(&path, text).expect("the list can be written");
    }
    let committed = fs::read_to_string(&path).unwrap_or_default();
    let (before, after): (BTreeSet<&str>, BTreeSet<&str>) =
        (committed.lines().collect(), text.lines().collect());
    let gone = before.difference(&after).map(|line| format!("- {line}\n"));
    let new = after.difference(&before).map(|line| format!("+ {line}\n"));
    let changes: String = gone.chain(new).collect();
    assert!(
        committed == text,
        "the public API has changed:\n{changes}if that is meant, run `cargo xtask api --bless`, \
         commit {GOLDEN}, and say it in CHANGELOG.md"
    );
}
