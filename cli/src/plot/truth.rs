//! True attitudes over time, and tables of attitudes.

use std::collections::VecDeque;
use std::error::Error;
use std::path::Path;

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::calibration::Mount;
use aplomb::units::radians;
use aplomb_models::motion;
use aplomb_models::motion::geometry::Quaternion as Truth;
use aplomb_recordings::attitude_table::Columns;
use aplomb_recordings::batches::{Batches, EvenRows, ROWS_SHOWING, Timed};
use aplomb_recordings::form::header;
use aplomb_recordings::log::{Lines, LogColumns, LogFault, parse_row_in};
use aplomb_recordings::motion::body_to_earth;
use aplomb_recordings::units::RowOptions;

use crate::progress;
use crate::source::{Point, Source};

/// Largest distance in time between an attitude and its truth, µs.
const TRUTH_WITHIN_US: u64 = 5_000;

/// Returns the mount in the models' terms, for the truth.
pub fn modelled(mount: Mount) -> Result<motion::Mount, String> {
    let name = mount.name();
    motion::Mount::parse(name).ok_or_else(|| format!("{name} is no mount of a recording"))
}

/// Rows of an attitude.csv, or of a truth.csv.
pub struct Table {
    /// Lines after the header.
    pub lines: Lines,
    /// Columns by the header.
    pub columns: Columns,
}

impl Source for Table {
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let Some(line) = self.lines.next_line()? else {
            return Ok(None);
        };
        let parsed = self.columns.row(line);
        let row = parsed.map_err(|reason| format!("{}: {reason}", self.lines.place()))?;
        let [p, q, r] = row.rates_deg_s.unwrap_or_default().map(radians);
        Ok(Some(Point {
            t_us: row.t_us,
            attitude: row.attitude.quaternion(),
            body_rates_rad_s: Vector3::new(p, q, r),
            tilt_sigma_rad: row.tilt_sigma_deg.map(radians),
            heading: None,
            flags: row.flags.unwrap_or_default(),
            specific_force_m_s2: None,
            truth: None,
            scored: row.scored,
        }))
    }

    fn has_flags(&self) -> bool {
        self.columns.has_flags()
    }
}

/// Truth at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueRow {
    /// Time, µs.
    pub t_us: i64,
    /// Body to earth, if it is known.
    pub attitude: Option<Truth>,
    /// True if the row counts for scores.
    pub scored: bool,
}

/// Reader of the next row; `None` after the last.
type NextRow = dyn FnMut() -> Result<Option<TrueRow>, Box<dyn Error>>;

/// True attitudes over time, read along with the estimate.
pub struct TruthFile {
    /// True for a table of attitudes, whose times are microseconds.
    pub is_table: bool,
    rows: Box<NextRow>,
    before: Option<TrueRow>,
    after: Option<TrueRow>,
}

impl TruthFile {
    /// Opens a table of attitudes, or a recording with truth of a sensor with this mount. The times
    /// of a recording have the unit of these options.
    pub fn open(path: &Path, mount: Mount, options: &RowOptions) -> Result<Self, Box<dyn Error>> {
        let (mount, options) = (modelled(mount)?, *options);
        let mut lines = progress::lines(path)?;
        let header = header(&mut lines)?;
        let mut file = if let Some(columns) = Columns::of(&header) {
            let mut table = Table { lines, columns };
            let rows = Self::new(move || {
                let point = table.next()?;
                Ok(point.map(|point| {
                    let Quaternion { w, x, y, z } = point.attitude;
                    let truth = Truth::new(w.into(), x.into(), y.into(), z.into());
                    TrueRow {
                        t_us: point.t_us,
                        attitude: Some(truth),
                        scored: point.scored,
                    }
                }))
            });
            Self {
                is_table: true,
                ..rows
            }
        } else if let Some(columns) = LogColumns::of(&header).filter(|own| own.has_truth()) {
            Self::new(evenly(move || {
                let Some(line) = lines.next_line()? else {
                    return Ok(None);
                };
                let row =
                    parse_row_in(line, columns, &options).map_err(|fault| lines.refuse(fault))?;
                Ok(Some(TrueRow {
                    t_us: row.time_us,
                    attitude: row.attitude.map(|truth| body_to_earth(truth, mount)),
                    scored: row.scored,
                }))
            }))
        } else {
            let refused = lines.refuse(LogFault::Header(header));
            return Err(format!(
                "{refused}; \
                 or t_us,qw,qx,qy,qz,… or t_us,roll_deg,pitch_deg,yaw_deg,… for truth"
            )
            .into());
        };
        file.after = (file.rows)()?;
        Ok(file)
    }

    fn new(rows: impl FnMut() -> Result<Option<TrueRow>, Box<dyn Error>> + 'static) -> Self {
        Self {
            is_table: false,
            rows: Box::new(rows),
            before: None,
            after: None,
        }
    }

    /// Returns the row nearest to this time, if it is near. Times must not go back.
    pub fn at(&mut self, t_us: i64) -> Result<Option<TrueRow>, Box<dyn Error>> {
        while let Some(after) = self.after
            && after.t_us < t_us
        {
            self.before = Some(after);
            self.after = (self.rows)()?;
        }
        let distance = |row: &TrueRow| row.t_us.abs_diff(t_us);
        let nearest = self
            .after
            .into_iter()
            .chain(self.before)
            .min_by_key(distance);
        Ok(nearest.filter(|row| distance(row) <= TRUTH_WITHIN_US))
    }
}

impl Timed for TrueRow {
    fn time_us(&mut self) -> &mut i64 {
        &mut self.t_us
    }
}

/// Returns the reader of a recording's rows as `replay` sees them: times that come in batches are
/// spread evenly.
fn evenly(
    mut rows: impl FnMut() -> Result<Option<TrueRow>, Box<dyn Error>> + 'static,
) -> impl FnMut() -> Result<Option<TrueRow>, Box<dyn Error>> + 'static {
    let (mut ahead, mut even, mut is_started) = (VecDeque::new(), None, false);
    move || {
        if !std::mem::replace(&mut is_started, true) {
            while ahead.len() < ROWS_SHOWING
                && let Some(row) = rows()?
            {
                ahead.push_back(row);
            }
            let times_us: Vec<i64> = ahead.iter().map(|row: &TrueRow| row.t_us).collect();
            if let Some(batches) = Batches::find(&times_us) {
                let mut queue = EvenRows::new(batches);
                let first = std::mem::take(&mut ahead);
                ahead = first.into_iter().flat_map(|row| queue.push(row)).collect();
                even = Some(queue);
            }
        }
        loop {
            if let Some(row) = ahead.pop_front() {
                return Ok(Some(row));
            }
            match (rows()?, &mut even) {
                (row, None) => return Ok(row),
                (Some(row), Some(queue)) => ahead.extend(queue.push(row)),
                (None, Some(queue)) => {
                    ahead.extend(queue.end());
                    return Ok(ahead.pop_front());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_truth_is_the_nearest_if_it_is_near() {
        let attitude = |nth: i64| Truth::from_euler(nth as f64, 0.0, 0.0);
        let mut times = [0, 10_000, 50_000].into_iter();
        let row = move |t_us| TrueRow {
            t_us,
            attitude: Some(attitude(t_us)),
            scored: true,
        };
        let mut file = TruthFile::new(move || Ok(times.next().map(row)));
        file.after = (file.rows)().unwrap();
        for (t_us, expected) in [
            (-4_000, Some(0)),
            (0, Some(0)),
            (1_000, Some(0)),
            (9_000, Some(10_000)),
            (10_000, Some(10_000)),
            (14_000, Some(10_000)),
            (16_000, None),
            (46_000, Some(50_000)),
            (54_000, Some(50_000)),
            (60_000, None),
        ] {
            assert_eq!(file.at(t_us).unwrap(), expected.map(row), "{t_us}");
        }
    }
}
