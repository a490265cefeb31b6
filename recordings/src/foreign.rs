//! Files of other formats, by their first bytes.

/// First bytes of a gzip file.
pub(crate) const GZIP: [u8; 2] = [0x1F, 0x8B];

/// First bytes of formats that are no table, with their names and the way to a table.
const SIGNATURES: [(&[u8], &str); 10] = [
    (
        b"PK\x03\x04",
        "a ZIP archive or an Excel workbook: unpack it, or save the sheet as CSV",
    ),
    (&GZIP, "gzip inside gzip: unpack it once, with gunzip"),
    (b"BZh", "a bzip2 file: unpack it with bunzip2"),
    (b"\xFD7zXZ\0", "an xz file: unpack it with unxz"),
    (
        b"\x28\xB5\x2F\xFD",
        "a Zstandard file: unpack it with unzstd",
    ),
    (b"7z\xBC\xAF\x27\x1C", "a 7z archive: unpack it"),
    (
        b"\x89PNG\r\n\x1A\n",
        "a PNG picture: give the recording itself",
    ),
    (b"%PDF-", "a PDF document: give the recording itself"),
    (
        b"SQLite format 3\0",
        "an SQLite database: export a CSV file",
    ),
    (b"\x89HDF\r\n\x1A\n", "an HDF5 file: export a CSV file"),
];

/// UTF-16, with the way to a table.
const UTF_16: &str = "a UTF-16 text: save it as UTF-8 (in PowerShell with `| Out-File -Encoding \
                      utf8`, in Excel as \"CSV UTF-8\")";

/// Characters that show UTF-16. A flight log with a zero in every other byte has no frame.
const UTF_16_CHARACTERS: usize = 6;

/// Returns the name of the format of these first bytes, with what to do, if they are neither a
/// table's nor a flight log's.
pub(crate) fn format_of(bytes: &[u8]) -> Option<&'static str> {
    let mut signatures = SIGNATURES.iter();
    if let Some((_, name)) = signatures.find(|(signature, _)| bytes.starts_with(signature)) {
        return Some(name);
    }
    let text = match bytes {
        [0xFF, 0xFE, text @ ..] | [0xFE, 0xFF, text @ ..] => text,
        _ => bytes,
    };
    let mut pairs = text.as_chunks::<2>().0.iter().take(UTF_16_CHARACTERS);
    let is_letter = |byte: u8| byte.is_ascii_graphic() || byte.is_ascii_whitespace();
    let is_utf_16 = pairs.len() == UTF_16_CHARACTERS
        && (pairs.clone().all(|pair| pair[1] == 0 && is_letter(pair[0]))
            || pairs.all(|pair| pair[0] == 0 && is_letter(pair[1])));
    is_utf_16.then_some(UTF_16)
}
