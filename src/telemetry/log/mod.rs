//! Flight log: every burst, and all that a replay needs to compute the same attitudes, to the bit.
//!
//! # Frames
//!
//! A frame is a body of at most [`BODY_CAPACITY`] bytes and its CRC-32 (ISO-HDLC, low byte first).
//! COBS stuffs it so that no byte in it is zero, between two zeros. Each frame has both its zeros,
//! so that a damaged one damages no other, and each can be read without the frames before it. A
//! decoder counts and skips other bytes on the line, such as text and halves of frames. The CRC has
//! 32 bits: with 1 % of the bytes flipped, 16 bits would accept a wrong frame in every few logs of
//! ten minutes.
//!
//! | kind | body | when |
//! |---|---|---|
//! | 1 | configuration: versions, settings, first burst | at start, once a second, after a change |
//! | 2 | burst: number, board's flags, time (48 bits of µs), missed edges, 14 bytes | each |
//! | 3 | attitude: time, quaternion, rates, flags; to check a replay | at the telemetry rate |
//! | 4 | piece of the filter's state | at start, every ten seconds, after a change |
//! | 5 | message as text | as it comes |
//! | 6 | compass: number, times, knowledge, field, declination | each reading |
//! | 7 | piece of the heading filter's state | after the pieces of the filter's state |
//! | 8 | heading: time, offset to yaw, σ; to check a replay | each change, once a second |
//!
//! Kinds 6 to 8 come with a compass alone. A decoder that does not know them counts them as damaged
//! pieces, and reads the others.
//!
//! # How a replay is exact
//!
//! An attitude depends on every burst since the filter's start. A log may begin in flight and have
//! holes, so it contains the state:
//! [`Pipeline::visit_state`](crate::pipeline::Pipeline::visit_state) as bytes (1.7 KiB), in pieces
//! between the bursts. A replay that has all pieces of a state, and every burst from that state's
//! number on, computes the attitudes of the flight. It stays exact until a burst is lost or the
//! settings change, and is exact again from the next state on. That holds for the same
//! [`REVISION`](crate::estimator::REVISION) of the filters.
//!
//! The heading depends on the readings of the compass too. Each has a number, and the time of the
//! sample after which the heading filter took it. A replay adds it after that sample. The heading
//! is exact from the filter's first reading on, or from a [`HeadingState`] on. It stays exact while
//! the attitude is exact and no reading is missing.
//!
//! # Load
//!
//! At 1 kHz and 50 attitudes a second the log takes 40 kB/s, 44 % of 921,600 baud; with a compass
//! 42 kB/s, 46 %. It takes 1.5 % of the core at 168 MHz. ([`BYTES_PER_BURST`] is the size of a
//! burst.) [`Sender`] never waits: a burst or a reading without room is left out, and the gap in
//! the numbers shows it. Configurations come first, then bursts, then readings, then pieces of the
//! state.
//!
//! ```
//! use aplomb::telemetry::log::{Decoder, FRAME_CAPACITY, Frame, Text, encode};
//!
//! let frame = Frame::Text(Text::new("ready"));
//! let mut buffer = [0; FRAME_CAPACITY];
//! let mut decoder = Decoder::new();
//! let noise = b"not a frame".iter();
//! let found: Vec<_> = noise
//!     .chain(encode(&frame, &mut buffer))
//!     .filter_map(|byte| decoder.push(*byte))
//!     .collect();
//! assert_eq!(found, [frame]);
//! assert_eq!(decoder.counts().damaged_bytes, 11);
//! ```

mod decoder;
mod frame;
mod sender;
#[cfg(test)]
mod tests;

pub use decoder::{Counts, Decoder};
pub use frame::{
    BODY_CAPACITY, BYTES_PER_ATTITUDE, BYTES_PER_BURST, BYTES_PER_HEADING, BYTES_PER_READING,
    Configuration, FORMAT_VERSION, FRAME_CAPACITY, Frame, HeadingState, NumberedBurst,
    PIECE_LENGTH, StatePiece, TEXT_CAPACITY, Text, TimedHeading, decode, encode,
};
pub use sender::{Sender, put_attitude, put_text};
