//! Request to end the program: Ctrl-C, `kill`, or a terminal that is gone.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

/// Message of a command that Ctrl-C has ended before its result was complete.
pub const ENDED: &str = "it was ended with Ctrl-C";

/// The program has to end.
static IS_ASKED: AtomicBool = AtomicBool::new(false);

/// Returns a flag that is set when the program has to end. From the first call on the signals do
/// not end it by themselves.
///
/// # Errors
///
/// Returns the error of the system if the signals cannot be caught.
pub fn end_request() -> Result<&'static AtomicBool, String> {
    static HANDLER: OnceLock<Result<(), String>> = OnceLock::new();
    let handler = HANDLER.get_or_init(|| {
        let set = ctrlc::set_handler(|| IS_ASKED.store(true, Ordering::Relaxed));
        set.map_err(|error| format!("Ctrl-C cannot be caught: {error}"))
    });
    handler.clone().map(|()| &IS_ASKED)
}

/// Returns whether the program has to end, if [`end_request`] was called.
pub fn is_end_asked() -> bool {
    IS_ASKED.load(Ordering::Relaxed)
}
