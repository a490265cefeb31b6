//! The linker script of the log. `memory.x` lies beside this; `-Tlink.x` comes from the project's `.cargo/config.toml`.

fn main() {
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
}
