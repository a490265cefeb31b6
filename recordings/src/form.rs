//! Forms of a text with sensor data, by its header.

use std::error::Error;

use aplomb::telemetry::bursts;

use crate::log::{Lines, LogError, LogFault, column_count};

/// Form of a text with sensor data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A bursts.csv.
    Bursts,
    /// A log with this number of columns.
    Log(usize),
}

impl Form {
    /// Reads the header, which is the next line.
    ///
    /// # Errors
    ///
    /// Returns an error with the place if the header is neither a log's nor that of bursts.
    pub fn read(lines: &mut Lines) -> Result<Self, Box<dyn Error>> {
        let header = header(lines)?;
        if header == bursts::HEADER {
            return Ok(Self::Bursts);
        }
        if let Some(columns) = column_count(&header) {
            return Ok(Self::Log(columns));
        }
        let fault = LogFault::Header(header);
        Err(format!("{}; or {} for bursts", lines.refuse(fault), bursts::HEADER).into())
    }
}

/// Reads the header of a table, which is the next line.
///
/// # Errors
///
/// Returns an error with the place if the file is empty, cannot be read, or is no table.
pub fn header(lines: &mut Lines) -> Result<String, Box<dyn Error>> {
    match lines.next_line() {
        // Before its first frame a module sends messages.
        Ok(Some(header)) if !header.contains('\0') && !header.starts_with('#') => {
            return Ok(header.to_owned());
        }
        Ok(None) => return Err(lines.refuse_file(LogFault::Empty).into()),
        Ok(Some(_))
        | Err(LogError {
            reason: LogFault::NotText,
            ..
        }) => {}
        Err(error) => return Err(error.into()),
    }
    Err(format!(
        "{}: it is no table. A flight log has to be a file, not standard input; \
         `replay` and `plot` take it, and `convert` makes a table of it",
        lines.place()
    )
    .into())
}
