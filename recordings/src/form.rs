//! Forms of a text with sensor data, by its header.

use std::error::Error;

use aplomb::telemetry::bursts;

use crate::columns::Order;
use crate::fault::{LogError, LogFault};
use crate::lines::Lines;
use crate::row::LogColumns;

/// Form of a text with sensor data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A bursts.csv.
    Bursts,
    /// A log with these columns.
    Log(LogColumns),
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
        if let Some(columns) = LogColumns::of(&header) {
            return Ok(Self::Log(columns));
        }
        // A flight log that was recorded from the module's start begins with lines of text.
        if lines.is_stream() && lines.are_followed_by_a_log() {
            let fault = LogFault::NoTable { is_stream: true };
            return Err(lines.refuse_file(fault).into());
        }
        let fault = LogFault::Header(header);
        Err(format!("{}; or {} for bursts", lines.refuse(fault), bursts::HEADER).into())
    }
}

/// Reads the header of a table: the next line that is no comment. A comment may state the
/// knowledge of the accelerometer: see [`Lines::accelerometer`]. From then on the columns of a
/// log come in their usual order, whatever that of the table is, without those of other names.
///
/// # Errors
///
/// Returns an error with the place if the file has no header, cannot be read, or is no table.
pub fn header(lines: &mut Lines) -> Result<String, LogError> {
    let mut has_comment = false;
    loop {
        match lines.next_line() {
            Ok(Some(line)) if line.starts_with('#') => {
                has_comment = true;
                lines.take_comment()?;
            }
            Ok(Some(header)) => {
                let header = header.to_owned();
                if LogColumns::of(&header).is_none()
                    && let Some((order, header)) = Order::of(&header)
                {
                    lines.set_order(order);
                    return Ok(header);
                }
                return Ok(header);
            }
            Ok(None) if has_comment => return Err(lines.refuse_file(LogFault::NoHeader)),
            Ok(None) => return Err(lines.refuse_file(LogFault::Empty)),
            // A flight log has NUL bytes and others of no text.
            Err(error) if matches!(error.reason, LogFault::NotText | LogFault::Nuls(_)) => {
                if lines.is_of_a_text() {
                    return Err(error);
                }
                break;
            }
            Err(error) => return Err(error),
        }
    }
    let is_stream = lines.is_stream();
    Err(lines.refuse(LogFault::NoTable { is_stream }))
}
