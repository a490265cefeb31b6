//! Writes the chosen board's memory sizes to `board.x` in the linker's search path. The root
//! `memory.x` includes that file.

use std::path::Path;
use std::{env, fs};

/// Boards, each with the file under `boards/` that holds its memory sizes.
const BOARDS: [(&str, &str); 5] = [
    ("CARGO_FEATURE_BOARD_STM32F405", "stm32f405.x"),
    ("CARGO_FEATURE_BOARD_BLACKPILL_F401", "stm32f401.x"),
    ("CARGO_FEATURE_BOARD_BLACKPILL_F411", "stm32f411.x"),
    ("CARGO_FEATURE_BOARD_NUCLEO_F411", "stm32f411.x"),
    ("CARGO_FEATURE_BOARD_NUCLEO_F446", "stm32f446.x"),
];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=boards");
    println!("cargo:rerun-if-changed=memory.x");
    let chosen: Vec<&str> = BOARDS
        .iter()
        .filter(|(feature, _)| env::var_os(feature).is_some())
        .map(|&(_, file)| file)
        .collect();
    let file = match chosen[..] {
        [] => return, // The library alone: whoever uses it brings their own linker scripts.
        [file] => file,
        _ => panic!("choose one of the features board-…, not {}", chosen.len()),
    };
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        println!(
            "cargo::error=a feature `board-…` is for the board's chip alone: add `--target \
             thumbv7em-none-eabihf`, or leave the feature out on a computer"
        );
        return;
    }
    let output = env::var("OUT_DIR").expect("cargo sets OUT_DIR for build scripts");
    fs::copy(
        Path::new("boards").join(file),
        Path::new(&output).join("board.x"),
    )
    .unwrap_or_else(|error| panic!("cannot copy boards/{file}: {error}"));
    println!("cargo:rustc-link-search={output}");
    println!("cargo:rustc-link-arg-bin=flight=-Tdefmt.x");
    println!("cargo:rustc-link-arg-examples=-Tdefmt.x");
}
