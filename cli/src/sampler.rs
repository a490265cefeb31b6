//! A sensor on a bus of this computer: the library's driver and pipeline, as the module runs them.
//!
//! The result has the form of the module's flight log, so that `view` shows it, `record` keeps it,
//! and `replay` repeats it to the bit.

use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Config, Mpu6050, SettingsState};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::log::{FRAME_CAPACITY, Frame, Text, encode};
use aplomb_recordings::flight_log::Recorder;
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;

/// Failed bursts in a row after which the sensor counts as gone.
const FAILURES_OF_A_LOSS: u8 = 100;

/// Samples between two checks of the sensor's settings.
const SAMPLES_TO_A_CHECK: u32 = 200;

/// Source of the samples' times.
pub trait Edges {
    /// Waits for the next sample, and returns its time, µs since any moment.
    ///
    /// # Errors
    ///
    /// Returns the reason if no sample comes, and what to do.
    fn wait(&mut self) -> Result<u64, String>;

    /// Returns whether the times are those of a clock, not of edges.
    fn is_polled(&self) -> bool;
}

/// Settings of a sensor on a bus.
pub struct SensorSettings {
    /// Configuration of the sensor.
    pub config: Config,
    /// Settings of the pipeline; the part is found out.
    pub pipeline: Settings,
    /// Address, if only one may answer.
    pub address: Option<u8>,
}

/// Sensor with its pipeline and its log.
pub struct Sampler<B, D, E> {
    sensor: Mpu6050<B>,
    delay: D,
    edges: E,
    config: Config,
    recorder: Recorder<Bytes>,
    bytes: Bytes,
    failed: u8,
    samples: u32,
    was_reset: bool,
}

impl<B: I2c, D: DelayNs, E: Edges> Sampler<B, D, E> {
    /// Finds and configures the sensor.
    ///
    /// # Errors
    ///
    /// Returns the driver's message.
    pub fn new(bus: B, mut delay: D, edges: E, settings: &SensorSettings) -> Result<Self, String> {
        let mut sensor = Mpu6050::probe(bus, &mut delay).map_err(|failure| failure.to_string())?;
        if let Some(address) = settings
            .address
            .filter(|address| *address != sensor.address())
        {
            return Err(format!(
                "the sensor answers at 0x{:02x}, not at 0x{address:02x}: AD0 selects the address, \
                 low 0x68, high 0x69",
                sensor.address()
            ));
        }
        sensor
            .configure(&settings.config, &mut delay)
            .map_err(|error| error.to_string())?;
        let pipeline = Settings {
            part: sensor.part(),
            sensor: settings.config,
            ..settings.pipeline
        };
        let bytes = Bytes::default();
        Ok(Self {
            sensor,
            delay,
            edges,
            config: settings.config,
            recorder: Recorder::new(bytes.clone(), Pipeline::new(&pipeline), 0),
            bytes,
            failed: 0,
            samples: 0,
            was_reset: false,
        })
    }

    /// Waits for a sample and processes it. Returns `None` if its burst failed, which costs one
    /// sample.
    ///
    /// # Errors
    ///
    /// Returns the reason if the sensor is gone.
    pub fn step(&mut self) -> Result<Option<Burst>, String> {
        let captured_at_us = self.edges.wait()?;
        let mut burst = match self.sensor.read_burst(captured_at_us) {
            Ok(burst) => burst,
            Err(error) => {
                self.failed = self.failed.saturating_add(1);
                if self.failed >= FAILURES_OF_A_LOSS {
                    return Err(error.to_string());
                }
                return Ok(None);
            }
        };
        burst.missed_before = std::mem::take(&mut self.failed);
        let mut flags = BoardFlags::empty();
        flags.set(BoardFlags::BUS_FAULT, burst.missed_before > 0);
        flags.set(BoardFlags::POLLED, self.edges.is_polled());
        let was_reset = std::mem::take(&mut self.was_reset);
        flags.set(BoardFlags::SENSOR_RESET, was_reset);
        let recorded = self.recorder.add(&burst, flags);
        recorded.map_err(|error| error.to_string())?;
        self.samples += 1;
        if self.samples.is_multiple_of(SAMPLES_TO_A_CHECK) {
            self.check_settings();
        }
        Ok(Some(burst))
    }

    /// Reads the settings back, and restores them if the sensor has lost one.
    fn check_settings(&mut self) {
        // A failed transfer shows with the next burst too.
        let settings = self.sensor.verify_config(&self.config);
        if let Ok(SettingsState::Reset | SettingsState::Changed) = settings {
            let restored = self.sensor.reconfigure(&self.config, &mut self.delay);
            self.was_reset = restored.is_ok();
            self.say("the sensor had lost its settings");
        }
    }

    /// Configures the sensor again after it was gone. Returns whether it answers.
    pub fn is_back(&mut self) -> bool {
        let configured = self.sensor.configure(&self.config, &mut self.delay);
        configured.is_ok()
    }

    /// Returns the bytes of the flight log since the last call.
    pub fn take_bytes(&self) -> Vec<u8> {
        std::mem::take(&mut self.bytes.lock())
    }

    /// Writes a message into the flight log.
    pub fn say(&self, text: &str) {
        let mut buffer = [0; FRAME_CAPACITY];
        let frame = encode(&Frame::Text(Text::new(text)), &mut buffer);
        self.bytes.lock().extend_from_slice(frame);
    }
}

/// Bytes that wait to be taken.
#[derive(Clone, Default)]
struct Bytes(Arc<Mutex<Vec<u8>>>);

impl Bytes {
    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<u8>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for Bytes {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lock().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
#[path = "../../models/tests/ideal_bus/mod.rs"]
mod ideal_bus;

#[cfg(test)]
mod tests {
    use super::ideal_bus::IdealBus;
    use super::*;
    use aplomb::mpu6050::Part;
    use aplomb_models::motion::rest::Rest;
    use aplomb_models::sensor::SensorConfig;
    use aplomb_recordings::flight_log;
    use embedded_hal::i2c::{ErrorKind, ErrorType, NoAcknowledgeSource, Operation};

    /// Edges of the modelled sensor's clock, at 200 Hz.
    struct Played(IdealBus);

    impl Edges for Played {
        fn wait(&mut self) -> Result<u64, String> {
            loop {
                self.0.delay_us(50);
                if let Some(edge) = self.0.take_edges().pop() {
                    return Ok(edge.time_ns / 1_000);
                }
            }
        }

        fn is_polled(&self) -> bool {
            false
        }
    }

    /// Bus that fails in some transfers, counted from the first burst.
    struct Faulty<F>(IdealBus, u32, F);

    impl<F> ErrorType for Faulty<F> {
        type Error = ErrorKind;
    }

    impl<F: Fn(u32) -> bool> I2c for Faulty<F> {
        fn transaction(
            &mut self,
            address: u8,
            operations: &mut [Operation<'_>],
        ) -> Result<(), ErrorKind> {
            let is_burst = operations
                .iter()
                .any(|operation| matches!(operation, Operation::Read(bytes) if bytes.len() == 14));
            if is_burst {
                self.1 += 1;
                if self.2(self.1) {
                    let source = NoAcknowledgeSource::Unknown;
                    return Err(ErrorKind::NoAcknowledge(source));
                }
            }
            self.0.transaction(address, operations)
        }
    }

    fn settings() -> SensorSettings {
        let mut config = Config::DEFAULT;
        config.sample_rate_divider = 4;
        SensorSettings {
            config,
            pipeline: Settings::new(&Part::MPU_6050),
            address: None,
        }
    }

    type Sampled<F> = Sampler<Faulty<F>, IdealBus, Played>;

    fn sampler<F: Fn(u32) -> bool>(
        address: u8,
        settings: &SensorSettings,
        fails: F,
    ) -> Result<Sampled<F>, String> {
        let config = SensorConfig {
            address,
            ..SensorConfig::new(1)
        };
        let bus = IdealBus::new(config, Rest::level());
        let edges = Played(bus.clone());
        Sampler::new(Faulty(bus.clone(), 0, fails), bus, edges, settings)
    }

    #[test]
    fn the_log_of_a_sensor_replays_and_lost_samples_are_counted() {
        let fails = |burst| burst % 50 == 0;
        let mut sampler = sampler(0x69, &settings(), fails).expect("it is found");
        let mut missed = 0;
        for _ in 0..2_000 {
            if let Some(burst) = sampler.step().expect("it stays") {
                missed += u32::from(burst.missed_before);
            }
        }
        sampler.say("a message");
        let bytes = sampler.take_bytes();
        assert!(sampler.take_bytes().is_empty());
        let log = flight_log::decode(&bytes).expect("it is a flight log");
        assert_eq!(log.messages, ["a message"]);
        let flight = log.flight(None).expect("one flight");
        assert_eq!((flight.bursts, missed), (1_960, 39));
        let configuration = flight.configuration.as_ref().expect("it has settings");
        assert_eq!(configuration.settings.sensor.sample_rate_divider, 4);
        let last = log.steps(flight).expect("memory").last().expect("a step");
        assert!(last.numbered.burst.captured_at_us > 9_900_000);
    }

    #[test]
    fn a_sensor_that_is_gone_is_reported_and_comes_back() {
        let fails = |burst| (300..500).contains(&burst);
        let mut sampler = sampler(0x68, &settings(), fails).expect("it is found");
        let mut steps = 0;
        let reason = loop {
            match sampler.step() {
                Ok(_) => steps += 1,
                Err(reason) => break reason,
            }
        };
        assert_eq!(steps, 299 + u32::from(FAILURES_OF_A_LOSS) - 1);
        assert!(reason.contains("0x68"), "{reason}");
        assert!(sampler.is_back());
    }

    #[test]
    fn lost_settings_are_restored_and_reported() {
        let mut sampler = sampler(0x68, &settings(), |_| false).expect("it is found");
        let model = sampler.edges.0.clone();
        {
            let (sensor, now_ns) = &mut *model.0.borrow_mut();
            sensor.corrupt_register(*now_ns, 0x1B, 0);
        }
        for _ in 0..=SAMPLES_TO_A_CHECK {
            sampler.step().expect("it stays");
        }
        assert_eq!(model.0.borrow().0.register(0x1B), 0x18);
        let log = flight_log::decode(&sampler.take_bytes()).expect("it is a flight log");
        assert_eq!(log.messages, ["the sensor had lost its settings"]);
        let flight = log.flight(None).expect("one flight");
        let last = log.steps(flight).expect("memory").last().expect("a step");
        assert!(last.numbered.flags.contains(BoardFlags::SENSOR_RESET));
    }

    #[test]
    fn another_address_is_named() {
        let mut settings = settings();
        settings.address = Some(0x69);
        let error = sampler(0x68, &settings, |_| false).err().expect("wrong");
        assert!(error.contains("at 0x68, not at 0x69"), "{error}");
    }
}
