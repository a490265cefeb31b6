//! Standard output of the programs.

use std::io::{self, ErrorKind, Write};
use std::sync::OnceLock;

/// First error of [`print_line`].
static LOST: OnceLock<io::Error> = OnceLock::new();

/// Prints a line. A closed pipe, as behind `head`, is no error; any other error is kept for
/// [`finish`].
pub fn print_line(text: &str) {
    let mut output = io::stdout();
    if let Err(error) = writeln!(output, "{text}").and_then(|()| output.flush())
        && error.kind() != ErrorKind::BrokenPipe
    {
        LOST.get_or_init(|| error);
    }
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
