//! Small text files: scripts and schedules.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use crate::foreign::format_of;

/// Bytes of the largest small file.
const LARGEST_BYTES: u64 = 1024 * 1024;

/// Reads a text of at most a mebibyte.
///
/// # Errors
///
/// Returns an error if the file cannot be read, is no UTF-8, or is larger.
pub fn read_small(path: &Path) -> io::Result<String> {
    let mut bytes = Vec::new();
    File::open(path)?
        .take(LARGEST_BYTES + 1)
        .read_to_end(&mut bytes)?;
    let refuse = |reason: String| io::Error::new(io::ErrorKind::InvalidData, reason);
    if bytes.len() as u64 > LARGEST_BYTES {
        return Err(refuse(format!("it has more than {LARGEST_BYTES} bytes")));
    }
    if let Some(format) = format_of(&bytes) {
        return Err(refuse(format!("it is {format}")));
    }
    let not_text = |_| refuse("it is not UTF-8 text: save it as UTF-8".to_owned());
    let text = String::from_utf8(bytes).map_err(not_text)?;
    // Some programs begin a text with the byte order mark, which is invisible.
    Ok(match text.strip_prefix('\u{FEFF}') {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_order_mark_is_left_out_and_utf_16_is_named() {
        let path = std::env::temp_dir().join(format!("aplomb-text-{}", std::process::id()));
        let read = |bytes: Vec<u8>| {
            std::fs::write(&path, bytes).expect("it can be written");
            read_small(&path).map_err(|error| error.to_string())
        };
        assert_eq!(read(b"\xEF\xBB\xBF{}".to_vec()).as_deref(), Ok("{}"));
        let utf_16 = "\u{FEFF}{\"compass\":1}".encode_utf16();
        let refused = read(utf_16.flat_map(u16::to_le_bytes).collect());
        assert!(refused.is_err_and(|error| error.starts_with("it is a UTF-16 text: save it")));
        let refused = read(b"\xE4".to_vec());
        assert!(refused.is_err_and(|error| error.contains("save it as UTF-8")));
        std::fs::remove_file(&path).expect("it is there");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_without_end_is_refused() {
        let error = read_small(Path::new("/dev/zero")).expect_err("it has no end");
        assert_eq!(error.to_string(), "it has more than 1048576 bytes");
    }
}
