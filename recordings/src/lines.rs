//! Lines of a file, plain or gzipped.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use flate2::bufread::MultiGzDecoder;

use crate::fault::{LogError, LogFault};

/// Byte order mark: U+FEFF in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";
/// Bytes that are read and unpacked at once.
const BUFFER_LENGTH: usize = 256 * 1024;

/// Lines of a file, which is gzipped if it begins as gzip files do.
pub struct Lines {
    path: PathBuf,
    text: Box<dyn BufRead>,
    is_zipped: bool,
    line: Vec<u8>,
    /// The last line is the next one again.
    is_unread: bool,
    /// Number of the last line, counted from 1.
    number: u64,
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
        Self::new(name, bytes).map_err(|error| LogError {
            file: name.to_owned(),
            line: None,
            reason: LogFault::Read(error),
        })
    }

    pub(crate) fn new(path: &Path, bytes: impl Read + 'static) -> io::Result<Self> {
        let mut bytes = BufReader::with_capacity(BUFFER_LENGTH, bytes);
        let is_zipped = bytes.fill_buf()?.starts_with(&[0x1F, 0x8B]);
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
            line: Vec::new(),
            is_unread: false,
            number: 0,
        })
    }

    /// Returns the next line, without its end; `None` after the last.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read on, is damaged, or is not text.
    pub fn next_line(&mut self) -> Result<Option<&str>, LogError> {
        if !std::mem::take(&mut self.is_unread) {
            self.line.clear();
            self.number += 1;
            match self.text.read_until(b'\n', &mut self.line) {
                Ok(0) => return Ok(None),
                Ok(_) => {}
                Err(error) if self.is_zipped => return Err(self.refuse(LogFault::Gzip(error))),
                Err(error) => return Err(self.refuse(LogFault::Read(error))),
            }
        }
        if self.line.ends_with(b"\n") {
            self.line.pop();
            if self.line.ends_with(b"\r") {
                self.line.pop();
            }
        }
        // Some programs begin a text with the byte order mark, which is invisible.
        let line = match self.line.strip_prefix(BYTE_ORDER_MARK) {
            Some(rest) if self.number == 1 => rest,
            _ => &self.line,
        };
        match std::str::from_utf8(line) {
            Ok(line) => Ok(Some(line)),
            Err(_) => Err(LogError {
                file: self.path.clone(),
                line: Some(self.number),
                reason: LogFault::NotText,
            }),
        }
    }

    /// Makes the last line the next one again.
    pub fn unread(&mut self) {
        self.is_unread = true;
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
        }
    }
}
