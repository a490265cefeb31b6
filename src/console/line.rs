//! Bytes in, lines out: whatever the wire brings, at most [`LINE_CAPACITY`] bytes are kept.
//!
//! A line ends with CR, LF or both, and holds printable ASCII; a tab counts as a blank, and backspace takes the last
//! character back. A line that is too long, or with any other byte in it, is dropped whole: half a command is none.

/// The longest line, its end not counted.
pub const LINE_CAPACITY: usize = 64;

/// Why a line was dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Spoiled {
    /// It is longer than [`LINE_CAPACITY`].
    TooLong,
    /// It has bytes that nobody types: the baud rates differ, or the line is noisy.
    Unreadable,
}

/// A line in the making.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineAssembler {
    bytes: [u8; LINE_CAPACITY],
    length: usize,
    spoiled: Option<Spoiled>,
    /// The byte before ended a line, so that the next one begins anew.
    is_complete: bool,
}

impl LineAssembler {
    /// An empty line.
    pub const fn new() -> Self {
        Self {
            bytes: [0; LINE_CAPACITY],
            length: 0,
            spoiled: None,
            is_complete: false,
        }
    }

    /// Takes a byte. If it ends a line with something in it, gives that line, or why it was dropped.
    pub fn push(&mut self, byte: u8) -> Option<Result<&str, Spoiled>> {
        if core::mem::take(&mut self.is_complete) {
            self.length = 0;
            self.spoiled = None;
        }
        match byte {
            b'\r' | b'\n' => return self.complete(),
            // What terminals send for backspace.
            0x08 | 0x7F => self.length = self.length.saturating_sub(1),
            b' '..=b'~' => self.append(byte),
            b'\t' => self.append(b' '),
            _ => self.spoil(),
        }
        None
    }

    /// The receiver has seen an error: what it holds of this line is not what was sent.
    pub fn spoil(&mut self) {
        if core::mem::take(&mut self.is_complete) {
            self.length = 0;
        }
        self.spoiled = Some(Spoiled::Unreadable);
    }

    fn append(&mut self, byte: u8) {
        match self.bytes.get_mut(self.length) {
            Some(place) => {
                *place = byte;
                self.length += 1;
            }
            None => {
                self.spoiled.get_or_insert(Spoiled::TooLong);
            }
        }
    }

    fn complete(&mut self) -> Option<Result<&str, Spoiled>> {
        self.is_complete = true;
        if let Some(spoiled) = self.spoiled {
            return Some(Err(spoiled));
        }
        // What was appended is ASCII.
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

    /// The lines in a text, dropped ones as their reason.
    fn lines(bytes: &[u8]) -> Vec<Result<String, Spoiled>> {
        let mut assembler = LineAssembler::new();
        let mut lines = Vec::new();
        for &byte in bytes {
            lines.extend(assembler.push(byte).map(|line| line.map(str::to_owned)));
        }
        lines
    }

    fn line(text: &str) -> Result<String, Spoiled> {
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
    fn backspace_takes_a_character_back() {
        assert_eq!(lines(b"x\x08\x08\x7fsage\x08\x08ve\n"), [line("save")]);
    }

    #[test]
    fn what_nobody_types_spoils_its_line_and_no_other() {
        let text = b"sa\x00ve\nsave\n\xFFsave\nsave\x1b\nhelp\n";
        let unreadable = Err(Spoiled::Unreadable);
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
    fn a_line_of_64_characters_fits_and_one_more_is_dropped() {
        let longest = "x".repeat(LINE_CAPACITY);
        assert_eq!(
            lines(format!("{longest}\n{longest}y\nshow\n").as_bytes()),
            [line(&longest), Err(Spoiled::TooLong), line("show")]
        );
        // What is taken back does not mend a line that has lost its end.
        assert_eq!(
            lines(format!("{longest}yz\x08\x08\n").as_bytes()),
            [Err(Spoiled::TooLong)]
        );
    }

    #[test]
    fn an_error_of_the_receiver_spoils_the_line_it_falls_into() {
        let mut assembler = LineAssembler::new();
        assert!(b"sav".iter().all(|&byte| assembler.push(byte).is_none()));
        assembler.spoil();
        assert_eq!(assembler.push(b'e'), None);
        assert_eq!(assembler.push(b'\n'), Some(Err(Spoiled::Unreadable)));
        // Between two lines, the next one.
        assembler.spoil();
        assert_eq!(assembler.push(b'\n'), Some(Err(Spoiled::Unreadable)));
        assert_eq!(assembler.push(b'x'), None);
        assert_eq!(assembler.push(b'\n'), Some(Ok("x")));
    }

    proptest! {
        /// The oracle splits the whole text at once.
        #[test]
        fn lines_are_those_between_the_line_ends(bytes in proptest::collection::vec(
            prop_oneof![4 => b' '..=b'~', 2 => Just(b'\n'), 1 => Just(b'\r'), 1 => 0x80..=0xFF_u8], 0..300))
        {
            let expected: Vec<_> = bytes
                .split_inclusive(|byte| matches!(byte, b'\r' | b'\n'))
                .filter_map(|line| line.split_last())
                .filter(|(end, _)| matches!(end, b'\r' | b'\n'))
                .filter_map(|(_, line)| match core::str::from_utf8(line) {
                    Ok(text) if text.len() > LINE_CAPACITY => Some(Err(Spoiled::TooLong)),
                    Ok(text) => Some(text.trim()).filter(|text| !text.is_empty()).map(|text| Ok(text.to_owned())),
                    Err(_) => Some(Err(Spoiled::Unreadable)),
                })
                .collect();
            let is_same = |got: &Result<String, Spoiled>, expected: &Result<String, Spoiled>| match (got, expected) {
                (Ok(got), Ok(expected)) => got == expected,
                (got, expected) => got.is_err() && expected.is_err(),
            };
            let got = lines(&bytes);
            // Bytes above 0x7F that happen to be UTF-8 are unreadable all the same.
            prop_assume!(bytes.split(|byte| matches!(byte, b'\r' | b'\n'))
                .all(|line| line.is_ascii() || core::str::from_utf8(line).is_err()));
            prop_assert_eq!(got.len(), expected.len());
            prop_assert!(got.iter().zip(&expected).all(|(got, expected)| is_same(got, expected)));
        }
    }
}
