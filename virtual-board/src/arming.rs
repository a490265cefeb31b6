//! Arms and disarms a flight as its recording does, by commands to the UART.

use aplomb_recordings::motion::Recording;
use virtual_board::flight::Run;
use virtual_board::recorder::Sample;
use virtual_board::script::Script;

/// Longest time from a command to its effect, s: the next telemetry tick reads it.
const ACTS_WITHIN_S: f64 = 0.1;

/// Changes of the armed state in a flight.
pub struct Arming {
    /// Times, s after power-up, with the state from there on.
    changes: Vec<(f64, bool)>,
    /// End of the flight, s.
    end_s: f64,
}

impl Arming {
    /// Takes the changes of a recording up to the end of the flight. Prints them, or the reason
    /// why they are ignored: the commands of a file arm, or those of a user do, in real time.
    pub fn of(recording: &Recording, script: &Script, is_live: bool, end_s: f64) -> Self {
        let mut commands = script.lines().iter().map(|(_, command)| command.as_str());
        let is_by_file = commands.any(|command| ["arm", "disarm"].contains(&command));
        let reason = match (is_by_file, is_live) {
            (true, _) => Some("the file of --commands arms"),
            (_, true) => Some("it flies in real time: type `arm`"),
            _ => None,
        };
        let changes = recording.arming();
        if let Some(reason) = reason.filter(|_| !changes.is_empty()) {
            eprintln!("the column armed of the recording is ignored: {reason}");
        }
        let changes = changes.iter().filter(|(at_s, _)| *at_s < end_s);
        let arming = Self {
            changes: changes.filter(|_| reason.is_none()).copied().collect(),
            end_s,
        };
        for (at_s, is_armed) in &arming.changes {
            eprintln!("{} at {at_s:.3} s, as recorded", command(*is_armed));
        }
        arming
    }

    /// Sends the commands in a run.
    pub fn send(&self, run: Run) -> Run {
        let changes = self.changes.iter();
        changes.fold(run, |run, (at_s, is_armed)| {
            run.command(*at_s, command(*is_armed))
        })
    }

    /// Returns a warning if the module has not followed a command.
    pub fn check(&self, samples: &[Sample]) -> Option<String> {
        let ends_s = self.changes.iter().skip(1).map(|(at_s, _)| *at_s);
        let ends_s = ends_s.chain([self.end_s]);
        let mut periods = self.changes.iter().zip(ends_s);
        let (at_s, is_armed) = periods.find_map(|((at_s, is_armed), end_s)| {
            let before = |sample: &Sample| (sample.published_ns as f64) < end_s * 1e9;
            let last = samples[..samples.partition_point(before)].last();
            let is_followed = last.is_some_and(|last| last.is_armed == *is_armed);
            (end_s - at_s > ACTS_WITHIN_S && !is_followed).then_some((at_s, is_armed))
        })?;
        Some(format!(
            "the module ignored `{}` at {at_s:.3} s: has the image no commands, or did a fault \
             garble it?",
            command(*is_armed)
        ))
    }
}

/// Returns the command that brings this state about.
const fn command(is_armed: bool) -> &'static str {
    if is_armed { "arm" } else { "disarm" }
}
