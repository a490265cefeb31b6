//! A quadrotor as a rigid body with four rotors: its state, the forces on it, and the equations of
//! motion.
//!
//! Body axes forward-right-down, earth axes north-east-down, SI units. In body axes:
//!
//! - thrust `k_T Ω²` of each rotor along −z, with the rolling and pitching moments of its arm;
//! - torque of each rotor on the body: aerodynamic `−s k_Q Ω²`, spin-up `−s J Ω'` and
//!   gyroscopic, s = +1 clockwise from above;
//! - rotor drag, linear in the air speed across the rotor (Faessler, Franchi, Scaramuzza, IEEE RA-L
//!   3(2), 2018);
//! - drag of the body, quadratic in the air speed;
//! - vibration. The unbalanced mass of each rotor turns with it: once per turn, across the axis.
//!   The two blades pass the arm: twice per turn, along the axis. Both act at the rotor, so they
//!   shake the body in rotation too.

use super::geometry::{Quaternion, Vector, add, cross, norm, scale, subtract};
use super::truth::STANDARD_GRAVITY_M_S2;

/// Air density at sea level, 15 °C, kg/m³ (ISO 2533).
const AIR_DENSITY_KG_M3: f64 = 1.225;

/// Number of rotors.
pub const ROTORS: usize = 4;

/// Masses, sizes and coefficients.
#[derive(Clone, Debug)]
pub struct Airframe {
    /// kg.
    pub mass_kg: f64,
    /// Moments of inertia about the body axes, kg·m²; the products of inertia are zero.
    pub inertia_kg_m2: Vector,
    /// Distance of every rotor from the centre of mass along x and along y, m.
    pub arm_m: f64,
    /// Thrust over squared rotor speed, N/(rad/s)².
    pub thrust_coefficient: f64,
    /// Torque over thrust, m.
    pub torque_per_thrust_m: f64,
    /// Fastest rotor speed, rad/s.
    pub rotor_speed_limit_rad_s: f64,
    /// Time constant of the rotor speed, s.
    pub motor_time_constant_s: f64,
    /// Moment of inertia of one rotor about its axis, kg·m².
    pub rotor_inertia_kg_m2: f64,
    /// Rotor drag over air speed and rotor speed, N/(m/s)/(rad/s).
    pub rotor_drag: f64,
    /// Drag coefficient times frontal area, m².
    pub drag_area_m2: f64,
    /// Unbalanced mass times radius of each rotor, kg·m.
    pub unbalance_kg_m: [f64; ROTORS],
    /// Thrust ripple at the blades' frequency over squared rotor speed, N/(rad/s)².
    pub ripple: [f64; ROTORS],
}

/// Position of each rotor in units of the arm (forward, right), and its sense of turning (+1
/// clockwise from above).
pub const ROTOR_LAYOUT: [(f64, f64, f64); ROTORS] = [
    (1.0, 1.0, -1.0),
    (-1.0, -1.0, -1.0),
    (1.0, -1.0, 1.0),
    (-1.0, 1.0, 1.0),
];

/// The state of the vehicle; a rate of change of the state has the same shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Earth axes, m.
    pub position_m: Vector,
    /// Earth axes, m/s.
    pub velocity_m_s: Vector,
    /// Body → earth.
    pub attitude: Quaternion,
    /// Body axes, rad/s.
    pub body_rates_rad_s: Vector,
    /// Rotor speeds, rad/s.
    pub rotor_speeds_rad_s: [f64; ROTORS],
    /// Angles that the rotors have turned since the start, rad.
    pub rotor_angles_rad: [f64; ROTORS],
}

impl State {
    /// At rest at the origin with still rotors.
    #[must_use]
    pub fn at_rest(attitude: Quaternion) -> Self {
        Self {
            position_m: [0.0; 3],
            velocity_m_s: [0.0; 3],
            attitude,
            body_rates_rad_s: [0.0; 3],
            rotor_speeds_rad_s: [0.0; ROTORS],
            rotor_angles_rad: [0.0; ROTORS],
        }
    }

    /// Returns the state without the rotors' whole turns, once there are many: the sine of an angle
    /// above 1.6 million takes ten times as long. A rotor turns so far within an hour.
    #[must_use]
    pub fn with_small_rotor_angles(mut self) -> Self {
        const LARGE_RAD: f64 = 1.0e6;
        for angle_rad in &mut self.rotor_angles_rad {
            if *angle_rad > LARGE_RAD {
                *angle_rad %= core::f64::consts::TAU;
            }
        }
        self
    }

    /// The state after going at `rate` for `duration`.
    #[must_use]
    #[inline]
    pub fn plus(&self, rate: &Self, duration: f64) -> Self {
        let rotors = |start: &[f64; ROTORS], rate: &[f64; ROTORS]| {
            let mut sum = *start;
            for (value, change) in sum.iter_mut().zip(rate) {
                *value += change * duration;
            }
            sum
        };
        let (q, r) = (self.attitude, rate.attitude);
        Self {
            position_m: add(self.position_m, scale(rate.position_m, duration)),
            velocity_m_s: add(self.velocity_m_s, scale(rate.velocity_m_s, duration)),
            attitude: Quaternion::new(
                q.w + r.w * duration,
                q.x + r.x * duration,
                q.y + r.y * duration,
                q.z + r.z * duration,
            ),
            body_rates_rad_s: add(
                self.body_rates_rad_s,
                scale(rate.body_rates_rad_s, duration),
            ),
            rotor_speeds_rad_s: rotors(&self.rotor_speeds_rad_s, &rate.rotor_speeds_rad_s),
            rotor_angles_rad: rotors(&self.rotor_angles_rad, &rate.rotor_angles_rad),
        }
    }
}

/// Everything that acts on the body but gravity, in body axes.
#[derive(Clone, Copy, Debug)]
pub struct Wrench {
    /// N.
    pub force_n: Vector,
    /// N·m about the centre of mass.
    pub torque_n_m: Vector,
}

impl Airframe {
    /// A 450 mm quadrotor of 1.2 kg on 10-inch rotors, well balanced and rigid as a drawing.
    #[must_use]
    pub fn balanced() -> Self {
        Self {
            mass_kg: 1.2,
            inertia_kg_m2: [0.012, 0.012, 0.022],
            arm_m: 0.159,
            thrust_coefficient: 1.2e-5,
            torque_per_thrust_m: 0.016,
            rotor_speed_limit_rad_s: 950.0,
            motor_time_constant_s: 0.03,
            rotor_inertia_kg_m2: 6e-5,
            rotor_drag: 1.8e-4,
            drag_area_m2: 0.02,
            unbalance_kg_m: [0.0; ROTORS],
            ripple: [0.0; ROTORS],
        }
    }

    /// The rotor speed at which the four thrusts carry the weight, rad/s.
    #[must_use]
    pub fn hover_speed_rad_s(&self) -> f64 {
        (self.mass_kg * STANDARD_GRAVITY_M_S2 / (ROTORS as f64 * self.thrust_coefficient)).sqrt()
    }

    /// Forces and torques in this state, in air that moves with `wind_m_s` over the earth.
    #[must_use]
    #[inline]
    pub fn wrench(
        &self,
        state: &State,
        rotor_acceleration: &[f64; ROTORS],
        wind_m_s: Vector,
    ) -> Wrench {
        let (mut force, at_rotors) = self.forces(state, wind_m_s);
        let mut torque = [0.0; 3];
        let [p, q, _] = state.body_rates_rad_s;
        for (rotor, &(forward, right, turn)) in ROTOR_LAYOUT.iter().enumerate() {
            let speed = state.rotor_speeds_rad_s[rotor];
            let thrust = self.thrust_coefficient * speed * speed;
            let at_rotor = at_rotors[rotor];
            force = add(force, at_rotor);
            let (x, y) = (self.arm_m * forward, self.arm_m * right);
            let momentum = turn * self.rotor_inertia_kg_m2 * speed;
            let spin = turn
                * (self.torque_per_thrust_m * thrust
                    + self.rotor_inertia_kg_m2 * rotor_acceleration[rotor]);
            // arm × force − rates × momentum; arm z, momentum x and momentum y are zero.
            torque = [
                torque[0] + y * at_rotor[2] - q * momentum,
                torque[1] - x * at_rotor[2] + p * momentum,
                torque[2] + (x * at_rotor[1] - y * at_rotor[0]) - spin,
            ];
        }
        Wrench {
            force_n: force,
            torque_n_m: torque,
        }
    }

    /// Returns the force of [`Self::wrench`], N.
    #[must_use]
    #[inline]
    pub fn force_n(&self, state: &State, wind_m_s: Vector) -> Vector {
        let (drag, at_rotors) = self.forces(state, wind_m_s);
        at_rotors.into_iter().fold(drag, add)
    }

    /// Returns the drag of the body and the force at each rotor, N.
    #[inline]
    fn forces(&self, state: &State, wind_m_s: Vector) -> (Vector, [Vector; ROTORS]) {
        let air_velocity = state
            .attitude
            .conjugate()
            .rotate(subtract(state.velocity_m_s, wind_m_s));
        let drag = -0.5 * AIR_DENSITY_KG_M3 * self.drag_area_m2 * norm(air_velocity);
        let mut at_rotors = [[0.0; 3]; ROTORS];
        for (rotor, &(_, _, turn)) in ROTOR_LAYOUT.iter().enumerate() {
            let speed = state.rotor_speeds_rad_s[rotor];
            let thrust = self.thrust_coefficient * speed * speed;
            let (sine, cosine) = libm::sincos(state.rotor_angles_rad[rotor]);
            let unbalanced = self.unbalance_kg_m[rotor] * speed * speed;
            // sin 2φ = 2 sin φ cos φ.
            let rippled = self.ripple[rotor] * speed * speed * 2.0 * sine * cosine;
            let across = -self.rotor_drag * speed;
            at_rotors[rotor] = [
                across * air_velocity[0] + unbalanced * cosine,
                across * air_velocity[1] + unbalanced * turn * sine,
                -thrust - rippled,
            ];
        }
        (scale(air_velocity, drag), at_rotors)
    }

    /// Rates at which the rotors change their speeds towards `commands`, rad/s².
    #[must_use]
    #[inline]
    pub fn rotor_acceleration(&self, state: &State, commands: &[f64; ROTORS]) -> [f64; ROTORS] {
        [0, 1, 2, 3].map(|rotor| {
            (commands[rotor] - state.rotor_speeds_rad_s[rotor]) / self.motor_time_constant_s
        })
    }

    /// The equations of motion in free flight: the rate of change of the state.
    #[must_use]
    #[inline]
    pub fn rate(&self, state: &State, commands: &[f64; ROTORS], wind_m_s: Vector) -> State {
        let rotor_acceleration = self.rotor_acceleration(state, commands);
        let wrench = self.wrench(state, &rotor_acceleration, wind_m_s);
        let specific_force = scale(wrench.force_n, 1.0 / self.mass_kg);
        let [p, q, r] = state.body_rates_rad_s;
        let [x, y, z] = self.inertia_kg_m2;
        let gyroscopic = cross(state.body_rates_rad_s, [x * p, y * q, z * r]);
        let net = subtract(wrench.torque_n_m, gyroscopic);
        State {
            position_m: state.velocity_m_s,
            velocity_m_s: add(
                state.attitude.rotate(specific_force),
                [0.0, 0.0, STANDARD_GRAVITY_M_S2],
            ),
            attitude: state
                .attitude
                .multiply(Quaternion::new(0.0, 0.5 * p, 0.5 * q, 0.5 * r)),
            body_rates_rad_s: [net[0] / x, net[1] / y, net[2] / z],
            rotor_speeds_rad_s: rotor_acceleration,
            rotor_angles_rad: state.rotor_speeds_rad_s,
        }
    }
}

/// One step of the classic fourth-order Runge–Kutta method; `rate(state, share)` with the share
/// of the step done. `k1` is the rate at the start.
#[must_use]
#[inline]
pub fn runge_kutta_step(
    start: &State,
    k1: State,
    step_s: f64,
    rate: impl Fn(&State, f64) -> State,
) -> State {
    let k2 = rate(&start.plus(&k1, 0.5 * step_s), 0.5);
    let k3 = rate(&start.plus(&k2, 0.5 * step_s), 0.5);
    let k4 = rate(&start.plus(&k3, step_s), 1.0);
    let mut end = start
        .plus(&k1, step_s / 6.0)
        .plus(&k2, step_s / 3.0)
        .plus(&k3, step_s / 3.0)
        .plus(&k4, step_s / 6.0);
    end.attitude = end.attitude.normalized();
    end
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::geometry::dot;

    const STILL_AIR: Vector = [0.0; 3];
    const OFF: [f64; ROTORS] = [0.0; ROTORS];

    fn run(
        airframe: &Airframe,
        start: State,
        commands: [f64; ROTORS],
        step_s: f64,
        steps: u32,
    ) -> State {
        let rate = |state: &State, _| airframe.rate(state, &commands, STILL_AIR);
        (0..steps).fold(start, |state, _| {
            runge_kutta_step(&state, rate(&state, 0.0), step_s, rate)
        })
    }

    fn turning(speed: f64) -> State {
        State {
            rotor_speeds_rad_s: [speed; ROTORS],
            ..State::at_rest(Quaternion::IDENTITY)
        }
    }

    #[test]
    fn a_rotor_loses_whole_turns_only() {
        let mut state = State::at_rest(Quaternion::IDENTITY);
        state.rotor_angles_rad = [1.0, 999_999.0, 1_000_001.0, 2.5e6];
        let small = state.with_small_rotor_angles().rotor_angles_rad;
        assert_eq!(small[..2], state.rotor_angles_rad[..2]);
        for (small, large) in small.into_iter().zip(state.rotor_angles_rad).skip(2) {
            assert!((0.0..7.0).contains(&small), "{small}");
            let turns = (large - small) / core::f64::consts::TAU;
            assert!((turns - turns.round()).abs() < 1.0e-6, "{turns}");
        }
    }

    #[test]
    fn without_air_and_rotors_it_falls_and_feels_nothing() {
        let airframe = Airframe {
            drag_area_m2: 0.0,
            ..Airframe::balanced()
        };
        let end = run(
            &airframe,
            State::at_rest(Quaternion::IDENTITY),
            OFF,
            1e-3,
            2000,
        );
        assert!((end.position_m[2] - 0.5 * STANDARD_GRAVITY_M_S2 * 4.0).abs() < 1e-9);
        assert_eq!(airframe.wrench(&end, &OFF, STILL_AIR).force_n, [0.0; 3]);
    }

    #[test]
    fn in_air_it_falls_at_terminal_velocity() {
        let airframe = Airframe::balanced();
        let end = run(
            &airframe,
            State::at_rest(Quaternion::IDENTITY),
            OFF,
            1e-2,
            10_000,
        );
        let weight = airframe.mass_kg * STANDARD_GRAVITY_M_S2;
        let terminal = (2.0 * weight / (AIR_DENSITY_KG_M3 * airframe.drag_area_m2)).sqrt();
        assert!((end.velocity_m_s[2] - terminal).abs() < 1e-6);
    }

    #[test]
    fn at_the_hover_speed_it_hovers_and_feels_one_g_up() {
        let airframe = Airframe::balanced();
        let speed = airframe.hover_speed_rad_s();
        let end = run(&airframe, turning(speed), [speed; ROTORS], 1e-3, 1000);
        assert!(norm(end.velocity_m_s) < 1e-9 && norm(end.body_rates_rad_s) < 1e-9);
        let force = airframe.wrench(&end, &OFF, STILL_AIR).force_n;
        assert!(
            norm(subtract(
                scale(force, 1.0 / airframe.mass_kg),
                [0.0, 0.0, -STANDARD_GRAVITY_M_S2]
            )) < 1e-9
        );
    }

    #[test]
    fn tumbling_freely_keeps_energy_and_angular_momentum() {
        let airframe = Airframe {
            drag_area_m2: 0.0,
            inertia_kg_m2: [0.012, 0.017, 0.022],
            ..Airframe::balanced()
        };
        let start = State {
            // About the middle axis: the unstable one.
            body_rates_rad_s: [0.1, 8.0, 0.1],
            ..State::at_rest(Quaternion::IDENTITY)
        };
        let momentum = |state: &State| {
            let body =
                [0, 1, 2].map(|axis| airframe.inertia_kg_m2[axis] * state.body_rates_rad_s[axis]);
            (
                state.attitude.rotate(body),
                0.5 * dot(body, state.body_rates_rad_s),
            )
        };
        let mut end = start;
        let mut slowest = f64::INFINITY;
        for _ in 0..400 {
            end = run(&airframe, end, OFF, 2.5e-4, 100);
            slowest = slowest.min(end.body_rates_rad_s[1]);
        }
        let ((before, energy), (after, energy_after)) = (momentum(&start), momentum(&end));
        assert!(
            norm(subtract(before, after)) < 1e-9 * norm(before),
            "{before:?} {after:?}"
        );
        assert!((energy - energy_after).abs() < 1e-9 * energy);
        assert!(slowest < -7.0, "it has not tumbled: {slowest}");
    }

    #[test]
    fn spinning_up_a_rotor_conserves_angular_momentum() {
        let airframe = Airframe {
            torque_per_thrust_m: 0.0,
            thrust_coefficient: 0.0,
            rotor_drag: 0.0,
            drag_area_m2: 0.0,
            ..Airframe::balanced()
        };
        // Only the two clockwise rotors spin up: the body must turn the other way.
        let end = run(
            &airframe,
            State::at_rest(Quaternion::IDENTITY),
            [0.0, 0.0, 500.0, 500.0],
            2.5e-4,
            4000,
        );
        let rotors: f64 = end.rotor_speeds_rad_s.iter().sum::<f64>() * airframe.rotor_inertia_kg_m2;
        let body = airframe.inertia_kg_m2[2] * end.body_rates_rad_s[2];
        assert!(body < -0.01);
        assert!((rotors + body).abs() < 1e-9, "{rotors} {body}");
    }

    #[test]
    fn a_spinning_rotor_makes_the_body_precess_and_keeps_the_angular_momentum() {
        let airframe = Airframe {
            torque_per_thrust_m: 0.0,
            thrust_coefficient: 0.0,
            rotor_drag: 0.0,
            drag_area_m2: 0.0,
            ..Airframe::balanced()
        };
        let speeds = [0.0, 0.0, 500.0, 500.0];
        let start = State {
            rotor_speeds_rad_s: speeds,
            body_rates_rad_s: [2.0, 0.0, 0.0],
            ..State::at_rest(Quaternion::IDENTITY)
        };
        let momentum = |state: &State| {
            let mut body =
                [0, 1, 2].map(|axis| airframe.inertia_kg_m2[axis] * state.body_rates_rad_s[axis]);
            body[2] += airframe.rotor_inertia_kg_m2 * 1000.0;
            state.attitude.rotate(body)
        };
        let end = run(&airframe, start, speeds, 2.5e-4, 4000);
        let (before, after) = (momentum(&start), momentum(&end));
        assert!(norm(subtract(before, after)) < 1e-9, "{before:?} {after:?}");
        assert!(end.body_rates_rad_s[1].abs() > 0.5, "it precesses");
    }

    #[test]
    fn each_rotor_tilts_and_turns_the_body_the_right_way() {
        let airframe = Airframe::balanced();
        let torque = |rotor: usize| {
            let mut state = State::at_rest(Quaternion::IDENTITY);
            state.rotor_speeds_rad_s[rotor] = 500.0;
            airframe.wrench(&state, &OFF, STILL_AIR).torque_n_m
        };
        // Front right lifts: left wing down, nose up; it turns counter-clockwise, so the body is
        // driven clockwise.
        assert!(torque(0)[0] < 0.0 && torque(0)[1] > 0.0 && torque(0)[2] > 0.0);
        // Back right lifts: left wing down, nose down; it turns clockwise.
        assert!(torque(3)[0] < 0.0 && torque(3)[1] < 0.0 && torque(3)[2] < 0.0);
    }

    #[test]
    fn rotor_drag_opposes_the_air_across_the_rotors_only() {
        let airframe = Airframe {
            drag_area_m2: 0.0,
            thrust_coefficient: 0.0,
            ..Airframe::balanced()
        };
        let state = turning(500.0);
        let force = airframe.wrench(&state, &OFF, [-3.0, 0.0, 5.0]).force_n;
        // A head wind of 3 m/s pushes back with c·v·ΣΩ.
        assert!((force[0] + 1.8e-4 * 3.0 * 2000.0).abs() < 1e-12);
        assert_eq!((force[1], force[2]), (0.0, 0.0));
    }

    #[test]
    fn vibration_is_at_once_and_twice_the_rotor_frequency() {
        let mut airframe = Airframe::balanced();
        airframe.unbalance_kg_m[0] = 1e-6;
        airframe.ripple[0] = 1e-7;
        let at_angle = |angle: f64| {
            let mut state = turning(500.0);
            state.rotor_angles_rad[0] = angle;
            airframe.wrench(&state, &OFF, STILL_AIR)
        };
        let pi = std::f64::consts::PI;
        let sides = (at_angle(0.0).force_n[0], at_angle(pi).force_n[0]);
        assert!(
            (sides.0 - 0.25).abs() < 1e-9 && (sides.1 + 0.25).abs() < 1e-9,
            "{sides:?}"
        );
        let (quarter, opposite) = (at_angle(pi / 4.0), at_angle(5.0 * pi / 4.0));
        let mean = at_angle(0.0).force_n[2];
        assert!((quarter.force_n[2] - mean + 0.025).abs() < 1e-9);
        assert!((opposite.force_n[2] - mean + 0.025).abs() < 1e-9);
        assert!(
            quarter.torque_n_m[0].abs() > 1e-3,
            "the ripple rolls the body"
        );
    }

    #[test]
    fn the_integrator_is_of_fourth_order() {
        let airframe = Airframe::balanced();
        let start = State {
            body_rates_rad_s: [1.0, 5.0, 2.0],
            velocity_m_s: [5.0, 0.0, 0.0],
            ..turning(400.0)
        };
        let end = |step_s: f64| {
            let steps = (0.5 / step_s).round() as u32;
            run(
                &airframe,
                start,
                [450.0, 500.0, 480.0, 520.0],
                step_s,
                steps,
            )
        };
        let exact = end(1e-4);
        let error = |step_s: f64| norm(subtract(end(step_s).velocity_m_s, exact.velocity_m_s));
        let ratio = error(2e-2) / error(1e-2);
        assert!((12.0..20.0).contains(&ratio), "{ratio}");
    }
}
