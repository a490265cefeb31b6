//! Armed state of a recording: its own, or that of `--armed-from`.

use std::path::Path;

use aplomb::telemetry::bursts;
use aplomb_recordings::log::Lines;

/// Armed state at the rows of a recording.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arming {
    /// Time after the first row from which on the filter is armed, µs; `None` without the option.
    from_us: Option<i64>,
    /// Time of the first row, µs.
    first_us: Option<i64>,
    is_armed: bool,
}

impl Arming {
    /// Creates the state of a recording with this value of `--armed-from`, s.
    pub fn new(from_s: Option<f64>) -> Self {
        Self {
            from_us: from_s.map(|seconds| (seconds * 1e6).round() as i64),
            ..Self::default()
        }
    }

    /// Returns the state at the next row. `own` is the recording's, `None` where it stays as it is.
    /// Returns a message if the recording arms despite the option.
    pub fn at(&mut self, t_us: i64, own: Option<bool>) -> Result<bool, String> {
        let first_us = *self.first_us.get_or_insert(t_us);
        match self.from_us {
            None => self.is_armed = own.unwrap_or(self.is_armed),
            Some(_) if own == Some(true) => {
                return Err(format!(
                    "it is ARMED at {t_us} us, so it holds the armed state: leave out --armed-from"
                ));
            }
            Some(from_us) => self.is_armed |= t_us.saturating_sub(first_us) >= from_us,
        }
        Ok(self.is_armed)
    }

    /// Checks after the last row that the time of the option has come.
    pub fn end(&self) -> Result<(), &'static str> {
        let is_late = self.from_us.is_some() && self.first_us.is_some() && !self.is_armed;
        match is_late {
            true => Err("--armed-from is after the last row: give the seconds after the first"),
            false => Ok(()),
        }
    }
}

/// Returns whether a table of bursts arms, as far as it can be read. Standard input may.
pub fn bursts_arm(path: &Path) -> bool {
    let Ok(mut lines) = Lines::open(path, |file| file) else {
        return true;
    };
    while let Ok(Some(line)) = lines.next_line() {
        if bursts::decode(line).is_ok_and(|row| row.is_armed) {
            return true;
        }
    }
    false
}
