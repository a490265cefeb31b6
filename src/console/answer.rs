//! Answers of the console: lines with a first word for programs, and the rest for people.
//!
//! The console writes a line to where it is sent from, so that none is ever copied.
//!
//! ```
//! use aplomb::console::answer::Kind;
//!
//! let answer = "ok rate 100";
//! assert!(answer.starts_with(Kind::Ok.name()));
//! ```

use core::fmt::{self, Write};

use crate::attitude::Vector3;

/// Length of the longest answer without its line end, in bytes: 19 pieces of a MAVLink text.
pub const ANSWER_CAPACITY: usize = 949;

/// Kind of an answer: its first word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Kind {
    /// `ok`: the command is done or has begun.
    Ok,
    /// `error`: the command is unknown or was refused; nothing has changed.
    Error,
    /// `progress`: a procedure has advanced.
    Progress,
    /// `done`: a job or procedure has succeeded.
    Done,
    /// `failed`: a job or procedure has failed; nothing has changed.
    Failed,
}

impl Kind {
    /// Returns the word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Error => "error",
            Self::Progress => "progress",
            Self::Done => "done",
            Self::Failed => "failed",
        }
    }
}

/// Writer of one answer.
pub(super) struct Reply<'a>(pub(super) &'a mut dyn Write);

impl Reply<'_> {
    /// Writes an answer of this kind, and returns the kind.
    #[inline(never)]
    pub(super) fn write(&mut self, kind: Kind, arguments: fmt::Arguments<'_>) -> Kind {
        // Tests hold the longest answers to their capacity; a longer one would be cut.
        write!(self.0, "{} {arguments}", kind.name()).ok();
        kind
    }

    /// Writes an answer of kind [`Kind::Ok`].
    pub(super) fn ok(&mut self, arguments: fmt::Arguments<'_>) -> Kind {
        self.write(Kind::Ok, arguments)
    }

    /// Writes an answer of kind [`Kind::Error`].
    pub(super) fn error(&mut self, arguments: fmt::Arguments<'_>) -> Kind {
        self.write(Kind::Error, arguments)
    }
}

/// Number with this many decimals (6 at most). Avoids the floating-point formatting of `core`,
/// which would take half of the firmware.
#[derive(Clone, Copy)]
pub(super) struct Decimal(pub(super) f32, pub(super) u32);

impl fmt::Display for Decimal {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.0;
        let decimals = self.1.min(6);
        if value.is_nan() {
            return formatter.write_str("nan");
        }
        let unit = 10_u32.saturating_pow(decimals);
        // The conversion saturates.
        let rounded = (value.abs() * unit as f32 + 0.5) as u32;
        let sign = if value < 0.0 && rounded > 0 { "-" } else { "" };
        let whole = rounded.checked_div(unit).unwrap_or_default();
        let rest = rounded.checked_rem(unit).unwrap_or_default();
        if unit == 1 {
            return write!(formatter, "{sign}{whole}");
        }
        write!(
            formatter,
            "{sign}{whole}.{rest:0width$}",
            width = decimals as usize
        )
    }
}

/// Three numbers, separated by commas, with this many decimals.
#[derive(Clone, Copy)]
pub(super) struct Triple(pub(super) Vector3, pub(super) u32);

impl fmt::Display for Triple {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(Vector3 { x, y, z }, decimals) = *self;
        let number = |value| Decimal(value, decimals);
        write!(formatter, "{},{},{}", number(x), number(y), number(z))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn numbers_have_their_decimals() {
        for (value, decimals, text) in [
            (0.0, 2, "0.00"),
            (-0.0, 2, "0.00"),
            (-0.004, 2, "0.00"),
            (-0.006, 2, "-0.01"),
            (12.345, 1, "12.3"),
            (0.99996, 4, "1.0000"),
            (36.6, 0, "37"),
            (f32::NAN, 2, "nan"),
            (f32::NEG_INFINITY, 2, "-42949672.95"),
        ] {
            assert_eq!(Decimal(value, decimals).to_string(), text);
        }
        assert_eq!(
            Triple(Vector3::new(1.0, -2.5, 0.0), 1).to_string(),
            "1.0,-2.5,0.0"
        );
    }

    proptest! {
        /// The oracle is the standard library's formatting; halves may round either way.
        #[test]
        fn numbers_are_read_back(value in -2000.0_f32..2000.0, decimals in 0_u32..5) {
            let read: f64 = Decimal(value, decimals).to_string().parse().expect("a number");
            let half = 0.5 * 0.1_f64.powi(decimals as i32);
            prop_assert!((read - f64::from(value)).abs() <= half + 1e-4);
        }
    }
}
