//! Telemetry: the formats that leave the module. Each file holds encoder and decoder of one format.
//!
//! | module | format |
//! |---|---|
//! | [`text`] | labelled text, one line per attitude |
//! | [`classic`] | the classic tutorial's line |
//! | [`teleplot`] | lines for Teleplot |
//! | [`heading`] | the heading's lines in `text` and `teleplot` |
//! | [`teapot`] | the packet of the teapot demo |
//! | `mavlink` | MAVLink 2, with feature `mavlink` |
//! | [`log`] | the flight log, which replays to the bit |
//! | [`bursts`] | recorded bursts as CSV |
//! | [`message`] | messages for people, in any format |
//!
//! ```
//! use aplomb::pipeline::Snapshot;
//! use aplomb::settings::OutputFormat;
//! use aplomb::telemetry::{self, FRAME_CAPACITY};
//!
//! let mut frame = [0; FRAME_CAPACITY];
//! let line = telemetry::encode(OutputFormat::Text, &Snapshot::default(), 0, &mut frame);
//! assert!(line.starts_with(b"roll:0.00\tpitch:0.00\tyaw:0.00\t"));
//! // The default UART carries 101 such lines a second.
//! assert_eq!(telemetry::largest_rate_hz(OutputFormat::Text, 115_200), 101);
//! ```

pub mod bursts;
pub mod classic;
mod decimal;
mod frame;
pub mod heading;
pub mod log;
mod mailbox;
#[cfg(feature = "mavlink")]
pub mod mavlink;
pub mod message;
mod output;
mod pace;
pub mod teapot;
pub mod teleplot;
pub mod text;

pub use frame::{
    FRAME_CAPACITY, encode, encode_heading, frame_length, has_room_for_heading, largest_rate_hz,
};
pub use mailbox::Mailbox;
pub use output::Output;
pub use pace::Pace;

/// Characters in one STATUSTEXT of MAVLink.
pub(crate) const TEXT_LENGTH: usize = 50;
/// Length of a frame of STATUSTEXT, in bytes: header and checksum, severity, characters, and the
/// text's number with that of the piece.
pub(crate) const TEXT_FRAME_LENGTH: usize = 12 + 1 + TEXT_LENGTH + 3;

/// Returns the room in bytes for a text of this many characters in any format. The longest format
/// is MAVLink: one frame for each 50 characters, and a last one that ends with a zero.
///
/// ```
/// assert_eq!(aplomb::telemetry::text_room(120), 3 * 66);
/// ```
pub const fn text_room(characters: usize) -> usize {
    (characters / TEXT_LENGTH + 1) * TEXT_FRAME_LENGTH
}
