//! Puts the memory sizes of QEMU's chip where the linker finds them as `board.x`, which the
//! workspace's `memory.x` includes.

use std::path::Path;
use std::{env, fs};

/// Chip of `-M netduinoplus2`: STM32F405.
const SIZES: &str = "../boards/stm32f405.x";

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed={SIZES}");
    println!("cargo:rerun-if-changed=../memory.x");
    let output = env::var("OUT_DIR").expect("cargo sets OUT_DIR for build scripts");
    fs::copy(SIZES, Path::new(&output).join("board.x"))
        .unwrap_or_else(|error| panic!("cannot copy {SIZES}: {error}"));
    println!("cargo:rustc-link-search={output}");
}
