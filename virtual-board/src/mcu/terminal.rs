//! The far end of the UART.

use std::collections::VecDeque;

use rigless::chip::Timeline;
use rigless::chip::uart;
use rigless::snapshot::Store;
use rigless::time::VirtualNanos;

use crate::faults::{FaultKind, ScheduledFault};

/// The far end of the UART. It records received bytes and sends its script; while a fault floods
/// the line, it sends arbitrary bytes.
#[derive(Debug, Default)]
pub struct Terminal {
    received: Vec<ReceivedByte>,
    /// The bytes still to send, in order.
    script: VecDeque<SentByte>,
    /// The faults during which it sends without a pause.
    floods: Vec<ScheduledFault>,
    /// Number of bytes of the floods so far.
    sent: u64,
    /// True if TX and RX are at their pins.
    pub(super) is_connected: [bool; 2],
}

/// A byte from the UART.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceivedByte {
    /// End of the stop bit, ns since power-up.
    pub at_ns: u64,
    /// The byte.
    pub byte: u8,
}

/// A byte for the UART.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SentByte {
    /// Earliest start of the start bit, ns since power-up. The byte waits for those before it.
    pub at_ns: u64,
    /// The byte.
    pub byte: u8,
}

impl Terminal {
    /// A terminal that sends these bytes.
    #[must_use]
    pub fn new(script: &[SentByte]) -> Self {
        let mut script = script.to_vec();
        // Bytes of one instant keep their order.
        script.sort_by_key(|sent| sent.at_ns);
        Self {
            script: script.into(),
            ..Self::default()
        }
    }

    /// Floods the line during these faults.
    pub(super) fn flood(&mut self, faults: &[ScheduledFault]) {
        let floods = |fault: &&ScheduledFault| {
            matches!(fault.kind, FaultKind::UartFlood | FaultKind::UartNoise)
        };
        self.floods = faults.iter().filter(floods).copied().collect();
    }

    /// Sends more bytes, from `at_ns` on.
    pub fn send(&mut self, at_ns: u64, bytes: &[u8]) {
        let sent = bytes.iter().map(|&byte| SentByte { at_ns, byte });
        self.script.extend(sent);
    }

    /// Takes the bytes received since the last call.
    pub fn take(&mut self) -> Vec<ReceivedByte> {
        std::mem::take(&mut self.received)
    }
}

/// Runs start from reset alone, so nothing keeps a board.
impl Store for Terminal {}

impl uart::Peer for Terminal {
    fn receive(&mut self, word: u16, context: &mut Timeline<'_, '_>) {
        if !self.is_connected[0] {
            return;
        }
        self.received.push(ReceivedByte {
            at_ns: context.now().0,
            byte: word.to_le_bytes()[0],
        });
    }

    fn transmit(&mut self, now: VirtualNanos) -> Option<u16> {
        if !self.is_connected[1] {
            return None;
        }
        if !self.floods.iter().any(|fault| fault.lasts(now.0)) {
            return self
                .script
                .pop_front_if(|sent| sent.at_ns <= now.0)
                .map(|sent| sent.byte.into());
        }
        self.sent += 1;
        // Any byte may come, most of them printable, and a line's end now and then.
        let mixed = self.sent.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
        let byte = match mixed % 40 {
            0 => u64::from(b'\n'),
            1..=4 => mixed >> 8,
            _ => 0x20 + (mixed >> 8) % 95,
        };
        Some(u16::from(byte.to_le_bytes()[0]))
    }
}
