//! What leaves the module: one file per format, encoder and decoder together.

pub mod bursts;
pub mod classic;
mod decimal;
pub mod log;
#[cfg(feature = "mavlink")]
pub mod mavlink;
pub mod message;
pub mod teapot;
pub mod teleplot;
pub mod text;

use crate::calibration::OutputFormat;
use crate::pipeline::Snapshot;

/// Room for one snapshot in any format, in bytes.
pub const FRAME_CAPACITY: usize = {
    let mut longest = 0;
    let mut index = 0;
    while index < OutputFormat::ALL.len() {
        let length = frame_length(OutputFormat::ALL[index]);
        if length > longest {
            longest = length;
        }
        index += 1;
    }
    longest
};

/// The longest frame of a snapshot in this format, in bytes.
pub const fn frame_length(format: OutputFormat) -> usize {
    match format {
        OutputFormat::Text => text::LINE_LENGTH,
        OutputFormat::Classic => classic::LINE_LENGTH,
    }
}

/// Writes a snapshot in a format, and returns what it wrote.
pub fn encode<'a>(
    format: OutputFormat,
    snapshot: &Snapshot,
    frame: &'a mut [u8; FRAME_CAPACITY],
) -> &'a [u8] {
    match format {
        OutputFormat::Text => frame
            .first_chunk_mut()
            .map(|line| text::encode(snapshot, line)),
        OutputFormat::Classic => frame
            .first_chunk_mut()
            .map(|line| classic::encode(&classic::angles_of(snapshot), line)),
    }
    .unwrap_or_default()
}

/// The most frames per second that a UART at this rate carries, eight bits a byte, one start and one stop bit.
pub const fn largest_rate_hz(format: OutputFormat, baud: u32) -> u32 {
    const BITS_PER_BYTE: u32 = 10;
    baud / (BITS_PER_BYTE * frame_length(format) as u32)
}

/// Bytes that are about to be sent, in a buffer of fixed size.
pub struct Output<'a> {
    buffer: &'a mut [u8],
    length: usize,
}

impl<'a> Output<'a> {
    /// Nothing yet, in `buffer`.
    pub const fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, length: 0 }
    }

    /// How many bytes there are.
    pub const fn length(&self) -> usize {
        self.length
    }

    /// Whether so many more fit.
    pub const fn has_room(&self, bytes: usize) -> bool {
        self.buffer.len().saturating_sub(self.length) >= bytes
    }

    /// Adds bytes, all or none; false if there is no room.
    pub fn put(&mut self, bytes: &[u8]) -> bool {
        let end = self.length + bytes.len();
        match self.buffer.get_mut(self.length..end) {
            Some(place) => {
                place.copy_from_slice(bytes);
                self.length = end;
                true
            }
            None => false,
        }
    }
}

/// How a rate is kept by ticks that also serve the console: so many ticks of this length to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pace {
    /// From tick to tick, in µs.
    pub period_us: u32,
    /// Ticks to a frame.
    pub ticks: u16,
}

impl Pace {
    /// Ticks come at least so often, per second.
    const LEAST_TICKS_HZ: u16 = 50;

    /// The pace of so many frames per second; none counts as one.
    pub const fn of(rate_hz: u16) -> Self {
        let rate_hz = if rate_hz == 0 { 1 } else { rate_hz };
        let ticks = Self::LEAST_TICKS_HZ.div_ceil(rate_hz);
        Self {
            period_us: 1_000_000 / (rate_hz as u32 * ticks as u32),
            ticks,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_is_written_by_its_own_file() {
        let snapshot = Snapshot::default();
        let mut frame = [0; FRAME_CAPACITY];
        let text = encode(OutputFormat::Text, &snapshot, &mut frame).to_vec();
        assert!(text.starts_with(b"roll:0.00\t") && text.ends_with(b"\n"));
        let classic = encode(OutputFormat::Classic, &snapshot, &mut frame);
        assert_eq!(classic, b"Roll:0.00(0.00),\tPitch:0.00(0.00)\n");
    }

    #[test]
    fn ticks_come_fifty_times_a_second_at_least_and_frames_at_their_rate() {
        let pace = |period_us, ticks| Pace { period_us, ticks };
        assert_eq!(Pace::of(50), pace(20_000, 1));
        assert_eq!(Pace::of(1000), pace(1_000, 1));
        assert_eq!(Pace::of(20), pace(16_666, 3));
        assert_eq!(Pace::of(1), pace(20_000, 50));
        for rate_hz in 1..=1000 {
            let Pace { period_us, ticks } = Pace::of(rate_hz);
            assert!(period_us <= 20_000, "{rate_hz}");
            let frame_us = period_us * u32::from(ticks);
            let error = 1.0 - f64::from(frame_us) * f64::from(rate_hz) / 1e6;
            assert!((0.0..=0.001).contains(&error), "{rate_hz}: {error}");
        }
    }

    #[test]
    fn the_default_rate_fits_the_default_line_and_the_fastest_line_carries_more() {
        assert_eq!(largest_rate_hz(OutputFormat::Text, 115_200), 109);
        assert_eq!(largest_rate_hz(OutputFormat::Text, 9_600), 9);
        assert_eq!(largest_rate_hz(OutputFormat::Text, 921_600), 877);
        assert!(largest_rate_hz(OutputFormat::Classic, 921_600) > 1000);
    }
}
