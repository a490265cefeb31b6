//! `bursts.csv`: what the bus delivered, one burst a line, to replay to the bit.
//!
//! ```text
//! t_us,bytes,flags
//! 1250345,0f3effc2e01c0a50ffe900130004,
//! 1252345,0f3cffc3e01a0a50ffe800130005,MISSED
//! ```
//!
//! The time is that of the capture in microseconds since boot, the bytes are 28 hexadecimal digits,
//! and the flag `MISSED` says that data-ready edges before this burst gave none.

use core::fmt;

use crate::mpu6050::{BURST_LENGTH, Burst};

/// The first line of the file.
pub const HEADER: &str = "t_us,bytes,flags";

/// The longest line, without its end: 20 digits, 28 digits, the flag and two commas.
pub const LINE_LENGTH: usize = 20 + 1 + 2 * BURST_LENGTH + 1 + MISSED.len();

const MISSED: &str = "MISSED";

/// Displays a burst as its line, without its end.
pub struct Line<'a>(pub &'a Burst);

impl fmt::Display for Line<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{},", self.0.captured_at_us)?;
        for byte in self.0.bytes {
            write!(formatter, "{byte:02x}")?;
        }
        formatter.write_str(",")?;
        if self.0.missed_before > 0 {
            formatter.write_str(MISSED)?;
        }
        Ok(())
    }
}

/// Why a line is not a burst.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum DecodeError {
    /// There are not three fields.
    Fields,
    /// The first field is not a whole number of microseconds.
    Time,
    /// The second field is not 28 hexadecimal digits.
    Bytes,
    /// The third field is neither empty nor `MISSED`.
    Flags,
}

impl fmt::Display for DecodeError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Fields => "expected three fields: t_us,bytes,flags",
            Self::Time => "t_us is not a whole number of microseconds",
            Self::Bytes => "bytes are not 28 hexadecimal digits",
            Self::Flags => "flags are neither empty nor MISSED",
        })
    }
}

impl core::error::Error for DecodeError {}

/// Reads a line, without its end. `missed_before` becomes 1 where the flag is set.
pub fn decode(line: &str) -> Result<Burst, DecodeError> {
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
    let missed_before = match flags {
        "" => 0,
        MISSED => 1,
        _ => return Err(DecodeError::Flags),
    };
    Ok(Burst {
        bytes,
        captured_at_us,
        missed_before,
    })
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
        ) {
            let burst = Burst { bytes, captured_at_us, missed_before };
            let line = Line(&burst).to_string();
            prop_assert!(line.len() <= LINE_LENGTH);
            prop_assert_eq!(decode(&line), Ok(burst));
        }

        #[test]
        fn any_text_is_a_burst_or_an_error(text in "[0-9a-f,MISED+ é-]{0,60}") {
            if let Ok(burst) = decode(&text) {
                prop_assert_eq!(decode(&Line(&burst).to_string()), Ok(burst));
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
        assert_eq!(decode(&format!("7,{digits},x")), Err(DecodeError::Flags));
    }
}
