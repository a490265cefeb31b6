//! Builds the firmware for a board, the virtual board, and the program `aplomb`.

use std::path::PathBuf;

use crate::setup::{TARGET, Toolchain};
use crate::step;

/// What differs between boards on this side.
#[derive(Clone, Copy)]
pub struct Board {
    /// The name after `--board`; the cargo feature is `board-` and this.
    pub name: &'static str,
    /// The chip, as probe-rs names it.
    pub chip: &'static str,
}

/// Every board, the default one first.
pub const BOARDS: [Board; 5] = [
    Board {
        name: "stm32f405",
        chip: "STM32F405RG",
    },
    Board {
        name: "blackpill-f401",
        chip: "STM32F401CC",
    },
    Board {
        name: "blackpill-f411",
        chip: "STM32F411CE",
    },
    Board {
        name: "nucleo-f411",
        chip: "STM32F411RE",
    },
    Board {
        name: "nucleo-f446",
        chip: "STM32F446RE",
    },
];

impl Default for Board {
    fn default() -> Self {
        BOARDS[0]
    }
}

impl Board {
    /// The board of this name.
    pub fn from_name(name: &str) -> Result<Self, String> {
        BOARDS
            .into_iter()
            .find(|board| board.name == name)
            .ok_or_else(|| {
                let names: Vec<&str> = BOARDS.iter().map(|board| board.name).collect();
                format!(
                    "there is no board `{name}`: choose one of {}",
                    names.join(", ")
                )
            })
    }

    /// The cargo feature that builds for it.
    pub fn feature(self) -> String {
        format!("board-{}", self.name)
    }
}

/// Whether this names a mount, before minutes of building: two signed axes at right angles, or an alias.
pub fn is_mount(name: &str) -> bool {
    let is_axis = |sign, axis| b"+-".contains(&sign) && b"xyz".contains(&axis);
    match *name.as_bytes() {
        [sign, forward, down_sign, down] => {
            name == "z-up" || is_axis(sign, forward) && is_axis(down_sign, down) && forward != down
        }
        _ => name == "z-down",
    }
}

/// One build of the firmware.
pub struct Firmware {
    /// The board.
    pub board: Board,
    /// The mount that is compiled in, or the default.
    pub mount: Option<String>,
}

impl Firmware {
    /// Builds it and returns the ELF file, which a build for another board or mount does not replace.
    pub fn build(&self, toolchain: &Toolchain) -> Result<PathBuf, String> {
        step::timed(
            &format!("building the firmware for {}", self.board.name),
            || {
                let mut cargo = toolchain.cargo("build");
                cargo.args([
                    "--profile",
                    "firmware",
                    "--bin",
                    "flight",
                    "--features",
                    &self.board.feature(),
                ]);
                match &self.mount {
                    Some(mount) => cargo.env("APLOMB_MOUNT", mount),
                    None => cargo.env_remove("APLOMB_MOUNT"),
                };
                step::run(&mut cargo)?;
                let mount = self.mount.as_deref().unwrap_or("default");
                keep(
                    "firmware",
                    "flight",
                    &format!("flight-{}-{mount}", self.board.name),
                )
            },
        )
    }
}

/// Builds the virtual board's program.
pub fn virtual_board() -> Result<PathBuf, String> {
    step::timed("building the virtual board", || {
        step::run(
            // The emulator asks for a newer compiler than it needs.
            step::command("cargo".as_ref()).args([
                "build",
                "--profile",
                "host",
                "-p",
                "virtual-board",
                "--ignore-rust-version",
            ]),
        )
    })?;
    Ok(target_folder().join("host/virtual-board"))
}

/// Builds the program `aplomb`.
pub fn program() -> Result<PathBuf, String> {
    step::run(step::command("cargo".as_ref()).args([
        "build",
        "--profile",
        "host",
        "-p",
        "aplomb-cli",
        "--ignore-rust-version",
    ]))?;
    Ok(target_folder().join("host/aplomb"))
}

/// Builds the program `aplomb-bench`.
pub fn bench() -> Result<PathBuf, String> {
    step::run(step::command("cargo".as_ref()).args([
        "build",
        "--profile",
        "host",
        "-p",
        "aplomb-bench",
        "--ignore-rust-version",
    ]))?;
    Ok(target_folder().join("host/aplomb-bench"))
}

/// Copies a program for the target to `target/firmware/<name>.elf`.
pub fn keep(profile: &str, program: &str, name: &str) -> Result<PathBuf, String> {
    let folder = target_folder().join("firmware");
    let built = target_folder().join(TARGET).join(profile).join(program);
    let kept = folder.join(format!("{name}.elf"));
    std::fs::create_dir_all(&folder)
        .and_then(|()| std::fs::copy(&built, &kept))
        .map_err(|error| {
            format!(
                "cannot copy {} to {}: {error}",
                built.display(),
                kept.display()
            )
        })?;
    Ok(kept)
}

/// Where cargo puts what it builds.
pub fn target_folder() -> PathBuf {
    match std::env::var_os("CARGO_TARGET_DIR") {
        Some(folder) => crate::root().join(folder),
        None => crate::root().join("target"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mounts_are_24_and_two_aliases() {
        let mut mounts = 0;
        for forward in ["+x", "-x", "+y", "-y", "+z", "-z"] {
            for down in ["+x", "-x", "+y", "-y", "+z", "-z"] {
                mounts += u32::from(is_mount(&format!("{forward}{down}")));
            }
        }
        assert_eq!(mounts, 24);
        assert!(is_mount("z-up") && is_mount("z-down"));
        assert!(!is_mount("up") && !is_mount("x+z+") && !is_mount(""));
    }

    /// The places that a new board has to be added to, beside those where the build fails without it.
    #[test]
    fn boards_are_named_wherever_boards_are_listed() {
        let read = |file: &str| std::fs::read_to_string(crate::root().join(file)).expect(file);
        let (page, embed) = (read("docs/first-board.md"), read("Embed.toml"));
        let list = crate::USAGE.rsplit_once("boards: ").expect("a list").1;
        for Board { name, chip } in BOARDS {
            assert!(list.contains(name), "{name} in the usage");
            let row = page
                .lines()
                .find(|line| line.starts_with(&format!("| `{name}` |")));
            assert!(
                row.is_some_and(|row| row.contains(chip)),
                "{name} in docs/first-board.md"
            );
            let section = if name == Board::default().name {
                "default"
            } else {
                name
            };
            let section = format!("[{section}.general]\nchip = \"{chip}\"");
            assert!(embed.contains(&section), "{section} in Embed.toml");
        }
    }
}
