//! Request to end the program: Ctrl-C, `kill`, or a terminal that is gone.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Returns a flag that is set when the program has to end. Can be called once.
pub fn end_request() -> Result<Arc<AtomicBool>, ctrlc::Error> {
    let is_asked = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&is_asked);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))?;
    Ok(is_asked)
}
