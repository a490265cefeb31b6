//! Recorded logs: CSV, plain or gzipped, checked strictly before anything runs.
//!
//! The header is one of
//!
//! ```text
//! t_us,ax,ay,az,gx,gy,gz
//! t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz
//! t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov
//! ```
//!
//! Time is in whole microseconds and increases; specific force in m/s² and rates in rad/s, in
//! sensor axes; the truth is the quaternion sensor → earth with z up, its four cells empty where
//! it is not known; `mov` is 1 where a row counts for scores, else 0.
//!
//! [`Lines`] and [`parse_row`] read row by row and check the form alone: numbers may have any
//! value. [`Log::read`] reads a whole log and refuses values that no sensor measures.

use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use flate2::bufread::MultiGzDecoder;

use aplomb_models::motion::geometry::{Quaternion, Vector, norm};

/// Columns in their order. A log has the first 7, 11 or 12 of them.
const COLUMNS: [&str; 12] = [
    "t_us", "ax", "ay", "az", "gx", "gy", "gz", "qw", "qx", "qy", "qz", "mov",
];

/// Largest plausible force (100 g). A larger one means that the columns are not in m/s².
const IMPLAUSIBLE_SPECIFIC_FORCE_M_S2: f64 = 1000.0;
/// Largest plausible rate (11,000 °/s). A larger one means that the columns are not in rad/s.
const IMPLAUSIBLE_RATE_RAD_S: f64 = 200.0;
/// Largest deviation of a quaternion's length from 1: the truth is often printed with few digits.
const QUATERNION_TOLERANCE: f64 = 0.01;
/// Byte order mark: U+FEFF in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";
/// Bytes that are read and unpacked at once.
const BUFFER_LENGTH: usize = 256 * 1024;

/// Row of a log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Time, µs.
    pub time_us: i64,
    /// Specific force in sensor axes, m/s².
    pub specific_force_m_s2: Vector,
    /// Rates in sensor axes, rad/s.
    pub rates_rad_s: Vector,
    /// True attitude, sensor → earth with z up, of length 1.
    pub attitude: Option<Quaternion>,
    /// The row counts for scores; true if the log has no such column.
    pub moving: bool,
}

/// Whole log, of at least two rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    rows: Vec<Row>,
}

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
    /// The file has no contents.
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

    fn new(path: &Path, bytes: impl Read + 'static) -> io::Result<Self> {
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

impl Log {
    /// Reads and checks a file, which is gzipped if it begins as gzip files do.
    ///
    /// # Errors
    ///
    /// Returns an error with the file, the line and the fault.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        Self::parse(Lines::open(path, |file| file)?)
    }

    /// Returns the rows, at least two, with increasing times.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    fn parse(mut lines: Lines) -> Result<Self, LogError> {
        let header = match lines.next_line()? {
            Some(header) => header.to_owned(),
            None => return Err(lines.refuse_file(LogFault::Empty)),
        };
        let Some(columns) = column_count(&header) else {
            return Err(lines.refuse(LogFault::Header(header)));
        };
        let mut rows: Vec<Row> = Vec::new();
        while let Some(line) = lines.next_line()? {
            let before = rows.last().map(|row| row.time_us);
            let row = parse_row(line, columns)
                .and_then(|row| check(&row, before).map(|()| row))
                .map_err(|reason| lines.refuse(reason))?;
            rows.push(row);
        }
        if rows.len() < 2 {
            return Err(lines.refuse_file(LogFault::TooShort));
        }
        Ok(Self { rows })
    }
}

/// Returns the number of columns of a log with this header; `None` for another header.
#[must_use]
pub fn column_count(header: &str) -> Option<usize> {
    [7, 11, 12]
        .into_iter()
        .find(|&count| header == COLUMNS[..count].join(","))
}

/// Reads a row with this number of columns. Numbers may have any value, also infinite or NaN.
///
/// # Errors
///
/// Returns the fault of the row.
pub fn parse_row(line: &str, columns: usize) -> Result<Row, LogFault> {
    let mut cells = [""; COLUMNS.len()];
    let mut found = 0;
    for cell in line.split(',') {
        if let Some(place) = cells.get_mut(found) {
            *place = cell;
        }
        found += 1;
    }
    if found != columns {
        return Err(LogFault::ColumnCount {
            found,
            expected: columns,
        });
    }
    let number = |index: usize| -> Result<f64, LogFault> {
        cells[index].parse().map_err(|_| LogFault::NotANumber {
            column: COLUMNS[index],
            text: cells[index].to_owned(),
        })
    };
    let vector = |first: usize| -> Result<Vector, LogFault> {
        Ok([number(first)?, number(first + 1)?, number(first + 2)?])
    };
    let time_us = cells[0]
        .parse()
        .map_err(|_| LogFault::Time(cells[0].to_owned()))?;
    let (specific_force_m_s2, rates_rad_s) = (vector(1)?, vector(4)?);
    let truth = &cells[7..11];
    let attitude = if truth.iter().all(|cell| cell.is_empty()) {
        None
    } else if truth.iter().any(|cell| cell.is_empty()) {
        return Err(LogFault::PartialTruth);
    } else {
        let quaternion = Quaternion::new(number(7)?, number(8)?, number(9)?, number(10)?);
        let length = quaternion.norm();
        if (length - 1.0).abs() > QUATERNION_TOLERANCE || length.is_nan() {
            return Err(LogFault::NotARotation(length));
        }
        Some(quaternion.normalized())
    };
    let moving = match cells[11] {
        "1" => true,
        "" if columns < COLUMNS.len() => true,
        "0" => false,
        other => return Err(LogFault::Moving(other.to_owned())),
    };
    Ok(Row {
        time_us,
        specific_force_m_s2,
        rates_rad_s,
        attitude,
        moving,
    })
}

/// Checks that a sensor can have measured this row, after the one at `before_us`.
fn check(row: &Row, before_us: Option<i64>) -> Result<(), LogFault> {
    let values = row.specific_force_m_s2.into_iter().chain(row.rates_rad_s);
    for (value, column) in values.zip(&COLUMNS[1..]) {
        if !value.is_finite() {
            return Err(LogFault::NotFinite { column, value });
        }
    }
    plausible(
        row.specific_force_m_s2,
        1,
        IMPLAUSIBLE_SPECIFIC_FORCE_M_S2,
        "m/s²",
    )?;
    plausible(row.rates_rad_s, 4, IMPLAUSIBLE_RATE_RAD_S, "rad/s")?;
    match before_us {
        Some(before) if before >= row.time_us => Err(LogFault::NotIncreasing {
            before,
            now: row.time_us,
        }),
        _ => Ok(()),
    }
}

fn plausible(
    vector: Vector,
    first_column: usize,
    limit: f64,
    unit: &'static str,
) -> Result<(), LogFault> {
    if norm(vector) <= limit {
        return Ok(());
    }
    let largest = (0..3).fold(0, |best, axis| {
        if vector[axis].abs() > vector[best].abs() {
            axis
        } else {
            best
        }
    });
    Err(LogFault::Implausible {
        column: COLUMNS[first_column + largest],
        value: vector[largest],
        unit,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Write;

    const HEADER: &str = "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov";
    const GOOD: &str = "0,0,0,9.81,0.1,0.2,0.3,1,0,0,0,1";

    /// Returns the line of the fault, if one line has it, and the fault.
    type Refusal = (Option<u64>, LogFault);

    fn parse(text: impl AsRef<[u8]>) -> Result<Log, Refusal> {
        let bytes = io::Cursor::new(text.as_ref().to_vec());
        Lines::new(Path::new("test.csv"), bytes)
            .map_err(|error| (None, LogFault::Read(error)))
            .and_then(|lines| Log::parse(lines).map_err(|error| (error.line, error.reason)))
    }

    /// Returns the line and the reason of the refusal of a log whose third line is `row`.
    fn refusal(row: &str) -> (Option<u64>, String) {
        let (line, reason) = parse(format!("{HEADER}\n{GOOD}\n{row}\n")).unwrap_err();
        (line, reason.to_string())
    }

    #[test]
    fn each_of_the_three_forms_is_read() {
        let short = parse("t_us,ax,ay,az,gx,gy,gz\n-5,1,2,3,4,5,6\r\n10,1e0,-2,3,4,5,6.5").unwrap();
        assert_eq!(short.rows()[0].time_us, -5);
        assert_eq!(short.rows()[1].specific_force_m_s2, [1.0, -2.0, 3.0]);
        assert_eq!(short.rows()[1].rates_rad_s, [4.0, 5.0, 6.5]);
        assert_eq!(short.rows()[1].attitude, None);
        let with_truth = parse(
            "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz\n0,1,2,3,4,5,6,0,1.001,0,0\n1,1,2,3,4,5,6,,,,\n",
        )
        .unwrap();
        assert_eq!(
            with_truth.rows()[0].attitude,
            Some(Quaternion::new(0.0, 1.0, 0.0, 0.0))
        );
        assert_eq!(with_truth.rows()[1].attitude, None);
        assert!(with_truth.rows()[1].moving);
        let full = parse(format!("{HEADER}\n{GOOD}\n1,0,0,9.81,0,0,0,,,,,0\n")).unwrap();
        assert!(full.rows()[0].moving && !full.rows()[1].moving);
    }

    proptest! {
        #[test]
        fn any_rows_are_a_log_or_a_line_that_is_wrong(
            cells in prop::collection::vec(
                prop_oneof![
                    20 => "[0-9]\\.[0-9],-?[0-9]{1,2},9\\.8,0,1e-3,[0-9](,1,0,0,0|,,,,),[01]",
                    1 => "1,2,3,[0-9a]{1,9},5,6(,1,0,0,0){0,1}(,[01]){0,1}",
                    1 => ".{0,20}",
                ],
                0..6,
            ),
            steps in prop::collection::vec(prop_oneof![10 => 1..9_u32, 1 => Just(0)], 6),
            end in any::<[u8; 3]>(),
            has_end in prop::bool::weighted(0.1),
        ) {
            let mut time_us = 0;
            let rows: Vec<String> = cells
                .iter()
                .zip(steps)
                .map(|(cells, step)| {
                    time_us += step;
                    format!("{time_us},{cells}")
                })
                .collect();
            let mut text = format!("{HEADER}\n{}", rows.join("\n")).into_bytes();
            if has_end {
                text.extend(end);
            }
            let line_count = text.split(|byte| *byte == b'\n').count() as u64;
            match parse(&text) {
                Ok(log) => {
                    prop_assert!((log.rows().len() as u64) < line_count);
                    prop_assert!(log.rows().is_sorted_by(|one, other| one.time_us < other.time_us));
                    for row in log.rows() {
                        let values = row.specific_force_m_s2.iter().chain(&row.rates_rad_s);
                        prop_assert!(values.copied().all(f64::is_finite));
                    }
                }
                Err((line, reason)) => {
                    prop_assert!(!reason.to_string().is_empty());
                    let is_whole = matches!(reason, LogFault::TooShort);
                    prop_assert_eq!(line.is_none(), is_whole);
                    prop_assert!(line.is_none_or(|line| (2..=line_count).contains(&line)));
                }
            }
        }
    }

    #[test]
    fn every_fault_names_its_line_and_its_reason() {
        let cases = [
            ("1,0,0,9.81,0,0,0,1,0,0,0", "11 columns"),
            ("", "1 columns"),
            ("1,0,0,up,0,0,0,1,0,0,0,1", "az is \"up\""),
            ("1,0,0,,0,0,0,1,0,0,0,1", "az is \"\""),
            ("1,0,0,9.81,NaN,0,0,1,0,0,0,1", "gx is NaN"),
            ("1,0,0,9.81,0,inf,0,1,0,0,0,1", "gy is inf"),
            ("1.5,0,0,9.81,0,0,0,1,0,0,0,1", "t_us is \"1.5\""),
            (
                "0,0,0,9.81,0,0,0,1,0,0,0,1",
                "t_us is 0, not after the row before, 0",
            ),
            ("-1,0,0,9.81,0,0,0,1,0,0,0,1", "not after"),
            (
                "1,0,0,4096,0,0,0,1,0,0,0,1",
                "az is 4096, which no such sensor reports; m/s²",
            ),
            ("1,0,0,9.81,0,0,-827,1,0,0,0,1", "gz is -827"),
            ("1,0,0,9.81,0,0,0,1,,0,0,1", "give all four"),
            ("1,0,0,9.81,0,0,0,1,0.2,0,0,1", "length 1.0198"),
            ("1,0,0,9.81,0,0,0,0,0,0,0,1", "length 0.0000"),
            ("1,0,0,9.81,0,0,0,1,0,0,0,2", "mov is \"2\""),
            ("1,0,0,9.81,0,0,0,1,0,0,0,", "mov is \"\""),
        ];
        for (row, expected) in cases {
            let (line, reason) = refusal(row);
            assert_eq!(line, Some(3), "{row}");
            assert!(reason.contains(expected), "{row}: {reason}");
        }
    }

    #[test]
    fn the_file_as_a_whole_is_checked_too() {
        assert!(matches!(parse(""), Err((None, LogFault::Empty))));
        assert!(matches!(
            parse(format!("{HEADER}\n{GOOD}\n")),
            Err((None, LogFault::TooShort))
        ));
        for header in [
            "t_us,ax,ay,az,gx,gy",
            "time,ax,ay,az,gx,gy,gz",
            "t_us,ax,ay,az,gx,gy,gz,mov",
            "",
        ] {
            assert!(
                matches!(
                    parse(format!("{header}\n")),
                    Err((Some(1), LogFault::Header(_)))
                ),
                "{header}"
            );
        }
        let binary = [HEADER.as_bytes(), b"\n\xFF\xFE\n"].concat();
        assert!(matches!(parse(binary), Err((Some(2), LogFault::NotText))));
    }

    /// A file of its own for each test, removed at the end.
    struct Temporary(PathBuf);

    impl Temporary {
        fn new(name: &str, bytes: &[u8]) -> Self {
            let path = std::env::temp_dir().join(format!("aplomb-{}-{name}", std::process::id()));
            File::create(&path).unwrap().write_all(bytes).unwrap();
            Self(path)
        }
    }

    impl Drop for Temporary {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    fn zip(text: &str) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(text.as_bytes()).unwrap();
        encoder.finish().unwrap()
    }

    fn long_log() -> String {
        let rows: Vec<String> = (0..500)
            .map(|index| format!("{},0.{index},1,9,0,0,0,1,0,0,0,1", index * 5000))
            .collect();
        format!("{HEADER}\n{}\n", rows.join("\n"))
    }

    #[test]
    fn plain_and_zipped_files_read_alike_whatever_their_names() {
        let plain = Temporary::new("plain.csv.gz", long_log().as_bytes());
        let zipped = Temporary::new("zipped.csv", &zip(&long_log()));
        let log = Log::read(&plain.0).unwrap();
        assert_eq!(log.rows().len(), 500);
        assert_eq!(log, Log::read(&zipped.0).unwrap());
    }

    #[test]
    fn a_cut_off_or_damaged_zip_is_refused() {
        let mut bytes = zip(&long_log());
        let cut = Temporary::new("cut.csv.gz", &bytes[..bytes.len() / 2]);
        let error = Log::read(&cut.0).unwrap_err();
        assert!(matches!(error.reason, LogFault::Gzip(_)), "{error}");
        assert!(
            error
                .to_string()
                .starts_with(&format!("{}:", cut.0.display())),
            "{error}"
        );
        // The checksum stands in the last eight bytes.
        let checksum = bytes.len() - 8;
        bytes[checksum] ^= 1;
        let damaged = Temporary::new("damaged.csv.gz", &bytes);
        assert!(matches!(
            Log::read(&damaged.0).unwrap_err().reason,
            LogFault::Gzip(_)
        ));
    }

    #[test]
    fn a_message_has_file_line_and_reason() {
        let file = Temporary::new("message.csv", format!("{HEADER}\n{GOOD}\nx\n").as_bytes());
        let message = Log::read(&file.0).unwrap_err().to_string();
        assert_eq!(
            message,
            format!(
                "{}:3: the row has 1 columns, but the header has 12",
                file.0.display()
            )
        );
        let missing = Log::read(Path::new("/no/such/log.csv")).unwrap_err();
        assert!(
            missing
                .to_string()
                .starts_with("/no/such/log.csv: the file cannot be opened"),
            "{missing}"
        );
    }
}
