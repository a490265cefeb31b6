//! Faults of recordings, with their places.

use std::fmt;
use std::io;
use std::path::PathBuf;

/// Error of a log: the reason and the place.
#[derive(Debug)]
pub struct LogError {
    /// File.
    pub file: PathBuf,
    /// Line, counted from 1; `None` for the whole file.
    pub line: Option<u64>,
    /// Fault of the line or file.
    pub reason: LogFault,
}

/// Faults of a log.
#[derive(Debug, thiserror::Error)]
pub enum LogFault {
    /// The file cannot be opened.
    #[error("the file cannot be opened: {0}")]
    Open(#[source] io::Error),
    /// Reading stopped with an error.
    #[error("the file cannot be read on: {0}")]
    Read(#[source] io::Error),
    /// The compressed data ends too early or is damaged.
    #[error("the gzip data is cut off or damaged: {0}")]
    Gzip(#[source] io::Error),
    /// There is nothing in the file.
    #[error("the file is empty")]
    Empty,
    /// The line is not text.
    #[error("the line is not UTF-8 text")]
    NotText,
    /// The header is not one of the three.
    #[error("the header is \"{0}\", but must be t_us,ax,ay,az,gx,gy,gz[,qw,qx,qy,qz[,mov]]")]
    Header(String),
    /// The row has more or fewer cells than the header.
    #[error("the row has {found} columns, but the header has {expected}")]
    ColumnCount {
        /// Cells in the row.
        found: usize,
        /// Cells in the header.
        expected: usize,
    },
    /// A cell is not a number.
    #[error("{column} is \"{text}\", which is not a number")]
    NotANumber {
        /// Name of the column.
        column: &'static str,
        /// Contents of the cell.
        text: String,
    },
    /// The time is not a whole number of microseconds.
    #[error("t_us is \"{0}\", which is not a whole number of microseconds")]
    Time(String),
    /// A cell is infinite or not a number.
    #[error("{column} is {value}, which is not finite")]
    NotFinite {
        /// Name of the column.
        column: &'static str,
        /// Contents of the cell.
        value: f64,
    },
    /// Time does not go on.
    #[error("t_us is {now}, not after the row before, {before}")]
    NotIncreasing {
        /// The time of the row before.
        before: i64,
        /// The time of this row.
        now: i64,
    },
    /// A value that no sensor of this kind reports in SI units.
    #[error(
        "{column} is {value}, which no such sensor reports; {unit} is expected, not raw counts"
    )]
    Implausible {
        /// Name of the column.
        column: &'static str,
        /// Contents of the cell.
        value: f64,
        /// The unit of the column.
        unit: &'static str,
    },
    /// Some but not all of the truth's cells are empty.
    #[error("some of qw,qx,qy,qz are empty: give all four, or none")]
    PartialTruth,
    /// The truth is not a rotation.
    #[error("qw,qx,qy,qz has the length {0:.4}, but a rotation's is 1")]
    NotARotation(f64),
    /// `mov` is neither 0 nor 1.
    #[error("mov is \"{0}\", but must be 0 or 1")]
    Moving(String),
    /// Motion needs two points in time.
    #[error("the log has fewer than two rows")]
    TooShort,
}

impl fmt::Display for LogError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}", self.file.display())?;
        if let Some(line) = self.line {
            write!(formatter, ":{line}")?;
        }
        write!(formatter, ": {}", self.reason)
    }
}

impl std::error::Error for LogError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        std::error::Error::source(&self.reason)
    }
}
