//! Covariance in three blocks, and the operations on it.
//!
//! Four states are *dynamic*: tilt (2) and horizontal velocity (2). The other fifteen are
//! *parameters* of the sensor: gyroscope bias (3), gyroscope matrix (9), accelerometer bias (3).
//! Time changes only the rows and columns of the dynamic states, so the blocks are stored apart:
//!
//! ```text
//!      dynamic  parameters
//! P = [  P_dd     P_pdᵀ  ]   P_dd: 4 × 4, full      P_pd: 15 × 4
//!     [  P_pd     P_pp   ]   P_pp: 15 × 15, lower triangle by rows
//! ```
//!
//! P_pp cannot become asymmetric, because only half of it is stored. P_dd is mirrored from its
//! lower half. Operations on P_pd and P_pp work on one row each, so that a caller can spread them
//! over several samples.

use super::prior::{FIRST_WITH_PRIOR, ParameterPriors};
use super::propagation::{
    DYNAMIC, Effect, GYROSCOPE_PARAMETERS, PARAMETERS, State, TILT_EAST, TILT_NORTH, Transition,
};
use crate::serialize::StateVisitor;

const TRIANGLE: usize = PARAMETERS * (PARAMETERS + 1) / 2;

/// Entries of the triangle for the gyroscope's bias.
const BIAS_ENTRIES: usize = 6;

/// Returns the place of a parameter's variance in the triangle.
const fn diagonal(parameter: usize) -> usize {
    parameter * (parameter + 3) / 2
}

/// Covariance of the error state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Covariance {
    dynamic: [[f32; DYNAMIC]; DYNAMIC],
    cross: [[f32; DYNAMIC]; PARAMETERS],
    triangle: [f32; TRIANGLE],
}

/// A column of the covariance, or a correction of the error state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Column {
    pub(super) dynamic: [f32; DYNAMIC],
    pub(super) parameters: [f32; PARAMETERS],
}

impl Column {
    /// The zero column.
    pub(super) const ZERO: Self = Self {
        dynamic: [0.0; DYNAMIC],
        parameters: [0.0; PARAMETERS],
    };

    /// Returns whether every entry is a finite number of plausible size.
    pub(super) fn is_sound(&self) -> bool {
        // A NaN makes the sum a NaN, which fails the comparison.
        let entries = self.dynamic.iter().chain(&self.parameters);
        entries.map(|entry| entry.abs()).sum::<f32>() < 1.0e4
    }

    /// Returns the entry of a state.
    pub(super) fn entry(&self, state: State) -> Option<f32> {
        match state {
            State::Dynamic(state) => self.dynamic.get(state),
            State::Parameter(parameter) => self.parameters.get(parameter),
        }
        .copied()
    }

    /// Adds a multiple of another column.
    pub(super) fn add(&mut self, other: &Self, factor: f32) {
        for (entry, other) in self.dynamic.iter_mut().zip(&other.dynamic) {
            *entry += factor * other;
        }
        for (entry, other) in self.parameters.iter_mut().zip(&other.parameters) {
            *entry += factor * other;
        }
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            dynamic,
            parameters,
        } = self;
        visitor.f32s(dynamic);
        visitor.f32s(parameters);
    }
}

impl Covariance {
    /// The zero matrix.
    pub(super) const ZERO: Self = Self {
        dynamic: [[0.0; DYNAMIC]; DYNAMIC],
        cross: [[0.0; DYNAMIC]; PARAMETERS],
        triangle: [0.0; TRIANGLE],
    };

    /// Returns the variance of a dynamic state.
    #[inline]
    pub(super) fn dynamic_variance(&self, state: usize) -> f32 {
        match self.dynamic.get(state).and_then(|row| row.get(state)) {
            Some(variance) => *variance,
            None => 0.0,
        }
    }

    /// Returns the variance of the tilt, both axes together, rad².
    #[inline]
    pub(super) fn tilt_variance(&self) -> f32 {
        self.dynamic_variance(TILT_NORTH) + self.dynamic_variance(TILT_EAST)
    }

    /// Returns the variance of a parameter.
    #[inline]
    pub(super) fn parameter_variance(&self, parameter: usize) -> f32 {
        match self.triangle.get(diagonal(parameter)) {
            Some(variance) => *variance,
            None => 0.0,
        }
    }

    /// Returns the variances of the gyroscope's bias.
    #[inline]
    pub(super) fn bias_variances(&self) -> [f32; 3] {
        let [x, _, y, _, _, z, ..] = self.triangle;
        [x, y, z]
    }

    /// Sets the variances of the gyroscope's bias, and keeps its correlations with other states.
    /// Unless they are zero, no variance must become smaller.
    pub(super) fn reset_bias(&mut self, [x, y, z]: [f32; 3]) {
        if let Some(bias) = self.triangle.first_chunk_mut::<BIAS_ENTRIES>() {
            *bias = [x, 0.0, y, 0.0, 0.0, z];
        }
    }

    /// Sets the variance of each parameter but the gyroscope's bias to its prior, and its
    /// correlations with other parameters to zero.
    pub(super) fn reset_parameters(&mut self, priors: &ParameterPriors) {
        let (_, rest) = self.triangle.split_at_mut(BIAS_ENTRIES);
        rest.fill(0.0);
        for parameter in FIRST_WITH_PRIOR..PARAMETERS {
            self.add_to_parameter(parameter, priors.variance(parameter));
        }
    }

    /// Adds to the variance of a dynamic state.
    pub(super) fn add_to_dynamic(&mut self, state: usize, variance: f32) {
        if let Some(own) = self
            .dynamic
            .get_mut(state)
            .and_then(|row| row.get_mut(state))
        {
            *own += variance;
        }
    }

    /// Adds to the variance of a parameter.
    pub(super) fn add_to_parameter(&mut self, parameter: usize, variance: f32) {
        if let Some(own) = self.triangle.get_mut(diagonal(parameter)) {
            *own += variance;
        }
    }

    /// Scales the error of a parameter, and adds to its variance.
    #[inline(never)]
    pub(super) fn scale_parameter(&mut self, parameter: usize, factor: f32, added: f32) {
        if let Some(row) = self.cross.get_mut(parameter) {
            row.iter_mut().for_each(|entry| *entry *= factor);
        }
        let row = self.row_mut(parameter);
        row.iter_mut().for_each(|entry| *entry *= factor);
        if let Some(own) = row.last_mut() {
            *own = *own * factor + added;
        }
        let mut index = diagonal(parameter);
        for other in parameter + 1..PARAMETERS {
            index += other;
            if let Some(entry) = self.triangle.get_mut(index) {
                *entry *= factor;
            }
        }
    }

    /// Sets the variance of a dynamic state, and its correlations to zero.
    #[inline(never)]
    pub(super) fn reset_dynamic(&mut self, state: usize, variance: f32) {
        for (index, row) in self.dynamic.iter_mut().enumerate() {
            if index == state {
                *row = [0.0; DYNAMIC];
            }
            if let Some(entry) = row.get_mut(state) {
                *entry = if index == state { variance } else { 0.0 };
            }
        }
        for row in &mut self.cross {
            if let Some(entry) = row.get_mut(state) {
                *entry = 0.0;
            }
        }
    }

    /// Sets the variances of tilt (per axis, rad²) and velocity (per axis, (m/s)²), and all their
    /// correlations to zero.
    pub(super) fn reset_tilt_and_velocity(&mut self, tilt: f32, velocity: f32) {
        self.cross.as_flattened_mut().fill(0.0);
        self.dynamic = [
            [tilt, 0.0, 0.0, 0.0],
            [0.0, tilt, 0.0, 0.0],
            [0.0, 0.0, velocity, 0.0],
            [0.0, 0.0, 0.0, velocity],
        ];
    }

    /// Propagates P_dd: P_dd ← A·P_dd·Aᵀ.
    pub(super) fn propagate_dynamic(&mut self, transition: &Transition) {
        let f = transition.down_m_s;
        let [north, east, north_m_s, east_m_s] = &mut self.dynamic;
        for column in 0..DYNAMIC {
            north_m_s[column] += f * east[column];
            east_m_s[column] -= f * north[column];
        }
        for row in &mut self.dynamic {
            row[2] += f * row[1];
            row[3] -= f * row[0];
        }
    }

    /// Propagates a row of P_pd: P_pd ← P_pd·Aᵀ; then P_dd ← P_dd − B·P_pd for that row.
    pub(super) fn propagate_cross(&mut self, parameter: usize, transition: &Transition) {
        let f = transition.down_m_s;
        let Some(row) = self.cross.get_mut(parameter) else {
            return;
        };
        row[2] += f * row[1];
        row[3] -= f * row[0];
        // Only the lower half of P_dd; `complete_dynamic` computes the rest.
        let [first, second, third, fourth] = &mut self.dynamic;
        match transition.effect(parameter) {
            Effect::Tilt(b) => {
                first[0] -= b[0] * row[0];
                second[0] -= b[1] * row[0];
                second[1] -= b[1] * row[1];
            }
            Effect::Velocity(b) => {
                for column in 0..3 {
                    third[column] -= b[0] * row[column];
                }
                for column in 0..4 {
                    fourth[column] -= b[1] * row[column];
                }
            }
        }
    }

    /// Propagates a row of P_pp into P_pd: P_pd ← P_pd − P_pp·Bᵀ.
    ///
    /// Each entry of the row represents two of P_pp.
    pub(super) fn propagate_parameters(&mut self, parameter: usize, transition: &Transition) {
        let start = parameter * (parameter + 1) / 2;
        let Some(row) = self.triangle.get(start..start + parameter + 1) else {
            return;
        };
        let Some((above, [own, ..])) = self.cross.split_at_mut_checked(parameter) else {
            return;
        };
        let Some((variance, row)) = row.split_last() else {
            return;
        };
        // The gyroscope's parameters before this one add to its covariance with the tilt.
        let [mut north, mut east] = [0.0; 2];
        match transition.effect(parameter) {
            Effect::Tilt(own_b) => {
                for ((p, b), other) in row.iter().zip(&transition.tilt).zip(above) {
                    north += p * b[0];
                    east += p * b[1];
                    other[0] -= p * own_b[0];
                    other[1] -= p * own_b[1];
                }
                own[0] -= north + variance * own_b[0];
                own[1] -= east + variance * own_b[1];
            }
            Effect::Velocity(own_b) => {
                let Some((gyroscope, accelerometer)) =
                    above.split_first_chunk_mut::<GYROSCOPE_PARAMETERS>()
                else {
                    return;
                };
                for ((p, b), other) in row.iter().zip(&transition.tilt).zip(gyroscope) {
                    north += p * b[0];
                    east += p * b[1];
                    other[2] -= p * own_b[0];
                    other[3] -= p * own_b[1];
                }
                own[0] -= north;
                own[1] -= east;
                let [mut north_m_s, mut east_m_s] = [variance * own_b[0], variance * own_b[1]];
                let biases = row.iter().skip(GYROSCOPE_PARAMETERS);
                for ((p, b), other) in biases.zip(&transition.tilt).zip(accelerometer) {
                    north_m_s += p * b[0];
                    east_m_s += p * b[1];
                    other[2] -= p * own_b[0];
                    other[3] -= p * own_b[1];
                }
                own[2] -= north_m_s;
                own[3] -= east_m_s;
            }
        }
    }

    /// Completes P_dd from the propagated P_pd: P_dd ← P_dd − P_pd·Bᵀ.
    ///
    /// P_dd is then symmetric.
    pub(super) fn complete_dynamic(&mut self, transition: &Transition) {
        // Only the lower half, with the terms that `propagate_cross` leaves out. In a copy the sums
        // stay in registers.
        let [mut first, mut second, mut third, mut fourth] = self.dynamic;
        let (gyroscope, accelerometer) = self.cross.split_at(GYROSCOPE_PARAMETERS);
        for (x, b) in gyroscope.iter().zip(&transition.tilt) {
            first[0] -= x[0] * b[0];
            second[0] -= x[1] * b[0];
            second[1] -= x[1] * b[1];
            third[0] -= x[2] * b[0];
            third[1] -= x[2] * b[1];
            fourth[0] -= x[3] * b[0];
            fourth[1] -= x[3] * b[1];
        }
        for (x, b) in accelerometer.iter().zip(&transition.tilt) {
            third[2] -= x[2] * b[0];
            fourth[2] -= x[3] * b[0];
            fourth[3] -= x[3] * b[1];
        }
        self.dynamic = [first, second, third, fourth];
        for row in 1..DYNAMIC {
            for column in 0..row {
                self.dynamic[column][row] = self.dynamic[row][column];
            }
        }
    }

    /// Returns whether every variance is positive and of plausible size.
    pub(super) fn is_sound(&self) -> bool {
        const LARGEST: f32 = 1.0e6;
        let is_sound = |variance: f32| variance > 0.0 && variance < LARGEST;
        (0..DYNAMIC).all(|state| is_sound(self.dynamic_variance(state)))
            && (0..PARAMETERS).all(|parameter| is_sound(self.parameter_variance(parameter)))
    }

    /// Writes the column of a dynamic state.
    pub(super) fn dynamic_column(&self, state: usize, column: &mut Column) {
        for (entry, row) in column.dynamic.iter_mut().zip(&self.dynamic) {
            *entry = row.get(state).copied().unwrap_or(0.0);
        }
        for (entry, row) in column.parameters.iter_mut().zip(&self.cross) {
            *entry = row.get(state).copied().unwrap_or(0.0);
        }
    }

    /// Writes the column of a parameter.
    pub(super) fn parameter_column(&self, parameter: usize, column: &mut Column) {
        if let Some(row) = self.cross.get(parameter) {
            column.dynamic = *row;
        }
        let mut index = parameter * (parameter + 1) / 2;
        for (other, entry) in column.parameters.iter_mut().enumerate() {
            *entry = self.triangle.get(index).copied().unwrap_or(0.0);
            index += if other < parameter { 1 } else { other + 1 };
        }
    }

    /// Returns an entry of P_pd, or zero.
    pub(super) fn cross_entry(&self, parameter: usize, state: usize) -> f32 {
        let row = self.cross.get(parameter);
        match row.and_then(|row| row.get(state)) {
            Some(entry) => *entry,
            None => 0.0,
        }
    }

    /// Returns the covariance of the tilt: north, north with east, east.
    pub(super) fn tilt(&self) -> [f32; 3] {
        let [[north, ..], [both, east, ..], ..] = self.dynamic;
        [north, both, east]
    }

    /// Adds the columns of tilt or velocity, north and east, times these factors. `first` is the
    /// first of the two states.
    pub(super) fn add_dynamic_columns(
        &self,
        first: usize,
        [north, east]: [f32; 2],
        dynamic: &mut [f32; DYNAMIC],
        parameters: &mut [f32; PARAMETERS],
    ) {
        // P_dd is symmetric.
        let rows = (self.dynamic.get(first), self.dynamic.get(first + 1));
        if let (Some(to_north), Some(to_east)) = rows {
            for ((sum, n), e) in dynamic.iter_mut().zip(to_north).zip(to_east) {
                *sum += north * n + east * e;
            }
        }
        if first == TILT_NORTH {
            for (sum, [n, e, _, _]) in parameters.iter_mut().zip(&self.cross) {
                *sum += north * n + east * e;
            }
        } else {
            for (sum, [_, _, n, e]) in parameters.iter_mut().zip(&self.cross) {
                *sum += north * n + east * e;
            }
        }
    }

    /// Adds the column of a parameter times a factor.
    pub(super) fn add_parameter_column(
        &self,
        parameter: usize,
        factor: f32,
        dynamic: &mut [f32; DYNAMIC],
        parameters: &mut [f32; PARAMETERS],
    ) {
        if let Some(row) = self.cross.get(parameter) {
            for (sum, entry) in dynamic.iter_mut().zip(row) {
                *sum += factor * entry;
            }
        }
        let (before, after) = parameters.split_at_mut(PARAMETERS.min(parameter + 1));
        for (sum, entry) in before.iter_mut().zip(self.row(parameter)) {
            *sum += factor * entry;
        }
        let mut index = (parameter + 1) * (parameter + 2) / 2 + parameter;
        for (other, sum) in after.iter_mut().enumerate() {
            if let Some(entry) = self.triangle.get(index) {
                *sum += factor * entry;
            }
            index += parameter + 2 + other;
        }
    }

    /// Adds a row of P_pd and P_pp to the product of the covariance with a vector that has entries
    /// at the gyroscope's parameters only. All rows make the whole product.
    pub(super) fn add_row_product(
        &self,
        parameter: usize,
        vector: &[f32; GYROSCOPE_PARAMETERS],
        dynamic: &mut [f32; DYNAMIC],
        parameters: &mut [f32; PARAMETERS],
    ) {
        let Some((variance, row)) = self.row(parameter).split_last() else {
            return;
        };
        let Some((before, [own, ..])) = parameters.split_at_mut_checked(parameter) else {
            return;
        };
        let Some(cross) = self.cross.get(parameter) else {
            return;
        };
        // A row of the accelerometer's bias has no entry.
        let factor = vector.get(parameter).copied().unwrap_or(0.0);
        for (sum, entry) in dynamic.iter_mut().zip(cross) {
            *sum += factor * entry;
        }
        let mut sum = factor * variance;
        for ((other, entry), value) in before.iter_mut().zip(row).zip(vector) {
            *other += factor * entry;
            sum += value * entry;
        }
        *own += sum;
    }

    /// Applies a measurement to P_dd: P ← P − h·hᵀ/s, with the column h and `inverse` = 1/s.
    pub(super) fn correct_dynamic(&mut self, h: &Column, inverse: f32) {
        for row in 0..DYNAMIC {
            let gain = h.dynamic[row] * inverse;
            for column in 0..=row {
                let corrected = self.dynamic[row][column] - gain * h.dynamic[column];
                self.dynamic[row][column] = corrected;
                self.dynamic[column][row] = corrected;
            }
        }
    }

    /// Applies a measurement to a row of P_pd and P_pp: P ← P − h·hᵀ/s.
    pub(super) fn correct_parameter(&mut self, parameter: usize, h: &Column, inverse: f32) {
        let Some(own) = h.parameters.get(parameter) else {
            return;
        };
        let gain = own * inverse;
        if let Some(row) = self.cross.get_mut(parameter) {
            for (entry, other) in row.iter_mut().zip(&h.dynamic) {
                *entry -= gain * other;
            }
        }
        for (entry, other) in self.row_mut(parameter).iter_mut().zip(&h.parameters) {
            *entry -= gain * other;
        }
    }

    #[inline]
    fn row(&self, parameter: usize) -> &[f32] {
        let start = parameter * (parameter + 1) / 2;
        self.triangle
            .get(start..start + parameter + 1)
            .unwrap_or(&[])
    }

    #[inline]
    fn row_mut(&mut self, parameter: usize) -> &mut [f32] {
        let start = parameter * (parameter + 1) / 2;
        self.triangle
            .get_mut(start..start + parameter + 1)
            .unwrap_or(&mut [])
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            dynamic,
            cross,
            triangle,
        } = self;
        visitor.f32s(dynamic.as_flattened_mut());
        visitor.f32s(cross.as_flattened_mut());
        visitor.f32s(triangle);
    }
}
