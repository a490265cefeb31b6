//! A smooth turn from rest in one attitude to rest in another, with its exact rates.
//!
//! The body turns about one fixed axis, and the angle follows the minimum-jerk profile of Flash and
//! Hogan (J. Neuroscience 5, 1985), s(τ) = 10τ³ − 15τ⁴ + 6τ⁵: rate and acceleration are
//! zero at both ends.

use super::geometry::{Quaternion, Vector, scale};

/// A turn of given length between two attitudes, the shorter way.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    start: Quaternion,
    /// In body axes, which a rotation about a fixed axis leaves the same in the earth's.
    rotation_vector: Vector,
    duration_s: f64,
}

impl Turn {
    /// The turn from `start` to `end`, both body → earth, in `duration_s` seconds.
    #[must_use]
    pub fn new(start: Quaternion, end: Quaternion, duration_s: f64) -> Self {
        Self {
            start,
            rotation_vector: start.conjugate().multiply(end).to_rotation_vector(),
            duration_s,
        }
    }

    /// Attitude (body → earth) and body rates (rad/s) at `elapsed_s` after the start; at rest
    /// before and after.
    #[must_use]
    pub fn at(&self, elapsed_s: f64) -> (Quaternion, Vector) {
        let t = (elapsed_s / self.duration_s).clamp(0.0, 1.0);
        let share = t * t * t * (10.0 + t * (6.0 * t - 15.0));
        let share_rate = 30.0 * t * t * (1.0 - t) * (1.0 - t) / self.duration_s;
        (
            self.start.multiply(Quaternion::from_rotation_vector(scale(
                self.rotation_vector,
                share,
            ))),
            scale(self.rotation_vector, share_rate),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::geometry::{norm, subtract};

    #[test]
    fn it_starts_and_ends_at_rest_where_it_should() {
        let start = Quaternion::from_euler(0.1, 0.2, 0.3);
        let end = Quaternion::from_euler(-1.0, 0.5, 2.0);
        let turn = Turn::new(start, end, 1.0);
        for (time, pose) in [(-1.0, start), (0.0, start), (1.0, end), (5.0, end)] {
            let (attitude, rates) = turn.at(time);
            assert!(norm(attitude.conjugate().multiply(pose).to_rotation_vector()) < 1e-12);
            assert_eq!(norm(rates), 0.0);
        }
    }

    #[test]
    fn its_rates_are_the_derivative_of_its_attitude() {
        let turn = Turn::new(
            Quaternion::IDENTITY,
            Quaternion::from_euler(1.0, -0.8, 2.5),
            1.0,
        );
        let step = 1e-5;
        let mut fastest: f64 = 0.0;
        for index in 1..100 {
            let time = f64::from(index) * 0.01;
            let (before, after) = (turn.at(time - step).0, turn.at(time + step).0);
            let difference = scale(
                before.conjugate().multiply(after).to_rotation_vector(),
                0.5 / step,
            );
            let rates = turn.at(time).1;
            assert!(norm(subtract(difference, rates)) < 1e-8, "at {time}");
            fastest = fastest.max(norm(rates));
        }
        assert!(fastest > 2.0);
    }
}
