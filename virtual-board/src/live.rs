//! `fly --live`, `--pty` and `--tcp`: the board in real time, with its UART at a [`Port`].

use std::thread;
use std::time::{Duration, Instant};

use virtual_board::mcu::ReceivedByte;
use virtual_board::port::Port;
use virtual_board::recorder::Observer;

/// Virtual time may be ahead of real time by this much: shorter sleeps cost more than they are
/// worth.
const AHEAD: Duration = Duration::from_millis(5);

/// After a delay longer than this, on a busy computer, the run does not catch up.
const BEHIND: Duration = Duration::from_millis(200);

/// Keeps the run to real time and transports the UART's bytes.
pub struct Live {
    /// The real time at which virtual time began.
    started: Instant,
    port: Port,
}

impl Live {
    /// Begins with the bytes of this port.
    pub fn new(port: Port) -> Self {
        Self {
            started: Instant::now(),
            port,
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
        self.port.send(bytes);
        self.port.receive()
    }

    fn keeps_record(&self) -> bool {
        false
    }
}
