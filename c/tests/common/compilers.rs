//! Compilers of this computer for the programs in C. `cargo xtask test` names the absent ones.

use std::path::Path;
use std::process::Command;

/// Compiler, and the options of a language or of a sanitizer.
pub type Compiler = (&'static str, &'static [&'static str]);

const SANITIZERS: &[&str] = &[
    "-std=c99",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover",
];
const CPP: &[&str] = &["-x", "c++", "-std=c++11", "-Wno-missing-field-initializers"];

/// All compilers of the tests.
const ALL: [Compiler; 6] = [
    ("gcc", &["-std=c99"]),
    ("gcc", SANITIZERS),
    ("g++", CPP),
    ("clang", &["-std=c99"]),
    ("clang", SANITIZERS),
    ("clang++", CPP),
];

/// Returns the compilers that are on this computer, and those that are not. `empty` is the source
/// of an empty program, and `probe` a file to write.
pub fn compilers(empty: &Path, probe: &Path) -> (Vec<Compiler>, Vec<Compiler>) {
    let can_link = |(name, options): &Compiler| {
        let mut command = Command::new(name);
        command.args(*options).arg(empty).arg("-o").arg(probe);
        command.output().is_ok_and(|output| output.status.success())
    };
    ALL.into_iter().partition(can_link)
}
