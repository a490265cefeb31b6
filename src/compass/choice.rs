//! Choice of the compass: found by itself, named, or none.

use core::fmt;
use core::str::FromStr;

use super::part_id::PartId;

/// Choice of the compass. Its text is the word that a command takes.
///
/// ```
/// use aplomb::compass::{Choice, PartId};
///
/// assert_eq!("qmc5883l".parse(), Ok(Choice::Named(PartId::Qmc5883l)));
/// assert_eq!(Choice::Auto.to_string(), "auto");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Choice {
    /// The first part that answers, if there is one.
    #[default]
    Auto,
    /// None.
    Off,
    /// The named part, and no other.
    Named(PartId),
}

impl Choice {
    /// Every choice. A stored record holds the index in this array.
    pub const ALL: [Self; 6] = [
        Self::Auto,
        Self::Off,
        Self::Named(PartId::Ak8963),
        Self::Named(PartId::Qmc5883l),
        Self::Named(PartId::Qmc5883p),
        Self::Named(PartId::Hmc5883l),
    ];

    /// Words of every choice.
    pub const WORDS: [&str; 6] = {
        let mut words = [""; 6];
        let mut index = 0;
        while index < words.len() {
            words[index] = Self::ALL[index].word();
            index += 1;
        }
        words
    };

    /// Returns the word.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Off => "off",
            Self::Named(part) => part.word(),
        }
    }

    /// Parses a word, also in constants.
    pub const fn parse(word: &str) -> Option<Self> {
        let mut index = 0;
        while index < Self::ALL.len() {
            if is_same(word.as_bytes(), Self::WORDS[index].as_bytes()) {
                return Some(Self::ALL[index]);
            }
            index += 1;
        }
        None
    }

    /// Returns whether the search may take this part.
    pub(super) fn takes(self, part: PartId) -> bool {
        match self {
            Self::Auto => true,
            Self::Off => false,
            Self::Named(named) => named == part,
        }
    }
}

const fn is_same(mut a: &[u8], mut b: &[u8]) -> bool {
    while let ([first, rest @ ..], [other, others @ ..]) = (a, b) {
        if *first != *other {
            return false;
        }
        (a, b) = (rest, others);
    }
    a.is_empty() && b.is_empty()
}

impl fmt::Display for Choice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.word())
    }
}

impl FromStr for Choice {
    type Err = ParseChoiceError;

    fn from_str(word: &str) -> Result<Self, ParseChoiceError> {
        Self::parse(word).ok_or(ParseChoiceError(()))
    }
}

/// Text that names no [`Choice`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParseChoiceError(());

impl fmt::Display for ParseChoiceError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a compass is auto, off, ak8963, qmc5883l, qmc5883p or hmc5883l")
    }
}

impl core::error::Error for ParseChoiceError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_is_read_back_from_its_word() {
        for choice in Choice::ALL {
            assert_eq!(choice.to_string().parse(), Ok(choice));
        }
        for part in PartId::ALL {
            assert!(Choice::ALL.contains(&Choice::Named(part)));
            assert!(Choice::Auto.takes(part) && !Choice::Off.takes(part));
        }
        for word in ["", "on", "AUTO", "auto ", "ak896", "ak89633"] {
            let error = word.parse::<Choice>().expect_err(word);
            assert!(error.to_string().contains("qmc5883p"), "{error}");
        }
    }
}
