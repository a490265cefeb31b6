//! Reader of a table of bursts, row by row, for every command.

use aplomb::telemetry::bursts;
use aplomb_recordings::log::{Lines, LogFault};
use aplomb_recordings::terminal::print_message;
use aplomb_recordings::units::BadRows;

/// Rows of a table of bursts.
pub struct BurstRows {
    lines: Lines,
    skips: bool,
    has_row: bool,
    skipped: u64,
    /// Place and fault of the first row that was left out.
    first_skipped: Option<String>,
}

impl BurstRows {
    /// Starts a table after its header, with this rule for bad rows. Default: an error.
    pub fn new(lines: Lines, rule: Option<BadRows>) -> Self {
        Self {
            lines,
            skips: rule == Some(BadRows::Skip),
            has_row: false,
            skipped: 0,
            first_skipped: None,
        }
    }

    /// Returns the next row; `None` after the last.
    ///
    /// # Errors
    ///
    /// Returns the place and the fault of a bad row, unless the rule leaves it out.
    pub fn next_row(&mut self) -> Result<Option<bursts::Row>, String> {
        loop {
            let error = match self.lines.next_line() {
                Ok(Some(line)) => match bursts::decode(line) {
                    Ok(row) => {
                        self.has_row = true;
                        return Ok(Some(row));
                    }
                    Err(reason) if self.skips => format!("{}: {reason}", self.lines.place()),
                    Err(reason) => {
                        let place = self.lines.place();
                        let advice = "--bad-rows skip leaves such rows out";
                        return Err(format!("{place}: {reason}; {advice}"));
                    }
                },
                Ok(None) => {
                    self.report_skipped();
                    return Ok(None);
                }
                Err(error) if self.skips && error.reason.is_cut_off() => {
                    let text = format!("warning: {error}: the rows before the cut are used");
                    print_message(&text);
                    self.report_skipped();
                    return Ok(None);
                }
                // A line without end cannot be left out.
                Err(error)
                    if self.skips
                        && error.reason.is_of_a_row()
                        && !matches!(error.reason, LogFault::LineTooLong) =>
                {
                    error.to_string()
                }
                Err(mut error) => {
                    let is_of_some = error.reason.is_cut_off() || error.reason.is_of_a_row();
                    error.can_be_skipped = self.has_row && is_of_some;
                    return Err(error.to_string());
                }
            };
            self.skipped += 1;
            self.first_skipped.get_or_insert(error);
        }
    }

    /// Reports once which rows were left out.
    fn report_skipped(&mut self) {
        if let Some(first) = self.first_skipped.take() {
            print_message(&format!(
                "warning: {} bad rows are left out; the first: {first}",
                self.skipped
            ));
        }
    }

    /// Returns the name of the input, for messages.
    pub fn name(&self) -> String {
        self.lines.name()
    }

    /// Returns the place of the last row: the file and the number of the line.
    pub fn place(&self) -> String {
        self.lines.place()
    }
}
