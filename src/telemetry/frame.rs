//! Frames: one snapshot in each format, and how many of them the UART carries.

use super::{classic, heading, log, teapot, teleplot, text};
use crate::compass;
use crate::estimator::heading::HeadingEstimate;
use crate::pipeline::Snapshot;
use crate::settings::OutputFormat;

/// Length of the longest frame of a snapshot in any format, in bytes.
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

/// Returns the length of the longest frame of a snapshot in a format, in bytes. For MAVLink this is
/// the sum of the three messages that a snapshot takes.
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

/// Length of ATTITUDE, ATTITUDE_QUATERNION and HIGHRES_IMU, in bytes.
const MAVLINK_LENGTH: usize = (12 + 28) + (12 + 32) + (12 + 63);

/// Returns the bytes per second that a format sends beside snapshots.
const fn other_bytes_per_second(format: OutputFormat) -> u32 {
    match format {
        // HEARTBEAT, SYS_STATUS and answers.
        OutputFormat::Mavlink => 300,
        // 1000 bursts and 1 % for a fast clock, configurations, pieces of the state.
        OutputFormat::Log => 1010 * log::BYTES_PER_BURST as u32 + 700 + compass_bytes_per_second(),
        _ => 0,
    }
}

/// Returns the bytes per second that the flight log sends of a compass: 51 readings, seven
/// headings, pieces of the heading filter's state.
const fn compass_bytes_per_second() -> u32 {
    if compass::IS_BUILT_IN {
        (51 * log::BYTES_PER_READING + 7 * log::BYTES_PER_HEADING + 250) as u32
    } else {
        0
    }
}

/// Encodes a snapshot in a format, and returns the frame.
///
/// `counter` is the number of frames sent so far, modulo 256; only the teapot packet holds it. The
/// frame is empty for MAVLink and the flight log, which are more than a frame per snapshot: see
/// `mavlink::Session` and [`log::Sender`].
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

/// Encodes the heading at a snapshot, and returns the lines that follow the snapshot's frame. They
/// are empty for formats without a heading.
#[inline(never)]
pub fn encode_heading<'a>(
    format: OutputFormat,
    snapshot: &Snapshot,
    estimate: &HeadingEstimate,
    lines: &'a mut [u8; heading::LINES_LENGTH],
) -> &'a [u8] {
    let line = heading::Line::new(snapshot, estimate);
    match format {
        OutputFormat::Text => heading::encode(&line, lines),
        OutputFormat::Teleplot => heading::encode_teleplot(&line, lines),
        _ => &[],
    }
}

/// Returns whether the UART carries the heading's lines beside this many frames per second.
pub const fn has_room_for_heading(format: OutputFormat, rate_hz: u32, baud: u32) -> bool {
    let length = frame_length(format) + heading::LINES_LENGTH;
    rate_hz as usize * length <= (baud / BITS_PER_BYTE) as usize
}

/// Bits of a byte on the UART: 8 data bits, a start bit and a stop bit.
const BITS_PER_BYTE: u32 = 10;

/// Largest rate of the attitudes in the flight log, Hz. At higher rates its other frames often take
/// longer than the time between two attitudes, and the next attitude is dropped.
const MAX_LOG_RATE_HZ: u32 = 250;

/// Returns the most frames per second that the UART carries at a baud rate, with 8 data bits, one
/// start bit and one stop bit. Returns 0 if the format does not fit at all.
pub const fn largest_rate_hz(format: OutputFormat, baud: u32) -> u32 {
    let rate_hz = (baud / BITS_PER_BYTE).saturating_sub(other_bytes_per_second(format))
        / frame_length(format) as u32;
    match format {
        OutputFormat::Log if rate_hz > MAX_LOG_RATE_HZ => MAX_LOG_RATE_HZ,
        _ => rate_hz,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_is_encoded() {
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
    fn the_heading_follows_where_the_line_has_room() {
        let estimate = HeadingEstimate {
            yaw_offset_rad: 0.0,
            sigma_rad: 0.0,
            is_valid: true,
        };
        for format in OutputFormat::ALL {
            let mut lines = [0; heading::LINES_LENGTH];
            let lines = encode_heading(format, &Snapshot::default(), &estimate, &mut lines);
            let start: &[u8] = match format {
                OutputFormat::Text => b"heading:0.00\t",
                OutputFormat::Teleplot => b">heading:0.00\n",
                _ => b"",
            };
            assert!(lines.starts_with(start) && lines.is_empty() == start.is_empty());
        }
        for (format, rate_hz) in [(OutputFormat::Text, 66), (OutputFormat::Teleplot, 63)] {
            assert!(has_room_for_heading(format, rate_hz, 115_200));
            assert!(!has_room_for_heading(format, rate_hz + 1, 115_200));
        }
    }

    #[test]
    fn the_default_rate_fits_the_default_baud_rate() {
        assert_eq!(largest_rate_hz(OutputFormat::Text, 115_200), 101);
        assert_eq!(largest_rate_hz(OutputFormat::Text, 9_600), 8);
        assert_eq!(largest_rate_hz(OutputFormat::Text, 921_600), 815);
        assert!(largest_rate_hz(OutputFormat::Classic, 921_600) > 1000);
        assert_eq!(largest_rate_hz(OutputFormat::Mavlink, 115_200), 70);
        assert_eq!(largest_rate_hz(OutputFormat::Log, 115_200), 0);
        assert_eq!(largest_rate_hz(OutputFormat::Log, 921_600), 250);
    }

    /// The table in `docs/telemetry.md`.
    #[test]
    fn the_highest_rates_are_the_documented_ones() {
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
                ("log", 48, 0, 250),
            ]
        );
    }
}
