//! The classic tutorial's line: `Roll:<angle>(<rate>),⇥Pitch:<angle>(<rate>)`.
//!
//! Degrees and °/s with two decimals; the rates are those at which the filtered angles change.

use super::decimal::{self, LONGEST_NUMBER, Writer};
use crate::estimator::ClassicAngles;

/// The longest line, its newline included.
pub const LINE_LENGTH: usize = "Roll:(),\tPitch:()\n".len() + 4 * LONGEST_NUMBER;

/// Writes a line, newline included, and returns it.
pub fn encode<'a>(angles: &ClassicAngles, line: &'a mut [u8; LINE_LENGTH]) -> &'a [u8] {
    let mut writer = Writer::new(line);
    writer.text("Roll:");
    writer.number(angles.roll_deg);
    writer.text("(");
    writer.number(angles.roll_rate_deg_s);
    writer.text("),\tPitch:");
    writer.number(angles.pitch_deg);
    writer.text("(");
    writer.number(angles.pitch_rate_deg_s);
    writer.text(")\n");
    writer.finish()
}

/// Reads a line, with or without its line end; `None` if it is not one.
pub fn decode(line: &str) -> Option<ClassicAngles> {
    let line = line.strip_suffix('\n').unwrap_or(line);
    let line = line.strip_suffix('\r').unwrap_or(line);
    let line = line.strip_prefix("Roll:")?;
    let (roll, line) = line.split_once('(')?;
    let (roll_rate, line) = line.split_once("),\tPitch:")?;
    let (pitch, line) = line.split_once('(')?;
    let pitch_rate = line.strip_suffix(')')?;
    Some(ClassicAngles {
        roll_deg: decimal::parse(roll)?,
        roll_rate_deg_s: decimal::parse(roll_rate)?,
        pitch_deg: decimal::parse(pitch)?,
        pitch_rate_deg_s: decimal::parse(pitch_rate)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: ClassicAngles = ClassicAngles {
        roll_deg: 12.34,
        roll_rate_deg_s: -5.6,
        pitch_deg: -0.5,
        pitch_rate_deg_s: 0.0,
    };

    #[test]
    fn the_line_is_the_tutorials_and_reads_back() {
        let mut line = [0; LINE_LENGTH];
        let text = core::str::from_utf8(encode(&EXAMPLE, &mut line)).expect("ASCII");
        assert_eq!(text, "Roll:12.34(-5.60),\tPitch:-0.50(0.00)\n");
        assert_eq!(decode(text), Some(EXAMPLE));
        assert_eq!(decode(&text.replace("Pitch", "pitch")), None);
        assert_eq!(decode(&text.replace(")\n", "\n")), None);
    }

    #[test]
    fn the_longest_line_fits_exactly() {
        let worst = f32::NEG_INFINITY;
        let angles = ClassicAngles {
            roll_deg: worst,
            roll_rate_deg_s: worst,
            pitch_deg: worst,
            pitch_rate_deg_s: worst,
        };
        let mut line = [0; LINE_LENGTH];
        let text = encode(&angles, &mut line);
        assert_eq!(text.len(), LINE_LENGTH);
        assert!(text.ends_with(b")\n"));
    }
}
