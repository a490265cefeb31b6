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

/// No step has more measurements: two of the velocity, three of the gyroscope's bias.
const MOST_MEASUREMENTS: usize = 5;

/// Rows of X that make one slice where a row costs little.
const ROWS_PER_SLICE: usize = 5;
const LAST_ROW: usize = CONSTANTS - 1;

/// What comes next.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Phase {
    /// Nothing.
    Idle,
    /// F·P·Fᵀ, from this row of X on: by A.
    Carry(usize),
    /// From this row of C on: into X.
    Mix(usize),
    /// X into M.
    Close,
    /// This measurement: its column, its gain, its correction.
    Measure(usize),
    /// P by this measurement, from this row on.
    Reduce(usize, usize),
    /// The correction is ready.
    Correct,
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
    measurements: [Option<Measurement>; MOST_MEASUREMENTS],
    /// h of the measurement under way.
    column: Column,
    /// 1/s of the same.
    inverse: f32,
}

impl Step {
    pub(super) const fn new() -> Self {
        Self {
            covariance: Covariance::ZERO,
            correction: Column::ZERO,
            phase: Phase::Idle,
            transition: Transition::NONE,
            measurements: [None; MOST_MEASUREMENTS],
            column: Column::ZERO,
            inverse: 0.0,
        }
    }

    pub(super) fn is_idle(&self) -> bool {
        self.phase == Phase::Idle
    }

    /// Drops what is left of a step.
    pub(super) fn abandon(&mut self) {
        self.phase = Phase::Idle;
    }

    /// Begins a step over an interval that added these variances to tilt and velocity.
    pub(super) fn begin(&mut self, transition: &Transition, noise: [f32; 2]) {
        let [tilt, velocity] = noise;
        self.transition = *transition;
        self.correction = Column::ZERO;
        self.measurements = [None; MOST_MEASUREMENTS];
        self.covariance.carry_moving(transition);
        for (state, variance) in [tilt, tilt, velocity, velocity].into_iter().enumerate() {
            self.covariance.add_to_moving(state, variance);
        }
        self.phase = Phase::Carry(0);
    }

    /// Adds a measurement at the end of the interval; one too many is ignored.
    pub(super) fn measure(&mut self, measurement: Measurement) {
        if let Some(free) = self.measurements.iter_mut().find(|place| place.is_none()) {
            *free = Some(measurement);
        }
    }

    /// Does one slice; true when that completed the step.
    pub(super) fn slice(&mut self) -> bool {
        self.phase = match self.phase {
            Phase::Idle => Phase::Idle,
            Phase::Carry(row) => {
                let end = row + ROWS_PER_SLICE;
                for row in row..end {
                    self.covariance.carry_cross(row, &self.transition);
                }
                if end > LAST_ROW {
                    Phase::Mix(0)
                } else {
                    Phase::Carry(end)
                }
            }
            Phase::Mix(row) => {
                // A short row of the triangle with a long one, so that all slices are alike.
                self.covariance.mix(row, &self.transition);
                if row < LAST_ROW / 2 {
                    self.covariance.mix(LAST_ROW - row, &self.transition);
                    Phase::Mix(row + 1)
                } else {
                    Phase::Close
                }
            }
            Phase::Close => {
                self.covariance.close(&self.transition);
                Phase::Measure(0)
            }
            Phase::Measure(index) => self.take(index),
            Phase::Reduce(index, row) => {
                self.covariance.reduce(row, &self.column, self.inverse);
                if row < LAST_ROW / 2 {
                    let other = LAST_ROW - row;
                    self.covariance.reduce(other, &self.column, self.inverse);
                    Phase::Reduce(index, row + 1)
                } else {
                    Phase::Measure(index + 1)
                }
            }
            Phase::Correct => Phase::Idle,
        };
        if self.phase == Phase::Correct {
            self.phase = Phase::Idle;
            return true;
        }
        false
    }

    fn take(&mut self, index: usize) -> Phase {
        let Some(Some(measurement)) = self.measurements.get(index) else {
            return Phase::Correct;
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
            return Phase::Correct;
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

const _: () = assert!(CONSTANTS % ROWS_PER_SLICE == 0 && MOVING == 4);
