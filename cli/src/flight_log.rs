//! The module's flight log on a computer: read, replayed, and made from bursts.
//!
//! A log is read as a whole, since the pieces of a filter's state come after the bursts that follow it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use aplomb::attitude::Quaternion;
use aplomb::estimator::REVISION;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::Burst;
use aplomb::pipeline::{Pipeline, Snapshot};
use aplomb::serialize::StateReader;
use aplomb::telemetry::Output;
use aplomb::telemetry::log::{
    Configuration, Counts, Decoder, FRAME_CAPACITY, Frame, NumberedBurst, Sender, StatePiece,
    put_attitude,
};

use crate::device::{Device, FilterName};

/// The first bytes decide what a file is.
const SNIFFED_BYTES: usize = 64 * 1024;

/// Attitudes are logged with every so many bursts.
const BURSTS_PER_ATTITUDE: u32 = 20;

/// A log.
#[derive(Default)]
pub struct FlightLog {
    /// One for each start of the module.
    pub flights: Vec<Flight>,
    /// What the decoder saw.
    pub counts: Counts,
    /// Messages of the module, in order.
    pub messages: Vec<String>,
    /// The file could not be read to its end: what came before is all there is.
    pub is_cut_off: bool,
}

/// What the module logged from one start to the next.
#[derive(Default)]
pub struct Flight {
    /// Changes of the settings, in order; the first is where the log begins.
    pub configurations: Vec<Configuration>,
    /// The bursts, in order.
    pub bursts: Vec<NumberedBurst>,
    /// Attitudes by their time.
    attitudes: BTreeMap<u64, Snapshot>,
    /// Whole states by the number of the burst that comes next.
    states: BTreeMap<u32, Vec<u8>>,
}

impl FlightLog {
    /// The flights of which there are bursts.
    pub fn flown(&self) -> impl Iterator<Item = &Flight> {
        self.flights
            .iter()
            .filter(|flight| !flight.bursts.is_empty())
    }

    /// The flight of this number, counted from 1; of a log with one flight, that one.
    pub fn flight(&self, number: Option<usize>) -> Result<&Flight, String> {
        let count = self.flown().count();
        let index = match number {
            None if count > 1 => {
                return Err(format!(
                    "the module started {count} times in it: choose a flight with --flight 1 to --flight {count}"
                ));
            }
            None => Some(0),
            Some(number) => number.checked_sub(1),
        };
        index
            .and_then(|index| self.flown().nth(index))
            .ok_or_else(|| format!("there is no such flight in it: it has 1 to {count}"))
    }
}

impl Flight {
    /// Bursts that are missing between the first and the last.
    pub fn lost(&self) -> u64 {
        match (self.bursts.first(), self.bursts.last()) {
            (Some(first), Some(last)) => {
                u64::from(last.number - first.number) + 1 - self.bursts.len() as u64
            }
            _ => 0,
        }
    }
}

/// Whether a file is a flight log: text has no zeros in it.
pub fn is_one(path: &Path) -> bool {
    // What is read of a pipe is gone.
    if !path.is_file() {
        return false;
    }
    let mut bytes = Vec::new();
    if let Ok(file) = open(path) {
        // What came before an error tells as well.
        let _ = file.take(SNIFFED_BYTES as u64).read_to_end(&mut bytes);
    }
    bytes.contains(&0)
}

/// Reads a log, plain or gzipped. One that cannot be read to its end is used as far as it can, with a warning.
pub fn read(path: &Path) -> Result<FlightLog, String> {
    let at = |error: String| format!("{}: {error}", path.display());
    let mut bytes = Vec::new();
    let end = open(path)?.read_to_end(&mut bytes);
    if let Err(error) = &end {
        eprintln!(
            "warning: {}: cut off or damaged after {} bytes ({error}): this is what came before",
            path.display(),
            bytes.len()
        );
    }
    let log = FlightLog {
        is_cut_off: end.is_err(),
        ..decode(&bytes)
    };
    if log.flights.iter().all(|flight| flight.bursts.is_empty()) {
        return Err(at(format!(
            "there is no burst in it: {} frames, {} pieces that are none. Was it recorded with `format log`, at the module's baud rate?",
            log.counts.frames, log.counts.damaged
        )));
    }
    Ok(log)
}

/// Opens a log, plain or gzipped.
pub fn open(path: &Path) -> Result<Box<dyn Read>, String> {
    let text = |error: std::io::Error| format!("{}: {error}", path.display());
    let mut magic = [0; 2];
    let is_zipped = File::open(path)
        .and_then(|mut file| file.read(&mut magic))
        .map_err(text)?
        == 2
        && magic == [0x1F, 0x8B];
    let file = File::open(path).map_err(text)?;
    Ok(if is_zipped {
        Box::new(flate2::read::MultiGzDecoder::new(file))
    } else {
        Box::new(file)
    })
}

/// Reads the bytes of a log.
pub fn decode(bytes: &[u8]) -> FlightLog {
    let mut decoder = Decoder::new();
    let mut log = FlightLog::default();
    let mut flight = Flight::default();
    // What came since the last burst belongs to the next one, which may be the first of another flight.
    let mut upcoming = Vec::new();
    let mut collector = Collector::default();
    // A log that was cut off may end with a whole frame whose last zero is missing.
    for byte in bytes.iter().chain(&[0]) {
        let Some(frame) = decoder.push(*byte) else {
            continue;
        };
        match frame {
            Frame::Burst(burst) => {
                let last = flight.bursts.last();
                if last.is_some_and(|last| burst.number <= last.number) {
                    log.flights.push(std::mem::take(&mut flight));
                    collector = Collector::default();
                }
                for frame in upcoming.drain(..) {
                    flight.add(frame, &mut collector);
                }
                flight.bursts.push(burst);
            }
            Frame::Text(text) => log.messages.push(text.as_str().to_owned()),
            other => upcoming.push(other),
        }
    }
    for frame in upcoming {
        flight.add(frame, &mut collector);
    }
    log.flights.push(flight);
    log.counts = decoder.counts();
    log
}

/// Puts the pieces of a state together.
#[derive(Default)]
pub struct Collector {
    number: u32,
    bytes: Vec<u8>,
}

impl Collector {
    pub fn add(&mut self, piece: &StatePiece) -> Option<(u32, Vec<u8>)> {
        if piece.offset == 0 {
            self.number = piece.number;
            self.bytes.clear();
        }
        if piece.number != self.number || usize::from(piece.offset) != self.bytes.len() {
            return None;
        }
        self.bytes.extend_from_slice(piece.bytes());
        let is_whole = self.bytes.len() == usize::from(piece.state_length);
        is_whole.then(|| (self.number, std::mem::take(&mut self.bytes)))
    }
}

impl Flight {
    fn add(&mut self, frame: Frame, collector: &mut Collector) {
        match frame {
            Frame::Configuration(configuration)
                if self.configurations.last() != Some(&configuration) =>
            {
                self.configurations.push(configuration);
            }
            Frame::Attitude(snapshot) => {
                self.attitudes.insert(snapshot.t_us, snapshot);
            }
            Frame::StatePiece(piece) => self.states.extend(collector.add(&piece)),
            _ => {}
        }
    }
}

/// How far a replay is the flight itself.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Agreement {
    /// Bursts that were replayed.
    pub bursts: u64,
    /// Those whose attitudes are the flight's to the bit, because a state and every burst since are known.
    pub exact: u64,
    /// Attitudes of the log that an exact one was compared with.
    pub compared: u64,
    /// Those that differ.
    pub different: u64,
    /// The time of the first of them, µs.
    pub first_difference_us: Option<u64>,
    /// The revision that flew, if it is not the present one: then nothing is exact.
    pub other_revision: Option<u16>,
}

/// A flight through the pipeline, burst by burst.
pub struct Replay<'a> {
    flight: &'a Flight,
    next: usize,
    device: Device,
    /// The configuration that holds now.
    configuration: usize,
    is_exact: bool,
    /// Whether the flight was flown with these filters, so that its states apply.
    is_revision: bool,
    agreement: Agreement,
}

impl<'a> Replay<'a> {
    /// Creates a replay with the flight's settings. With another filter than the Kalman filter nothing is exact.
    pub fn new(flight: &'a Flight, filter: FilterName) -> Result<Self, &'static str> {
        let Some(first) = flight.configurations.first() else {
            return Err(
                "there is no configuration in it, so that the bytes have no meaning: record a second or more",
            );
        };
        let is_revision = first.revision == REVISION;
        Ok(Self {
            flight,
            next: 0,
            device: Device::for_bursts(filter, &first.settings),
            configuration: 0,
            is_exact: false,
            is_revision,
            agreement: Agreement {
                other_revision: (!is_revision).then_some(first.revision),
                ..Agreement::default()
            },
        })
    }

    /// The next burst's time and snapshot.
    pub fn next(&mut self) -> Option<Snapshot> {
        let NumberedBurst {
            number,
            flags,
            burst,
        } = *self.flight.bursts.get(self.next)?;
        let before = self.next.checked_sub(1);
        let follows = before.is_some_and(|before| self.flight.bursts[before].number + 1 == number);
        self.is_exact &= follows;
        self.next += 1;
        self.change_settings(number);
        if self.is_revision
            && let Some(state) = self.flight.states.get(&number)
            && let Some(pipeline) = self.device.kalman_mut()
        {
            let mut restored = *pipeline;
            let mut reader = StateReader::new(state);
            restored.visit_state(&mut reader);
            if reader.is_complete() {
                *pipeline = restored;
                self.is_exact = true;
            }
        }
        // That the module reads the scales back is not in the log; only VALID depends on it.
        let snapshot = self.device.update(&burst, flags);
        self.agreement.bursts += 1;
        if self.is_exact {
            self.agreement.exact += 1;
            self.compare(&snapshot);
        }
        Some(snapshot)
    }

    /// Returns the pipeline.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// How far it is the flight itself.
    pub fn agreement(&self) -> &Agreement {
        &self.agreement
    }

    fn change_settings(&mut self, number: u32) {
        let Some(next) = self.flight.configurations.get(self.configuration + 1) else {
            return;
        };
        if number < next.from_number {
            return;
        }
        let before = &self.flight.configurations[self.configuration].settings;
        if next.settings != *before {
            // Without the state after it, nobody knows between which two samples it was.
            self.is_exact = false;
            self.device.set_calibration(&next.settings);
        }
        self.configuration += 1;
    }

    fn compare(&mut self, snapshot: &Snapshot) {
        let Some(flown) = self.flight.attitudes.get(&snapshot.t_us) else {
            return;
        };
        self.agreement.compared += 1;
        let bits = |snapshot: &Snapshot| {
            let Quaternion { w, x, y, z } = snapshot.attitude;
            let rates = snapshot.body_rates_rad_s;
            [w, x, y, z, rates.x, rates.y, rates.z].map(f32::to_bits)
        };
        if bits(flown) != bits(snapshot) {
            self.agreement.different += 1;
            self.agreement
                .first_difference_us
                .get_or_insert(snapshot.t_us);
        }
    }
}

/// Writes bursts as the module would log them, with this pipeline.
pub struct Recorder<W> {
    output: W,
    sender: Sender,
    pipeline: Pipeline,
    number: u32,
}

impl<W: Write> Recorder<W> {
    /// A log that begins with the next burst.
    pub fn new(output: W, pipeline: Pipeline, next_number: u32) -> Self {
        Self {
            output,
            sender: Sender::new(next_number),
            pipeline,
            number: next_number,
        }
    }

    /// Adds a burst, with what the board said of it.
    pub fn add(&mut self, burst: &Burst, flags: BoardFlags) -> std::io::Result<Snapshot> {
        let now_us = burst.captured_at_us;
        if self.sender.wants_state(now_us) {
            self.sender.copy_state(&self.pipeline, self.number);
            self.sender.measure_state(now_us);
        }
        let mut burst_to_send = Some(NumberedBurst {
            number: self.number,
            flags,
            burst: *burst,
        });
        let mut buffer = [0; 8 * FRAME_CAPACITY];
        let mut output = Output::new(&mut buffer);
        self.sender
            .fill(now_us, &mut output, || burst_to_send.take());
        let snapshot = self.pipeline.update(burst, flags);
        if self.number.is_multiple_of(BURSTS_PER_ATTITUDE) {
            put_attitude(&snapshot, &mut output);
        }
        self.number += 1;
        let length = output.length();
        self.output.write_all(&buffer[..length])?;
        Ok(snapshot)
    }

    /// Gives back what it writes to.
    #[cfg(test)]
    pub fn into_inner(self) -> W {
        self.output
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::LazyLock;

    use crate::simulated;
    use aplomb::mpu6050::{
        AccelerometerCounts, GyroscopeCounts, Part, RawSample, TemperatureCounts,
    };
    use aplomb::pipeline::Settings;
    use aplomb::telemetry::log::encode;
    use proptest::prelude::*;

    fn settings() -> Settings {
        Settings::new(&Part::MPU_6050)
    }

    /// Minutes of a simulated quadrotor at 1 kHz, its samples as counts.
    fn bursts(seconds: usize) -> Vec<Burst> {
        let recordings: Vec<_> = (0..seconds.div_ceil(60) as u64)
            .map(simulated::flight)
            .collect();
        let config = settings().sensor;
        let count = |value: f32, unit: f32| (value / unit) as i16;
        recordings
            .iter()
            .flat_map(|recording| &recording.samples)
            .take(seconds * 1000)
            .enumerate()
            .map(|(index, sample)| {
                let force = aplomb::calibration::Mount::Z_UP.to_sensor(sample.specific_force_m_s2);
                let rates = aplomb::calibration::Mount::Z_UP.to_sensor(sample.angular_rate_rad_s);
                let force_unit = config.accelerometer_range.m_s2_per_count();
                let rate_unit = config.gyroscope_range.rad_s_per_count();
                let raw = RawSample {
                    accelerometer: AccelerometerCounts(
                        [force.x, force.y, force.z].map(|value| count(value, force_unit)),
                    ),
                    temperature: TemperatureCounts(-4000),
                    gyroscope: GyroscopeCounts(
                        [rates.x, rates.y, rates.z].map(|value| count(value, rate_unit)),
                    ),
                };
                Burst {
                    bytes: raw.encode(),
                    captured_at_us: 1_234_567 + 1_000 * index as u64,
                    missed_before: 0,
                }
            })
            .collect()
    }

    /// The log of these bursts, from the burst of this index on, and all snapshots of the flight.
    fn fly(bursts: &[Burst], first: usize) -> (Vec<u8>, Vec<Snapshot>) {
        let mut pipeline = Pipeline::new(&settings());
        let mut snapshots: Vec<_> = bursts[..first]
            .iter()
            .map(|burst| pipeline.update(burst, BoardFlags::empty()))
            .collect();
        let mut recorder = Recorder::new(Vec::new(), pipeline, first as u32);
        snapshots.extend(bursts[first..].iter().map(|burst| {
            recorder
                .add(burst, BoardFlags::empty())
                .expect("memory takes everything")
        }));
        (recorder.into_inner(), snapshots)
    }

    fn replayed(flight: &Flight) -> (Vec<Snapshot>, Agreement) {
        let mut replay = Replay::new(flight, FilterName::Kalman).expect("there is a configuration");
        let snapshots = std::iter::from_fn(|| replay.next()).collect();
        (snapshots, replay.agreement().clone())
    }

    #[test]
    fn ten_minutes_fit_the_line_and_replay_to_the_bit() {
        let bursts = bursts(600);
        assert_eq!(bursts.len(), 600_000);
        let (bytes, flown) = fly(&bursts, 0);
        let per_second = bytes.len() / 600;
        assert!(10 * per_second < 921_600 / 2, "{per_second} bytes a second");
        let log = decode(&bytes);
        let [flight] = &log.flights[..] else {
            panic!("{} flights", log.flights.len())
        };
        assert_eq!((flight.lost(), log.counts.damaged), (0, 0));
        let read: Vec<_> = flight
            .bursts
            .iter()
            .map(|numbered| numbered.burst)
            .collect();
        assert!(read == bursts, "every burst comes back");
        let (snapshots, agreement) = replayed(flight);
        assert!(snapshots == flown, "every attitude comes back to the bit");
        assert_eq!(
            agreement,
            Agreement {
                bursts: 600_000,
                exact: 600_000,
                compared: 30_000,
                ..Agreement::default()
            }
        );
    }

    #[test]
    fn a_log_that_begins_in_flight_and_has_a_hole_is_exact_but_for_the_hole() {
        let bursts = bursts(45);
        let (mut bytes, flown) = fly(&bursts, 5_000);
        // A second of the line is lost, ten seconds after the log's start.
        let per_second = bytes.len() / 40;
        bytes.drain(12 * per_second..13 * per_second);
        let log = decode(&bytes);
        let flight = &log.flights[0];
        assert!((950..1_050).contains(&flight.lost()), "{}", flight.lost());
        let (snapshots, agreement) = replayed(flight);
        assert_eq!(agreement.different, 0);
        assert!(agreement.compared > 1_000);
        // From the hole to the next state nothing is promised.
        let inexact = agreement.bursts - agreement.exact;
        assert!((6_000..9_000).contains(&inexact), "{agreement:?}");
        let at = |t_us| flown.iter().find(|snapshot| snapshot.t_us == t_us).copied();
        for snapshot in [&snapshots[0], &snapshots[10_000], snapshots.last().unwrap()] {
            assert_eq!(Some(*snapshot), at(snapshot.t_us));
        }
    }

    #[test]
    fn of_a_line_with_every_hundredth_byte_wrong_all_that_is_whole_is_recovered() {
        let bursts = bursts(60);
        let (bytes, _) = fly(&bursts, 0);
        let mut random = 1_u64;
        let mut random = || {
            // Marsaglia's xorshift.
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random
        };
        // The frames of the clean stream, each with its two zeros, and which of them are hit.
        let mut damaged = bytes.clone();
        for byte in &mut damaged {
            if random() % 100 == 0 {
                *byte ^= 1 + (random() % 255) as u8;
            }
        }
        let mut whole = Vec::new();
        let mut total = 0;
        let mut start = 0;
        while start < bytes.len() {
            let end = start
                + 2
                + bytes[start + 1..]
                    .iter()
                    .position(|&byte| byte == 0)
                    .unwrap();
            total += 1;
            if bytes[start..end] == damaged[start..end] {
                let mut decoder = Decoder::new();
                whole.extend(
                    bytes[start..end]
                        .iter()
                        .filter_map(|&byte| decoder.push(byte)),
                );
            }
            start = end;
        }
        let mut decoder = Decoder::new();
        let found: Vec<_> = damaged
            .iter()
            .filter_map(|&byte| decoder.push(byte))
            .collect();
        assert!(found == whole, "{} of {}", found.len(), whole.len());
        assert!(
            (total / 2..total * 4 / 5).contains(&whole.len()),
            "{total} {}",
            whole.len()
        );
        let log = decode(&damaged);
        let lost = log.flights[0].lost();
        assert!(lost > 10_000 && lost + log.flights[0].bursts.len() as u64 > 59_990);
    }

    #[test]
    fn a_restart_of_the_module_is_another_flight() {
        let bursts = bursts(3);
        let (mut bytes, flown) = fly(&bursts, 0);
        bytes.extend(b"# aplomb on a board\n");
        bytes.extend(fly(&bursts, 0).0);
        let log = decode(&bytes);
        assert_eq!(log.flights.len(), 2);
        for flight in &log.flights {
            assert!(replayed(flight).0 == flown);
        }
    }

    /// A second's log, damaged, with whole frames of any numbers between.
    fn nearly_a_log() -> impl Strategy<Value = Vec<u8>> {
        static LOG: LazyLock<Vec<u8>> = LazyLock::new(|| fly(&bursts(2), 0).0);
        let change = (any::<prop::sample::Index>(), any::<u8>());
        let burst = (any::<u32>(), any::<u64>(), any::<[u8; 14]>()).prop_map(
            |(number, captured_at_us, bytes)| {
                let burst = Burst {
                    bytes,
                    captured_at_us,
                    missed_before: 0,
                };
                let flags = BoardFlags::from_bits_retain(number);
                Frame::Burst(NumberedBurst {
                    number,
                    flags,
                    burst,
                })
            },
        );
        let configuration = any::<u32>().prop_map(|from_number| {
            let mut settings = Settings::new(&Part::MPU_6050);
            settings.sensor_delay_us = Some(from_number);
            Frame::Configuration(Configuration {
                revision: REVISION,
                from_number,
                settings,
            })
        });
        let frame = prop_oneof![3 => burst, 1 => configuration];
        let insertion = (any::<prop::sample::Index>(), frame);
        (
            prop::collection::vec(change, 0..40),
            prop::collection::vec(insertion, 0..10),
            any::<prop::sample::Index>(),
        )
            .prop_map(|(changes, insertions, end)| {
                let mut bytes = LOG.clone();
                for (place, byte) in changes {
                    let place = place.index(bytes.len());
                    bytes[place] = byte;
                }
                for (place, frame) in insertions {
                    let place = place.index(bytes.len());
                    let frame = encode(&frame, &mut [0; FRAME_CAPACITY]).to_vec();
                    bytes.splice(place..place, frame);
                }
                bytes.truncate(end.index(bytes.len()));
                bytes
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        #[test]
        fn any_log_is_read_and_replayed_to_its_end(bytes in nearly_a_log()) {
            let log = decode(&bytes);
            let mut whole = 0;
            for flight in log.flown() {
                let numbers = flight.bursts.iter().map(|burst| burst.number);
                prop_assert!(numbers.is_sorted_by(|one, other| one < other));
                prop_assert!(flight.lost() <= u64::from(u32::MAX));
                whole += flight.bursts.len() as u64;
                let Ok(mut replay) = Replay::new(flight, FilterName::Kalman) else {
                    prop_assert!(flight.configurations.is_empty());
                    continue;
                };
                while let Some(snapshot) = replay.next() {
                    let q = snapshot.attitude;
                    prop_assert!((q.dot(q) - 1.0).abs() < 1e-3, "{q:?}");
                }
                let agreement = replay.agreement();
                prop_assert_eq!(agreement.bursts, flight.bursts.len() as u64);
                prop_assert!(agreement.compared <= agreement.exact && agreement.exact <= agreement.bursts);
            }
            prop_assert!(whole <= log.counts.frames);
        }
    }

    #[test]
    fn another_filter_is_never_called_exact() {
        let bursts = bursts(3);
        let log = decode(&fly(&bursts, 0).0);
        let mut replay =
            Replay::new(&log.flights[0], FilterName::Classic).expect("there is a configuration");
        while replay.next().is_some() {}
        assert_eq!(
            (replay.agreement().bursts, replay.agreement().exact),
            (3_000, 0)
        );
    }
}
