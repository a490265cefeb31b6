//! Route of the simulated flight: way-points without end, drawn in a box above the take-off
//! point.

use super::geometry::{Vector, norm, subtract};
use super::truth::STANDARD_GRAVITY_M_S2;
use crate::random::Random;

/// One leg of the flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// Destination, earth axes, m.
    pub position_m: Vector,
    /// Heading to arrive with, rad.
    pub yaw_rad: f64,
    /// Fastest horizontal speed, m/s.
    pub speed_limit_m_s: f64,
    /// Greatest horizontal acceleration, m/s².
    pub acceleration_limit_m_s2: f64,
    /// Time of the stay there, s.
    pub hold_s: f64,
}

/// No leg asks for more horizontal speed than this, m/s.
pub const SPEED_LIMIT_M_S: f64 = 8.0;

/// Close enough to a way-point, m.
const ARRIVAL_RADIUS_M: f64 = 1.0;

/// After this long a way-point is given up (a gale may forbid it), s.
const LEG_TIMEOUT_S: f64 = 20.0;

/// A sequence of legs.
#[derive(Clone, Debug)]
pub struct Route {
    leg: Leg,
    elapsed_s: f64,
    held_s: f64,
    /// `None` stays at the first way-point for ever.
    random: Option<Random>,
}

impl Route {
    /// Climbs to 3 m and stays there.
    #[must_use]
    pub fn hover() -> Self {
        let leg = Leg {
            position_m: [0.0, 0.0, -3.0],
            yaw_rad: 0.0,
            speed_limit_m_s: 2.0,
            acceleration_limit_m_s2: 2.0,
            hold_s: 1.0,
        };
        Self {
            leg,
            elapsed_s: 0.0,
            held_s: 0.0,
            random: None,
        }
    }

    /// Climbs to 3 m, then flies from way-point to way-point, now gently, now at up to 1 g.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
        Self {
            random: Some(Random::new(seed, "route")),
            ..Self::hover()
        }
    }

    /// The leg to fly now.
    #[must_use]
    pub fn leg(&self) -> &Leg {
        &self.leg
    }

    /// Lets `step_s` seconds pass with the vehicle at `position_m`.
    pub fn step(&mut self, position_m: Vector, step_s: f64) {
        self.elapsed_s += step_s;
        if norm(subtract(position_m, self.leg.position_m)) < ARRIVAL_RADIUS_M {
            self.held_s += step_s;
        }
        let done = self.held_s >= self.leg.hold_s || self.elapsed_s > LEG_TIMEOUT_S;
        if let (true, Some(random)) = (done, &mut self.random) {
            self.leg = Leg {
                position_m: [
                    random.uniform(-15.0, 15.0),
                    random.uniform(-15.0, 15.0),
                    random.uniform(-12.0, -3.0),
                ],
                yaw_rad: random.uniform(-std::f64::consts::PI, std::f64::consts::PI),
                speed_limit_m_s: random.uniform(2.0, SPEED_LIMIT_M_S),
                acceleration_limit_m_s2: random.uniform(0.2, 1.0) * STANDARD_GRAVITY_M_S2,
                hold_s: random.uniform(0.05, 1.5),
            };
            self.elapsed_s = 0.0;
            self.held_s = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leg_lasts_until_the_vehicle_has_stayed_there_or_time_is_up() {
        let mut route = Route::by_seed(1);
        let first = *route.leg();
        route.step([5.0, 0.0, 0.0], 19.9);
        assert_eq!(*route.leg(), first);
        route.step([5.0, 0.0, 0.0], 0.2);
        let second = *route.leg();
        assert_ne!(second, first);
        route.step(second.position_m, 0.5 * second.hold_s);
        assert_eq!(*route.leg(), second);
        route.step(second.position_m, 0.6 * second.hold_s);
        assert_ne!(*route.leg(), second);
    }

    #[test]
    fn a_hover_stays_for_ever() {
        let mut route = Route::hover();
        let first = *route.leg();
        route.step(first.position_m, 1000.0);
        assert_eq!(*route.leg(), first);
    }
}
