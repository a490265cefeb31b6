//! The covariance step, in slices: so little at a time that no sample waits for it.
//!
//! A step covers an interval in which the mean has been integrated and its [`Transition`] summed up.
//! It predicts the covariance over that interval, P ← F·P·Fᵀ + Q, and then takes scalar
//! measurements z = x_i + noise one after the other (Bierman, *Factorization Methods for Discrete
//! Sequential Estimation*, 1977, ch. II):
//!
//! ```text
//! h = P·e_i    s = h_i + r    δ ← δ + h·(z − x_i − δ_i)/s    P ← P − h·hᵀ/s
//! ```
//!
//! δ, the correction, is about the interval's end, which is some samples ago when the last slice is
//! done; whoever applies it carries it forward.

use super::matrix::{CONSTANTS, Column, Covariance, MOVING, Transition};
use crate::state::Exchange;

/// No step has more measurements: two of the velocity, three of the gyroscope's bias.
const MOST_MEASUREMENTS: usize = 5;

const LAST_ROW: usize = CONSTANTS - 1;

/// What comes next.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Phase {
    /// Nothing.
    Idle,
    /// F·P·Fᵀ: X by A.
    Carry,
    /// C into X, from this row of C on.
    Mix(usize),
    /// X into M.
    Close,
    /// Time for measurements.
    Predicted,
    /// This measurement: its column, its gain, its correction.
    Measure(usize),
    /// P by this measurement, from this row on.
    Reduce(usize, usize),
    /// Is the result sound?
    Check,
    /// Everything is done.
    Done,
}

/// What a slice did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Progress {
    /// Nothing: no step is under way.
    Idle,
    /// A part of the work.
    Working,
    /// The covariance is predicted to the interval's end: the measurements may come.
    Predicted,
    /// The correction is complete, and the step with it.
    Corrected,
    /// The same, but the numbers make no sense.
    Unsound,
}

/// A measured state and what was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Measurement {
    /// Which state.
    pub(super) state: State,
    /// Measured minus predicted, before any correction of this step.
    pub(super) innovation: f32,
    /// The measurement's variance.
    pub(super) variance: f32,
}

/// A state that can be measured.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum State {
    /// Moving state of this index.
    Moving(usize),
    /// Constant of this index.
    Constant(usize),
}

/// The covariance, and the step that is under way.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Step {
    pub(super) covariance: Covariance,
    /// δ.
    pub(super) correction: Column,
    phase: Phase,
    transition: Transition,
    duration_s: f32,
    measurements: [Option<Measurement>; MOST_MEASUREMENTS],
    /// h of the measurement under way.
    column: Column,
    /// 1/s of the same.
    inverse: f32,
}

impl Measurement {
    fn exchange(&mut self, state: &mut impl Exchange) {
        let (mut is_constant, mut index) = match self.state {
            State::Moving(index) => (false, index),
            State::Constant(index) => (true, index),
        };
        state.truth(&mut is_constant);
        state.index(&mut index, if is_constant { CONSTANTS } else { MOVING });
        self.state = if is_constant {
            State::Constant(index)
        } else {
            State::Moving(index)
        };
        state.number(&mut self.innovation);
        state.number(&mut self.variance);
    }
}

impl Phase {
    fn exchange(&mut self, state: &mut impl Exchange) {
        let (mut kind, mut first, mut second) = match *self {
            Self::Idle => (0, 0, 0),
            Self::Carry => (1, 0, 0),
            Self::Mix(row) => (2, row, 0),
            Self::Close => (3, 0, 0),
            Self::Predicted => (4, 0, 0),
            Self::Measure(index) => (5, index, 0),
            Self::Reduce(index, row) => (6, index, row),
            Self::Check => (7, 0, 0),
            Self::Done => (8, 0, 0),
        };
        state.index(&mut kind, 9);
        // Both are compared with what they count before they are used.
        state.index(&mut first, CONSTANTS + 1);
        state.index(&mut second, CONSTANTS + 1);
        *self = match kind {
            1 => Self::Carry,
            2 => Self::Mix(first),
            3 => Self::Close,
            4 => Self::Predicted,
            5 => Self::Measure(first),
            6 => Self::Reduce(first, second),
            7 => Self::Check,
            8 => Self::Done,
            _ => Self::Idle,
        };
    }
}

impl Step {
    pub(super) fn exchange(&mut self, state: &mut impl Exchange) {
        self.covariance.exchange(state);
        self.correction.exchange(state);
        self.phase.exchange(state);
        self.transition.exchange(state);
        state.number(&mut self.duration_s);
        for measurement in &mut self.measurements {
            state.optional(
                measurement,
                Measurement {
                    state: State::Moving(0),
                    innovation: 0.0,
                    variance: 0.0,
                },
                |state, measurement| measurement.exchange(state),
            );
        }
        self.column.exchange(state);
        state.number(&mut self.inverse);
    }

    pub(super) const fn new() -> Self {
        Self {
            covariance: Covariance::ZERO,
            correction: Column::ZERO,
            phase: Phase::Idle,
            transition: Transition::NONE,
            duration_s: 0.0,
            measurements: [None; MOST_MEASUREMENTS],
            column: Column::ZERO,
            inverse: 0.0,
        }
    }

    /// How long the interval is, s.
    pub(super) fn duration_s(&self) -> f32 {
        self.duration_s
    }

    /// Drops what is left of a step.
    pub(super) fn abandon(&mut self) {
        self.phase = Phase::Idle;
    }

    /// Begins a step over an interval that added these variances to tilt and velocity.
    pub(super) fn begin(&mut self, transition: &Transition, noise: [f32; 2], duration_s: f32) {
        let [tilt, velocity] = noise;
        self.duration_s = duration_s;
        self.transition = *transition;
        self.correction = Column::ZERO;
        self.measurements = [None; MOST_MEASUREMENTS];
        self.covariance.carry_moving(transition);
        for (state, variance) in [tilt, tilt, velocity, velocity].into_iter().enumerate() {
            self.covariance.add_to_moving(state, variance);
        }
        self.phase = Phase::Carry;
    }

    /// Adds a measurement at the end of the interval; one too many is ignored.
    #[inline(never)]
    pub(super) fn measure(&mut self, measurement: Measurement) {
        if let Some(free) = self.measurements.iter_mut().find(|place| place.is_none()) {
            *free = Some(measurement);
        }
    }

    /// Does one slice.
    pub(super) fn slice(&mut self) -> Progress {
        match self.phase {
            Phase::Idle => return Progress::Idle,
            Phase::Carry => {
                for row in 0..CONSTANTS {
                    self.covariance.carry_cross(row, &self.transition);
                }
                self.phase = Phase::Mix(0);
            }
            Phase::Mix(row) => {
                // A short row of the triangle with a long one, so that all slices are alike.
                self.covariance.mix(row, &self.transition);
                self.phase = if row < LAST_ROW / 2 {
                    self.covariance.mix(LAST_ROW - row, &self.transition);
                    Phase::Mix(row + 1)
                } else {
                    Phase::Close
                };
            }
            Phase::Close => {
                self.covariance.close(&self.transition);
                self.phase = Phase::Predicted;
            }
            Phase::Predicted => {
                self.phase = Phase::Measure(0);
                return Progress::Predicted;
            }
            Phase::Measure(index) => {
                self.phase = self.take(index);
            }
            Phase::Reduce(index, row) => {
                self.reduce_pair(row);
                self.reduce_pair(row + 1);
                self.phase = if row + 2 <= LAST_ROW / 2 {
                    Phase::Reduce(index, row + 2)
                } else {
                    Phase::Measure(index + 1)
                };
            }
            Phase::Check => {
                if !(self.covariance.is_sound() && self.correction.is_sound()) {
                    self.phase = Phase::Idle;
                    return Progress::Unsound;
                }
                self.phase = Phase::Done;
            }
            Phase::Done => {
                self.phase = Phase::Idle;
                return Progress::Corrected;
            }
        }
        Progress::Working
    }

    /// Reduces a short row with a long one; the one in the middle alone.
    fn reduce_pair(&mut self, row: usize) {
        self.covariance.reduce(row, &self.column, self.inverse);
        if row < LAST_ROW - row {
            let other = LAST_ROW - row;
            self.covariance.reduce(other, &self.column, self.inverse);
        }
    }

    fn take(&mut self, index: usize) -> Phase {
        let Some(Some(measurement)) = self.measurements.get(index) else {
            return Phase::Check;
        };
        let (column, own, corrected) = match measurement.state {
            State::Moving(state) => {
                let column = self.covariance.moving_column(state);
                let own = column.moving.get(state).copied();
                (column, own, self.correction.moving.get(state).copied())
            }
            State::Constant(constant) => {
                let column = self.covariance.constant_column(constant);
                let own = column.constants.get(constant).copied();
                (
                    column,
                    own,
                    self.correction.constants.get(constant).copied(),
                )
            }
        };
        let (Some(own), Some(corrected)) = (own, corrected) else {
            return Phase::Check;
        };
        self.inverse = 1.0 / (own + measurement.variance);
        let gain = (measurement.innovation - corrected) * self.inverse;
        for (correction, entry) in self.correction.moving.iter_mut().zip(&column.moving) {
            *correction += gain * entry;
        }
        for (correction, entry) in self.correction.constants.iter_mut().zip(&column.constants) {
            *correction += gain * entry;
        }
        self.covariance.reduce_moving(&column, self.inverse);
        self.column = column;
        Phase::Reduce(index, 0)
    }
}
