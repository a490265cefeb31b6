//! Motions for flights that have no time to lose: a body that swings about an axis, and a motion
//! that is under way at power-up, or runs by a wrong clock.

use super::geometry::{Quaternion, Vector, scale};
use super::truth::Truth;
use super::{Motion, geometry};
use crate::random::Random;

/// Rest, and then a swing to and fro about an axis through the sensor, which so feels gravity
/// alone.
#[derive(Clone, Debug)]
pub struct Swing {
    start: Quaternion,
    axis: Vector,
    amplitude_rad: f64,
    rate_rad_s: f64,
    rest_s: f64,
}

impl Swing {
    /// A swing of 20° to 120° to one side and back, at up to 200 °/s, after `rest_s` of rest.
    #[must_use]
    pub fn by_seed(seed: u64, rest_s: f64) -> Self {
        let mut random = Random::new(seed, "swing");
        let axis: Vector = [random.normal(), random.normal(), random.normal()];
        let amplitude_rad = random.uniform(20.0, 120.0).to_radians();
        // The angle is half the amplitude times 1 − cos, so its rate is at most half the
        // amplitude times this.
        let fastest_rad_s = random.uniform(20.0, 200.0).to_radians();
        Self {
            start: Quaternion::from_euler(
                random.uniform(-0.5, 0.5),
                random.uniform(-0.5, 0.5),
                0.0,
            ),
            axis: scale(axis, 1.0 / geometry::norm(axis).max(1e-6)),
            amplitude_rad,
            rate_rad_s: fastest_rad_s / (0.5 * amplitude_rad),
            rest_s,
        }
    }
}

impl Motion for Swing {
    fn at(&mut self, time_s: f64) -> Truth {
        let phase = self.rate_rad_s * (time_s - self.rest_s).max(0.0);
        let angle = 0.5 * self.amplitude_rad * (1.0 - libm::cos(phase));
        let rate = 0.5 * self.amplitude_rad * self.rate_rad_s * libm::sin(phase);
        let turned = Quaternion::from_rotation_vector(scale(self.axis, angle));
        let attitude = self.start.multiply(turned);
        Truth::turning(attitude, scale(self.axis, rate))
    }
}

/// The last part of a swing, and then the swing with its rest: a start in motion.
#[derive(Clone, Debug)]
pub struct Moving {
    /// The swing.
    pub swing: Swing,
    /// Length of the last part, s. A swing that is shorter rests before it.
    pub first_s: f64,
}

impl Motion for Moving {
    fn at(&mut self, time_s: f64) -> Truth {
        let Swing {
            rest_s, rate_rad_s, ..
        } = self.swing;
        let left_s = self.first_s - time_s;
        let swung_s = std::f64::consts::TAU / rate_rad_s - left_s;
        self.swing.at(if left_s > 0.0 {
            rest_s + swung_s.max(0.0)
        } else {
            -left_s
        })
    }
}

/// A motion that has been going on for a while at power-up.
#[derive(Clone, Debug)]
pub struct Later<M> {
    /// The motion.
    pub motion: M,
    /// Time since its start, s.
    pub by_s: f64,
}

impl<M: Motion> Motion for Later<M> {
    fn at(&mut self, time_s: f64) -> Truth {
        self.motion.at(time_s + self.by_s)
    }
}

/// A motion by the time of a clock that is wrong.
pub struct ByOtherClock {
    /// The motion.
    pub motion: Box<dyn Motion>,
    /// Time from which the clock is wrong, s.
    pub from_s: f64,
    /// Error of the clock, as a share: +0.01 runs 1 % fast.
    pub error: f64,
}

impl Motion for ByOtherClock {
    fn at(&mut self, time_s: f64) -> Truth {
        let wrong_s = (time_s - self.from_s).max(0.0);
        self.motion
            .at(time_s - wrong_s + wrong_s / (1.0 + self.error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::inclination_error_rad;

    #[test]
    fn the_rates_are_those_of_the_attitude() {
        for seed in 0..20 {
            let mut swing = Swing::by_seed(seed, 1.5);
            assert_eq!(swing.at(0.0).body_rates_rad_s.map(f64::abs), [0.0; 3]);
            for step in 0..300 {
                let time_s = 1.4 + f64::from(step) * 0.01;
                let (before, middle, after) = (
                    swing.at(time_s - 1e-5),
                    swing.at(time_s),
                    swing.at(time_s + 1e-5),
                );
                let [before_q, after_q] = [before, after].map(|truth| truth.attitude.unwrap());
                let turn = before_q.conjugate().multiply(after_q).to_rotation_vector();
                for (turned, rate) in turn.into_iter().zip(middle.body_rates_rad_s) {
                    assert!(
                        (turned / 2e-5 - rate).abs() < 0.01,
                        "{seed} {time_s}: {turn:?}"
                    );
                }
                let fastest = geometry::norm(middle.body_rates_rad_s);
                assert!(fastest.to_degrees() < 200.1);
            }
        }
    }

    #[test]
    fn later_is_the_same_motion_later() {
        let swing = Swing::by_seed(3, 1.5);
        let mut later = Later {
            motion: swing.clone(),
            by_s: 1.0,
        };
        let expected = swing.clone().at(3.0).attitude.unwrap();
        assert_eq!(
            inclination_error_rad(later.at(2.0).attitude.unwrap(), expected),
            0.0
        );
    }

    #[test]
    fn a_start_in_motion_ends_at_the_rest_of_the_swing() {
        for seed in 0..20 {
            let swing = Swing::by_seed(seed, 1.5);
            let mut moving = Moving {
                swing: swing.clone(),
                first_s: 2.0,
            };
            let fastest = (0..200).map(|step| {
                let truth = moving.at(f64::from(step) * 0.01);
                geometry::norm(truth.body_rates_rad_s)
            });
            assert!(fastest.fold(0.0, f64::max) > 0.1, "{seed}");
            let [before, after] = [1.999_99, 2.000_01].map(|time_s| moving.at(time_s));
            assert!(geometry::norm(before.body_rates_rad_s) < 0.01, "{seed}");
            assert_eq!(after.body_rates_rad_s.map(f64::abs), [0.0; 3]);
            let expected = swing.clone().at(2.0).attitude.unwrap();
            let later = moving.at(4.0).attitude.unwrap();
            assert!(inclination_error_rad(later, expected) < 1e-9, "{seed}");
        }
    }

    #[test]
    fn a_clock_that_runs_slow_shows_more_of_the_motion_in_its_second() {
        let swing = Swing::by_seed(3, 1.5);
        let mut slow = ByOtherClock {
            motion: Box::new(swing.clone()),
            from_s: 2.0,
            error: -0.08,
        };
        for (shown_s, true_s) in [(1.9, 1.9), (2.92, 3.0)] {
            let expected = swing.clone().at(true_s).body_rates_rad_s;
            let shown = slow.at(shown_s).body_rates_rad_s;
            for (shown, expected) in shown.into_iter().zip(expected) {
                assert!((shown - expected).abs() < 1e-9, "{shown_s}");
            }
        }
    }
}
