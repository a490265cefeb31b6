//! Heading as labelled text, one line after that of the attitude in the format `text`,
//!
//! ```text
//! heading:271.35⇥heading_sigma:2.10⇥heading_valid:1
//! ```
//!
//! with tabs between the fields, and one line for each field in the format `teleplot`. The heading
//! is that of body forward, degrees in [0, 360), clockwise from magnetic north, or from true north
//! if the record has a declination. σ is in degrees.
//! `heading_valid` is 1 with [`Flags::HEADING_VALID`], else 0. There is no line while the heading
//! is unknown. The line of the attitude is the same with and without a compass.
//!
//! ```
//! use aplomb::telemetry::heading::{self, Line};
//!
//! let line = Line { heading_deg: 271.35, sigma_deg: 2.1, is_valid: true };
//! let mut buffer = [0; heading::LINES_LENGTH];
//! let encoded = std::str::from_utf8(heading::encode(&line, &mut buffer))?;
//! assert_eq!(encoded, "heading:271.35\theading_sigma:2.10\theading_valid:1\n");
//! assert_eq!(heading::decode(encoded), Some(line));
//! # Ok::<(), std::str::Utf8Error>(())
//! ```

use super::decimal::{self, LONGEST_NUMBER, Writer};
use crate::estimator::heading::HeadingEstimate;
use crate::health::Flags;
use crate::pipeline::Snapshot;
use crate::units::degrees;

/// Labels of the numbers.
pub(super) const LABELS: [&str; 2] = ["heading", "heading_sigma"];
/// Label of the last field: whether the heading is valid.
pub(super) const VALID_LABEL: &str = "heading_valid";

/// Length of the longest text in either format with its newlines, in bytes.
pub const LINES_LENGTH: usize = {
    // Each field has `>`, a label, a colon, its value, and a newline.
    let numbers = LABELS[0].len() + LABELS[1].len() + 2 * (3 + LONGEST_NUMBER);
    numbers + VALID_LABEL.len() + 4
};

/// Content of a line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Line {
    /// Heading, degrees in [0, 360).
    pub heading_deg: f32,
    /// σ of the heading, degrees.
    pub sigma_deg: f32,
    /// True if the heading is wrong by no more than the larger of 15° and six σ.
    pub is_valid: bool,
}

impl Line {
    /// Creates the line of a heading at a snapshot with its flags.
    pub fn new(snapshot: &Snapshot, heading: &HeadingEstimate) -> Self {
        let heading_rad = heading.heading_rad(snapshot.euler().yaw_rad);
        Self {
            heading_deg: full_turn(degrees(heading_rad)),
            sigma_deg: degrees(heading.sigma_rad),
            is_valid: snapshot.flags.contains(Flags::HEADING_VALID),
        }
    }
}

/// Converts an angle in (−180, 180] degrees to [0, 360), also after rounding to hundredths.
fn full_turn(degrees: f32) -> f32 {
    let turned = if degrees < 0.0 {
        degrees + 360.0
    } else {
        degrees
    };
    if turned < 359.995 { turned } else { 0.0 }
}

/// Encodes the line of the format `text` with its newline, and returns it.
#[inline(never)]
pub fn encode<'a>(line: &Line, buffer: &'a mut [u8; LINES_LENGTH]) -> &'a [u8] {
    put(line, buffer, "", "\t")
}

/// Encodes the lines of the format `teleplot` with their newlines, and returns them.
#[inline(never)]
pub fn encode_teleplot<'a>(line: &Line, buffer: &'a mut [u8; LINES_LENGTH]) -> &'a [u8] {
    put(line, buffer, ">", "\n")
}

/// Writes the fields with `before` before each, and `after` after each but the last.
#[inline(never)]
fn put<'a>(line: &Line, buffer: &'a mut [u8; LINES_LENGTH], before: &str, after: &str) -> &'a [u8] {
    let mut writer = Writer::new(buffer);
    for (label, value) in LABELS.into_iter().zip([line.heading_deg, line.sigma_deg]) {
        writer.text(before);
        writer.text(label);
        writer.text(":");
        writer.number(value);
        writer.text(after);
    }
    writer.text(before);
    writer.text(VALID_LABEL);
    writer.text(if line.is_valid { ":1\n" } else { ":0\n" });
    writer.finish()
}

/// Decodes a line of the format `text`, with or without its end; `None` if it is not one.
pub fn decode(line: &str) -> Option<Line> {
    let line = line.strip_suffix('\n').unwrap_or(line);
    let line = line.strip_suffix('\r').unwrap_or(line);
    let mut fields = line.split('\t');
    let mut value = |label: &str| {
        let field = fields.next()?.strip_prefix(label)?;
        field.strip_prefix(':')
    };
    let [heading, sigma] = LABELS;
    let decoded = Line {
        heading_deg: decimal::parse(value(heading)?)?,
        sigma_deg: decimal::parse(value(sigma)?)?,
        is_valid: match value(VALID_LABEL)? {
            "0" => false,
            "1" => true,
            _ => return None,
        },
    };
    fields.next().is_none().then_some(decoded)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{EulerAngles, Quaternion};
    use crate::units::radians;

    fn line_of(yaw_deg: f32, offset_deg: f32) -> String {
        let snapshot = Snapshot {
            attitude: Quaternion::from_euler(EulerAngles {
                yaw_rad: radians(yaw_deg),
                ..EulerAngles::default()
            }),
            flags: Flags::VALID | Flags::HEADING_VALID,
            ..Snapshot::default()
        };
        let heading = HeadingEstimate {
            yaw_offset_rad: radians(offset_deg),
            sigma_rad: radians(28.0),
            is_valid: true,
        };
        let mut buffer = [0; LINES_LENGTH];
        let encoded = encode(&Line::new(&snapshot, &heading), &mut buffer);
        String::from_utf8(encoded.to_vec()).expect("ASCII")
    }

    #[test]
    fn the_heading_is_yaw_and_offset_clockwise_from_north() {
        for (yaw_deg, offset_deg, expected) in [
            (10.0, 20.0, "30.00"),
            (-100.0, -70.0, "190.00"),
            (170.0, 20.0, "190.00"),
            (0.0, -0.004, "0.00"),
            (0.0, -0.01, "359.99"),
        ] {
            let line = line_of(yaw_deg, offset_deg);
            let expected = format!("heading:{expected}\theading_sigma:28.00\theading_valid:1\n");
            assert_eq!(line, expected);
        }
    }

    #[test]
    fn the_flag_of_the_snapshot_counts() {
        let heading = HeadingEstimate {
            yaw_offset_rad: 0.0,
            sigma_rad: 0.1,
            is_valid: true,
        };
        let line = Line::new(&Snapshot::default(), &heading);
        assert!(!line.is_valid);
        let mut buffer = [0; LINES_LENGTH];
        assert!(encode(&line, &mut buffer).ends_with(b"heading_valid:0\n"));
    }

    #[test]
    fn the_longest_lines_fit_exactly_and_read_back() {
        let line = Line {
            heading_deg: f32::NEG_INFINITY,
            sigma_deg: f32::NEG_INFINITY,
            is_valid: false,
        };
        let mut buffer = [0; LINES_LENGTH];
        let encoded = core::str::from_utf8(encode_teleplot(&line, &mut buffer)).expect("ASCII");
        assert_eq!(encoded.len(), LINES_LENGTH);
        let line = Line {
            heading_deg: 359.99,
            sigma_deg: 28.5,
            is_valid: false,
        };
        let encoded = core::str::from_utf8(encode_teleplot(&line, &mut buffer)).expect("ASCII");
        let mut fields = encoded.lines().map(super::super::teleplot::decode);
        assert_eq!(fields.next(), Some(Some(("heading", 359.99))));
        assert_eq!(fields.next(), Some(Some(("heading_sigma", 28.5))));
        assert_eq!(fields.next(), Some(Some(("heading_valid", 0.0))));
        let mut buffer = [0; LINES_LENGTH];
        let encoded = core::str::from_utf8(encode(&line, &mut buffer)).expect("ASCII");
        assert_eq!(decode(encoded), Some(line));
        assert_eq!(decode(encoded.trim_end()), Some(line));
    }

    #[test]
    fn other_lines_are_no_heading() {
        for other in [
            "",
            "roll:1.00\tpitch:-2.50",
            "heading:1.00\theading_sigma:1.00",
            "heading:1.0\theading_sigma:1.00\theading_valid:1",
            "heading:1.00\theading_sigma:1.00\theading_valid:2",
            "heading:1.00\theading_sigma:1.00\theading_valid:1\tmore:1.00",
            "heading_sigma:1.00\theading:1.00\theading_valid:1",
        ] {
            assert_eq!(decode(other), None, "{other}");
        }
    }
}
