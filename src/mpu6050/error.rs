//! Errors of the driver, with the remedy in their text.

use core::fmt;

use embedded_hal::i2c::{self, ErrorKind, ErrorType, NoAcknowledgeSource};

use super::part::PARTS;
use super::registers::{ADDRESSES, Register};

/// Reason why no sensor was found, with the bus for another try.
pub struct ProbeFailure<I2C: ErrorType> {
    /// Bus.
    pub i2c: I2C,
    /// Reason.
    pub error: Error<I2C::Error>,
}

impl<I2C: ErrorType> fmt::Debug for ProbeFailure<I2C> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.error, formatter)
    }
}

impl<I2C: ErrorType> fmt::Display for ProbeFailure<I2C> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.error, formatter)
    }
}

impl<I2C: ErrorType> core::error::Error for ProbeFailure<I2C> {}

/// Purpose of a bus transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Operation {
    /// Read of a register, or of several from it on.
    Read,
    /// Write of a register.
    Write,
}

impl Operation {
    const fn name(self) -> &'static str {
        match self {
            Self::Read => "reading",
            Self::Write => "writing",
        }
    }
}

/// Error of the driver. Its text names the place and the remedy.
///
/// ```
/// use aplomb::mpu6050::Error;
///
/// let error: Error<embedded_hal::i2c::ErrorKind> = Error::NotFound;
/// assert!(error.to_string().ends_with("check VCC, GND, SCL, SDA and the pull-ups"));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Error<E> {
    /// No chip acknowledged either address.
    NotFound,
    /// A chip answered whose identity is not in [`PARTS`].
    UnknownIdentity {
        /// Bus address of the chip.
        address: u8,
        /// Value of its WHO_AM_I register.
        who_am_i: u8,
    },
    /// PWR_MGMT_1 did not have its reset value 100 ms after the reset.
    ResetFailed {
        /// Address of the sensor.
        address: u8,
        /// Value of PWR_MGMT_1.
        read: u8,
    },
    /// A register did not keep the value that was written to it.
    Readback {
        /// Address of the sensor.
        address: u8,
        /// Register.
        register: Register,
        /// Value written.
        written: u8,
        /// Value read back.
        read: u8,
    },
    /// A transfer failed.
    Bus {
        /// Purpose of the transfer.
        operation: Operation,
        /// First register of the transfer.
        register: Register,
        /// Address of the sensor.
        address: u8,
        /// Error of the bus.
        source: E,
    },
}

impl<E: i2c::Error> fmt::Display for Error<E> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFound => {
                let [low, high] = ADDRESSES;
                write!(
                    formatter,
                    "no sensor answers at 0x{low:02x} or 0x{high:02x}: check VCC, GND, SCL, SDA \
                     and the pull-ups"
                )
            }
            Self::UnknownIdentity { address, who_am_i } => {
                write!(
                    formatter,
                    "the chip at 0x{address:02x} has WHO_AM_I 0x{who_am_i:02x}, which is none of"
                )?;
                for part in &PARTS {
                    write!(formatter, " 0x{:02x}", part.who_am_i)?;
                }
                write!(formatter, ": not a supported sensor")
            }
            Self::ResetFailed { address, read } => write!(
                formatter,
                "the sensor at 0x{address:02x} did not reset: PWR_MGMT_1 (0x6b) reads \
                 0x{read:02x}: switch its power off and on"
            ),
            Self::Readback {
                address,
                register,
                written,
                read,
            } => write!(
                formatter,
                "the sensor at 0x{address:02x} did not keep {} (0x{:02x}): wrote 0x{written:02x}, \
                 read 0x{read:02x}: check the supply and the wiring",
                register.name(),
                register.address()
            ),
            Self::Bus {
                operation,
                register,
                address,
                source,
            } => write!(
                formatter,
                "{} {} (0x{:02x}) at 0x{address:02x} failed: {}: check the wiring",
                operation.name(),
                register.name(),
                register.address(),
                reason(source.kind())
            ),
        }
    }
}

impl<E: i2c::Error> core::error::Error for Error<E> {}

/// Returns the reason of a failed transfer, as a part of a sentence.
const fn reason(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::Bus => "bus error",
        ErrorKind::ArbitrationLoss => "arbitration lost",
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address) => "address not acknowledged",
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data) => "data not acknowledged",
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown) => "not acknowledged",
        ErrorKind::Overrun => "overrun",
        _ => "no response in time, or another error",
    }
}

#[cfg(feature = "defmt")]
impl<E: i2c::Error> defmt::Format for Error<E> {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        // Every output has the same words, which costs their formatting on the target.
        defmt::write!(formatter, "{}", defmt::Display2Format(self));
    }
}

#[cfg(feature = "defmt")]
impl<I2C: ErrorType> defmt::Format for ProbeFailure<I2C> {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        defmt::Format::format(&self.error, formatter);
    }
}
