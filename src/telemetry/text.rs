//! Labelled text for people and Arduino-style plotters, one line per attitude,
//!
//! ```text
//! roll:1.00⇥pitch:-2.50⇥yaw:9.00⇥roll_rate:0.00⇥pitch_rate:0.12⇥yaw_rate:-3.00⇥valid:1
//! ```
//!
//! with tabs between the fields. Angles are degrees, rates are the body's own p, q, r in °/s; yaw
//! is relative to the heading at start. Numbers have two decimals. `valid` is 1 with
//! [`Flags::VALID`], else 0; a message names the other flags when they change. Teleplot has a
//! format of its own, [`teleplot`](super::teleplot).
//!
//! ```
//! use aplomb::telemetry::text::{self, Line};
//!
//! let line = Line { roll_deg: 1.0, pitch_deg: -2.5, is_valid: true, ..Line::default() };
//! let mut buffer = [0; text::LINE_LENGTH];
//! let encoded = std::str::from_utf8(text::encode_line(&line, &mut buffer))?;
//! assert_eq!(text::decode(encoded), Ok(line));
//! # Ok::<(), std::str::Utf8Error>(())
//! ```

use core::fmt;

use super::decimal::{self, LONGEST_NUMBER, Writer};
use crate::health::Flags;
use crate::pipeline::Snapshot;
use crate::units::degrees;

pub(super) const LABELS: [&str; 6] = [
    "roll",
    "pitch",
    "yaw",
    "roll_rate",
    "pitch_rate",
    "yaw_rate",
];

/// Label of the last field: whether the attitude is valid.
pub(super) const VALID_LABEL: &str = "valid";
const INVALID: &str = "valid:0\n";
pub(super) const VALID: &str = "valid:1\n";

/// Length of the longest line with its newline, in bytes.
pub const LINE_LENGTH: usize = {
    // Each field has a label, a colon, a number, and a tab.
    let mut length = VALID.len();
    let mut index = 0;
    while index < LABELS.len() {
        length += LABELS[index].len() + 1 + LONGEST_NUMBER + 1;
        index += 1;
    }
    length
};

/// Content of a line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Line {
    /// Roll, degrees in (−180, 180].
    pub roll_deg: f32,
    /// Pitch, degrees in [−90, 90].
    pub pitch_deg: f32,
    /// Yaw relative to the heading at start, degrees in (−180, 180].
    pub yaw_deg: f32,
    /// Rate about the forward axis, °/s.
    pub roll_rate_deg_s: f32,
    /// Rate about the right axis, °/s.
    pub pitch_rate_deg_s: f32,
    /// Rate about the down axis, °/s.
    pub yaw_rate_deg_s: f32,
    /// True if the attitude has [`Flags::VALID`].
    pub is_valid: bool,
}

impl Line {
    /// Returns the numbers in the order of the labels.
    pub(super) const fn values(&self) -> [f32; 6] {
        [
            self.roll_deg,
            self.pitch_deg,
            self.yaw_deg,
            self.roll_rate_deg_s,
            self.pitch_rate_deg_s,
            self.yaw_rate_deg_s,
        ]
    }
}

/// Writes the fields with `before` before each, and `after` after each but the last.
#[inline(never)]
pub(super) fn put(writer: &mut Writer<'_>, numbers: &Line, before: &str, after: &str) {
    for (label, value) in LABELS.into_iter().zip(numbers.values()) {
        writer.text(before);
        writer.text(label);
        writer.text(":");
        if label == "roll" || label == "yaw" {
            writer.angle(value);
        } else {
            writer.number(value);
        }
        writer.text(after);
    }
    writer.text(before);
    writer.text(if numbers.is_valid { VALID } else { INVALID });
}

impl From<&Snapshot> for Line {
    fn from(snapshot: &Snapshot) -> Self {
        let angles = snapshot.euler();
        let rates = snapshot.body_rates_rad_s;
        Self {
            roll_deg: degrees(angles.roll_rad),
            pitch_deg: degrees(angles.pitch_rad),
            yaw_deg: degrees(angles.yaw_rad),
            roll_rate_deg_s: degrees(rates.x),
            pitch_rate_deg_s: degrees(rates.y),
            yaw_rate_deg_s: degrees(rates.z),
            is_valid: snapshot.flags.contains(Flags::VALID),
        }
    }
}

/// Encodes the line of a snapshot with its newline, and returns it.
///
/// Numbers are limited to ±99999.99; a NaN is written as `nan`.
pub fn encode<'a>(snapshot: &Snapshot, line: &'a mut [u8; LINE_LENGTH]) -> &'a [u8] {
    encode_line(&Line::from(snapshot), line)
}

/// Encodes a line with its newline, and returns it; see [`encode`].
#[inline(never)]
pub fn encode_line<'a>(numbers: &Line, line: &'a mut [u8; LINE_LENGTH]) -> &'a [u8] {
    let mut writer = Writer::new(line);
    put(&mut writer, numbers, "", "\t");
    writer.finish()
}

/// Reason why a line is not valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum DecodeError {
    /// The field with this label is missing or out of order.
    MissingField(&'static str),
    /// The value of the field with this label is not a number with two decimals.
    NotANumber(&'static str),
    /// `valid` is neither 0 nor 1.
    NotAValidity,
    /// Text follows the last field.
    TrailingText,
}

impl fmt::Display for DecodeError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MissingField(label) => write!(formatter, "expected the field `{label}:`"),
            Self::NotANumber(label) => {
                write!(formatter, "`{label}` is not a number with two decimals")
            }
            Self::NotAValidity => write!(formatter, "`{VALID_LABEL}` is neither 0 nor 1"),
            Self::TrailingText => write!(formatter, "there is text after the last field"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// Decodes a line, with or without its end.
///
/// # Errors
///
/// Returns a [`DecodeError`] with the first field that differs from the output of [`encode`].
pub fn decode(line: &str) -> Result<Line, DecodeError> {
    let line = line.strip_suffix('\n').unwrap_or(line);
    let line = line.strip_suffix('\r').unwrap_or(line);
    let mut fields = line.split('\t');
    let mut value = |label: &'static str| {
        fields
            .next()
            .and_then(|field| field.strip_prefix(label))
            .and_then(|field| field.strip_prefix(':'))
            .ok_or(DecodeError::MissingField(label))
    };
    let mut field = |label| decimal::parse(value(label)?).ok_or(DecodeError::NotANumber(label));
    let [roll, pitch, yaw, roll_rate, pitch_rate, yaw_rate] = LABELS;
    let numbers = Line {
        roll_deg: field(roll)?,
        pitch_deg: field(pitch)?,
        yaw_deg: field(yaw)?,
        roll_rate_deg_s: field(roll_rate)?,
        pitch_rate_deg_s: field(pitch_rate)?,
        yaw_rate_deg_s: field(yaw_rate)?,
        is_valid: match value(VALID_LABEL)? {
            "0" => false,
            "1" => true,
            _ => return Err(DecodeError::NotAValidity),
        },
    };
    match fields.next() {
        None => Ok(numbers),
        Some(_) => Err(DecodeError::TrailingText),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{EulerAngles, Quaternion, Vector3};
    use crate::units::radians;

    const EXAMPLE: &str = "roll:1.00\tpitch:-2.50\tyaw:90.00\t\
                           roll_rate:0.00\tpitch_rate:0.12\tyaw_rate:-3.00\tvalid:1\n";

    fn written(snapshot: &Snapshot) -> String {
        let mut line = [0; LINE_LENGTH];
        String::from_utf8(encode(snapshot, &mut line).to_vec()).expect("ASCII")
    }

    #[test]
    fn a_snapshot_becomes_a_labelled_line() {
        let snapshot = Snapshot {
            attitude: Quaternion::from_euler(EulerAngles {
                roll_rad: radians(1.0),
                pitch_rad: radians(-2.5),
                yaw_rad: radians(90.0),
            }),
            body_rates_rad_s: Vector3::new(0.0, radians(0.12), radians(-3.0)),
            flags: Flags::VALID | Flags::POLLED,
            ..Snapshot::default()
        };
        assert_eq!(written(&snapshot), EXAMPLE);
        let degraded = Snapshot {
            flags: Flags::DEGRADED,
            ..snapshot
        };
        assert_eq!(written(&degraded), EXAMPLE.replace("valid:1", "valid:0"));
    }

    #[test]
    fn roll_and_yaw_never_read_minus_180_and_rates_may() {
        let numbers = Line {
            roll_deg: -179.999,
            pitch_deg: 0.0,
            yaw_deg: -179.999,
            roll_rate_deg_s: -180.0,
            pitch_rate_deg_s: 0.0,
            yaw_rate_deg_s: -180.0,
            is_valid: false,
        };
        let mut line = [0; LINE_LENGTH];
        let text = core::str::from_utf8(encode_line(&numbers, &mut line)).expect("ASCII");
        assert_eq!(
            text,
            "roll:180.00\tpitch:0.00\tyaw:180.00\t\
             roll_rate:-180.00\tpitch_rate:0.00\tyaw_rate:-180.00\tvalid:0\n"
        );
    }

    #[test]
    fn the_longest_line_fits_exactly() {
        let worst = f32::NEG_INFINITY;
        let numbers = Line {
            roll_deg: worst,
            pitch_deg: worst,
            yaw_deg: worst,
            roll_rate_deg_s: worst,
            pitch_rate_deg_s: worst,
            yaw_rate_deg_s: worst,
            is_valid: true,
        };
        let mut line = [0; LINE_LENGTH];
        let text = encode_line(&numbers, &mut line);
        assert_eq!(text.len(), LINE_LENGTH);
        assert_eq!(text.last(), Some(&b'\n'));
    }

    #[test]
    fn lines_are_read_with_any_line_end() {
        let expected = Line {
            roll_deg: 1.0,
            pitch_deg: -2.5,
            yaw_deg: 90.0,
            roll_rate_deg_s: 0.0,
            pitch_rate_deg_s: 0.12,
            yaw_rate_deg_s: -3.0,
            is_valid: true,
        };
        let bare = EXAMPLE.trim_end();
        assert_eq!(decode(EXAMPLE), Ok(expected));
        assert_eq!(decode(bare), Ok(expected));
        assert_eq!(decode(&format!("{bare}\r\n")), Ok(expected));
    }

    #[test]
    fn errors_name_the_field() {
        let cut = EXAMPLE.replace("\tyaw_rate:-3.00", "");
        assert_eq!(decode(&cut), Err(DecodeError::MissingField("yaw_rate")));
        let swapped = EXAMPLE.replace("pitch:", "yaw:");
        assert_eq!(decode(&swapped), Err(DecodeError::MissingField("pitch")));
        let broken = EXAMPLE.replace("90.00", "90.0");
        assert_eq!(decode(&broken), Err(DecodeError::NotANumber("yaw")));
        let unsure = EXAMPLE.replace("valid:1", "valid:2");
        assert_eq!(decode(&unsure), Err(DecodeError::NotAValidity));
        let longer = EXAMPLE.replace('\n', "\tmore:1.00\n");
        assert_eq!(decode(&longer), Err(DecodeError::TrailingText));
        assert_eq!(decode(""), Err(DecodeError::MissingField("roll")));
        assert_eq!(
            DecodeError::NotANumber("yaw").to_string(),
            "`yaw` is not a number with two decimals"
        );
    }
}
