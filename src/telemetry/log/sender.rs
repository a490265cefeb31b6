//! Sender: writes bursts, configurations and states as they fit.

use super::super::output::Output;
use super::frame::{
    BYTES_PER_BURST, Configuration, FRAME_CAPACITY, Frame, NumberedBurst, PIECE_LENGTH, StatePiece,
    Text, encode,
};
use crate::estimator::REVISION;
use crate::pipeline::{Pipeline, Snapshot};
use crate::serialize::StateWriter;

/// Time between two configurations, µs.
const CONFIGURATION_PERIOD_US: u64 = 1_000_000;

/// Time between two states, µs.
const STATE_PERIOD_US: u64 = 10_000_000;

/// Pieces of the state per call, so that bursts find room.
const PIECES_PER_CALL: usize = 4;

/// Sender of a flight log.
///
/// The telemetry task owns it. If [`wants_state`](Self::wants_state), the task copies the pipeline
/// with [`copy_state`](Self::copy_state); then [`fill`](Self::fill) writes as much as there is room
/// for.
#[derive(Debug, Clone)]
pub struct Sender {
    state: Option<StateCopy>,
    next_state_us: u64,
    next_configuration_us: u64,
    from_number: u32,
}

/// Copy of the pipeline, to be sent in pieces.
#[derive(Debug, Clone, Copy)]
struct StateCopy {
    pipeline: Pipeline,
    number: u32,
    /// Bytes of the state that were sent.
    sent: usize,
    /// Length of the state, bytes.
    length: usize,
}

impl Sender {
    /// Creates a sender for a log that begins with the burst of this number.
    pub const fn new(next_number: u32) -> Self {
        Self {
            state: None,
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
        self.state = Some(StateCopy {
            pipeline: *pipeline,
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
        state.pipeline.visit_state(&mut measure);
        // A pipeline that still averages has no byte form; the next copy comes sooner.
        let (length, pause_us) = match measure.length() {
            Some(length) => (length, STATE_PERIOD_US),
            None => (0, CONFIGURATION_PERIOD_US),
        };
        state.length = length;
        self.next_state_us = now_us + pause_us;
    }

    /// Writes as much as there is room for. `bursts` returns the oldest burst that was not sent;
    /// `now_us` is the time since boot, µs.
    #[inline(never)]
    pub fn fill(
        &mut self,
        now_us: u64,
        output: &mut Output<'_>,
        mut bursts: impl FnMut() -> Option<NumberedBurst>,
    ) {
        let mut bytes = [0; FRAME_CAPACITY];
        if let Some(state) = &self.state
            && now_us >= self.next_configuration_us
        {
            let configuration = Frame::Configuration(Configuration {
                revision: REVISION,
                from_number: self.from_number,
                settings: *state.pipeline.settings(),
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
            state.pipeline.visit_state(&mut window);
            if !output.put(encode(&Frame::StatePiece(piece), &mut bytes)) {
                return;
            }
            state.sent += PIECE_LENGTH;
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
