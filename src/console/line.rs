//! Line assembler: turns received bytes into lines of at most [`LINE_CAPACITY`] bytes.
//!
//! A line ends with CR, LF or both, and holds printable ASCII. A tab counts as a blank, and
//! backspace removes the last character. A line that is too long, or has any other byte in it, is
//! dropped whole: half a command is none.
//! Noise alone, without a character, is forgotten after a pause.
//!
//! ```
//! use aplomb::console::line::LineAssembler;
//!
//! let mut assembler = LineAssembler::new();
//! let lines: Vec<_> = b"rate 5\x080\r\n"
//!     .iter()
//!     .filter_map(|byte| assembler.push(*byte).map(|line| line.map(str::to_owned)))
//!     .collect();
//! assert_eq!(lines, [Ok("rate 0".to_owned())]);
//! ```

use core::fmt;

/// Length of the longest line without its end, in bytes.
pub const LINE_CAPACITY: usize = 64;

/// Reason why a line was dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LineError {
    /// The line is longer than [`LINE_CAPACITY`].
    TooLong,
    /// The line has bytes that are not printable: the baud rates differ, or the line is noisy.
    Unreadable,
}

impl fmt::Display for LineError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong => write!(formatter, "the line is longer than {LINE_CAPACITY} bytes"),
            Self::Unreadable => formatter
                .write_str("the line has bytes that are not printable: is the baud rate right?"),
        }
    }
}

impl core::error::Error for LineError {}

/// Assembler of one line at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineAssembler {
    bytes: [u8; LINE_CAPACITY],
    length: usize,
    error: Option<LineError>,
    /// True if the last byte ended a line.
    is_complete: bool,
}

impl LineAssembler {
    /// Creates an assembler with an empty line.
    pub const fn new() -> Self {
        Self {
            bytes: [0; LINE_CAPACITY],
            length: 0,
            error: None,
            is_complete: false,
        }
    }

    /// Adds a byte. A byte that ends a line returns it, or the reason why it was dropped; an empty
    /// line returns nothing.
    pub fn push(&mut self, byte: u8) -> Option<Result<&str, LineError>> {
        if core::mem::take(&mut self.is_complete) {
            self.length = 0;
            self.error = None;
        }
        match byte {
            b'\r' | b'\n' => return self.complete(),
            // Terminals send either for backspace.
            0x08 | 0x7F => self.length = self.length.saturating_sub(1),
            b' '..=b'~' => self.append(byte),
            b'\t' => self.append(b' '),
            _ => self.discard_line(),
        }
        None
    }

    /// Drops the line under way, because the receiver has reported an error.
    pub fn discard_line(&mut self) {
        if core::mem::take(&mut self.is_complete) {
            self.length = 0;
        }
        self.error = Some(LineError::Unreadable);
    }

    /// Forgets the line under way if noise is all that it has. A line of which characters are left
    /// stays dropped up to its end: half a command is none. A beginning that is garbled whole is
    /// noise, and is forgotten too. Call it after a pause.
    pub fn forget_noise(&mut self) {
        if self.length == 0 && !self.is_complete {
            self.error = None;
        }
    }

    fn append(&mut self, byte: u8) {
        match self.bytes.get_mut(self.length) {
            Some(place) => {
                *place = byte;
                self.length += 1;
            }
            None => {
                self.error.get_or_insert(LineError::TooLong);
            }
        }
    }

    fn complete(&mut self) -> Option<Result<&str, LineError>> {
        self.is_complete = true;
        if let Some(error) = self.error {
            return Some(Err(error));
        }
        // Only ASCII is appended.
        let text = core::str::from_utf8(self.bytes.get(..self.length)?).ok()?;
        let text = text.trim_ascii();
        (!text.is_empty()).then_some(Ok(text))
    }
}

impl Default for LineAssembler {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Lines of a text; the reason for each dropped one.
    fn lines(bytes: &[u8]) -> Vec<Result<String, LineError>> {
        let mut assembler = LineAssembler::new();
        let mut lines = Vec::new();
        for &byte in bytes {
            lines.extend(assembler.push(byte).map(|line| line.map(str::to_owned)));
        }
        lines
    }

    fn line(text: &str) -> Result<String, LineError> {
        Ok(text.to_owned())
    }

    #[test]
    fn any_line_end_ends_a_line_once() {
        let expected = [line("status"), line("show")];
        for end in ["\r", "\n", "\r\n"] {
            let text = format!("status{end}{end}{end}  show\t{end}");
            assert_eq!(lines(text.as_bytes()), expected, "{end:?}");
        }
        assert_eq!(lines(b"status"), []);
    }

    #[test]
    fn backspace_removes_a_character() {
        assert_eq!(lines(b"x\x08\x08\x7fsage\x08\x08ve\n"), [line("save")]);
    }

    #[test]
    fn an_unprintable_byte_drops_its_line_and_no_other() {
        let text = b"sa\x00ve\nsave\n\xFFsave\nsave\x1b\nhelp\n";
        let unreadable = Err(LineError::Unreadable);
        assert_eq!(
            lines(text),
            [
                unreadable.clone(),
                line("save"),
                unreadable.clone(),
                unreadable,
                line("help")
            ]
        );
    }

    #[test]
    fn a_line_of_64_characters_fits_and_a_longer_one_is_dropped() {
        let longest = "x".repeat(LINE_CAPACITY);
        assert_eq!(
            lines(format!("{longest}\n{longest}y\nshow\n").as_bytes()),
            [line(&longest), Err(LineError::TooLong), line("show")]
        );
        // Backspace does not restore a line that has lost its end.
        assert_eq!(
            lines(format!("{longest}yz\x08\x08\n").as_bytes()),
            [Err(LineError::TooLong)]
        );
    }

    #[test]
    fn an_error_of_the_receiver_drops_the_line_it_falls_into() {
        let mut assembler = LineAssembler::new();
        assert!(b"sav".iter().all(|&byte| assembler.push(byte).is_none()));
        assembler.discard_line();
        assert_eq!(assembler.push(b'e'), None);
        assert_eq!(assembler.push(b'\n'), Some(Err(LineError::Unreadable)));
        // Between two lines, the next one.
        assembler.discard_line();
        assert_eq!(assembler.push(b'\n'), Some(Err(LineError::Unreadable)));
        assert_eq!(assembler.push(b'x'), None);
        assert_eq!(assembler.push(b'\n'), Some(Ok("x")));
    }

    proptest! {
        /// The oracle splits the whole text at once.
        #[test]
        fn lines_are_those_between_the_line_ends(
            bytes in proptest::collection::vec(
                prop_oneof![
                    4 => b' '..=b'~',
                    2 => Just(b'\n'),
                    1 => Just(b'\r'),
                    1 => 0x80..=0xFF_u8,
                ],
                0..300,
            ),
        ) {
            let oracle = |line: &[u8]| match core::str::from_utf8(line) {
                Ok(text) if text.len() > LINE_CAPACITY => Some(Err(LineError::TooLong)),
                Ok(text) if text.trim().is_empty() => None,
                Ok(text) => Some(Ok(text.trim().to_owned())),
                Err(_) => Some(Err(LineError::Unreadable)),
            };
            let expected: Vec<_> = bytes
                .split_inclusive(|byte| matches!(byte, b'\r' | b'\n'))
                .filter_map(|line| line.split_last())
                .filter(|(end, _)| matches!(end, b'\r' | b'\n'))
                .filter_map(|(_, line)| oracle(line))
                .collect();
            let is_same = |(got, expected): (&Result<String, _>, &Result<String, _>)| {
                got.as_ref().ok() == expected.as_ref().ok()
            };
            let got = lines(&bytes);
            // Bytes above 0x7F that happen to be UTF-8 are unreadable too.
            prop_assume!(bytes.split(|byte| matches!(byte, b'\r' | b'\n'))
                .all(|line| line.is_ascii() || core::str::from_utf8(line).is_err()));
            prop_assert_eq!(got.len(), expected.len());
            prop_assert!(got.iter().zip(&expected).all(is_same));
        }
    }
}
