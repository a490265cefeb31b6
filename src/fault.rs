//! Faults of bus, sensor, data, outputs, clock and processor, in classes that are counted. Also the
//! causes of a reset, and the layout of the health report in RAM.
//!
//! The board produces these values, and telemetry prints them.
//!
//! A failed burst is never published. The next good one holds the number of samples lost before it.
//!
//! ```
//! use aplomb::fault::{BurstFailure, BurstFault, BurstStep, FaultClass};
//!
//! let failure = BurstFailure { fault: BurstFault::Deadline, step: BurstStep::Data };
//! assert_eq!(failure.class(), FaultClass::BurstDeadline);
//! assert_eq!(failure.class().to_string(), "burst-deadline");
//! assert_eq!(failure.to_string(), "the bus did not answer in time in the data");
//! ```

use core::fmt;

/// Class of faults, with a counter of its own. Its text is its [`name`](Self::name).
///
/// The numbers are stable: a debugger and the virtual board read the counters by them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
#[non_exhaustive]
pub enum FaultClass {
    /// The sensor did not acknowledge its address.
    AddressNotAcknowledged = 0,
    /// The sensor did not acknowledge another byte.
    DataNotAcknowledged = 1,
    /// A burst did not end in time: SCL is stretched or held.
    BurstDeadline = 2,
    /// SDA was held low during a bus recovery.
    DataLineLow = 3,
    /// SCL was held low during a bus recovery.
    ClockLineLow = 4,
    /// A START or STOP was misplaced, or a setting was garbled on its way.
    BusError = 5,
    /// SDA was low while this side released it.
    ArbitrationLost = 6,
    /// A byte was lost inside the I2C port.
    Overrun = 7,
    /// The DMA controller reported an error.
    Dma = 8,
    /// No data-ready edge came for three periods, and the pin was low.
    InterruptMissing = 9,
    /// No data-ready edge came for three periods, and the pin was high.
    InterruptStuckHigh = 10,
    /// A data-ready edge came too soon after the one before.
    InterruptGlitch = 11,
    /// The sensor did not answer a probe.
    SensorSilent = 12,
    /// The sensor was in its reset state.
    SensorReset = 13,
    /// A register of the sensor had lost its value.
    RegisterChanged = 14,
    /// The data stopped changing.
    Frozen = 15,
    /// A sample was no measurement: all zeros, all ones, or implausible.
    Rejected = 16,
    /// An axis began to read full scale.
    Saturated = 17,
    /// The die was outside the part's temperature range.
    Temperature = 18,
    /// A sample was lost because the attitude task had not ended.
    AttitudeLate = 19,
    /// Samples were lost.
    SamplesMissed = 20,
    /// A frame was dropped because the last one was still being sent.
    TelemetryLate = 21,
    /// Bytes from the UART were garbled or lost.
    UartInput = 22,
    /// The crystal stopped; the internal oscillator took over.
    ClockFailed = 23,
    /// The watchdog reset the processor.
    Watchdog = 24,
    /// A hard fault or a panic; the processor was reset.
    Crash = 25,
    /// A hard fault with the stack exhausted; the processor was reset.
    StackOverflow = 26,
    /// A compass that was found or named gave no usable readings.
    Compass = 27,
}

impl fmt::Display for FaultClass {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl FaultClass {
    /// Number of classes.
    pub const COUNT: usize = Self::ALL.len();

    /// Every class, in the order of the numbers.
    pub const ALL: [Self; 28] = [
        Self::AddressNotAcknowledged,
        Self::DataNotAcknowledged,
        Self::BurstDeadline,
        Self::DataLineLow,
        Self::ClockLineLow,
        Self::BusError,
        Self::ArbitrationLost,
        Self::Overrun,
        Self::Dma,
        Self::InterruptMissing,
        Self::InterruptStuckHigh,
        Self::InterruptGlitch,
        Self::SensorSilent,
        Self::SensorReset,
        Self::RegisterChanged,
        Self::Frozen,
        Self::Rejected,
        Self::Saturated,
        Self::Temperature,
        Self::AttitudeLate,
        Self::SamplesMissed,
        Self::TelemetryLate,
        Self::UartInput,
        Self::ClockFailed,
        Self::Watchdog,
        Self::Crash,
        Self::StackOverflow,
        Self::Compass,
    ];

    /// Returns the class with this number.
    pub const fn from_number(number: u32) -> Option<Self> {
        let mut index = 0;
        while index < Self::ALL.len() {
            let class = Self::ALL[index];
            if class as u32 == number {
                return Some(class);
            }
            index += 1;
        }
        None
    }

    /// Returns the name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::AddressNotAcknowledged => "address-nack",
            Self::DataNotAcknowledged => "data-nack",
            Self::BurstDeadline => "burst-deadline",
            Self::DataLineLow => "sda-low",
            Self::ClockLineLow => "scl-low",
            Self::BusError => "bus-error",
            Self::ArbitrationLost => "arbitration-lost",
            Self::Overrun => "overrun",
            Self::Dma => "dma-error",
            Self::InterruptMissing => "interrupt-missing",
            Self::InterruptStuckHigh => "interrupt-stuck-high",
            Self::InterruptGlitch => "interrupt-glitch",
            Self::SensorSilent => "sensor-silent",
            Self::SensorReset => "sensor-reset",
            Self::RegisterChanged => "register-changed",
            Self::Frozen => "frozen",
            Self::Rejected => "rejected",
            Self::Saturated => "saturated",
            Self::Temperature => "temperature",
            Self::AttitudeLate => "attitude-late",
            Self::SamplesMissed => "samples-missed",
            Self::TelemetryLate => "telemetry-late",
            Self::UartInput => "uart-input",
            Self::ClockFailed => "clock-failed",
            Self::Watchdog => "watchdog",
            Self::Crash => "crash",
            Self::StackOverflow => "stack-overflow",
            Self::Compass => "compass",
        }
    }
}

/// Layout of the health report that the firmware keeps in RAM under the symbol `APLOMB_HEALTH`.
///
/// All words are 32 bits and little-endian; offsets are in bytes. The report survives every reset
/// but power-up: the counters continue.
///
/// ```
/// use aplomb::fault::{FaultClass, report};
///
/// // Counter of watchdog resets.
/// let offset = report::COUNTERS + 4 * FaultClass::Watchdog as usize;
/// assert_eq!(offset, 20 + 4 * 24);
/// ```
pub mod report {
    use super::FaultClass;

    /// Offset of the layout's version.
    pub const VERSION_OFFSET: usize = 0;
    /// Version of the layout.
    pub const VERSION: u32 = 3;
    /// Offset of the cause of the last reset: a [`ResetCause`](super::ResetCause) as a number.
    pub const RESET_CAUSE: usize = 4;
    /// Offset of the last fault: number of its class, or [`NO_FAULT`].
    pub const LAST_FAULT: usize = 8;
    /// Offset of the number of starts since power-up.
    pub const STARTS: usize = 12;
    /// Offset of the last crash's program counter, 0 without one.
    pub const CRASH_ADDRESS: usize = 16;
    /// Offset of the counters, one word per class in the order of the numbers.
    pub const COUNTERS: usize = 20;
    /// Length of the report, bytes.
    pub const LENGTH: usize = COUNTERS + 4 * FaultClass::COUNT;
    /// Value of the last fault while there was none.
    pub const NO_FAULT: u32 = u32::MAX;
}

/// Cause of a processor reset. Its text is its [`name`](Self::name).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
#[non_exhaustive]
pub enum ResetCause {
    /// Power-up or brown-out.
    Power = 0,
    /// The reset pin, pulled by a person or a debugger, or a debugger's reset of the core.
    Pin = 1,
    /// The firmware itself, after a crash.
    Software = 2,
    /// The independent watchdog: samples, attitude or telemetry had stopped.
    Watchdog = 3,
    /// Another cause.
    Other = 4,
}

impl fmt::Display for ResetCause {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl ResetCause {
    /// Returns the cause, as a part of a sentence.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Power => "power came",
            Self::Pin => "the reset pin or a debugger",
            Self::Software => "the firmware itself",
            Self::Watchdog => "the watchdog",
            Self::Other => "an unknown reset",
        }
    }

    /// Returns whether RAM, with the estimate of the motion, has survived the reset.
    pub const fn is_warm(self) -> bool {
        matches!(self, Self::Software | Self::Watchdog)
    }
}

/// Source of the core's clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ClockSource {
    /// The board's crystal, or the clock that another chip drives into its pin.
    Crystal,
    /// The chip's own oscillator, because no crystal answered. Times are accurate to 1 % at 25 °C,
    /// to 8 % over temperature (STM32F405 datasheet, table "HSI oscillator characteristics").
    InternalOscillator,
}

/// Step of a burst, in order. The numbers are stable: one word holds step and fault.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum BurstStep {
    /// No burst runs; the reader waits for an edge.
    Idle = 0,
    /// START is requested.
    Start = 1,
    /// The address is being sent, for writing.
    AddressWrite = 2,
    /// The register pointer is being sent.
    Pointer = 3,
    /// The repeated START is requested.
    RepeatedStart = 4,
    /// The address is being sent, for reading.
    AddressRead = 5,
    /// DMA receives the 14 data bytes.
    Data = 6,
    /// A setting of the compass is being sent.
    Setting = 7,
}

/// Reason why a burst failed. The numbers are stable: one word holds step and fault.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
#[non_exhaustive]
pub enum BurstFault {
    /// The sensor did not acknowledge a byte.
    NotAcknowledged = 1,
    /// A START or STOP was misplaced on the bus.
    BusError = 2,
    /// SDA was low while this side released it.
    ArbitrationLost = 3,
    /// A byte was lost inside the I2C port.
    Overrun = 4,
    /// The DMA controller reported an error.
    Dma = 5,
    /// The step did not end before its deadline.
    Deadline = 6,
    /// The sensor's INT pin stayed silent.
    NoDataReady = 7,
}

/// Fault of a burst, and the step of the burst.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BurstFailure {
    /// Fault.
    pub fault: BurstFault,
    /// Step.
    pub step: BurstStep,
}

impl BurstFailure {
    /// Returns the class that counts the failure. A missing edge with the pin high counts as
    /// [`FaultClass::InterruptStuckHigh`] instead.
    pub const fn class(&self) -> FaultClass {
        match (self.fault, self.step) {
            (BurstFault::NotAcknowledged, BurstStep::AddressWrite | BurstStep::AddressRead) => {
                FaultClass::AddressNotAcknowledged
            }
            (BurstFault::NotAcknowledged, _) => FaultClass::DataNotAcknowledged,
            (BurstFault::BusError, _) => FaultClass::BusError,
            (BurstFault::ArbitrationLost, _) => FaultClass::ArbitrationLost,
            (BurstFault::Overrun, _) => FaultClass::Overrun,
            (BurstFault::Dma, _) => FaultClass::Dma,
            (BurstFault::Deadline, _) => FaultClass::BurstDeadline,
            (BurstFault::NoDataReady, _) => FaultClass::InterruptMissing,
        }
    }

    /// Returns the failure with these numbers; `None` if one of them is unknown.
    pub const fn from_codes(fault: u8, step: u8) -> Option<Self> {
        let fault = match fault {
            1 => BurstFault::NotAcknowledged,
            2 => BurstFault::BusError,
            3 => BurstFault::ArbitrationLost,
            4 => BurstFault::Overrun,
            5 => BurstFault::Dma,
            6 => BurstFault::Deadline,
            7 => BurstFault::NoDataReady,
            _ => return None,
        };
        let step = match step {
            0 => BurstStep::Idle,
            1 => BurstStep::Start,
            2 => BurstStep::AddressWrite,
            3 => BurstStep::Pointer,
            4 => BurstStep::RepeatedStart,
            5 => BurstStep::AddressRead,
            6 => BurstStep::Data,
            7 => BurstStep::Setting,
            _ => return None,
        };
        Some(Self { fault, step })
    }
}

impl core::error::Error for BurstFailure {}

impl fmt::Display for BurstFailure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.fault == BurstFault::NoDataReady {
            return formatter
                .write_str("no data-ready edge on the INT pin: check the wire from INT to PA1");
        }
        formatter.write_str(match self.fault {
            BurstFault::NotAcknowledged => "the sensor did not acknowledge",
            BurstFault::BusError => "bus error",
            BurstFault::ArbitrationLost => "SDA was held low",
            BurstFault::Overrun => "a byte was lost in the I2C port",
            BurstFault::Dma => "DMA error",
            BurstFault::Deadline => "the bus did not answer in time",
            BurstFault::NoDataReady => "",
        })?;
        formatter.write_str(match self.step {
            BurstStep::Idle => " between bursts",
            BurstStep::Start => " at the start",
            BurstStep::AddressWrite => " at its address (write)",
            BurstStep::Pointer => " at the register pointer",
            BurstStep::RepeatedStart => " at the repeated start",
            BurstStep::AddressRead => " at its address (read)",
            BurstStep::Data => " in the data",
            BurstStep::Setting => " in a setting of the compass",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_class_has_its_number_and_name() {
        let mut names = Vec::new();
        for (number, class) in FaultClass::ALL.into_iter().enumerate() {
            assert_eq!(class as usize, number);
            assert_eq!(FaultClass::from_number(number as u32), Some(class));
            assert!(!names.contains(&class.name()), "{}", class.name());
            names.push(class.name());
        }
        assert_eq!(FaultClass::from_number(report::NO_FAULT), None);
    }

    #[test]
    fn every_failure_is_read_back_from_its_codes() {
        let mut known = 0;
        for fault in 0..=u8::MAX {
            for step in 0..=u8::MAX {
                if let Some(failure) = BurstFailure::from_codes(fault, step) {
                    assert_eq!((failure.fault as u8, failure.step as u8), (fault, step));
                    known += 1;
                }
            }
        }
        assert_eq!(known, 7 * 8);
    }
}
