//! Finding and configuring the sensor over a blocking `embedded-hal` bus.
//!
//! Two steps: [`Mpu6050::probe`] finds out who is there, [`Mpu6050::configure`] resets it, wakes it
//! and sets it up; the interrupt is enabled by its very last write, so no data-ready edge comes
//! from a half-configured sensor. Every setting is read back and compared. Together the two take
//! about 230 ms, nearly all of it waiting as the datasheet asks; a deadline on each bus transfer is
//! the bus's own business.

use core::fmt;

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{Error as _, ErrorKind, ErrorType, I2c};

use super::burst::{BURST_LENGTH, Burst};
use super::config::Config;
use super::part::{PARTS, Part};
use super::registers::{
    ACCELEROMETER_LOW_PASS_MASK, FULL_SCALE_MASK, FULL_SCALE_SHIFT, INTERRUPT_ACTIVE_HIGH_PULSE,
    INTERRUPT_DATA_READY, LOW_PASS_MASK, POWER_AWAKE_GYROSCOPE_CLOCK, POWER_AWAKE_INTERNAL_CLOCK,
    POWER_DEVICE_RESET, Register, SIGNAL_PATH_RESET_ALL,
};

/// The two bus addresses, with the AD0 pin low and high (product specification §9.2).
pub const ADDRESSES: [u8; 2] = [0x68, 0x69];

/// Register access may take this long after power-up (product specification §6.3): ten looks, 10 ms
/// apart, cover it.
const POWER_UP_LOOKS: u32 = 10;
const POWER_UP_INTERVAL_MS: u32 = 10;
/// Wait after a device reset and after a signal path reset (register map §4.28).
const RESET_MS: u32 = 100;
/// The gyroscope's zero-rate output settles in this time (product specification §6.1).
const ZERO_RATE_SETTLING_MS: u32 = 30;

/// A sensor that was found, and the bus it sits on.
#[derive(Debug)]
pub struct Mpu6050<I2C> {
    i2c: I2C,
    address: u8,
    part: &'static Part,
}

impl<I2C: I2c> Mpu6050<I2C> {
    /// Looks for a known part at both addresses.
    ///
    /// Tries for 100 ms, because the sensor may have been powered up together with the processor.
    /// Something unknown at the first address (a clock chip may sit there) does not hide a sensor
    /// at the second.
    ///
    /// # Errors
    ///
    /// [`Error::NotFound`] if nobody answers, [`Error::UnknownIdentity`] if somebody else does,
    /// [`Error::Bus`] if the bus itself fails. The failure gives the bus back.
    pub fn probe(mut i2c: I2C, delay: &mut impl DelayNs) -> Result<Self, ProbeFailure<I2C>> {
        for look in 0..POWER_UP_LOOKS {
            if look > 0 {
                delay.delay_ms(POWER_UP_INTERVAL_MS);
            }
            match look_once(&mut i2c) {
                Ok(Some((address, part))) => return Ok(Self { i2c, address, part }),
                Ok(None) => {}
                Err(error) => return Err(ProbeFailure { i2c, error }),
            }
        }
        let error = Error::NotFound;
        Err(ProbeFailure { i2c, error })
    }

    /// Resets the sensor and sets it up; data-ready pulses begin as it returns.
    ///
    /// The sequence is the datasheet's: reset, 100 ms, verify; wake, reset the signal paths, 100 ms;
    /// clock from the gyroscope, 30 ms for its zero-rate output to settle; then the settings, and
    /// the data-ready interrupt last. It may be called again at any time.
    ///
    /// # Errors
    ///
    /// [`Error::ResetFailed`], [`Error::Readback`] or [`Error::Bus`]. The sensor is then in no
    /// particular state; calling this again starts over.
    pub fn configure(
        &mut self,
        config: &Config,
        delay: &mut impl DelayNs,
    ) -> Result<(), Error<I2C::Error>> {
        self.reset_and_wake(delay)?;
        self.set(Register::SampleRateDivider, config.sample_rate_divider)?;
        let low_pass = config.low_pass.bits();
        self.modify(Register::Configuration, LOW_PASS_MASK, low_pass)?;
        self.modify(
            Register::GyroscopeConfiguration,
            FULL_SCALE_MASK,
            config.gyroscope_range.bits() << FULL_SCALE_SHIFT,
        )?;
        self.modify(
            Register::AccelerometerConfiguration,
            FULL_SCALE_MASK,
            config.accelerometer_range.bits() << FULL_SCALE_SHIFT,
        )?;
        if self.part.has_accelerometer_low_pass {
            self.modify(
                Register::AccelerometerConfiguration2,
                ACCELEROMETER_LOW_PASS_MASK,
                low_pass,
            )?;
        }
        self.set(
            Register::InterruptPinConfiguration,
            INTERRUPT_ACTIVE_HIGH_PULSE,
        )?;
        self.set(Register::InterruptEnable, INTERRUPT_DATA_READY)
    }

    /// Reads one sample, blocking; for processors whose burst reads need no DMA.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`] if the transfer fails.
    pub fn read_burst(&mut self, captured_at_us: u64) -> Result<Burst, Error<I2C::Error>> {
        let mut bytes = [0; BURST_LENGTH];
        read(
            &mut self.i2c,
            self.address,
            Register::AccelerometerXHigh,
            &mut bytes,
        )?;
        Ok(Burst {
            bytes,
            captured_at_us,
            missed_before: 0,
        })
    }

    /// The part that answered.
    pub const fn part(&self) -> &'static Part {
        self.part
    }

    /// The address it answered at.
    pub const fn address(&self) -> u8 {
        self.address
    }

    /// Gives the bus back.
    pub fn release(self) -> I2C {
        self.i2c
    }

    fn reset_and_wake(&mut self, delay: &mut impl DelayNs) -> Result<(), Error<I2C::Error>> {
        self.write(Register::PowerManagement1, POWER_DEVICE_RESET)?;
        delay.delay_ms(RESET_MS);
        let read = self.read(Register::PowerManagement1)?;
        if !self.part.power_after_reset.contains(&read) {
            return Err(Error::ResetFailed {
                address: self.address,
                read,
            });
        }
        self.set(Register::PowerManagement1, POWER_AWAKE_INTERNAL_CLOCK)?;
        // This one reads back as zero by definition, so there is nothing to compare.
        self.write(Register::SignalPathReset, SIGNAL_PATH_RESET_ALL)?;
        delay.delay_ms(RESET_MS);
        self.set(Register::PowerManagement1, POWER_AWAKE_GYROSCOPE_CLOCK)?;
        delay.delay_ms(ZERO_RATE_SETTLING_MS);
        Ok(())
    }

    /// Replaces the bits of `mask`, keeps the others, and compares.
    fn modify(&mut self, register: Register, mask: u8, bits: u8) -> Result<(), Error<I2C::Error>> {
        let kept = self.read(register)? & !mask;
        self.set(register, kept | (bits & mask))
    }

    /// Writes a register, reads it back and compares.
    fn set(&mut self, register: Register, written: u8) -> Result<(), Error<I2C::Error>> {
        self.write(register, written)?;
        let read = self.read(register)?;
        if read == written {
            return Ok(());
        }
        Err(Error::Readback {
            address: self.address,
            register,
            written,
            read,
        })
    }

    fn write(&mut self, register: Register, value: u8) -> Result<(), Error<I2C::Error>> {
        self.i2c
            .write(self.address, &[register.address(), value])
            .map_err(|source| Error::Bus {
                operation: Operation::Write,
                register,
                address: self.address,
                source,
            })
    }

    fn read(&mut self, register: Register) -> Result<u8, Error<I2C::Error>> {
        read_byte(&mut self.i2c, self.address, register)
    }
}

/// Why no sensor was found, with the bus for another try.
pub struct ProbeFailure<I2C: ErrorType> {
    /// The bus.
    pub i2c: I2C,
    /// The reason.
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

/// What a bus transfer was for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Operation {
    /// Reading a register, or several from it on.
    Read,
    /// Writing a register.
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

/// What went wrong, where, and (in its text) what to do about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<E> {
    /// Nobody acknowledged either address.
    NotFound,
    /// Somebody answered whose identity is not in [`PARTS`].
    UnknownIdentity {
        /// Where it answered.
        address: u8,
        /// What its WHO_AM_I register holds.
        who_am_i: u8,
    },
    /// PWR_MGMT_1 had no value that a reset leaves, 100 ms after the reset.
    ResetFailed {
        /// The sensor's address.
        address: u8,
        /// What PWR_MGMT_1 held.
        read: u8,
    },
    /// A register did not keep what was written to it.
    Readback {
        /// The sensor's address.
        address: u8,
        /// The register.
        register: Register,
        /// The value written.
        written: u8,
        /// The value read back.
        read: u8,
    },
    /// A transfer failed.
    Bus {
        /// What the transfer was for.
        operation: Operation,
        /// The register it was about.
        register: Register,
        /// The address it went to.
        address: u8,
        /// The bus's own error.
        source: E,
    },
}

impl<E: fmt::Debug> fmt::Display for Error<E> {
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
                "{} {} (0x{:02x}) at 0x{address:02x} failed: {source:?}: check the wiring",
                operation.name(),
                register.name(),
                register.address()
            ),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for Error<E> {}

#[cfg(feature = "defmt")]
impl<E: fmt::Debug> defmt::Format for Error<E> {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        // The same words on every output, for the price of formatting them on the target.
        defmt::write!(formatter, "{}", defmt::Display2Format(self));
    }
}

#[cfg(feature = "defmt")]
impl<I2C: ErrorType> defmt::Format for ProbeFailure<I2C> {
    fn format(&self, formatter: defmt::Formatter<'_>) {
        defmt::Format::format(&self.error, formatter);
    }
}

/// One look at both addresses; `None` if nobody acknowledged.
#[allow(clippy::type_complexity)]
fn look_once<I2C: I2c>(i2c: &mut I2C) -> Result<Option<(u8, &'static Part)>, Error<I2C::Error>> {
    let mut first_error = None;
    for address in ADDRESSES {
        let error = match read_byte(i2c, address, Register::WhoAmI) {
            Ok(who_am_i) => match Part::from_who_am_i(who_am_i) {
                Some(part) => return Ok(Some((address, part))),
                None => Error::UnknownIdentity { address, who_am_i },
            },
            Err(Error::Bus { source, .. })
                if matches!(source.kind(), ErrorKind::NoAcknowledge(_)) =>
            {
                continue;
            }
            Err(error) => error,
        };
        first_error.get_or_insert(error);
    }
    first_error.map_or(Ok(None), Err)
}

fn read_byte<I2C: I2c>(
    i2c: &mut I2C,
    address: u8,
    register: Register,
) -> Result<u8, Error<I2C::Error>> {
    let mut byte = [0];
    read(i2c, address, register, &mut byte)?;
    let [value] = byte;
    Ok(value)
}

/// Reads consecutive registers from `register` on.
fn read<I2C: I2c>(
    i2c: &mut I2C,
    address: u8,
    register: Register,
    bytes: &mut [u8],
) -> Result<(), Error<I2C::Error>> {
    i2c.write_read(address, &[register.address()], bytes)
        .map_err(|source| Error::Bus {
            operation: Operation::Read,
            register,
            address,
            source,
        })
}
