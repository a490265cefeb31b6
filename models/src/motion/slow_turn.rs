//! A slow, steady turn, as of a turntable, an aerial or a boat: its readings hardly change.

use super::geometry::{Quaternion, Vector, scale};
use super::truth::Truth;
use super::{Motion, geometry};
use crate::random::Random;

/// A turn about an axis through the sensor that is fixed in earth and body axes. Its rate grows
/// smoothly, stays, wobbles in half of the turns, and falls smoothly. Before and after it the body
/// rests.
#[derive(Clone, Debug)]
pub struct SlowTurn {
    start: Quaternion,
    /// Axis of the turn, body axes.
    axis: Vector,
    rate_rad_s: f64,
    /// Time for which the rate grows or falls.
    ramp_s: f64,
    from_s: f64,
    until_s: f64,
    /// Amplitude of the wobble, as a share of the rate.
    wobble: f64,
    wobble_rad_s: f64,
}

impl SlowTurn {
    /// A turn at 1 to 60 °/s that begins at `from_s` (before zero: it is under way at power-up),
    /// and ends between 4 s and 28 s. Seven of ten axes are within 30° of the vertical.
    #[must_use]
    pub fn by_seed(seed: u64, from_s: f64) -> Self {
        let mut random = Random::new(seed, "slow turn");
        let start =
            Quaternion::from_euler(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), 0.0);
        let limits_deg = if random.uniform(0.0, 1.0) < 0.7 {
            [0.0, 30.0]
        } else {
            [30.0, 90.0]
        };
        let off_rad = random.uniform(limits_deg[0], limits_deg[1]).to_radians();
        let (sine, cosine) = (libm::sin(off_rad), libm::cos(off_rad));
        let azimuth_rad = random.uniform(0.0, std::f64::consts::TAU);
        let axis = start.conjugate().rotate([
            sine * libm::cos(azimuth_rad),
            sine * libm::sin(azimuth_rad),
            cosine,
        ]);
        let rate_deg_s = random.uniform(1.0_f64.ln(), 60.0_f64.ln()).exp();
        let sign = random.sign();
        let is_wobbly = random.uniform(0.0, 1.0) < 0.5;
        Self {
            start,
            axis: scale(axis, 1.0 / geometry::norm(axis)),
            rate_rad_s: sign * rate_deg_s.to_radians(),
            ramp_s: random.uniform(0.05, 6.0),
            from_s,
            until_s: random.uniform(4.0, 28.0),
            wobble: f64::from(u8::from(is_wobbly)) * random.uniform(0.0, 0.1),
            wobble_rad_s: std::f64::consts::TAU * random.uniform(0.05, 3.0),
        }
    }

    /// Share of the full rate, and its integral, this long after a ramp has begun.
    fn ramp(&self, elapsed_s: f64) -> (f64, f64) {
        let x = (elapsed_s / self.ramp_s).clamp(0.0, 1.0);
        let share = x * x * (3.0 - 2.0 * x);
        let within_s = self.ramp_s * (x * x * x - 0.5 * x * x * x * x);
        (share, within_s + (elapsed_s - self.ramp_s).max(0.0))
    }
}

impl Motion for SlowTurn {
    fn at(&mut self, time_s: f64) -> Truth {
        let (rising, risen_s) = self.ramp(time_s - self.from_s);
        let (falling, fallen_s) = self.ramp(time_s - self.until_s);
        let phase = self.wobble_rad_s * (time_s - self.from_s).max(0.0);
        let wobble = self.wobble * libm::sin(phase);
        let wobbled_s = self.wobble * (1.0 - libm::cos(phase)) / self.wobble_rad_s;
        let rate = self.rate_rad_s * (rising - falling + wobble);
        let angle = self.rate_rad_s * (risen_s - fallen_s + wobbled_s);
        let turned = Quaternion::from_rotation_vector(scale(self.axis, angle));
        let attitude = self.start.multiply(turned);
        Truth::turning(attitude, scale(self.axis, rate))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rates_are_those_of_the_attitude() {
        for seed in 0..20 {
            for from_s in [-8.0, 2.0] {
                let mut turn = SlowTurn::by_seed(seed, from_s);
                for step in 0..300 {
                    let time_s = 0.01 + f64::from(step) * 0.13;
                    let before = turn.at(time_s - 1e-5).attitude.unwrap();
                    let rate = turn.at(time_s).body_rates_rad_s;
                    let after = turn.at(time_s + 1e-5).attitude.unwrap();
                    let turned = before.conjugate().multiply(after).to_rotation_vector();
                    for (turned, rate) in turned.into_iter().zip(rate) {
                        assert!((turned / 2e-5 - rate).abs() < 1e-4, "{seed} {time_s}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_turn_begins_after_the_rest_or_before_power_up() {
        for seed in 0..20 {
            assert_eq!(
                SlowTurn::by_seed(seed, 2.0).at(2.0).body_rates_rad_s,
                [0.0; 3]
            );
            let rate = geometry::norm(SlowTurn::by_seed(seed, -8.0).at(0.0).body_rates_rad_s);
            assert!((0.9..66.0).contains(&rate.to_degrees()), "{rate}");
        }
    }
}
