//! A debug probe that reads the firmware's log: it drains the RTT buffer from memory and decodes
//! defmt.

use defmt_decoder::{DecodeError, Table};
use rigless::emulator::Memory;
use rigless::soc::Width;

/// Offsets in the RTT control block (SEGGER UM08001, section "RTT Control Block").
const FIRST_UP_CHANNEL: u64 = 24;
const BUFFER: u64 = 4;
const SIZE: u64 = 8;
const WRITE_OFFSET: u64 = 12;
const READ_OFFSET: u64 = 16;
const FLAGS: u64 = 20;

/// The mode of the up channel in which the firmware waits for room in the buffer.
const BLOCK_IF_FULL: u64 = 2;

/// The identification of a control block that has been set up.
const IDENTIFICATION: &[u8; 10] = b"SEGGER RTT";

/// A line of the firmware's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// Time at which the probe read it, ns since power-up.
    pub at_ns: u64,
    /// Level and message.
    pub text: String,
}

/// The probe.
pub struct Probe {
    control_block: u64,
    table: Table,
    /// The bytes read of an incomplete frame.
    rest: Vec<u8>,
}

impl Probe {
    /// A probe for an image with its control block at `control_block`. `None` if the image has no
    /// defmt data.
    #[must_use]
    pub fn attach(elf: &[u8], control_block: u64) -> Option<Self> {
        Some(Self {
            control_block,
            table: Table::parse(elf).ok().flatten()?,
            rest: Vec::new(),
        })
    }

    /// Takes what the firmware has logged since the last call.
    pub fn drain(&mut self, memory: &mut dyn Memory, at_ns: u64) -> Vec<LogLine> {
        let Some(bytes) = self.read(memory) else {
            return Vec::new();
        };
        self.rest.extend(bytes);
        // A frame ends with a zero and contains none (defmt's rzCOBS encoding).
        let complete = self
            .rest
            .iter()
            .rposition(|&byte| byte == 0)
            .map_or(0, |last| last + 1);
        let mut decoder = self.table.new_stream_decoder();
        decoder.received(&self.rest[..complete]);
        let mut lines = Vec::new();
        loop {
            let text = match decoder.decode() {
                Ok(frame) => {
                    let level = frame
                        .level()
                        .map_or(String::new(), |level| level.as_str().to_uppercase());
                    format!("{level:<5} {}", frame.display_message())
                }
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => "ERROR (a malformed log frame)".into(),
            };
            lines.push(LogLine { at_ns, text });
        }
        drop(decoder);
        self.rest.drain(..complete);
        lines
    }

    /// Asks the firmware to wait whenever the buffer is full, as probe-rs does when it attaches.
    pub fn make_log_wait(&self, memory: &mut dyn Memory) {
        if self.is_set_up(memory) {
            let address = self.control_block + FIRST_UP_CHANNEL + FLAGS;
            memory.write(address, Width::W32, BLOCK_IF_FULL).ok();
        }
    }

    /// Empties the up channel's buffer, as a probe does. `None` if there is nothing yet.
    fn read(&self, memory: &mut dyn Memory) -> Option<Vec<u8>> {
        let channel = self.control_block + FIRST_UP_CHANNEL;
        let mut word = |address: u64| memory.read(address, Width::W32).ok();
        let written = word(channel + WRITE_OFFSET)?;
        let mut read = word(channel + READ_OFFSET)?;
        if read == written {
            return None;
        }
        let (buffer, size) = (word(channel + BUFFER)?, word(channel + SIZE)?);
        if !self.is_set_up(memory) || written >= size || read >= size {
            return None;
        }
        let mut bytes = Vec::new();
        while read != written {
            bytes.push(u8::try_from(memory.read(buffer + read, Width::W8).ok()?).ok()?);
            read = (read + 1) % size;
        }
        memory.write(channel + READ_OFFSET, Width::W32, read).ok()?;
        Some(bytes)
    }

    fn is_set_up(&self, memory: &mut dyn Memory) -> bool {
        (self.control_block..)
            .zip(IDENTIFICATION)
            .all(|(address, &byte)| {
                memory
                    .read(address, Width::W8)
                    .is_ok_and(|read| read == u64::from(byte))
            })
    }
}
