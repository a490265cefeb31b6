//! Wrong usage, which ends the program with another exit code than a failure.

use std::error::Error;
use std::fmt;

/// Wrong usage: options that contradict each other, or that mean nothing for the input.
#[derive(Debug, PartialEq, Eq)]
pub struct Usage(String);

impl From<String> for Usage {
    fn from(reason: String) -> Self {
        Self(reason)
    }
}

impl From<&str> for Usage {
    fn from(reason: &str) -> Self {
        Self(reason.to_owned())
    }
}

impl fmt::Display for Usage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl Error for Usage {}
