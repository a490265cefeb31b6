//! Running other programs, with progress and clear failures.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Work that this run has skipped.
static SKIPPED: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// A command that runs in the workspace's folder, free of what the outer cargo left in the
/// environment.
pub fn command(program: &Path) -> Command {
    let mut command = Command::new(program);
    command.current_dir(crate::root());
    for (name, _) in std::env::vars_os() {
        let name = name.to_string_lossy().into_owned();
        let of_this_run = name.starts_with("CARGO_PKG_")
            || name.starts_with("CARGO_MANIFEST_")
            || name == "CARGO"
            || name == "CARGO_CRATE_NAME"
            || name == "CARGO_BIN_NAME";
        if of_this_run {
            command.env_remove(name);
        }
    }
    command
}

/// Returns a cargo command for this computer. The emulator asks for a newer compiler than it needs.
pub fn host_cargo(subcommand: &str) -> Command {
    let mut cargo = command(Path::new("cargo"));
    cargo.args([subcommand, "--ignore-rust-version"]);
    cargo
}

/// Returns the folder of cargo's build products.
pub fn target_folder() -> PathBuf {
    match std::env::var_os("CARGO_TARGET_DIR") {
        Some(folder) => crate::root().join(folder),
        None => crate::root().join("target"),
    }
}

/// Runs a command with its output on this terminal.
pub fn run(command: &mut Command) -> Result<(), String> {
    let shown = describe(command);
    let status = command
        .status()
        .map_err(|error| format!("cannot run `{shown}`: {error}"))?;
    if status.success() {
        Ok(())
    } else {
        Err(format!("`{shown}` failed ({status})"))
    }
}

/// Runs a command and returns its output, or `None` if it failed.
pub fn output(command: &mut Command) -> Option<String> {
    let output = command.stderr(Stdio::null()).output().ok()?;
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Announces a step, does it, and reports how long it took.
pub fn timed<T>(what: &str, work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    eprintln!("\n── {what}");
    let start = Instant::now();
    let result = work()?;
    eprintln!("── {what}: done in {:.0} s", start.elapsed().as_secs_f64());
    Ok(result)
}

/// Reports that work is skipped, and the reason. [`summary`] names it again.
pub fn skip(work: &str, reason: &str) {
    eprintln!("   skipped: {work}, because {reason}");
    let mut skipped = SKIPPED.lock().unwrap_or_else(PoisonError::into_inner);
    skipped.push(work.to_owned());
}

/// Returns the last line of a run that has passed: its duration, and all work that it has skipped.
pub fn summary(start: Instant) -> String {
    let skipped = SKIPPED.lock().unwrap_or_else(PoisonError::into_inner);
    summary_of(start.elapsed().as_secs_f64(), &skipped)
}

fn summary_of(seconds: f64, skipped: &[String]) -> String {
    if skipped.is_empty() {
        return format!("all passed in {seconds:.0} s");
    }
    let skipped = skipped.join("; ");
    format!("passed in {seconds:.0} s; skipped: {skipped}")
}

/// Returns true if a program of this name is on the path.
pub fn is_installed(program: &str) -> bool {
    std::env::var_os("PATH").is_some_and(|path| {
        std::env::split_paths(&path).any(|folder| folder.join(program).is_file())
    })
}

fn describe(command: &Command) -> String {
    let mut text = Path::new(command.get_program())
        .file_name()
        .unwrap_or(command.get_program())
        .to_string_lossy()
        .into_owned();
    for argument in command.get_args() {
        text.push(' ');
        text.push_str(&argument.to_string_lossy());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_line_names_all_work_that_was_skipped() {
        assert_eq!(summary_of(59.6, &[]), "all passed in 60 s");
        let start = Instant::now();
        skip("one check", "a tool is not installed");
        skip("another", "there are no recordings");
        let line = summary(start);
        assert_eq!(line, "passed in 0 s; skipped: one check; another");
    }
}
