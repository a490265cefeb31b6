//! The header is that of the code.

use std::collections::BTreeMap;
use std::path::Path;

use aplomb::health::{BoardFlags, Flags};

/// Text at the head of the header.
const HEAD: &str = "\
/* aplomb: attitude from an MPU-6050, or from samples in SI units. docs/c.md explains it.
 *
 * Made from c/src/ by `APLOMB_BLESS=1 cargo test -r -p aplomb-c --test header`. */";

/// Returns the macros of the version.
fn version() -> String {
    let numbers = [
        ("MAJOR", env!("CARGO_PKG_VERSION_MAJOR")),
        ("MINOR", env!("CARGO_PKG_VERSION_MINOR")),
        ("PATCH", env!("CARGO_PKG_VERSION_PATCH")),
    ]
    .map(|(part, number)| format!("#define APLOMB_VERSION_{part} {number}\n"));
    format!(
        "\n/* Version of this header. `aplomb_version` returns that of the library. */\n{}\
         #define APLOMB_VERSION \"{}\"",
        numbers.concat(),
        env!("CARGO_PKG_VERSION")
    )
}

/// Returns the header that the code gives.
fn header() -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut config = cbindgen::Config {
        language: cbindgen::Language::C,
        cpp_compat: true,
        header: Some(HEAD.to_owned()),
        include_guard: Some("APLOMB_H".to_owned()),
        documentation_style: cbindgen::DocumentationStyle::C99,
        usize_is_size_t: true,
        no_includes: true,
        sys_includes: vec!["stdbool.h".to_owned(), "stdint.h".to_owned()],
        line_length: 96,
        after_includes: Some(version()),
        ..cbindgen::Config::default()
    };
    config.enumeration.rename_variants = cbindgen::RenameRule::QualifiedScreamingSnakeCase;
    config.export.include = ["AplombAccelerometerKnowledge", "AplombCompassKnowledge"]
        .map(str::to_owned)
        .into();
    let bindings = cbindgen::Builder::new()
        .with_config(config)
        .with_src(folder.join("src/lib.rs"));
    let mut text = Vec::new();
    bindings
        .generate()
        .expect("the code can be read")
        .write(&mut text);
    String::from_utf8(text).expect("a header is text")
}

#[test]
fn the_header_is_that_of_the_code() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("include/aplomb.h");
    let made = header();
    if std::env::var_os("APLOMB_BLESS").is_some() {
        std::fs::write(&file, &made).expect("the header can be written");
    }
    let committed = std::fs::read_to_string(&file).unwrap_or_default();
    assert_eq!(committed, made, "bless c/include/aplomb.h anew");
}

#[test]
fn the_flags_are_those_of_the_library() {
    let header = header();
    let of_snapshots = Flags::all()
        .iter_names()
        .map(|(name, flag)| (name, flag.bits()));
    let of_callers = BoardFlags::all()
        .iter_names()
        .map(|(name, flag)| (name, flag.bits()));
    let flags: BTreeMap<&str, u32> = of_snapshots.chain(of_callers).collect();
    for (name, bits) in &flags {
        let line = format!(
            "#define APLOMB_FLAG_{name} (1u << {})\n",
            bits.trailing_zeros()
        );
        assert!(header.contains(&line), "the header lacks {line}");
    }
    assert_eq!(header.matches("#define APLOMB_FLAG_").count(), flags.len());
}
