//! Steps of the heading filter, in slices: one step after each covariance step of the tilt filter,
//! over the same interval.
//!
//! 1. *Repeat* the tilt filter's step on the cross-covariance (`kalman/heading_access.rs`).
//! 2. *Rotate* the field by the drift of yaw. The gyroscope's errors in ε turn the level frame by
//!    ψ·ε about down, so the field in it moves by (ψ·ε)·(−c_y, c_x, 0). The errors are
//!    constant over an interval. The step therefore uses those after the tilt filter's correction
//!    δ: it moves c by ψ·δ, and adds the remaining covariance of ε to that of c. The tilt
//!    filter corrects its attitude some samples after the interval. Until then the open interval
//!    has the old errors, so its ψ·δ moves c too: at the end of the step, after the measurement.
//! 3. *Forget* the local deviation, and add the process noise.
//! 4. *Measure*: three rows, each by `measurement.rs`.
//!
//! The [module](super) has a table of the symbols.

use super::Heading;
use super::covariance::{CORRELATED, CrossRow, DEVIATION, FIELD, IRON, STATES};
use crate::estimator::arithmetic::{larger, smaller, square};
use crate::estimator::kalman::Kalman;
use crate::estimator::kalman::heading_access::{
    ERROR_STATES, FIRST_GYROSCOPE, GYROSCOPE, MEASUREMENTS, TiltMeasurement, VELOCITY,
};
use crate::serialize::StateVisitor;

/// Rows of X that a slice propagates.
const ROWS: usize = 2;
/// Measurements of the tilt filter that a slice repeats on a row of O.
const OWN_MEASUREMENTS: usize = 2;

/// The next slice of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum FieldSlice {
    /// No step.
    Idle,
    /// Waits for the tilt filter to end its step.
    Waiting,
    /// X over the interval, from this row on.
    Propagate(u8),
    /// Means of the closed interval's readings. Then X by what the tilt filter resets and lets
    /// return to its prior.
    Relax,
    /// Repeats the tilt filter's measurements on a row of X. Index 0: gains, state, and the columns
    /// of the velocity. Index n > 0: the column of measurement n − 1, if it is of a parameter.
    RepeatOnCross(u8, u8),
    /// Repeats the tilt filter's measurements on a row of O, from this index on (from 0).
    RepeatOnOwn(u8, u8),
    /// P·ψᵀ: covariance of the drift of yaw with ε, from this pair of parameters on.
    Drift(u8),
    /// X·ψᵀ: covariance of the drift of yaw with f.
    ProjectDrift,
    /// Field and O by the drift of yaw.
    RotateField,
    /// X by the drift of yaw.
    RotateCross,
    /// Process noise of field and hard iron.
    Walk,
    /// A state of the local deviation.
    Forget(u8),
    /// Expected innovation of this axis.
    Expect(u8),
    /// The gate.
    Gate,
    /// The watch over lasting contradictions.
    Watch,
    /// J·hᵀ at f for this axis, but for the hard iron.
    Project(u8),
    /// J·hᵀ at f for this axis by the hard iron.
    ProjectIron(u8),
    /// J·hᵀ at ε for this axis, but for the tilt.
    ProjectCross(u8),
    /// The states by this axis.
    CorrectStates(u8),
    /// O and X by this axis, from this row on.
    Correct(u8, u8),
    /// The check of the numbers.
    Check,
    /// The result.
    Finish,
}

impl Heading {
    /// Runs a slice. Inlined into a loop, each call would compute the addresses of every slice.
    #[inline(never)]
    pub(super) fn slice(&mut self, kalman: &Kalman) {
        self.next_slice = match self.next_slice {
            FieldSlice::Idle => FieldSlice::Idle,
            FieldSlice::Waiting => FieldSlice::Waiting,
            FieldSlice::Propagate(row) => self.propagate(kalman, row),
            FieldSlice::Relax => self.relax(kalman),
            FieldSlice::RepeatOnCross(row, index) => self.repeat_on_cross_row(kalman, row, index),
            FieldSlice::RepeatOnOwn(row, index) => self.repeat_on_own_row(kalman, row, index),
            FieldSlice::Drift(parameter) => self.drift(kalman, parameter),
            FieldSlice::ProjectDrift => self.project_drift(),
            FieldSlice::RotateField => self.rotate_field(kalman),
            FieldSlice::RotateCross => self.rotate_cross(kalman),
            FieldSlice::Walk => self.walk(kalman),
            FieldSlice::Forget(state) => self.forget(state),
            FieldSlice::Expect(axis) => self.expect(kalman, axis),
            FieldSlice::Gate => self.gate(kalman),
            FieldSlice::Watch => self.watch(),
            FieldSlice::Project(axis) => self.project_own(axis),
            FieldSlice::ProjectIron(axis) => self.project_iron(axis),
            FieldSlice::ProjectCross(axis) => self.project_cross(axis),
            FieldSlice::CorrectStates(axis) => self.correct_states(kalman, axis),
            FieldSlice::Correct(axis, row) => self.correct_rows(axis, row),
            FieldSlice::Check => self.check(),
            FieldSlice::Finish => self.finish(kalman),
        };
    }

    fn propagate(&mut self, kalman: &Kalman, first: u8) -> FieldSlice {
        for row in self
            .covariance
            .cross
            .iter_mut()
            .skip(first.into())
            .take(ROWS)
        {
            kalman.propagate_row(row);
        }
        let next = first + ROWS as u8;
        if usize::from(next) < CORRELATED {
            FieldSlice::Propagate(next)
        } else {
            FieldSlice::Relax
        }
    }

    /// Averages the readings of the closed interval. Then repeats on X what the tilt filter has
    /// reset, or has let return to its prior.
    fn relax(&mut self, kalman: &Kalman) -> FieldSlice {
        let yaw = &self.intervals.open(self.open).yaw;
        self.late_turn_rad = dot(yaw, kalman.gyroscope_correction());
        self.intervals.closed_mut(self.open).average_readings();
        let (relaxed, factor) = kalman.relaxed();
        self.covariance.scale_cross(relaxed, factor);
        if kalman.is_velocity_reset() {
            for state in VELOCITY {
                self.covariance.scale_cross(state, 0.0);
            }
        }
        if kalman.has_lost_digits() {
            // The field keeps the variance that the measurement would have taken from it.
            self.covariance.forget_cross();
        }
        FieldSlice::RepeatOnCross(0, 0)
    }

    /// Repeats the tilt filter's measurements on a row of X, one slice per index.
    ///
    /// - Index 0: the gains of all measurements, the state, and the velocity's columns of this row.
    /// - Index n > 0: the column of measurement n − 1. The first that is of no parameter ends the
    ///   row. Therefore the queue must hold parameters first, then the velocity
    ///   (`Kalman::measure`); in another order X would lose the columns of the bias.
    ///
    /// A row needs its own p_i from before the step, and X·e_i of the rows above from after it.
    fn repeat_on_cross_row(&mut self, kalman: &Kalman, row: u8, index: u8) -> FieldSlice {
        let place = usize::from(row);
        let Some(entries) = self.covariance.cross.get_mut(place) else {
            // `drift` adds to it.
            self.cross_scratch = [0.0; ERROR_STATES];
            return FieldSlice::Drift(0);
        };
        let Some(number) = usize::from(index).checked_sub(1) else {
            let mut change = 0.0;
            let mut velocity = [0.0; 2];
            for (number, gain) in self.own_scratch.iter_mut().enumerate().take(MEASUREMENTS) {
                let Some(measurement) = kalman.last_step_measurement(number) else {
                    break;
                };
                let p = entries.get(measurement.state).copied().unwrap_or(0.0);
                *gain = p * measurement.weight;
                change += *gain * measurement.residual;
                let velocity_axis = measurement.state.wrapping_sub(VELOCITY.start);
                if let Some(factor) = velocity.get_mut(velocity_axis) {
                    *factor = -*gain;
                }
            }
            kalman.add_velocity_columns(velocity, entries);
            if let Some(state) = self.state.get_mut(place) {
                *state += change;
            }
            return FieldSlice::RepeatOnCross(row, 1);
        };
        let parameter = kalman
            .last_step_measurement(number)
            .and_then(TiltMeasurement::parameter);
        let gain = self.own_scratch.get(number).copied().unwrap_or(0.0);
        match parameter {
            Some(parameter) => kalman.add_parameter_column(parameter, -gain, entries),
            None => return FieldSlice::RepeatOnOwn(row, 0),
        }
        FieldSlice::RepeatOnCross(row, index + 1)
    }

    /// Repeats the tilt filter's measurements on a row of O, from the rows of X so far.
    fn repeat_on_own_row(&mut self, kalman: &Kalman, row: u8, first: u8) -> FieldSlice {
        let start = usize::from(first);
        for index in start..start + OWN_MEASUREMENTS {
            let (Some(measurement), Some(gain)) = (
                kalman.last_step_measurement(index),
                self.own_scratch.get(index),
            ) else {
                return FieldSlice::RepeatOnCross(row + 1, 0);
            };
            let mut column = [0.0; CORRELATED];
            for (entry, row) in column.iter_mut().zip(&self.covariance.cross) {
                *entry = row.get(measurement.state).copied().unwrap_or(0.0);
            }
            self.covariance.subtract(row.into(), *gain, &column);
        }
        let next = first + OWN_MEASUREMENTS as u8;
        if kalman.last_step_measurement(next.into()).is_some() {
            FieldSlice::RepeatOnOwn(row, next)
        } else {
            FieldSlice::RepeatOnCross(row + 1, 0)
        }
    }

    /// Adds to the covariance of the drift of yaw with the error states: P·ψᵀ.
    fn drift(&mut self, kalman: &Kalman, part: u8) -> FieldSlice {
        let yaw = &self.intervals.closed(self.open).yaw;
        let is_more = kalman.add_product(part.into(), yaw, &mut self.cross_scratch);
        if is_more {
            FieldSlice::Drift(part + 1)
        } else {
            FieldSlice::ProjectDrift
        }
    }

    /// Computes the covariance of the drift of yaw with the field states: X·ψᵀ.
    fn project_drift(&mut self) -> FieldSlice {
        let yaw = &self.intervals.closed(self.open).yaw;
        for (entry, row) in self.own_scratch.iter_mut().zip(&self.covariance.cross) {
            *entry = dot(yaw, gyroscope(row));
        }
        FieldSlice::RotateField
    }

    /// Rotates the field by the drift of yaw, and O with it.
    fn rotate_field(&mut self, kalman: &Kalman) -> FieldSlice {
        let known = dot(&self.closed().yaw, gyroscope(&self.cross_scratch));
        let variance = known + self.yaw_noise_rad2(kalman);
        let [x, y, ..] = self.state;
        let (gx, gy) = (-y, x);
        // X·ψᵀ.
        let [drift_x, drift_y, rest @ ..] = self.own_scratch;
        let covariance = &mut self.covariance;
        covariance.add(0, 0, 2.0 * gx * drift_x + square(gx) * variance);
        covariance.add(1, 0, gy * drift_x + gx * drift_y + gx * gy * variance);
        covariance.add(1, 1, 2.0 * gy * drift_y + square(gy) * variance);
        for (row, entry) in rest.into_iter().enumerate().take(CORRELATED - 2) {
            covariance.add(row + 2, 0, gx * entry);
            covariance.add(row + 2, 1, gy * entry);
        }
        FieldSlice::RotateCross
    }

    /// Rotates X by the drift of yaw.
    fn rotate_cross(&mut self, kalman: &Kalman) -> FieldSlice {
        let closed = self.closed();
        let corrected_rad = dot(&closed.yaw, kalman.gyroscope_correction());
        let drift_rad = self.drift_rad_s * closed.duration_s;
        let turn_rad = corrected_rad + drift_rad;
        if kalman.is_still() && corrected_rad * drift_rad > 0.0 {
            // A rest has found the offset, or a part of it: the level frame turns less from now on.
            let left = larger(1.0 - corrected_rad / drift_rad, 0.0);
            self.drift_rad_s *= left;
        }
        let [x, y, ..] = self.state;
        self.covariance.subtract_cross(0, y, &self.cross_scratch);
        self.covariance.subtract_cross(1, -x, &self.cross_scratch);
        self.turn_field(turn_rad);
        FieldSlice::Walk
    }

    /// Turns the field about down.
    #[inline(never)]
    pub(super) fn turn_field(&mut self, turn_rad: f32) {
        let [x, y, ..] = &mut self.state;
        let (gx, gy) = (-*y, *x);
        *x += gx * turn_rad;
        *y += gy * turn_rad;
    }

    /// Returns the variance of yaw that the interval adds beside the gyroscope's errors, rad².
    fn yaw_noise_rad2(&self, kalman: &Kalman) -> f32 {
        let interval = self.closed();
        kalman.turn_noise_rad2(interval.duration_s, interval.squared_rate)
            + square(self.tuning.yaw_walk) * interval.duration_s
            + interval.unseen_rad2
    }

    /// Adds the process noise of field and hard iron, and updates how much the body moves.
    fn walk(&mut self, kalman: &Kalman) -> FieldSlice {
        let tuning = self.tuning;
        let duration_s = self.closed().duration_s;
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
            self.closed().motion(tuning)
        };
        self.since_first_s += duration_s;
        let decay = share(duration_s, tuning.moving_hold_s);
        self.motion = larger(motion, self.motion * (1.0 - decay));
        FieldSlice::Forget(DEVIATION as u8)
    }

    /// Lets a state of the local deviation return to zero: a first-order Gauss-Markov process
    /// (Gelb, *Applied Optimal Estimation*, 1974, §3.8).
    ///
    /// It keeps 1/(1 + T/τ) over a step of length T, which is cheaper than exp(−T/τ) and
    /// forgets less: with steps of 0.22 s the memory in full motion is 0.29 s, and τ 0.2 s.
    fn forget(&mut self, state: u8) -> FieldSlice {
        let tuning = self.tuning;
        let moving = if self.motion < tuning.least_motion {
            0.0
        } else {
            self.motion / tuning.deviation_moving_s
        };
        let duration_s = self.closed().duration_s;
        let decays = duration_s * (1.0 / tuning.deviation_still_s + moving);
        let keep = 1.0 / (1.0 + decays);
        let variance = square(tuning.deviation_ut) + tuning.excess_to_deviation * self.excess;
        let place = usize::from(state);
        self.covariance.scale(place, keep);
        let added = variance * (1.0 - square(keep));
        self.covariance.add(place, place, added);
        if let Some(deviation) = self.state.get_mut(place) {
            *deviation *= keep;
        }
        if place + 1 < STATES {
            return FieldSlice::Forget(state + 1);
        }
        // The excess ends in a silence too.
        self.excess *= 1.0 - share(duration_s, tuning.excess_s);
        if self.closed().has_readings() {
            self.expected_ut2 = 0.0;
            FieldSlice::Expect(0)
        } else {
            FieldSlice::Check
        }
    }
}

/// Returns the share that a duration has of a time constant, at most 1.
#[inline(never)]
pub(super) fn share(duration_s: f32, time_s: f32) -> f32 {
    smaller(duration_s / time_s, 1.0)
}

/// Returns the entries of the gyroscope's parameters.
#[inline]
fn gyroscope(row: &CrossRow) -> &[f32] {
    row.get(FIRST_GYROSCOPE..FIRST_GYROSCOPE + GYROSCOPE)
        .unwrap_or(&[])
}

#[inline(never)]
fn dot(left: &[f32; GYROSCOPE], right: &[f32]) -> f32 {
    left.iter().zip(right).map(|(a, b)| a * b).sum()
}

impl FieldSlice {
    /// Visits the slice.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let (mut kind, first, second) = match *self {
            Self::Idle => (0, 0, 0),
            Self::Waiting => (1, 0, 0),
            Self::Propagate(row) => (2, row, 0),
            Self::Relax => (3, 0, 0),
            Self::RepeatOnCross(row, index) => (4, row, index),
            Self::RepeatOnOwn(row, index) => (5, row, index),
            Self::Drift(part) => (6, part, 0),
            Self::ProjectDrift => (7, 0, 0),
            Self::RotateField => (8, 0, 0),
            Self::RotateCross => (9, 0, 0),
            Self::Walk => (10, 0, 0),
            Self::Forget(state) => (11, state, 0),
            Self::Expect(axis) => (12, axis, 0),
            Self::Gate => (13, 0, 0),
            Self::Watch => (14, 0, 0),
            Self::Project(axis) => (15, axis, 0),
            Self::ProjectIron(axis) => (16, axis, 0),
            Self::ProjectCross(axis) => (17, axis, 0),
            Self::CorrectStates(axis) => (18, axis, 0),
            Self::Correct(axis, row) => (19, axis, row),
            Self::Check => (20, 0, 0),
            Self::Finish => (21, 0, 0),
        };
        // A place out of range does no harm: each slice checks it.
        let (mut place, mut other) = (usize::from(first), usize::from(second));
        visitor.index(&mut kind, 22);
        visitor.index(&mut place, ERROR_STATES);
        visitor.index(&mut other, ERROR_STATES);
        let (first, second) = (place as u8, other as u8);
        *self = match kind {
            1 => Self::Waiting,
            2 => Self::Propagate(first),
            3 => Self::Relax,
            4 => Self::RepeatOnCross(first, second),
            5 => Self::RepeatOnOwn(first, second),
            6 => Self::Drift(first),
            7 => Self::ProjectDrift,
            8 => Self::RotateField,
            9 => Self::RotateCross,
            10 => Self::Walk,
            11 => Self::Forget(first),
            12 => Self::Expect(first),
            13 => Self::Gate,
            14 => Self::Watch,
            15 => Self::Project(first),
            16 => Self::ProjectIron(first),
            17 => Self::ProjectCross(first),
            18 => Self::CorrectStates(first),
            19 => Self::Correct(first, second),
            20 => Self::Check,
            21 => Self::Finish,
            _ => Self::Idle,
        };
    }
}
