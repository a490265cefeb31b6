//! Finding and configuring the sensor over a blocking `embedded-hal` bus.
//!
//! Two steps: [`Mpu6050::probe`] finds out who is there, [`Mpu6050::configure`] resets it, wakes it
//! and sets it up; the interrupt is enabled by its very last write, so no data-ready edge comes
//! from a half-configured sensor. Every setting is read back and compared. Together the two take
//! about 230 ms, nearly all of it waiting as the datasheet asks; a deadline on each bus transfer is
//! the bus's own business.

use core::fmt;

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{self, Error as _, ErrorKind, ErrorType, I2c, NoAcknowledgeSource};

use super::burst::{BURST_LENGTH, Burst, RawSample};
use super::check::{Check, Condition};
use super::config::{AccelerometerRange, Config, GyroscopeRange, LowPass};
use super::part::{PARTS, Part};
use super::registers::Register;
use super::self_test::{AxisTest, SelfTest};
use super::steps::{Step, Steps};

/// The two bus addresses, with the AD0 pin low and high (product specification §9.2).
pub const ADDRESSES: [u8; 2] = [0x68, 0x69];

/// Register access may take this long after power-up (product specification §6.3): ten looks, 10 ms
/// apart, cover it.
const POWER_UP_LOOKS: u32 = 10;
const POWER_UP_INTERVAL_MS: u32 = 10;
/// Samples that each of the self-test's two readings is a mean of, 1 ms apart.
const SELF_TEST_SAMPLES: u16 = 200;
/// The filter of [`SELF_TEST_CONFIG`] and the deflection itself settle in much less than this.
const SELF_TEST_SETTLING_MS: u32 = 100;
/// Gyroscope at ±250 °/s, accelerometer at ±8 g (register map §4.1).
const SELF_TEST_CONFIG: Config = Config {
    accelerometer_range: AccelerometerRange::G8,
    gyroscope_range: GyroscopeRange::Degrees250,
    low_pass: LowPass::Hertz98,
    sample_rate_divider: 0,
};

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
        self.take(Step::configuration(config, self.part), delay)
    }

    /// Sets up a sensor that has just reset itself, or that lost one setting: as
    /// [`configure`](Self::configure), without the device reset and the 200 ms that go with it. It takes
    /// about 35 ms, nearly all of it for the gyroscope's start.
    ///
    /// # Errors
    ///
    /// As of [`configure`](Self::configure).
    pub fn configure_again(
        &mut self,
        config: &Config,
        delay: &mut impl DelayNs,
    ) -> Result<(), Error<I2C::Error>> {
        self.take(Step::configuration_again(config, self.part), delay)
    }

    /// Reads every setting back.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`] if a transfer fails.
    pub fn inspect(&mut self, config: &Config) -> Result<Condition, Error<I2C::Error>> {
        let mut condition = Condition::Intact;
        for check in Check::all(config, self.part) {
            let mut bytes = [0; Check::LONGEST];
            let (read, _) = bytes.split_at_mut(check.length.min(Check::LONGEST));
            self::read(&mut self.i2c, self.address, check.first, read)?;
            match check.of(&bytes) {
                Condition::Intact => {}
                Condition::Reset => return Ok(Condition::Reset),
                Condition::Changed => condition = Condition::Changed,
            }
        }
        Ok(condition)
    }

    /// Looks for a known part once, at both addresses.
    ///
    /// # Errors
    ///
    /// As of [`probe`](Self::probe).
    pub fn look(mut i2c: I2C) -> Result<Self, ProbeFailure<I2C>> {
        let error = match look_once(&mut i2c) {
            Ok(Some((address, part))) => return Ok(Self { i2c, address, part }),
            Ok(None) => Error::NotFound,
            Err(error) => error,
        };
        Err(ProbeFailure { i2c, error })
    }

    /// Does the datasheet's self-test; the sensor has to rest meanwhile, for about 0.9 s.
    ///
    /// It leaves the sensor without interrupts and at other ranges: call [`configure`](Self::configure) after it.
    ///
    /// # Errors
    ///
    /// Those of [`configure`](Self::configure). A response that is wrong is no error but in the result.
    pub fn self_test(&mut self, delay: &mut impl DelayNs) -> Result<SelfTest, Error<I2C::Error>> {
        self.take(Step::before_self_test(&SELF_TEST_CONFIG, self.part), delay)?;
        let mut codes = [0; 4];
        if self.part.has_self_test_trim {
            read(&mut self.i2c, self.address, Register::SelfTestX, &mut codes)?;
        }
        delay.delay_ms(SELF_TEST_SETTLING_MS);
        let off = self.mean_counts(delay)?;
        self.take(Step::self_test(&SELF_TEST_CONFIG, self.part), delay)?;
        delay.delay_ms(SELF_TEST_SETTLING_MS);
        let on = self.mean_counts(delay)?;
        let mut axes =
            on.into_iter()
                .zip(off)
                .zip(SelfTest::trims(codes))
                .map(|((on, off), trims)| {
                    let [x, y, z] = on;
                    let [off_x, off_y, off_z] = off;
                    let [trim_x, trim_y, trim_z] = trims;
                    [(x, off_x, trim_x), (y, off_y, trim_y), (z, off_z, trim_z)].map(
                        |(on, off, trim_counts)| AxisTest {
                            response_counts: on - off,
                            trim_counts,
                        },
                    )
                });
        let none = [AxisTest {
            response_counts: 0.0,
            trim_counts: None,
        }; 3];
        Ok(SelfTest {
            gyroscope: axes.next().unwrap_or(none),
            accelerometer: axes.next().unwrap_or(none),
        })
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

    /// The mean of some samples, in counts: gyroscope, accelerometer.
    fn mean_counts(
        &mut self,
        delay: &mut impl DelayNs,
    ) -> Result<[[f32; 3]; 2], Error<I2C::Error>> {
        let mut sums = [[0_i32; 3]; 2];
        for _ in 0..SELF_TEST_SAMPLES {
            let sample = RawSample::decode(&self.read_burst(0)?.bytes);
            for (sum, counts) in sums
                .iter_mut()
                .zip([sample.gyroscope.0, sample.accelerometer.0])
            {
                for (sum, count) in sum.iter_mut().zip(counts) {
                    *sum += i32::from(count);
                }
            }
            delay.delay_ms(1);
        }
        Ok(sums.map(|sum| sum.map(|sum| sum as f32 / f32::from(SELF_TEST_SAMPLES))))
    }

    /// Takes these steps, and reads each register back that keeps what is written to it.
    #[inline(never)]
    fn take(
        &mut self,
        mut steps: Steps,
        delay: &mut impl DelayNs,
    ) -> Result<(), Error<I2C::Error>> {
        steps.try_for_each(|step| self.take_one(step, delay))
    }

    fn take_one(&mut self, step: Step, delay: &mut impl DelayNs) -> Result<(), Error<I2C::Error>> {
        let register = step.register;
        let kept = if step.mask == u8::MAX {
            0
        } else {
            self.read(register)? & !step.mask
        };
        let written = kept | step.value;
        self.write(register, written)?;
        let address = self.address;
        if step.is_device_reset() {
            delay.delay_ms(step.wait_ms);
            let read = self.read(register)?;
            return if self.part.power_after_reset.contains(&read) {
                Ok(())
            } else {
                Err(Error::ResetFailed { address, read })
            };
        }
        if step.reads_back() {
            let read = self.read(register)?;
            if read != written {
                return Err(Error::Readback {
                    address,
                    register,
                    written,
                    read,
                });
            }
        }
        if step.wait_ms > 0 {
            delay.delay_ms(step.wait_ms);
        }
        Ok(())
    }

    #[inline(never)]
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

/// Why a transfer failed, in words that fit into a sentence.
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

#[inline(never)]
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

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::rc::Rc;

    use embedded_hal::i2c::Operation as BusOperation;

    use super::*;
    use crate::mpu6050::{AccelerometerRange, GyroscopeRange, LowPass};

    /// What happened on the bus and beside it, in order.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    enum Event {
        Write(u8, u8),
        Read(u8),
        WaitMs(u32),
    }
    use Event::{Read, WaitMs, Write};

    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    enum FakeError {
        Nack,
        Arbitration,
    }

    impl embedded_hal::i2c::Error for FakeError {
        fn kind(&self) -> ErrorKind {
            match self {
                Self::Nack => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
                Self::Arbitration => ErrorKind::ArbitrationLoss,
            }
        }
    }

    /// A sensor that knows the datasheet and nothing of the driver's tables.
    struct Sensor {
        /// Where it sits, and its identity; more than one for a bus with other chips.
        chips: Vec<(u8, u8)>,
        registers: [u8; 128],
        power_after_reset: u8,
        milliseconds: u32,
        reset_done_at_ms: u32,
        /// Bits of a register that do not take.
        stuck: Option<(u8, u8)>,
        /// The transactions that fail, and how.
        failures: Box<dyn Fn(usize) -> Option<FakeError>>,
        transactions: usize,
        log: Vec<Event>,
    }

    impl Sensor {
        fn new(address: u8, who_am_i: u8) -> Self {
            let mut sensor = Self {
                chips: vec![(address, who_am_i)],
                registers: [0; 128],
                power_after_reset: if matches!(who_am_i, 0x70 | 0x71 | 0x73) {
                    0x01
                } else {
                    0x40
                },
                milliseconds: 0,
                reset_done_at_ms: 0,
                stuck: None,
                failures: Box::new(|_| None),
                transactions: 0,
                log: Vec::new(),
            };
            sensor.reset();
            // As a crashed program may have left it, so that only a reset helps; the reserved bits
            // of the full-scale registers come up set after it in this sensor.
            sensor.registers[0x38] = 0x01;
            sensor.registers[0x37] = 0xB0;
            sensor
        }

        fn reset(&mut self) {
            self.registers = [0; 128];
            self.registers[0x1B] = 0xE7;
            self.registers[0x1C] = 0x05;
            self.registers[0x1A] = 0x80;
            self.registers[0x1D] = 0xC8;
            self.registers[0x6B] = self.power_after_reset;
        }

        fn transfer(
            &mut self,
            address: u8,
            operations: &mut [BusOperation<'_>],
        ) -> Result<(), FakeError> {
            let index = self.transactions;
            self.transactions += 1;
            if let Some(error) = (self.failures)(index) {
                return Err(error);
            }
            let Some(&(_, who_am_i)) = self.chips.iter().find(|chip| chip.0 == address) else {
                return Err(FakeError::Nack);
            };
            let mut pointer = 0;
            for operation in operations {
                match operation {
                    BusOperation::Write([register, values @ ..]) => {
                        pointer = *register;
                        for value in values.iter() {
                            self.log.push(Write(pointer, *value));
                            self.write(pointer, *value);
                            pointer += 1;
                        }
                    }
                    BusOperation::Write([]) => {}
                    BusOperation::Read(values) => {
                        self.log.push(Read(pointer));
                        for value in values.iter_mut() {
                            *value = match pointer {
                                0x75 => who_am_i,
                                _ => self.registers[usize::from(pointer)],
                            };
                            pointer += 1;
                        }
                    }
                }
            }
            Ok(())
        }

        fn write(&mut self, register: u8, value: u8) {
            let slot = &mut self.registers[usize::from(register)];
            match (register, value) {
                (0x6B, value) if value & 0x80 != 0 => {
                    *slot = 0x80;
                    self.reset_done_at_ms = self.milliseconds + 100;
                }
                (0x68, _) => *slot = 0,
                _ => {
                    let stuck = match self.stuck {
                        Some((stuck_register, bits)) if stuck_register == register => bits,
                        _ => 0,
                    };
                    *slot = (value & !stuck) | (*slot & stuck);
                }
            }
        }

        fn wait(&mut self, milliseconds: u32) {
            self.log.push(WaitMs(milliseconds));
            self.milliseconds += milliseconds;
            if self.registers[0x6B] & 0x80 != 0 && self.milliseconds >= self.reset_done_at_ms {
                self.reset();
            }
        }
    }

    #[derive(Clone)]
    struct Bench(Rc<RefCell<Sensor>>);

    impl Bench {
        fn new(sensor: Sensor) -> Self {
            Self(Rc::new(RefCell::new(sensor)))
        }

        fn probe(&self) -> Result<Mpu6050<Self>, ProbeFailure<Self>> {
            Mpu6050::probe(self.clone(), &mut self.clone())
        }

        fn probe_error(&self) -> Error<FakeError> {
            match self.probe() {
                Ok(_) => panic!("found something"),
                Err(failure) => failure.error,
            }
        }

        fn register(&self, register: usize) -> u8 {
            self.0.borrow().registers[register]
        }
    }

    impl ErrorType for Bench {
        type Error = FakeError;
    }

    impl I2c for Bench {
        fn transaction(
            &mut self,
            address: u8,
            operations: &mut [BusOperation<'_>],
        ) -> Result<(), FakeError> {
            self.0.borrow_mut().transfer(address, operations)
        }
    }

    impl DelayNs for Bench {
        fn delay_ns(&mut self, nanoseconds: u32) {
            self.delay_ms(nanoseconds / 1_000_000);
        }

        fn delay_ms(&mut self, milliseconds: u32) {
            self.0.borrow_mut().wait(milliseconds);
        }
    }

    const UNUSUAL: Config = Config {
        accelerometer_range: AccelerometerRange::G4,
        gyroscope_range: GyroscopeRange::Degrees1000,
        low_pass: LowPass::Hertz20,
        sample_rate_divider: 9,
    };

    #[test]
    fn the_sequence_is_the_datasheets() {
        let bench = Bench::new(Sensor::new(0x68, 0x68));
        let mut sensor = bench.probe().expect("a sensor");
        assert_eq!(sensor.address(), 0x68);
        assert_eq!(sensor.part().name, "MPU-6050");
        sensor
            .configure(&Config::default(), &mut bench.clone())
            .expect("configured");
        let expected = [
            Read(0x75),
            // Reset, wait, verify.
            Write(0x6B, 0x80),
            WaitMs(100),
            Read(0x6B),
            // Wake, reset the signal paths.
            Write(0x6B, 0x00),
            Read(0x6B),
            Write(0x68, 0x07),
            WaitMs(100),
            // The gyroscope's clock, and its settling.
            Write(0x6B, 0x01),
            Read(0x6B),
            WaitMs(30),
            // Sample rate, filter, ranges: other bits of theirs are kept.
            Write(0x19, 0x00),
            Read(0x19),
            Read(0x1A),
            Write(0x1A, 0x81),
            Read(0x1A),
            Read(0x1B),
            Write(0x1B, 0x1F),
            Read(0x1B),
            Read(0x1C),
            Write(0x1C, 0x1D),
            Read(0x1C),
            // The pin, and the interrupt last.
            Write(0x37, 0x00),
            Read(0x37),
            Write(0x38, 0x01),
            Read(0x38),
        ];
        assert_eq!(bench.0.borrow().log, expected);
    }

    #[test]
    fn settings_reach_their_bits_in_every_part() {
        for part in &PARTS {
            let bench = Bench::new(Sensor::new(0x68, part.who_am_i));
            let mut sensor = bench.probe().expect(part.name);
            assert_eq!(sensor.part(), part);
            sensor
                .configure(&UNUSUAL, &mut bench.clone())
                .expect(part.name);
            assert_eq!(bench.register(0x19), 9);
            assert_eq!(bench.register(0x1A), 0x84);
            assert_eq!(bench.register(0x1B), 0x17);
            assert_eq!(bench.register(0x1C), 0x0D);
            let has_own_filter = matches!(part.who_am_i, 0x70 | 0x71 | 0x73 | 0x98);
            let expected = if has_own_filter { 0xC4 } else { 0xC8 };
            assert_eq!(bench.register(0x1D), expected, "{}", part.name);
            assert_eq!(bench.register(0x37), 0x00);
            assert_eq!(bench.register(0x38), 0x01);
            assert_eq!(bench.register(0x6B), 0x01);
        }
    }

    #[test]
    fn the_second_address_is_found_past_a_stranger() {
        let mut chips = Sensor::new(0x69, 0x68);
        chips.chips.push((0x68, 0x13));
        for sensor in [Sensor::new(0x69, 0x68), chips] {
            let bench = Bench::new(sensor);
            let mut found = bench.probe().expect("a sensor");
            assert_eq!(found.address(), 0x69);
            found
                .configure(&Config::default(), &mut bench.clone())
                .expect("configured");
            assert_eq!(found.release().0.borrow().registers[0x38], 0x01);
        }
    }

    #[test]
    fn an_unknown_identity_is_named_with_its_address() {
        for address in ADDRESSES {
            let bench = Bench::new(Sensor::new(address, 0x13));
            let error = bench.probe_error();
            let expected = Error::UnknownIdentity {
                address,
                who_am_i: 0x13,
            };
            assert_eq!(error, expected);
            let text = error.to_string();
            assert!(text.contains(&format!("0x{address:02x}")), "{text}");
            assert!(text.contains("0x13"), "{text}");
            assert!(text.contains("0x68 0x70 0x71 0x72 0x73 0x98"), "{text}");
        }
    }

    #[test]
    fn an_empty_bus_is_looked_at_for_as_long_as_power_up_takes() {
        let bench = Bench::new(Sensor::new(0x42, 0x68));
        let error = bench.probe_error();
        assert_eq!(error, Error::NotFound);
        let text = error.to_string();
        assert!(text.contains("0x68") && text.contains("0x69"), "{text}");
        let sensor = bench.0.borrow();
        assert_eq!(sensor.milliseconds, 90);
        assert_eq!(sensor.transactions, 20);
    }

    #[test]
    fn a_sensor_that_is_still_powering_up_is_found() {
        let mut sensor = Sensor::new(0x68, 0x68);
        sensor.failures = Box::new(|index| (index < 10).then_some(FakeError::Nack));
        let bench = Bench::new(sensor);
        assert!(bench.probe().is_ok());
        assert_eq!(bench.0.borrow().milliseconds, 50);
    }

    #[test]
    fn a_broken_bus_is_not_an_absent_sensor() {
        let mut sensor = Sensor::new(0x68, 0x68);
        sensor.failures = Box::new(|_| Some(FakeError::Arbitration));
        let bench = Bench::new(sensor);
        let expected = Error::Bus {
            operation: Operation::Read,
            register: Register::WhoAmI,
            address: 0x68,
            source: FakeError::Arbitration,
        };
        assert_eq!(bench.probe_error(), expected);
        assert_eq!(
            expected.to_string(),
            "reading WHO_AM_I (0x75) at 0x68 failed: arbitration lost: check the wiring"
        );
        // The bus comes back for another try.
        let Err(failure) = bench.probe() else {
            panic!("found something");
        };
        failure.i2c.0.borrow_mut().failures = Box::new(|_| None);
        assert!(bench.probe().is_ok());
    }

    #[test]
    fn one_failure_anywhere_is_reported_and_repaired_by_another_try() {
        for who_am_i in [0x68, 0x70] {
            let good = Bench::new(Sensor::new(0x68, who_am_i));
            let mut sensor = good.probe().expect("a sensor");
            sensor
                .configure(&UNUSUAL, &mut good.clone())
                .expect("configured");
            let transactions = good.0.borrow().transactions;
            assert_eq!(transactions, if who_am_i == 0x68 { 23 } else { 26 });

            for failing in 0..transactions {
                for failure in [FakeError::Nack, FakeError::Arbitration] {
                    let mut sensor = Sensor::new(0x68, who_am_i);
                    sensor.failures = Box::new(move |index| (index == failing).then_some(failure));
                    let bench = Bench::new(sensor);
                    let mut sensor = match bench.probe() {
                        Ok(sensor) => sensor,
                        Err(_) => bench.probe().expect("a second try"),
                    };
                    let first = sensor.configure(&UNUSUAL, &mut bench.clone());
                    // A failure of the identity is over by then; any later one must be told.
                    match first {
                        Ok(()) => assert_eq!(failing, 0),
                        Err(Error::Bus {
                            address, source, ..
                        }) => assert_eq!((address, source), (0x68, failure)),
                        Err(error) => panic!("transaction {failing}: {error}"),
                    }
                    sensor
                        .configure(&UNUSUAL, &mut bench.clone())
                        .expect("a second try");
                    assert_eq!(bench.0.borrow().registers, good.0.borrow().registers);
                }
            }
        }
    }

    #[test]
    fn a_sensor_that_goes_away_at_any_point_is_an_error() {
        for last_good in 0..23 {
            let mut sensor = Sensor::new(0x68, 0x68);
            sensor.failures = Box::new(move |index| (index > last_good).then_some(FakeError::Nack));
            let bench = Bench::new(sensor);
            let mut sensor = bench.probe().expect("a sensor");
            let result = sensor.configure(&UNUSUAL, &mut bench.clone());
            assert_eq!(result.is_ok(), last_good == 22, "{last_good}");
        }
    }

    #[test]
    fn a_bus_error_says_what_was_done() {
        let mut sensor = Sensor::new(0x69, 0x68);
        // Two looks, the reset and its check; then waking it fails.
        sensor.failures = Box::new(|index| (index == 4).then_some(FakeError::Nack));
        let bench = Bench::new(sensor);
        let mut sensor = bench.probe().expect("a sensor");
        let error = sensor
            .configure(&UNUSUAL, &mut bench.clone())
            .expect_err("a failure");
        assert_eq!(
            error.to_string(),
            "writing PWR_MGMT_1 (0x6b) at 0x69 failed: not acknowledged: check the wiring"
        );
    }

    #[test]
    fn a_register_that_does_not_keep_its_value_is_named() {
        for (register, bits) in [
            (0x6B, 0x01),
            (0x19, 0x08),
            (0x1A, 0x04),
            (0x1B, 0x10),
            (0x1C, 0x08),
            (0x1D, 0x04),
            (0x38, 0x01),
        ] {
            let mut sensor = Sensor::new(0x68, 0x70);
            sensor.stuck = Some((register, bits));
            // So that it is the last write of this register that cannot take.
            sensor.power_after_reset = 0x40;
            let bench = Bench::new(sensor);
            let mut sensor = bench.probe().expect("a sensor");
            let error = sensor
                .configure(&UNUSUAL, &mut bench.clone())
                .expect_err("a mismatch");
            let Error::Readback {
                address,
                register: named,
                written,
                read,
            } = error
            else {
                panic!("register 0x{register:02x}: {error}");
            };
            assert_eq!((address, named.address()), (0x68, register));
            assert_eq!(written ^ read, bits, "register 0x{register:02x}");
            let text = error.to_string();
            for part in [
                named.name(),
                &format!("0x{register:02x}"),
                &format!("wrote 0x{written:02x}"),
                &format!("read 0x{read:02x}"),
            ] {
                assert!(text.contains(part), "{text}");
            }
            // Nothing pulses the pin before everything else is right.
            if register != 0x38 {
                assert_eq!(bench.register(0x38), 0x00);
            }
        }
    }

    #[test]
    fn a_reset_without_effect_is_an_error() {
        for power in [0x80, 0x00, 0xFF, 0x01] {
            let mut sensor = Sensor::new(0x68, 0x68);
            sensor.power_after_reset = power;
            let bench = Bench::new(sensor);
            let mut sensor = bench.probe().expect("a sensor");
            let result = sensor.configure(&UNUSUAL, &mut bench.clone());
            let expected = Error::ResetFailed {
                address: 0x68,
                read: power,
            };
            assert_eq!(result, Err(expected));
            assert!(expected.to_string().contains(&format!("0x{power:02x}")));
        }
    }

    #[test]
    fn a_sensor_that_lost_its_settings_gets_them_back_without_a_reset() {
        for who_am_i in [0x68, 0x70] {
            let good = Bench::new(Sensor::new(0x68, who_am_i));
            let mut sensor = good.probe().expect("a sensor");
            sensor
                .configure(&UNUSUAL, &mut good.clone())
                .expect("configured");
            assert_eq!(sensor.inspect(&UNUSUAL), Ok(Condition::Intact));
            for (register, bits, condition) in [
                (0x19, 0x01, Condition::Changed),
                (0x1A, 0x01, Condition::Changed),
                (0x1B, 0x08, Condition::Changed),
                (0x1C, 0x10, Condition::Changed),
                (0x37, 0x80, Condition::Changed),
                (0x38, 0x01, Condition::Changed),
                (0x6B, 0x40, Condition::Reset),
                (0x6C, 0x04, Condition::Changed),
            ] {
                let bench = Bench::new(Sensor::new(0x68, who_am_i));
                let mut sensor = bench.probe().expect("a sensor");
                sensor
                    .configure(&UNUSUAL, &mut bench.clone())
                    .expect("configured");
                bench.0.borrow_mut().registers[register] ^= bits;
                assert_eq!(sensor.inspect(&UNUSUAL), Ok(condition), "0x{register:02x}");
                let before = bench.0.borrow().milliseconds;
                sensor
                    .configure_again(&UNUSUAL, &mut bench.clone())
                    .expect("configured again");
                assert_eq!(bench.0.borrow().milliseconds - before, 30);
                assert_eq!(sensor.inspect(&UNUSUAL), Ok(Condition::Intact));
                assert_eq!(bench.0.borrow().registers, good.0.borrow().registers);
            }
        }
    }

    #[test]
    fn a_burst_is_read_in_one_transfer() {
        let bench = Bench::new(Sensor::new(0x68, 0x68));
        let mut sensor = bench.probe().expect("a sensor");
        for (index, register) in (0x3B..=0x48).enumerate() {
            bench.0.borrow_mut().registers[register] = 100 + index as u8;
        }
        let before = bench.0.borrow().transactions;
        let burst = sensor.read_burst(123).expect("a burst");
        assert_eq!(bench.0.borrow().transactions, before + 1);
        let expected: Vec<u8> = (100..114).collect();
        assert_eq!(burst.bytes.to_vec(), expected);
        assert_eq!((burst.captured_at_us, burst.missed_before), (123, 0));
    }
}
