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

/// The longest frame of a snapshot in this format, in bytes; of MAVLink all three that a snapshot takes.
pub const fn frame_length(format: OutputFormat) -> usize {
    match format {
        OutputFormat::Text => text::LINE_LENGTH,
        OutputFormat::Classic => classic::LINE_LENGTH,
        OutputFormat::Teleplot => teleplot::LINES_LENGTH,
        OutputFormat::Teapot => teapot::PACKET_LENGTH,
        OutputFormat::Mavlink => MAVLINK_LENGTH,
        OutputFormat::Log => log::BYTES_PER_ATTITUDE,
    }
}

/// ATTITUDE, ATTITUDE_QUATERNION and HIGHRES_IMU.
const MAVLINK_LENGTH: usize = (12 + 28) + (12 + 32) + (12 + 63);

/// What a format sends beside snapshots, in bytes per second.
const fn other_bytes_per_second(format: OutputFormat) -> u32 {
    match format {
        // HEARTBEAT, SYS_STATUS, and answers.
        OutputFormat::Mavlink => 300,
        // 1000 bursts and 1 % for a clock that is fast, configurations, pieces of the state.
        OutputFormat::Log => 1010 * log::BYTES_PER_BURST as u32 + 700,
        _ => 0,
    }
}

/// Writes a snapshot in a format, and returns what it wrote. The counter is one more for each frame that is sent.
/// MAVLink and the flight log are more than a frame for a snapshot: their own files write them.
#[inline(never)]
pub fn encode<'a>(
    format: OutputFormat,
    snapshot: &Snapshot,
    counter: u8,
    frame: &'a mut [u8; FRAME_CAPACITY],
) -> &'a [u8] {
    match format {
        OutputFormat::Text => frame
            .first_chunk_mut()
            .map(|line| text::encode(snapshot, line)),
        OutputFormat::Classic => frame
            .first_chunk_mut()
            .map(|line| classic::encode(&classic::angles_of(snapshot), line)),
        OutputFormat::Teleplot => frame
            .first_chunk_mut()
            .map(|lines| teleplot::encode(snapshot, lines)),
        OutputFormat::Teapot => {
            frame
                .first_chunk_mut::<{ teapot::PACKET_LENGTH }>()
                .map(|packet| {
                    *packet = teapot::encode(snapshot.attitude, counter);
                    packet.as_slice()
                })
        }
        OutputFormat::Mavlink | OutputFormat::Log => None,
    }
    .unwrap_or_default()
}

/// The most frames per second that a UART at this rate carries, eight bits a byte, one start and one stop bit.
pub const fn largest_rate_hz(format: OutputFormat, baud: u32) -> u32 {
    const BITS_PER_BYTE: u32 = 10;
    (baud / BITS_PER_BYTE).saturating_sub(other_bytes_per_second(format))
        / frame_length(format) as u32
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
    #[inline(never)]
    pub fn put(&mut self, bytes: &[u8]) -> bool {
        let end = self.length + bytes.len();
        match self.buffer.get_mut(self.length..end) {
            Some(place) => {
                for (place, byte) in place.iter_mut().zip(bytes) {
                    *place = *byte;
                }
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
    /// The same for the flight log, whose bursts fill half of the transmitter's buffer in this time.
    const LEAST_LOG_TICKS_HZ: u16 = 100;

    /// The pace of so many frames per second in a format; none counts as one.
    pub const fn of(format: OutputFormat, rate_hz: u16) -> Self {
        let rate_hz = if rate_hz == 0 { 1 } else { rate_hz };
        let least_hz = match format {
            OutputFormat::Log => Self::LEAST_LOG_TICKS_HZ,
            _ => Self::LEAST_TICKS_HZ,
        };
        let ticks = least_hz.div_ceil(rate_hz);
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
        let text = encode(OutputFormat::Text, &snapshot, 0, &mut frame).to_vec();
        assert!(text.starts_with(b"roll:0.00\t") && text.ends_with(b"\n"));
        let classic = encode(OutputFormat::Classic, &snapshot, 0, &mut frame);
        assert_eq!(classic, b"Roll:0.00(0.00),\tPitch:0.00(0.00)\n");
        let teleplot = encode(OutputFormat::Teleplot, &snapshot, 0, &mut frame);
        assert!(teleplot.starts_with(b">roll:0.00\n"));
        let teapot = encode(OutputFormat::Teapot, &snapshot, 7, &mut frame);
        assert_eq!((teapot.len(), teapot[2], teapot[11]), (14, 0x40, 7));
    }

    #[test]
    fn ticks_come_fifty_times_a_second_at_least_and_frames_at_their_rate() {
        let pace = |period_us, ticks| Pace { period_us, ticks };
        assert_eq!(Pace::of(OutputFormat::Text, 50), pace(20_000, 1));
        assert_eq!(Pace::of(OutputFormat::Text, 1000), pace(1_000, 1));
        assert_eq!(Pace::of(OutputFormat::Text, 20), pace(16_666, 3));
        assert_eq!(Pace::of(OutputFormat::Text, 1), pace(20_000, 50));
        for rate_hz in 1..=1000 {
            let Pace { period_us, ticks } = Pace::of(OutputFormat::Text, rate_hz);
            assert!(period_us <= 20_000, "{rate_hz}");
            let frame_us = period_us * u32::from(ticks);
            let error = 1.0 - f64::from(frame_us) * f64::from(rate_hz) / 1e6;
            assert!((0.0..=0.001).contains(&error), "{rate_hz}: {error}");
        }
    }

    #[test]
    fn the_default_rate_fits_the_default_line_and_the_fastest_line_carries_more() {
        assert_eq!(largest_rate_hz(OutputFormat::Text, 115_200), 101);
        assert_eq!(largest_rate_hz(OutputFormat::Text, 9_600), 8);
        assert_eq!(largest_rate_hz(OutputFormat::Text, 921_600), 815);
        assert!(largest_rate_hz(OutputFormat::Classic, 921_600) > 1000);
        assert_eq!(largest_rate_hz(OutputFormat::Mavlink, 115_200), 70);
        assert_eq!(largest_rate_hz(OutputFormat::Log, 115_200), 0);
        assert!(largest_rate_hz(OutputFormat::Log, 921_600) > 1000);
    }

    /// The table in README.md.
    #[test]
    fn the_documented_rates_are_these() {
        let rows = OutputFormat::ALL.map(|format| {
            let rate = |baud| largest_rate_hz(format, baud).min(1000);
            (
                format.name(),
                frame_length(format),
                rate(115_200),
                rate(921_600),
            )
        });
        assert_eq!(
            rows,
            [
                ("text", 113, 101, 815),
                ("classic", 54, 213, 1000),
                ("teleplot", 120, 96, 768),
                ("teapot", 14, 822, 1000),
                ("mavlink", 159, 70, 577),
                ("log", 48, 0, 1000),
            ]
        );
    }
}
