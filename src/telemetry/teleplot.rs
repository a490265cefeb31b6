//! Teleplot format: one line for each variable.
//!
//! ```text
//! >roll:1.00
//! >pitch:-2.50
//! ```
//!
//! Teleplot needs a line for each variable, begun with `>` on a serial port, and takes a second
//! colon for a time. An Arduino plotter needs all variables of a moment in one line, as [`text`]
//! has them. Labels and units are the same.
//!
//! ```
//! use aplomb::telemetry::teleplot;
//!
//! assert_eq!(teleplot::decode(">pitch:-2.50\n"), Some(("pitch", -2.5)));
//! assert_eq!(teleplot::decode("pitch:-2.50\n"), None);
//! ```

use super::decimal::{LONGEST_NUMBER, Writer};
use super::{heading, text};
use crate::pipeline::Snapshot;

/// Length of the longest set of lines with their newlines, in bytes.
pub const LINES_LENGTH: usize = {
    // Each field has `>`, a label, a colon, a number and a newline.
    let mut length = 1 + text::VALID.len();
    let mut index = 0;
    while index < text::LABELS.len() {
        length += 1 + text::LABELS[index].len() + 1 + LONGEST_NUMBER + 1;
        index += 1;
    }
    length
};

/// Encodes the lines of a snapshot, and returns them.
#[inline(never)]
pub fn encode<'a>(snapshot: &Snapshot, lines: &'a mut [u8; LINES_LENGTH]) -> &'a [u8] {
    let mut writer = Writer::new(lines);
    text::put(&mut writer, &text::Line::from(snapshot), ">", "\n");
    writer.finish()
}

/// Decodes one line, with or without its end: label and value in degrees or °/s; `None` if it is
/// not one.
pub fn decode(line: &str) -> Option<(&str, f32)> {
    let line = line.strip_suffix('\n').unwrap_or(line);
    let line = line.strip_suffix('\r').unwrap_or(line);
    let (label, value) = line.strip_prefix('>')?.split_once(':')?;
    let value = match (label, value) {
        (text::VALID_LABEL | heading::VALID_LABEL, "0") => 0.0,
        (text::VALID_LABEL | heading::VALID_LABEL, "1") => 1.0,
        _ if text::LABELS.contains(&label) || heading::LABELS.contains(&label) => {
            super::decimal::parse(value)?
        }
        _ => return None,
    };
    Some((label, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{EulerAngles, Quaternion, Vector3};
    use crate::health::Flags;
    use crate::units::radians;

    #[test]
    fn each_variable_has_a_line_that_reads_back() {
        let snapshot = Snapshot {
            attitude: Quaternion::from_euler(EulerAngles {
                roll_rad: radians(1.0),
                pitch_rad: radians(-2.5),
                yaw_rad: radians(90.0),
            }),
            body_rates_rad_s: Vector3::new(0.0, radians(0.12), radians(-3.0)),
            flags: Flags::VALID,
            ..Snapshot::default()
        };
        let mut lines = [0; LINES_LENGTH];
        let lines = core::str::from_utf8(encode(&snapshot, &mut lines)).expect("ASCII");
        assert_eq!(
            lines,
            ">roll:1.00\n>pitch:-2.50\n>yaw:90.00\n\
             >roll_rate:0.00\n>pitch_rate:0.12\n>yaw_rate:-3.00\n>valid:1\n"
        );
        let read: Vec<_> = lines.lines().map(decode).collect();
        assert_eq!(read[1], Some(("pitch", -2.5)));
        assert!(read.iter().all(Option::is_some));
        assert_eq!(read[6], Some(("valid", 1.0)));
        assert_eq!(decode(">valid:2"), None);
        assert_eq!(decode("roll:1.00"), None);
        assert_eq!(decode(">height:1.00"), None);
    }

    #[test]
    fn the_longest_lines_fit_exactly() {
        let snapshot = Snapshot {
            body_rates_rad_s: Vector3::new(-1e9, -1e9, -1e9),
            ..Snapshot::default()
        };
        let mut lines = [0; LINES_LENGTH];
        let length = encode(&snapshot, &mut lines).len();
        // Angles of zero are five bytes shorter than the longest number.
        assert_eq!(length, LINES_LENGTH - 3 * (LONGEST_NUMBER - 4));
    }
}
