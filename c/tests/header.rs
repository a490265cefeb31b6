//! The header is that of the code.

use std::collections::BTreeMap;
use std::path::Path;

use aplomb::health::{BoardFlags, Flags};

/// Text at the head of the header.
const HEAD: &str = "\
/* aplomb: attitude from an MPU-6050, or from samples in SI units. docs/c.md explains it.
 *
 *     AplombSettings settings = aplomb_default_settings();
 *     aplomb_init(&pipeline, &settings);                     once
 *     aplomb_update_burst(&pipeline, &burst, &snapshot);     with each burst of 14 bytes
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

/// Name of the function whose name ends with the header's number, before that number.
const NUMBERED: &str = "aplomb_header_";

/// Functions that start a pipeline: each program calls one of them.
const STARTS: [&str; 2] = ["aplomb_init", "aplomb_compass_init"];

/// Returns the name of the numbered function in this text, with its number.
fn numbered(text: &str) -> &str {
    let (start, _) = text.match_indices(NUMBERED).next().expect("it is there");
    &text[start..start + NUMBERED.len() + 8]
}

/// Returns the name that the numbered function has to have: its number is a hash (FNV-1a) of all
/// declarations, without comments. So structures with other fields have another number.
fn expected_name(header: &str) -> String {
    let is_comment = |line: &&str| {
        let line = line.trim_start();
        ["//", "/*", "* "]
            .iter()
            .any(|start| line.starts_with(start))
    };
    let text = header.replace(numbered(header), NUMBERED);
    let lines = text.lines().filter(|line| !is_comment(line));
    let hash = lines
        .flat_map(str::bytes)
        .fold(0x811C_9DC5_u32, |hash, byte| {
            (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
        });
    format!("{NUMBERED}{hash:08x}")
}

/// Returns macros by which a program refers to the number of its header.
fn references(name: &str) -> String {
    let line = |start| {
        format!(
            "#define {start}(pipeline, settings) \\\n    ({name}(), {start}(pipeline, settings))\n"
        )
    };
    format!(
        "/* Each program refers to the number of its header: see {name}. */\n{}\n",
        STARTS.map(line).concat()
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
    let text = String::from_utf8(text).expect("a header is text");
    let end = text.rfind("#endif").expect("the guard ends");
    let (declarations, guard) = text.split_at(end);
    format!("{declarations}{}{guard}", references(numbered(&text)))
}

#[test]
fn the_header_is_that_of_the_code() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("include/aplomb.h");
    let mut made = header();
    let (name, expected) = (numbered(&made).to_owned(), expected_name(&made));
    if std::env::var_os("APLOMB_BLESS").is_some() {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs");
        let code = std::fs::read_to_string(&source).expect("the code can be read");
        std::fs::write(&source, code.replace(&name, &expected)).expect("and written");
        made = made.replace(&name, &expected);
        std::fs::write(&file, &made).expect("the header can be written");
    } else {
        assert_eq!(name, expected, "bless c/include/aplomb.h anew");
    }
    let committed = std::fs::read_to_string(&file).unwrap_or_default();
    assert_eq!(committed, made, "bless c/include/aplomb.h anew");
}

#[test]
fn another_structure_has_another_number() {
    let header = header();
    let name = expected_name(&header);
    for (text, other) in [
        ("  uint16_t low_pass_hz;\n", ""),
        ("  uint16_t low_pass_hz;\n", "  int16_t low_pass_hz;\n"),
        ("  uint8_t missed_before;\n", "  uint8_t lost_before;\n"),
    ] {
        assert!(header.contains(text), "{text}");
        assert_ne!(expected_name(&header.replace(text, other)), name, "{other}");
    }
    let other_number = header.replace(numbered(&header), &format!("{NUMBERED}01234567"));
    assert_eq!(expected_name(&other_number), name);
    let other_comment = header.replace("// Done.", "// Completed.");
    assert_ne!(other_comment, header);
    assert_eq!(expected_name(&other_comment), name);
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
