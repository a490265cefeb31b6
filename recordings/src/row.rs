//! Row of a log, and its form as text.

use aplomb_models::motion::geometry::{Quaternion, Vector};

use crate::fault::LogFault;

/// Columns of sensor and truth, in their order. A log has the first 7, 11 or 12 of them.
pub(crate) const COLUMNS: [&str; 12] = [
    "t_us", "ax", "ay", "az", "gx", "gy", "gz", "qw", "qx", "qy", "qz", "mov",
];

/// Columns of a compass, which stand before `qw`.
pub(crate) const COMPASS: [&str; 3] = ["mx", "my", "mz"];

/// Column of the armed state, the last one.
pub(crate) const ARMED: [&str; 1] = ["armed"];

/// Columns before those of a compass.
pub(crate) const SENSOR_COLUMNS: usize = 7;

/// Largest plausible magnetic field, µT: the compasses of this kind end at 4,912 µT.
const LARGEST_FIELD_UT: f64 = 10_000.0;

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
    /// Magnetic field in sensor axes, µT; `None` where there is no new reading.
    pub field_ut: Option<Vector>,
    /// True attitude, sensor → earth with z up, of length 1.
    pub attitude: Option<Quaternion>,
    /// True if the row counts for scores: its cell `mov` is 1, or the log has no such column.
    pub scored: bool,
    /// State of the vehicle from this row on; `None` where it stays as it is.
    pub armed: Option<bool>,
}

/// Columns that a log has, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogColumns {
    /// Number of the compass's columns.
    compass: usize,
    /// Number of the truth's columns, `mov` included.
    truth: usize,
    /// Number of the armed state's columns.
    armed: usize,
}

impl LogColumns {
    /// Columns of a log of a sensor alone.
    pub const SENSOR: Self = Self {
        compass: 0,
        truth: 0,
        armed: 0,
    };

    /// Returns the columns of a log with this header; `None` for another header.
    #[must_use]
    pub fn of(header: &str) -> Option<Self> {
        let (sensor, truths) = COLUMNS.split_at(SENSOR_COLUMNS);
        let lengths = [0, 4, 5].into_iter();
        let groups = [(0, 0), (0, 1), (COMPASS.len(), 0), (COMPASS.len(), 1)];
        let mut forms = lengths.flat_map(|truth| {
            groups.map(|(compass, armed)| Self {
                compass,
                truth,
                armed,
            })
        });
        forms.find(|form| {
            let (compass, truth) = (&COMPASS[..form.compass], &truths[..form.truth]);
            let names = [sensor, compass, truth, &ARMED[..form.armed]].concat();
            header == names.join(",")
        })
    }

    /// Returns the number of columns.
    #[must_use]
    pub const fn count(self) -> usize {
        SENSOR_COLUMNS + self.compass + self.truth + self.armed
    }

    /// Returns whether there are columns of a compass.
    #[must_use]
    pub const fn has_compass(self) -> bool {
        self.compass > 0
    }

    /// Returns whether there are columns of a truth.
    #[must_use]
    pub const fn has_truth(self) -> bool {
        self.truth > 0
    }

    /// Returns whether there is a column of the armed state.
    #[must_use]
    pub const fn has_armed(self) -> bool {
        self.armed > 0
    }
}

/// Reads a row with these columns. Numbers may have any value, also infinite or NaN.
///
/// # Errors
///
/// Returns the fault of the row.
pub fn parse_row(line: &str, columns: LogColumns) -> Result<Row, LogFault> {
    parse_row_with(line, columns, |cell| cell.parse().ok(), 1.0)
}

/// Reads a row whose time, µs, this function reads. The unit of its field is `unit_ut`, µT.
pub(crate) fn parse_row_with(
    line: &str,
    columns: LogColumns,
    time: impl Fn(&str) -> Option<i64>,
    unit_ut: f64,
) -> Result<Row, LogFault> {
    let mut cells = [""; COLUMNS.len()];
    let mut field_cells = [""; COMPASS.len()];
    let compass = columns.compass;
    let armed_place = columns.count() - columns.armed;
    let mut armed_cell = "";
    let mut found: usize = 0;
    for cell in line.split(',').map(str::trim) {
        let place = match found.checked_sub(SENSOR_COLUMNS) {
            Some(index) if index < compass => field_cells.get_mut(index),
            Some(_) if found >= armed_place => Some(&mut armed_cell),
            Some(_) => cells.get_mut(found - compass),
            None => cells.get_mut(found),
        };
        if let Some(place) = place {
            *place = cell;
        }
        found += 1;
    }
    let expected = columns.count();
    if found != expected {
        return Err(LogFault::ColumnCount { found, expected });
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
    let field_ut = field(field_cells, unit_ut)?;
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
    let scored = match cells[11] {
        "1" => true,
        "" if SENSOR_COLUMNS + columns.truth < COLUMNS.len() => true,
        "0" => false,
        other => return Err(LogFault::Moving(other.to_owned())),
    };
    let armed = match armed_cell {
        "" => None,
        "0" => Some(false),
        "1" => Some(true),
        other => return Err(LogFault::Armed(other.to_owned())),
    };
    Ok(Row {
        time_us,
        specific_force_m_s2,
        rates_rad_s,
        field_ut,
        attitude,
        scored,
        armed,
    })
}

/// Reads the cells of a compass in this unit, µT; `None` if all are empty.
fn field(cells: [&str; 3], unit_ut: f64) -> Result<Option<Vector>, LogFault> {
    if cells.iter().all(|cell| cell.is_empty()) {
        return Ok(None);
    }
    if cells.iter().any(|cell| cell.is_empty()) {
        return Err(LogFault::PartialField);
    }
    let mut field: Vector = [0.0; 3];
    for ((value, cell), column) in field.iter_mut().zip(cells).zip(COMPASS) {
        let number: f64 = cell.parse().map_err(|_| LogFault::NotANumber {
            column,
            text: cell.to_owned(),
        })?;
        *value = number * unit_ut;
        if value.is_nan() || value.abs() > LARGEST_FIELD_UT {
            return Err(LogFault::ImplausibleField {
                column,
                value: number,
            });
        }
    }
    Ok(Some(field))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_shows_which_columns_a_log_has() {
        let sensor = "t_us,ax,ay,az,gx,gy,gz";
        let truths = ["", ",qw,qx,qy,qz", ",qw,qx,qy,qz,mov"];
        let others = ["", ",mx,my,mz"].map(|compass| ["", ",armed"].map(|armed| (compass, armed)));
        for (compass, armed) in others.into_iter().flatten() {
            for truth in truths {
                let header = format!("{sensor}{compass}{truth}{armed}");
                let columns = LogColumns::of(&header).expect("a log");
                assert_eq!(columns.count(), header.split(',').count(), "{header}");
                assert_eq!(columns.has_compass(), !compass.is_empty(), "{header}");
                assert_eq!(columns.has_truth(), !truth.is_empty(), "{header}");
                assert_eq!(columns.has_armed(), !armed.is_empty(), "{header}");
            }
        }
    }
}
