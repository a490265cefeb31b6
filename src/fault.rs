//! What can go wrong between the sensor's pins and the pipeline, as plain values that the board
//! produces and the telemetry puts into words.
//!
//! A failed burst is never published: the next good one says how many were lost before it.

use core::fmt;

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
