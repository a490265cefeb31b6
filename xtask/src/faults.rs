//! `cargo xtask faults`: the campaign of flights with faults by chance on the virtual board.

use std::path::Path;

use crate::build::{self, Board, Firmware};
use crate::setup::Toolchain;
use crate::step;

/// Builds the programs and passes the arguments on.
pub fn run(arguments: &[String]) -> Result<(), String> {
    let virtual_board = build::virtual_board()?;
    if arguments.iter().any(|a| a == "--help" || a == "-h") {
        return step::run(step::command(&virtual_board).arg("faults").args(arguments));
    }
    let elf = Firmware::full(Board::default()).build(&Toolchain::for_target()?)?;
    let mut faults = step::command(&virtual_board);
    step::run(faults.arg("faults").args(arguments).arg("--elf").arg(elf))
}

/// Flies the default campaign.
pub fn fly_default(virtual_board: &Path, elf: &Path) -> Result<(), String> {
    let mut faults = step::command(virtual_board);
    step::run(faults.args(["faults", "--elf"]).arg(elf))
}
