//! Console: commands over the UART. Bytes come in, one line of answer goes out for each command.
//!
//! | module | job |
//! |---|---|
//! | [`mod@line`] | assembles bytes to lines, and drops damaged ones |
//! | [`command`] | parses a line, and suggests the nearest right form |
//! | [`answer`] | writes the lines that go back |
//! | `dispatch` | runs each command |
//! | `baud` | changes the baud rate, and reverts a change that fails |
//! | `procedure_runner`, `procedure` | run the calibrations, from one stationary mean to the next |
//! | `compass_procedure` | runs the calibration of the compass |
//! | `preferences` | checks that the UART can carry a format at a rate |
//! | `status` | prints the module's state and the working record |
//! | `measure` | prints the figures of the module's own work |
//! | `line_errors` | limits the answers to wrong input |
//! | `nearest`, `numbers` | find the most similar word, and parse numbers |
//! | `module` | port through which the console reaches the rest of the module |
//! | `ground_station` | turns MAVLink requests into commands |
//!
//! [`Console`] holds the *working record*, which is in use, and the *stored record*, which is in
//! flash. Commands change the working record only. `save` makes it the stored one, and only if they
//! differ or the start found a problem in flash. The console reaches the rest of the module through
//! [`Module`], so that tests need no hardware.
//!
//! # Noise
//!
//! Noise on the line never changes the stored record. The console drops a line with a byte that is
//! not printable ASCII, and everything that the receiver flagged. In random bytes, the line `save`
//! has a probability of 2⁻⁴⁶ per byte: four letters between two line ends, with two kinds of
//! line end. The line stores nothing unless a setting was changed before, by a person or by noise.
//! Noise matches a command such as `rate 9` with 2⁻⁵⁹ per byte. A day of nothing but noise at
//! 921,600 baud is 2³³ bytes: both happen in that order with a probability of 10⁻¹².
//! After a start with a problem in flash, a `save` by noise stores the record in use, unchanged.
//!
//! Nor does the console answer noise line by line. It counts unreadable lines and reports them once
//! a second. Answers to wrong commands have a budget of [`MAX_ERROR_ANSWERS`], which refills by two
//! a second.
//!
//! ```
//! use aplomb::console::command::Command;
//!
//! let error = "stauts".parse::<Command>().unwrap_err();
//! assert_eq!(error.to_string(), "there is no command \"stauts\", did you mean \"status\"?");
//! ```

pub mod answer;
mod baud;
pub mod command;
mod compass_procedure;
mod dispatch;
#[cfg(feature = "mavlink")]
pub mod ground_station;
pub mod line;
mod line_errors;
mod measure;
mod module;
mod nearest;
mod numbers;
mod preferences;
mod procedure;
mod procedure_runner;
mod status;

pub use command::Command;
pub use dispatch::Console;
pub use line_errors::MAX_ERROR_ANSWERS;
pub use module::{Job, Module, Outcome, State};
pub use preferences::usable_preferences;
