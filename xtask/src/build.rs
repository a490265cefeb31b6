//! Builds the firmware for a board, the virtual board, and the program `aplomb`.

use std::path::PathBuf;

use crate::setup::{TARGET, Toolchain};
use crate::step::{self, target_folder};

/// A board's name and chip.
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

    /// The cargo features of the full firmware with compass.
    pub fn features(self) -> String {
        format!("compass,board-{}", self.name)
    }
}

/// Returns true if this names a mount, before minutes of building: two signed axes at right angles,
/// or an alias.
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
    /// Parts that it has.
    pub kind: Kind,
}

/// Parts of a build of the firmware.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Everything.
    Full,
    /// Everything but the compass.
    WithoutCompass,
    /// Neither commands nor MAVLink, flight log and compass.
    Minimal,
}

impl Kind {
    /// The cargo features for a board.
    fn features(self, board: Board) -> String {
        match self {
            Self::Full => board.features(),
            Self::WithoutCompass => format!("full,{}", board.feature()),
            Self::Minimal => board.feature(),
        }
    }

    /// The name for messages, and the end of the file's name.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Full => ("firmware", ""),
            Self::WithoutCompass => ("firmware without compass", "-without-compass"),
            Self::Minimal => ("minimal firmware", "-minimal"),
        }
    }
}

impl Firmware {
    /// The full firmware for a board, with the default mount.
    pub fn full(board: Board) -> Self {
        Self {
            board,
            mount: None,
            kind: Kind::Full,
        }
    }

    /// The firmware without compass for a board, with the default mount.
    pub fn without_compass(board: Board) -> Self {
        Self {
            kind: Kind::WithoutCompass,
            ..Self::full(board)
        }
    }

    /// The minimal firmware for a board, with the default mount.
    pub fn minimal(board: Board) -> Self {
        Self {
            kind: Kind::Minimal,
            ..Self::full(board)
        }
    }

    /// Builds it and returns the ELF file, which a build for another board or mount does not
    /// replace.
    pub fn build(&self, toolchain: &Toolchain) -> Result<PathBuf, String> {
        let (kind, end) = self.kind.names();
        let features = self.kind.features(self.board);
        step::timed(
            &format!("building the {kind} for {}", self.board.name),
            || {
                let mut cargo = toolchain.cargo("build");
                cargo.args([
                    "--profile",
                    "firmware",
                    "--bin",
                    "flight",
                    "--features",
                    &features,
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
                    &format!("flight-{}{end}-{mount}", self.board.name),
                )
            },
        )
    }
}

/// Builds the virtual board's program.
pub fn virtual_board() -> Result<PathBuf, String> {
    step::timed("building the virtual board", || {
        host_program("virtual-board")
    })
}

/// Builds the program `aplomb`.
pub fn program() -> Result<PathBuf, String> {
    host_program("aplomb")
}

/// Builds the program `aplomb-bench`.
pub fn bench() -> Result<PathBuf, String> {
    host_program("aplomb-bench")
}

/// Builds a program, with the same features of its dependencies as the tests of the workspace:
/// otherwise the emulator and its compiler would be built twice.
fn host_program(program: &str) -> Result<PathBuf, String> {
    let mut build = step::host_cargo("build");
    build.args(["--release", "--workspace", "--bin", program]);
    // A small test: only beside a test does cargo count the features of the tests' dependencies.
    step::run(build.args(["--test", "qemu"]))?;
    Ok(target_folder().join("release").join(program))
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

    /// The places that a new board has to be added to, beside those where the build fails without
    /// it.
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
