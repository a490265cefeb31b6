//! A debug probe that reads the firmware's log: it drains the RTT buffer from memory and decodes defmt.

use defmt_decoder::{DecodeError, StreamDecoder, Table};
use rigless::emulator::Memory;
use rigless::soc::Width;

/// Offsets in the RTT control block (SEGGER UM08001, section "RTT Control Block").
const FIRST_UP_CHANNEL: u64 = 24;
const BUFFER: u64 = 4;
const SIZE: u64 = 8;
const WRITE_OFFSET: u64 = 12;
const READ_OFFSET: u64 = 16;

/// The identification that says that the control block has been set up.
const IDENTIFICATION: &[u8; 10] = b"SEGGER RTT";

/// A line of the firmware's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// When the probe read it, ns since power-up.
    pub at_ns: u64,
    /// Level and message.
    pub text: String,
}

/// The probe.
pub struct Probe {
    control_block: u64,
    decoder: Box<dyn StreamDecoder + Send + Sync>,
}

impl Probe {
    /// A probe for an image with its control block at `control_block`. `None` if the image has no defmt data.
    #[must_use]
    pub fn attach(elf: &[u8], control_block: u64) -> Option<Self> {
        // The decoder borrows the table for as long as it lives. One table per run stays until the process ends.
        let table: &'static Table = Box::leak(Box::new(Table::parse(elf).ok().flatten()?));
        Some(Self {
            control_block,
            decoder: table.new_stream_decoder(),
        })
    }

    /// Takes what the firmware has logged since the last call.
    pub fn drain(&mut self, memory: &mut dyn Memory, at_ns: u64) -> Vec<LogLine> {
        if let Some(bytes) = self.read(memory) {
            self.decoder.received(&bytes);
        }
        let mut lines = Vec::new();
        loop {
            let text = match self.decoder.decode() {
                Ok(frame) => {
                    let level = frame.level().map_or("     ".into(), |level| {
                        format!("{:<5}", level.as_str().to_uppercase())
                    });
                    format!("{level} {}", frame.display_message())
                }
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => "ERROR (a malformed log frame)".into(),
            };
            lines.push(LogLine { at_ns, text });
        }
        lines
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
