//! Covariance of the field states, and their cross-covariance with the tilt filter's error states.
//!
//! ```text
//!      field states  error states
//! P = [     O            X      ]   O: 9 × 9, lower triangle by rows     X: 9 × 19
//! ```

use crate::estimator::kalman::follow::ERROR_STATES;

/// Number of field states: field (3), hard iron (3), local deviation (3).
pub(super) const STATES: usize = 9;
const TRIANGLE: usize = STATES * (STATES + 1) / 2;

/// Row of the cross-covariance.
pub(super) type CrossRow = [f32; ERROR_STATES];

/// Covariance of the field states.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Covariance {
    triangle: [f32; TRIANGLE],
    pub(super) cross: [CrossRow; STATES],
}

/// Index of an entry of the triangle.
#[inline]
const fn index(row: usize, column: usize) -> usize {
    if row >= column {
        row * (row + 1) / 2 + column
    } else {
        column * (column + 1) / 2 + row
    }
}

impl Covariance {
    /// The zero matrix.
    pub(super) const ZERO: Self = Self {
        triangle: [0.0; TRIANGLE],
        cross: [[0.0; ERROR_STATES]; STATES],
    };

    /// Returns an entry of O.
    #[inline]
    pub(super) fn entry(&self, row: usize, column: usize) -> f32 {
        self.triangle
            .get(index(row, column))
            .copied()
            .unwrap_or(0.0)
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
        for other in 0..STATES {
            if let Some(entry) = self.triangle.get_mut(index(state, other)) {
                *entry *= if other == state {
                    factor * factor
                } else {
                    factor
                };
            }
        }
        if let Some(row) = self.cross.get_mut(state) {
            row.iter_mut().for_each(|entry| *entry *= factor);
        }
    }

    /// Scales the cross-covariance with an error state.
    pub(super) fn scale_cross(&mut self, error_state: usize, factor: f32) {
        for row in &mut self.cross {
            if let Some(entry) = row.get_mut(error_state) {
                *entry *= factor;
            }
        }
    }

    /// Subtracts `gain`·`column`ᵀ from a row of O, up to the diagonal.
    #[inline]
    pub(super) fn subtract(&mut self, row: usize, gain: f32, column: &[f32; STATES]) {
        let start = row * (row + 1) / 2;
        if let Some(entries) = self.triangle.get_mut(start..start + row + 1) {
            for (entry, value) in entries.iter_mut().zip(column) {
                *entry -= gain * value;
            }
        }
    }

    /// Subtracts `gain`·`column`ᵀ from a row of X.
    #[inline]
    pub(super) fn subtract_cross(&mut self, row: usize, gain: f32, column: &CrossRow) {
        if let Some(entries) = self.cross.get_mut(row) {
            for (entry, value) in entries.iter_mut().zip(column) {
                *entry -= gain * value;
            }
        }
    }
}
