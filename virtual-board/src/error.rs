//! Reasons for which a run could not be made.

use std::fmt::Display;
use std::path::PathBuf;

use thiserror::Error;

/// Reason for which a run could not be made.
#[derive(Debug, Error)]
pub enum Error {
    /// The firmware image cannot be used.
    #[error("{path}: {1}", path = .0.display())]
    Firmware(PathBuf, String),
    /// A file of commands cannot be read, or has a line that is none.
    #[error("{path}: {1}", path = .0.display())]
    Script(PathBuf, String),
    /// The emulator gave up.
    #[error("the emulator: {0}")]
    Emulator(String),
    /// A file cannot be written.
    #[error("{path}: {1}", path = .0.display())]
    Output(PathBuf, String),
}

impl Error {
    /// An error of the emulator's.
    pub(crate) fn emulator(cause: impl Display) -> Self {
        Self::Emulator(cause.to_string())
    }
}
