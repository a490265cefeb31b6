//! Flight logs of the module: read step by step, and [recorded](Recorder) from bursts.
//!
//! A log is read twice, each time from its beginning and in little memory: once for a summary of
//! its flights, and once for the [steps](Steps) of a flight. The pieces of a filter's state come
//! after the bursts that follow that state, so the second reading looks ahead by some seconds.

mod recorder;
mod steps;
mod text_joiner;

pub use recorder::Recorder;
pub use steps::{Step, Steps};
pub use text_joiner::TextJoiner;

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use aplomb::telemetry::log::{Configuration, Counts, Frame, NumberedBurst, StatePiece};

use crate::foreign::{GZIP, format_of};
use crate::lines::is_text;
use crate::terminal::print_message;
use steps::Frames;

/// Bytes at a file's start in which [`is_flight_log`] searches a frame.
const INSPECTED_BYTES: usize = 64 * 1024;
/// Most flights of a log.
const MOST_FLIGHTS: usize = 10_000;
/// Most messages of a log that are kept.
const MOST_MESSAGES: usize = 10_000;
/// Most readings of the compass between two bursts that are counted.
const MOST_READINGS: usize = 10_000;

/// Opens the bytes of a log, from the beginning.
type Open = dyn Fn() -> Result<Box<dyn Read>, String>;

/// Summary of a flight log.
pub struct FlightLog {
    open: Box<Open>,
    /// Flights, one for each start of the module.
    pub flights: Vec<Flight>,
    /// Counts of the decoder.
    pub counts: Counts,
    /// Messages of the module, in order; of very many, the first.
    pub messages: Vec<String>,
    /// Reading stopped before the end of the file.
    pub is_cut_off: bool,
}

/// Summary of one flight: from a start of the module to the next.
#[derive(Clone, Debug, Default)]
pub struct Flight {
    /// Place among the flights.
    index: usize,
    /// First settings; `None` if there are none in the log.
    pub configuration: Option<Configuration>,
    /// Number of bursts.
    pub bursts: u64,
    /// Numbers of the first and the last burst.
    numbers: Option<(u32, u32)>,
    /// Number and time of the last burst, µs.
    last: Option<(u32, u64)>,
    /// Number of readings of the compass.
    pub readings: u64,
    /// Readings that are missing between the first and the last.
    pub readings_lost: u64,
    /// Number of the last reading.
    last_reading: Option<u32>,
}

impl FlightLog {
    /// Returns the flights that have bursts.
    pub fn flown(&self) -> impl Iterator<Item = &Flight> {
        self.flights.iter().filter(|flight| flight.bursts > 0)
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

    /// Returns the steps of a flight, read anew.
    ///
    /// # Errors
    ///
    /// Returns a message if the file cannot be opened again.
    pub fn steps(&self, flight: &Flight) -> Result<Steps, String> {
        Ok(Steps::new(Frames::new((self.open)()?), flight.index))
    }

    /// Reads the bytes of a log once, for its summary. Returns the error that ended the reading
    /// too early, too. `open` opens the log again, for the steps of a flight.
    fn scan(
        open: Box<Open>,
        bytes: Box<dyn Read>,
    ) -> Result<(Self, Option<std::io::Error>), String> {
        let mut frames = Frames::new(bytes);
        let mut flights = Vec::new();
        let mut messages = Vec::new();
        let mut joiner = TextJoiner::default();
        let mut flight = Flight::default();
        // Settings after the last burst belong to the next one, perhaps of another flight.
        let mut upcoming = None;
        // Readings of the compass likewise.
        let mut readings = Vec::new();
        for frame in frames.by_ref() {
            let message = match &frame {
                Frame::Text(piece) => joiner.add(piece),
                _ => joiner.end(),
            };
            if messages.len() < MOST_MESSAGES {
                messages.extend(message);
            }
            match frame {
                Frame::Burst(burst) => {
                    if flight.last.is_some_and(|last| is_new_start(last, &burst)) {
                        let index = flight.index + 1;
                        flights.push(std::mem::take(&mut flight));
                        flight.index = index;
                        if index >= MOST_FLIGHTS {
                            return Err(format!("the module started over {index} times in it"));
                        }
                    }
                    flight.take(upcoming.take());
                    flight.count(&burst);
                    flight.count_readings(&mut readings);
                }
                Frame::Reading(reading) if readings.len() < MOST_READINGS => {
                    readings.push(reading.number);
                }
                Frame::Configuration(configuration) => {
                    upcoming.get_or_insert(configuration);
                }
                _ => {}
            }
        }
        messages.extend(joiner.end());
        flight.take(upcoming);
        flight.count_readings(&mut readings);
        flights.push(flight);
        let (counts, error) = frames.end();
        let log = Self {
            open,
            flights,
            counts,
            messages,
            is_cut_off: error.is_some(),
        };
        Ok((log, error))
    }
}

impl Flight {
    /// Returns how many bursts are missing between the first and the last.
    #[must_use]
    pub fn lost(&self) -> u64 {
        match self.numbers {
            Some((first, last)) => u64::from(last - first) + 1 - self.bursts,
            None => 0,
        }
    }

    fn take(&mut self, configuration: Option<Configuration>) {
        if self.configuration.is_none() {
            self.configuration = configuration;
        }
    }

    fn count(&mut self, burst: &NumberedBurst) {
        self.bursts += 1;
        let first = self.numbers.map_or(burst.number, |(first, _)| first);
        self.numbers = Some((first, burst.number));
        self.last = Some((burst.number, burst.burst.captured_at_us));
    }

    /// Counts readings of the compass, and removes them.
    fn count_readings(&mut self, numbers: &mut Vec<u32>) {
        for number in numbers.drain(..) {
            self.readings += 1;
            let step = self.last_reading.and_then(|last| number.checked_sub(last));
            // A number that is not larger belongs to another start.
            self.readings_lost += u64::from(step.unwrap_or(0).saturating_sub(1));
            self.last_reading = Some(number);
        }
    }
}

/// Time by which a burst is before the last one if the module has started again, µs. Within a
/// flight no burst is.
const BACK_US: u64 = 100_000;

/// Returns whether the module has started again before a burst, after the last one of this number
/// and time (µs): the number or the time goes back.
#[must_use]
pub fn is_new_start(last: (u32, u64), burst: &NumberedBurst) -> bool {
    let (number, t_us) = last;
    burst.number <= number || burst.burst.captured_at_us.saturating_add(BACK_US) < t_us
}

/// Returns whether a file is a flight log, which has zero bytes and others of no text. A text may
/// end with zero bytes after a crash. Other formats have a signature.
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
    bytes.contains(&0) && !is_text(&bytes) && format_of(&bytes).is_none()
}

/// Reads a log, plain or gzipped, for its summary. If it cannot be read to its end, warns on
/// standard error and uses the part before.
///
/// # Errors
///
/// Returns a message with the path if the file cannot be opened or has no burst.
pub fn read(path: &Path) -> Result<FlightLog, String> {
    let at = |error: String| format!("{}: {error}", path.display());
    let name = path.to_owned();
    let (log, error) = FlightLog::scan(Box::new(move || open(&name)), open(path)?).map_err(at)?;
    if let Some(error) = &error {
        print_message(&format!(
            "warning: {}: cut off or damaged ({error}): this is what came before",
            path.display()
        ));
    }
    if log.flown().next().is_none() {
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
        && magic == GZIP;
    let file = File::open(path).map_err(text)?;
    Ok(if is_zipped {
        Box::new(flate2::read::MultiGzDecoder::new(file))
    } else {
        Box::new(file)
    })
}

/// Reads the bytes of a log for its summary.
///
/// # Errors
///
/// Returns a message if there are too many flights in it.
pub fn decode(bytes: &[u8]) -> Result<FlightLog, String> {
    let bytes: Arc<[u8]> = bytes.into();
    let open: Box<Open> = Box::new(move || Ok(Box::new(std::io::Cursor::new(Arc::clone(&bytes)))));
    let all = open()?;
    Ok(FlightLog::scan(open, all)?.0)
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
