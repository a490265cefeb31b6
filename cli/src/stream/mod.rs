//! Decoder of the module's stream, whatever its format: bytes in, attitudes and messages out.
//!
//! The decoders of all formats get every byte. Each accepts only input that it can check (a
//! checksum, or the exact form of a line or packet), so the present format is that of the last
//! accepted piece, and may change without notice.

mod fields;
mod item;
mod lines;
mod log;
mod mavlink;
mod packets;
#[cfg(test)]
mod tests;

use aplomb::settings::OutputFormat;

pub use fields::{field, numbers};
pub use item::{Attitude, Counts, Format, Item, Sensors};
use lines::{Content, Lines};
use log::Log;
use mavlink::Mavlink;
use packets::Packets;

/// Decoder of a stream.
#[derive(Default)]
pub struct Decoder {
    format: Option<Format>,
    counts: Counts,
    lines: Lines,
    packets: Packets,
    mavlink: Mavlink,
    log: Log,
}

impl Decoder {
    /// Returns the format of the last decoded piece.
    pub fn format(&self) -> Option<Format> {
        self.format
    }

    /// Returns the counts so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Drops unfinished pieces, because the next bytes do not continue the stream.
    pub fn interrupt(&mut self) {
        let Self { format, counts, .. } = *self;
        *self = Self {
            format,
            counts,
            ..Self::default()
        };
    }

    /// Takes the next bytes, and appends what they complete.
    pub fn push(&mut self, bytes: &[u8], items: &mut Vec<Item>) {
        for byte in bytes {
            let start = items.len();
            let found = self.take(*byte, items);
            if let Some(format) = found {
                if self.format.replace(format) != Some(format) {
                    self.leave_others(format);
                }
                if !format.has_lines() {
                    self.lines.restart();
                }
            }
            let is_reading = |item: &&Item| matches!(item, Item::Attitude(_));
            self.counts.attitudes += items[start..].iter().filter(is_reading).count() as u64;
        }
    }

    /// Forgets the numbers of other formats, so that their gaps do not count as lost.
    fn leave_others(&mut self, format: Format) {
        if format != Format::Module(OutputFormat::Log) {
            self.log = Log::default();
        }
        if format != Format::Module(OutputFormat::Mavlink) {
            self.mavlink.sequence = None;
        }
        if format != Format::Module(OutputFormat::Teapot) {
            self.packets.counter = None;
        }
    }

    /// Takes a byte, and returns the format of the piece that it completes.
    fn take(&mut self, byte: u8, items: &mut Vec<Item>) -> Option<Format> {
        let has_lines = self.format.is_none_or(Format::has_lines);
        let format = self.format;
        let counts = &mut self.counts;
        let module = |format| Some(Format::Module(format));
        if self.log.push(byte, counts, items) {
            return module(OutputFormat::Log);
        }
        // Pieces of another format look damaged to this decoder, and are not.
        let damaged = self.log.take_damaged();
        if format == module(OutputFormat::Log) {
            counts.damaged += damaged;
        }
        if self.mavlink.push(byte, counts, items) {
            return module(OutputFormat::Mavlink);
        }
        let damaged = self.mavlink.take_damaged();
        if format == module(OutputFormat::Mavlink) {
            counts.damaged += damaged;
        }
        if let Some((attitude, counter)) = self.packets.push(byte) {
            if let Some(last) = self.packets.counter.replace(counter) {
                counts.lost += u64::from(counter.wrapping_sub(last).wrapping_sub(1));
            }
            items.push(Item::Attitude(Attitude::of_quaternion(attitude)));
            return module(OutputFormat::Teapot);
        }
        match self.lines.push(byte, items) {
            Some(Content::Attitude(format)) => return Some(format),
            Some(Content::Unknown) if has_lines && format.is_some() => counts.damaged += 1,
            Some(_) | None => {}
        }
        None
    }
}
