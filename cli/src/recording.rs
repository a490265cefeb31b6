//! Recordings with truth, in memory, for comparing filters.

use std::path::{Path, PathBuf};

use aplomb::attitude::Vector3;
use aplomb::calibration::Mount;
use aplomb::estimator::Sample;
use virtual_board::motion::log::{Lines, LogError, LogFault, column_count, parse_row};

use crate::filter::{Choice, Filter, up_in_body};
use crate::score::{Errors, START_US, Score, up_in_sensor};

/// One recording in body axes, its sensor mounted face up.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The set to which it belongs: its folder.
    pub set: String,
    /// The file.
    pub name: String,
    /// By how much its samples are late.
    pub delay_us: u32,
    /// What the sensor said.
    pub samples: Vec<Sample>,
    /// "Up" in body axes for each sample, where it is known and counts.
    pub true_up: Vec<Option<[f64; 3]>>,
}

impl Recording {
    /// Reads a log; `None` if it is a file of another kind, holds register counts, or has no truth that counts.
    pub fn read(path: &Path, delay_us: u32) -> Result<Option<Self>, LogError> {
        let mut lines = Lines::open(path, |file| file)?;
        let header = lines.next_line()?;
        let Some(columns @ 11..) = header.and_then(column_count) else {
            return Ok(None);
        };
        let mut recording = Self {
            set: name_of(path.parent()),
            name: name_of(Some(path)),
            delay_us,
            samples: Vec::new(),
            true_up: Vec::new(),
        };
        let mut first_us = None;
        while let Some(line) = lines.next_line()? {
            let row = parse_row(line, columns).map_err(|fault| lines.refuse(fault))?;
            let first_us = *first_us.get_or_insert(row.time_us);
            let since_us = row.time_us.checked_sub(first_us);
            let t_us = since_us
                .and_then(|since| u64::try_from(since).ok())
                .ok_or_else(|| lines.refuse(LogFault::Time(row.time_us.to_string())))?;
            recording.samples.push(Sample {
                t_us,
                specific_force_m_s2: to_body(row.specific_force_m_s2),
                angular_rate_rad_s: to_body(row.rates_rad_s),
                ..Sample::default()
            });
            let up = row.attitude.filter(|_| row.moving).map(up_in_sensor);
            recording.true_up.push(up.map(|[x, y, z]| [x, -y, -z]));
        }
        let has_truth = recording.true_up.iter().any(Option::is_some);
        Ok(has_truth.then_some(recording))
    }

    /// The median step between its samples.
    pub fn step_s(&self) -> f32 {
        let pairs = self.samples.iter().zip(self.samples.iter().skip(1));
        let mut steps: Vec<u64> = pairs
            .map(|(before, after)| after.t_us.saturating_sub(before.t_us))
            .collect();
        steps.sort_unstable();
        let median = steps.get(steps.len() / 2).copied().unwrap_or(1_000);
        median.max(1) as f32 * 1e-6
    }

    /// Runs a filter through it. `None` if no row counts.
    pub fn score(&self, choice: Choice) -> Option<Score> {
        let mut filter = Filter::new(choice, self.step_s(), self.delay_us);
        let start_us = self.samples.first()?.t_us + START_US.unsigned_abs();
        let mut errors = Errors::default();
        for (sample, true_up) in self.samples.iter().zip(&self.true_up) {
            let attitude = filter.update(sample).attitude;
            if let Some(true_up) = *true_up
                && sample.t_us >= start_us
            {
                let up = up_in_body(attitude);
                errors.add([up.x, up.y, up.z].map(f64::from), true_up);
            }
        }
        errors.score()
    }
}

/// Every file below a folder that may be a log, in order; or the file itself.
pub fn files(path: &Path) -> std::io::Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(path)? {
        let path = entry?.path();
        let name = name_of(Some(&path));
        if path.is_dir() || name.ends_with(".csv") || name.ends_with(".csv.gz") {
            found.extend(files(&path)?);
        }
    }
    found.sort();
    Ok(found)
}

fn to_body([x, y, z]: [f64; 3]) -> Vector3 {
    Mount::Z_UP.to_body(Vector3::new(x as f32, y as f32, z as f32))
}

fn name_of(path: Option<&Path>) -> String {
    path.and_then(Path::file_name)
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}
