//! MAVLink 2: as much as a ground station needs to connect quietly, show the horizon, and configure
//! the module.
//!
//! | sent | how often |
//! |---|---|
//! | HEARTBEAT, SYS_STATUS | 1 Hz |
//! | ATTITUDE, ATTITUDE_QUATERNION, HIGHRES_IMU | at the telemetry rate |
//! | VFR_HUD | 2 Hz, while the heading is valid |
//! | STATUSTEXT | the module's messages, in pieces of 50 letters |
//! | PARAM_VALUE, COMMAND_ACK, MISSION_COUNT (0), AUTOPILOT_VERSION | on request |
//!
//! | received | effect |
//! |---|---|
//! | PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET | see [`parameter`] |
//! | COMMAND_LONG, COMMAND_INT | [`Action`]s; each command gets an answer, known or not |
//! | MISSION_REQUEST_LIST | answers that there is none |
//!
//! [`Session`] has no clock and no port. It turns requests that it cannot answer itself into
//! [`Action`]s; the owner runs them and reports the result with [`Session::answer`]. Nothing waits:
//! a message without room is dropped and counted, answers go before attitudes. Only a message that
//! is sent takes a sequence number, so that a gap in the numbers is a loss on the line.
//!
//! # Heading
//!
//! Yaw in ATTITUDE and ATTITUDE_QUATERNION is the heading while that is valid, and relative
//! otherwise. It jumps where the heading becomes valid or is no longer valid. SYS_STATUS has a
//! magnetometer if there is a compass, and HIGHRES_IMU its calibrated field in body axes.
//!
//! # Text commands meanwhile
//!
//! The console stays within reach. The `receiver` passes on every byte outside MAVLink frames as
//! text, so that `format text`, on a line of its own, returns to text. Noise may cost the line that
//! follows within a second, so a program repeats it. The console's answers come as STATUSTEXT.
//!
//! # The `mavlink` crate
//!
//! Sent types, field order, checksums and enumerations are those of the `mavlink` crate, dialect
//! `common`. It costs 4 KiB of flash more than code by hand, and up to 240 instructions a message
//! (Cortex-M4F, ten messages out and six in): a load of 0.05 % at 150 messages a second. That does
//! not outweigh a definition that others maintain and test. `wire` adds what the crate's types
//! cannot hold: a command that its dialect lacks, and the fields that version 2 appended. Requests
//! are decoded by hand, so that a value which the crate does not know costs no answer.
//!
//! ```
//! use aplomb::estimator::Sample;
//! use aplomb::settings::Record;
//! use aplomb::telemetry::Output;
//! use aplomb::telemetry::mavlink::{Session, Vehicle};
//!
//! let mut session = Session::new();
//! let mut buffer = [0; 256];
//! let mut output = Output::new(&mut buffer);
//! let vehicle = Vehicle {
//!     snapshot: None,
//!     is_due: true,
//!     sample: &Sample::default(),
//!     temperature_celsius: 25.0,
//!     heading: None,
//!     compass: Default::default(),
//!     record: &Record::default(),
//!     baud: 115_200,
//!     is_armed: false,
//!     bursts_failed: 0,
//! };
//! session.fill(0, &vehicle, &mut output);
//! let length = output.length();
//! // Before the first attitude HEARTBEAT comes alone: 0xFD, 9 bytes of payload, 21 in all.
//! assert_eq!(buffer[..2], [0xFD, 9]);
//! assert_eq!(length, 21);
//! ```

// The firmware's panic check (`xtask/src/panics.rs`) cannot distinguish the crate's panics from our
// own, so this module has none.
#![cfg_attr(
    not(test),
    deny(
        clippy::expect_used,
        clippy::indexing_slicing,
        clippy::panic,
        clippy::todo,
        clippy::unimplemented,
        clippy::unreachable,
        clippy::unwrap_used
    )
)]

mod action;
mod inbox;
mod messages;
pub mod parameter;
mod receiver;
mod session;
mod wire;

pub use super::message::Severity;
pub use action::{Action, Calibrate, Outcome, Ticket};
pub use messages::Vehicle;
pub use session::Session;
pub use wire::{COMPONENT, SYSTEM};
