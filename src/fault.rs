//! What can go wrong between the sensor's pins and the pipeline, as plain values that the board
//! produces and the telemetry puts into words.
//!
//! A failed burst is never published: the next good one says how many were lost before it.

use core::fmt;

/// A class of faults: what is counted, and what a report names. The numbers are stable: a debugger and
/// the virtual board read the counters by them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum FaultClass {
    /// The sensor did not acknowledge its address.
    AddressNotAcknowledged = 0,
    /// The sensor did not acknowledge another byte.
    DataNotAcknowledged = 1,
    /// A burst did not end in time: the clock is stretched or held.
    BurstDeadline = 2,
    /// SDA was held low when the bus was to be freed.
    DataLineLow = 3,
    /// SCL was held low when the bus was to be freed.
    ClockLineLow = 4,
    /// A START or STOP came at the wrong place.
    BusError = 5,
    /// SDA was low where this side let it go.
    ArbitrationLost = 6,
    /// A byte was lost inside the port.
    Overrun = 7,
    /// The DMA controller reported an error.
    Dma = 8,
    /// No data-ready edge came for three periods; the pin was low.
    InterruptMissing = 9,
    /// The same, and the pin was high.
    InterruptStuckHigh = 10,
    /// A data-ready edge came too soon after the one before.
    InterruptGlitch = 11,
    /// The sensor did not answer when it was looked for.
    SensorSilent = 12,
    /// The sensor had gone back to its reset state.
    SensorReset = 13,
    /// A register of the sensor did not hold what was written to it.
    RegisterChanged = 14,
    /// The data did not change any more.
    Frozen = 15,
    /// A sample was no measurement: all zeros or all ones, or absurd.
    Rejected = 16,
    /// An axis began to read full scale.
    Saturated = 17,
    /// The die was outside the temperatures that the part is made for.
    Temperature = 18,
    /// A sample was lost because the attitude task was not done.
    AttitudeLate = 19,
    /// Data-ready edges gave no sample.
    SamplesMissed = 20,
    /// A line was left out because the last was still going out.
    TelemetryLate = 21,
    /// What came in by UART was garbled or too much.
    UartInput = 22,
    /// The crystal stopped; the internal oscillator took over.
    ClockFailed = 23,
    /// The watchdog reset the processor.
    Watchdog = 24,
    /// A hard fault or a panic; the processor was reset.
    Crash = 25,
    /// The same, with the stack used up.
    StackOverflow = 26,
}

impl FaultClass {
    /// How many classes there are.
    pub const COUNT: usize = Self::ALL.len();

    /// Every class, by its number.
    pub const ALL: [Self; 27] = [
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
    ];

    /// The class of this number.
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

    /// Its name in reports.
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
        }
    }
}

/// What the firmware counts and remembers, as it lies in RAM under the symbol `APLOMB_HEALTH`.
///
/// All words are 32 bits and little-endian. It outlives every reset but that of the supply: the counters
/// go on.
pub mod report {
    use super::FaultClass;

    /// Offset of the version of this layout.
    pub const VERSION_OFFSET: usize = 0;
    /// The version.
    pub const VERSION: u32 = 1;
    /// Offset of the variance of the published tilt, both axes together, an `f32` in rad²; its root is σ.
    pub const TILT_VARIANCE: usize = 4;
    /// Offset of the cause of the last reset: a [`ResetCause`](super::ResetCause) as a number.
    pub const RESET_CAUSE: usize = 8;
    /// Offset of the last fault: the number of its class, or [`NO_FAULT`].
    pub const LAST_FAULT: usize = 12;
    /// Offset of how often the firmware has started since power came.
    pub const STARTS: usize = 16;
    /// Offset of the place of the last crash: the program counter of a hard fault, zero without one.
    pub const CRASH_ADDRESS: usize = 20;
    /// Offset of the counters, a word for each class, by its number.
    pub const COUNTERS: usize = 24;
    /// The length of it all.
    pub const LENGTH: usize = COUNTERS + 4 * FaultClass::COUNT;
    /// No fault has been seen.
    pub const NO_FAULT: u32 = u32::MAX;
}

/// What reset the processor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum ResetCause {
    /// The supply came, or sank too low.
    Power = 0,
    /// The reset pin, pulled by a person or a debugger.
    Pin = 1,
    /// The firmware itself, after a crash or because it was asked to.
    Software = 2,
    /// The independent watchdog: samples, attitude or telemetry had stopped.
    Watchdog = 3,
    /// Something else.
    Other = 4,
}

impl ResetCause {
    /// What it was, in words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Power => "power came",
            Self::Pin => "the reset pin",
            Self::Software => "the firmware itself",
            Self::Watchdog => "the watchdog",
            Self::Other => "an unknown reset",
        }
    }

    /// Whether RAM and what it says of the motion have outlived it.
    pub const fn is_warm(self) -> bool {
        matches!(self, Self::Software | Self::Watchdog)
    }
}

/// What the core's clock runs from.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ClockSource {
    /// The board's crystal, or the clock that another chip drives into its pin.
    Crystal,
    /// The chip's own oscillator, since no crystal answered: times are right to 1 % only
    /// (STM32F405 datasheet, table "HSI oscillator characteristics").
    InternalOscillator,
}

/// The steps of a burst, in their order. The numbers are stable: they travel in one word with the fault.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum BurstStep {
    /// No burst runs; the reader waits for an edge.
    Idle = 0,
    /// START is asked for.
    Start = 1,
    /// The address is on its way, for writing.
    AddressWrite = 2,
    /// The register pointer is on its way.
    Pointer = 3,
    /// The repeated START is asked for.
    RepeatedStart = 4,
    /// The address is on its way, for reading.
    AddressRead = 5,
    /// DMA takes the 14 data bytes.
    Data = 6,
}

/// Why a burst failed. The numbers are stable: they travel in one word with the step.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum BurstFault {
    /// The sensor did not acknowledge a byte.
    NotAcknowledged = 1,
    /// A START or STOP came at the wrong place on the bus.
    BusError = 2,
    /// SDA was low where this side let it go.
    ArbitrationLost = 3,
    /// A byte was lost inside the port.
    Overrun = 4,
    /// The DMA controller reported an error.
    Dma = 5,
    /// The step did not end before its deadline.
    Deadline = 6,
    /// The sensor's INT pin stayed silent.
    NoDataReady = 7,
}

/// A fault and the step it happened in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BurstFailure {
    /// Why.
    pub fault: BurstFault,
    /// Where.
    pub step: BurstStep,
}

impl BurstFailure {
    /// The class that it is counted in.
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

    /// The failure with these numbers, or nothing if either number stands for nothing.
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
            _ => return None,
        };
        Some(Self { fault, step })
    }
}

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
    fn every_failure_survives_its_codes() {
        let mut known = 0;
        for fault in 0..=u8::MAX {
            for step in 0..=u8::MAX {
                if let Some(failure) = BurstFailure::from_codes(fault, step) {
                    assert_eq!((failure.fault as u8, failure.step as u8), (fault, step));
                    known += 1;
                }
            }
        }
        assert_eq!(known, 7 * 7);
    }
}
