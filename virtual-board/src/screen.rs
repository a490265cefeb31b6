//! A run on standard output: the firmware's log, and how far the run is.

use std::io::{self, IsTerminal, Write as _};
use std::time::Instant;

use virtual_board::probe::LogLine;
use virtual_board::recorder::{Observer, Progress};

/// Time between two attitudes where standard output is no terminal, ns.
const ATTITUDE_PAUSE_NS: u64 = 999_000_000;

/// Shows the run while it goes on: the firmware's log, and how far it is.
pub struct Screen {
    started: Instant,
    is_terminal: bool,
    /// Virtual seconds at which a line of progress is due, where it cannot be overwritten.
    next_line_s: f64,
    /// Time at which an attitude is due, ns: `None` on a terminal, which shows each of them.
    next_attitude_ns: Option<u64>,
}

impl Screen {
    /// Starts the clock.
    pub fn new() -> Self {
        Self {
            started: Instant::now(),
            is_terminal: io::stderr().is_terminal(),
            next_line_s: 0.0,
            next_attitude_ns: (!io::stdout().is_terminal()).then_some(0),
        }
    }

    /// Returns whether to show a line. A file or a pipe gets an attitude a second, and everything
    /// else; firmware.log has all lines.
    fn shows(&mut self, line: &LogLine) -> bool {
        let is_attitude = line.text.contains("roll:") && line.text.contains("pitch:");
        match &mut self.next_attitude_ns {
            Some(next_ns) if is_attitude => {
                let is_due = line.at_ns >= *next_ns;
                if is_due {
                    *next_ns = line.at_ns + ATTITUDE_PAUSE_NS;
                }
                is_due
            }
            _ => true,
        }
    }

    fn clear_line(&self) {
        if self.is_terminal {
            eprint!("\r\x1b[K");
        }
    }
}

impl Observer for Screen {
    fn log(&mut self, line: &LogLine) {
        if !self.shows(line) {
            return;
        }
        self.clear_line();
        println!("{:10.3} s  {}", line.at_ns as f64 * 1e-9, line.text);
    }

    fn progress(&mut self, progress: Progress) {
        let now_s = progress.now_ns as f64 * 1e-9;
        let speed = now_s / self.started.elapsed().as_secs_f64();
        let percent = 100.0 * progress.now_ns as f64 / progress.end_ns as f64;
        let text = format!("{percent:3.0} %, {now_s:.1} s flown, {speed:.1} times real time");
        if self.is_terminal {
            self.clear_line();
            eprint!("{text}");
            io::stderr().flush().ok();
        } else if now_s >= self.next_line_s {
            self.next_line_s = now_s + 10.0;
            eprintln!("{text}");
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.clear_line();
    }
}
