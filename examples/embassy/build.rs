//! Adds the linker script of the log. `memory.x` lies beside this file; `-Tlink.x` comes from the
//! project's `.cargo/config.toml`.

fn main() {
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
}
