//! Armed state of a recording: its own, or that of `--armed-from`.

use std::collections::VecDeque;
use std::path::Path;

use aplomb::estimator::REVISION;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::serialize::{StateReader, StateWriter};
use aplomb::telemetry::bursts;
use aplomb::telemetry::log::Configuration;
use aplomb_recordings::flight_log::Steps;
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

/// Armed state at the bursts of a flight log, which holds it in the filter's states alone.
#[derive(Debug)]
pub struct LoggedArming {
    /// Numbers of the bursts from which on the filter is armed, or disarmed, in order.
    changes: VecDeque<(u32, bool)>,
    is_armed: bool,
}

impl LoggedArming {
    /// Reads the states of a flight with this first configuration. Returns `None` if none of them
    /// can be read: none is complete, or they are of another [`REVISION`].
    ///
    /// A command that arms or disarms begins new settings, and the state follows some bursts later.
    /// So the first state of the settings holds from their first burst on.
    pub fn read(steps: Steps, first: &Configuration) -> Option<Self> {
        if first.revision != REVISION {
            return None;
        }
        let mut found = None;
        let mut changes = VecDeque::new();
        let mut settings_from = first.from_number;
        let mut unknown_from = Some(settings_from);
        for step in steps {
            if let Some(next) = step.configuration
                && next.from_number != settings_from
            {
                settings_from = next.from_number;
                unknown_from = Some(settings_from);
            }
            if let Some(is_armed) = step.state.as_deref().and_then(armed_in) {
                let from = unknown_from.take().unwrap_or(step.numbered.number);
                if is_armed != found.unwrap_or(false) {
                    changes.push_back((from, is_armed));
                }
                found = Some(is_armed);
            }
        }
        found.map(|_| Self {
            changes,
            is_armed: false,
        })
    }

    /// Returns whether the filter is armed at some burst.
    pub fn arms(&self) -> bool {
        !self.changes.is_empty()
    }

    /// Returns the state at the burst of this number. Numbers increase.
    pub fn at(&mut self, number: u32) -> bool {
        while let Some((_, is_armed)) = self.changes.pop_front_if(|(from, _)| *from <= number) {
            self.is_armed = is_armed;
        }
        self.is_armed
    }
}

/// Returns the armed state in the bytes of a pipeline's state; `None` if they are not a whole one.
fn armed_in(state: &[u8]) -> Option<bool> {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut reader = StateReader::new(state);
    pipeline.visit_state(&mut reader);
    if !reader.is_complete() {
        return None;
    }
    // Arming changes every state but an armed one.
    pipeline.set_armed(true);
    let mut armed = vec![0; state.len()];
    pipeline.visit_state(&mut StateWriter::new(&mut armed, 0));
    Some(armed == state)
}

#[cfg(test)]
mod tests;
