//! The simulated flight: rest on the ground, take-off, way-points, with exact truth at any instant.
//!
//! The physics of [`super::airframe`] run on a fixed grid of 4 kHz; the autopilot acts on every
//! fourth step. Between the grid points the state is the cubic Hermite interpolation of states and
//! their rates. The specific force follows from the equations of motion in that state. So attitude,
//! rates and specific force agree at every instant.

use super::Motion;
use super::airframe::{Airframe, ROTORS, State, runge_kutta_step};
use super::autopilot::Autopilot;
use super::geometry::{Quaternion, Vector, interpolate, scale};
use super::route::Route;
use super::truth::{ROOM_TEMPERATURE_C, STANDARD_GRAVITY_M_S2, Truth};
use super::wind::Wind;
use crate::random::Random;

/// Rest on the ground before the rotors start, s.
pub const REST_S: f64 = 3.0;

/// The commanded thrust grows from nothing in this time after the rest, s.
const SPIN_UP_S: f64 = 1.0;

const STEPS_PER_SECOND: u64 = 4000;
const STEP_S: f64 = 1.0 / STEPS_PER_SECOND as f64;
const STEPS_PER_CONTROL: u64 = 4;

/// All that makes one flight different from another.
#[derive(Clone, Debug)]
pub struct Flight {
    /// The vehicle.
    pub airframe: Airframe,
    /// The air.
    pub wind: Wind,
    /// The way-points.
    pub route: Route,
    /// Attitude on the ground, body → earth.
    pub ground_attitude: Quaternion,
    /// Air temperature, °C.
    pub temperature_c: f64,
}

impl Flight {
    /// A hover over level ground in still air with perfect rotors: what closed forms can say
    /// something about.
    #[must_use]
    pub fn ideal_hover() -> Self {
        Self {
            airframe: Airframe::balanced(),
            wind: Wind::calm(),
            route: Route::hover(),
            ground_attitude: Quaternion::IDENTITY,
            temperature_c: ROOM_TEMPERATURE_C,
        }
    }

    /// A flight like any other day's: a little slope, some wind, rotors that are not quite
    /// balanced.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
        let mut random = Random::new(seed, "flight");
        let slope = random.uniform(1.0, 3.0).to_radians();
        let direction = random.uniform(0.0, std::f64::consts::TAU);
        let ground = [
            slope * libm::cos(direction),
            slope * libm::sin(direction),
            0.0,
        ];
        let mut airframe = Airframe::balanced();
        // At the hover speed one rotor shakes the body by 0.1 to 1 m/s² once per turn, and by up
        // to 0.8 m/s² twice per turn.
        let per_m_s2 =
            airframe.mass_kg / (airframe.hover_speed_rad_s() * airframe.hover_speed_rad_s());
        airframe.unbalance_kg_m = [0; ROTORS].map(|_| random.uniform(0.1, 1.0) * per_m_s2);
        airframe.ripple = [0; ROTORS].map(|_| random.uniform(0.2, 0.8) * per_m_s2);
        Self {
            airframe,
            wind: Wind::by_seed(seed),
            route: Route::by_seed(seed),
            ground_attitude: Quaternion::from_rotation_vector(ground),
            temperature_c: random.uniform(10.0, 30.0),
        }
    }
}

/// A flight under way.
#[derive(Clone, Debug)]
pub struct Quadrotor {
    flight: Flight,
    autopilot: Autopilot,
    commands: [f64; ROTORS],
    airborne: bool,
    /// Steps done; the segment ends at this grid point.
    steps: u64,
    segment: Segment,
}

/// One step of the grid, with what is needed to interpolate in it.
#[derive(Clone, Copy, Debug)]
struct Segment {
    start: State,
    start_rate: State,
    end: State,
    end_rate: State,
    commands: [f64; ROTORS],
    start_wind_m_s: Vector,
    end_wind_m_s: Vector,
    airborne: bool,
}

impl Quadrotor {
    /// The flight of this seed.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
        Self::new(Flight::by_seed(seed))
    }

    /// A flight of one's own.
    #[must_use]
    pub fn new(flight: Flight) -> Self {
        let state = State::at_rest(flight.ground_attitude);
        let still = State::at_rest(Quaternion::new(0.0, 0.0, 0.0, 0.0));
        let wind = flight.wind.velocity_m_s();
        Self {
            flight,
            autopilot: Autopilot::default(),
            commands: [0.0; ROTORS],
            airborne: false,
            steps: 0,
            segment: Segment {
                start: state,
                start_rate: still,
                end: state,
                end_rate: still,
                commands: [0.0; ROTORS],
                start_wind_m_s: wind,
                end_wind_m_s: wind,
                airborne: false,
            },
        }
    }

    /// The state at `time_s`; times must not decrease.
    pub fn state_at(&mut self, time_s: f64) -> State {
        let share = self.step_to(time_s);
        self.segment.state(share)
    }

    /// Steps until the segment contains `time_s`, and returns the share of it.
    fn step_to(&mut self, time_s: f64) -> f64 {
        while self.steps as f64 * STEP_S < time_s {
            self.step();
        }
        let start_s = (self.steps.max(1) - 1) as f64 * STEP_S;
        ((time_s - start_s) / STEP_S).clamp(0.0, 1.0)
    }

    fn step(&mut self) {
        let time_s = self.steps as f64 * STEP_S;
        let start = self.segment.end.with_small_rotor_angles();
        let start_wind_m_s = self.segment.end_wind_m_s;
        if self.steps.is_multiple_of(STEPS_PER_CONTROL) && time_s >= REST_S {
            self.control(&start, time_s - REST_S);
        }
        self.flight.wind.step(STEP_S);
        let end_wind_m_s = self.flight.wind.velocity_m_s();
        let (airframe, commands) = (&self.flight.airframe, self.commands);
        self.airborne = self.airborne || lifts_off(airframe, &start);
        let airborne = self.airborne;
        let rate = |state: &State, share: f64| {
            let wind = interpolate(start_wind_m_s, end_wind_m_s, share);
            let free = airframe.rate(state, &commands, wind);
            if airborne { free } else { held(free) }
        };
        let start_rate = self.segment.rate_of_next(airborne, &commands);
        let start_rate = start_rate.unwrap_or_else(|| rate(&start, 0.0));
        let end = runge_kutta_step(&start, start_rate, STEP_S, rate);
        self.segment = Segment {
            start,
            start_rate,
            end,
            end_rate: rate(&end, 1.0),
            commands,
            start_wind_m_s,
            end_wind_m_s,
            airborne,
        };
        self.steps += 1;
    }

    fn control(&mut self, state: &State, since_rest_s: f64) {
        let step_s = STEP_S * STEPS_PER_CONTROL as f64;
        if self.airborne {
            self.flight.route.step(state.position_m, step_s);
        }
        let wanted = self.autopilot.rotor_speeds(
            &self.flight.airframe,
            state,
            self.flight.route.leg(),
            self.airborne,
            step_s,
        );
        // Thrust goes with the square of the speed.
        let share = (since_rest_s / SPIN_UP_S).min(1.0).sqrt();
        self.commands = wanted.map(|speed| speed * share);
    }
}

impl Motion for Quadrotor {
    fn at(&mut self, time_s: f64) -> Truth {
        let share = self.step_to(time_s);
        let segment = &self.segment;
        let state = segment.state(share);
        let airframe = &self.flight.airframe;
        let specific_force_m_s2 = if segment.airborne {
            let wind = interpolate(segment.start_wind_m_s, segment.end_wind_m_s, share);
            scale(airframe.force_n(&state, wind), 1.0 / airframe.mass_kg)
        } else {
            Truth::at_rest(state.attitude).specific_force_m_s2
        };
        Truth {
            specific_force_m_s2,
            body_rates_rad_s: state.body_rates_rad_s,
            attitude: Some(state.attitude),
            temperature_c: self.flight.temperature_c,
            thrust_g: thrust_n(airframe, &state) / (airframe.mass_kg * STANDARD_GRAVITY_M_S2),
            scored: segment.airborne,
        }
    }
}

impl Segment {
    /// Returns the rate at the start of the next step, if that is the one at the end of this.
    fn rate_of_next(&self, airborne: bool, commands: &[f64; ROTORS]) -> Option<State> {
        // The interpolation may round.
        let wind_m_s = interpolate(self.start_wind_m_s, self.end_wind_m_s, 1.0);
        let is_same = self.airborne == airborne
            && self.commands == *commands
            && wind_m_s == self.end_wind_m_s;
        is_same.then_some(self.end_rate)
    }

    /// The state at `share` of the step: the cubic with the states and rates of both ends.
    fn state(&self, share: f64) -> State {
        let (s, s2, s3) = (share, share * share, share * share * share);
        let zero = State::at_rest(Quaternion::new(0.0, 0.0, 0.0, 0.0));
        let mut state = zero
            .plus(&self.start, 2.0 * s3 - 3.0 * s2 + 1.0)
            .plus(&self.end, 3.0 * s2 - 2.0 * s3)
            .plus(&self.start_rate, (s3 - 2.0 * s2 + s) * STEP_S)
            .plus(&self.end_rate, (s3 - s2) * STEP_S);
        state.attitude = state.attitude.normalized();
        state
    }
}

/// Returns true if the rotors carry the weight. The ground only pushes.
fn lifts_off(airframe: &Airframe, state: &State) -> bool {
    let up = state.attitude.rotate([0.0, 0.0, 1.0])[2];
    thrust_n(airframe, state) * up >= airframe.mass_kg * STANDARD_GRAVITY_M_S2
}

/// Returns the thrust of all rotors.
fn thrust_n(airframe: &Airframe, state: &State) -> f64 {
    let squares = state.rotor_speeds_rad_s.iter().map(|speed| speed * speed);
    airframe.thrust_coefficient * squares.sum::<f64>()
}

/// Returns the rates of change while the ground holds the body: only the rotors move.
fn held(free: State) -> State {
    State {
        rotor_speeds_rad_s: free.rotor_speeds_rad_s,
        rotor_angles_rad: free.rotor_angles_rad,
        ..State::at_rest(Quaternion::new(0.0, 0.0, 0.0, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::geometry::{add, angle_between, norm, subtract};
    use crate::motion::route::SPEED_LIMIT_M_S;
    use crate::motion::truth::up_in_body;

    #[test]
    fn it_rests_then_takes_off() {
        let mut flight = Quadrotor::by_seed(1);
        let first = flight.at(0.0);
        assert_eq!(flight.at(1.234), first);
        assert_eq!(flight.at(3.0), first);
        let slope =
            angle_between(up_in_body(first.attitude.unwrap()), [0.0, 0.0, -1.0]).to_degrees();
        assert!((1.0..=3.0).contains(&slope), "{slope}");
        assert!((norm(first.specific_force_m_s2) - STANDARD_GRAVITY_M_S2).abs() < 1e-12);
        assert!(!first.scored);
        assert!(flight.at(5.0).scored);
        assert!(flight.state_at(8.0).position_m[2] < -2.0);
    }

    #[test]
    fn an_ideal_hover_feels_exactly_one_g_and_stands_still() {
        let mut flight = Quadrotor::new(Flight::ideal_hover());
        let state = flight.state_at(40.0);
        assert!(
            norm(subtract(state.position_m, [0.0, 0.0, -3.0])) < 1e-3,
            "{:?}",
            state.position_m
        );
        let truth = flight.at(40.0);
        assert!(
            norm(add(
                truth.specific_force_m_s2,
                [0.0, 0.0, STANDARD_GRAVITY_M_S2]
            )) < 1e-3
        );
        assert!(norm(truth.body_rates_rad_s) < 1e-6);
    }

    #[test]
    fn the_rates_integrate_to_the_attitude() {
        for seed in 0..3 {
            let mut flight = Quadrotor::by_seed(seed);
            let step_s = 1.0 / 8000.0;
            let mut attitude = flight.at(0.0).attitude.unwrap();
            for index in 0..60 * 8000 {
                // The middle of the interval: the midpoint rule.
                let rates = flight
                    .at((f64::from(index) + 0.5) * step_s)
                    .body_rates_rad_s;
                attitude =
                    attitude.multiply(Quaternion::from_rotation_vector(scale(rates, step_s)));
            }
            let truth = flight.at(60.0).attitude.unwrap();
            let error =
                norm(attitude.conjugate().multiply(truth).to_rotation_vector()).to_degrees();
            assert!(error < 0.01, "seed {seed}: {error}°");
        }
    }

    #[test]
    fn the_specific_force_integrates_to_the_velocity() {
        let mut flight = Quadrotor::by_seed(4);
        let step_s = 1.0 / 8000.0;
        let mut velocity = [0.0; 3];
        for index in 0..60 * 8000 {
            let truth = flight.at((f64::from(index) + 0.5) * step_s);
            let acceleration = truth.attitude.unwrap().rotate(truth.specific_force_m_s2);
            velocity = add(
                velocity,
                scale(add(acceleration, [0.0, 0.0, STANDARD_GRAVITY_M_S2]), step_s),
            );
        }
        let truth = flight.state_at(60.0).velocity_m_s;
        assert!(norm(truth) > 0.1, "it moves");
        assert!(
            norm(subtract(velocity, truth)) < 1e-3,
            "{velocity:?} {truth:?}"
        );
    }

    #[test]
    fn speed_tilt_and_place_stay_bounded_and_are_made_use_of() {
        let (mut fastest, mut steepest, mut farthest): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for seed in 0..8 {
            let mut flight = Quadrotor::by_seed(seed);
            for index in 0..12_000 {
                let state = flight.state_at(f64::from(index) * 0.01);
                fastest = fastest.max(norm(state.velocity_m_s));
                steepest = steepest
                    .max(angle_between(up_in_body(state.attitude), [0.0, 0.0, -1.0]).to_degrees());
                farthest = farthest.max(norm(state.position_m));
            }
        }
        assert!(
            fastest < SPEED_LIMIT_M_S + 2.0 && fastest > 5.0,
            "{fastest} m/s"
        );
        assert!(steepest < 65.0 && steepest > 30.0, "{steepest}°");
        assert!(farthest < 40.0 && farthest > 10.0, "{farthest} m");
    }

    #[test]
    fn horizontal_acceleration_reaches_half_a_g_but_not_much_more_than_one() {
        let mut greatest: f64 = 0.0;
        for seed in 0..8 {
            // Averaged over 50 ms, which leaves the vibration out.
            let mut flight = Quadrotor::by_seed(seed);
            let mut before = flight.state_at(0.0).velocity_m_s;
            for index in 1..1200 {
                let velocity = flight.state_at(f64::from(index) * 0.05).velocity_m_s;
                let change = scale(subtract(velocity, before), 1.0 / 0.05);
                greatest = greatest.max(libm::hypot(change[0], change[1]));
                before = velocity;
            }
        }
        assert!(
            (0.5..1.3).contains(&(greatest / STANDARD_GRAVITY_M_S2)),
            "{greatest} m/s²"
        );
    }

    #[test]
    fn one_seed_is_one_flight_however_it_is_asked() {
        let mut often = Quadrotor::by_seed(9);
        let mut rarely = Quadrotor::by_seed(9);
        let mut other = Quadrotor::by_seed(10);
        for index in 0..20_000 {
            let _ = often.at(f64::from(index) * 1e-3 - 1e-9);
        }
        assert_eq!(often.at(20.0), rarely.at(20.0));
        assert_ne!(rarely.at(20.0), other.at(20.0));
    }

    #[test]
    fn the_rotors_shake_both_sensors_at_their_own_frequency() {
        let spread = |flight: Flight| {
            let mut quadrotor = Quadrotor::new(flight);
            let truths: Vec<Truth> = (0..8000)
                .map(|index| quadrotor.at(20.0 + f64::from(index) / 8000.0))
                .collect();
            let deviation = |value: fn(&Truth) -> f64| {
                let mean = truths.iter().map(value).sum::<f64>() / truths.len() as f64;
                (truths
                    .iter()
                    .map(|truth| (value(truth) - mean).powi(2))
                    .sum::<f64>()
                    / truths.len() as f64)
                    .sqrt()
            };
            (
                deviation(|truth| truth.specific_force_m_s2[0]),
                deviation(|truth| truth.body_rates_rad_s[0].to_degrees()),
            )
        };
        let smooth = spread(Flight::ideal_hover());
        let shaken = spread(Flight {
            airframe: Flight::by_seed(2).airframe,
            ..Flight::ideal_hover()
        });
        assert!(smooth.0 < 1e-2 && smooth.1 < 1e-2, "{smooth:?}");
        assert!(
            (0.2..3.0).contains(&shaken.0) && (0.1..5.0).contains(&shaken.1),
            "{shaken:?}"
        );
    }
}
