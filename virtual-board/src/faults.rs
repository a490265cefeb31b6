//! What can go wrong on the virtual board, each at a time that a test chooses.
//!
//! Times are seconds of virtual time since power-up.

use std::ops::Range;

/// A byte of a bus transaction that the sensor ought to acknowledge.
///
/// Bytes that the sensor sends are acknowledged by the microcontroller, so no fault of the sensor's can refuse them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusByte {
    /// The address with the write direction, after a start.
    AddressWrite,
    /// The register number.
    Pointer,
    /// A register's new value.
    Value,
    /// The address with the read direction, after the repeated start.
    AddressRead,
}

/// A line of the sensor's bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusLine {
    /// SCL, the clock.
    Clock,
    /// SDA, the data.
    Data,
}

/// A fault.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// No sensor is connected for this long; then one is, freshly powered.
    SensorAbsent(Range<f64>),
    /// The sensor acknowledges nothing for this long, and goes on as before afterwards.
    SensorSilent(Range<f64>),
    /// A line of the bus is short-circuited to ground for this long, so that nothing gets through.
    BusHeldLow(BusLine, Range<f64>),
    /// WHO_AM_I reads as this for this long.
    Identity(u8, Range<f64>),
    /// From `from_s` on, the sensor refuses the next `count` bytes of this kind.
    Nack {
        /// The kind of byte.
        byte: BusByte,
        /// Since when.
        from_s: f64,
        /// How many.
        count: u32,
    },
    /// The INT wire is stuck at this level for this long.
    InterruptStuck(bool, Range<f64>),
    /// The sensor's supply fails for an instant, so that it restarts asleep.
    SensorReset(f64),
    /// What the firmware receives on its UART is garbled: so many bytes in a million come with an error.
    ReceptionGarbled {
        /// With noise on a bit.
        noise_per_million: u32,
        /// With a stop bit that is none.
        framing_per_million: u32,
    },
    /// The crystal does not start, or the other chip's clock does not come.
    NoCrystal,
    /// The firmware's microsecond timer starts at this count instead of zero.
    TimerStartsAt(u32),
}

/// Seconds as nanoseconds since power-up.
#[must_use]
pub fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Whether a time is in a range of seconds.
#[must_use]
pub fn within(now_ns: u64, range: &Range<f64>) -> bool {
    (nanoseconds(range.start)..nanoseconds(range.end)).contains(&now_ns)
}
