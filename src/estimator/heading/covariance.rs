//! Covariance of the field states, and their cross-covariance with the tilt filter's error states.
//!
//! ```text
//! O: 9 × 9, lower triangle by rows      X: 6 × 19, field and hard iron with the error states
//! ```
//!
//! The [module](super) has a table of the symbols.
//!
//! The local deviation forgets within seconds, so X leaves out its correlation with the error
//! states. In 5,000 simulated flights no covariance became indefinite.

use crate::estimator::kalman::heading_access::ERROR_STATES;
use crate::serialize::StateVisitor;

/// Number of field states: field (3), hard iron (3), local deviation (3).
pub(super) const STATES: usize = 9;
/// First state of the field in level axes.
pub(super) const FIELD: usize = 0;
/// First state of the hard iron in body axes.
pub(super) const IRON: usize = 3;
/// First state of the local deviation in level axes.
pub(super) const DEVIATION: usize = 6;
/// States that correlate with the tilt filter's: field and hard iron.
pub(super) const CORRELATED: usize = DEVIATION;

const TRIANGLE: usize = STATES * (STATES + 1) / 2;

/// Row of X.
pub(super) type CrossRow = [f32; ERROR_STATES];

/// Covariance of the field states.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct FieldCovariance {
    triangle: [f32; TRIANGLE],
    pub(super) cross: [CrossRow; CORRELATED],
}

/// Returns the index of an entry of O in the triangle.
#[inline]
const fn index(row: usize, column: usize) -> usize {
    if row >= column {
        row * (row + 1) / 2 + column
    } else {
        column * (column + 1) / 2 + row
    }
}

impl FieldCovariance {
    /// The zero matrix.
    pub(super) const ZERO: Self = Self {
        triangle: [0.0; TRIANGLE],
        cross: [[0.0; ERROR_STATES]; CORRELATED],
    };

    /// Returns an entry of O.
    #[inline]
    pub(super) fn entry(&self, row: usize, column: usize) -> f32 {
        match self.triangle.get(index(row, column)) {
            Some(entry) => *entry,
            None => 0.0,
        }
    }

    /// Returns an entry of X, or zero.
    #[inline]
    pub(super) fn cross_entry(&self, row: usize, error_state: usize) -> f32 {
        let entry = self.cross.get(row).and_then(|row| row.get(error_state));
        match entry {
            Some(entry) => *entry,
            None => 0.0,
        }
    }

    /// Adds to an entry of O.
    #[inline]
    pub(super) fn add(&mut self, row: usize, column: usize, amount: f32) {
        if let Some(entry) = self.triangle.get_mut(index(row, column)) {
            *entry += amount;
        }
    }

    /// Sets a state's variance, and its correlations to zero.
    pub(super) fn reset(&mut self, state: usize, variance: f32) {
        self.scale(state, 0.0);
        self.add(state, state, variance);
    }

    /// Scales the error of a state.
    pub(super) fn scale(&mut self, state: usize, factor: f32) {
        let start = state * (state + 1) / 2;
        if let Some(row) = self.triangle.get_mut(start..start + state + 1) {
            row.iter_mut().for_each(|entry| *entry *= factor);
        }
        for other in state..STATES {
            if let Some(entry) = self.triangle.get_mut(index(other, state)) {
                *entry *= factor;
            }
        }
        if let Some(row) = self.cross.get_mut(state) {
            row.iter_mut().for_each(|entry| *entry *= factor);
        }
    }

    /// Returns whether the field correlates with the tilt, as from the first measurement on.
    #[inline]
    pub(super) fn is_correlated(&self) -> bool {
        let (north, east) = (FIELD, FIELD + 1);
        self.cross_entry(north, 1) != 0.0 || self.cross_entry(east, 0) != 0.0
    }

    /// Scales the correlations with an error state.
    pub(super) fn scale_cross(&mut self, error_state: usize, factor: f32) {
        for row in &mut self.cross {
            if let Some(entry) = row.get_mut(error_state) {
                *entry *= factor;
            }
        }
    }

    /// Forgets the correlations with the tilt filter.
    pub(super) fn forget_cross(&mut self) {
        self.cross = [[0.0; ERROR_STATES]; CORRELATED];
    }

    /// Adds a column of O times a factor.
    #[inline]
    pub(super) fn add_column(&self, state: usize, factor: f32, column: &mut [f32; STATES]) {
        let start = state * (state + 1) / 2;
        let (before, after) = column.split_at_mut(STATES.min(state + 1));
        let row = self.triangle.get(start..).unwrap_or(&[]);
        for (sum, entry) in before.iter_mut().zip(row) {
            *sum += factor * entry;
        }
        let mut index = start + 2 * state + 1;
        for (other, sum) in after.iter_mut().enumerate() {
            if let Some(entry) = self.triangle.get(index) {
                *sum += factor * entry;
            }
            index += state + 2 + other;
        }
    }

    /// Subtracts `gain`·`column`ᵀ from a row of O, up to the diagonal.
    #[inline]
    pub(super) fn subtract(&mut self, row: usize, gain: f32, column: &[f32]) {
        let start = row * (row + 1) / 2;
        if let Some(entries) = self.triangle.get_mut(start..start + row + 1) {
            for (entry, value) in entries.iter_mut().zip(column) {
                *entry -= gain * value;
            }
        }
    }

    /// Subtracts `gain`·`column`ᵀ from a row of X, if the state has one.
    #[inline]
    pub(super) fn subtract_cross(&mut self, row: usize, gain: f32, column: &CrossRow) {
        if let Some(entries) = self.cross.get_mut(row) {
            for (entry, value) in entries.iter_mut().zip(column) {
                *entry -= gain * value;
            }
        }
    }

    /// Returns whether every variance is positive and of plausible size.
    pub(super) fn is_sound(&self) -> bool {
        const LARGEST: f32 = 1.0e7;
        (0..STATES).all(|state| {
            let variance = self.entry(state, state);
            variance > 0.0 && variance < LARGEST
        })
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.f32s(&mut self.triangle);
        visitor.f32s(self.cross.as_flattened_mut());
    }
}
