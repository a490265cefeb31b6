//! Limits of the specific force of a stationary sensor.

use crate::attitude::Vector3;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Smallest specific force that an uncorrected, stationary sensor reads, g. An offset of 80 mg on
/// each axis and 3 % of sensitivity (product specification §6.2) make an error of 0.17 g.
pub(super) const MIN_GRAVITY_G: f32 = 0.8;
/// Largest specific force that an uncorrected, stationary sensor reads, g.
pub(super) const MAX_GRAVITY_G: f32 = 1.2;

/// Returns the unit vector along a specific force in m/s²; `None` if the force cannot be gravity.
pub(super) fn direction(force_m_s2: Vector3) -> Option<Vector3> {
    const MIN: f32 = MIN_GRAVITY_G * STANDARD_GRAVITY_M_S2;
    const MAX: f32 = MAX_GRAVITY_G * STANDARD_GRAVITY_M_S2;
    let norm = force_m_s2.norm();
    (MIN..=MAX)
        .contains(&norm)
        .then(|| force_m_s2.scale(1.0 / norm))
}

/// Rounds degrees to a whole number, for messages.
pub(super) fn whole_degrees(degrees: f32) -> i32 {
    (degrees + 0.5) as i32
}

/// Returns the specific force of a body at rest, in body axes, m/s².
#[cfg(test)]
pub(super) fn gravity_in(roll_degrees: f32, pitch_degrees: f32) -> Vector3 {
    use crate::attitude::{EulerAngles, Quaternion};
    use crate::units::radians;

    let attitude = Quaternion::from_euler(EulerAngles {
        roll_rad: radians(roll_degrees),
        pitch_rad: radians(pitch_degrees),
        yaw_rad: 0.0,
    });
    -attitude.down_in_body().scale(STANDARD_GRAVITY_M_S2)
}
