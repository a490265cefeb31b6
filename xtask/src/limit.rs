//! Programs with a time limit, so that one that hangs does not hang all of CI.
//!
//! `rigs/tests/qemu.rs` includes this file too.

use std::io::Read;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Time between two checks of whether the program has ended.
const CHECK_PERIOD: Duration = Duration::from_millis(5);

/// Runs a program and returns its output. `what` names its work in errors.
///
/// Stops the program at the limit. The error then has what it printed before.
pub fn output_within(limit: Duration, what: &str, command: &mut Command) -> Result<Output, String> {
    let program = command.get_program().to_owned();
    let fail = |error| format!("{what}: cannot run {}: {error}", program.display());
    command.stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(fail)?;
    let stdout = child.stdout.take().map(collect);
    let stderr = child.stderr.take().map(collect);
    let status = wait(&mut child, limit).map_err(fail)?;
    if status.is_none() {
        let _ = child.kill();
        let _ = child.wait();
    }
    let bytes = |reader: Option<JoinHandle<Vec<u8>>>| {
        reader
            .and_then(|reader| reader.join().ok())
            .unwrap_or_default()
    };
    let (stdout, stderr) = (bytes(stdout), bytes(stderr));
    match status {
        Some(status) => Ok(Output {
            status,
            stdout,
            stderr,
        }),
        None => Err(format!(
            "{what} hangs: stopped after {} s. It printed: {}{}",
            limit.as_secs(),
            String::from_utf8_lossy(&stdout),
            String::from_utf8_lossy(&stderr)
        )),
    }
}

/// Reads until the end, in a thread of its own, so that a full pipe does not stop the program.
fn collect(mut pipe: impl Read + Send + 'static) -> JoinHandle<Vec<u8>> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        let _ = pipe.read_to_end(&mut bytes);
        bytes
    })
}

/// Waits until the program ends; `None` if it does not within the limit.
fn wait(child: &mut Child, limit: Duration) -> std::io::Result<Option<ExitStatus>> {
    let deadline = Instant::now() + limit;
    loop {
        let status = child.try_wait()?;
        if status.is_some() || Instant::now() >= deadline {
            return Ok(status);
        }
        thread::sleep(CHECK_PERIOD);
    }
}
