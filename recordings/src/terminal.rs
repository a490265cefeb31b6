//! Standard output and standard error of the programs.
//!
//! If a program writes its output file to standard output, its messages go to standard error. A
//! terminal that is closed, or a reader that has ended, stops no program: the message is lost.

use std::io::{self, ErrorKind, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

/// Standard output is taken by an output file.
static IS_TAKEN: AtomicBool = AtomicBool::new(false);

/// First error of [`print_line`].
static LOST: OnceLock<io::Error> = OnceLock::new();

/// Prints a line. A closed pipe, as behind `head`, is no error; any other error is kept for
/// [`finish`].
pub fn print_line(text: &str) {
    if IS_TAKEN.load(Ordering::Relaxed) {
        return print_message(text);
    }
    let mut output = io::stdout();
    if let Err(error) = writeln!(output, "{text}").and_then(|()| output.flush())
        && error.kind() != ErrorKind::BrokenPipe
    {
        LOST.get_or_init(|| error);
    }
}

/// Prints a line on standard error. If that is closed, the line is lost: `eprintln!` would panic.
pub fn print_message(text: &str) {
    print_status(&format!("{text}\n"));
}

/// Prints a text on standard error as it is, such as a line that the next one replaces.
pub fn print_status(text: &str) {
    let mut output = io::stderr();
    output
        .write_all(text.as_bytes())
        .and_then(|()| output.flush())
        .ok();
}

/// Prints to standard error from now on, because standard output is an output file.
pub fn use_standard_error() {
    IS_TAKEN.store(true, Ordering::Relaxed);
}

/// Returns whether every line was printed.
///
/// # Errors
///
/// Returns the first error, such as a full disk, as a message.
pub fn finish() -> Result<(), String> {
    LOST.get().map_or(Ok(()), |error| {
        Err(format!("standard output cannot be written: {error}"))
    })
}
