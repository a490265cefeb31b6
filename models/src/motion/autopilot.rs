//! The simulated vehicle's own control: position → velocity → attitude → rates → rotors,
//! each inside the next.
//!
//! It steers by the true state. Its business is to fly credibly, not to be examined.

use super::airframe::{Airframe, ROTOR_LAYOUT, ROTORS, State};
use super::geometry::{Quaternion, Vector, add, angle_between, cross, dot, norm, scale, subtract};
use super::route::Leg;
use super::truth::STANDARD_GRAVITY_M_S2;

const POSITION_GAIN_PER_S: f64 = 1.2;
const VELOCITY_GAIN_PER_S: f64 = 2.5;
const VELOCITY_INTEGRAL_GAIN_PER_S2: f64 = 0.8;
const ATTITUDE_GAIN_PER_S: f64 = 7.0;
const YAW_GAIN_PER_S: f64 = 2.5;
const RATE_GAIN_PER_S: f64 = 20.0;
const RATE_INTEGRAL_GAIN_PER_S2: f64 = 20.0;

const CLIMB_LIMIT_M_S: f64 = 2.5;
const SINK_LIMIT_M_S: f64 = 1.5;
const VERTICAL_ACCELERATION_LIMIT_M_S2: f64 = 0.4 * STANDARD_GRAVITY_M_S2;
/// Tangent of the steepest tilt asked for: 45°, one g to the side while the height is kept.
const TILT_LIMIT_TANGENT: f64 = 1.0;
const TILT_RATE_LIMIT_RAD_S: f64 = 4.0;
const YAW_RATE_LIMIT_RAD_S: f64 = 1.5;
/// The share of the weight that the rotors always carry, so that the attitude stays under control.
const LEAST_THRUST_SHARE: f64 = 0.2;
/// Time constant with which the wanted acceleration builds up.
const ACCELERATION_TIME_S: f64 = 0.15;

/// The memory of the control loops.
#[derive(Clone, Debug, Default)]
pub struct Autopilot {
    velocity_set_point_m_s: Vector,
    feed_forward_m_s2: Vector,
    velocity_integral_m_s2: Vector,
    rate_integral_rad_s2: Vector,
}

impl Autopilot {
    /// The rotor speeds to command (rad/s) for the next `step_s` seconds. On the ground the
    /// integrals rest.
    pub fn rotor_speeds(
        &mut self,
        airframe: &Airframe,
        state: &State,
        leg: &Leg,
        airborne: bool,
        step_s: f64,
    ) -> [f64; ROTORS] {
        let acceleration = self.wanted_acceleration(state, leg, airborne, step_s);
        let wanted_force = subtract(acceleration, [0.0, 0.0, STANDARD_GRAVITY_M_S2]);
        let down = state.attitude.rotate([0.0, 0.0, 1.0]);
        let weight = airframe.mass_kg * STANDARD_GRAVITY_M_S2;
        let thrust = (-airframe.mass_kg * dot(wanted_force, down)).max(LEAST_THRUST_SHARE * weight);
        let torque =
            self.wanted_torque(airframe, state, wanted_force, leg.yaw_rad, airborne, step_s);
        mix(airframe, thrust, torque)
    }

    /// Earth axes, m/s².
    fn wanted_acceleration(
        &mut self,
        state: &State,
        leg: &Leg,
        airborne: bool,
        step_s: f64,
    ) -> Vector {
        let away = subtract(leg.position_m, state.position_m);
        let distance = libm::hypot(away[0], away[1]);
        // No faster than can be braked at 70 % of the permitted deceleration.
        let braking = (1.4 * leg.acceleration_limit_m_s2 * distance).sqrt();
        let speed = leg
            .speed_limit_m_s
            .min(braking)
            .min(POSITION_GAIN_PER_S * distance);
        let direction = if distance > 0.0 {
            [away[0] / distance, away[1] / distance]
        } else {
            [0.0; 2]
        };
        let climb = (POSITION_GAIN_PER_S * away[2]).clamp(-CLIMB_LIMIT_M_S, SINK_LIMIT_M_S);
        let wanted = [speed * direction[0], speed * direction[1], climb];

        let change = limited(
            subtract(wanted, self.velocity_set_point_m_s),
            leg.acceleration_limit_m_s2 * step_s,
            VERTICAL_ACCELERATION_LIMIT_M_S2 * step_s,
        );
        self.velocity_set_point_m_s = add(self.velocity_set_point_m_s, change);
        let build_up = step_s / ACCELERATION_TIME_S;
        let towards = subtract(scale(change, 1.0 / step_s), self.feed_forward_m_s2);
        self.feed_forward_m_s2 = add(self.feed_forward_m_s2, scale(towards, build_up));

        let error = subtract(self.velocity_set_point_m_s, state.velocity_m_s);
        if airborne {
            let grown = add(
                self.velocity_integral_m_s2,
                scale(error, VELOCITY_INTEGRAL_GAIN_PER_S2 * step_s),
            );
            self.velocity_integral_m_s2 = limited(grown, 4.0, 4.0);
        }
        let acceleration = add(
            add(self.feed_forward_m_s2, scale(error, VELOCITY_GAIN_PER_S)),
            self.velocity_integral_m_s2,
        );
        let vertical = acceleration[2].clamp(
            -VERTICAL_ACCELERATION_LIMIT_M_S2,
            VERTICAL_ACCELERATION_LIMIT_M_S2,
        );
        let horizontal = TILT_LIMIT_TANGENT * (STANDARD_GRAVITY_M_S2 - vertical);
        limited(acceleration, horizontal, VERTICAL_ACCELERATION_LIMIT_M_S2)
    }

    /// Body axes, N·m.
    fn wanted_torque(
        &mut self,
        airframe: &Airframe,
        state: &State,
        wanted_force: Vector,
        yaw_rad: f64,
        airborne: bool,
        step_s: f64,
    ) -> Vector {
        let (tilt_error, yaw_error) =
            attitude_error(state.attitude, attitude_for(wanted_force, yaw_rad));
        let tilt_rates = limited(
            scale(tilt_error, ATTITUDE_GAIN_PER_S),
            TILT_RATE_LIMIT_RAD_S,
            0.0,
        );
        let yaw_rate =
            (YAW_GAIN_PER_S * yaw_error).clamp(-YAW_RATE_LIMIT_RAD_S, YAW_RATE_LIMIT_RAD_S);
        let rate_error = subtract(
            [tilt_rates[0], tilt_rates[1], yaw_rate],
            state.body_rates_rad_s,
        );
        if airborne {
            let grown = add(
                self.rate_integral_rad_s2,
                scale(rate_error, RATE_INTEGRAL_GAIN_PER_S2 * step_s),
            );
            self.rate_integral_rad_s2 = limited(grown, 5.0, 5.0);
        }
        let angular_acceleration = add(
            scale(rate_error, RATE_GAIN_PER_S),
            self.rate_integral_rad_s2,
        );
        let inertia = airframe.inertia_kg_m2;
        let momentum = [0, 1, 2].map(|axis| inertia[axis] * state.body_rates_rad_s[axis]);
        add(
            [0, 1, 2].map(|axis| inertia[axis] * angular_acceleration[axis]),
            cross(state.body_rates_rad_s, momentum),
        )
    }
}

/// The vector with its horizontal part no longer than `horizontal` and its vertical part no larger
/// than `vertical`.
fn limited(vector: Vector, horizontal: f64, vertical: f64) -> Vector {
    let length = libm::hypot(vector[0], vector[1]);
    let factor = if length > horizontal {
        horizontal / length
    } else {
        1.0
    };
    [
        vector[0] * factor,
        vector[1] * factor,
        vector[2].clamp(-vertical, vertical),
    ]
}

/// The attitude (body → earth) whose thrust axis points along `force` and whose nose points along
/// `yaw_rad`.
fn attitude_for(force: Vector, yaw_rad: f64) -> Quaternion {
    let down = scale(force, -1.0 / norm(force));
    let heading = [libm::cos(yaw_rad), libm::sin(yaw_rad), 0.0];
    let right = cross(down, heading);
    let right = scale(right, 1.0 / norm(right));
    let forward = cross(right, down);
    Quaternion::from_matrix([0, 1, 2].map(|row| [forward[row], right[row], down[row]]))
}

/// Returns the rotation from `current` to `wanted`, in body axes: first the shortest tilt, then the
/// rest about the thrust axis.
///
/// Keeping the two apart lets the tilt, which flies the vehicle, go ahead of the heading, which
/// does not matter (Brescianini, Hehn, D'Andrea, ETH Zürich, 2013).
fn attitude_error(current: Quaternion, wanted: Quaternion) -> (Vector, f64) {
    let down = [0.0, 0.0, 1.0];
    let wanted_down = current.conjugate().rotate(wanted.rotate(down));
    let axis = cross(down, wanted_down);
    let sine = norm(axis);
    let tilt = if sine > 0.0 {
        scale(axis, angle_between(down, wanted_down) / sine)
    } else {
        [0.0; 3]
    };
    let tilted = current.multiply(Quaternion::from_rotation_vector(tilt));
    (
        tilt,
        tilted.conjugate().multiply(wanted).to_rotation_vector()[2],
    )
}

/// The rotor speeds that give this thrust and torque, as far as the rotors can.
fn mix(airframe: &Airframe, thrust_n: f64, torque_n_m: Vector) -> [f64; ROTORS] {
    let strongest = airframe.thrust_coefficient
        * airframe.rotor_speed_limit_rad_s
        * airframe.rotor_speed_limit_rad_s;
    ROTOR_LAYOUT.map(|(forward, right, turn)| {
        let share = thrust_n - right * torque_n_m[0] / airframe.arm_m
            + forward * torque_n_m[1] / airframe.arm_m
            - turn * torque_n_m[2] / airframe.torque_per_thrust_m;
        let thrust = (share / ROTORS as f64).clamp(0.01 * strongest, strongest);
        (thrust / airframe.thrust_coefficient).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mixer_is_the_inverse_of_the_rotors() {
        let airframe = Airframe::balanced();
        let wanted = [0.1, -0.2, 0.03];
        let state = State {
            rotor_speeds_rad_s: mix(&airframe, 12.0, wanted),
            ..State::at_rest(Quaternion::IDENTITY)
        };
        let wrench = airframe.wrench(&state, &[0.0; ROTORS], [0.0; 3]);
        assert!((wrench.force_n[2] + 12.0).abs() < 1e-9);
        assert!(norm(subtract(wrench.torque_n_m, wanted)) < 1e-9);
    }

    #[test]
    fn the_wanted_attitude_thrusts_along_the_force_and_keeps_the_heading() {
        let force = [2.0, -3.0, -9.0];
        let attitude = attitude_for(force, 0.7);
        assert!(norm(cross(attitude.rotate([0.0, 0.0, -1.0]), force)) < 1e-12);
        // The right wing never leaves the vertical plane across the heading, and the nose is on the
        // heading's side.
        let heading = [libm::cos(0.7), libm::sin(0.7), 0.0];
        assert!(dot(attitude.rotate([0.0, 1.0, 0.0]), heading).abs() < 1e-12);
        assert!(dot(attitude.rotate([1.0, 0.0, 0.0]), heading) > 0.9);
    }

    #[test]
    fn the_error_is_the_tilt_and_then_the_turn_about_the_thrust_axis() {
        let current = Quaternion::from_euler(0.2, -0.4, 1.0);
        let wanted = Quaternion::from_euler(-0.5, 0.3, -1.2);
        let (tilt, yaw) = attitude_error(current, wanted);
        assert_eq!(tilt[2], 0.0);
        let reached = current
            .multiply(Quaternion::from_rotation_vector(tilt))
            .multiply(Quaternion::from_rotation_vector([0.0, 0.0, yaw]));
        assert!(norm(reached.conjugate().multiply(wanted).to_rotation_vector()) < 1e-12);
    }
}
