//! Row of a log, and its form as text.

use aplomb_models::motion::geometry::{Quaternion, Vector};

use crate::fault::LogFault;

/// Columns in their order. A log has the first 7, 11 or 12 of them.
pub(crate) const COLUMNS: [&str; 12] = [
    "t_us", "ax", "ay", "az", "gx", "gy", "gz", "qw", "qx", "qy", "qz", "mov",
];

/// Largest deviation of a quaternion's length from 1: the truth is often printed with few digits.
const QUATERNION_TOLERANCE: f64 = 0.01;

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
    parse_row_with(line, columns, |cell| cell.parse().ok())
}

/// Reads a row whose time, µs, this function reads.
pub(crate) fn parse_row_with(
    line: &str,
    columns: usize,
    time: impl Fn(&str) -> Option<i64>,
) -> Result<Row, LogFault> {
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
    let time_us = time(cells[0]).ok_or_else(|| LogFault::Time(cells[0].to_owned()))?;
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
