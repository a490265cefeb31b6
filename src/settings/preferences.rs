//! Preferences of the outputs: format, rate and baud rate.

use core::fmt;
use core::str::FromStr;

/// Preferences of the outputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Preferences {
    /// Telemetry format. Default: text.
    pub format: OutputFormat,
    /// Attitudes per second, 1 to 1000. Default: 50.
    pub rate_hz: u16,
    /// Bits per second on the UART: one of the console's `BAUD_RATES`. Default: 115,200.
    pub baud: u32,
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            format: OutputFormat::Text,
            rate_hz: 50,
            baud: 115_200,
        }
    }
}

/// Telemetry format. Its text is its [`name`](Self::name).
///
/// ```
/// use aplomb::settings::OutputFormat;
///
/// assert_eq!("mavlink".parse(), Ok(OutputFormat::Mavlink));
/// assert_eq!(OutputFormat::Log.to_string(), "log");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum OutputFormat {
    /// Labelled text.
    #[default]
    Text,
    /// Line of the classic tutorial.
    Classic,
    /// Lines for Teleplot.
    Teleplot,
    /// Packet of the teapot demo.
    Teapot,
    /// MAVLink 2.
    Mavlink,
    /// Flight log.
    Log,
}

impl OutputFormat {
    /// Every format. Flash and MAVLink hold the index in this array, so a new format comes last.
    pub const ALL: [Self; 6] = [
        Self::Text,
        Self::Classic,
        Self::Teleplot,
        Self::Teapot,
        Self::Mavlink,
        Self::Log,
    ];

    /// Names of the formats, in the order of [`ALL`](Self::ALL).
    pub const NAMES: [&str; 6] = ["text", "classic", "teleplot", "teapot", "mavlink", "log"];

    /// Returns the name, as the command `format` takes it.
    #[inline(never)]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Classic => "classic",
            Self::Teleplot => "teleplot",
            Self::Teapot => "teapot",
            Self::Mavlink => "mavlink",
            Self::Log => "log",
        }
    }
}

impl fmt::Display for OutputFormat {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl FromStr for OutputFormat {
    type Err = ParseOutputFormatError;

    /// Parses a name.
    fn from_str(name: &str) -> Result<Self, ParseOutputFormatError> {
        Self::ALL
            .into_iter()
            .find(|format| format.name() == name)
            .ok_or(ParseOutputFormatError(()))
    }
}

/// Text that names no [`OutputFormat`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParseOutputFormatError(());

impl fmt::Display for ParseOutputFormatError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("the formats are")?;
        let mut separator = " ";
        for name in OutputFormat::NAMES {
            write!(formatter, "{separator}{name}")?;
            separator = ", ";
        }
        Ok(())
    }
}

impl core::error::Error for ParseOutputFormatError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_format_is_read_back_from_its_name() {
        for (format, name) in OutputFormat::ALL.into_iter().zip(OutputFormat::NAMES) {
            assert_eq!(format.to_string(), name);
            assert_eq!(name.parse(), Ok(format));
        }
        for text in ["", "Text", "text ", "csv"] {
            let error = text.parse::<OutputFormat>().expect_err(text);
            assert_eq!(
                error.to_string(),
                "the formats are text, classic, teleplot, teapot, mavlink, log"
            );
        }
    }
}
