//! Configures the sensor at start and after faults, in the idle task, while the burst reader is
//! off.
//!
//! At power-up the sensor gets the datasheet's whole sequence, 230 ms. Later the registers are read
//! back first. If all are right, nothing is written. If the sensor has reset itself or lost a
//! setting, it is reconfigured in 35 ms. An attempt without an answer takes at most 10 ms.

use embedded_hal::i2c::ErrorKind;

use super::delay::Delay;
use super::sensor_bus::{BusHeldLow, SensorBus};
use super::{burst_reader, retained};
use crate::compass::{self, PartId};
use crate::fault::FaultClass;
use crate::mpu6050::{Config, Error, Mpu6050, Part, ReadBack, SelfTest, SettingsState};

/// Pause between two attempts, in ms: recovery is due 20 ms after the end of a fault.
pub const RETRY_MS: u32 = 5;

/// Probes until a sensor that powers up with the processor must answer: 100 ms (product
/// specification §6.3).
const PROBES_WHILE_STARTING: u32 = 100 / RETRY_MS;

/// Reconfigurations in a row before the whole sequence, reset included, is tried.
const RECONFIGURATIONS_WITHOUT_RESET: u8 = 3;

/// Sensor that is ready.
#[derive(Clone, Copy)]
pub struct Ready {
    /// Part, by its identity.
    pub part: &'static Part,
    /// Address on the bus, 7 bits.
    pub address: u8,
}

/// Reason why no sensor is ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum NotReady {
    /// A line of the bus is low.
    BusHeldLow(BusHeldLow),
    /// The sensor does not answer, or not as expected.
    Sensor(Error<ErrorKind>),
}

/// Sensor and the state of its configuration.
pub struct Sensor {
    bus: SensorBus,
    config: Config,
    /// True if the sensor has had the whole sequence in this run or the previous one.
    is_known: bool,
    failures: u8,
    silent_probes: u32,
}

impl Sensor {
    /// Creates a sensor on this bus. `is_known` is true if the previous run has configured it.
    pub fn new(bus: SensorBus, config: Config, is_known: bool) -> Self {
        Self {
            bus,
            config,
            is_known,
            failures: 0,
            silent_probes: 0,
        }
    }

    /// Frees the bus and makes the sensor ready.
    ///
    /// # Errors
    ///
    /// Returns [`NotReady`] with the reason; try again in [`RETRY_MS`].
    pub fn make_ready(&mut self) -> Result<Ready, NotReady> {
        let result = self.attempt();
        match result {
            Ok(_) => {
                self.is_known = true;
                self.failures = 0;
                self.silent_probes = 0;
            }
            Err(NotReady::BusHeldLow(held)) => retained::count(if held.clock {
                FaultClass::ClockLineLow
            } else {
                FaultClass::DataLineLow
            }),
            Err(NotReady::Sensor(Error::NotFound)) => {
                self.silent_probes = self.silent_probes.saturating_add(1);
                if self.is_known || !self.may_be_starting() {
                    retained::count(FaultClass::SensorSilent);
                }
            }
            // The bus is at fault, and no reset of the sensor helps.
            Err(NotReady::Sensor(Error::Bus { .. })) => {}
            Err(NotReady::Sensor(_)) => {
                self.failures = self.failures.saturating_add(1);
                if self.failures >= RECONFIGURATIONS_WITHOUT_RESET {
                    self.is_known = false;
                    self.failures = 0;
                }
            }
        }
        result
    }

    /// Runs the sensor's self-test. The next [`make_ready`](Self::make_ready) configures it from
    /// reset.
    ///
    /// # Errors
    /// Returns [`NotReady`] if there is no sensor.
    pub fn test(&mut self) -> Result<SelfTest, NotReady> {
        self.is_known = false;
        Self::probe(&mut self.bus)?
            .self_test(&mut Delay)
            .map_err(NotReady::Sensor)
    }

    /// Runs the self-test of a compass that is configured, and that has these factory trims. The
    /// compass keeps the settings of the test.
    ///
    /// # Errors
    /// Returns the [`compass::Fault`] if it does not answer.
    pub fn test_compass(
        &mut self,
        part: PartId,
        trims: [u8; 3],
    ) -> Result<compass::SelfTest, compass::Fault> {
        self.bus.recover().map_err(|_| compass::Fault::HoldsBus)?;
        compass::driver::self_test(&mut self.bus, part, trims, &mut Delay)
    }

    /// Reads the sensor's settings back.
    ///
    /// # Errors
    /// Returns [`NotReady`] if there is no sensor.
    pub fn read_back(&mut self) -> Result<ReadBack, NotReady> {
        Self::probe(&mut self.bus)?
            .read_back(&self.config)
            .map_err(NotReady::Sensor)
    }

    /// Returns whether the sensor may still be powering up: it has been silent for less than 100
    /// ms.
    pub const fn may_be_starting(&self) -> bool {
        self.silent_probes < PROBES_WHILE_STARTING
    }

    /// Frees the bus and searches it for the sensor.
    #[inline(never)]
    fn probe(bus: &mut SensorBus) -> Result<Mpu6050<&mut SensorBus>, NotReady> {
        bus.recover().map_err(NotReady::BusHeldLow)?;
        Mpu6050::probe_once(bus).map_err(|failure| NotReady::Sensor(failure.error))
    }

    fn attempt(&mut self) -> Result<Ready, NotReady> {
        let mut sensor = Self::probe(&mut self.bus)?;
        if self.is_known {
            let settings = sensor
                .verify_config(&self.config)
                .map_err(NotReady::Sensor)?;
            let needs_reconfiguration = settings != SettingsState::Intact;
            let was_wrong = burst_reader::take_wrong_setting();
            match settings {
                // The setting was right: the bus garbled it on the way.
                SettingsState::Intact if was_wrong => retained::count(FaultClass::BusError),
                SettingsState::Intact => {}
                SettingsState::Reset => retained::count(FaultClass::SensorReset),
                SettingsState::Changed => retained::count(FaultClass::RegisterChanged),
            }
            if needs_reconfiguration {
                burst_reader::flag_sensor_reset();
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
