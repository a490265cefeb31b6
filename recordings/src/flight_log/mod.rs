//! Flight logs of the module: read as a whole, and [recorded](Recorder) from bursts.
//!
//! A log is read as a whole because the pieces of a filter's state come after the bursts that
//! follow that state.

mod recorder;

pub use recorder::Recorder;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use aplomb::pipeline::Snapshot;
use aplomb::telemetry::log::{Configuration, Counts, Decoder, Frame, NumberedBurst, StatePiece};

/// Bytes at a file's start in which [`is_flight_log`] searches a frame.
const INSPECTED_BYTES: usize = 64 * 1024;

/// A flight log.
#[derive(Debug, Default)]
pub struct FlightLog {
    /// Flights, one for each start of the module.
    pub flights: Vec<Flight>,
    /// Counts of the decoder.
    pub counts: Counts,
    /// Messages of the module, in order.
    pub messages: Vec<String>,
    /// Reading stopped before the end of the file.
    pub is_cut_off: bool,
}

/// Log of one flight: from a start of the module to the next.
#[derive(Debug, Default)]
pub struct Flight {
    /// Changes of the settings, in order; the first is where the log begins.
    pub configurations: Vec<Configuration>,
    /// Bursts, in order.
    pub bursts: Vec<NumberedBurst>,
    /// Attitudes by their time.
    attitudes: BTreeMap<u64, Snapshot>,
    /// Whole states by the number of the burst that comes next.
    states: BTreeMap<u32, Vec<u8>>,
}

impl FlightLog {
    /// Returns the flights that have bursts.
    pub fn flown(&self) -> impl Iterator<Item = &Flight> {
        self.flights
            .iter()
            .filter(|flight| !flight.bursts.is_empty())
    }

    /// Returns the flight of this number, counted from 1. Without a number, returns the only
    /// flight.
    ///
    /// # Errors
    ///
    /// Returns the reason if there is no such flight, or several and no number.
    pub fn flight(&self, number: Option<usize>) -> Result<&Flight, String> {
        let count = self.flown().count();
        let index = match number {
            None if count > 1 => {
                return Err(format!(
                    "the module started {count} times in it: \
                     choose a flight with --flight 1 to --flight {count}"
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
    /// Returns how many bursts are missing between the first and the last.
    #[must_use]
    pub fn lost(&self) -> u64 {
        match (self.bursts.first(), self.bursts.last()) {
            (Some(first), Some(last)) => {
                u64::from(last.number - first.number) + 1 - self.bursts.len() as u64
            }
            _ => 0,
        }
    }

    /// Returns the logged attitude of this time.
    #[must_use]
    pub fn attitude(&self, t_us: u64) -> Option<&Snapshot> {
        self.attitudes.get(&t_us)
    }

    /// Returns the logged state of the pipeline before the burst of this number, as bytes.
    #[must_use]
    pub fn state(&self, next_number: u32) -> Option<&[u8]> {
        self.states.get(&next_number).map(Vec::as_slice)
    }

    fn add(&mut self, frame: Frame, collector: &mut StateCollector) {
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

/// Returns whether a file is a flight log: a text has no zero bytes.
#[must_use]
pub fn is_flight_log(path: &Path) -> bool {
    // Reading a pipe would consume its bytes.
    if !path.is_file() {
        return false;
    }
    let mut bytes = Vec::new();
    if let Ok(file) = open(path) {
        // The bytes before an error are enough.
        let _ = file.take(INSPECTED_BYTES as u64).read_to_end(&mut bytes);
    }
    bytes.contains(&0)
}

/// Reads a log, plain or gzipped. If it cannot be read to its end, warns on standard error and uses
/// the part before.
///
/// # Errors
///
/// Returns a message with the path if the file cannot be opened or has no burst.
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
            "there is no burst in it: {} frames, {} pieces that are none. \
             Was it recorded with `format log`, at the module's baud rate?",
            log.counts.frames, log.counts.damaged
        )));
    }
    Ok(log)
}

/// Opens a file, plain or gzipped.
///
/// # Errors
///
/// Returns a message with the path if the file cannot be opened.
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

/// Decodes the bytes of a log.
#[must_use]
pub fn decode(bytes: &[u8]) -> FlightLog {
    let mut decoder = Decoder::new();
    let mut log = FlightLog::default();
    let mut flight = Flight::default();
    // Frames after the last burst belong to the next one, which may be the first of another flight.
    let mut upcoming = Vec::new();
    let mut collector = StateCollector::default();
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
                    collector = StateCollector::default();
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

/// Collector of a state's pieces.
#[derive(Debug, Default)]
pub struct StateCollector {
    number: u32,
    bytes: Vec<u8>,
}

impl StateCollector {
    /// Adds a piece. Returns the whole state, with the number of the burst that comes next, when
    /// the piece completes it.
    pub fn add(&mut self, piece: &StatePiece) -> Option<(u32, Vec<u8>)> {
        if piece.offset == 0 {
            self.number = piece.number;
            self.bytes.clear();
        }
        if piece.number != self.number || usize::from(piece.offset) != self.bytes.len() {
            return None;
        }
        self.bytes.extend_from_slice(piece.bytes());
        let is_complete = self.bytes.len() == usize::from(piece.state_length);
        is_complete.then(|| (self.number, std::mem::take(&mut self.bytes)))
    }
}
