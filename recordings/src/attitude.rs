//! Attitudes as recordings are judged by: "up" in the body's axes, and extrapolation over a delay.

use aplomb::attitude::{Quaternion, Vector3};

/// Returns the attitude `delay_s` later, if the body keeps these rates.
#[must_use]
pub fn extrapolate(attitude: Quaternion, body_rates_rad_s: Vector3, delay_s: f32) -> Quaternion {
    let turn = body_rates_rad_s.scale(delay_s);
    attitude
        .multiply(Quaternion::from_rotation_vector(turn))
        .normalize()
}

/// Returns the direction opposite to gravity, in body axes.
#[must_use]
pub fn up_in_body(attitude: Quaternion) -> Vector3 {
    -attitude.down_in_body()
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb::attitude::EulerAngles;
    use aplomb::units::radians;

    #[test]
    fn attitudes_are_extrapolated_about_the_bodys_own_axes() {
        let attitude = Quaternion::from_euler(EulerAngles {
            yaw_rad: radians(90.0),
            ..EulerAngles::default()
        });
        let rates = Vector3::new(radians(100.0), 0.0, 0.0);
        let angles = extrapolate(attitude, rates, 0.1).to_euler();
        assert!((angles.roll_rad - radians(10.0)).abs() < 1e-5);
        assert!((angles.yaw_rad - radians(90.0)).abs() < 1e-5);
    }
}
