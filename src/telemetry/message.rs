//! What the firmware has to say besides attitudes: one line of text each, the same on every output.
//!
//! On the UART a message starts with `# `, so that a plotter of the labelled values skips it. Each
//! says what happened and, where a person has to act, what to do.

use core::fmt;

use embedded_hal::i2c;
use heapless::Deque;

use crate::calibration::storage::LoadProblem;
use crate::fault::{BurstFailure, ClockSource, FaultClass, ResetCause};
use crate::health::Flags;
use crate::mpu6050;

/// Room for the longest message on a line of its own, in bytes.
pub const LINE_CAPACITY: usize = 200;

/// A message.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Message {
    /// The firmware has started.
    Started {
        /// The board that it was built for.
        board: &'static str,
        /// The core clock, in megahertz.
        core_mhz: u16,
        /// What the clock runs from.
        clock: ClockSource,
    },
    /// A stored record was found and is in use.
    RecordLoaded,
    /// Something is wrong with what is stored.
    RecordProblem(LoadProblem),
    /// It was a reset that started it, with power on.
    Restarted {
        /// What reset the processor.
        cause: ResetCause,
        /// The last fault before that.
        last_fault: Option<FaultClass>,
        /// Where the firmware crashed; zero if it did not.
        crash_address: u32,
    },
    /// The sensor is configured and its bursts begin.
    SensorConfigured {
        /// The part's name.
        part: &'static str,
        /// Its address on the bus, 7 bits.
        address: u8,
    },
    /// A line of the sensor's bus is low and clocking did not free it.
    BusHeldLow {
        /// Whether SCL is low; else SDA is.
        clock: bool,
    },
    /// The sensor could not be configured.
    SensorFailed(mpu6050::Error<i2c::ErrorKind>),
    /// Bursts have failed.
    BurstsFailed {
        /// How and where the last one did.
        failure: BurstFailure,
        /// How many since the last such message.
        count: u16,
    },
    /// The sensor is set up again after bursts failed.
    Recovering,
    /// The board was moved before the gyroscope's offset was measured: that begins again.
    MovedAtStart,
    /// The gyroscope's offset is measured: rates are free of it from here on.
    OffsetMeasured,
    /// The flags of the attitude have changed for longer than a moment.
    Attitude(Flags),
    /// Messages were lost, since too many came at once.
    MessagesLost {
        /// How many.
        count: u16,
    },
}

/// How bad it is.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Severity {
    /// All is well.
    Information,
    /// The attitude suffers, or would, if this lasted.
    Warning,
    /// There is no attitude.
    Error,
}

impl Message {
    /// How bad it is.
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
            | Self::MessagesLost { .. } => Severity::Warning,
            Self::Attitude(flags) if flags.intersects(Flags::DEGRADED) => Severity::Warning,
            Self::BusHeldLow { .. } | Self::SensorFailed(_) => Severity::Error,
            Self::Started { .. }
            | Self::RecordLoaded
            | Self::SensorConfigured { .. }
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
                        "from the internal oscillator: no crystal answered, times are right to 1 % only"
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
            Self::Attitude(flags) => {
                formatter.write_str("attitude: ")?;
                fmt::Display::fmt(flags, formatter)
            }
            Self::MessagesLost { count } => write!(formatter, "{count} messages lost"),
        }
    }
}

/// Messages on their way to the task that sends them.
pub struct Mailbox {
    messages: Deque<Message, 16>,
    lost: u16,
}

impl Mailbox {
    /// An empty mailbox.
    pub const fn new() -> Self {
        Self {
            messages: Deque::new(),
            lost: 0,
        }
    }

    /// Adds a message. If there is no room it is counted, and the count comes out as a message.
    pub fn post(&mut self, message: Message) {
        if self.messages.push_back(message).is_err() {
            self.lost = self.lost.saturating_add(1);
        }
    }

    /// Takes the oldest message.
    pub fn take(&mut self) -> Option<Message> {
        self.messages.pop_front().or_else(|| {
            let count = core::mem::take(&mut self.lost);
            (count > 0).then_some(Message::MessagesLost { count })
        })
    }
}

impl Default for Mailbox {
    fn default() -> Self {
        Self::new()
    }
}

/// Text in a buffer of fixed size. What does not fit is cut off at a character's end.
pub struct TextBuffer<'a> {
    buffer: &'a mut [u8],
    length: usize,
}

impl<'a> TextBuffer<'a> {
    /// An empty text in `buffer`.
    pub fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, length: 0 }
    }

    /// The number of bytes written.
    pub fn length(&self) -> usize {
        self.length
    }

    /// The number of bytes that still fit.
    pub fn room(&self) -> usize {
        self.buffer.len() - self.length
    }
}

impl TextBuffer<'_> {
    /// Appends bytes that are no text, all or none.
    pub fn write_bytes(&mut self, bytes: &[u8]) {
        let end = self.length + bytes.len();
        if let Some(place) = self.buffer.get_mut(self.length..end) {
            place.copy_from_slice(bytes);
            self.length = end;
        }
    }
}

impl fmt::Write for TextBuffer<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let mut fitting = text.len().min(self.room());
        while !text.is_char_boundary(fitting) {
            fitting -= 1;
        }
        let end = self.length + fitting;
        if let (Some(place), Some(bytes)) = (
            self.buffer.get_mut(self.length..end),
            text.as_bytes().get(..fitting),
        ) {
            place.copy_from_slice(bytes);
            self.length = end;
        }
        if fitting == text.len() {
            Ok(())
        } else {
            Err(fmt::Error)
        }
    }
}

#[cfg(test)]
mod tests {
    use core::fmt::Write;

    use super::*;
    use crate::fault::{BurstFault, BurstStep};
    use crate::mpu6050::registers::Register;

    #[test]
    fn messages_say_what_happened_where_and_what_to_do() {
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
            Message::RecordProblem(LoadProblem::NewerFormat { version: u16::MAX }),
            Message::Restarted {
                cause: ResetCause::Software,
                last_fault: Some(FaultClass::InterruptStuckHigh),
                crash_address: u32::MAX,
            },
            Message::BusHeldLow { clock: true },
            Message::Recovering,
            Message::MovedAtStart,
            Message::OffsetMeasured,
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
        for (fault, step) in (0..=7).flat_map(|fault| (0..=6).map(move |step| (fault, step))) {
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

    #[test]
    fn a_mailbox_keeps_order_and_counts_what_it_had_no_room_for() {
        let mut mailbox = Mailbox::new();
        assert_eq!(mailbox.take(), None);
        for count in 0..20 {
            mailbox.post(Message::MessagesLost { count });
        }
        for count in 0..16 {
            assert_eq!(mailbox.take(), Some(Message::MessagesLost { count }));
        }
        assert_eq!(mailbox.take(), Some(Message::MessagesLost { count: 4 }));
        assert_eq!(mailbox.take(), None);
    }

    #[test]
    fn a_text_buffer_cuts_at_a_character() {
        let mut buffer = [0; 4];
        let mut text = TextBuffer::new(&mut buffer);
        assert!(text.write_str("ab").is_ok());
        assert!(text.write_str("c°").is_err());
        text.write_bytes(b"de");
        assert_eq!((text.length(), text.room()), (3, 1));
        text.write_bytes(b"f");
        assert_eq!((text.length(), text.room()), (4, 0));
        assert_eq!(&buffer, b"abcf");
    }
}
