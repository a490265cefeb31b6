//! Reader of a log's rows, for every program: units, order and plausibility in one place.

use std::collections::VecDeque;

use crate::batches::{Batches, EvenRows, ROWS_SHOWING, Timed};
use crate::fault::{LogError, LogFault};
use crate::lines::Lines;
use crate::plausibility::{JUDGED_ROWS, Judge};
use crate::row::{LogColumns, Row, parse_row_with};
use crate::units::{BadRows, RowOptions, TimeUnit};
use crate::wrap::Wraps;

/// Lines after a bad one that are read for one that is good.
const LINES_AFTER: usize = 100;

/// Rows of a log in SI units, or counts, one after the other. Needs the same memory for any log.
pub struct Rows {
    lines: Lines,
    columns: LogColumns,
    options: RowOptions,
    judge: Judge,
    /// First rows, which were judged together, with the numbers of their lines. Later the next
    /// rows, which show whether a time is corrupt.
    ahead: VecDeque<(u64, Row)>,
    /// Error after these rows.
    fault: Option<LogError>,
    is_over: bool,
    /// Number of the line of the last row.
    line: u64,
    skipped: u64,
    /// Place and fault of the first row that was left out.
    first_skipped: Option<LogError>,
    has_warned: bool,
    /// Wraps of the clock, if it may be one of 32 bits that counts microseconds.
    wraps: Option<Wraps>,
    has_wrapped: bool,
    /// Rows whose times come in batches, until their batch is over.
    even: Option<EvenRows<(u64, Row)>>,
}

impl Timed for (u64, Row) {
    fn time_us(&mut self) -> &mut i64 {
        &mut self.1.time_us
    }
}

impl Rows {
    /// Starts a log after its header, which has these columns. `is_raw` if the values are register
    /// counts: their force and rate have no unit.
    ///
    /// # Errors
    ///
    /// Returns an error if the file cannot be read, or its first rows suggest another unit.
    pub fn new(
        lines: Lines,
        columns: LogColumns,
        options: RowOptions,
        is_raw: bool,
    ) -> Result<Self, LogError> {
        let mut rows = Self {
            lines,
            columns,
            options,
            judge: Judge::new(options, is_raw),
            ahead: VecDeque::new(),
            fault: None,
            is_over: false,
            line: 0,
            skipped: 0,
            first_skipped: None,
            has_warned: false,
            wraps: match (options.time_unit, options.bad_rows) {
                (_, Some(BadRows::Keep)) => None,
                (None | Some(TimeUnit::Microseconds), _) => Some(Wraps::default()),
                _ => None,
            },
            has_wrapped: false,
            even: None,
        };
        rows.read_ahead(JUDGED_ROWS.max(ROWS_SHOWING));
        if options.bad_rows != Some(BadRows::Keep) {
            rows.find_batches();
        }
        let first = rows.ahead.iter().map(|(_, row)| row);
        if let Err(fault) = rows.judge.units(first) {
            rows.line = rows.ahead.front().map_or(0, |(line, _)| *line);
            return Err(rows.refuse(fault));
        }
        // The units explain a fault better than the fault itself.
        if let Some(error) = rows.fault.take() {
            return Err(error);
        }
        let first = rows.ahead.iter().map(|(_, row)| row);
        let time_warning = rows.judge.time_warning(first.clone());
        let field_warning = rows.judge.field_warning(first);
        for warning in time_warning.into_iter().chain(field_warning) {
            rows.warn(&warning);
        }
        Ok(rows)
    }

    /// Returns the next row; `None` after the last.
    ///
    /// # Errors
    ///
    /// Returns the place and the fault of a bad row, unless the options leave it out or keep it.
    /// No option keeps rates that suggest another unit.
    pub fn next_row(&mut self) -> Result<Option<Row>, LogError> {
        loop {
            self.read_ahead(1);
            let Some((line, row)) = self.ahead.pop_front() else {
                if let Some(error) = self.fault.take() {
                    return Err(error);
                }
                self.end()?;
                return Ok(None);
            };
            self.line = line;
            let verdict = match self.rule() {
                BadRows::Keep => self.judge.rates(&row),
                BadRows::Refuse | BadRows::Skip => self.judge(&row),
            };
            match verdict.map_err(|fault| self.refuse(fault)) {
                Ok(()) => {
                    let watched = self.judge.watch(&row);
                    watched.map_err(|fault| self.lines.refuse_file(fault))?;
                    return Ok(Some(row));
                }
                Err(error) => self.skip_or_refuse(error)?,
            }
        }
    }

    /// Reads rows until this number waits, or to the end or an error.
    fn read_ahead(&mut self, count: usize) {
        while self.ahead.len() < count && self.fault.is_none() && !self.is_over {
            match (self.read(), &mut self.even) {
                (Ok(Some(row)), None) => self.ahead.push_back(row),
                (Ok(Some(row)), Some(even)) => self.ahead.extend(even.push(row)),
                (Ok(None), _) => self.is_over = true,
                (Err(error), _) => self.fault = Some(error),
            }
            self.end_batches();
        }
    }

    /// Spreads the times from the first row on, if those of the first rows come in batches.
    fn find_batches(&mut self) {
        let times_us: Vec<i64> = self.ahead.iter().map(|(_, row)| row.time_us).collect();
        let Some(batches) = Batches::find(&times_us) else {
            return;
        };
        let text = format!("{}: {}", self.lines.name(), batches.message());
        self.lines.notify("note", text);
        let mut even = EvenRows::new(batches);
        let first = std::mem::take(&mut self.ahead);
        self.ahead = first.into_iter().flat_map(|row| even.push(row)).collect();
        self.even = Some(even);
        self.end_batches();
    }

    /// Takes the rows of the last batch, if no row follows.
    fn end_batches(&mut self) {
        if (self.is_over || self.fault.is_some())
            && let Some(even) = &mut self.even
        {
            self.ahead.extend(even.end());
        }
    }

    /// Judges a row by those before it, and its time by the next two rows too.
    fn judge(&mut self, row: &Row) -> Result<(), LogFault> {
        self.read_ahead(2);
        let after = [0, 1].map(|index| self.ahead.get(index).map(|(_, row)| row.time_us));
        let now = row.time_us;
        match after[0] {
            Some(next) if self.judge.is_misplaced(now, after) => {
                Err(LogFault::Misplaced { now, next })
            }
            _ => self.judge.row(row),
        }
    }

    /// Reports what was left out, and judges the recording as a whole after its last row.
    fn end(&mut self) -> Result<(), LogError> {
        self.report_skipped();
        let judged = self.judge.end();
        if let Some(warning) = judged.map_err(|fault| self.lines.refuse_file(fault))? {
            self.warn(&warning);
        }
        Ok(())
    }

    /// Reports a warning on the whole file.
    fn warn(&mut self, warning: &str) {
        let text = format!("{}: {warning}", self.lines.name());
        self.lines.notify("warning", text);
    }

    /// Returns the warnings and notes that [`Lines::collect_notices`] has collected.
    pub(crate) fn take_notices(&mut self) -> Vec<String> {
        self.lines.take_notices()
    }

    /// Returns the error of the last row, for this reason.
    #[must_use]
    pub fn refuse(&self, reason: LogFault) -> LogError {
        LogError {
            line: Some(self.line),
            ..self.lines.refuse_file(reason)
        }
    }

    /// Returns the name of the input, for messages.
    #[must_use]
    pub fn name(&self) -> String {
        self.lines.name()
    }

    /// Returns the place of the last row: the file and the number of the line.
    #[must_use]
    pub fn place(&self) -> String {
        format!("{}:{}", self.lines.name(), self.line)
    }

    /// Returns the number of the last row's line, counted from 1.
    #[must_use]
    pub fn line(&self) -> u64 {
        self.line
    }

    /// Returns the number of rows that were left out, and the first of them.
    #[must_use]
    pub fn skipped(&self) -> (u64, Option<&LogError>) {
        (self.skipped, self.first_skipped.as_ref())
    }

    fn rule(&self) -> BadRows {
        self.options.bad_rows.unwrap_or_default()
    }

    /// Reads the next row that has the form of one, with the number of its line.
    fn read(&mut self) -> Result<Option<(u64, Row)>, LogError> {
        let skips = self.rule() == BadRows::Skip;
        loop {
            let error = match self.lines.next_line() {
                Ok(Some(line)) => match parse_row_in(line, self.columns, &self.options) {
                    Ok(row) => return Ok(Some((self.lines.number(), self.count_on(row)))),
                    Err(fault) => self.lines.refuse(fault),
                },
                Ok(None) => return Ok(None),
                Err(error) if skips && error.reason.is_cut_off() => {
                    let text = format!("{error}: the rows before the cut are used");
                    self.lines.notify("warning", text);
                    return Ok(None);
                }
                Err(error) => error,
            };
            self.skip_or_refuse(error)?;
        }
    }

    /// Counts the time of a row on, where the clock has wrapped.
    fn count_on(&mut self, mut row: Row) -> Row {
        let Some(wraps) = &mut self.wraps else {
            return row;
        };
        let (time_us, has_wrapped) = wraps.count(row.time_us);
        row.time_us = time_us;
        if has_wrapped && !std::mem::replace(&mut self.has_wrapped, true) {
            let text = format!(
                "{}: t_us begins again, as a clock of 32 bits does after 71.6 minutes: it is \
                 counted on",
                self.lines.place()
            );
            self.lines.notify("note", text);
        }
        row
    }

    fn skip_or_refuse(&mut self, mut error: LogError) -> Result<(), LogError> {
        let is_of_a_row = error.reason.is_of_a_row();
        if !is_of_a_row || self.rule() != BadRows::Skip {
            error.can_be_skipped = match error.reason.is_cut_off() {
                true => self.judge.has_row() || !self.ahead.is_empty(),
                false => is_of_a_row && self.has_good_rows(),
            };
            return Err(error);
        }
        // A line without end cannot be left out.
        if matches!(error.reason, LogFault::LineTooLong) {
            return Err(error);
        }
        self.skipped += 1;
        self.first_skipped.get_or_insert(error);
        Ok(())
    }

    /// Returns whether rows are left without the bad ones: one of the next, or one before the end.
    fn has_good_rows(&mut self) -> bool {
        let (mut judge, mut wraps) = (self.judge.clone(), self.wraps);
        if self.ahead.iter().any(|(_, row)| judge.row(row).is_ok()) {
            return true;
        }
        for _ in 0..LINES_AFTER {
            let Ok(Some(line)) = self.lines.next_line() else {
                return self.judge.has_row() && self.ahead.is_empty();
            };
            if let Ok(mut row) = parse_row_in(line, self.columns, &self.options) {
                if let Some(wraps) = &mut wraps {
                    row.time_us = wraps.count(row.time_us).0;
                }
                if judge.row(&row).is_ok() {
                    return true;
                }
            }
        }
        false
    }

    /// Reports once which rows were left out.
    fn report_skipped(&mut self) {
        if let Some(first) = &self.first_skipped
            && !std::mem::replace(&mut self.has_warned, true)
        {
            let text = format!("{} bad rows are left out; the first: {first}", self.skipped);
            self.lines.notify("warning", text);
        }
    }
}

/// Reads a row in the units of these options. Checks its form alone, like
/// [`parse_row`](crate::row::parse_row).
///
/// # Errors
///
/// Returns the fault of the first cell that is wrong.
pub fn parse_row_in(
    line: &str,
    columns: LogColumns,
    options: &RowOptions,
) -> Result<Row, LogFault> {
    let time = |cell: &str| options.time_us(cell);
    let mut row = parse_row_with(line, columns, time, options.field_ut())?;
    options.convert(&mut row);
    Ok(row)
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;
    use std::path::Path;

    use super::*;
    use crate::units::{FieldUnit, ForceUnit, RateUnit, TimeUnit};

    const SI: RowOptions = RowOptions {
        time_unit: None,
        force_unit: None,
        rate_unit: None,
        field_unit: None,
        bad_rows: None,
    };
    const SKIP: RowOptions = RowOptions {
        bad_rows: Some(BadRows::Skip),
        ..SI
    };

    /// Returns the rows, and how many were left out.
    fn read(text: &str, options: RowOptions, is_raw: bool) -> Result<(Vec<Row>, u64), String> {
        read_columns(text, LogColumns::SENSOR, options, is_raw)
    }

    /// Returns the rows of these columns, and how many were left out.
    fn read_columns(
        text: &str,
        columns: LogColumns,
        options: RowOptions,
        is_raw: bool,
    ) -> Result<(Vec<Row>, u64), String> {
        let bytes = std::io::Cursor::new(text.to_owned().into_bytes());
        let lines = Lines::new(Path::new("test.csv"), bytes).expect("memory is read");
        let reader = Rows::new(lines, columns, options, is_raw);
        let mut reader = reader.map_err(|error| error.to_string())?;
        let mut rows = Vec::new();
        while let Some(row) = reader.next_row().map_err(|error| error.to_string())? {
            rows.push(row);
        }
        Ok((rows, reader.skipped().0))
    }

    /// Returns 20 s at 100 Hz of a sensor that is turned by hand, in these units of time, force and
    /// rate: 1 for µs, m/s² and rad/s.
    fn turned(time: f64, force: f64, rate: f64) -> String {
        (0..2_000).fold(String::new(), |mut text, index| {
            let angle = f64::from(index) * 0.01;
            let (y, z) = (9.81 * angle.sin() * force, 9.81 * angle.cos() * force);
            let t = f64::from(index) * 10_000.0 * time;
            writeln!(text, "{t},0,{y:.5},{z:.5},{:.5},0,0", rate).expect("memory");
            text
        })
    }

    #[test]
    fn each_wrong_unit_is_named_with_the_option_that_converts_it() {
        let (expected, _) = read(&turned(1.0, 1.0, 1.0), SI, false).expect("SI units");
        let degrees = 57.295_78;
        let g = 1.0 / 9.806_65;
        let cases = [
            (
                (1e-3, 1.0, 1.0),
                "--time-unit ms",
                RowOptions {
                    time_unit: Some(TimeUnit::Milliseconds),
                    ..SI
                },
            ),
            (
                (1e-6, 1.0, 1.0),
                "--time-unit s",
                RowOptions {
                    time_unit: Some(TimeUnit::Seconds),
                    ..SI
                },
            ),
            (
                (1e3, 1.0, 1.0),
                "--time-unit ns",
                RowOptions {
                    time_unit: Some(TimeUnit::Nanoseconds),
                    ..SI
                },
            ),
            (
                (1.0, g, 1.0),
                "--force-unit g",
                RowOptions {
                    force_unit: Some(ForceUnit::G),
                    ..SI
                },
            ),
            (
                (1.0, 1e3 * g, 1.0),
                "--force-unit mg",
                RowOptions {
                    force_unit: Some(ForceUnit::MilliG),
                    ..SI
                },
            ),
            (
                (1.0, 1.0, degrees),
                "--rate-unit deg/s",
                RowOptions {
                    rate_unit: Some(RateUnit::DegreesPerSecond),
                    ..SI
                },
            ),
        ];
        for ((time, force, rate), option, options) in cases {
            let text = turned(time, force, rate);
            let refusal = read(&text, SI, false).expect_err(option);
            assert!(refusal.contains("did you mean"), "{refusal}");
            assert!(
                refusal.contains(&format!("({option})")),
                "{option}: {refusal}"
            );
            // No rule for bad rows makes the right units of them.
            assert!(read(&text, SKIP, false).is_err(), "{option}");
            let (rows, _) = read(&text, options, false).expect(option);
            for (row, expected) in rows.iter().zip(&expected) {
                assert_eq!(row.time_us, expected.time_us, "{option}");
                let values = row.specific_force_m_s2.iter().chain(&row.rates_rad_s);
                let expected = expected
                    .specific_force_m_s2
                    .iter()
                    .chain(&expected.rates_rad_s);
                for (value, expected) in values.zip(expected) {
                    assert!(
                        (value - expected).abs() < 2e-4,
                        "{option}: {value} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_field_in_another_unit_is_named_with_the_option_that_converts_it() {
        // A compass face up in Central Europe, which turns about the vertical.
        let turning = |unit_ut: f64, hard_iron_ut: f64| -> String {
            (0..300).fold(String::new(), |mut text, index| {
                let angle = f64::from(index) * 0.02;
                let x = (20.0 * angle.cos() + hard_iron_ut) / unit_ut;
                let (y, z) = (-20.0 * angle.sin() / unit_ut, -44.0 / unit_ut);
                let field = if index % 3 == 0 {
                    format!("{x:e},{y:e},{z:e}")
                } else {
                    ",,".to_owned()
                };
                let t_us = index * 10_000;
                writeln!(text, "{t_us},0,0.0{index},9.81,0,0,0.2,{field}").expect("memory");
                text
            })
        };
        let columns = LogColumns::of("t_us,ax,ay,az,gx,gy,gz,mx,my,mz").expect("a log");
        let read = |text: &str, options: RowOptions| read_columns(text, columns, options, false);
        let field = |rows: &[Row]| rows.first().and_then(|row| row.field_ut).expect("a field");
        let with = |unit: FieldUnit| RowOptions {
            field_unit: Some(unit),
            ..SI
        };
        for hard_iron_ut in [0.0, 25.0, 150.0] {
            let (rows, _) = read(&turning(1.0, hard_iron_ut), SI).expect("microtesla");
            let expected = field(&rows);
            for (name, unit_ut, unit) in [
                ("G", 100.0, FieldUnit::Gauss),
                ("T", 1e6, FieldUnit::Tesla),
                ("nT", 1e-3, FieldUnit::Nanotesla),
            ] {
                let text = turning(unit_ut, hard_iron_ut);
                let refusal = read(&text, SI).expect_err(name);
                assert!(
                    refusal.contains(&format!("(--field-unit {name})")),
                    "{name}: {refusal}"
                );
                let (rows, _) = read(&text, with(unit)).expect(name);
                for (found, expected) in field(&rows).iter().zip(expected) {
                    assert!(
                        (found - expected).abs() < 1e-6,
                        "{name}: {found} {expected}"
                    );
                }
            }
        }
        // Normalized readings have the length 1, and none of a gauss.
        let normalized = turning(f64::hypot(20.0, 44.0), 0.0);
        let refusal = read(&normalized, SI).expect_err("normalized");
        assert!(refusal.contains("(--field-unit norm)"), "{refusal}");
        let (rows, _) = read(&normalized, with(FieldUnit::Normalized)).expect("normalized");
        assert!((field(&rows)[2] + 45.5).abs() < 0.1, "{:?}", field(&rows));
        let gauss = read(&normalized, with(FieldUnit::Gauss)).expect("given");
        assert!((field(&gauss.0)[2] + 91.0).abs() < 0.1);
        // Milligauss may be microtesla with a magnet beside them.
        let judge = Judge::new(SI, false);
        let warning = |text: &str| {
            let (rows, _) = read(text, SI).expect("it passes");
            judge.field_warning(rows.iter())
        };
        assert_eq!(warning(&turning(1.0, 25.0)), None);
        let milligauss = warning(&turning(0.1, 0.0)).expect("a warning");
        assert!(milligauss.contains("--field-unit mG"), "{milligauss}");
    }

    #[test]
    fn counts_are_told_from_si_units_and_units_that_are_given_are_believed() {
        let counts: String = (0..50).fold(String::new(), |mut text, index| {
            writeln!(text, "{},12,-30,2048,1,-2,3", index * 1_000).expect("memory");
            text
        });
        let refusal = read(&counts, SI, false).expect_err("counts");
        assert!(refusal.contains("register counts (add --raw"), "{refusal}");
        assert_eq!(read(&counts, SI, true).expect("counts").0.len(), 50);
        // A drop tower, in m/s².
        let falling = turned(1.0, 0.1, 1.0);
        assert!(read(&falling, SI, false).is_err());
        let given = RowOptions {
            force_unit: Some(ForceUnit::MetresPerSecondSquared),
            ..SI
        };
        assert_eq!(read(&falling, given, false).expect("given").0.len(), 2_000);
    }

    #[test]
    fn a_bad_row_is_refused_or_left_out_or_kept() {
        let good = |time: u32| format!("{time},0,0,9.81,0,0,0");
        for (bad, can_be_kept) in [
            ("1000,0,0,9.81,0,0,0", true),
            ("3000,0,0,nan,0,0,0", true),
            ("3000,0,inf,9.81,0,0,0", true),
            ("3000,0,0,1e30,0,0,0", true),
            ("3000000000000000,0,0,9.81,0,0,0", true),
            ("3000,0,0", false),
            ("3000,0,0,9.8l,0,0,0", false),
            ("\u{0}", false),
        ] {
            let text = format!("{}\n{bad}\n{}\n{}\n", good(1000), good(2000), good(4000));
            let refusal = read(&text, SI, false).expect_err(bad);
            assert!(refusal.starts_with("test.csv:2: "), "{bad}: {refusal}");
            assert!(
                refusal.ends_with("; --bad-rows skip leaves such rows out"),
                "{refusal}"
            );
            let (rows, skipped) = read(&text, SKIP, false).expect(bad);
            let times: Vec<i64> = rows.iter().map(|row| row.time_us).collect();
            assert_eq!((times, skipped), (vec![1000, 2000, 4000], 1), "{bad}");
            let keep = RowOptions {
                bad_rows: Some(BadRows::Keep),
                ..SI
            };
            assert_eq!(read(&text, keep, false).is_ok(), can_be_kept, "{bad}");
        }
    }

    #[test]
    fn a_corrupt_time_costs_its_row_alone() {
        let log = |times: &[i64]| -> String {
            times
                .iter()
                .enumerate()
                .fold(String::new(), |mut text, (index, time)| {
                    writeln!(text, "{time},0,0.0{index},9.81,0,0,0.2").expect("memory");
                    text
                })
        };
        let times: Vec<i64> = (0..600).map(|row| 10_000 * (row + 5)).collect();
        for place in [0, 1, 2, 50, 254, 255, 256, 257, 400, 597, 598, 599] {
            for shift in [
                -1_700_000_000_000_000,
                -25_000,
                -12_000,
                12_000,
                25_000,
                3_000_000,
                1 << 31,
                1_700_000_000_000_000,
            ] {
                let mut corrupt = times.clone();
                corrupt[place] += shift;
                // A row that is the last one may come late.
                if place + 1 == times.len() && (0..=3_600_000_000).contains(&shift)
                    || place == 0 && (-3_600_000_000..0).contains(&shift)
                {
                    continue;
                }
                let text = log(&corrupt);
                let refusal = read(&text, SI, false).expect_err("a corrupt row");
                let expected = format!("test.csv:{}: t_us is ", place + 1);
                assert!(refusal.starts_with(&expected), "{place} {shift}: {refusal}");
                assert!(refusal.ends_with("leaves such rows out"), "{refusal}");
                let (rows, skipped) = read(&text, SKIP, false).expect("it is left out");
                assert_eq!(skipped, 1, "{place} {shift}");
                let found: Vec<i64> = rows.iter().map(|row| row.time_us).collect();
                let mut expected = times.clone();
                expected.remove(place);
                assert_eq!(found, expected, "{place} {shift}");
            }
        }
        // A pause of the logger is no corrupt time.
        let mut paused = times.clone();
        for time in &mut paused[300..] {
            *time += 60_000_000;
        }
        assert_eq!(read(&log(&paused), SKIP, false).expect("a pause").1, 0);
    }

    #[test]
    fn an_offset_in_degrees_per_second_is_refused_in_a_rest() {
        let rest = |rates: &str| {
            (0..500).fold(String::new(), |mut text, index| {
                writeln!(text, "{},0.2,0.1,9.8,{rates}", index * 10_000).expect("memory");
                text
            })
        };
        let refusal = read(&rest("2.1,-3.2,1.4"), SI, false).expect_err("these are °/s");
        assert!(
            refusal.contains("the rate, while the force keeps its direction, is mostly 4.076"),
            "{refusal}"
        );
        assert!(refusal.contains("(--rate-unit deg/s)"), "{refusal}");
        for unit in [RateUnit::DegreesPerSecond, RateUnit::RadiansPerSecond] {
            let options = RowOptions {
                rate_unit: Some(unit),
                ..SI
            };
            let read = read(&rest("2.1,-3.2,1.4"), options, false);
            assert!(read.is_ok_and(|(rows, _)| rows.len() == 500));
        }
        assert!(read(&rest("0.037,-0.056,0.024"), SI, false).is_ok());
    }

    /// Before, `Keep` skipped this check: bench scored rates in °/s as rad/s.
    #[test]
    fn rates_of_another_unit_are_refused_where_any_row_is_kept() {
        let keep = RowOptions {
            bad_rows: Some(BadRows::Keep),
            ..SI
        };
        let fast = turned(1.0, 1.0, 57.295_78);
        let rest = (0..500).fold(String::new(), |mut text, index| {
            writeln!(text, "{},0.2,0.1,9.8,2.1,-3.2,1.4", index * 10_000).expect("memory");
            text
        });
        for text in [&fast, &rest] {
            let refusal = read(text, keep, false).expect_err("these are °/s");
            assert!(refusal.contains("(--rate-unit deg/s)"), "{refusal}");
            let given = RowOptions {
                rate_unit: Some(RateUnit::RadiansPerSecond),
                ..keep
            };
            assert!(read(text, given, false).is_ok());
            assert!(read(text, keep, true).is_ok(), "counts have no unit");
        }
        // Single rows may have any value.
        let slow = turned(1.0, 1.0, 1.0);
        for bad in ["1e30", "nan", "-inf", "4000"] {
            let rows = slow.lines().enumerate().map(|(index, line)| {
                let cells: Vec<&str> = line.split(',').collect();
                match index % 50 {
                    7 => format!(
                        "{},{},{},{},{bad},0,0\n",
                        cells[0], cells[1], cells[2], cells[3]
                    ),
                    _ => format!("{line}\n"),
                }
            });
            let (rows, _) = read(&rows.collect::<String>(), keep, false).expect(bad);
            assert_eq!(rows.len(), 2_000, "{bad}");
        }
    }

    #[test]
    fn a_clock_of_32_bits_is_counted_on() {
        let log = (0..1_000_i64).fold(String::new(), |mut text, index| {
            let time_us = (4_290_000_000 + index * 10_000) % (1 << 32);
            writeln!(text, "{time_us},0.2,0.1,9.8,0.01,0,0").expect("memory");
            text
        });
        for options in [SI, SKIP] {
            let (rows, skipped) = read(&log, options, false).expect("it is counted on");
            assert_eq!((rows.len(), skipped), (1_000, 0));
            let steps = rows
                .windows(2)
                .map(|pair| pair[1].time_us - pair[0].time_us);
            assert!(steps.into_iter().all(|step| step == 10_000));
        }
    }

    #[test]
    fn a_last_row_that_ends_in_a_number_is_a_bad_row() {
        let log = turned(1.0, 1.0, 1.0);
        let log = log.lines().map(|line| format!("{line}.25\n"));
        let log: String = log.collect();
        let whole = log.trim_end();
        assert_eq!(read(whole, SI, false).expect("no line end").0.len(), 2_000);
        for cut in [1, 2, 3] {
            let text = &whole[..whole.len() - cut];
            let refusal = read(text, SI, false).expect_err("a cut row");
            assert!(
                refusal.contains("test.csv:2000: the last row ends in"),
                "{refusal}"
            );
            assert!(refusal.ends_with("leaves such rows out"), "{refusal}");
            let (rows, skipped) = read(text, SKIP, false).expect("it is left out");
            assert_eq!((rows.len(), skipped), (1_999, 1));
        }
        // With a line end, the number is whole.
        let ended = format!("{}\n", &whole[..whole.len() - 1]);
        assert!(read(&ended, SI, false).is_ok());
        // Without decimals nothing shows a cut.
        let counts = turned(1.0, 1.0, 1.0);
        let counts = counts.trim_end();
        assert!(read(counts, SI, false).is_ok());
    }

    #[test]
    fn times_keep_their_microseconds_in_every_unit() {
        for (unit, cell, expected) in [
            (TimeUnit::Seconds, "1700000000", Some(1_700_000_000_000_000)),
            (TimeUnit::Seconds, "0.0000015", Some(2)),
            (TimeUnit::Milliseconds, "-2.5", Some(-2_500)),
            (
                TimeUnit::Nanoseconds,
                "1700000000123456789",
                Some(1_700_000_000_123_456),
            ),
            (TimeUnit::Microseconds, "1.5", Some(2)),
            (TimeUnit::Seconds, "9223372036854775807", None),
            (TimeUnit::Seconds, "1e300", None),
            (TimeUnit::Seconds, "nan", None),
            (TimeUnit::Seconds, "", None),
        ] {
            let options = RowOptions {
                time_unit: Some(unit),
                ..SI
            };
            assert_eq!(options.time_us(cell), expected, "{cell}");
        }
        assert_eq!(SI.time_us("1.0"), None);
    }
}
