//! Covariance step in slices, so that no sample takes the time of a whole step.
//!
//! A step covers an interval through which the nominal state has been integrated and whose
//! [`Transition`] is known. The step propagates the covariance over the interval,
//! P ← F·P·Fᵀ + Q. It then applies scalar measurements z = x_i + noise in sequence (Bierman,
//! *Factorization Methods for Discrete Sequential Estimation*, 1977, ch. II):
//!
//! ```text
//! h = P·e_i    s = h_i + r    δ ← δ + h·(z − x_i − δ_i)/s    P ← P − h·hᵀ/s
//! ```
//!
//! The correction δ belongs to the interval's end, some samples before the last slice. The caller
//! propagates it to the present.

use super::covariance::{Column, Covariance};
use super::propagation::{
    DYNAMIC, PARAMETERS, State, TILT_EAST, TILT_NORTH, Transition, VELOCITY_EAST, VELOCITY_NORTH,
};
use crate::serialize::StateVisitor;

/// Most measurements of a step: two of the velocity, three of the gyroscope's bias.
pub(super) const MOST_MEASUREMENTS: usize = 5;

const LAST_ROW: usize = PARAMETERS - 1;

/// Rows of the block P_pd in a slice.
const CROSS_ROWS: usize = 8;

/// The next slice.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum CovarianceSlice {
    /// No step is under way.
    Idle,
    /// F·P·Fᵀ: the block P_pd by A, from this row on.
    PropagateCross(usize),
    /// F·P·Fᵀ: the block P_pp into P_pd, from this row of P_pp on.
    PropagateParameters(usize),
    /// F·P·Fᵀ: the block P_pd into P_dd.
    CompleteDynamic,
    /// The caller checks corrections and rest, and lets a parameter return towards its prior.
    Prepare,
    /// The caller adds the measurements.
    Measure,
    /// Column, gain and correction of this measurement.
    Correct(usize),
    /// P by this measurement, from this row on.
    CorrectRows(usize, usize),
    /// The check of the result.
    Check,
    /// The correction is due.
    Done,
}

/// Result of a slice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Progress {
    /// No step is under way.
    Idle,
    /// A part of the step is done.
    Working,
    /// The covariance is propagated to the interval's end.
    Propagated,
    /// The work before the measurements is due: checks of corrections and rest, and the return of a
    /// parameter towards its prior.
    PreparationDue,
    /// The measurements are due.
    MeasurementsDue,
    /// The covariance is complete, and its numbers are usable.
    Checked,
    /// The step and its correction are complete.
    Corrected,
    /// The step is complete, and its numbers are unusable.
    Unsound,
}

/// A scalar measurement of one state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Measurement {
    /// The measured state.
    pub(super) state: State,
    /// Measured minus predicted value, before any correction of this step.
    pub(super) innovation: f32,
    /// The measurement's variance.
    pub(super) variance: f32,
}

/// Covariance, and the step in progress.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct CovarianceStep {
    pub(super) covariance: Covariance,
    /// The correction δ of the error state.
    pub(super) correction: Column,
    next_slice: CovarianceSlice,
    transition: Transition,
    duration_s: f32,
    measurements: [Measurement; MOST_MEASUREMENTS],
    /// Number of measurements of this step.
    measured: usize,
    /// h of the measurement being applied.
    column: Column,
    /// 1/s of the measurement being applied.
    inverse: f32,
}

impl CovarianceStep {
    /// Creates a zero covariance without a step.
    pub(super) const fn new() -> Self {
        Self {
            covariance: Covariance::ZERO,
            correction: Column::ZERO,
            next_slice: CovarianceSlice::Idle,
            transition: Transition::IDENTITY,
            duration_s: 0.0,
            measurements: [Measurement::BLANK; MOST_MEASUREMENTS],
            measured: 0,
            column: Column::ZERO,
            inverse: 0.0,
        }
    }

    /// Returns the length of the interval, s.
    pub(super) fn duration_s(&self) -> f32 {
        self.duration_s
    }

    /// Returns the transition of the interval.
    pub(super) fn transition(&self) -> &Transition {
        &self.transition
    }

    /// Returns a measurement of the step.
    pub(super) fn measurement(&self, index: usize) -> Option<Measurement> {
        self.measurements.get(..self.measured)?.get(index).copied()
    }

    /// Returns the number of measurements of the step.
    pub(super) fn measured(&self) -> usize {
        self.measured
    }

    /// Returns whether the measurements from this index on are those of parameters, then those of
    /// the velocity.
    pub(super) fn are_parameters_first(&self, index: usize) -> bool {
        let queued = self.measurements.get(index..self.measured).unwrap_or(&[]);
        queued.is_sorted_by_key(|measurement| matches!(measurement.state, State::Dynamic(_)))
    }

    /// Returns the last measurement of the step.
    pub(super) fn last_measurement(&self) -> Option<Measurement> {
        self.measurements.get(..self.measured)?.last().copied()
    }

    /// Returns whether a step has begun and not ended: the covariance is then not that of the
    /// nominal state.
    #[inline]
    pub(super) fn is_under_way(&self) -> bool {
        self.next_slice != CovarianceSlice::Idle
    }

    /// Returns the tilt variance, both axes together, rad².
    #[inline]
    pub(super) fn tilt_variance_rad2(&self) -> f32 {
        self.covariance.tilt_variance()
    }

    /// Drops the rest of the step. Completes the measurement that is being applied first, because
    /// half of one can make the covariance indefinite: at most eight pairs of rows.
    pub(super) fn abandon(&mut self) {
        if let CovarianceSlice::CorrectRows(_, row) = self.next_slice {
            for row in row..LAST_ROW / 2 + 1 {
                self.correct_row_pair(row);
            }
        }
        self.next_slice = CovarianceSlice::Idle;
    }

    /// Begins a step over an interval that adds these variances to each axis of tilt (rad²) and
    /// velocity ((m/s)²).
    pub(super) fn begin(
        &mut self,
        transition: &Transition,
        tilt_noise: f32,
        velocity_noise: f32,
        duration_s: f32,
    ) {
        self.duration_s = duration_s;
        self.transition = *transition;
        self.correction = Column::ZERO;
        self.measured = 0;
        self.covariance.propagate_dynamic(transition);
        self.covariance.add_to_dynamic(TILT_NORTH, tilt_noise);
        self.covariance.add_to_dynamic(TILT_EAST, tilt_noise);
        self.covariance
            .add_to_dynamic(VELOCITY_NORTH, velocity_noise);
        self.covariance
            .add_to_dynamic(VELOCITY_EAST, velocity_noise);
        self.next_slice = CovarianceSlice::PropagateCross(0);
    }

    /// Queues a measurement at the interval's end. Ignores more than [`MOST_MEASUREMENTS`]. The
    /// heading filter needs those of parameters before those of the velocity.
    pub(super) fn queue_measurement(&mut self, measurement: Measurement) {
        if let Some(free) = self.measurements.get_mut(self.measured) {
            *free = measurement;
            self.measured += 1;
        }
    }

    /// Runs one slice.
    pub(super) fn slice(&mut self) -> Progress {
        match self.next_slice {
            CovarianceSlice::Idle => return Progress::Idle,
            CovarianceSlice::PropagateCross(row) => {
                let end = row + CROSS_ROWS;
                for row in row..end {
                    self.covariance.propagate_cross(row, &self.transition);
                }
                self.next_slice = if end < PARAMETERS {
                    CovarianceSlice::PropagateCross(end)
                } else {
                    CovarianceSlice::PropagateParameters(0)
                };
            }
            CovarianceSlice::PropagateParameters(row) => {
                // A short row of the triangle is paired with a long one, so that all slices take
                // the same time.
                self.covariance.propagate_parameters(row, &self.transition);
                self.next_slice = if row < LAST_ROW / 2 {
                    self.covariance
                        .propagate_parameters(LAST_ROW - row, &self.transition);
                    CovarianceSlice::PropagateParameters(row + 1)
                } else {
                    CovarianceSlice::CompleteDynamic
                };
            }
            CovarianceSlice::CompleteDynamic => {
                self.covariance.complete_dynamic(&self.transition);
                self.next_slice = CovarianceSlice::Prepare;
                return Progress::Propagated;
            }
            CovarianceSlice::Prepare => {
                self.next_slice = CovarianceSlice::Measure;
                return Progress::PreparationDue;
            }
            CovarianceSlice::Measure => {
                self.next_slice = CovarianceSlice::Correct(0);
                return Progress::MeasurementsDue;
            }
            CovarianceSlice::Correct(index) => self.next_slice = self.apply_measurement(index),
            CovarianceSlice::CorrectRows(index, row) => {
                self.correct_row_pair(row);
                self.correct_row_pair(row + 1);
                self.next_slice = if row + 2 <= LAST_ROW / 2 {
                    CovarianceSlice::CorrectRows(index, row + 2)
                } else {
                    CovarianceSlice::Correct(index + 1)
                };
            }
            CovarianceSlice::Check => {
                if !(self.covariance.is_sound() && self.correction.is_sound()) {
                    self.next_slice = CovarianceSlice::Idle;
                    return Progress::Unsound;
                }
                self.next_slice = CovarianceSlice::Done;
                return Progress::Checked;
            }
            CovarianceSlice::Done => {
                self.next_slice = CovarianceSlice::Idle;
                return Progress::Corrected;
            }
        }
        Progress::Working
    }

    /// Corrects a short row and a long one, or the middle row alone.
    fn correct_row_pair(&mut self, row: usize) {
        self.covariance
            .correct_parameter(row, &self.column, self.inverse);
        if row < LAST_ROW - row {
            self.covariance
                .correct_parameter(LAST_ROW - row, &self.column, self.inverse);
        }
    }

    /// Applies the measurement of this index to δ and P_dd. Returns the next slice.
    #[inline(never)]
    fn apply_measurement(&mut self, index: usize) -> CovarianceSlice {
        let Some(measurement) = self.measurement(index) else {
            return CovarianceSlice::Check;
        };
        let state = measurement.state;
        let column = &mut self.column;
        match state {
            State::Dynamic(state) => self.covariance.dynamic_column(state, column),
            State::Parameter(parameter) => self.covariance.parameter_column(parameter, column),
        }
        let (Some(own), Some(corrected)) = (column.entry(state), self.correction.entry(state))
        else {
            return CovarianceSlice::Check;
        };
        self.inverse = 1.0 / (own + measurement.variance);
        let gain = (measurement.innovation - corrected) * self.inverse;
        self.correction.add(column, gain);
        self.covariance.correct_dynamic(column, self.inverse);
        CovarianceSlice::CorrectRows(index, 0)
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            covariance,
            correction,
            next_slice,
            transition,
            duration_s,
            measurements,
            measured,
            column,
            inverse,
        } = self;
        covariance.visit_state(visitor);
        correction.visit_state(visitor);
        next_slice.visit_state(visitor);
        transition.visit_state(visitor);
        visitor.f32(duration_s);
        for measurement in measurements {
            measurement.visit_state(visitor);
        }
        visitor.index(measured, MOST_MEASUREMENTS + 1);
        column.visit_state(visitor);
        visitor.f32(inverse);
    }
}

impl Measurement {
    const BLANK: Self = Self {
        state: State::Dynamic(TILT_NORTH),
        innovation: 0.0,
        variance: 0.0,
    };

    fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            state,
            innovation,
            variance,
        } = self;
        let (mut is_parameter, mut index) = match *state {
            State::Dynamic(index) => (false, index),
            State::Parameter(index) => (true, index),
        };
        visitor.bool(&mut is_parameter);
        visitor.index(&mut index, if is_parameter { PARAMETERS } else { DYNAMIC });
        *state = if is_parameter {
            State::Parameter(index)
        } else {
            State::Dynamic(index)
        };
        visitor.f32(innovation);
        visitor.f32(variance);
    }
}

impl CovarianceSlice {
    fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let (mut kind, mut first, mut second) = match *self {
            Self::Idle => (0, 0, 0),
            Self::PropagateCross(row) => (1, row, 0),
            Self::PropagateParameters(row) => (2, row, 0),
            Self::CompleteDynamic => (3, 0, 0),
            Self::Measure => (4, 0, 0),
            Self::Correct(index) => (5, index, 0),
            Self::CorrectRows(index, row) => (6, index, row),
            Self::Check => (7, 0, 0),
            Self::Done => (8, 0, 0),
            Self::Prepare => (9, 0, 0),
        };
        visitor.index(&mut kind, 10);
        // A row or index out of range does no harm: both are checked where they are used.
        visitor.index(&mut first, PARAMETERS + 1);
        visitor.index(&mut second, LAST_ROW / 2 + 1);
        *self = match kind {
            1 => Self::PropagateCross(first),
            2 => Self::PropagateParameters(first),
            3 => Self::CompleteDynamic,
            4 => Self::Measure,
            5 => Self::Correct(first),
            6 => Self::CorrectRows(first, second),
            7 => Self::Check,
            8 => Self::Done,
            9 => Self::Prepare,
            _ => Self::Idle,
        };
    }
}
