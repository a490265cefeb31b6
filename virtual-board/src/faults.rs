//! The faults of the virtual board. A test, a schedule or a seed chooses the time of each.
//!
//! Times are seconds of virtual time since power-up. [`FaultKind`] lists the faults of a schedule
//! by name. Each behaves as the silicon does; its comment cites the section of RM0090 or of the
//! sensor's documents. [`Fault`] adds faults for tests alone.

use std::fmt;
use std::ops::Range;

use aplomb::fault::FaultClass;

/// A kind of fault with its parameter. Its text form is the name, and the parameter after a colon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// The sensor does not acknowledge its address, in the one direction if one is given: AF
    /// (RM0090, 27.3.4).
    AddressNack(Option<Direction>),
    /// The sensor does not acknowledge this byte of those written to it: 0 is the register number,
    /// 1 the first value.
    DataNack(u8),
    /// The sensor holds SCL low from the end of the byte on the wire (clock stretching, UM10204,
    /// 3.1.9). The controller waits for as long as that takes (RM0090, 27.3.3).
    BurstStall,
    /// SDA is short-circuited to ground. With a rest: the sensor has lost count in the middle of a
    /// byte that it sends. It goes on with each clock, however long that takes (UM10204, 3.1.16).
    SdaLow(Option<RestOfByte>),
    /// SCL is short-circuited to ground.
    SclLow,
    /// A STOP lies in the middle of every byte: BERR, and the sensor is no longer addressed
    /// (RM0090, 27.3.4). As a flag alone, BERR is set without a STOP, and the transfer goes on
    /// (STM32F405 errata, "Spurious bus error detection in master mode").
    BusError(IsFlagAlone),
    /// SDA is pulled low while the controller sends a one: ARLO, and the controller is one no
    /// longer (RM0090, 27.3.4).
    ArbitrationLost,
    /// The memory refuses what the DMA stream of the sensor's bus writes: TEIF, and the stream
    /// stops (RM0090, 10.3.18).
    DmaError,
    /// The INT wire is open: the pin follows the microcontroller's own pull resistor, or stays low.
    IntMissing,
    /// The INT wire is short-circuited to the supply.
    IntHigh,
    /// The INT wire is short-circuited to ground.
    IntLow,
    /// Pulses of 1 µs on the INT wire, this many a second, opposite to its level.
    IntGlitch(u32),
    /// The sensor acknowledges nothing, and goes on as before afterwards.
    SensorSilent,
    /// The sensor's supply fails; it comes back with all registers at reset, asleep.
    SensorBrownout,
    /// A register of the sensor changes by itself, once.
    RegisterFlip(u8, u8),
    /// The data registers keep their values, while the data-ready edges go on.
    Frozen,
    /// The data registers read zero.
    Zeros,
    /// The data registers read ones.
    Ones,
    /// An axis reads full scale.
    Saturated(Axis),
    /// An axis keeps its value, while the others go on.
    Stuck(Axis),
    /// The temperature registers read this, in °C.
    Temperature(f64),
    /// The core executes nothing, as while the flash is erased (RM0090, 3.5.2): every interrupt is
    /// late.
    CoreStall,
    /// Bytes come in on the UART without a pause.
    UartFlood,
    /// Bytes come in on the UART without a pause, with noise and framing errors (RM0090, 30.3.3).
    UartNoise,
    /// A debug probe that had made the log wait for it (as probe-rs does) is pulled off.
    ProbeDetach,
    /// The crystal stops. With the clock security system on, CSSF is set and the core continues
    /// from the internal oscillator. It executes the NMI while CSSF stays set (RM0090, 7.2.7). With
    /// it off, the core stops. The crystal comes back at the end, if the duration is not zero.
    CrystalDies,
    /// The interrupt that the attitude task runs on is held back, as by another of its priority
    /// that takes too long.
    AttitudeLate,
    /// The processor leaves the Thumb state, as by a jump through a corrupted pointer. This is a
    /// usage fault. As no handler is enabled for it, a hard fault follows (PM0214, 2.4).
    Crash,
    /// The stack is used up but for these bytes: a sleeping core wakes with its stack pointer
    /// there. The exception that wakes it pushes 32 bytes, and its handler more.
    StackOverflow(u8),
    /// A debugger resets the chip by AIRCR, as when it starts new firmware. No schedule has it.
    DebuggerReset,
    /// The core hangs until a reset, at the longest until the end, if the duration is not zero.
    WatchdogHang,
    /// The compass has no supply; it comes back with all registers at reset.
    CompassSilent,
    /// The compass's data registers keep their values, and are reported as new.
    CompassFrozen,
    /// The compass's data and status registers read zero.
    CompassZeros,
    /// A magnet lies on the compass.
    CompassOverflow,
    /// The compass's data and status registers read random bits.
    CompassGarbled,
    /// The compass never reports a measurement.
    CompassNeverReady,
    /// Another chip is in the compass's place: not configured, with this identity.
    CompassIdentity(u8),
    /// The compass holds SCL low whenever it is addressed, until the end of the fault.
    CompassStall,
    /// The supply has only these millivolts. Below 2,700 the flash completes no operation (RM0090,
    /// 3.6.2). Below [`SENSOR_MILLIVOLTS`] the sensor is off, and below [`CORE_MILLIVOLTS`] the
    /// core too: it restarts with the supply. Below
    /// [`RAM_MILLIVOLTS`](crate::ram::RAM_MILLIVOLTS) the RAM loses its content.
    SupplySag(u32),
}

/// The lowest supply of the sensor, mV (MPU-6050 product specification, 6.3).
pub const SENSOR_MILLIVOLTS: u32 = 2_375;
/// The supply below which the chip holds itself in reset, mV (STM32F405 datasheet, "Embedded reset
/// and power control block characteristics": the power-down threshold, 1.68 V).
pub const CORE_MILLIVOLTS: u32 = 1_680;

/// True if a bus error is a flag without a STOP on the lines.
pub type IsFlagAlone = bool;

/// The rest of a byte that a sensor sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RestOfByte {
    /// Clocks until the sensor waits for the acknowledge, 1 to 9.
    pub clocks: u8,
    /// Bits of the byte, the present one first, which is a zero.
    pub bits: u8,
}

/// The direction of a transaction, from the address byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To the sensor.
    Write,
    /// From the sensor.
    Read,
}

/// An axis of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Accelerometer X.
    AccelerometerX,
    /// Accelerometer Y.
    AccelerometerY,
    /// Accelerometer Z.
    AccelerometerZ,
    /// Gyroscope X.
    GyroscopeX,
    /// Gyroscope Y.
    GyroscopeY,
    /// Gyroscope Z.
    GyroscopeZ,
}

impl Axis {
    /// All of them with their names.
    pub const NAMES: [(Self, &'static str); 6] = [
        (Self::AccelerometerX, "ax"),
        (Self::AccelerometerY, "ay"),
        (Self::AccelerometerZ, "az"),
        (Self::GyroscopeX, "gx"),
        (Self::GyroscopeY, "gy"),
        (Self::GyroscopeZ, "gz"),
    ];

    /// Name of the axis in a schedule.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize].1
    }
}

impl FaultKind {
    /// Name of the kind.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::AddressNack(_) => "address-nack",
            Self::DataNack(_) => "data-nack",
            Self::BurstStall => "burst-stall",
            Self::SdaLow(_) => "sda-low",
            Self::SclLow => "scl-low",
            Self::BusError(_) => "bus-error",
            Self::ArbitrationLost => "arbitration-lost",
            Self::DmaError => "dma-error",
            Self::IntMissing => "int-missing",
            Self::IntHigh => "int-high",
            Self::IntLow => "int-low",
            Self::IntGlitch(_) => "int-glitch",
            Self::SensorSilent => "sensor-silent",
            Self::SensorBrownout => "sensor-brownout",
            Self::RegisterFlip(..) => "register-flip",
            Self::Frozen => "frozen",
            Self::Zeros => "zeros",
            Self::Ones => "ones",
            Self::Saturated(_) => "saturated",
            Self::Stuck(_) => "stuck",
            Self::Temperature(_) => "temperature",
            Self::CoreStall => "core-stall",
            Self::UartFlood => "uart-flood",
            Self::UartNoise => "uart-noise",
            Self::ProbeDetach => "probe-detach",
            Self::CrystalDies => "crystal-dies",
            Self::AttitudeLate => "attitude-late",
            Self::Crash => "crash",
            Self::StackOverflow(_) => "stack-overflow",
            Self::DebuggerReset => "debugger-reset",
            Self::WatchdogHang => "watchdog-hang",
            Self::CompassSilent => "compass-silent",
            Self::CompassFrozen => "compass-frozen",
            Self::CompassZeros => "compass-zeros",
            Self::CompassOverflow => "compass-overflow",
            Self::CompassGarbled => "compass-garbled",
            Self::CompassNeverReady => "compass-never-ready",
            Self::CompassIdentity(_) => "compass-identity",
            Self::CompassStall => "compass-stall",
            Self::SupplySag(_) => "supply-sag",
        }
    }
}

impl FaultKind {
    /// Returns true if the fault is one of the compass.
    #[must_use]
    pub fn is_of_compass(&self) -> bool {
        self.name().starts_with("compass-")
    }

    /// Returns true if the fault ends in a reset of the processor.
    #[must_use]
    pub fn resets(&self) -> bool {
        let resets_with_supply_on = matches!(
            self,
            Self::WatchdogHang | Self::Crash | Self::StackOverflow(_) | Self::DebuggerReset
        );
        resets_with_supply_on || self.stops_core()
    }

    /// Returns the classes of which the firmware counts one at least (docs/faults.md). Empty if
    /// the fault leaves no trace, or shows in some flights alone: a stuck axis only in motion.
    #[must_use]
    pub fn counted(&self) -> &'static [FaultClass] {
        use FaultClass as Class;
        match self {
            Self::AddressNack(_) => &[Class::AddressNotAcknowledged],
            Self::DataNack(0) => &[Class::DataNotAcknowledged],
            Self::BurstStall => &[Class::BurstDeadline],
            Self::SdaLow(None) => &[Class::DataLineLow],
            Self::SdaLow(Some(_)) => &[
                Class::BurstDeadline,
                Class::DataLineLow,
                Class::ArbitrationLost,
                Class::BusError,
                Class::AddressNotAcknowledged,
            ],
            Self::SclLow => &[Class::ClockLineLow, Class::BurstDeadline],
            Self::BusError(_) => &[Class::BusError],
            Self::ArbitrationLost => &[Class::ArbitrationLost],
            Self::DmaError => &[Class::Dma],
            Self::IntMissing | Self::IntLow => &[Class::InterruptMissing],
            Self::IntHigh => &[Class::InterruptStuckHigh, Class::InterruptMissing],
            Self::IntGlitch(_) => &[Class::InterruptGlitch],
            Self::SensorSilent => &[Class::AddressNotAcknowledged, Class::SensorSilent],
            Self::SensorBrownout => &[Class::AddressNotAcknowledged, Class::SensorReset],
            Self::RegisterFlip(..) => &[Class::RegisterChanged, Class::SensorReset],
            Self::Frozen => &[Class::Frozen],
            Self::Zeros | Self::Ones => &[Class::Rejected],
            Self::Saturated(_) => &[Class::Saturated],
            Self::Temperature(_) => &[Class::Temperature],
            Self::UartNoise => &[Class::UartInput],
            Self::CrystalDies => &[Class::ClockFailed],
            Self::AttitudeLate => &[Class::AttitudeLate],
            Self::Crash => &[Class::Crash],
            Self::StackOverflow(_) => &[Class::StackOverflow],
            Self::WatchdogHang => &[Class::Watchdog],
            Self::CoreStall => &[Class::SamplesMissed],
            // The firmware may not address the compass in so short a stall.
            Self::CompassStall => &[],
            Self::CompassSilent
            | Self::CompassFrozen
            | Self::CompassZeros
            | Self::CompassOverflow
            | Self::CompassGarbled
            | Self::CompassNeverReady
            | Self::CompassIdentity(_) => &[Class::Compass],
            Self::DataNack(_)
            | Self::Stuck(_)
            | Self::UartFlood
            | Self::ProbeDetach
            | Self::DebuggerReset
            | Self::SupplySag(_) => &[],
        }
    }

    /// Returns true if the core has no supply during the fault.
    #[must_use]
    pub fn stops_core(&self) -> bool {
        matches!(*self, Self::SupplySag(millivolts) if millivolts < CORE_MILLIVOLTS)
    }

    /// Returns true if the sensor has no supply during the fault.
    #[must_use]
    pub fn stops_sensor(&self) -> bool {
        match *self {
            Self::SensorBrownout => true,
            Self::SupplySag(millivolts) => millivolts < SENSOR_MILLIVOLTS,
            _ => false,
        }
    }
}

impl fmt::Display for FaultKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())?;
        match self {
            Self::AddressNack(Some(Direction::Write)) => formatter.write_str(":write"),
            Self::AddressNack(Some(Direction::Read)) => formatter.write_str(":read"),
            Self::DataNack(byte) => write!(formatter, ":{byte}"),
            Self::SdaLow(Some(RestOfByte { clocks, bits: 0 })) => write!(formatter, ":{clocks}"),
            Self::SdaLow(Some(RestOfByte { clocks, bits })) => {
                write!(formatter, ":{clocks}:{bits:#04x}")
            }
            Self::BusError(true) => formatter.write_str(":flag"),
            Self::IntGlitch(hz) => write!(formatter, ":{hz}"),
            Self::RegisterFlip(register, value) => {
                write!(formatter, ":{register:#04x}:{value:#04x}")
            }
            Self::Saturated(axis) | Self::Stuck(axis) => write!(formatter, ":{}", axis.name()),
            Self::Temperature(celsius) => write!(formatter, ":{celsius}"),
            Self::CompassIdentity(identity) => write!(formatter, ":{identity:#04x}"),
            Self::SupplySag(millivolts) => write!(formatter, ":{millivolts}"),
            Self::StackOverflow(room_bytes) => write!(formatter, ":{room_bytes}"),
            _ => Ok(()),
        }
    }
}

/// A fault with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScheduledFault {
    /// Start, ns since power-up.
    pub start_ns: u64,
    /// Duration, ns; zero if it happens once or does not end by itself.
    pub duration_ns: u64,
    /// The kind of fault.
    pub kind: FaultKind,
}

impl ScheduledFault {
    /// Time at which the fault ends by itself, ns since power-up; `u64::MAX` if it does not.
    #[must_use]
    pub fn end_ns(&self) -> u64 {
        let is_endless = matches!(self.kind, FaultKind::CrystalDies | FaultKind::WatchdogHang);
        if is_endless && self.duration_ns == 0 {
            u64::MAX
        } else {
            self.start_ns + self.duration_ns
        }
    }

    /// Returns true if the fault is active at this time.
    #[must_use]
    pub fn lasts(&self, now_ns: u64) -> bool {
        (self.start_ns..self.end_ns()).contains(&now_ns)
    }
}

impl fmt::Display for ScheduledFault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = |nanoseconds: u64| nanoseconds as f64 / 1e9;
        write!(
            formatter,
            "{} {} {}",
            seconds(self.start_ns),
            seconds(self.duration_ns),
            self.kind
        )
    }
}

/// A byte of a bus transaction that the sensor ought to acknowledge.
///
/// Bytes that the sensor sends are acknowledged by the microcontroller, so no fault of the sensor's
/// can refuse them.
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
        /// Start of the fault, s.
        from_s: f64,
        /// Number of bytes.
        count: u32,
    },
    /// The INT wire is stuck at this level for this long.
    InterruptStuck(bool, Range<f64>),
    /// The sensor's supply fails for an instant, so that it restarts asleep.
    SensorReset(f64),
    /// Garbles the bytes that the firmware receives on its UART: so many in a million arrive with
    /// an error.
    ReceptionGarbled {
        /// With noise on a bit.
        noise_per_million: u32,
        /// With a wrong stop bit.
        framing_per_million: u32,
    },
    /// The crystal does not start, or the other chip's clock does not come.
    NoCrystal,
    /// The internal oscillator is off by this share from nominal: +0.01 runs 1 % fast (STM32F405
    /// datasheet, "HSI oscillator characteristics": −0.08 to +0.045 from −40 °C to 105 °C).
    ///
    /// The run's time is that of the core's clock. While the core runs by a fast oscillator, motion
    /// and sensor therefore run slower by this share, and faster by a slow one.
    InternalOscillator(f64),
    /// A START of the sensor's bus takes 0.6 µs, and 1.2 µs in a transfer, instead of no time.
    SlowStart,
    /// After a byte that it did not acknowledge, the port clocks another one at once, instead of
    /// waiting for STOP for a period of SCL. The manual promises no such time (RM0090, 27.3.7).
    NoTimeForStop,
    /// The supply is this low for this long, in millivolts. The sensor works down to 2,375.
    Supply(u32, Range<f64>),
    /// The watchdog's oscillator runs at this frequency, Hz, of 17,000 to 47,000 (STM32F405
    /// datasheet, "LSI oscillator characteristics"). The typical one is 32,000.
    WatchdogClock(u64),
    /// A new limit of the watchdog takes five cycles of the prescaler's output to arrive, instead
    /// of the oscillator's. The manual counts "RC cycles", and ST's HAL waits for six of these.
    SlowWatchdog,
    /// The chip reports this revision in DBGMCU_IDCODE (RM0090, 38.6.1).
    ChipRevision(u16),
    /// The firmware's microsecond timer starts at this count instead of zero.
    TimerStartsAt(u32),
    /// A fault of a schedule.
    Scheduled(ScheduledFault),
}

/// A time in which the supply is lower, s, and the voltage then, mV.
pub type Sag = (Range<f64>, u32);

impl Fault {
    /// Returns the sag of the supply, if the fault is one.
    #[must_use]
    pub fn sag(&self) -> Option<Sag> {
        match self {
            Self::Supply(millivolts, range) => Some((range.clone(), *millivolts)),
            Self::Scheduled(fault) => match fault.kind {
                FaultKind::SupplySag(millivolts) => {
                    let seconds = |ns: u64| ns as f64 * 1e-9;
                    Some((seconds(fault.start_ns)..seconds(fault.end_ns()), millivolts))
                }
                _ => None,
            },
            _ => None,
        }
    }
}

/// The scheduled faults among these.
pub fn scheduled(faults: &[Fault]) -> impl Iterator<Item = &ScheduledFault> {
    faults.iter().filter_map(|fault| match fault {
        Fault::Scheduled(scheduled) => Some(scheduled),
        _ => None,
    })
}

/// The error of the internal oscillator and the time from which the core runs by it, ns, if it does
/// and there is an error.
#[must_use]
pub fn internal_time(faults: &[Fault]) -> Option<(f64, u64)> {
    let error = faults.iter().find_map(|fault| match fault {
        Fault::InternalOscillator(error) => Some(*error),
        _ => None,
    })?;
    let mut dies = scheduled(faults).filter(|fault| fault.kind == FaultKind::CrystalDies);
    let from_ns = if faults.contains(&Fault::NoCrystal) {
        0
    } else {
        dies.next()?.start_ns
    };
    Some((error, from_ns))
}

/// Seconds as nanoseconds since power-up.
#[must_use]
pub fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Returns true if a time is in a range of seconds.
#[must_use]
pub fn within(now_ns: u64, range: &Range<f64>) -> bool {
    (nanoseconds(range.start)..nanoseconds(range.end)).contains(&now_ns)
}
