//! Comments before the header of a recording that stand for options, such as
//! `# --accelerometer factory`.

use std::fmt::Write as _;

use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::{AccelerometerRange, GyroscopeRange, ParseRangeError};

use crate::fault::LogFault;
use crate::quote::quote;
use crate::units::knowledge_name;

/// Start of a comment that states the knowledge of the accelerometer.
pub const ACCELEROMETER_COMMENT: &str = "# --accelerometer ";

/// Properties of the sensor that a recording states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statements {
    /// Knowledge of the accelerometer.
    pub accelerometer: Option<AccelerometerKnowledge>,
    /// Full scale of the accelerometer in a table of bursts.
    pub accelerometer_range: Option<AccelerometerRange>,
    /// Full scale of the gyroscope in a table of bursts.
    pub gyroscope_range: Option<GyroscopeRange>,
}

impl Statements {
    /// Takes a comment, which may state several options. Returns the first option that no comment
    /// can state.
    ///
    /// # Errors
    ///
    /// Returns the fault of an option's value.
    pub(crate) fn take(&mut self, comment: &str) -> Result<Option<String>, LogFault> {
        let text = comment.trim_start_matches('#').trim_start();
        let is_letter = |character: char| character.is_ascii_alphabetic();
        // Lines of dashes separate paragraphs.
        let is_option = text
            .strip_prefix("--")
            .is_some_and(|it| it.starts_with(is_letter));
        let mut unused = None;
        for option in text.split("--").skip(1).filter(|_| is_option) {
            let is_end = |character: char| character.is_whitespace() || "=:".contains(character);
            let (name, value) = option.split_once(is_end).unwrap_or((option, ""));
            let value = value.trim_matches(is_end);
            let wrong = |error: &ParseRangeError| {
                LogFault::Statement(format!("\"{}\": {error}", quote(value)))
            };
            match name.to_ascii_lowercase().as_str() {
                "accelerometer" => {
                    let known = AccelerometerKnowledge::from_name(value);
                    let unknown = || LogFault::Knowledge(value.to_owned());
                    self.accelerometer = Some(known.ok_or_else(unknown)?);
                }
                "accel-range" => {
                    let range = value.parse();
                    self.accelerometer_range = Some(range.map_err(|error| wrong(&error))?);
                }
                "gyro-range" => {
                    let range = value.parse();
                    self.gyroscope_range = Some(range.map_err(|error| wrong(&error))?);
                }
                _ => {
                    unused.get_or_insert_with(|| format!("--{}", option.trim()));
                }
            }
        }
        Ok(unused)
    }

    /// Returns whether a full scale is stated.
    #[must_use]
    pub const fn has_ranges(&self) -> bool {
        self.accelerometer_range.is_some() || self.gyroscope_range.is_some()
    }

    /// Returns the comments that state the same, a line each.
    #[must_use]
    pub fn comments(&self) -> String {
        let mut text = String::new();
        if let Some(knowledge) = self.accelerometer {
            let name = knowledge_name(knowledge);
            writeln!(text, "{ACCELEROMETER_COMMENT}{name}").ok();
        }
        if let Some(range) = self.accelerometer_range {
            writeln!(text, "# --accel-range {range}").ok();
        }
        if let Some(range) = self.gyroscope_range {
            writeln!(text, "# --gyro-range {range}").ok();
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let stated = Statements {
            accelerometer: Some(AccelerometerKnowledge::SixPoses),
            accelerometer_range: Some(AccelerometerRange::G2),
            gyroscope_range: Some(GyroscopeRange::Degrees250),
        };
        let mut read = Statements::default();
        for comment in stated.comments().lines() {
            assert_eq!(read.take(comment).expect("right"), None);
        }
        assert_eq!(read, stated);
    }

    #[test]
    fn every_spelling_of_an_option_counts_or_is_refused() {
        for comment in [
            "# --accelerometer factory",
            "#--accelerometer factory ",
            "##  --Accelerometer=factory",
            "# --accelerometer: factory",
            "# --gyro-range 250 --accelerometer factory",
        ] {
            let mut stated = Statements::default();
            assert_eq!(stated.take(comment).expect("right"), None, "{comment}");
            let factory = Some(AccelerometerKnowledge::Factory);
            assert_eq!(stated.accelerometer, factory, "{comment}");
        }
        for wrong in [
            "# --accelerometer factori",
            "#--accelerometer",
            "# --accelerometer factory I think",
            "# --accel-range 3",
            "# --gyro-range fast",
        ] {
            assert!(Statements::default().take(wrong).is_err(), "{wrong}");
        }
        let mut stated = Statements::default();
        for (comment, unused) in [
            ("#--gyroscope calibrated", Some("--gyroscope calibrated")),
            ("# --accelerometr factory", Some("--accelerometr factory")),
            ("# made with --accelerometer factory", None),
            ("# -----------", None),
            ("# -- a motto", None),
            ("#", None),
        ] {
            let found = stated.take(comment).expect("no wrong value");
            assert_eq!(found.as_deref(), unused, "{comment}");
        }
        assert_eq!(stated, Statements::default());
    }
}
