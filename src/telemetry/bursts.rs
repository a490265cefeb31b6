//! `bursts.csv`: recorded bursts, one a line, which replay to the bit.
//!
//! ```text
//! t_us,bytes,flags
//! 1250345,0f3effc2e01c0a50ffe900130004,
//! 1252345,0f3cffc3e01a0a50ffe800130005,MISSED
//! 1262345,0f3cffc3e01a0a50ffe800130005,MISSED|BUS_FAULT|SENSOR_RESET
//! ```
//!
//! The time is that of the capture, in µs since boot. The bytes are 28 hexadecimal digits. The
//! flags, joined by `|`, go into the pipeline with the burst. `MISSED` means that samples before
//! this one were lost; the others are those of [`BoardFlags`]. Files of earlier versions have
//! `MISSED` alone.
//!
//! ```
//! use aplomb::telemetry::bursts;
//!
//! let line = "1250345,0f3effc2e01c0a50ffe900130004,MISSED";
//! let (burst, flags) = bursts::decode(line)?;
//! assert_eq!((burst.captured_at_us, burst.missed_before), (1_250_345, 1));
//! assert_eq!(bursts::Line(&burst, flags).to_string(), line);
//! # Ok::<(), bursts::DecodeError>(())
//! ```

use core::fmt;

use crate::health::BoardFlags;
use crate::mpu6050::{BURST_LENGTH, Burst};

/// First line of the file.
pub const HEADER: &str = "t_us,bytes,flags";

/// Length of the longest line without its end, in bytes: 20 digits, 28 digits, every flag and two
/// commas.
pub const LINE_LENGTH: usize = 20 + 1 + 2 * BURST_LENGTH + 1 + FLAGS_LENGTH;

/// Flags that a line can have.
const ALL_FLAGS: &str =
    "MISSED|BUS_FAULT|SENSOR_RESET|LATE|POLLED|INTERNAL_CLOCK|COMPASS_FAULT|SCALES_VERIFIED";
const FLAGS_LENGTH: usize = ALL_FLAGS.len();
const MISSED: &str = "MISSED";

/// Displays a burst and the board's flags as a line, without its end.
#[derive(Debug)]
pub struct Line<'a>(pub &'a Burst, pub BoardFlags);

impl fmt::Display for Line<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(burst, flags) = *self;
        write!(formatter, "{},", burst.captured_at_us)?;
        for byte in burst.bytes {
            write!(formatter, "{byte:02x}")?;
        }
        formatter.write_str(",")?;
        if burst.missed_before > 0 {
            let separator = if flags.is_empty() { "" } else { "|" };
            write!(formatter, "{MISSED}{separator}")?;
        }
        write!(formatter, "{flags}")
    }
}

/// Reason why a line is not a burst.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum DecodeError {
    /// The line does not have three fields.
    Fields,
    /// The first field is not a whole number of microseconds.
    Time,
    /// The second field is not 28 hexadecimal digits.
    Bytes,
    /// The third field holds a name that is no flag of a burst.
    Flags,
}

impl fmt::Display for DecodeError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fields => formatter.write_str("expected three fields: t_us,bytes,flags"),
            Self::Time => formatter.write_str("t_us is not a whole number of microseconds"),
            Self::Bytes => formatter.write_str("bytes are not 28 hexadecimal digits"),
            Self::Flags => write!(formatter, "flags are not names of {ALL_FLAGS}, joined by |"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// Decodes a line, without its end: the burst and the board's flags. `MISSED` becomes a
/// `missed_before` of 1.
///
/// # Errors
///
/// Returns a [`DecodeError`] with the first field that is not valid.
pub fn decode(line: &str) -> Result<(Burst, BoardFlags), DecodeError> {
    let mut fields = line.split(',');
    let (Some(time), Some(digits), Some(flags), None) =
        (fields.next(), fields.next(), fields.next(), fields.next())
    else {
        return Err(DecodeError::Fields);
    };
    let captured_at_us = time.parse().map_err(|_| DecodeError::Time)?;
    let mut bytes = [0; BURST_LENGTH];
    if digits.len() != 2 * BURST_LENGTH {
        return Err(DecodeError::Bytes);
    }
    for (byte, pair) in bytes.iter_mut().zip(digits.as_bytes().chunks_exact(2)) {
        *byte = pair
            .iter()
            .try_fold(0, |value, &digit| {
                let nibble = char::from(digit).to_digit(16)? as u8;
                Some(value << 4 | nibble)
            })
            .ok_or(DecodeError::Bytes)?;
    }
    let mut burst = Burst {
        bytes,
        captured_at_us,
        missed_before: 0,
    };
    let mut board = BoardFlags::empty();
    for name in flags.split('|').filter(|_| !flags.is_empty()) {
        if name == MISSED {
            burst.missed_before = 1;
        } else {
            board |= BoardFlags::from_name(name).ok_or(DecodeError::Flags)?;
        }
    }
    Ok((burst, board))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_burst_survives_its_line(
            bytes: [u8; BURST_LENGTH],
            captured_at_us: u64,
            missed_before in 0..2_u8,
            bits: u32,
        ) {
            let burst = Burst { bytes, captured_at_us, missed_before };
            let flags = BoardFlags::from_bits_truncate(bits);
            let line = Line(&burst, flags).to_string();
            prop_assert!(line.len() <= LINE_LENGTH);
            prop_assert_eq!(decode(&line), Ok((burst, flags)));
        }

        #[test]
        fn any_text_is_a_burst_or_an_error(
            text in "[0-9a-f,MISED|LAT+ é-]{0,60}|\
                     [0-9]{1,21},[0-9a-fA-F]{28},((MISSED|LATE|POLLED|VALID|x)[|]?){0,3}",
        ) {
            if let Ok((burst, flags)) = decode(&text) {
                prop_assert_eq!(decode(&Line(&burst, flags).to_string()), Ok((burst, flags)));
            }
        }
    }

    #[test]
    fn each_error_is_named() {
        let digits = "00".repeat(BURST_LENGTH);
        assert_eq!(decode(&format!("7,{digits}")), Err(DecodeError::Fields));
        assert_eq!(decode(&format!("x,{digits},")), Err(DecodeError::Time));
        assert_eq!(decode(&format!("7,{digits}00,")), Err(DecodeError::Bytes));
        let sign = digits.replacen("00", "+1", 1);
        assert_eq!(decode(&format!("7,{sign},")), Err(DecodeError::Bytes));
        // Flags that the pipeline sets by itself are no flags of a burst.
        for flags in ["x", "VALID", "MISSED|GAP", "|", "MISSED|"] {
            let line = format!("7,{digits},{flags}");
            assert_eq!(decode(&line), Err(DecodeError::Flags), "{flags}");
        }
        assert!(DecodeError::Flags.to_string().contains("MISSED|BUS_FAULT"));
    }

    #[test]
    fn the_longest_line_has_every_flag() {
        let burst = Burst {
            bytes: [0; BURST_LENGTH],
            captured_at_us: u64::MAX,
            missed_before: 1,
        };
        let line = Line(&burst, BoardFlags::all()).to_string();
        assert_eq!(line.len(), LINE_LENGTH);
    }

    #[test]
    fn lines_of_earlier_versions_are_read() {
        let line = |flags| format!("1250345,0f3effc2e01c0a50ffe900130004,{flags}");
        for (flags, missed_before) in [("", 0), ("MISSED", 1)] {
            let (burst, of_board) = decode(&line(flags)).expect("a burst");
            assert_eq!(
                (burst.missed_before, of_board),
                (missed_before, BoardFlags::empty())
            );
        }
    }
}
