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

/// Bursts read too late after which the bus is judged.
const LATE_OF_A_SLOW_BUS: u8 = 100;

/// Time between two checks of the sensor's settings, µs: that of the firmware.
const CHECK_PERIOD_US: u64 = 44_000;

/// Sample that waits in the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Time, µs since any moment.
    pub time_us: u64,
    /// Samples since the previous edge that were not read.
    pub skipped: u32,
}

/// Source of the samples' times.
pub trait Edges {
    /// Waits for the next sample.
    ///
    /// # Errors
    ///
    /// Returns the reason if no sample comes, and what to do.
    fn wait(&mut self) -> Result<Edge, String>;

    /// Returns the time of the next edge, µs, if it has already come; `None` for a clock. The next
    /// [`wait`](Self::wait) returns that edge, or a later one.
    ///
    /// # Errors
    ///
    /// Returns the reason if the source fails.
    fn pending_us(&mut self) -> Result<Option<u64>, String>;

    /// Returns the present time, µs, on the clock of the samples.
    fn now_us(&self) -> u64;

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
    /// Samples lost since the last burst: skipped, with a failed transfer, or read too late.
    missed: u32,
    /// Duration of the shortest transfer of a burst, µs.
    shortest_us: u64,
    /// Bursts read too late since the sensor was configured.
    late: u8,
    /// Time of the last check of the settings, µs.
    checked_at_us: u64,
    /// Result of that check, for the next burst.
    checked: BoardFlags,
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
            verifies_scales: true,
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
            missed: 0,
            shortest_us: u64::MAX,
            late: 0,
            checked_at_us: 0,
            checked: BoardFlags::empty(),
        })
    }

    /// Waits for a sample and processes it. Returns `None` if its burst failed, or was read too
    /// late. Each costs one sample.
    ///
    /// # Errors
    ///
    /// Returns the reason if the sensor is gone, or its bus too slow.
    pub fn step(&mut self) -> Result<Option<Burst>, String> {
        let edge = self.edges.wait()?;
        self.missed = self.missed.saturating_add(edge.skipped);
        let started_us = self.edges.now_us();
        let mut burst = match self.sensor.read_burst(edge.time_us) {
            Ok(burst) => burst,
            Err(error) => {
                self.missed = self.missed.saturating_add(1);
                self.failed = self.failed.saturating_add(1);
                if self.failed >= FAILURES_OF_A_LOSS {
                    return Err(error.to_string());
                }
                return Ok(None);
            }
        };
        if self.is_too_late(started_us)? {
            self.missed = self.missed.saturating_add(1);
            return Ok(None);
        }
        burst.missed_before = u8::try_from(std::mem::take(&mut self.missed)).unwrap_or(u8::MAX);
        let mut flags = std::mem::take(&mut self.checked);
        flags.set(BoardFlags::BUS_FAULT, std::mem::take(&mut self.failed) > 0);
        flags.set(BoardFlags::POLLED, self.edges.is_polled());
        let recorded = self.recorder.add(&burst, flags);
        recorded.map_err(|error| error.to_string())?;
        let is_due = edge.time_us.abs_diff(self.checked_at_us) >= CHECK_PERIOD_US;
        if is_due || self.recorder.awaits_scale_check() {
            self.checked_at_us = edge.time_us;
            self.check_settings();
        }
        Ok(Some(burst))
    }

    /// Returns whether the transfer that has ended may hold a later sample than that of its edge,
    /// or a polled one more than a period after its time. The system may have run other programs
    /// before the transfer, or in it.
    ///
    /// The sensor fixes the sample when its data begin, and they are most of a transfer. So it was
    /// fixed before the second half of the shortest transfer, counted back from the end.
    ///
    /// # Errors
    ///
    /// Returns the reason if [`LATE_OF_A_SLOW_BUS`] bursts were late, and even the shortest
    /// transfer takes longer than a period: see [`is_bus_too_slow`](Self::is_bus_too_slow).
    fn is_too_late(&mut self, started_us: u64) -> Result<bool, String> {
        let ended_us = self.edges.now_us();
        let transfer_us = ended_us.saturating_sub(started_us);
        self.shortest_us = self.shortest_us.min(transfer_us);
        let period_us = self.period_us();
        if self.edges.is_polled() {
            return Ok(transfer_us - self.shortest_us > period_us);
        }
        let fixed_us = ended_us.saturating_sub(self.shortest_us / 2);
        let next_us = self.edges.pending_us()?;
        let is_late = next_us.is_some_and(|next_us| next_us <= fixed_us);
        self.late = self.late.saturating_add(u8::from(is_late));
        if self.is_bus_too_slow() {
            return Err(format!(
                "a transfer takes {} µs, and samples come each {period_us} µs: lower --rate-hz, \
                 or make the bus faster",
                self.shortest_us
            ));
        }
        Ok(is_late)
    }

    /// Returns whether the bus is too slow for the sample rate: to wait does not help.
    pub fn is_bus_too_slow(&self) -> bool {
        self.late >= LATE_OF_A_SLOW_BUS && self.shortest_us > self.period_us()
    }

    fn period_us(&self) -> u64 {
        (1e6 / self.config.sample_rate_hz()) as u64
    }

    /// Reads the settings back, and restores them if the sensor has lost one. A failed transfer
    /// gives no result.
    fn check_settings(&mut self) {
        match self.sensor.verify_config(&self.config) {
            Ok(SettingsState::Intact) => self.checked = BoardFlags::SCALES_VERIFIED,
            Ok(SettingsState::Reset | SettingsState::Changed) => {
                // If it fails, the next check finds the settings lost again.
                let _ = self.sensor.reconfigure(&self.config, &mut self.delay);
                self.checked = BoardFlags::SENSOR_RESET;
                self.say("the sensor had lost its settings");
            }
            Err(_) => {}
        }
    }

    /// Configures the sensor again after it was gone. Returns whether it answers.
    pub fn is_back(&mut self) -> bool {
        (self.late, self.shortest_us) = (0, u64::MAX);
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
    use aplomb::health::Flags;
    use aplomb::mpu6050::Part;
    use aplomb_models::motion::rest::Rest;
    use aplomb_models::motion::swing::Swing;
    use aplomb_models::motion::{Motion, Quaternion, inclination_error_rad};
    use aplomb_models::sensor::{DataReady, SensorConfig};
    use aplomb_recordings::flight_log;
    use embedded_hal::i2c::{ErrorKind, ErrorType, NoAcknowledgeSource, Operation};

    /// Edges of the modelled sensor's clock, at 200 Hz, and those that were not waited for.
    struct Played(IdealBus, Vec<DataReady>);

    impl Edges for Played {
        fn wait(&mut self) -> Result<Edge, String> {
            loop {
                self.0.delay_us(50);
                self.1.extend(self.0.take_edges());
                if let Some(edge) = self.1.pop() {
                    return Ok(Edge {
                        time_us: edge.time_ns / 1_000,
                        skipped: std::mem::take(&mut self.1).len() as u32,
                    });
                }
            }
        }

        fn pending_us(&mut self) -> Result<Option<u64>, String> {
            self.1.extend(self.0.take_edges());
            Ok(self.1.first().map(|edge| edge.time_ns / 1_000))
        }

        fn now_us(&self) -> u64 {
            self.0.0.borrow().1 / 1_000
        }

        fn is_polled(&self) -> bool {
            false
        }
    }

    /// Bus of a computer that runs other programs before some bursts, for a time in µs.
    struct Preempted<F>(IdealBus, u32, F);

    impl<F> ErrorType for Preempted<F> {
        type Error = ErrorKind;
    }

    impl<F: Fn(u32) -> u32> I2c for Preempted<F> {
        fn transaction(
            &mut self,
            address: u8,
            operations: &mut [Operation<'_>],
        ) -> Result<(), ErrorKind> {
            let mut reads = operations.iter();
            if reads
                .any(|operation| matches!(operation, Operation::Read(bytes) if bytes.len() == 14))
            {
                self.1 += 1;
                self.0.delay_us((self.2)(self.1));
            }
            self.0.transaction(address, operations)
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
        sampler_in(Rest::level(), address, settings, fails)
    }

    fn sampler_in<F: Fn(u32) -> bool>(
        motion: impl Motion + 'static,
        address: u8,
        settings: &SensorSettings,
        fails: F,
    ) -> Result<Sampled<F>, String> {
        let config = SensorConfig {
            address,
            ..SensorConfig::new(1)
        };
        let bus = IdealBus::new(config, motion);
        let edges = Played(bus.clone(), Vec::new());
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
        // 200 samples a second: the check is due after 44 ms.
        let mut steps = 0;
        while model.0.borrow().0.register(0x1B) == 0 {
            sampler.step().expect("it stays");
            steps += 1;
        }
        assert!(steps <= 10, "{steps} samples");
        assert_eq!(model.0.borrow().0.register(0x1B), 0x18);
        sampler.step().expect("it stays");
        let log = flight_log::decode(&sampler.take_bytes()).expect("it is a flight log");
        assert_eq!(log.messages, ["the sensor had lost its settings"]);
        let flight = log.flight(None).expect("one flight");
        let last = log.steps(flight).expect("memory").last().expect("a step");
        assert!(last.numbered.flags.contains(BoardFlags::SENSOR_RESET));
    }

    /// A valid attitude is wrong by no more than the larger of 5° and six σ, also after the loss
    /// of the full scale in motion.
    #[test]
    fn no_attitude_with_a_lost_full_scale_is_valid_and_wrong() {
        for (divider, seed) in [(0, 1), (4, 1), (4, 2), (4, 3), (19, 1), (19, 2)] {
            let mut settings = settings();
            settings.config.sample_rate_divider = divider;
            let swing = Swing::by_seed(seed, 4.0);
            let found = sampler_in(swing.clone(), 0x68, &settings, |_| false);
            let mut sampler = found.expect("it is found");
            let model = sampler.edges.0.clone();
            let mut losses_us = [6_000_000, 11_100_000, 17_300_000].into_iter().peekable();
            loop {
                let burst = sampler.step().expect("it stays").expect("no burst fails");
                let now_us = burst.captured_at_us;
                if losses_us.next_if(|at_us| now_us >= *at_us).is_some() {
                    let (sensor, now_ns) = &mut *model.0.borrow_mut();
                    sensor.corrupt_register(*now_ns, 0x1B, 0);
                }
                if now_us > 25_000_000 {
                    break;
                }
            }
            let log = flight_log::decode(&sampler.take_bytes()).expect("it is a flight log");
            assert_eq!(log.messages.len(), 3, "divider {divider}, seed {seed}");
            judge(&log, swing, &format!("divider {divider}, seed {seed}"));
        }
    }

    /// Replays a log with this motion, and holds its valid attitudes to their promise.
    fn judge(log: &flight_log::FlightLog, mut motion: impl Motion, case: &str) {
        let flight = log.flight(None).expect("one flight");
        let settings = flight.configuration.as_ref().expect("settings").settings;
        let mut pipeline = Pipeline::new(&settings);
        let (mut valid, mut count) = (0, 0);
        for step in log.steps(flight).expect("memory") {
            let burst = step.numbered.burst;
            let snapshot = pipeline.update(&burst, step.numbered.flags);
            count += 1;
            if !snapshot.flags.contains(Flags::VALID) {
                continue;
            }
            valid += 1;
            let truth = motion.at(burst.captured_at_us as f64 * 1e-6).attitude;
            let [w, x, y, z] = {
                let q = snapshot.attitude;
                [q.w, q.x, q.y, q.z].map(f64::from)
            };
            let attitude = Quaternion { w, x, y, z };
            let error_rad = inclination_error_rad(attitude, truth.expect("a swing has one"));
            let promised_rad = (6.0 * f64::from(snapshot.tilt_sigma_rad())).max(5_f64.to_radians());
            assert!(
                error_rad < promised_rad,
                "{case}: {} µs, {:.1}° and valid",
                burst.captured_at_us,
                error_rad.to_degrees()
            );
        }
        assert!(2 * valid > count, "{case}: {valid} of {count} are valid");
    }

    #[test]
    fn samples_that_are_not_read_are_counted() {
        let mut sampler = sampler(0x68, &settings(), |burst| burst == 60).expect("it is found");
        let mut pauses = IdealBus::clone(&sampler.edges.0);
        let mut missed = Vec::new();
        for step in 0..100 {
            if step == 30 {
                // The program sleeps for four periods.
                pauses.delay_ms(20);
            }
            if let Some(burst) = sampler.step().expect("it stays") {
                missed.push(burst.missed_before);
            }
        }
        let lost: Vec<_> = missed.iter().filter(|lost| **lost > 0).collect();
        assert_eq!(lost, [&3, &1]);
        let log = flight_log::decode(&sampler.take_bytes()).expect("it is a flight log");
        let flight = log.flight(None).expect("one flight");
        let steps = log.steps(flight).expect("memory");
        let faults = steps.filter(|step| step.numbered.flags.contains(BoardFlags::BUS_FAULT));
        assert_eq!(faults.count(), 1);
    }

    #[test]
    fn a_burst_that_is_read_after_the_next_edge_is_missed() {
        let bus = IdealBus::new(SensorConfig::new(1), Swing::by_seed(1, 0.0));
        let edges = Played(bus.clone(), Vec::new());
        // The period is 5 ms. Burst 80 has begun its data when the edge comes.
        let pauses = |burst| match burst {
            20 => 2_000,
            40 => 5_100,
            60 => 12_000,
            80 => 4_700,
            _ => 0,
        };
        let preempted = Preempted(bus.clone(), 0, pauses);
        let found = Sampler::new(preempted, bus.clone(), edges, &settings());
        let mut sampler = found.expect("it is found");
        bus.0.borrow_mut().0.take_bursts();
        let (mut missed, mut late) = (Vec::new(), 0);
        for _ in 0..200 {
            let burst = sampler.step().expect("it stays");
            let read = bus.0.borrow_mut().0.take_bursts();
            let Some(burst) = burst else {
                late += 1;
                continue;
            };
            // Edges have indices from zero, and the first comes a period after the configuration.
            let edge = read.first().and_then(|read| read.edge).expect("a sample");
            missed.push((edge, burst.missed_before, burst.captured_at_us));
        }
        let lost: Vec<u8> = missed
            .iter()
            .map(|burst| burst.1)
            .filter(|lost| *lost > 0)
            .collect();
        assert_eq!(
            (lost.as_slice(), late),
            ([1, 2].as_slice(), 2),
            "{missed:?}"
        );
        for pair in missed.windows(2) {
            let samples = pair[1].0 - pair[0].0;
            assert_eq!(samples, 1 + u64::from(pair[1].1), "{pair:?}");
            let step_us = pair[1].2 - pair[0].2;
            assert!(
                step_us.abs_diff(5_000 * samples) < 100 * samples,
                "{pair:?}"
            );
        }
    }

    /// Clock of a computer that polls at 200 Hz.
    struct Polled(IdealBus);

    impl Edges for Polled {
        fn wait(&mut self) -> Result<Edge, String> {
            self.0.delay_us(5_000 - (self.now_us() % 5_000) as u32);
            Ok(Edge {
                time_us: self.now_us(),
                skipped: 0,
            })
        }

        fn pending_us(&mut self) -> Result<Option<u64>, String> {
            Ok(None)
        }

        fn now_us(&self) -> u64 {
            self.0.0.borrow().1 / 1_000
        }

        fn is_polled(&self) -> bool {
            true
        }
    }

    #[test]
    fn a_bus_that_is_slower_than_the_sensor_is_named_unless_it_is_polled() {
        let bus = IdealBus::new(SensorConfig::new(1), Swing::by_seed(1, 0.0));
        let edges = Played(bus.clone(), Vec::new());
        let slow = Preempted(bus.clone(), 0, |_| 12_000);
        let found = Sampler::new(slow, bus.clone(), edges, &settings());
        let mut sampler = found.expect("it is found");
        let error = (0..300).find_map(|_| sampler.step().err());
        let error = error.expect("most bursts are late");
        assert!(error.contains("samples come each 5000 µs"), "{error}");
        assert!(sampler.is_bus_too_slow());
        assert!(sampler.is_back() && !sampler.is_bus_too_slow());
        assert_eq!(sampler.step().map(|burst| burst.is_some()), Ok(false));
        // One preempted burst is older than the others by more than a period.
        let slow = |burst| if burst == 40 { 18_000 } else { 12_000 };
        let slow = Preempted(bus.clone(), 0, slow);
        let found = Sampler::new(slow, bus.clone(), Polled(bus), &settings());
        let mut sampler = found.expect("it is found");
        let bursts = (0..300).map(|_| sampler.step().expect("it stays"));
        assert_eq!(bursts.flatten().count(), 299);
    }

    #[test]
    fn another_address_is_named() {
        let mut settings = settings();
        settings.address = Some(0x69);
        let error = sampler(0x68, &settings, |_| false).err().expect("wrong");
        assert!(error.contains("at 0x68, not at 0x69"), "{error}");
    }
}
