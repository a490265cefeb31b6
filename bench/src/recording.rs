//! Recordings in memory, to compare filters on: with truth, or with rests to check by.

use std::path::{Path, PathBuf};

use aplomb::attitude::Vector3;
use aplomb::calibration::Mount;
use aplomb::estimator::Sample;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::{AccelerometerCounts, AccelerometerRange, GyroscopeCounts, GyroscopeRange};
use aplomb_models::motion::geometry::angle_between;
use aplomb_recordings::attitude::up_in_body;
use aplomb_recordings::counts::counts;
use aplomb_recordings::form::header;
use aplomb_recordings::log::{Lines, LogColumns, LogError, LogFault, Row, Rows, UnitGuess};
use aplomb_recordings::plateau::Plateaus;
use aplomb_recordings::score::{Errors, START_US, Score, up_in_sensor};
use aplomb_recordings::turns::Turns;
use aplomb_recordings::units::{BadRows, RowOptions};
use aplomb_recordings::vibration::{FULL_SCALE_G, Vibration};

use crate::compass::Compass;
use crate::filter::{Choice, Filter};
use crate::rest;

/// Recording in body axes.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Set: the folder.
    pub set: String,
    /// File name.
    pub name: String,
    /// Delay of the samples, µs.
    pub delay_us: u32,
    /// Reference.
    pub reference: Reference,
    /// Knowledge of the accelerometer's offset.
    pub accelerometer: AccelerometerKnowledge,
    /// Samples.
    pub samples: Vec<Sample>,
    /// True "up" in body axes for each sample, where it is known.
    pub known_up: Vec<Option<[f64; 3]>>,
    /// True "up" in body axes for each sample, where it is known and counts for scores.
    pub true_up: Vec<Option<[f64; 3]>>,
    /// Compass, if the recording has one: its heading is scored then, not its tilt.
    pub compass: Option<Compass>,
    /// Message on clipping.
    pub clipping: Option<String>,
}

/// Reference that a recording is judged by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reference {
    /// A measured truth.
    Truth,
    /// The accelerometer, where the sensor rests.
    Rest,
}

impl Reference {
    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Truth => "truth",
            Self::Rest => "rest",
        }
    }
}

/// Properties of a set that its files do not state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Handling {
    /// Delay of the samples, µs.
    pub delay_us: u32,
    /// Age of a reading of the compass against its row's sample, µs.
    pub compass_delay_us: u32,
    /// Knowledge of the compass's hard iron.
    pub compass: CompassKnowledge,
    /// Ranges of register counts; `None` for SI units.
    pub ranges: Option<(AccelerometerRange, GyroscopeRange)>,
}

impl Handling {
    /// Returns the compass without a reading.
    fn compass(self) -> Compass {
        Compass {
            delay_us: self.compass_delay_us,
            knowledge: self.compass,
            ..Compass::default()
        }
    }
}

/// Fault of a file's rows.
enum Fault {
    /// The values are no register counts.
    Counts,
    Log(LogError),
}

impl From<LogError> for Fault {
    fn from(error: LogError) -> Self {
        Self::Log(error)
    }
}

/// Result of reading a file.
pub enum Found {
    /// Recording that can be scored.
    Recording(Recording),
    /// Reason why the file cannot be scored.
    Unusable(String),
}

impl Recording {
    /// Reads a file. Malformed rows are errors; a file that cannot be scored is
    /// [`Found::Unusable`].
    pub fn read(path: &Path, handling: Handling) -> Result<Found, LogError> {
        let unusable = |reason: &str| Ok(Found::Unusable(reason.to_owned()));
        let mut lines = Lines::open(path, |file| file)?;
        let header = match header(&mut lines) {
            Ok(header) => header,
            Err(LogError {
                reason: LogFault::Empty | LogFault::NoHeader,
                ..
            }) => return unusable("it has no header"),
            Err(LogError {
                reason: LogFault::NotText | LogFault::NoTable { .. },
                ..
            }) => return unusable("it is no text"),
            Err(error) => return Err(error),
        };
        if header == aplomb::telemetry::bursts::HEADER {
            return unusable("bursts have no truth: `aplomb replay` takes them");
        }
        let Some(columns) = LogColumns::of(&header) else {
            return unusable("it is no recording: it does not begin with t_us,ax,ay,az,gx,gy,gz");
        };
        let mut recording = Self {
            set: name_of(path.parent()),
            name: name_of(Some(path)),
            delay_us: handling.delay_us,
            reference: Reference::Truth,
            accelerometer: lines.accelerometer().unwrap_or(match handling.ranges {
                Some(_) => AccelerometerKnowledge::Factory,
                None => AccelerometerKnowledge::Calibrated,
            }),
            samples: Vec::new(),
            known_up: Vec::new(),
            true_up: Vec::new(),
            compass: columns.has_compass().then(|| handling.compass()),
            clipping: None,
        };
        match recording.add_rows(lines, columns, handling) {
            Ok(()) => {}
            Err(Fault::Counts) => {
                return unusable(
                    "its values are no register counts, though its set is said to hold them",
                );
            }
            Err(Fault::Log(LogError {
                reason: LogFault::Unit(guess),
                ..
            })) => return unusable(&unit_message(&guess)),
            Err(Fault::Log(error)) => return Err(error),
        }
        if handling.ranges.is_none() {
            recording.mark_clipping();
        }
        if recording.has_scored_row() {
            return Ok(Found::Recording(recording));
        }
        recording.reference = Reference::Rest;
        recording.true_up = rest::up_at_rest(&recording.samples);
        if recording.has_scored_row() {
            Ok(Found::Recording(recording))
        } else {
            unusable(
                "it has no truth, and after its first 5 s it does not lie still for 1.5 s either",
            )
        }
    }

    /// Adds the rows of a file after its header. Rates and other numbers that suggest another unit
    /// are a fault.
    fn add_rows(
        &mut self,
        lines: Lines,
        columns: LogColumns,
        handling: Handling,
    ) -> Result<(), Fault> {
        let keep = RowOptions {
            bad_rows: Some(BadRows::Keep),
            ..RowOptions::default()
        };
        let mut rows = Rows::new(lines, columns, keep, handling.ranges.is_some())?;
        let mut start = None;
        while let Some(row) = rows.next_row()? {
            let (first_us, mount) = *start.get_or_insert((row.time_us, mount(&row)));
            let since_us = row.time_us.checked_sub(first_us);
            let t_us = since_us
                .and_then(|since| u64::try_from(since).ok())
                .ok_or_else(|| rows.refuse(LogFault::Time(row.time_us.to_string())))?;
            let Ok(sample) = sample(&row, t_us, mount, handling) else {
                return Err(Fault::Counts);
            };
            self.samples.push(sample);
            if let Some(compass) = &mut self.compass {
                compass.add(&row, mount);
            }
            let up = row.attitude.map(up_in_sensor).map(|up| {
                let up = mount.to_body(vector(up)).0;
                [up.x, up.y, up.z].map(f64::from)
            });
            self.known_up.push(up);
            self.true_up.push(up.filter(|_| row.scored));
        }
        Ok(())
    }

    /// Marks clipped samples as saturated.
    pub fn mark_clipping(&mut self) {
        let mut plateaus = Plateaus::default();
        for sample in &mut self.samples {
            let [force, rates] = [sample.specific_force_m_s2, sample.angular_rate_rad_s]
                .map(|vector| [vector.x, vector.y, vector.z].map(f64::from));
            let saturation = plateaus.check(force, rates);
            sample.is_force_saturated |= saturation.force;
            sample.is_rate_saturated |= saturation.rate;
        }
        self.clipping = plateaus.message();
    }

    /// Returns the vibration.
    pub fn vibration(&self) -> Vibration {
        let mut vibration = Vibration::new(FULL_SCALE_G);
        for sample in &self.samples {
            let force = sample.specific_force_m_s2;
            vibration.add(
                sample.t_us.cast_signed(),
                [force.x, force.y, force.z].map(f64::from),
            );
        }
        vibration
    }

    /// Returns the turns of the force beside those of the gyroscope.
    fn turns(&self) -> Turns {
        let mut turns = Turns::default();
        for sample in &self.samples {
            let [force, rates] = [sample.specific_force_m_s2, sample.angular_rate_rad_s]
                .map(|vector| [vector.x, vector.y, vector.z].map(f64::from));
            let is_saturated = sample.is_force_saturated || sample.is_rate_saturated;
            turns.add(sample.t_us.cast_signed(), force, rates, is_saturated);
        }
        turns
    }

    /// Returns messages on what harms the accuracy, or shows that columns are not what they seem.
    pub fn warnings(&self) -> Vec<String> {
        let messages = [
            self.clipping.clone(),
            self.vibration().message(),
            // This program has no option for the unit.
            (self.turns().warning()).map(|text| text.replace(" (--rate-unit)", "")),
        ];
        let place = |message| format!("{}/{}: {message}", self.set, self.name);
        messages.into_iter().flatten().map(place).collect()
    }

    /// Returns whether any row counts for scores.
    fn has_scored_row(&self) -> bool {
        let start_us = self.start_us();
        let mut rows = self.samples.iter().zip(&self.true_up);
        rows.any(|(sample, up)| sample.t_us >= start_us && up.is_some())
    }

    /// Returns the time from which on rows count, µs.
    pub fn start_us(&self) -> u64 {
        self.samples.first().map_or(0, |first| first.t_us) + START_US.unsigned_abs()
    }

    /// Returns the median step between samples, s.
    pub fn step_s(&self) -> f32 {
        let pairs = self.samples.iter().zip(self.samples.iter().skip(1));
        let mut steps: Vec<u64> = pairs
            .map(|(before, after)| after.t_us.saturating_sub(before.t_us))
            .collect();
        steps.sort_unstable();
        let median = steps.get(steps.len() / 2).copied().unwrap_or(1_000);
        median.max(1) as f32 * 1e-6
    }

    /// Scores a filter. Returns `None` if no row counts.
    pub fn score(&self, choice: Choice) -> Option<Score> {
        let mut errors = Errors::default();
        let has_sigma = self.reference == Reference::Truth;
        let filter =
            Filter::new(choice, self.step_s(), self.delay_us).with_knowledge(self.accelerometer);
        self.run(filter, |estimated, true_up, sigma_rad| {
            errors.add(estimated, true_up, sigma_rad.filter(|_| has_sigma));
        });
        errors.score()
    }

    /// Returns the root mean square in degrees of a filter that was set up for this recording.
    pub fn rms(&self, filter: Filter) -> f64 {
        let (mut squares, mut rows) = (0.0, 0_u32);
        self.run(filter, |estimated, true_up, _| {
            let error = angle_between(estimated, true_up).to_degrees();
            squares += error * error;
            rows += 1;
        });
        (squares / f64::from(rows)).sqrt()
    }

    /// Runs a filter, and calls `note` for every row that counts: its "up", the true one, σ in
    /// rad.
    fn run(&self, mut filter: Filter, mut note: impl FnMut([f64; 3], [f64; 3], Option<f32>)) {
        let start_us = self.start_us();
        for (sample, true_up) in self.samples.iter().zip(&self.true_up) {
            let attitude = filter.update(sample).attitude;
            if let Some(true_up) = *true_up
                && sample.t_us >= start_us
            {
                let up = up_in_body(attitude);
                let estimated = [up.x, up.y, up.z].map(f64::from);
                note(estimated, true_up, filter.tilt_sigma_rad());
            }
        }
    }
}

/// Returns the reason not to score a recording whose numbers suggest another unit.
fn unit_message(guess: &UnitGuess) -> String {
    format!(
        "{} is mostly {:.3}, where {} is usual: convert it to µs, m/s² and rad/s, or say \
         --counts SET=G,DPS if these are counts",
        guess.quantity, guess.value, guess.usual
    )
}

/// Returns every file below a folder, in order; or the file itself.
pub fn files(path: &Path) -> std::io::Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(path)? {
        found.extend(files(&entry?.path())?);
    }
    found.sort();
    Ok(found)
}

/// Returns whether the name is that of a table.
pub fn is_table(path: &Path) -> bool {
    let name = name_of(Some(path)).to_lowercase();
    name.ends_with(".csv") || name.ends_with(".csv.gz")
}

/// Returns the mount in this row: face up or face down. Most filters do not depend on it.
fn mount(row: &Row) -> Mount {
    if row.specific_force_m_s2[2] < 0.0 {
        Mount::Z_DOWN
    } else {
        Mount::Z_UP
    }
}

fn sample(row: &Row, t_us: u64, mount: Mount, handling: Handling) -> Result<Sample, String> {
    let Some((accelerometer_range, gyroscope_range)) = handling.ranges else {
        return Ok(Sample::new(
            t_us,
            mount.to_body(vector(row.specific_force_m_s2)),
            mount.to_body(vector(row.rates_rad_s)),
        ));
    };
    let [force, rates] = counts(row)?;
    let (force, rates) = (AccelerometerCounts(force), GyroscopeCounts(rates));
    let mut sample = Sample::new(
        t_us,
        mount.to_body(force.to_m_s2(accelerometer_range)),
        mount.to_body(rates.to_rad_s(gyroscope_range)),
    );
    sample.is_force_saturated = force.is_saturated();
    sample.is_rate_saturated = rates.is_saturated();
    Ok(sample)
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3::new(x as f32, y as f32, z as f32)
}

fn name_of(path: Option<&Path>) -> String {
    path.and_then(Path::file_name)
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}
