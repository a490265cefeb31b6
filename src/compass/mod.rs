//! Drivers of compasses: AK8963 (inside an MPU-9250 or MPU-9255), HMC5883L, QMC5883L, QMC5883P.
//!
//! | module | job |
//! |---|---|
//! | `part` | trait of a part: registers, settings, identity, decoding |
//! | `ak8963`, `hmc5883l`, `qmc5883l`, `qmc5883p` | the parts |
//! | [`Session`] | finds, configures, reads and supervises a compass, without a bus of its own |
//! | `driver` | the same over any blocking `embedded-hal` bus, and the self-test |
//! | `fault` | reasons why there is no reading |
//!
//! A [`Session`] asks for one short transfer at a time, at most one per [`SLOT_MS`]. The firmware
//! performs it between two bursts of the IMU; [`Compass`] performs it on a blocking bus.
//!
//! Readings are in µT along the chip's printed axes. Those of an AK8963 are along the axes of the
//! accelerometer beside it.
//!
//! ```
//! use aplomb::compass::{Choice, Outcome, Session, Transfer};
//!
//! let mut session = Session::new(Choice::Auto);
//! // The first transfer asks an AK8963 for its identity. None answers.
//! let transfer = session.next_transfer();
//! assert_eq!(transfer, Some(Transfer::Read { address: 0x0C, register: 0x00, length: 2 }));
//! assert_eq!(session.finish(&Outcome::NoAnswer), None);
//! ```

/// True if this build searches, reads and calibrates a compass. Firmware needs the feature
/// `compass` for it.
pub const IS_BUILT_IN: bool = cfg!(any(feature = "compass", not(feature = "firmware")));

mod ak8963;
mod choice;
pub(crate) mod driver;
mod fault;
mod hmc5883l;
mod part;
mod part_id;
mod qmc5883l;
mod qmc5883p;
mod self_test;
mod session;
mod status;
#[cfg(test)]
mod tests;

pub use choice::{Choice, ParseChoiceError};
pub use driver::Compass;
pub use fault::Fault;
pub use part::{Bytes, LONGEST_READ};
pub use part_id::PartId;
pub use self_test::SelfTest;
pub use session::{Outcome, READING_PERIOD_US, SLOT_MS, Session, Transfer};
pub use status::CompassStatus;
