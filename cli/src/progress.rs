//! Progress bars.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};

use aplomb_recordings::log::{Lines, LogError};

/// Size from which on reading takes seconds.
const LONG_BYTES: u64 = 16 * 1024 * 1024;

/// Opens a file, with a progress bar if it is long; `-` is standard input.
pub fn lines(path: &Path) -> Result<Lines, LogError> {
    if path == Path::new("-") {
        return Lines::read_from(Path::new("standard input"), std::io::stdin());
    }
    let length = std::fs::metadata(path).map_or(0, |data| data.len());
    let bar = if length < LONG_BYTES {
        ProgressBar::hidden()
    } else {
        let style = ProgressStyle::with_template("{wide_bar} {bytes} of {total_bytes}, {eta} left");
        ProgressBar::new(length).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    };
    Lines::open(path, |file| bar.wrap_read(file))
}

/// Creates a bar of this many steps.
pub fn bar(name: &'static str, length: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}");
    ProgressBar::new(length)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        .with_message(name)
}
