//! Bringing the sensor up, and bringing it back: what the idle task does while the burst reader is
//! off.
//!
//! At power-up the sensor gets the datasheet's whole sequence, 230 ms. Later it gets no more than
//! it needs: nothing if its registers still hold what they should, and 35 ms of waking and setting
//! if it has reset itself or lost a setting. One attempt takes at most 10 ms where the sensor does
//! not answer.

use embedded_hal::i2c::ErrorKind;

use super::sensor_bus::{BusHeldLow, SensorBus};
use super::timebase::Delay;
use super::{burst_reader, retained};
use crate::fault::FaultClass;
use crate::mpu6050::{Condition, Config, Error, Mpu6050, Part, SelfTest};

/// Pause between two attempts, in ms: recovery is due 20 ms after the end of a fault.
pub const RETRY_MS: u32 = 5;

/// A sensor that is powered up together with the processor answers 100 ms later at most (product
/// specification §6.3).
const LOOKS_WHILE_STARTING: u32 = 100 / RETRY_MS;

/// So often in a row is setting it again tried before the whole sequence is, reset included.
const TRIES_WITHOUT_RESET: u8 = 3;

/// A sensor that is ready.
#[derive(Clone, Copy)]
pub struct Ready {
    /// Which part it is.
    pub part: &'static Part,
    /// Its address on the bus, 7 bits.
    pub address: u8,
}

/// Why there is no sensor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum NotReady {
    /// A line of its bus is low.
    BusHeldLow(BusHeldLow),
    /// It does not answer, or not as it should.
    Sensor(Error<ErrorKind>),
}

/// The sensor, as far as it has been brought up.
pub struct Sensor {
    bus: SensorBus,
    config: Config,
    /// True if it has had the whole sequence in this run or the one before.
    is_known: bool,
    failures: u8,
    silent_looks: u32,
}

impl Sensor {
    /// A sensor on this bus. `is_known` says that the run before has brought it up.
    pub fn new(bus: SensorBus, config: Config, is_known: bool) -> Self {
        Self {
            bus,
            config,
            is_known,
            failures: 0,
            silent_looks: 0,
        }
    }

    /// Frees the bus and makes the sensor ready.
    ///
    /// # Errors
    ///
    /// [`NotReady`] says what stands in the way; try again in [`RETRY_MS`].
    pub fn make_ready(&mut self) -> Result<Ready, NotReady> {
        let result = self.attempt();
        match result {
            Ok(_) => {
                self.is_known = true;
                self.failures = 0;
                self.silent_looks = 0;
            }
            Err(NotReady::BusHeldLow(held)) => retained::count(if held.clock {
                FaultClass::ClockLineLow
            } else {
                FaultClass::DataLineLow
            }),
            Err(NotReady::Sensor(Error::NotFound)) => {
                self.silent_looks = self.silent_looks.saturating_add(1);
                if self.is_known || !self.may_be_starting() {
                    retained::count(FaultClass::SensorSilent);
                }
            }
            // The bus is at fault, and no reset of the sensor mends it.
            Err(NotReady::Sensor(Error::Bus { .. })) => {}
            Err(NotReady::Sensor(_)) => {
                self.failures = self.failures.saturating_add(1);
                if self.failures >= TRIES_WITHOUT_RESET {
                    self.is_known = false;
                    self.failures = 0;
                }
            }
        }
        result
    }

    /// Has the sensor test itself. It is set up from scratch afterwards.
    ///
    /// # Errors
    ///
    /// [`NotReady`].
    pub fn test(&mut self) -> Result<SelfTest, NotReady> {
        self.is_known = false;
        self.bus.recover().map_err(NotReady::BusHeldLow)?;
        Mpu6050::probe_once(&mut self.bus)
            .map_err(|failure| NotReady::Sensor(failure.error))?
            .self_test(&mut Delay)
            .map_err(NotReady::Sensor)
    }

    /// Returns whether it has been silent for no longer than it takes to start.
    pub const fn may_be_starting(&self) -> bool {
        self.silent_looks < LOOKS_WHILE_STARTING
    }

    fn attempt(&mut self) -> Result<Ready, NotReady> {
        self.bus.recover().map_err(NotReady::BusHeldLow)?;
        let mut sensor = Mpu6050::probe_once(&mut self.bus)
            .map_err(|failure| NotReady::Sensor(failure.error))?;
        if self.is_known {
            let condition = sensor
                .verify_config(&self.config)
                .map_err(NotReady::Sensor)?;
            let was_reset = condition != Condition::Intact;
            match condition {
                Condition::Intact => {}
                Condition::Reset => retained::count(FaultClass::SensorReset),
                Condition::Changed => retained::count(FaultClass::RegisterChanged),
            }
            if was_reset {
                burst_reader::note_sensor_reset();
                sensor
                    .reconfigure(&self.config, &mut Delay)
                    .map_err(NotReady::Sensor)?;
            }
        } else {
            sensor
                .configure(&self.config, &mut Delay)
                .map_err(NotReady::Sensor)?;
        }
        Ok(Ready {
            part: sensor.part(),
            address: sensor.address(),
        })
    }
}
