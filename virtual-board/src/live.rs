//! `fly --live`: the board in real time, with its UART on standard output and standard input, as on
//! a serial port.

use std::io::{self, BufRead, Write};
use std::process;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use virtual_board::mcu::ReceivedByte;
use virtual_board::recorder::Observer;

/// Virtual time may be ahead of real time by this much: shorter sleeps cost more than they are
/// worth.
const AHEAD: Duration = Duration::from_millis(5);

/// After a delay longer than this, on a busy computer, the run does not catch up.
const BEHIND: Duration = Duration::from_millis(200);

/// Keeps the run to real time and transports the UART's bytes. Ends the program when standard
/// output or input is closed.
pub struct Live {
    /// The real time at which virtual time began.
    started: Instant,
    lines: Receiver<String>,
}

impl Live {
    /// Begins to listen to standard input.
    pub fn new() -> Self {
        let (sender, lines) = channel();
        thread::spawn(move || {
            for line in io::stdin().lock().lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
            process::exit(0);
        });
        Self {
            started: Instant::now(),
            lines,
        }
    }

    fn keep_pace(&mut self, now_ns: u64) {
        let (virtual_time, real_time) = (Duration::from_nanos(now_ns), self.started.elapsed());
        let ahead = virtual_time.saturating_sub(real_time);
        if ahead >= AHEAD {
            thread::sleep(ahead);
        }
        let behind = real_time.saturating_sub(virtual_time);
        if behind > BEHIND {
            self.started += behind;
        }
    }
}

impl Observer for Live {
    fn uart(&mut self, now_ns: u64, received: &[ReceivedByte]) -> Vec<u8> {
        self.keep_pace(now_ns);
        let bytes: Vec<u8> = received.iter().map(|received| received.byte).collect();
        let mut output = io::stdout().lock();
        let written = output.write_all(&bytes).and_then(|()| output.flush());
        if written.is_err() {
            process::exit(0);
        }
        let lines = self.lines.try_iter();
        lines
            .flat_map(|line| format!("{line}\n").into_bytes())
            .collect()
    }

    fn keeps_record(&self) -> bool {
        false
    }
}
