//! The covariance as three blocks, and the few operations that the filter needs.
//!
//! States are of two kinds. Four of them *move* by themselves: tilt (2) and horizontal velocity (2).
//! The other fifteen are *constants* of the sensor that at most wander: gyroscope bias (3),
//! gyroscope matrix (9), accelerometer bias (3). Only rows and columns of moving states change when
//! time passes, so the blocks are kept apart:
//!
//! ```text
//!       moving  constants
//! P = [   M        Xᵀ    ]   M: 4 × 4, full      X: 15 × 4
//!     [   X        C     ]   C: 15 × 15, lower triangle by rows
//! ```
//!
//! C cannot be asymmetric, because half of it is not stored; M is mirrored from its lower half.
//! Everything goes by rows of constants, so that a caller can do a few rows at a time.

use crate::state::Exchange;

/// Tilt about north and east, velocity to north and east.
pub(super) const MOVING: usize = 4;
/// Gyroscope bias, gyroscope matrix by rows, accelerometer bias.
pub(super) const CONSTANTS: usize = 15;
/// Gyroscope bias and matrix: the constants that turn; the accelerometer's bias is the rest.
pub(super) const TURNING: usize = 12;

const TRIANGLE: usize = CONSTANTS * (CONSTANTS + 1) / 2;

/// What moving states are moved by in an interval: `moving ← A·moving − B·constants`.
///
/// A is the identity but for the velocity that a tilt gathers under the specific force.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Transition {
    /// B for tilt: what each turning constant adds to it, north and east. Its first three entries
    /// are the integral of the rotation matrix's upper rows, and so B for velocity as well.
    pub(super) tilt_per: [[f32; 2]; TURNING],
    /// The integral of the specific force's vertical part, m/s: about −g times the interval.
    pub(super) vertical_m_s: f32,
}

impl Transition {
    pub(super) fn exchange(&mut self, state: &mut impl Exchange) {
        state.numbers(self.tilt_per.as_flattened_mut());
        state.number(&mut self.vertical_m_s);
    }

    pub(super) const NONE: Self = Self {
        tilt_per: [[0.0; 2]; TURNING],
        vertical_m_s: 0.0,
    };

    /// Moves an error (or a column of the covariance) along.
    pub(super) fn carry(&self, moving: &mut [f32; MOVING], constants: &[f32; CONSTANTS]) {
        let [mut north, mut east] = [0.0; 2];
        for (b, constant) in self.tilt_per.iter().zip(constants) {
            north += b[0] * constant;
            east += b[1] * constant;
        }
        let [mut north_m_s, mut east_m_s] = [0.0; 2];
        for (b, constant) in self.tilt_per.iter().zip(&constants[TURNING..]) {
            north_m_s += b[0] * constant;
            east_m_s += b[1] * constant;
        }
        moving[2] += self.vertical_m_s * moving[1] - north_m_s;
        moving[3] -= self.vertical_m_s * moving[0] + east_m_s;
        moving[0] -= north;
        moving[1] -= east;
    }
}

/// The blocks.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Covariance {
    moving: [[f32; MOVING]; MOVING],
    cross: [[f32; MOVING]; CONSTANTS],
    triangle: [f32; TRIANGLE],
}

/// A column of the covariance: with which states one state goes.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Column {
    pub(super) moving: [f32; MOVING],
    pub(super) constants: [f32; CONSTANTS],
}

impl Column {
    pub(super) fn exchange(&mut self, state: &mut impl Exchange) {
        state.numbers(&mut self.moving);
        state.numbers(&mut self.constants);
    }

    pub(super) const ZERO: Self = Self {
        moving: [0.0; MOVING],
        constants: [0.0; CONSTANTS],
    };

    /// Whether every entry is a number, and none absurd.
    pub(super) fn is_sound(&self) -> bool {
        // A NaN spoils the sum and fails the comparison.
        let entries = self.moving.iter().chain(&self.constants);
        entries.map(|entry| entry.abs()).sum::<f32>() < 1.0e4
    }
}

impl Covariance {
    pub(super) fn exchange(&mut self, state: &mut impl Exchange) {
        state.numbers(self.moving.as_flattened_mut());
        state.numbers(self.cross.as_flattened_mut());
        state.numbers(&mut self.triangle);
    }

    pub(super) const ZERO: Self = Self {
        moving: [[0.0; MOVING]; MOVING],
        cross: [[0.0; MOVING]; CONSTANTS],
        triangle: [0.0; TRIANGLE],
    };

    /// Sets every entry to zero, in its place.
    pub(super) fn clear(&mut self) {
        self.moving.as_flattened_mut().fill(0.0);
        self.cross.as_flattened_mut().fill(0.0);
        self.triangle.fill(0.0);
    }

    /// The covariance of a moving state with itself.
    #[inline]
    pub(super) fn moving_variance(&self, state: usize) -> f32 {
        match self.moving.get(state).and_then(|row| row.get(state)) {
            Some(variance) => *variance,
            None => 0.0,
        }
    }

    /// The covariance of a constant with itself.
    #[inline]
    pub(super) fn constant_variance(&self, constant: usize) -> f32 {
        match self.row(constant).last() {
            Some(variance) => *variance,
            None => 0.0,
        }
    }

    /// Adds to the variance of a moving state.
    pub(super) fn add_to_moving(&mut self, state: usize, variance: f32) {
        if let Some(own) = self
            .moving
            .get_mut(state)
            .and_then(|row| row.get_mut(state))
        {
            *own += variance;
        }
    }

    /// Adds to the variance of a constant.
    pub(super) fn add_to_constant(&mut self, constant: usize, variance: f32) {
        if let Some(own) = self.row_mut(constant).last_mut() {
            *own += variance;
        }
    }

    /// Forgets what a moving state has to do with anything; its variance is this now.
    pub(super) fn reset_moving(&mut self, state: usize, variance: f32) {
        for (index, row) in self.moving.iter_mut().enumerate() {
            if index == state {
                *row = [0.0; MOVING];
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

    /// M ← A·M·Aᵀ.
    pub(super) fn carry_moving(&mut self, by: &Transition) {
        let f = by.vertical_m_s;
        let [north, east, north_m_s, east_m_s] = &mut self.moving;
        for column in 0..MOVING {
            north_m_s[column] += f * east[column];
            east_m_s[column] -= f * north[column];
        }
        for row in &mut self.moving {
            row[2] += f * row[1];
            row[3] -= f * row[0];
        }
    }

    /// Row of X: X ← X·Aᵀ, and M ← M − B·X of that row.
    pub(super) fn carry_cross(&mut self, constant: usize, by: &Transition) {
        let f = by.vertical_m_s;
        let Some(row) = self.cross.get_mut(constant) else {
            return;
        };
        row[2] += f * row[1];
        row[3] -= f * row[0];
        let (b, from) = effect(by, constant);
        // Only the lower half of M; `close` does the rest.
        let [first, second, third, fourth] = &mut self.moving;
        if from == 0 {
            first[0] -= b[0] * row[0];
            second[0] -= b[1] * row[0];
            second[1] -= b[1] * row[1];
        } else {
            for column in 0..3 {
                third[column] -= b[0] * row[column];
            }
            for column in 0..4 {
                fourth[column] -= b[1] * row[column];
            }
        }
    }

    /// Row of C: X ← X − C·Bᵀ for every entry of C in that row, each of which stands for two.
    pub(super) fn mix(&mut self, constant: usize, by: &Transition) {
        let (own_b, own_from) = effect(by, constant);
        let start = constant * (constant + 1) / 2;
        let Some(row) = self.triangle.get(start..start + constant + 1) else {
            return;
        };
        let Some((above, [own, ..])) = self.cross.split_at_mut_checked(constant) else {
            return;
        };
        let Some((variance, row)) = row.split_last() else {
            return;
        };
        // What the turning constants before this one do to its own tilt.
        let [mut north, mut east] = [0.0; 2];
        if own_from == 0 {
            for ((p, b), other) in row.iter().zip(&by.tilt_per).zip(above) {
                north += p * b[0];
                east += p * b[1];
                other[0] -= p * own_b[0];
                other[1] -= p * own_b[1];
            }
            own[0] -= north + variance * own_b[0];
            own[1] -= east + variance * own_b[1];
        } else {
            let Some((turning, forces)) = above.split_first_chunk_mut::<TURNING>() else {
                return;
            };
            for ((p, b), other) in row.iter().zip(&by.tilt_per).zip(turning) {
                north += p * b[0];
                east += p * b[1];
                other[2] -= p * own_b[0];
                other[3] -= p * own_b[1];
            }
            own[0] -= north;
            own[1] -= east;
            let [mut north_m_s, mut east_m_s] = [variance * own_b[0], variance * own_b[1]];
            for ((p, b), other) in row.iter().skip(TURNING).zip(&by.tilt_per).zip(forces) {
                north_m_s += p * b[0];
                east_m_s += p * b[1];
                other[2] -= p * own_b[0];
                other[3] -= p * own_b[1];
            }
            own[2] -= north_m_s;
            own[3] -= east_m_s;
        }
    }

    /// M ← M − X·Bᵀ, after X is complete; then M is symmetric again.
    pub(super) fn close(&mut self, by: &Transition) {
        // Only the lower half is computed: what the rows of M lack after `carry_cross`.
        let [first, second, third, fourth] = &mut self.moving;
        let (turning, forces) = self.cross.split_at(TURNING);
        for (x, b) in turning.iter().zip(&by.tilt_per) {
            first[0] -= x[0] * b[0];
            second[0] -= x[1] * b[0];
            second[1] -= x[1] * b[1];
            third[0] -= x[2] * b[0];
            third[1] -= x[2] * b[1];
            fourth[0] -= x[3] * b[0];
            fourth[1] -= x[3] * b[1];
        }
        for (x, b) in forces.iter().zip(&by.tilt_per) {
            third[2] -= x[2] * b[0];
            fourth[2] -= x[3] * b[0];
            fourth[3] -= x[3] * b[1];
        }
        for row in 1..MOVING {
            for column in 0..row {
                self.moving[column][row] = self.moving[row][column];
            }
        }
    }

    /// Whether every variance is a positive number, and none absurd.
    pub(super) fn is_sound(&self) -> bool {
        const LARGEST: f32 = 1.0e6;
        let is_sound = |variance: f32| variance > 0.0 && variance < LARGEST;
        (0..MOVING).all(|state| is_sound(self.moving_variance(state)))
            && (0..CONSTANTS).all(|constant| is_sound(self.constant_variance(constant)))
    }

    /// The column of a moving state.
    pub(super) fn moving_column(&self, state: usize) -> Column {
        let mut column = Column::ZERO;
        for (entry, row) in column.moving.iter_mut().zip(&self.moving) {
            *entry = row.get(state).copied().unwrap_or(0.0);
        }
        for (entry, row) in column.constants.iter_mut().zip(&self.cross) {
            *entry = row.get(state).copied().unwrap_or(0.0);
        }
        column
    }

    /// The column of a constant.
    pub(super) fn constant_column(&self, constant: usize) -> Column {
        let mut column = Column::ZERO;
        if let Some(row) = self.cross.get(constant) {
            column.moving = *row;
        }
        let mut index = constant * (constant + 1) / 2;
        for (other, entry) in column.constants.iter_mut().enumerate() {
            *entry = self.triangle.get(index).copied().unwrap_or(0.0);
            index += if other < constant { 1 } else { other + 1 };
        }
        column
    }

    /// M ← M − h·hᵀ/s.
    pub(super) fn reduce_moving(&mut self, h: &Column, inverse: f32) {
        for row in 0..MOVING {
            let gain = h.moving[row] * inverse;
            for column in 0..=row {
                let reduced = self.moving[row][column] - gain * h.moving[column];
                self.moving[row][column] = reduced;
                self.moving[column][row] = reduced;
            }
        }
    }

    /// Row of X and C: P ← P − h·hᵀ/s.
    pub(super) fn reduce(&mut self, constant: usize, h: &Column, inverse: f32) {
        let Some(own) = h.constants.get(constant) else {
            return;
        };
        let gain = own * inverse;
        if let Some(row) = self.cross.get_mut(constant) {
            for (entry, other) in row.iter_mut().zip(&h.moving) {
                *entry -= gain * other;
            }
        }
        for (entry, other) in self.row_mut(constant).iter_mut().zip(&h.constants) {
            *entry -= gain * other;
        }
    }

    #[inline]
    fn row(&self, constant: usize) -> &[f32] {
        let start = constant * (constant + 1) / 2;
        self.triangle
            .get(start..start + constant + 1)
            .unwrap_or(&[])
    }

    #[inline]
    fn row_mut(&mut self, constant: usize) -> &mut [f32] {
        let start = constant * (constant + 1) / 2;
        self.triangle
            .get_mut(start..start + constant + 1)
            .unwrap_or(&mut [])
    }
}

/// What a constant adds to the moving states: two numbers, and the first state that they go to.
fn effect(by: &Transition, constant: usize) -> ([f32; 2], usize) {
    match by.tilt_per.get(constant) {
        Some(b) => (*b, 0),
        None => (
            by.tilt_per
                .get(constant.wrapping_sub(TURNING))
                .copied()
                .unwrap_or([0.0; 2]),
            2,
        ),
    }
}
