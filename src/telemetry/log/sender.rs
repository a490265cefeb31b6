//! Sender: writes bursts, configurations and states as they fit.

use super::super::output::Output;
use super::frame::{
    BYTES_PER_BURST, BYTES_PER_READING, Configuration, FRAME_CAPACITY, Frame, HeadingState,
    NumberedBurst, PIECE_LENGTH, StatePiece, Text, TimedHeading, encode,
};
use crate::compass;
use crate::estimator::REVISION;
use crate::estimator::heading::Heading;
use crate::pipeline::{CompassReading, Pipeline, Settings, Snapshot};
use crate::serialize::{StateVisitor, StateWriter};

/// Time between two configurations, µs.
const CONFIGURATION_PERIOD_US: u64 = 1_000_000;

/// Time between two states, µs.
const STATE_PERIOD_US: u64 = 10_000_000;

/// Longest time between two frames of a heading, µs: the first may be damaged.
const HEADING_PERIOD_US: u64 = 1_000_000;

/// Pieces of the state per call, so that bursts find room.
const PIECES_PER_CALL: usize = 4;

/// Sender of a flight log.
///
/// The telemetry task owns it. If [`wants_state`](Self::wants_state), the task copies the pipeline
/// with [`copy_state`](Self::copy_state). When that state is sent, the sender
/// [`wants_heading`](Self::wants_heading), in the same memory. [`fill`](Self::fill) writes as much
/// as there is room for.
#[derive(Debug, Clone)]
pub struct Sender {
    state: Option<StateCopy>,
    /// The heading filter's state follows the pipeline's.
    is_heading_pending: bool,
    /// Settings of the last pipeline that was copied.
    settings: Option<Settings>,
    heading: Option<TimedHeading>,
    next_heading_us: u64,
    next_state_us: u64,
    next_configuration_us: u64,
    from_number: u32,
}

/// Copy of a state, to be sent in pieces.
#[derive(Debug, Clone, Copy)]
struct StateCopy {
    copied: Copied,
    number: u32,
    /// Bytes of the state that were sent.
    sent: usize,
    /// Length of the state, bytes.
    length: usize,
}

/// State that is sent.
#[derive(Debug, Clone, Copy)]
#[allow(
    clippy::large_enum_variant,
    reason = "both take the same memory in turn, and nothing is allocated"
)]
enum Copied {
    Pipeline(Pipeline),
    Heading(HeadingState),
}

impl Copied {
    fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        match self {
            Self::Pipeline(pipeline) => pipeline.visit_state(visitor),
            // Without a compass the firmware has no code for its state.
            Self::Heading(heading) if compass::IS_BUILT_IN => heading.visit_state(visitor),
            Self::Heading(_) => {}
        }
    }
}

impl Sender {
    /// Creates a sender for a log that begins with the burst of this number.
    pub const fn new(next_number: u32) -> Self {
        Self {
            state: None,
            is_heading_pending: false,
            settings: None,
            heading: None,
            next_heading_us: 0,
            next_state_us: 0,
            next_configuration_us: 0,
            from_number: next_number,
        }
    }

    /// Restarts the log because the settings change with the burst of this number. The sender needs
    /// a state at once, and a configuration follows it.
    pub fn restart(&mut self, next_number: u32) {
        *self = Self::new(next_number);
    }

    /// Returns whether the sender needs a copy of the pipeline now. `now_us` is the time since
    /// boot, µs.
    pub fn wants_state(&self, now_us: u64) -> bool {
        now_us >= self.next_state_us
    }

    /// Copies the pipeline before the burst of this number. Does nothing else, because the pipeline
    /// is locked meanwhile; [`measure_state`](Self::measure_state) must follow.
    #[inline(never)]
    pub fn copy_state(&mut self, pipeline: &Pipeline, next_number: u32) {
        self.settings = Some(*pipeline.settings());
        self.state = Some(StateCopy {
            copied: Copied::Pipeline(*pipeline),
            number: next_number,
            sent: 0,
            length: 0,
        });
        self.is_heading_pending = true;
    }

    /// Returns whether the sender needs a copy of the heading filter now: the pipeline's state has
    /// been sent.
    pub fn wants_heading(&self) -> bool {
        let is_sent = |state: &StateCopy| state.length > 0 && state.sent >= state.length;
        self.is_heading_pending && self.state.as_ref().is_some_and(is_sent)
    }

    /// Copies the heading filter before the burst of this number, where the compass's next reading
    /// has the number `next_reading`. `filter` is `None` while it waits for a reading. Before the
    /// first reading there is nothing to send. [`measure_state`](Self::measure_state) must follow.
    #[inline(never)]
    pub fn copy_heading(&mut self, filter: Option<&Heading>, next_reading: u32, next_number: u32) {
        self.is_heading_pending = false;
        if next_reading == 0 {
            return;
        }
        self.state = Some(StateCopy {
            copied: Copied::Heading(HeadingState {
                next_reading,
                filter: filter.copied(),
            }),
            number: next_number,
            sent: 0,
            length: 0,
        });
    }

    /// Measures the length of the copied state, and schedules the next one. `now_us` is the time
    /// since boot, µs.
    #[inline(never)]
    pub fn measure_state(&mut self, now_us: u64) {
        let Some(state) = &mut self.state else {
            return;
        };
        let mut measure = StateWriter::new(&mut [], 0);
        state.copied.visit_state(&mut measure);
        // A state with a value out of range has no byte form; the next copy comes sooner.
        let (length, pause_us) = match measure.length() {
            Some(length) => (length, STATE_PERIOD_US),
            None => (0, CONFIGURATION_PERIOD_US),
        };
        state.length = length;
        if let Copied::Pipeline(_) = state.copied {
            self.next_state_us = now_us + pause_us;
        }
    }

    /// Writes as much as there is room for. `bursts` and `readings` return the oldest burst and
    /// the oldest reading of the compass that were not sent; `now_us` is the time since boot, µs.
    #[inline(never)]
    pub fn fill(
        &mut self,
        now_us: u64,
        output: &mut Output<'_>,
        mut bursts: impl FnMut() -> Option<NumberedBurst>,
        mut readings: impl FnMut() -> Option<CompassReading>,
    ) {
        let mut bytes = [0; FRAME_CAPACITY];
        if let Some(settings) = &self.settings
            && now_us >= self.next_configuration_us
        {
            let configuration = Frame::Configuration(Configuration {
                revision: REVISION,
                from_number: self.from_number,
                settings: *settings,
            });
            if output.put(encode(&configuration, &mut bytes)) {
                self.next_configuration_us = now_us + CONFIGURATION_PERIOD_US;
            }
        }
        while output.has_room(BYTES_PER_BURST)
            && let Some(burst) = bursts()
        {
            output.put(encode(&Frame::Burst(burst), &mut bytes));
        }
        while compass::IS_BUILT_IN
            && output.has_room(BYTES_PER_READING)
            && let Some(reading) = readings()
        {
            output.put(encode(&Frame::Reading(reading), &mut bytes));
        }
        self.put_pieces(output, &mut bytes);
    }

    /// Writes the next pieces of the state.
    fn put_pieces(&mut self, output: &mut Output<'_>, bytes: &mut [u8; FRAME_CAPACITY]) {
        let Some(state) = &mut self.state else {
            return;
        };
        for _ in 0..PIECES_PER_CALL {
            if state.sent >= state.length {
                return;
            }
            let mut piece = StatePiece {
                number: state.number,
                offset: state.sent as u16,
                state_length: state.length as u16,
                data: [0; PIECE_LENGTH],
            };
            let mut window = StateWriter::new(&mut piece.data, state.sent);
            state.copied.visit_state(&mut window);
            let frame = match state.copied {
                Copied::Pipeline(_) => Frame::StatePiece(piece),
                Copied::Heading(_) => Frame::HeadingPiece(piece),
            };
            if !output.put(encode(&frame, bytes)) {
                return;
            }
            state.sent += PIECE_LENGTH;
        }
    }

    /// Writes the latest heading if it has changed since the last one, or after a second. `now_us`
    /// is the time since boot, µs.
    #[inline(never)]
    pub fn put_heading(&mut self, now_us: u64, heading: TimedHeading, output: &mut Output<'_>) {
        if self.heading == Some(heading) && now_us < self.next_heading_us {
            return;
        }
        let mut bytes = [0; FRAME_CAPACITY];
        if output.put(encode(&Frame::Heading(heading), &mut bytes)) {
            self.heading = Some(heading);
            self.next_heading_us = now_us + HEADING_PERIOD_US;
        }
    }
}

/// Writes an attitude. Returns false if there was no room.
#[inline(never)]
pub fn put_attitude(snapshot: &Snapshot, output: &mut Output<'_>) -> bool {
    let mut bytes = [0; FRAME_CAPACITY];
    output.put(encode(&Frame::Attitude(*snapshot), &mut bytes))
}

/// Writes a message, a long one in several frames. Returns false if there was no room for all of
/// it.
#[inline(never)]
pub fn put_text(text: &str, output: &mut Output<'_>) -> bool {
    let mut bytes = [0; FRAME_CAPACITY];
    let mut rest = text;
    while !rest.is_empty() {
        let part = Text::new(rest);
        if !output.put(encode(&Frame::Text(part), &mut bytes)) {
            return false;
        }
        rest = rest.get(part.as_str().len()..).unwrap_or_default();
    }
    true
}
