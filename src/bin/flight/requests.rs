//! Requests between the tasks: under a lock, or as bits that a task polls.

use core::sync::atomic::{AtomicU8, Ordering};

use aplomb::console::{Job, Outcome};
use aplomb::mpu6050::Part;

/// Requests of the console to the supervisor, and the supervisor's results.
pub struct Requests {
    /// The sensor and its address, once it is configured.
    pub sensor: Option<(&'static Part, u8)>,
    /// Job that needs a pause of the sensor.
    pub job: Option<Job>,
    /// Outcome of the last job.
    pub outcome: Option<Outcome>,
}

impl Requests {
    /// Creates requests without a job.
    pub const fn new() -> Self {
        Self {
            sensor: None,
            job: None,
            outcome: None,
        }
    }
}

/// Requests to the supervisor, which polls them without a lock.
pub static TO_SUPERVISOR: RequestBits = RequestBits::new();
/// [`Requests::job`] is set.
pub const JOB: u8 = 1;
/// A measurement is wanted.
#[cfg(feature = "full")]
pub const MEASUREMENT: u8 = 2;
/// The measurement starts again without figures.
#[cfg(feature = "full")]
pub const NEW_MEASUREMENT: u8 = 4;

/// Work of the attitude task after each publication, besides counting it.
pub static AFTER_PUBLICATION: RequestBits = RequestBits::new();
/// The flight log needs bursts.
pub const LOG: u8 = 1;
/// A calibration procedure measures at rest.
pub const STATIONARY: u8 = 2;
/// A measurement runs.
#[cfg(feature = "full")]
pub const FIGURES: u8 = 4;

/// Bits that one task sets and another polls.
pub struct RequestBits(AtomicU8);

impl RequestBits {
    const fn new() -> Self {
        Self(AtomicU8::new(0))
    }

    /// Returns all bits.
    #[inline(always)]
    pub fn bits(&self) -> u8 {
        self.0.load(Ordering::Acquire)
    }

    /// Returns whether this bit is set.
    pub fn contains(&self, bit: u8) -> bool {
        self.bits() & bit != 0
    }

    /// Sets or clears these bits. Returns whether one of them was set before.
    pub fn set(&self, bits: u8, is_set: bool) -> bool {
        let before = if is_set {
            self.0.fetch_or(bits, Ordering::AcqRel)
        } else {
            self.0.fetch_and(!bits, Ordering::AcqRel)
        };
        before & bits != 0
    }
}
