//! Messages of the firmware to people: one line of text each, the same on every output.
//!
//! A message reports an event and, where a person has to act, the remedy. On the UART it starts
//! with `# `, so that a plotter of the labelled values skips it.
//!
//! ```
//! use aplomb::telemetry::message::{Message, Severity};
//!
//! let message = Message::BusHeldLow { clock: false };
//! assert_eq!(message.severity(), Severity::Error);
//! assert!(message.to_string().starts_with("SDA (PB9) stays low: check the wiring"));
//! ```

use core::fmt;

use embedded_hal::i2c;

use crate::compass;
use crate::fault::{BurstFailure, ClockSource, FaultClass, ResetCause};
use crate::health::Flags;
use crate::mpu6050;
use crate::settings::storage::LoadProblem;

/// Length of the longest message with `# ` and its newline, in bytes.
pub const LINE_CAPACITY: usize = 200;

/// Message. Its text is for people.
#[derive(Clone, Copy, PartialEq, Debug)]
#[non_exhaustive]
pub enum Message {
    /// The firmware has started.
    Started {
        /// Board that the firmware was built for.
        board: &'static str,
        /// Core clock, MHz.
        core_mhz: u16,
        /// Source of the clock.
        clock: ClockSource,
    },
    /// A stored record is in use.
    RecordLoaded,
    /// A stored record could not be read.
    RecordProblem(LoadProblem),
    /// A reset has restarted the firmware, with power on.
    Restarted {
        /// Cause of the reset.
        cause: ResetCause,
        /// Last fault before the reset.
        last_fault: Option<FaultClass>,
        /// Program counter of a crash; 0 without one.
        crash_address: u32,
    },
    /// The sensor is configured and its bursts begin.
    SensorConfigured {
        /// Name of the part.
        part: &'static str,
        /// Bus address, 7 bits.
        address: u8,
    },
    /// The compass is configured and its readings come.
    CompassConfigured {
        /// Name of the part.
        part: &'static str,
        /// Bus address, 7 bits.
        address: u8,
    },
    /// The compass gives no usable readings.
    CompassFailed(compass::Fault),
    /// A line of the sensor's bus is low and clocking did not free it.
    BusHeldLow {
        /// True if SCL is low; otherwise SDA is.
        clock: bool,
    },
    /// The sensor could not be configured.
    SensorFailed(mpu6050::Error<i2c::ErrorKind>),
    /// Bursts have failed.
    BurstsFailed {
        /// Fault and step of the last failure.
        failure: BurstFailure,
        /// Number of failures since the last such message.
        count: u16,
    },
    /// The firmware reconfigures the sensor after bursts failed.
    Recovering,
    /// The board moved before the gyroscope's offset was measured. The measurement starts over.
    MovedAtStart,
    /// The gyroscope's offset is measured, and removed from the rates from now on.
    OffsetMeasured,
    /// Vibration is so strong that the accelerometer may clip.
    VibrationTooStrong,
    /// The attitude's flags have changed for longer than a moment.
    Attitude(Flags),
    /// Messages were lost because too many came at once.
    MessagesLost {
        /// Number of lost messages.
        count: u16,
    },
}

/// Severity of a message.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Severity {
    /// No fault.
    Information,
    /// The attitude is degraded, or would be if the cause lasted.
    Warning,
    /// No attitude is available.
    Error,
}

impl Message {
    /// Returns the severity.
    pub const fn severity(&self) -> Severity {
        match self {
            Self::Started {
                clock: ClockSource::InternalOscillator,
                ..
            }
            | Self::RecordProblem(_)
            | Self::BurstsFailed { .. }
            | Self::Restarted { .. }
            | Self::Recovering
            | Self::MovedAtStart
            | Self::VibrationTooStrong
            | Self::CompassFailed(_)
            | Self::MessagesLost { .. } => Severity::Warning,
            Self::Attitude(flags) if flags.intersects(Flags::DEGRADED) => Severity::Warning,
            Self::BusHeldLow { .. } | Self::SensorFailed(_) => Severity::Error,
            Self::Started { .. }
            | Self::RecordLoaded
            | Self::SensorConfigured { .. }
            | Self::CompassConfigured { .. }
            | Self::Attitude(_)
            | Self::OffsetMeasured => Severity::Information,
        }
    }
}

impl fmt::Display for Message {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Started {
                board,
                core_mhz,
                clock,
            } => {
                let version = env!("CARGO_PKG_VERSION");
                write!(formatter, "aplomb {version} on {board}, {core_mhz} MHz ")?;
                formatter.write_str(match clock {
                    ClockSource::Crystal => "from the crystal",
                    ClockSource::InternalOscillator => {
                        "from the internal oscillator: no crystal answered, \
                         times are off by up to 8 %"
                    }
                })
            }
            Self::RecordLoaded => formatter.write_str("stored calibration and settings in use"),
            Self::RecordProblem(problem) => write!(formatter, "{problem}"),
            Self::Restarted {
                cause,
                last_fault,
                crash_address,
            } => {
                let fault = last_fault.map_or("none", FaultClass::name);
                write!(formatter, "reset by {}, last fault: {fault}", cause.name())?;
                if *crash_address != 0 {
                    write!(formatter, ", at 0x{crash_address:08x}")?;
                }
                Ok(())
            }
            Self::SensorConfigured { part, address } => {
                write!(formatter, "{part} at 0x{address:02x} configured")
            }
            // Without a compass no such message comes.
            Self::CompassConfigured { .. } | Self::CompassFailed(_) if !compass::IS_BUILT_IN => {
                Ok(())
            }
            Self::CompassConfigured { part, address } => {
                write!(formatter, "compass: {part} at 0x{address:02x} configured")
            }
            Self::CompassFailed(fault) => write!(formatter, "compass: {fault}"),
            Self::BusHeldLow { clock } => {
                let line = if *clock { "SCL (PB8)" } else { "SDA (PB9)" };
                write!(
                    formatter,
                    "{line} stays low: check the wiring and the sensor's supply; trying again"
                )
            }
            Self::SensorFailed(error) => write!(formatter, "{error}; trying again"),
            Self::BurstsFailed { failure, count: 1 } => write!(formatter, "burst lost: {failure}"),
            Self::BurstsFailed { failure, count } => {
                write!(formatter, "{count} bursts lost, the last: {failure}")
            }
            Self::Recovering => formatter.write_str("setting the bus and the sensor up again"),
            Self::MovedAtStart => formatter
                .write_str("moved while the gyroscope's offset was being measured: hold it still"),
            Self::OffsetMeasured => formatter.write_str("gyroscope's offset measured, ready"),
            Self::VibrationTooStrong => formatter
                .write_str("vibration too strong: balance the rotors, mount the sensor softly"),
            Self::Attitude(flags) => {
                formatter.write_str("attitude: ")?;
                fmt::Display::fmt(flags, formatter)
            }
            Self::MessagesLost { count } => write!(formatter, "{count} messages lost"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::{BurstFault, BurstStep};
    use crate::mpu6050::registers::Register;

    #[test]
    fn messages_report_the_event_its_place_and_the_remedy() {
        let failure = BurstFailure {
            fault: BurstFault::NotAcknowledged,
            step: BurstStep::Pointer,
        };
        let cases = [
            (
                Message::BurstsFailed { failure, count: 1 },
                "burst lost: the sensor did not acknowledge at the register pointer",
            ),
            (
                Message::BurstsFailed { failure, count: 3 },
                "3 bursts lost, the last: the sensor did not acknowledge at the register pointer",
            ),
            (
                Message::BusHeldLow { clock: false },
                "SDA (PB9) stays low: check the wiring and the sensor's supply; trying again",
            ),
            (
                Message::SensorConfigured {
                    part: "MPU-6050",
                    address: 0x69,
                },
                "MPU-6050 at 0x69 configured",
            ),
            (
                Message::Attitude(Flags::VALID | Flags::DEGRADED | Flags::POLLED),
                "attitude: VALID|DEGRADED|POLLED",
            ),
        ];
        for (message, text) in cases {
            assert_eq!(message.to_string(), text);
        }
    }

    #[test]
    fn every_message_fits_its_line() {
        let error = |error| Message::SensorFailed(error);
        let mut messages = vec![
            Message::Started {
                board: "blackpill-f411",
                core_mhz: 168,
                clock: ClockSource::InternalOscillator,
            },
            Message::RecordLoaded,
            Message::RecordProblem(LoadProblem::Damaged),
            Message::RecordProblem(LoadProblem::BothDamaged),
            Message::RecordProblem(LoadProblem::NewerFormat { version: u16::MAX }),
            Message::Restarted {
                cause: ResetCause::Software,
                last_fault: Some(FaultClass::InterruptStuckHigh),
                crash_address: u32::MAX,
            },
            Message::BusHeldLow { clock: true },
            Message::CompassConfigured {
                part: "HMC5883L/DA5883",
                address: 0x1e,
            },
            Message::CompassFailed(compass::Fault::Other {
                named: compass::PartId::Hmc5883l,
                found: compass::PartId::Qmc5883l,
            }),
            Message::CompassFailed(compass::Fault::WrongIdentity {
                address: 0x1e,
                identity: [0; 3],
            }),
            Message::CompassFailed(compass::Fault::HoldsBus),
            Message::Recovering,
            Message::MovedAtStart,
            Message::OffsetMeasured,
            Message::VibrationTooStrong,
            Message::Attitude(Flags::LASTING),
            Message::MessagesLost { count: u16::MAX },
            error(mpu6050::Error::NotFound),
            error(mpu6050::Error::UnknownIdentity {
                address: 0x69,
                who_am_i: 0,
            }),
            error(mpu6050::Error::ResetFailed {
                address: 0x69,
                read: 0,
            }),
        ];
        // The longest name is SIGNAL_PATH_RESET's.
        for register in [Register::SignalPathReset, Register::AccelerometerXHigh] {
            messages.push(error(mpu6050::Error::Readback {
                address: 0x69,
                register,
                written: 0xff,
                read: 0,
            }));
            messages.push(error(mpu6050::Error::Bus {
                operation: mpu6050::Operation::Write,
                register,
                address: 0x69,
                source: i2c::ErrorKind::NoAcknowledge(i2c::NoAcknowledgeSource::Address),
            }));
        }
        for (fault, step) in (0..=7).flat_map(|fault| (0..=7).map(move |step| (fault, step))) {
            if let Some(failure) = BurstFailure::from_codes(fault, step) {
                messages.push(Message::BurstsFailed {
                    failure,
                    count: u16::MAX,
                });
            }
        }
        for message in messages {
            let line = format!("# {message}\n");
            assert!(line.len() <= LINE_CAPACITY, "{} bytes: {line}", line.len());
        }
    }
}
