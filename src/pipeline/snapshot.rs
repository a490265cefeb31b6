//! The result for one sample.

use crate::attitude::{EulerAngles, Quaternion, Vector3};
use crate::health::Flags;

/// An attitude at one moment, with its σ and flags.
///
/// The attitude is that of `t_us`: it is extrapolated by the sensor's delay. The body rates are
/// those of the sample, older by the delay: 1.9 ms by default, 4.8 ms in a filter of 42 Hz.
///
/// The layout is part of the interface: debuggers and emulators read it from memory.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Snapshot {
    /// Time of the sample, in µs since start.
    pub t_us: u64,
    /// Body (forward-right-down) to earth (north-east-down). Its sign is continuous.
    pub attitude: Quaternion,
    /// Body rates p, q, r about forward, right and down in rad/s, without bias.
    pub body_rates_rad_s: Vector3,
    /// State of the attitude.
    pub flags: Flags,
    /// Variance of the direction of down, both axes together, in rad². Infinite if unknown.
    pub tilt_variance_rad2: f32,
}

const _: () = assert!(core::mem::offset_of!(Snapshot, attitude) == 8);
const _: () = assert!(core::mem::offset_of!(Snapshot, body_rates_rad_s) == 24);
const _: () = assert!(core::mem::offset_of!(Snapshot, flags) == 36);
const _: () = assert!(core::mem::offset_of!(Snapshot, tilt_variance_rad2) == 40);

impl Snapshot {
    /// Returns roll, pitch and yaw in rad. Yaw is relative to the heading at start.
    pub fn euler(&self) -> EulerAngles {
        self.attitude.to_euler()
    }

    /// Returns σ of the direction of down, both axes together, in rad.
    pub fn tilt_sigma_rad(&self) -> f32 {
        libm::sqrtf(self.tilt_variance_rad2)
    }
}
