//! The true state of the body at one instant, and the error of an estimate.

use super::geometry::{Quaternion, Vector, angle_between};

/// Standard gravity in m/s² (CGPM 1901), the g of every datasheet.
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

/// Room temperature, in °C, for motions without a thermometer.
pub const ROOM_TEMPERATURE_C: f64 = 25.0;

/// The state of the body at one instant. Body axes are forward-right-down, earth axes
/// north-east-down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Specific force (acceleration minus gravity) in body axes, m/s². Level and at rest it is (0,
    /// 0, −g).
    pub specific_force_m_s2: Vector,
    /// Angular rate of the body relative to the earth, in body axes, rad/s.
    pub body_rates_rad_s: Vector,
    /// Body → earth, where it is known.
    pub attitude: Option<Quaternion>,
    /// Temperature of the air around the sensor, °C.
    pub temperature_c: f64,
    /// Thrust of the rotors, in the body's weight: 1 in a hover, 0 without rotors. Their currents
    /// have a magnetic field.
    pub thrust_g: f64,
    /// True if this instant counts for accuracy scores.
    pub scored: bool,
}

impl Truth {
    /// A body that does not move, in the given attitude; it does not count for scores.
    #[must_use]
    pub fn at_rest(attitude: Quaternion) -> Self {
        Self {
            specific_force_m_s2: attitude
                .conjugate()
                .rotate([0.0, 0.0, -STANDARD_GRAVITY_M_S2]),
            body_rates_rad_s: [0.0; 3],
            attitude: Some(attitude),
            temperature_c: ROOM_TEMPERATURE_C,
            thrust_g: 0.0,
            scored: false,
        }
    }

    /// A body that turns in place at these rates, in body axes, rad/s; it counts for scores.
    #[must_use]
    pub fn turning(attitude: Quaternion, body_rates_rad_s: Vector) -> Self {
        Self {
            body_rates_rad_s,
            scored: true,
            ..Self::at_rest(attitude)
        }
    }
}

/// The direction "up" in body axes, for a body → earth (north-east-down) attitude.
#[must_use]
pub fn up_in_body(body_to_earth: Quaternion) -> Vector {
    body_to_earth.conjugate().rotate([0.0, 0.0, -1.0])
}

/// The inclination error in radians, 0 to π: the angle between the estimated and the true "up" in
/// body axes.
///
/// Yaw plays no part in it. This is the measure of Laidig and others, *BROAD*, Data 6(7), 2021,
/// section 4.
#[must_use]
pub fn inclination_error_rad(estimated: Quaternion, truth: Quaternion) -> f64 {
    angle_between(up_in_body(estimated), up_in_body(truth))
}

/// The heading error in radians, from −π to π: the turn about down from the true to the
/// estimated attitude.
///
/// The tilt plays no part in it: the turn is the twist of their difference about down.
#[must_use]
pub fn heading_error_rad(estimated: Quaternion, truth: Quaternion) -> f64 {
    let error = estimated.multiply(truth.conjugate());
    // The sign of the quaternion has no meaning.
    let (z, w) = if error.w < 0.0 {
        (-error.z, -error.w)
    } else {
        (error.z, error.w)
    };
    2.0 * z.atan2(w)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_rest_feels_one_g_upwards() {
        assert_eq!(
            Truth::at_rest(Quaternion::IDENTITY).specific_force_m_s2,
            [0.0, 0.0, -STANDARD_GRAVITY_M_S2]
        );
    }

    #[test]
    fn inclination_error_sees_tilt_and_is_blind_to_yaw() {
        let truth = Quaternion::from_euler(0.4, -0.3, 1.0);
        let yawed = Quaternion::from_euler(0.4, -0.3, -2.0);
        assert!(inclination_error_rad(yawed, truth) < 1e-12);
        let tilted = Quaternion::from_euler(0.45, -0.3, -2.0);
        // A roll of δ at pitch θ tilts by δ·cos θ to first order; the exact spherical distance
        // is a little off.
        assert!((inclination_error_rad(tilted, truth) - 0.05 * libm::cos(0.3)).abs() < 1e-4);
        assert!((inclination_error_rad(truth.scaled(-1.0), truth)).abs() < 1e-12);
        let inverted = Quaternion::from_euler(0.4 + std::f64::consts::PI, 0.3, 0.0);
        assert!(inclination_error_rad(inverted, truth) > 2.5);
    }

    #[test]
    fn heading_error_sees_the_turn_about_down_with_its_sign() {
        let truth = Quaternion::from_euler(0.4, -0.3, 1.0);
        for turn_rad in [-3.0, -0.2, 0.0, 1.5, 3.0] {
            let about_down = Quaternion::from_rotation_vector([0.0, 0.0, turn_rad]);
            let turned = about_down.multiply(truth);
            assert!((heading_error_rad(turned, truth) - turn_rad).abs() < 1e-12);
            assert!((heading_error_rad(turned.scaled(-1.0), truth) - turn_rad).abs() < 1e-12);
        }
        let tilt = Quaternion::from_rotation_vector([0.3, 0.0, 0.0]);
        assert!(heading_error_rad(tilt.multiply(truth), truth).abs() < 1e-12);
    }
}
