//! Steps of a flight: each burst with what else the log holds for it.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Read};

use aplomb::pipeline::{CompassReading, Snapshot};
use aplomb::telemetry::log::{Configuration, Counts, Decoder, Frame, NumberedBurst, TimedHeading};

use super::{StateCollector, is_new_start};

/// Bursts that are read ahead. A state is sent anew after 10 s, or 10,000 bursts.
const BURSTS_AHEAD: usize = 20_000;
/// Most frames of each other kind that are kept for bursts to come.
const MOST_KEPT: usize = 20_000;
/// Most states of a filter that are kept for bursts to come.
const MOST_STATES: usize = 20;
/// Bytes that are read at once.
const BUFFER_LENGTH: usize = 64 * 1024;

/// Frames of a log, in order.
pub(super) struct Frames {
    bytes: Box<dyn Read>,
    decoder: Decoder,
    buffer: Vec<u8>,
    /// Bytes of the buffer that were decoded.
    used: usize,
    is_over: bool,
    error: Option<io::Error>,
}

impl Frames {
    pub(super) fn new(bytes: Box<dyn Read>) -> Self {
        Self {
            bytes,
            decoder: Decoder::new(),
            buffer: Vec::new(),
            used: 0,
            is_over: false,
            error: None,
        }
    }

    /// Returns the decoder's counts, and the error that ended the reading too early.
    pub(super) fn end(self) -> (Counts, Option<io::Error>) {
        (self.decoder.counts(), self.error)
    }

    /// Reads the next bytes into the buffer, which is empty at the end.
    fn fill(&mut self) {
        self.used = 0;
        self.buffer.resize(BUFFER_LENGTH, 0);
        let length = loop {
            match self.bytes.read(&mut self.buffer) {
                Ok(length) => break length,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    self.error = Some(error);
                    break 0;
                }
            }
        };
        self.buffer.truncate(length);
    }
}

impl Iterator for Frames {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        while !self.is_over {
            if self.used == self.buffer.len() {
                self.fill();
                if self.buffer.is_empty() {
                    // A log that was cut off may end with a whole frame whose last zero is missing.
                    self.is_over = true;
                    return self.decoder.push(0);
                }
            }
            let byte = self.buffer[self.used];
            self.used += 1;
            if let Some(frame) = self.decoder.push(byte) {
                return Some(frame);
            }
        }
        None
    }
}

/// Burst of a flight, with what else the log holds for it.
#[derive(Clone, Debug)]
pub struct Step {
    /// Burst.
    pub numbered: NumberedBurst,
    /// New settings from this burst on.
    pub configuration: Option<Configuration>,
    /// State of the pipeline before this burst, as bytes.
    pub state: Option<Vec<u8>>,
    /// Logged attitude of this burst's time.
    pub attitude: Option<Snapshot>,
    /// State of the heading filter before this burst, as bytes of a
    /// [`HeadingState`](aplomb::telemetry::log::HeadingState).
    pub heading_state: Option<Vec<u8>>,
    /// Reading of the compass that the heading filter took after this burst. If that burst is
    /// missing, the reading comes with the next one.
    pub reading: Option<CompassReading>,
    /// Heading that changed at this burst's time.
    pub heading: Option<TimedHeading>,
}

/// Steps of one flight, in order. Needs the same memory for a flight of any length.
pub struct Steps {
    frames: Frames,
    /// Place of the flight whose frames come now, and of the one that is asked for.
    present: usize,
    wanted: usize,
    /// Number and time of the last burst that was read, µs.
    last: Option<(u32, u64)>,
    /// Frames since the last burst: of its flight, or of the next one.
    upcoming: VecDeque<Frame>,
    bursts: VecDeque<NumberedBurst>,
    collector: StateCollector,
    states: BTreeMap<u32, Vec<u8>>,
    attitudes: BTreeMap<u64, Snapshot>,
    heading_collector: StateCollector,
    heading_states: BTreeMap<u32, Vec<u8>>,
    readings: BTreeMap<u64, CompassReading>,
    headings: BTreeMap<u64, TimedHeading>,
    configurations: VecDeque<Configuration>,
    last_configuration: Option<Configuration>,
    is_over: bool,
}

impl Steps {
    pub(super) fn new(frames: Frames, wanted: usize) -> Self {
        Self {
            frames,
            present: 0,
            wanted,
            last: None,
            upcoming: VecDeque::new(),
            bursts: VecDeque::new(),
            collector: StateCollector::default(),
            states: BTreeMap::new(),
            attitudes: BTreeMap::new(),
            heading_collector: StateCollector::default(),
            heading_states: BTreeMap::new(),
            readings: BTreeMap::new(),
            headings: BTreeMap::new(),
            configurations: VecDeque::new(),
            last_configuration: None,
            is_over: false,
        }
    }

    /// Reads one frame ahead.
    fn read(&mut self) {
        match self.frames.next() {
            Some(Frame::Burst(burst)) => {
                if self.last.is_some_and(|last| is_new_start(last, &burst)) {
                    self.present += 1;
                }
                self.last = Some((burst.number, burst.burst.captured_at_us));
                if self.present > self.wanted {
                    self.is_over = true;
                    return;
                }
                self.keep_upcoming();
                if self.present == self.wanted {
                    self.bursts.push_back(burst);
                }
            }
            Some(Frame::Text(_)) => {}
            Some(frame) => {
                if self.upcoming.len() == MOST_KEPT {
                    self.upcoming.pop_front();
                }
                self.upcoming.push_back(frame);
            }
            None => {
                self.keep_upcoming();
                self.is_over = true;
            }
        }
    }

    /// Keeps the frames before a burst, if they are of the wanted flight.
    fn keep_upcoming(&mut self) {
        for frame in std::mem::take(&mut self.upcoming) {
            if self.present == self.wanted {
                self.keep(frame);
            }
        }
    }

    fn keep(&mut self, frame: Frame) {
        match frame {
            Frame::Configuration(configuration)
                if self.last_configuration.as_ref() != Some(&configuration) =>
            {
                // The first one is where the log begins.
                if self.last_configuration.is_some() && self.configurations.len() < MOST_KEPT {
                    self.configurations.push_back(configuration);
                }
                self.last_configuration = Some(configuration);
            }
            Frame::Attitude(snapshot) => {
                insert(&mut self.attitudes, snapshot.t_us, snapshot);
            }
            Frame::StatePiece(piece) => {
                keep_state(&mut self.states, self.collector.add(&piece));
            }
            Frame::HeadingPiece(piece) => {
                keep_state(&mut self.heading_states, self.heading_collector.add(&piece));
            }
            Frame::Reading(reading) => {
                insert(&mut self.readings, reading.sample_t_us, reading);
            }
            Frame::Heading(heading) => {
                insert(&mut self.headings, heading.t_us, heading);
            }
            _ => {}
        }
    }
}

/// Inserts a value. Of very many the first is dropped.
fn insert<T>(values: &mut BTreeMap<u64, T>, t_us: u64, value: T) {
    values.insert(t_us, value);
    if values.len() > MOST_KEPT {
        values.pop_first();
    }
}

/// Keeps a state that is complete.
fn keep_state(states: &mut BTreeMap<u32, Vec<u8>>, state: Option<(u32, Vec<u8>)>) {
    states.extend(state);
    if states.len() > MOST_STATES {
        states.pop_first();
    }
}

/// Takes the state before the burst of this number, and drops older ones.
fn take_state(states: &mut BTreeMap<u32, Vec<u8>>, number: u32) -> Option<Vec<u8>> {
    while states
        .first_key_value()
        .is_some_and(|(first, _)| *first < number)
    {
        states.pop_first();
    }
    states.remove(&number)
}

/// Takes the last value up to this time, and drops older ones.
fn take_until<T>(values: &mut BTreeMap<u64, T>, t_us: u64) -> Option<T> {
    let mut last = None;
    while values
        .first_key_value()
        .is_some_and(|(first, _)| *first <= t_us)
    {
        last = values.pop_first().map(|(_, value)| value);
    }
    last
}

impl Iterator for Steps {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        while !self.is_over && self.bursts.len() <= BURSTS_AHEAD {
            self.read();
        }
        let numbered = self.bursts.pop_front()?;
        let (number, t_us) = (numbered.number, numbered.burst.captured_at_us);
        let changes = |next: &mut Configuration| next.from_number <= number;
        let heading = take_until(&mut self.headings, t_us);
        Some(Step {
            numbered,
            configuration: self.configurations.pop_front_if(changes),
            state: take_state(&mut self.states, number),
            attitude: self.attitudes.remove(&t_us),
            heading_state: take_state(&mut self.heading_states, number),
            reading: take_until(&mut self.readings, t_us),
            heading: heading.filter(|heading| heading.t_us == t_us),
        })
    }
}
