//! Faults of recordings, with their places.

use std::fmt;
use std::io;
use std::path::PathBuf;

use crate::columns::difference;
use crate::quote::quote;

/// Bytes of the longest line. A row of the widest table has about 1,000.
pub const LONGEST_LINE: usize = 16 * 1024;

/// Error of a recording: the reason and the place.
#[derive(Debug)]
pub struct LogError {
    /// File.
    pub file: PathBuf,
    /// Line, counted from 1; `None` for the whole file.
    pub line: Option<u64>,
    /// Fault of the line or file.
    pub reason: LogFault,
    /// The option `--bad-rows skip` leaves the row out, or all after a cut.
    pub can_be_skipped: bool,
}

/// Quantity whose numbers suggest another unit.
#[derive(Debug)]
pub struct UnitGuess {
    /// Quantity.
    pub quantity: &'static str,
    /// Median or mean of the column.
    pub value: f64,
    /// Usual value.
    pub usual: &'static str,
    /// The unit that such values suggest, with its option.
    pub meant: &'static str,
    /// Option that asserts the unit of the columns.
    pub option: &'static str,
}

impl fmt::Display for UnitGuess {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} is mostly ", self.quantity)?;
        if self.value.abs() < 0.01 {
            write!(formatter, "{:.1e}", self.value)?;
        } else {
            write!(formatter, "{:.3}", self.value)?;
        }
        write!(
            formatter,
            ", where {} is usual: did you mean {}? If not, add {}",
            self.usual, self.meant, self.option
        )
    }
}

/// Faults of a recording.
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
    /// The file has no contents.
    #[error("the file is empty")]
    Empty,
    /// The file has comments alone.
    #[error("there are comments in the file, but no header and no rows")]
    NoHeader,
    /// The line has more bytes than any row.
    #[error("the line has more than {LONGEST_LINE} bytes: this is no table of a recording")]
    LineTooLong,
    /// The line has so many NUL bytes.
    #[error(
        "{}: a file that was not closed, after a crash or a loss of power, ends like this",
        nuls(*.0)
    )]
    Nuls(usize),
    /// The file has another format.
    #[error("this is {0}")]
    OtherFormat(&'static str),
    /// The lines end with carriage returns alone.
    #[error("the lines end with carriage returns alone: save the file with line feeds")]
    CarriageReturns,
    /// The line is not text.
    #[error("the line is not UTF-8 text: save the file as UTF-8")]
    NotText,
    /// The file is not a text with columns: perhaps a flight log.
    #[error(
        "it is no table. {} `replay` and `plot` take it, and `convert` makes a table of it",
        if *is_stream {
            "A flight log has to be a file, not standard input: give the file's name."
        } else {
            "Is it a flight log, of which there is too little:"
        }
    )]
    NoTable {
        /// True for standard input.
        is_stream: bool,
    },
    /// The header is not that of a recording.
    #[error(
        "{}the header is \"{}\", but must be \
         t_us,ax,ay,az,gx,gy,gz[,mx,my,mz][,qw,qx,qy,qz[,mov]][,armed]",
        cause(.0), quote(.0)
    )]
    Header(String),
    /// The comment states no knowledge of the accelerometer.
    #[error(
        "\"{}\" is no knowledge of the accelerometer: write factory, six-poses or calibrated, or \
         remove the line",
        quote(.0)
    )]
    Knowledge(String),
    /// A comment states a full scale that no sensor has.
    #[error("{0}; or remove the comment")]
    Statement(String),
    /// The last row ends in the middle of a number.
    #[error(
        "the last row ends in the middle of a number: it has no line end, and fewer decimals than \
         every row before"
    )]
    CutNumber,
    /// The row has more or fewer cells than the header.
    #[error("the row has {found} columns, but the header has {expected}")]
    ColumnCount {
        /// Cells in the row.
        found: usize,
        /// Cells in the header.
        expected: usize,
    },
    /// A cell is not a number.
    #[error("{column} is \"{}\", which is not a number", quote(text))]
    NotANumber {
        /// Name of the column.
        column: &'static str,
        /// Contents of the cell.
        text: String,
    },
    /// The time is not a whole number of microseconds.
    #[error(
        "t_us is \"{}\", which is not a whole number of microseconds{}",
        quote(.0), suggestion(.0)
    )]
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
    /// The next rows fit the rows before, but not this one.
    #[error("t_us is {now}, which the rows after it contradict: the next one has {next}")]
    Misplaced {
        /// The time of this row.
        now: i64,
        /// The time of the next row.
        next: i64,
    },
    /// Time goes on by more than any pause of a logger.
    #[error("t_us is {now}, which is {} after the row before, {before}", span(*before, *now))]
    Gap {
        /// The time of the row before.
        before: i64,
        /// The time of this row.
        now: i64,
    },
    /// A value that no sensor of this kind reports in the column's unit.
    #[error(
        "{column} is {value}, which no such sensor reports; {unit} is expected: \
         did you mean {meant}?"
    )]
    Implausible {
        /// Name of the column.
        column: &'static str,
        /// Contents of the cell.
        value: f64,
        /// The unit of the column.
        unit: &'static str,
        /// The unit that such a value suggests, with its option.
        meant: &'static str,
    },
    /// The first rows, taken together, suggest another unit.
    #[error("{0}")]
    Unit(Box<UnitGuess>),
    /// The times are probably milliseconds.
    #[error(
        "the time between rows is mostly {step:.0}, and {}: did you mean ms (--time-unit ms)? \
         If not, add --time-unit us",
        milliseconds(*seconds)
    )]
    Milliseconds {
        /// Median of the steps.
        step: f64,
        /// Duration of the whole recording in µs, s; `None` if the turns show milliseconds.
        seconds: Option<f64>,
    },
    /// Some but not all of the compass's cells are empty.
    #[error("some of mx,my,mz are empty: give all three, or none where there is no new reading")]
    PartialField,
    /// A magnetic field that no compass measures.
    #[error(
        "{column} is {value}, which no compass measures; microtesla are expected: \
         did you mean nT (--field-unit nT)?"
    )]
    ImplausibleField {
        /// Name of the column.
        column: &'static str,
        /// Contents of the cell.
        value: f64,
    },
    /// Some but not all of the truth's cells are empty.
    #[error("some of qw,qx,qy,qz are empty: give all four, or none")]
    PartialTruth,
    /// The truth is not a rotation.
    #[error("qw,qx,qy,qz has the length {0:.4}, but a rotation's is 1")]
    NotARotation(f64),
    /// `mov` is neither 0 nor 1.
    #[error("mov is \"{}\", but must be 0 or 1", quote(.0))]
    Moving(String),
    /// `armed` is neither 0 nor 1 nor empty.
    #[error("armed is \"{}\", but must be 0 or 1, or empty where it stays as it is", quote(.0))]
    Armed(String),
    /// Motion needs two points in time.
    #[error("the recording has fewer than two rows")]
    TooShort,
}

impl LogFault {
    /// Returns whether compressed data ends too early: the rows before the cut are good.
    #[must_use]
    pub fn is_cut_off(&self) -> bool {
        let is_end = |error: &io::Error| error.kind() == io::ErrorKind::UnexpectedEof;
        matches!(self, Self::Gzip(error) if is_end(error))
    }

    /// Returns whether the fault is of one row, which can be left out.
    #[must_use]
    pub fn is_of_a_row(&self) -> bool {
        match self {
            Self::Open(_)
            | Self::Read(_)
            | Self::Gzip(_)
            | Self::Empty
            | Self::NoHeader
            | Self::OtherFormat(_)
            | Self::CarriageReturns
            | Self::NoTable { .. }
            | Self::Header(_)
            | Self::Knowledge(_)
            | Self::Statement(_)
            | Self::Unit(_)
            | Self::Milliseconds { .. }
            | Self::TooShort => false,
            Self::LineTooLong
            | Self::Nuls(_)
            | Self::NotText
            | Self::CutNumber
            | Self::ColumnCount { .. }
            | Self::NotANumber { .. }
            | Self::Time(_)
            | Self::NotFinite { .. }
            | Self::NotIncreasing { .. }
            | Self::Misplaced { .. }
            | Self::Gap { .. }
            | Self::Implausible { .. }
            | Self::PartialField
            | Self::ImplausibleField { .. }
            | Self::PartialTruth
            | Self::NotARotation(_)
            | Self::Moving(_)
            | Self::Armed(_) => true,
        }
    }
}

/// Returns the cause why a header is not that of a recording, with a colon; empty if none is
/// certain.
fn cause(header: &str) -> String {
    let difference = difference(header);
    match difference.is_empty() {
        true => difference,
        false => format!("{difference}: "),
    }
}

/// Returns a suggestion for a time with decimals.
fn suggestion(text: &str) -> &'static str {
    match text.parse::<f64>() {
        Ok(time) if time.is_finite() => {
            ": did you mean seconds (--time-unit s), milliseconds (--time-unit ms), \
             or microseconds to be rounded (--time-unit us)?"
        }
        _ => "",
    }
}

/// Returns the reason why times are probably milliseconds, by the duration in µs, s.
fn milliseconds(seconds: Option<f64>) -> String {
    match seconds {
        Some(seconds) => format!("in microseconds the recording would last {seconds:.3} s"),
        None => "the force turns as far as the rates turn it in milliseconds".to_owned(),
    }
}

/// Returns the finding of so many NUL bytes.
fn nuls(count: usize) -> String {
    if count > LONGEST_LINE {
        format!("the line has more than {LONGEST_LINE} bytes that are NUL")
    } else {
        format!("the line has {count} NUL bytes")
    }
}

/// Returns the time from `before` to `now`, µs, in a unit that a reader can imagine.
fn span(before: i64, now: i64) -> String {
    let seconds = now.abs_diff(before) as f64 * 1e-6;
    let units = [
        ("years", 31_557_600.0),
        ("days", 86_400.0),
        ("hours", 3_600.0),
    ];
    let (name, length) = units
        .into_iter()
        .find(|(_, length)| seconds >= *length)
        .unwrap_or(("s", 1.0));
    format!("{:.1} {name}", seconds / length)
}

impl fmt::Display for LogError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}", self.file.display())?;
        if let Some(line) = self.line {
            write!(formatter, ":{line}")?;
        }
        write!(formatter, ": {}", self.reason)?;
        if self.can_be_skipped {
            formatter.write_str(match self.reason.is_cut_off() {
                true => "; --bad-rows skip uses the rows before the cut",
                false => "; --bad-rows skip leaves such rows out",
            })?;
        }
        Ok(())
    }
}

impl std::error::Error for LogError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        std::error::Error::source(&self.reason)
    }
}
