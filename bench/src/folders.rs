//! Folders of recordings: which files can be scored, and how.

use std::error::Error;
use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use aplomb::estimator::heading::CompassKnowledge;
use aplomb::mpu6050::{AccelerometerRange, GyroscopeRange};

use crate::parallel;
use crate::recording::{Found, Handling, Recording, files, is_table};

/// Default folder of recordings.
const DEFAULT_FOLDER: &str = "../shared/data";
/// Known delays of sets. BROAD's inertial data lag its optical truth, by their correlation.
const KNOWN_DELAYS_US: [(&str, u32); 2] = [("broad", 4_000), ("broad-mag", 4_000)];
/// Known delays of sets' compasses against their inertial data, and what is known of their hard
/// iron. BROAD's magnetometer was calibrated, and lags its truth by 14 ms.
const KNOWN_COMPASSES: [(&str, u32, CompassKnowledge); 1] =
    [("broad-mag", 10_000, CompassKnowledge::Calibrated)];
/// Known ranges of sets that hold register counts, by their publisher.
const KNOWN_RANGES: [(&str, AccelerometerRange, GyroscopeRange); 1] = [(
    "mpu6050-raw",
    AccelerometerRange::G8,
    GyroscopeRange::Degrees250,
)];

/// Full scales of register counts.
pub type Ranges = (AccelerometerRange, GyroscopeRange);

/// Folders with the handling of their sets.
#[derive(Default)]
pub struct Folders<'a> {
    /// Folders or files of recordings; empty for the default folder.
    pub paths: &'a [PathBuf],
    /// Stated delays of sets, µs.
    pub delays_us: &'a [(String, u32)],
    /// Stated delays of sets' compasses, µs.
    pub compass_delays_us: &'a [(String, u32)],
    /// Stated ranges of sets.
    pub ranges: &'a [(String, Ranges)],
}

/// File that cannot be scored.
#[derive(serde::Serialize)]
pub struct NotScored {
    file: String,
    /// Line of the fault, if one line has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<u64>,
    reason: String,
}

impl fmt::Display for NotScored {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(formatter, "{}:{line}: {}", self.file, self.reason),
            None => write!(formatter, "{}: {}", self.file, self.reason),
        }
    }
}

/// Returns the recordings of these sets, for a test; says that it is skipped if one is missing.
///
/// # Panics
///
/// Panics with the name of a file that cannot be scored, or of a set without a recording.
#[cfg(test)]
pub fn recordings_of(sets: &[&str]) -> Option<Vec<Recording>> {
    let paths = sets.iter().map(|set| aplomb_recordings::at_hand::set(set));
    paths
        .collect::<Option<Vec<PathBuf>>>()
        .map(|paths| all_of(&paths))
}

/// Returns the recordings in these folders, of which each file has to be one.
#[cfg(test)]
fn all_of(paths: &[PathBuf]) -> Vec<Recording> {
    let mut all = Vec::new();
    for path in paths {
        let folders = Folders {
            paths: std::slice::from_ref(path),
            ..Folders::default()
        };
        let (recordings, not_scored) = folders.read().expect("recordings that can be read");
        let is_whole = not_scored.is_empty() && !recordings.is_empty();
        assert!(is_whole, "{}", folders.nothing_to_score(&not_scored));
        all.extend(recordings);
    }
    all
}

impl Folders<'_> {
    /// Reads every recording, and returns those that can be scored and those that cannot.
    pub fn read(&self) -> Result<(Vec<Recording>, Vec<NotScored>), Box<dyn Error>> {
        let default = Path::new(DEFAULT_FOLDER);
        let folders = if self.paths.is_empty() && default.is_dir() {
            vec![default.to_owned()]
        } else {
            self.paths.to_vec()
        };
        let mut paths = Vec::new();
        for folder in &folders {
            let found = files(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
            paths.extend(found);
        }
        let results = parallel::map_with_bar("reading", &paths, |path| {
            // A named file is read whatever its name ends with.
            if !is_table(path) && !folders.contains(path) {
                return Ok(Found::Unusable("it is no .csv or .csv.gz".to_owned()));
            }
            let set = path.parent().and_then(Path::file_name).unwrap_or_default();
            Recording::read(path, self.handling(&set.to_string_lossy()))
        });
        let (mut recordings, mut not_scored) = (Vec::new(), Vec::new());
        for (path, result) in paths.iter().zip(results) {
            let (line, reason) = match result {
                Ok(Found::Recording(recording)) => {
                    recordings.push(recording);
                    continue;
                }
                Ok(Found::Unusable(reason)) => (None, reason),
                Err(error) => (error.line, error.reason.to_string()),
            };
            not_scored.push(NotScored {
                file: path.display().to_string(),
                line,
                reason,
            });
        }
        Ok((recordings, not_scored))
    }

    /// Returns the message for folders of which nothing can be scored.
    pub fn nothing_to_score(&self, not_scored: &[NotScored]) -> String {
        let named = self.paths.iter().map(|path| path.display().to_string());
        let named = named.collect::<Vec<_>>().join(" ");
        if not_scored.is_empty() {
            return format!("{named}: there is no recording in it");
        }
        let mut text = format!("{named}: nothing of it can be scored");
        for not_scored in not_scored {
            let _ = write!(text, "\n  {not_scored}");
        }
        text
    }

    /// Returns the stated handling of a set, or else the known one.
    fn handling(&self, set: &str) -> Handling {
        let stated = self.delays_us.iter().find(|(name, _)| name == set);
        let known = KNOWN_DELAYS_US.iter().find(|(name, _)| *name == set);
        let delay_us = stated.map(|(_, delay)| *delay);
        let ranges = self.ranges.iter().find(|(name, _)| name == set);
        let known_ranges = KNOWN_RANGES.iter().find(|(name, ..)| *name == set);
        let known_compass = KNOWN_COMPASSES.iter().find(|(name, ..)| *name == set);
        let (compass_delay_us, compass) =
            known_compass.map_or_else(Default::default, |&(_, delay, compass)| (delay, compass));
        let stated = self.compass_delays_us.iter().find(|(name, _)| name == set);
        Handling {
            compass_delay_us: stated.map_or(compass_delay_us, |(_, delay)| *delay),
            compass,
            delay_us: delay_us.or(known.map(|(_, delay)| *delay)).unwrap_or(0),
            ranges: ranges
                .map(|(_, ranges)| *ranges)
                .or(known_ranges.map(|&(_, force, rate)| (force, rate))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the message of the panic at a folder with these files.
    fn panic_at(folder: &str, files: &[(&str, &str)]) -> String {
        let folder = std::env::temp_dir().join(format!("aplomb-{folder}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        for (name, text) in files {
            std::fs::write(folder.join(name), text).expect("a file");
        }
        let paths = [folder.clone()];
        let result = std::panic::catch_unwind(|| all_of(&paths).len());
        std::fs::remove_dir_all(&folder).expect("a folder");
        let message = result.expect_err("a set that is not whole");
        *message.downcast::<String>().expect("a message")
    }

    #[test]
    fn a_set_with_a_damaged_file_is_no_set() {
        let good = (0..2_000).fold("t_us,ax,ay,az,gx,gy,gz\n".to_owned(), |text, index| {
            format!("{text}{},0,0,9.8,0,0,0\n", index * 5_000)
        });
        let cut = &good[..300];
        let message = panic_at("damaged", &[("a.csv", &good), ("b.csv", cut)]);
        assert!(message.contains("b.csv"), "{message}");
        let message = panic_at("empty", &[]);
        assert!(message.contains("there is no recording in it"), "{message}");
    }

    #[test]
    fn what_is_stated_of_a_set_comes_before_what_is_known() {
        let none = Folders::default();
        assert_eq!(none.handling("broad").delay_us, 4_000);
        assert_eq!(none.handling("other"), Handling::default());
        let eight = (AccelerometerRange::G8, GyroscopeRange::Degrees250);
        assert_eq!(none.handling("mpu6050-raw").ranges, Some(eight));
        let two = (AccelerometerRange::G2, GyroscopeRange::Degrees500);
        let some = Folders {
            paths: &[],
            delays_us: &[("broad".to_owned(), 1_000), ("x".to_owned(), 7)],
            compass_delays_us: &[("x".to_owned(), 9)],
            ranges: &[("mpu6050-raw".to_owned(), two)],
        };
        assert_eq!(some.handling("broad").delay_us, 1_000);
        assert_eq!(some.handling("x").delay_us, 7);
        assert_eq!(some.handling("x").compass_delay_us, 9);
        assert_eq!(some.handling("broad-mag").compass_delay_us, 10_000);
        assert_eq!(some.handling("mpu6050-raw").ranges, Some(two));
    }
}
