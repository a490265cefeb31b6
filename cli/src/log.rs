//! Recorded logs: CSV, plain or gzipped, read row by row and checked strictly.
//!
//! The header is one of
//!
//! ```text
//! t_us,ax,ay,az,gx,gy,gz
//! t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz
//! t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov
//! ```
//!
//! Time is in whole microseconds; specific force in m/s² and rates in rad/s, in sensor axes; the truth is
//! the quaternion sensor → earth with z up, its four cells empty where it is not known; `mov` is 1 where a
//! row counts for scores, else 0.
//!
//! What a row says is not judged here: numbers may be infinite and time may run backwards, since
//! that is for an estimator to bear.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use flate2::bufread::MultiGzDecoder;

/// The columns in their order; a log has the first 7, 11 or 12 of them.
const COLUMNS: [&str; 12] = [
    "t_us", "ax", "ay", "az", "gx", "gy", "gz", "qw", "qx", "qy", "qz", "mov",
];
/// How far a quaternion's length may be from 1: the truth is often printed with few digits.
const QUATERNION_TOLERANCE: f64 = 0.01;
const BUFFER_BYTES: usize = 256 * 1024;

/// One row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// µs.
    pub time_us: i64,
    /// Sensor axes, m/s².
    pub specific_force: [f64; 3],
    /// Sensor axes, rad/s.
    pub rates: [f64; 3],
    /// w, x, y, z: sensor → earth with z up, of length 1 within a hundredth.
    pub truth: Option<[f64; 4]>,
    /// The row counts for scores; true if the log has no such column.
    pub is_moving: bool,
}

/// Why a file was refused, and where.
#[derive(Debug, thiserror::Error)]
#[error("{}{}: {reason}", .file.display(), .line.map(|line| format!(":{line}")).unwrap_or_default())]
pub struct Refusal {
    /// The file.
    pub file: PathBuf,
    /// The line, counted from 1; `None` if the file as a whole is meant.
    pub line: Option<u64>,
    /// What is wrong with it.
    pub reason: Fault,
}

/// What can be wrong with a file.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    #[error("the file cannot be opened: {0}")]
    Open(#[source] io::Error),
    #[error("the file cannot be read on: {0}")]
    Read(#[source] io::Error),
    #[error("the gzip data is cut off or damaged: {0}")]
    Gzip(#[source] io::Error),
    #[error("the file is empty")]
    Empty,
    #[error("there is no row after the header")]
    NoRows,
    #[error("the line is not UTF-8 text")]
    NotText,
    #[error(
        "the header is \"{0}\", but must be t_us,ax,ay,az,gx,gy,gz[,qw,qx,qy,qz[,mov]] (a log) or t_us,bytes,flags (bursts)"
    )]
    Header(String),
    #[error("the row has {found} columns, but the header has {expected}")]
    ColumnCount { found: usize, expected: usize },
    #[error("{column} is \"{text}\", which is not a number")]
    NotANumber { column: &'static str, text: String },
    #[error("t_us is \"{0}\", which is not a whole number of microseconds")]
    Time(String),
    #[error("some of qw,qx,qy,qz are empty: give all four, or none")]
    PartialTruth,
    #[error("qw,qx,qy,qz has the length {0:.4}, but a rotation's is 1")]
    NotARotation(f64),
    #[error("mov is \"{0}\", but must be 0 or 1")]
    Moving(String),
    #[error("{column} is {value}, which is not a count of a 16-bit register")]
    NotACount { column: &'static str, value: f64 },
    #[error("{0}")]
    Burst(#[from] aplomb::telemetry::bursts::DecodeError),
}

/// The lines of a file, gzipped if it begins as gzip files do.
pub struct Lines {
    path: PathBuf,
    text: Box<dyn BufRead>,
    is_zipped: bool,
    line: Vec<u8>,
    /// The number of the line that was read last, counted from 1.
    number: u64,
}

impl Lines {
    /// Opens the file. Whatever is read of it, unpacked or not, passes through `wrap` first.
    pub fn open<R: Read + 'static>(
        path: &Path,
        wrap: impl FnOnce(File) -> R,
    ) -> Result<Self, Refusal> {
        let refuse = |reason| Refusal {
            file: path.to_owned(),
            line: None,
            reason,
        };
        let file = File::open(path).map_err(|error| refuse(Fault::Open(error)))?;
        let mut file = BufReader::with_capacity(BUFFER_BYTES, wrap(file));
        let start = file
            .fill_buf()
            .map_err(|error| refuse(Fault::Read(error)))?;
        let is_zipped = start.starts_with(&[0x1F, 0x8B]);
        let text: Box<dyn BufRead> = if is_zipped {
            Box::new(BufReader::with_capacity(
                BUFFER_BYTES,
                MultiGzDecoder::new(file),
            ))
        } else {
            Box::new(file)
        };
        Ok(Self {
            path: path.to_owned(),
            text,
            is_zipped,
            line: Vec::new(),
            number: 0,
        })
    }

    /// The next line, without its end; `None` after the last.
    pub fn next(&mut self) -> Result<Option<&str>, Refusal> {
        self.line.clear();
        self.number += 1;
        match self.text.read_until(b'\n', &mut self.line) {
            Ok(0) => return Ok(None),
            Ok(_) => {}
            Err(error) if self.is_zipped => return Err(self.refuse(Fault::Gzip(error))),
            Err(error) => return Err(self.refuse(Fault::Read(error))),
        }
        if self.line.ends_with(b"\n") {
            self.line.pop();
            if self.line.ends_with(b"\r") {
                self.line.pop();
            }
        }
        match std::str::from_utf8(&self.line) {
            Ok(line) => Ok(Some(line)),
            Err(_) => Err(Refusal {
                file: self.path.clone(),
                line: Some(self.number),
                reason: Fault::NotText,
            }),
        }
    }

    /// What is wrong with the line that was read last.
    pub fn refuse(&self, reason: Fault) -> Refusal {
        Refusal {
            file: self.path.clone(),
            line: Some(self.number),
            reason,
        }
    }

    /// What is wrong with the file as a whole.
    pub fn refuse_file(&self, reason: Fault) -> Refusal {
        Refusal {
            line: None,
            ..self.refuse(reason)
        }
    }
}

/// How many columns a log with this header has; `None` if it is not a log's.
pub fn columns(header: &str) -> Option<usize> {
    [7, 11, 12]
        .into_iter()
        .find(|&count| header == COLUMNS[..count].join(","))
}

/// Reads a row of so many columns.
pub fn parse(line: &str, columns: usize) -> Result<Row, Fault> {
    let mut cells = [""; COLUMNS.len()];
    let mut found = 0;
    for cell in line.split(',') {
        if let Some(place) = cells.get_mut(found) {
            *place = cell;
        }
        found += 1;
    }
    if found != columns {
        return Err(Fault::ColumnCount {
            found,
            expected: columns,
        });
    }
    let number = |index: usize| -> Result<f64, Fault> {
        let (column, text) = (COLUMNS[index], cells[index]);
        text.parse().map_err(|_| Fault::NotANumber {
            column,
            text: text.to_owned(),
        })
    };
    let vector = |first: usize| -> Result<[f64; 3], Fault> {
        Ok([number(first)?, number(first + 1)?, number(first + 2)?])
    };
    let truth_cells = &cells[7..11];
    let truth = if truth_cells.iter().all(|cell| cell.is_empty()) {
        None
    } else if truth_cells.iter().any(|cell| cell.is_empty()) {
        return Err(Fault::PartialTruth);
    } else {
        let truth = [number(7)?, number(8)?, number(9)?, number(10)?];
        let length = truth.iter().map(|part| part * part).sum::<f64>().sqrt();
        if (length - 1.0).abs() > QUATERNION_TOLERANCE || length.is_nan() {
            return Err(Fault::NotARotation(length));
        }
        Some(truth)
    };
    let is_moving = match cells[11] {
        "1" => true,
        "" if columns < COLUMNS.len() => true,
        "0" => false,
        other => return Err(Fault::Moving(other.to_owned())),
    };
    Ok(Row {
        time_us: cells[0]
            .parse()
            .map_err(|_| Fault::Time(cells[0].to_owned()))?,
        specific_force: vector(1)?,
        rates: vector(4)?,
        truth,
        is_moving,
    })
}

/// The values of a row whose cells are register counts: accelerometer, then gyroscope.
///
/// A logger that turns an axis around makes 32768 of the register's −32768: it is full scale too.
pub fn counts(row: &Row) -> Result<[[i16; 3]; 2], Fault> {
    let mut counts = [[0; 3]; 2];
    let groups = [&row.specific_force, &row.rates];
    for (group, values) in groups.into_iter().enumerate() {
        for (axis, &value) in values.iter().enumerate() {
            // The conversion saturates.
            let count = value as i16;
            if value.fract() != 0.0 || !(-32_768.0..=32_768.0).contains(&value) {
                let column = COLUMNS[1 + 3 * group + axis];
                return Err(Fault::NotACount { column, value });
            }
            counts[group][axis] = count;
        }
    }
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "0,0,0,9.81,0.1,0.2,0.3,1,0,0,0,1";

    #[test]
    fn each_of_the_three_forms_is_read() {
        let header = "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov";
        assert_eq!(columns(header), Some(12));
        let full = parse(GOOD, 12).unwrap();
        assert_eq!(full.specific_force, [0.0, 0.0, 9.81]);
        assert_eq!(full.rates, [0.1, 0.2, 0.3]);
        assert_eq!(full.truth, Some([1.0, 0.0, 0.0, 0.0]));
        assert!(full.is_moving);
        assert!(!parse("1,0,0,9,0,0,0,,,,,0", 12).unwrap().is_moving);
        assert_eq!(parse("1,0,0,9,0,0,0,,,,,0", 12).unwrap().truth, None);
        assert_eq!(columns("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz"), Some(11));
        assert!(parse("1,0,0,9,0,0,0,,,,", 11).unwrap().is_moving);
        assert_eq!(columns("t_us,ax,ay,az,gx,gy,gz"), Some(7));
        let short = parse("-5,1e0,-2,3,4,5,6.5", 7).unwrap();
        assert_eq!((short.time_us, short.specific_force[0]), (-5, 1.0));
        for other in ["", "t_us,ax,ay,az,gx,gy", "t_us,ax,ay,az,gx,gy,gz,mov"] {
            assert_eq!(columns(other), None, "{other}");
        }
    }

    #[test]
    fn every_fault_names_its_reason() {
        for (row, expected) in [
            ("1,0,0,9.81,0,0,0,1,0,0,0", "11 columns"),
            ("1,0,0,9.81,0,0,0,1,0,0,0,1,1", "13 columns"),
            ("", "1 columns"),
            ("1,0,0,up,0,0,0,1,0,0,0,1", "az is \"up\""),
            ("1,0,0,,0,0,0,1,0,0,0,1", "az is \"\""),
            ("1.5,0,0,9.81,0,0,0,1,0,0,0,1", "t_us is \"1.5\""),
            ("1,0,0,9.81,0,0,0,1,,0,0,1", "give all four"),
            ("1,0,0,9.81,0,0,0,1,0.2,0,0,1", "length 1.0198"),
            ("1,0,0,9.81,0,0,0,nan,0,0,0,1", "length NaN"),
            ("1,0,0,9.81,0,0,0,1,0,0,0,2", "mov is \"2\""),
            ("1,0,0,9.81,0,0,0,1,0,0,0,", "mov is \"\""),
        ] {
            let reason = parse(row, 12).unwrap_err().to_string();
            assert!(reason.contains(expected), "{row}: {reason}");
        }
    }

    #[test]
    fn counts_are_those_of_a_register_and_full_scale_may_be_turned_around() {
        let row = |cell: &str| parse(&format!("0,1,-2,{cell},4,5,-32768"), 7).unwrap();
        let read = |cell: &str| counts(&row(cell)).map_err(|fault| fault.to_string());
        assert_eq!(read("3"), Ok([[1, -2, 3], [4, 5, i16::MIN]]));
        assert_eq!(read("32768"), Ok([[1, -2, i16::MAX], [4, 5, i16::MIN]]));
        for cell in ["0.5", "32769", "-32769", "inf", "nan"] {
            assert!(read(cell).unwrap_err().starts_with("az is "), "{cell}");
        }
    }
}
