//! Published words in the firmware's memory.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::heading::HeadingEstimate;
use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use rigless::emulator::{Host, Memory};
use rigless::soc::Width;

/// Reads a snapshot from the firmware's memory.
pub(super) fn read_snapshot(memory: &mut dyn Host, address: u64) -> Option<Snapshot> {
    let mut word = |offset: u64| {
        let value = Memory::read(memory, address + offset, Width::W32).ok()?;
        u32::try_from(value).ok()
    };
    let t_us = u64::from(word(0)?) | u64::from(word(4)?) << 32;
    let mut float = |offset: u64| word(offset).map(f32::from_bits);
    let attitude = Quaternion {
        w: float(8)?,
        x: float(12)?,
        y: float(16)?,
        z: float(20)?,
    };
    let body_rates_rad_s = Vector3::new(float(24)?, float(28)?, float(32)?);
    let tilt_variance_rad2 = float(40)?;
    Some(Snapshot {
        t_us,
        attitude,
        body_rates_rad_s,
        flags: Flags::from_bits_truncate(word(36)?),
        tilt_variance_rad2,
    })
}

/// Reads the published heading from the firmware's memory; `None` while it is unknown.
pub(super) fn read_heading(memory: &mut dyn Host, address: u64) -> Option<HeadingEstimate> {
    let mut word = |offset: u64| {
        let value = Memory::read(memory, address + offset, Width::W32).ok()?;
        u32::try_from(value).ok()
    };
    let state = word(16)?;
    Some(HeadingEstimate {
        yaw_offset_rad: word(8).map(f32::from_bits)?,
        sigma_rad: word(12).map(f32::from_bits)?,
        is_valid: state & 2 != 0,
    })
    .filter(|_| state & 1 != 0)
}

/// Returns whether the module is armed. A command changes the word between two samples only.
pub(super) fn is_armed(memory: &mut dyn Host, address: u64) -> bool {
    Memory::read(memory, address, Width::W32).is_ok_and(|word| word != 0)
}
