//! Runs of programs in QEMU's ARM machines.

use std::path::Path;
use std::process::{Command, Output};

/// Machine with the Cortex-M4F whose instructions are counted.
const COUNTING_MACHINE: &str = "netduinoplus2";

/// Runs a program that counts its instructions: the machine's clock advances by one nanosecond an
/// instruction. Returns the program's output through semihosting.
pub fn run_counting(program: &Path) -> Result<Output, String> {
    let options = ["-display", "none", "-serial", "null"];
    let counting = ["-icount", "shift=0,sleep=off"];
    run(
        COUNTING_MACHINE,
        &[options.as_slice(), &counting].concat(),
        program,
    )
}

/// Runs a program on this machine without a serial port. Returns the program's output through
/// semihosting.
pub fn run_on(machine: &str, program: &Path) -> Result<Output, String> {
    run(machine, &["-nographic", "-serial", "none"], program)
}

fn run(machine: &str, options: &[&str], program: &Path) -> Result<Output, String> {
    let mut qemu = Command::new("qemu-system-arm");
    qemu.args(["-M", machine, "-monitor", "none"]).args(options);
    qemu.args(["-semihosting-config", "enable=on,target=native", "-kernel"]);
    let output = qemu.arg(program).output();
    output.map_err(|error| format!("cannot run qemu-system-arm: {error}"))
}
