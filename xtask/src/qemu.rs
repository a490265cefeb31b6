//! Runs of programs in QEMU's ARM machines.

use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use crate::limit;

/// Machine with the Cortex-M4F whose instructions are counted.
const COUNTING_MACHINE: &str = "netduinoplus2";

/// Longest run of a program; the usual ones take seconds. An image that hangs would hang all of CI.
const LIMIT: Duration = Duration::from_secs(600);

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
    let what = format!("{} in QEMU's machine {machine}", program.display());
    limit::output_within(LIMIT, &what, qemu.arg(program))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_hangs_is_stopped_and_named() {
        let run = |script: &str, limit| {
            let mut shell = Command::new("sh");
            limit::output_within(limit, "an image", shell.args(["-c", script]))
        };
        let error = run("echo begins; exec sleep 60", Duration::from_secs(1)).unwrap_err();
        assert_eq!(
            error,
            "an image hangs: stopped after 1 s. It printed: begins\n"
        );
        // More than a pipe holds.
        let output = run("head -c 300000 /dev/zero; echo no >&2; exit 3", LIMIT).unwrap();
        assert_eq!(output.stdout.len(), 300_000);
        assert_eq!(output.stderr, b"no\n");
        assert_eq!(output.status.code(), Some(3));
        let error = limit::output_within(LIMIT, "an image", &mut Command::new("/no/such"));
        assert!(error.is_err_and(|error| error.contains("an image: cannot run /no/such")));
    }
}
