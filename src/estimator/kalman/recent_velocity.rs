//! Recent speed of the vehicle, which sets the noise of the small-velocity measurement.

use super::tuning::Tuning;
use crate::estimator::arithmetic::{smaller, square};
use crate::serialize::StateVisitor;

/// Mean squared velocity of a vehicle that may have begun to move, (m/s)²: 1 m/s on each
/// horizontal axis.
///
/// While the tilt is uncertain, the filter would take the first accelerations of a vehicle that had
/// stayed in place for tilt. In simulated flights 45 of 1,000 starts from kept state, 62 of 1,000
/// from a stored offset, and 17 of 1,000 pauses were then `VALID` and wrong.
const MAY_MOVE_M2_S2: f32 = 2.0;

/// Recent average speed of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct RecentVelocity {
    smooth_m_s: [f32; 2],
    /// Mean square of the smoothed velocity, (m/s)².
    pub(super) squared: f32,
    /// Time since the start, s, and at most that of the average.
    age_s: f32,
}

impl RecentVelocity {
    /// A vehicle that has not moved.
    pub(super) const NONE: Self = Self {
        smooth_m_s: [0.0; 2],
        squared: 0.0,
        age_s: 0.5,
    };

    /// A vehicle that has moved at this mean squared velocity, (m/s)², for long, and may have
    /// begun to move.
    pub(super) fn kept(squared: f32, tuning: &Tuning) -> Self {
        let mut recent = Self {
            squared: smaller(squared, square(2.0 * tuning.velocity_noise_limit)),
            age_s: tuning.velocity_average_s,
            ..Self::NONE
        };
        recent.may_move();
        recent
    }

    /// Allows for a vehicle that has begun to move while nothing showed it.
    pub(super) fn may_move(&mut self) {
        if self.squared < MAY_MOVE_M2_S2 {
            self.squared = MAY_MOVE_M2_S2;
        }
    }

    /// Adds the velocity of an interval.
    pub(super) fn update(&mut self, velocity_m_s: [f32; 2], duration_s: f32, tuning: &Tuning) {
        let share = duration_s / (tuning.velocity_smoothing_s + duration_s);
        for (smooth, velocity) in self.smooth_m_s.iter_mut().zip(velocity_m_s) {
            *smooth += share * (velocity - *smooth);
        }
        // A plain average at first, and an exponential one later.
        self.age_s = smaller(self.age_s + duration_s, tuning.velocity_average_s);
        let [north, east] = self.smooth_m_s;
        // A larger value would change nothing now, and the average would return slowly after a
        // knock.
        let limit = square(2.0 * tuning.velocity_noise_limit);
        let squared = smaller(square(north) + square(east), limit);
        self.squared += duration_s / (self.age_s + duration_s) * (squared - self.squared);
    }

    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            smooth_m_s,
            squared,
            age_s,
        } = self;
        visitor.f32s(smooth_m_s);
        visitor.f32(squared);
        visitor.f32(age_s);
    }
}
