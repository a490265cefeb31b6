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
//! this one were lost, and `ARMED` that the filter was armed. The others are those of
//! [`BoardFlags`]. Files of earlier versions have `MISSED` alone, or no `ARMED`.
//!
//! ```
//! use aplomb::mpu6050::Part;
//! use aplomb::pipeline::{Pipeline, Settings};
//! use aplomb::telemetry::bursts;
//!
//! let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
//! let line = "1250345,0f3effc2e01c0a50ffe900130004,MISSED|ARMED";
//! let row = bursts::decode(line)?;
//! assert_eq!((row.burst.captured_at_us, row.burst.missed_before), (1_250_345, 1));
//! assert_eq!(row.to_string(), line);
//! pipeline.set_armed(row.is_armed);
//! let snapshot = pipeline.update(&row.burst, row.board);
//! assert_eq!(snapshot.t_us, 1_250_345);
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
    "MISSED|ARMED|BUS_FAULT|SENSOR_RESET|LATE|POLLED|INTERNAL_CLOCK|COMPASS_FAULT|SCALES_VERIFIED";
const FLAGS_LENGTH: usize = ALL_FLAGS.len();
const MISSED: &str = "MISSED";
const ARMED: &str = "ARMED";

/// Row of the file. Its text is the line, without its end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Row {
    /// Burst.
    pub burst: Burst,
    /// Conditions of the board.
    pub board: BoardFlags,
    /// True if the filter was armed: pass it to
    /// [`Pipeline::set_armed`](crate::pipeline::Pipeline::set_armed) before the burst.
    pub is_armed: bool,
}

impl fmt::Display for Row {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{},", self.burst.captured_at_us)?;
        for byte in self.burst.bytes {
            write!(formatter, "{byte:02x}")?;
        }
        let mut separator = ",";
        let own = [
            (MISSED, self.burst.missed_before > 0),
            (ARMED, self.is_armed),
        ];
        for (name, _) in own.iter().filter(|(_, is_set)| *is_set) {
            write!(formatter, "{separator}{name}")?;
            separator = "|";
        }
        if self.board.is_empty() && separator == "|" {
            return Ok(());
        }
        write!(formatter, "{separator}{}", self.board)
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

/// Decodes a line, without its end. `MISSED` becomes a `missed_before` of 1.
///
/// # Errors
///
/// Returns a [`DecodeError`] with the first field that is not valid.
pub fn decode(line: &str) -> Result<Row, DecodeError> {
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
    let mut row = Row {
        burst: Burst {
            bytes,
            captured_at_us,
            missed_before: 0,
        },
        board: BoardFlags::empty(),
        is_armed: false,
    };
    for name in flags.split('|').filter(|_| !flags.is_empty()) {
        match name {
            MISSED => row.burst.missed_before = 1,
            ARMED => row.is_armed = true,
            _ => row.board |= BoardFlags::from_name(name).ok_or(DecodeError::Flags)?,
        }
    }
    Ok(row)
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
            is_armed: bool,
        ) {
            let burst = Burst { bytes, captured_at_us, missed_before };
            let board = BoardFlags::from_bits_truncate(bits);
            let row = Row { burst, board, is_armed };
            let line = row.to_string();
            prop_assert!(line.len() <= LINE_LENGTH);
            prop_assert_eq!(decode(&line), Ok(row));
        }

        #[test]
        fn any_text_is_a_burst_or_an_error(
            text in "[0-9a-f,MISED|LAT+ é-]{0,60}|\
                     [0-9]{1,21},[0-9a-fA-F]{28},((MISSED|ARMED|LATE|POLLED|VALID|x)[|]?){0,3}",
        ) {
            if let Ok(row) = decode(&text) {
                prop_assert_eq!(decode(&row.to_string()), Ok(row));
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
        assert!(
            DecodeError::Flags
                .to_string()
                .contains("MISSED|ARMED|BUS_FAULT")
        );
    }

    #[test]
    fn the_longest_line_has_every_flag() {
        let burst = Burst {
            bytes: [0; BURST_LENGTH],
            captured_at_us: u64::MAX,
            missed_before: 1,
        };
        let row = Row {
            burst,
            board: BoardFlags::all(),
            is_armed: true,
        };
        assert_eq!(row.to_string().len(), LINE_LENGTH);
    }

    #[test]
    fn lines_of_earlier_versions_are_read() {
        let line = |flags| format!("1250345,0f3effc2e01c0a50ffe900130004,{flags}");
        for (flags, missed_before) in [("", 0), ("MISSED", 1)] {
            let row = decode(&line(flags)).expect("a burst");
            assert_eq!(
                (row.burst.missed_before, row.board, row.is_armed),
                (missed_before, BoardFlags::empty(), false)
            );
        }
    }
}
