//! Steps of the heading filter, in slices: one step after each covariance step of the tilt filter,
//! over the same interval.
//!
//! 1. *Repeat* the tilt filter's step on the cross-covariance ([`follow`](follow)).
//! 2. *Turn* the field by the drift of yaw. The gyroscope's errors e turn the level frame by
//!    W·e about down, so the field in it moves by (W·e)·(−c_y, c_x, 0). The errors are constant
//!    over an interval, so those after the tilt filter's correction δ serve: c moves by δ, and its
//!    covariance by what is left.
//! 3. *Forget* the local deviation, and add the process noise.
//! 4. *Measure*: three rows, each by [`measurement`](super::measurement).
//!
//! [`follow`]: crate::estimator::kalman

use super::Heading;
use super::covariance::{CORRELATED, DEVIATION, FIELD, IRON, STATES};
use super::tuning::square;
use crate::estimator::kalman::Kalman;
use crate::estimator::kalman::follow::{
    ERROR_STATES, FIRST_GYROSCOPE, GYROSCOPE, MEASUREMENTS, VELOCITY,
};

/// Rows of X that a slice propagates.
const ROWS: usize = 3;
/// Parameters of the gyroscope whose drift a slice adds.
const PARAMETERS: usize = 2;

/// The next slice of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum Phase {
    /// No step.
    Idle,
    /// Waits for the tilt filter to end its step.
    Waiting,
    /// X over the interval, from this row on.
    Propagate(usize),
    /// X by what the tilt filter resets and lets return to its prior.
    Relax,
    /// A row of X, and of O, by the tilt filter's measurement of this index.
    Follow(usize, usize),
    /// Covariance of the drift of yaw with the error states, from this parameter on.
    Drift(usize),
    /// Covariance of the drift of yaw with the field states.
    Turn,
    /// The field by the drift of yaw.
    Turned,
    /// Process noise of field and hard iron.
    Walk,
    /// This state of the local deviation.
    Forget(usize),
    /// Expected innovation of this axis.
    Expect(usize),
    /// The gate.
    Gate,
    /// O·hᵀ and the innovation of this axis.
    Project(usize),
    /// X·hᵀ of this axis.
    ProjectCross(usize),
    /// Gain of this axis, and O and X from this row on.
    Correct(usize, usize),
    /// The result.
    Finish,
}

impl Heading {
    /// Runs a slice.
    pub(super) fn slice(&mut self, kalman: &Kalman) {
        self.phase = match self.phase {
            Phase::Idle => Phase::Idle,
            Phase::Waiting => Phase::Waiting,
            Phase::Propagate(row) => self.propagate(kalman, row),
            Phase::Relax => self.relax(kalman),
            Phase::Follow(row, index) => self.follow_measurement(kalman, row, index),
            Phase::Drift(parameter) => self.drift(kalman, parameter),
            Phase::Turn => self.project_drift(),
            Phase::Turned => self.turn_field(kalman),
            Phase::Walk => self.walk(kalman),
            Phase::Forget(state) => self.forget(state),
            Phase::Expect(axis) => self.expect(kalman, axis),
            Phase::Gate => self.gate(),
            Phase::Project(axis) => self.project_own(axis),
            Phase::ProjectCross(axis) => self.project_cross(kalman, axis),
            Phase::Correct(axis, row) => self.correct(axis, row),
            Phase::Finish => self.finish(kalman),
        };
    }

    fn propagate(&mut self, kalman: &Kalman, first: usize) -> Phase {
        for row in self.covariance.cross.iter_mut().skip(first).take(ROWS) {
            kalman.propagate_row(row);
        }
        if first + ROWS < CORRELATED {
            Phase::Propagate(first + ROWS)
        } else {
            Phase::Relax
        }
    }

    fn relax(&mut self, kalman: &Kalman) -> Phase {
        let (relaxed, factor) = kalman.relaxed();
        self.covariance.scale_cross(relaxed, factor);
        if kalman.is_velocity_reset() {
            for state in VELOCITY {
                self.covariance.scale_cross(state, 0.0);
            }
        }
        Phase::Follow(0, 0)
    }

    /// Repeats a measurement of the tilt filter on a row of X and O.
    ///
    /// A row needs its own p before the step, and X·e of the rows above after the step.
    fn follow_measurement(&mut self, kalman: &Kalman, row: usize, index: usize) -> Phase {
        let Some(own) = self.covariance.cross.get(row) else {
            self.column = [0.0; ERROR_STATES];
            return Phase::Drift(0);
        };
        if index == 0 {
            for (place, gain) in self.gains.iter_mut().enumerate() {
                *gain = match kalman.followed(place) {
                    Some(followed) => {
                        let p = own.get(followed.state).copied().unwrap_or(0.0);
                        p * followed.weight
                    }
                    None => 0.0,
                };
            }
        }
        if let (Some(followed), Some(gain)) = (kalman.followed(index), self.gains.get(index)) {
            let gain = *gain;
            kalman.copy_column(followed.state, &mut self.column);
            self.covariance.subtract_cross(row, gain, &self.column);
            if let Some(state) = self.state.get_mut(row) {
                *state += gain * followed.residual;
            }
            if index + 1 < MEASUREMENTS && kalman.followed(index + 1).is_some() {
                return Phase::Follow(row, index + 1);
            }
        }
        self.follow_own(kalman, row);
        Phase::Follow(row + 1, 0)
    }

    /// Repeats the tilt filter's measurements on a row of O, from the rows of X so far.
    fn follow_own(&mut self, kalman: &Kalman, row: usize) {
        for (index, gain) in self.gains.iter().enumerate() {
            let Some(followed) = kalman.followed(index) else {
                return;
            };
            let mut column = [0.0; CORRELATED];
            for (entry, row) in column.iter_mut().zip(&self.covariance.cross) {
                *entry = row.get(followed.state).copied().unwrap_or(0.0);
            }
            self.covariance.subtract(row, *gain, &column);
        }
    }

    /// Adds to the covariance of the drift of yaw with the error states: P·Wᵀ.
    fn drift(&mut self, kalman: &Kalman, first: usize) -> Phase {
        let effects = self.closed.yaw.iter().enumerate();
        for (parameter, effect) in effects.skip(first).take(PARAMETERS) {
            let mut column = [0.0; ERROR_STATES];
            kalman.copy_column(FIRST_GYROSCOPE + parameter, &mut column);
            for (sum, entry) in self.column.iter_mut().zip(&column) {
                *sum += effect * entry;
            }
        }
        if first + PARAMETERS < GYROSCOPE {
            Phase::Drift(first + PARAMETERS)
        } else {
            Phase::Turn
        }
    }

    /// Computes the covariance of the drift of yaw with the field states: X·Wᵀ.
    fn project_drift(&mut self) -> Phase {
        self.own = [0.0; STATES];
        for (entry, row) in self.own.iter_mut().zip(&self.covariance.cross) {
            let parameters = row.iter().skip(FIRST_GYROSCOPE);
            *entry = dot(&self.closed.yaw, parameters);
        }
        Phase::Turned
    }

    /// Turns the field by the drift of yaw.
    fn turn_field(&mut self, kalman: &Kalman) -> Phase {
        let yaw = &self.closed.yaw;
        let [x, y, ..] = self.state;
        let (gx, gy) = (-y, x);
        let known = dot(yaw, self.column.iter().skip(FIRST_GYROSCOPE));
        let variance = known + self.yaw_noise_rad2(kalman);
        let own = self.own;
        let covariance = &mut self.covariance;
        let [wx, wy, rest @ ..] = own;
        covariance.add(0, 0, 2.0 * gx * wx + square(gx) * variance);
        covariance.add(1, 0, gy * wx + gx * wy + gx * gy * variance);
        covariance.add(1, 1, 2.0 * gy * wy + square(gy) * variance);
        for (row, entry) in rest.into_iter().enumerate() {
            covariance.add(row + 2, 0, gx * entry);
            covariance.add(row + 2, 1, gy * entry);
        }
        covariance.subtract_cross(0, -gx, &self.column);
        covariance.subtract_cross(1, -gy, &self.column);
        let turn_rad = dot(yaw, kalman.gyroscope_correction().iter());
        let [x, y, ..] = &mut self.state;
        *x += gx * turn_rad;
        *y += gy * turn_rad;
        Phase::Walk
    }

    /// Returns the variance of yaw that the interval adds beside the gyroscope's errors, rad².
    fn yaw_noise_rad2(&self, kalman: &Kalman) -> f32 {
        let interval = &self.closed;
        kalman.turn_noise_rad2(interval.duration_s, interval.squared_rate)
            + square(self.tuning.yaw_walk) * interval.duration_s
            + interval.unseen_rad2
    }

    /// Adds the process noise of field and hard iron, and updates how much the body moves.
    fn walk(&mut self, kalman: &Kalman) -> Phase {
        let tuning = self.tuning;
        let duration_s = self.closed.duration_s;
        let iron = square(tuning.hard_iron_walk) + tuning.excess_to_hard_iron * self.excess;
        for axis in 0..3 {
            let field = square(tuning.field_walk) * duration_s;
            self.covariance.add(FIELD + axis, FIELD + axis, field);
            self.covariance
                .add(IRON + axis, IRON + axis, iron * duration_s);
        }
        let motion = if kalman.is_still() {
            0.0
        } else {
            self.closed.motion(tuning)
        };
        let decay = (duration_s / tuning.moving_hold_s).min(1.0);
        self.motion = motion.max(self.motion * (1.0 - decay));
        Phase::Forget(DEVIATION)
    }

    /// Lets a state of the local deviation return to zero: a first-order Gauss-Markov process
    /// (Gelb, *Applied Optimal Estimation*, 1974, §3.8).
    fn forget(&mut self, state: usize) -> Phase {
        let tuning = self.tuning;
        let moving = if self.motion < tuning.least_motion {
            0.0
        } else {
            self.motion / tuning.deviation_moving_s
        };
        let decays = self.closed.duration_s * (1.0 / tuning.deviation_still_s + moving);
        let keep = 1.0 / (1.0 + decays);
        let variance = square(tuning.deviation_ut) + tuning.excess_to_deviation * self.excess;
        self.covariance.scale(state, keep);
        let added = variance * (1.0 - square(keep));
        self.covariance.add(state, state, added);
        if let Some(deviation) = self.state.get_mut(state) {
            *deviation *= keep;
        }
        if state + 1 < STATES {
            Phase::Forget(state + 1)
        } else if self.closed.has_readings() {
            self.expected = 0.0;
            Phase::Expect(0)
        } else {
            Phase::Finish
        }
    }
}

fn dot<'a>(left: &[f32], right: impl Iterator<Item = &'a f32>) -> f32 {
    left.iter().zip(right).map(|(a, b)| a * b).sum()
}
