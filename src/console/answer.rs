//! What the console says: one line each, with a first word for programs and the rest for people.
//!
//! Lines are written where they are sent from, so that none is ever copied.

use core::fmt::{self, Write};

use crate::attitude::Vector3;

/// Room for the longest answer, its line end not counted, in bytes.
pub const ANSWER_CAPACITY: usize = 608;

/// The first word of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Kind {
    /// `ok`: the command was understood and is done, or has begun.
    Ok,
    /// `error`: the command was not understood or refused; nothing has changed.
    Error,
    /// `progress`: how something that takes its time goes on.
    Progress,
    /// `done`: it has ended as it should.
    Done,
    /// `failed`: it has ended otherwise; nothing has changed.
    Failed,
}

impl Kind {
    /// The word.
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

/// Where answers are written, one line at a time.
pub(super) struct Reply<'a>(pub(super) &'a mut dyn Write);

impl Reply<'_> {
    /// Writes an answer of this kind, and gives the kind back.
    #[inline(never)]
    pub(super) fn say(&mut self, kind: Kind, arguments: fmt::Arguments<'_>) -> Kind {
        // Tests hold the longest answers to their room; what does not fit is left out.
        write!(self.0, "{} {arguments}", kind.name()).ok();
        kind
    }

    pub(super) fn ok(&mut self, arguments: fmt::Arguments<'_>) -> Kind {
        self.say(Kind::Ok, arguments)
    }

    pub(super) fn error(&mut self, arguments: fmt::Arguments<'_>) -> Kind {
        self.say(Kind::Error, arguments)
    }
}

/// A number with so many decimals, without the formatting of floating-point numbers, which would be half of the image.
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

/// Three numbers, separated by commas, with so many decimals.
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
