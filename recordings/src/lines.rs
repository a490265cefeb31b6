//! Lines of a file, plain or gzipped.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use aplomb::estimator::kalman::AccelerometerKnowledge;
use flate2::bufread::MultiGzDecoder;

use crate::columns::Order;
use crate::fault::{LONGEST_LINE, LogError, LogFault};
use crate::foreign::{GZIP, format_of};
use crate::quote::quote;
use crate::statement::Statements;
use crate::terminal::print_message;

/// Byte order mark: U+FEFF in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";
/// Most NUL bytes that are passed over within a line: file systems reserve no more for a logger.
const MOST_NULS: usize = 1 << 30;
/// Fewest numbers that show how many decimals the last cell of a line has.
const FEWEST_NUMBERS: usize = 8;
/// Most lines of text before a flight log, after which it is not searched on.
const LINES_BEFORE_A_LOG: usize = 2_000;
/// Bytes that are read and unpacked at once.
const BUFFER_LENGTH: usize = 256 * 1024;

/// Lines of a file, which is gzipped if it begins as gzip files do.
pub struct Lines {
    path: PathBuf,
    text: Box<dyn BufRead>,
    is_zipped: bool,
    is_stream: bool,
    /// Last line, without its NUL bytes.
    line: Vec<u8>,
    /// Number of its NUL bytes.
    nuls: usize,
    /// The last line is the next one again.
    is_unread: bool,
    /// The last line has an end.
    is_ended: bool,
    /// Number of lines that end with a number, and its fewest decimals.
    numbers: usize,
    least_decimals: usize,
    /// Number of the last line, counted from 1.
    number: u64,
    /// Order of the columns, if it is not that of a log, and the last line in that of a log.
    order: Option<(Order, String)>,
    /// Statements of the comments.
    stated: Statements,
    /// Warnings and notes, if they are collected.
    notices: Option<Vec<String>>,
}

impl Lines {
    /// Opens a file. All bytes pass through `wrap`, still zipped.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be opened or read.
    pub fn open<R: Read + 'static>(
        path: &Path,
        wrap: impl FnOnce(File) -> R,
    ) -> Result<Self, LogError> {
        let at = |reason: LogFault| LogError {
            file: path.to_owned(),
            line: None,
            reason,
            can_be_skipped: false,
        };
        let file = File::open(path).map_err(|error| at(LogFault::Open(error)))?;
        Self::new(path, wrap(file)).map_err(|error| at(LogFault::Read(error)))
    }

    /// Returns the lines of an open input; messages call it `name`.
    ///
    /// # Errors
    ///
    /// Returns an error if the input cannot be read.
    pub fn read_from(name: &Path, bytes: impl Read + 'static) -> Result<Self, LogError> {
        let lines = Self::new(name, bytes).map(|lines| Self {
            is_stream: true,
            ..lines
        });
        lines.map_err(|error| LogError {
            file: name.to_owned(),
            line: None,
            reason: LogFault::Read(error),
            can_be_skipped: false,
        })
    }

    pub(crate) fn new(path: &Path, bytes: impl Read + 'static) -> io::Result<Self> {
        let mut bytes = BufReader::with_capacity(BUFFER_LENGTH, bytes);
        let is_zipped = bytes.fill_buf()?.starts_with(&GZIP);
        let text: Box<dyn BufRead> = if is_zipped {
            let unzipped = MultiGzDecoder::new(bytes);
            Box::new(BufReader::with_capacity(BUFFER_LENGTH, unzipped))
        } else {
            Box::new(bytes)
        };
        Ok(Self {
            path: path.to_owned(),
            text,
            is_zipped,
            is_stream: false,
            line: Vec::new(),
            nuls: 0,
            is_unread: false,
            is_ended: true,
            numbers: 0,
            least_decimals: usize::MAX,
            number: 0,
            order: None,
            stated: Statements::default(),
            notices: None,
        })
    }

    /// Collects warnings and notes from now on, instead of printing them on standard error.
    pub(crate) fn collect_notices(&mut self) {
        self.notices = Some(Vec::new());
    }

    /// Returns the warnings and notes that were collected.
    pub(crate) fn take_notices(&mut self) -> Vec<String> {
        self.notices
            .as_mut()
            .map(std::mem::take)
            .unwrap_or_default()
    }

    /// Prints a warning or a note on standard error, or collects it.
    pub(crate) fn notify(&mut self, kind: &str, text: String) {
        match &mut self.notices {
            Some(notices) => notices.push(text),
            None => print_message(&format!("{kind}: {text}")),
        }
    }

    /// Returns the next line that is not blank, without its end; `None` after the last.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read on, is damaged, or is not text, or if the line
    /// has NUL bytes or more than 16,384 others.
    pub fn next_line(&mut self) -> Result<Option<&str>, LogError> {
        if !std::mem::take(&mut self.is_unread) {
            loop {
                self.number += 1;
                if !self.read_line().map_err(|fault| self.refuse(fault))? {
                    return Ok(None);
                }
                if self.nuls > 0 {
                    return Err(self.refuse(LogFault::Nuls(self.nuls)));
                }
                if !self.line.trim_ascii().is_empty() {
                    break;
                }
            }
            if self.is_number_cut() {
                return Err(self.refuse(LogFault::CutNumber));
            }
        }
        let Ok(line) = std::str::from_utf8(&self.line) else {
            return Err(self.refuse(LogFault::NotText));
        };
        let Some((order, arranged)) = &mut self.order else {
            return Ok(Some(line));
        };
        if !order.arrange(line, arranged) {
            let (found, expected) = (line.split(',').count(), order.cells);
            return Err(self.refuse(LogFault::ColumnCount { found, expected }));
        }
        Ok(self.order.as_ref().map(|(_, arranged)| arranged.as_str()))
    }

    /// Sets the order of the columns of the next lines. Reports which are unused.
    pub(crate) fn set_order(&mut self, order: Order) {
        if !order.unused.is_empty() {
            let names = quote(&order.unused.join(","));
            let text = format!("{}: columns that are not used: {names}", self.name());
            self.notify("note", text);
        }
        self.order = Some((order, String::new()));
    }

    /// Takes the last line, which is a comment, and keeps what it states. Warns of an option that
    /// no comment can state.
    pub(crate) fn take_comment(&mut self) -> Result<(), LogError> {
        let mut stated = self.stated;
        let comment = str::from_utf8(&self.line).unwrap_or_default();
        let taken = stated.take(comment);
        let unused = taken.map_err(|fault| self.refuse(fault))?;
        self.stated = stated;
        if let Some(option) = unused {
            let (place, option) = (self.place(), quote(&option));
            let text = format!(
                "{place}: the comment \"{option}\" changes nothing: only --accelerometer, \
                 --accel-range and --gyro-range can be stated in a comment"
            );
            self.notify("warning", text);
        }
        Ok(())
    }

    /// Returns the knowledge of the accelerometer that a comment before the header states.
    #[must_use]
    pub fn accelerometer(&self) -> Option<AccelerometerKnowledge> {
        self.stated.accelerometer
    }

    /// Returns all that the comments before the header state.
    #[must_use]
    pub fn stated(&self) -> &Statements {
        &self.stated
    }

    /// Returns whether the last line is that of a text, whatever its encoding.
    pub(crate) fn is_of_a_text(&self) -> bool {
        is_text(&self.line)
    }

    /// Reads on, and returns whether a flight log follows some lines of text.
    pub(crate) fn are_followed_by_a_log(&mut self) -> bool {
        for _ in 0..LINES_BEFORE_A_LOG {
            match self.next_line() {
                Ok(Some(_)) => {}
                Ok(None) => return false,
                Err(_) => return !self.is_of_a_text(),
            }
        }
        false
    }

    /// Reads a line, without its end. Returns false at the end of the file.
    fn read_line(&mut self) -> Result<bool, LogFault> {
        self.line.clear();
        self.nuls = 0;
        let mut is_end = true;
        loop {
            let buffer = match self.text.fill_buf() {
                Ok(buffer) => buffer,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) if self.is_zipped => return Err(LogFault::Gzip(error)),
                Err(error) => return Err(LogFault::Read(error)),
            };
            if buffer.is_empty() {
                break;
            }
            if is_end
                && self.number == 1
                && let Some(format) = format_of(buffer)
            {
                return Err(LogFault::OtherFormat(format));
            }
            is_end = false;
            // Counted, not stored: the tail of a file that was not closed may have any length.
            let nuls = buffer.iter().take_while(|byte| **byte == 0).count();
            if nuls > 0 {
                self.text.consume(nuls);
                self.nuls += nuls;
                let is_first = self.number == 1 && self.line.is_empty();
                if is_first && self.nuls > LONGEST_LINE {
                    return Err(LogFault::Nuls(self.nuls));
                } else if self.nuls > MOST_NULS {
                    return Err(LogFault::LineTooLong);
                }
                continue;
            }
            let end = memchr::memchr2(b'\n', 0, buffer);
            let is_ended = end.is_some_and(|end| buffer[end] == b'\n');
            let part = &buffer[..end.unwrap_or(buffer.len())];
            // Refused before it is stored: a line without end would fill the memory.
            if self.line.len() + part.len() > LONGEST_LINE {
                let has_returns = [part, &self.line].iter().any(|line| line.contains(&b'\r'));
                return Err(match has_returns {
                    true => LogFault::CarriageReturns,
                    false => LogFault::LineTooLong,
                });
            }
            self.line.extend_from_slice(part);
            let used = part.len() + usize::from(is_ended);
            self.text.consume(used);
            self.is_ended = is_ended;
            if is_ended {
                break;
            }
        }
        if self.line.ends_with(b"\r") {
            self.line.pop();
        }
        // Some programs begin a text with the byte order mark, which is invisible.
        if self.number == 1 && self.line.starts_with(BYTE_ORDER_MARK) {
            self.line.drain(..BYTE_ORDER_MARK.len());
        }
        Ok(!is_end)
    }

    /// Returns whether the last line has no end, and its last number fewer decimals than each one
    /// before: the program or computer that wrote it stopped there.
    fn is_number_cut(&mut self) -> bool {
        let Some(decimals) = decimals(&self.line) else {
            return false;
        };
        if !self.is_ended && self.numbers >= FEWEST_NUMBERS && decimals < self.least_decimals {
            return true;
        }
        self.numbers += 1;
        self.least_decimals = self.least_decimals.min(decimals);
        false
    }

    /// Makes the last line the next one again.
    pub fn unread(&mut self) {
        self.is_unread = true;
    }

    /// Returns the name of the input, for messages.
    #[must_use]
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Returns whether the input is no file, but for example standard input.
    #[must_use]
    pub fn is_stream(&self) -> bool {
        self.is_stream
    }

    /// Returns the number of the last line, counted from 1.
    #[must_use]
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Returns the place of the last line: the file and the number.
    #[must_use]
    pub fn place(&self) -> String {
        format!("{}:{}", self.path.display(), self.number)
    }

    /// Returns the error of the last line, for this reason.
    #[must_use]
    pub fn refuse(&self, reason: LogFault) -> LogError {
        LogError {
            line: Some(self.number),
            ..self.refuse_file(reason)
        }
    }

    /// Returns the error of the whole file, for this reason.
    #[must_use]
    pub fn refuse_file(&self, reason: LogFault) -> LogError {
        LogError {
            file: self.path.clone(),
            line: None,
            reason,
            can_be_skipped: false,
        }
    }
}

/// Returns the number of bytes after the decimal point of the last cell; `None` if the cell is no
/// number.
fn decimals(line: &[u8]) -> Option<usize> {
    let cell = line.rsplit(|byte| *byte == b',').next()?.trim_ascii();
    let is_of_a_number = |byte: &u8| byte.is_ascii_digit() || b"+-.eE".contains(byte);
    if !cell.iter().all(is_of_a_number) || !cell.iter().any(u8::is_ascii_digit) {
        return None;
    }
    let point = memchr::memchr(b'.', cell);
    Some(point.map_or(0, |point| cell.len() - point - 1))
}

/// Returns whether these bytes are of a text, whatever its encoding. A text may end with NUL bytes,
/// after a crash of the program or computer that wrote it.
pub(crate) fn is_text(bytes: &[u8]) -> bool {
    let is_control = |byte: &u8| byte.is_ascii_control() && !byte.is_ascii_whitespace();
    !bytes.iter().any(|byte| *byte != 0 && is_control(byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(bytes: impl Read + 'static) -> Lines {
        Lines::new(Path::new("test.csv"), bytes).expect("memory is read")
    }

    #[test]
    fn a_line_without_end_is_refused_before_it_fills_the_memory() {
        // Endless: it would hang, if it were read on.
        let mut endless = lines(io::repeat(b'0'));
        let error = endless.next_line().expect_err("it has no end");
        assert!(matches!(error.reason, LogFault::LineTooLong), "{error}");
        assert_eq!(error.line, Some(1));
        assert!(endless.line.capacity() <= 2 * LONGEST_LINE);
        let longest = format!("{}\nb\n", "a".repeat(LONGEST_LINE));
        let mut at_most = lines(io::Cursor::new(longest.into_bytes()));
        assert_eq!(
            at_most.next_line().unwrap().map(str::len),
            Some(LONGEST_LINE)
        );
        assert_eq!(at_most.next_line().unwrap(), Some("b"));
        assert_eq!(at_most.next_line().unwrap(), None);
    }

    #[test]
    fn blank_lines_are_passed_over_and_counted() {
        let mut lines = lines(io::Cursor::new("\u{FEFF}a\r\n\r\n \t\nb\n\n\n"));
        assert_eq!(lines.next_line().unwrap(), Some("a"));
        assert_eq!(lines.next_line().unwrap(), Some("b"));
        assert_eq!(lines.place(), "test.csv:4");
        lines.unread();
        assert_eq!(lines.next_line().unwrap(), Some("b"));
        assert_eq!(lines.next_line().unwrap(), None);
    }
}
