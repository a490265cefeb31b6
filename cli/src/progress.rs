//! A bar that shows how much of a long file has been read.

use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};

use aplomb_recordings::log::{Lines, LogError};

/// Files from this size on take seconds.
const LONG_BYTES: u64 = 16 * 1024 * 1024;

/// Opens a file whose reading shows on a bar, if it is long and someone watches; `-` is standard input.
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
