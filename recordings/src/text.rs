//! Small text files: scripts and schedules.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Bytes of the largest small file.
const LARGEST_BYTES: u64 = 1024 * 1024;

/// Reads a text of at most a mebibyte.
///
/// # Errors
///
/// Returns an error if the file cannot be read, is no UTF-8, or is larger.
pub fn read_small(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    let length = File::open(path)?
        .take(LARGEST_BYTES + 1)
        .read_to_string(&mut text)?;
    if length as u64 > LARGEST_BYTES {
        let reason = format!("it has more than {LARGEST_BYTES} bytes");
        return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_without_end_is_refused() {
        let error = read_small(Path::new("/dev/zero")).expect_err("it has no end");
        assert_eq!(error.to_string(), "it has more than 1048576 bytes");
    }
}
