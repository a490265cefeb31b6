//! Cholesky factor of the normal equations of a fit with nine parameters.

/// Number of parameters.
pub(super) const PARAMETERS: usize = 9;

/// One row, or one vector of parameters.
pub(super) type Row = [f32; PARAMETERS];

/// Normal equations JᵀJ·x = Jᵀr of a least-squares fit.
pub(super) struct NormalEquations {
    /// JᵀJ.
    pub(super) matrix: [Row; PARAMETERS],
    /// Jᵀr.
    pub(super) right: Row,
}

impl NormalEquations {
    /// No equation.
    pub(super) const NONE: Self = Self {
        matrix: [[0.0; PARAMETERS]; PARAMETERS],
        right: [0.0; PARAMETERS],
    };

    /// Adds the equation row·x = value.
    #[inline(never)]
    pub(super) fn add(&mut self, row: &Row, value: f32) {
        for ((sums, right), left) in self.matrix.iter_mut().zip(&mut self.right).zip(row) {
            for (sum, other) in sums.iter_mut().zip(row) {
                *sum += left * other;
            }
            *right += left * value;
        }
    }
}

/// Lower triangle L of a matrix L·Lᵀ.
pub(super) struct Cholesky([Row; PARAMETERS]);

impl Cholesky {
    /// Factors a matrix; `None` if it is singular to `f32` precision.
    pub(super) fn factor(matrix: &[Row; PARAMETERS]) -> Option<Self> {
        let mut lower = [[0.0_f32; PARAMETERS]; PARAMETERS];
        for (row, given) in matrix.iter().enumerate() {
            let (above, below) = lower.split_at_mut(row);
            let current = below.first_mut()?;
            for (column, other) in above.iter().enumerate() {
                let entry = (given.get(column)? - dot(current, other)) / other.get(column)?;
                *current.get_mut(column)? = entry;
            }
            let diagonal = *given.get(row)?;
            let pivot = diagonal - dot(current, current);
            // A NaN fails every comparison.
            let is_regular = pivot > 1.0e-5 * diagonal && pivot > 1.0e-7;
            if !is_regular {
                return None;
            }
            *current.get_mut(row)? = libm::sqrtf(pivot);
        }
        Some(Self(lower))
    }

    /// Solves L·Lᵀ·x = right for x.
    pub(super) fn solve(&self, right: &Row) -> Row {
        let mut x = *right;
        // L·y = right from the top down, then Lᵀ·x = y from the bottom up.
        for index in 0..PARAMETERS {
            let column = self.0.map(|row| entry(&row, index));
            eliminate(&mut x, &column, index, index + 1..PARAMETERS);
        }
        for (index, row) in self.0.iter().enumerate().rev() {
            eliminate(&mut x, row, index, 0..index);
        }
        x
    }

    /// Returns the largest element on the diagonal of the inverse matrix: the largest variance of
    /// a parameter per variance of an equation.
    pub(super) fn largest_inverse_diagonal(&self) -> f32 {
        let mut largest = 0.0_f32;
        for index in 0..PARAMETERS {
            let mut unit = [0.0; PARAMETERS];
            if let Some(one) = unit.get_mut(index) {
                *one = 1.0;
            }
            largest = largest.max(entry(&self.solve(&unit), index));
        }
        largest
    }
}

/// Solves for the unknown at `index`, and subtracts its part from the unknowns in `others`.
fn eliminate(x: &mut Row, factors: &Row, index: usize, others: core::ops::Range<usize>) {
    let value = entry(x, index) / entry(factors, index);
    for (other, (x, factor)) in x.iter_mut().zip(factors).enumerate() {
        if other == index {
            *x = value;
        } else if others.contains(&other) {
            *x -= factor * value;
        }
    }
}

/// Scalar product.
pub(super) fn dot(a: &Row, b: &Row) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Element of a row; every index in use exists.
fn entry(row: &Row, index: usize) -> f32 {
    row.get(index).copied().unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factorisation_solves() {
        // Positive definite: a diagonal and a rank-one part.
        let mut matrix = [[0.0; PARAMETERS]; PARAMETERS];
        for (row, line) in matrix.iter_mut().enumerate() {
            for (column, entry) in line.iter_mut().enumerate() {
                *entry = 0.1 * (row + 1) as f32 * (column + 1) as f32;
                if row == column {
                    *entry += 2.0 + row as f32;
                }
            }
        }
        let expected: Row = [1.0, -2.0, 3.0, 0.5, -0.25, 4.0, 1.5, -1.0, 2.0];
        let right = matrix.map(|row| dot(&row, &expected));
        let solved = Cholesky::factor(&matrix).expect("regular").solve(&right);
        for (found, expected) in solved.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{solved:?}");
        }
        assert!(Cholesky::factor(&[[1.0; PARAMETERS]; PARAMETERS]).is_none());
    }
}
