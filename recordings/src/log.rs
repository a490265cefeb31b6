//! Recorded logs: CSV, plain or gzipped, checked strictly before anything runs.
//!
//! The header is one of these, each with or without a compass:
//!
//! ```text
//! t_us,ax,ay,az,gx,gy,gz[,mx,my,mz][,armed]
//! t_us,ax,ay,az,gx,gy,gz[,mx,my,mz],qw,qx,qy,qz[,armed]
//! t_us,ax,ay,az,gx,gy,gz[,mx,my,mz],qw,qx,qy,qz,mov[,armed]
//! ```
//!
//! Time is in whole microseconds and increases; specific force in m/s², rates in rad/s and
//! magnetic field in µT, in sensor axes, the field's three cells empty where there is no new
//! reading; the truth is the quaternion sensor → earth with z up, its four cells empty where
//! it is not known; `mov` is 1 where a row counts for scores, else 0. `armed` is 1 from the row on
//! in which the vehicle is armed, 0 from the row on in which it is disarmed; an empty cell leaves
//! the state, which begins disarmed, as it is.
//!
//! Lines that begin with `#` before the header, and blank lines, are no rows. The line
//! `# --accelerometer factory` (or another knowledge) stands for the option. [`Rows`] reads row by
//! row, in any unit, and refuses what no sensor measures; [`Log::read`] reads a whole log with it.
//! [`parse_row`] checks the form alone: numbers may have any value.

use std::path::Path;

use aplomb::estimator::kalman::AccelerometerKnowledge;

pub use crate::fault::{LogError, LogFault, UnitGuess};
use crate::form::header;
pub use crate::lines::{ACCELEROMETER_COMMENT, Lines};
pub use crate::row::{LogColumns, Row, parse_row};
pub use crate::rows::Rows;
use crate::units::{BadRows, RowOptions};

/// Whole log, of at least two rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    rows: Vec<Row>,
    accelerometer: Option<AccelerometerKnowledge>,
}

impl Log {
    /// Reads and checks a file, which is gzipped if it begins as gzip files do.
    ///
    /// # Errors
    ///
    /// Returns an error with the file, the line and the fault.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        Self::read_with(path, RowOptions::default())
    }

    /// Reads a file like [`read`](Self::read), with these units and this rule for bad rows. A log
    /// never keeps them.
    ///
    /// # Errors
    ///
    /// Returns an error with the file, the line and the fault.
    pub fn read_with(path: &Path, options: RowOptions) -> Result<Self, LogError> {
        let (log, _) = Self::parse(Lines::open(path, |file| file)?, options)?;
        Ok(log)
    }

    /// Reads a file like [`read_with`](Self::read_with). Returns the warnings and notes on it,
    /// which the others print on standard error.
    ///
    /// # Errors
    ///
    /// Returns an error with the file, the line and the fault.
    pub fn read_quietly(path: &Path, options: RowOptions) -> Result<(Self, Vec<String>), LogError> {
        let mut lines = Lines::open(path, |file| file)?;
        lines.collect_notices();
        Self::parse(lines, options)
    }

    /// Returns the knowledge of the accelerometer that the log states.
    #[must_use]
    pub fn accelerometer(&self) -> Option<AccelerometerKnowledge> {
        self.accelerometer
    }

    /// Returns the rows, at least two, with increasing times.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Reads all rows. Returns the notices too, if the lines collect them.
    fn parse(mut lines: Lines, mut options: RowOptions) -> Result<(Self, Vec<String>), LogError> {
        if options.bad_rows == Some(BadRows::Keep) {
            options.bad_rows = Some(BadRows::Refuse);
        }
        let header = header(&mut lines)?;
        let Some(columns) = LogColumns::of(&header) else {
            return Err(lines.refuse(LogFault::Header(header)));
        };
        let whole = lines.refuse_file(LogFault::TooShort);
        let accelerometer = lines.accelerometer();
        let mut reader = Rows::new(lines, columns, options, false)?;
        let mut rows: Vec<Row> = Vec::new();
        while let Some(row) = reader.next_row()? {
            rows.push(row);
        }
        if rows.len() < 2 {
            return Err(whole);
        }
        let log = Self {
            rows,
            accelerometer,
        };
        Ok((log, reader.take_notices()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb_models::motion::geometry::Quaternion;
    use proptest::prelude::*;
    use std::fs::File;
    use std::io::{self, Write};
    use std::path::PathBuf;

    const HEADER: &str = "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov";
    const GOOD: &str = "0,0,0,9.81,0.1,0.2,0.3,1,0,0,0,1";

    /// Returns the line of the fault, if one line has it, and the fault.
    type Refusal = (Option<u64>, LogFault);

    fn parse(text: impl AsRef<[u8]>) -> Result<Log, Refusal> {
        let bytes = io::Cursor::new(text.as_ref().to_vec());
        Lines::new(Path::new("test.csv"), bytes)
            .map_err(|error| (None, LogFault::Read(error)))
            .and_then(|lines| {
                Log::parse(lines, RowOptions::default()).map_err(|error| (error.line, error.reason))
            })
            .map(|(log, _)| log)
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
        assert!(with_truth.rows()[1].scored);
        let with_compass =
            parse("t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n0,1,2,3,4,5,6,-7.5,8,9\n1,1,2,3,4,5,6,,,\n")
                .unwrap();
        assert_eq!(with_compass.rows()[0].field_ut, Some([-7.5, 8.0, 9.0]));
        assert_eq!(with_compass.rows()[1].field_ut, None);
        assert!(with_compass.rows()[1].scored);
        let with_both = parse(
            "t_us,ax,ay,az,gx,gy,gz,mx,my,mz,qw,qx,qy,qz,mov\n\
             0,1,2,3,4,5,6,7,8,9,0,1,0,0,0\n1,1,2,3,4,5,6,,,,,,,,1\n",
        )
        .unwrap();
        let (first, second) = (&with_both.rows()[0], &with_both.rows()[1]);
        assert_eq!(first.field_ut, Some([7.0, 8.0, 9.0]));
        assert_eq!(first.attitude, Some(Quaternion::new(0.0, 1.0, 0.0, 0.0)));
        assert!(!first.scored && second.scored && second.attitude.is_none());
        let armed = parse(
            "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,armed\n\
             0,1,2,3,4,5,6,0,1,0,0,\n1,1,2,3,4,5,6,,,,,1\n2,1,2,3,4,5,6,,,,,0\n",
        )
        .unwrap();
        let states: Vec<_> = armed.rows().iter().map(|row| row.armed).collect();
        assert_eq!(states, [None, Some(true), Some(false)]);
        assert!(armed.rows()[0].attitude.is_some() && armed.rows()[0].scored);
        let full = parse(format!("{HEADER}\n{GOOD}\n1,0,0,9.81,0,0,0,,,,,0\n")).unwrap();
        assert!(full.rows()[0].scored && !full.rows()[1].scored);
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
            ("x", "1 columns"),
            ("1,0,0,up,0,0,0,1,0,0,0,1", "az is \"up\""),
            ("1,0,0,,0,0,0,1,0,0,0,1", "az is \"\""),
            ("1,0,0,9.81,NaN,0,0,1,0,0,0,1", "gx is NaN"),
            ("1,0,0,9.81,0,inf,0,1,0,0,0,1", "gy is inf"),
            (
                "1.5,0,0,9.81,0,0,0,1,0,0,0,1",
                "t_us is \"1.5\", which is not a whole number of microseconds: \
                 did you mean seconds (--time-unit s), milli",
            ),
            (
                "0,0,0,9.81,0,0,0,1,0,0,0,1",
                "t_us is 0, not after the row before, 0",
            ),
            ("-1,0,0,9.81,0,0,0,1,0,0,0,1", "not after"),
            (
                "1,0,0,4096,0,0,0,1,0,0,0,1",
                "az is 4096, which no such sensor reports; m/s² is expected: did you mean mg",
            ),
            (
                "1,0,0,9.81,0,0,-827,1,0,0,0,1",
                "gz is -827, which no such sensor reports; rad/s is expected: did you mean °/s \
                 (--rate-unit deg/s)",
            ),
            (
                "3000000000000000,0,0,9.81,0,0,0,1,0,0,0,1",
                "t_us is 3000000000000000, which is 95.1 years after the row before, 0",
            ),
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
    fn faults_of_a_compass_name_their_column() {
        let header = "t_us,ax,ay,az,gx,gy,gz,mx,my,mz";
        for (cells, expected) in [
            ("1,,3", "some of mx,my,mz are empty"),
            ("1,2,north", "mz is \"north\""),
            (
                "1,NaN,3",
                "my is NaN, which no compass measures; microtesla",
            ),
            ("30000,2,3", "mx is 30000, which no compass measures"),
            ("1,2,3,4", "11 columns, but the header has 10"),
        ] {
            let text = format!("{header}\n0,0,0,9.81,0,0,0,1,2,3\n1,0,0,9.81,0,0,0,{cells}\n");
            let (line, reason) = parse(text).unwrap_err();
            assert_eq!(line, Some(3), "{cells}");
            assert!(reason.to_string().contains(expected), "{cells}: {reason}");
        }
    }

    #[test]
    fn an_armed_state_that_is_none_names_its_line() {
        for bad in ["yes", "2", "1.0", "true"] {
            let text = format!(
                "t_us,armed,ax,ay,az,gx,gy,gz\n0,,0,0,9.81,0,0,0\n1,{bad},0,0,9.81,0,0,0\n"
            );
            let (line, reason) = parse(text).unwrap_err();
            assert_eq!(line, Some(3), "{bad}");
            let expected = format!("armed is \"{bad}\", but must be 0 or 1, or empty where");
            assert!(reason.to_string().starts_with(&expected), "{reason}");
        }
    }

    #[test]
    fn the_file_as_a_whole_is_checked_too() {
        let stated = format!("# --accelerometer fact\n{HEADER}\n{GOOD}\n");
        let (line, reason) = parse(stated).unwrap_err();
        assert_eq!(line, Some(1));
        assert!(reason.to_string().contains("\"fact\""), "{reason}");
        for empty in ["", "\n"] {
            assert!(matches!(parse(empty), Err((None, LogFault::Empty))));
        }
        let comment = parse("# a comment\n\n");
        assert!(matches!(comment, Err((None, LogFault::NoHeader))));
        assert!(matches!(
            parse(format!("{HEADER}\n{GOOD}\n")),
            Err((None, LogFault::TooShort))
        ));
        for header in [
            "t_us,ax,ay,az,gx,gy",
            "time,ax,ay,az,gx,gy,gz",
            "t_us,ax,ay,az,gx,gy,gz,mov",
            "0,0,0,9.81,0,0,0",
        ] {
            assert!(
                matches!(
                    parse(format!("{header}\n")),
                    Err((Some(1), LogFault::Header(_)))
                ),
                "{header}"
            );
        }
        let led = format!(
            "# 2026-11-22\n# a logger\n{HEADER}\n{GOOD}\n1{}\n",
            &GOOD[1..]
        );
        assert_eq!(parse(led).unwrap().rows().len(), 2);
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
        let advice = "--bad-rows skip uses the rows before the cut";
        assert!(error.to_string().ends_with(advice), "{error}");
        let skip = RowOptions {
            bad_rows: Some(BadRows::Skip),
            ..RowOptions::default()
        };
        let part = Log::read_with(&cut.0, skip).expect("the part before the cut");
        let whole = parse(long_log()).unwrap();
        assert!((2..500).contains(&part.rows().len()));
        assert!(whole.rows().starts_with(part.rows()));
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
            Log::read_with(&damaged.0, skip).unwrap_err().reason,
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
                "{}:3: the row has 1 columns, but the header has 12; \
                 --bad-rows skip leaves such rows out",
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
