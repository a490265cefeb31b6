//! Blocking driver: finds and configures the sensor over an `embedded-hal` bus.
//!
//! [`Mpu6050::probe`] finds a supported chip. [`Mpu6050::configure`] resets, wakes and configures
//! it, and reads every setting back. Its last write enables the interrupt, so that no data-ready
//! edge comes from a half-configured sensor. Together they take about 230 ms, nearly all of it
//! waits that the datasheet asks for. The bus itself must limit the time of each transfer.

#[cfg(test)]
mod tests;

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{Error as _, ErrorKind, I2c};

use super::burst::{BURST_LENGTH, Burst, RawSample};
use super::check::{Check, ReadBack, SettingsState};
use super::config::{AccelerometerRange, Config, GyroscopeRange, LowPass};
use super::error::{Error, Operation, ProbeFailure};
use super::part::Part;
use super::registers::{ADDRESSES, Register};
use super::self_test::{AxisTest, SelfTest};
use super::steps::{Step, Steps};

/// Time after power-up until the registers can be accessed, ms (product specification §6.3).
const POWER_UP_MS: u32 = 100;
/// Time between two probes, ms.
const POWER_UP_INTERVAL_MS: u32 = 10;
/// Samples of each of the self-test's two means, 1 ms apart.
const SELF_TEST_SAMPLES: u16 = 200;
/// Means of the gyroscope and the accelerometer, counts.
type MeanCounts = [[f32; 3]; 2];
/// Largest spread of the gyroscope's samples in a mean of a sensor that is kept still, counts:
/// 3 °/s. The noise spreads by 0.5 °/s.
const SELF_TEST_SPREAD_COUNTS: u16 = 3 * 131;
/// Wait before a self-test's mean, ms: much longer than the filter of [`SELF_TEST_CONFIG`] and the
/// deflection take to settle.
const SELF_TEST_SETTLING_MS: u32 = 100;
/// Configuration of the self-test: gyroscope at ±250 °/s, accelerometer at ±8 g (register map
/// §4.1).
const SELF_TEST_CONFIG: Config = Config {
    accelerometer_range: AccelerometerRange::G8,
    gyroscope_range: GyroscopeRange::Degrees250,
    low_pass: LowPass::Hertz98,
    sample_rate_divider: 0,
};

/// Sensor on a bus.
///
/// ```no_run
/// use aplomb::mpu6050::{Config, Mpu6050};
/// use embedded_hal::delay::DelayNs;
/// use embedded_hal::i2c::I2c;
///
/// fn start<I2C: I2c>(i2c: I2C, delay: &mut impl DelayNs) -> Option<Mpu6050<I2C>> {
///     let mut sensor = Mpu6050::probe(i2c, delay).ok()?;
///     sensor.configure(&Config::default(), delay).ok()?;
///     Some(sensor)
/// }
/// ```
#[derive(Debug)]
pub struct Mpu6050<I2C> {
    i2c: I2C,
    address: u8,
    part: &'static Part,
}

impl<I2C: I2c> Mpu6050<I2C> {
    /// Searches both addresses for a supported part.
    ///
    /// Repeats the search for 100 ms, because the sensor may power up together with the processor.
    /// Any failure is repeated: Linux reports a sensor that does not acknowledge as another error.
    /// An unknown chip at the first address, such as a clock, does not hide a sensor at the second.
    ///
    /// # Errors
    ///
    /// Returns the error of the last search: [`Error::NotFound`] if no chip answers,
    /// [`Error::UnknownIdentity`] if only an unknown one does, [`Error::Bus`] if the bus fails. The
    /// failure holds the bus.
    pub fn probe(i2c: I2C, delay: &mut impl DelayNs) -> Result<Self, ProbeFailure<I2C>> {
        let mut result = Self::probe_once(i2c);
        for _ in 0..POWER_UP_MS / POWER_UP_INTERVAL_MS {
            let Err(failure) = result else { break };
            delay.delay_ms(POWER_UP_INTERVAL_MS);
            result = Self::probe_once(failure.i2c);
        }
        result
    }

    /// Resets and configures the sensor, in 230 ms. Data-ready pulses begin as it returns.
    ///
    /// The sequence is the datasheet's. Reset, 100 ms, verify; wake, reset the signal paths, 100
    /// ms. Clock from the gyroscope, 30 ms for its zero-rate output to settle. Then the settings,
    /// and the data-ready interrupt last. It can be repeated at any time.
    ///
    /// # Errors
    ///
    /// Returns [`Error::ResetFailed`], [`Error::Readback`] or [`Error::Bus`]. The state of the
    /// sensor is undefined then; the next call starts over.
    pub fn configure(
        &mut self,
        config: &Config,
        delay: &mut impl DelayNs,
    ) -> Result<(), Error<I2C::Error>> {
        self.run(Step::configuration(config, self.part), delay)
    }

    /// Configures a sensor that has just reset itself, or that lost one setting.
    ///
    /// Works like [`configure`](Self::configure), without the device reset and its 200 ms. It takes
    /// about 35 ms, nearly all of it for the gyroscope's start.
    ///
    /// # Errors
    ///
    /// Returns the errors of [`configure`](Self::configure).
    pub fn reconfigure(
        &mut self,
        config: &Config,
        delay: &mut impl DelayNs,
    ) -> Result<(), Error<I2C::Error>> {
        self.run(Step::reconfiguration(config, self.part), delay)
    }

    /// Reads every setting back and compares it with the configuration.
    ///
    /// # Errors
    ///
    /// Returns [`Error::Bus`] if a transfer fails.
    pub fn verify_config(&mut self, config: &Config) -> Result<SettingsState, Error<I2C::Error>> {
        Ok(self.read_back(config)?.settings)
    }

    /// Reads every setting back, for people.
    ///
    /// # Errors
    ///
    /// Returns [`Error::Bus`] if a transfer fails.
    pub fn read_back(&mut self, config: &Config) -> Result<ReadBack, Error<I2C::Error>> {
        let mut settings = SettingsState::Intact;
        let mut registers = Check::all(config, self.part)
            .map(|check| (check.first, check.length, [0; Check::LONGEST]));
        for (check, (first, length, bytes)) in
            Check::all(config, self.part).iter().zip(&mut registers)
        {
            let (read, _) = bytes.split_at_mut((*length).min(Check::LONGEST));
            self::read(&mut self.i2c, self.address, *first, read)?;
            match check.evaluate(bytes) {
                SettingsState::Intact => {}
                // A reset explains every other difference.
                _ if settings == SettingsState::Reset => {}
                other => settings = other,
            }
        }
        Ok(ReadBack {
            part: self.part,
            settings,
            registers,
        })
    }

    /// Searches both addresses for a supported part, once.
    ///
    /// # Errors
    ///
    /// Returns the errors of [`probe`](Self::probe).
    pub fn probe_once(mut i2c: I2C) -> Result<Self, ProbeFailure<I2C>> {
        let error = match probe_addresses(&mut i2c) {
            Ok(Some((address, part))) => return Ok(Self { i2c, address, part }),
            Ok(None) => Error::NotFound,
            Err(error) => error,
        };
        Err(ProbeFailure { i2c, error })
    }

    /// Runs the datasheet's self-test, for about 0.9 s. The sensor must be stationary meanwhile.
    ///
    /// Leaves the sensor with other ranges and without interrupts: call
    /// [`configure`](Self::configure) afterwards.
    ///
    /// # Errors
    ///
    /// Returns the errors of [`configure`](Self::configure). A wrong response is not an error: the
    /// result reports it.
    pub fn self_test(&mut self, delay: &mut impl DelayNs) -> Result<SelfTest, Error<I2C::Error>> {
        self.run(Step::before_self_test(&SELF_TEST_CONFIG, self.part), delay)?;
        let mut codes = [0; 4];
        if self.part.has_self_test_trim {
            read(&mut self.i2c, self.address, Register::SelfTestX, &mut codes)?;
        }
        delay.delay_ms(SELF_TEST_SETTLING_MS);
        let (off, moved_before) = self.mean_counts(delay)?;
        self.run(Step::self_test(&SELF_TEST_CONFIG, self.part), delay)?;
        delay.delay_ms(SELF_TEST_SETTLING_MS);
        let (on, moved_after) = self.mean_counts(delay)?;
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
            has_moved: moved_before || moved_after,
        })
    }

    /// Reads one sample, for processors that read bursts without DMA. `captured_at_us` is the time
    /// of its data-ready edge, µs since start.
    ///
    /// # Errors
    ///
    /// Returns [`Error::Bus`] if the transfer fails.
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

    /// Returns the part that answered.
    pub const fn part(&self) -> &'static Part {
        self.part
    }

    /// Returns the bus address, 7 bits.
    pub const fn address(&self) -> u8 {
        self.address
    }

    /// Returns the bus.
    pub fn release(self) -> I2C {
        self.i2c
    }

    /// Returns the mean of [`SELF_TEST_SAMPLES`] samples, counts: gyroscope, accelerometer. The
    /// second value is true if the sensor moved meanwhile.
    fn mean_counts(
        &mut self,
        delay: &mut impl DelayNs,
    ) -> Result<(MeanCounts, bool), Error<I2C::Error>> {
        let mut sums = [[0_i32; 3]; 2];
        let (mut least, mut most) = ([i16::MAX; 3], [i16::MIN; 3]);
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
            for ((least, most), count) in least.iter_mut().zip(&mut most).zip(sample.gyroscope.0) {
                *least = (*least).min(count);
                *most = (*most).max(count);
            }
            delay.delay_ms(1);
        }
        let has_moved = least
            .into_iter()
            .zip(most)
            .any(|(least, most)| most.abs_diff(least) > SELF_TEST_SPREAD_COUNTS);
        let means = sums.map(|sum| sum.map(|sum| sum as f32 / f32::from(SELF_TEST_SAMPLES)));
        Ok((means, has_moved))
    }

    /// Runs steps, and reads back every register that keeps its value.
    #[inline(never)]
    fn run(&mut self, mut steps: Steps, delay: &mut impl DelayNs) -> Result<(), Error<I2C::Error>> {
        steps.try_for_each(|step| self.run_step(step, delay))
    }

    fn run_step(&mut self, step: Step, delay: &mut impl DelayNs) -> Result<(), Error<I2C::Error>> {
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

/// Probes both addresses once; `None` if no chip acknowledged.
fn probe_addresses<I2C: I2c>(
    i2c: &mut I2C,
) -> Result<Option<(u8, &'static Part)>, Error<I2C::Error>> {
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
