//! Fit of a compass: hard iron, soft iron, gains and mount at once, from readings in motion.
//!
//! The earth's field c is constant. With the attitudes R (body to earth) of the filter, readings m
//! and the unknown matrix A and offset b, R·(A·m + b) = c. For a given c this is a linear
//! regression of Rᵀ·c on (m, 1). The c whose regression explains most is the largest
//! eigenvector of a 3×3 matrix. So 46 sums are enough, and nothing iterates over the readings.
//!
//! The second eigenvalue says how much a wrong c would explain: it is near 1 if the vehicle was
//! turned too little. The scale follows from det A = 1: gains that are right on average.

use core::fmt;

use super::super::mount::Mount;
use super::correction::CompassCorrection;
use super::coverage::{Coverage, Side};
use crate::attitude::{BodyVector, Quaternion, Vector3};

/// Smallest number of readings: 10 s at 50 a second.
pub const MIN_READINGS: u32 = 500;
/// Smallest coverage, percent.
const MIN_PERCENT: u8 = 80;
/// Largest share that a wrong field may explain.
const MAX_SECOND: f32 = 0.8;
/// Largest residual, as a share of the field: 4.5°.
const MAX_RESIDUAL: f32 = 0.08;
/// Strengths of the earth's field with a gain error of 30 %, µT.
const STRENGTHS_UT: core::ops::RangeInclusive<f32> = 16.0..=85.0;
/// Unit of the sums, so that field and constant are alike, µT.
const UNIT_UT: f32 = 50.0;
/// Steps of a power iteration: 0.8⁶⁰ is 10⁻⁶.
const STEPS: u8 = 60;

/// Row of the regression: the three components of a reading, and 1.
type Row = [f32; 4];

/// Sums over the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CompassFitter {
    /// Σ h·hᵀ of the rows h.
    squares: [Row; 4],
    /// Σ R_ij·h for each element of R.
    products: [[Row; 3]; 3],
    readings: u32,
    coverage: Coverage,
}

/// Result of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CompassFit {
    /// Mount of the compass, which the fit finds too.
    pub mount: Mount,
    /// Correction of readings on that mount.
    pub correction: CompassCorrection,
    /// Strength of the field, µT.
    pub strength_ut: f32,
    /// Dip of the field below the horizon, rad.
    pub dip_rad: f32,
    /// Root mean square of the residual, µT.
    pub residual_ut: f32,
}

/// Reason why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum CompassFitError {
    /// Too few readings came.
    TooFew {
        /// Number of readings.
        have: u32,
    },
    /// A side of the vehicle never pointed down.
    Missing(Side),
    /// The vehicle was turned too little.
    Coverage {
        /// Share of the directions, percent.
        percent: u8,
    },
    /// The readings do not change along all axes.
    Unchanging,
    /// The readings contradict the attitudes.
    Inconsistent {
        /// Residual, percent of the field.
        percent: u16,
    },
    /// The strength is not the earth's.
    Strength {
        /// Strength, µT.
        strength_ut: f32,
    },
}

impl fmt::Display for CompassFitError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFew { have } => {
                write!(formatter, "{have} of at least {MIN_READINGS} readings")
            }
            Self::Missing(side) => write!(formatter, "it was never {side}"),
            Self::Coverage { percent } => write!(
                formatter,
                "{percent} % of the directions are too few: turn it about all its axes"
            ),
            Self::Unchanging => formatter.write_str("an axis of the compass does not change"),
            Self::Inconsistent { percent } => write!(
                formatter,
                "the readings contradict the motion by {percent} %: \
                 go away from iron, magnets and currents, and turn it to and fro"
            ),
            Self::Strength { strength_ut } => write!(
                formatter,
                "a field of {} uT is not the earth's: go away from iron and magnets",
                *strength_ut as i32
            ),
        }
    }
}

impl core::error::Error for CompassFitError {}

impl CompassFitter {
    /// Creates a fitter without readings.
    pub const fn new() -> Self {
        Self {
            squares: [[0.0; 4]; 4],
            products: [[[0.0; 4]; 3]; 3],
            readings: 0,
            coverage: Coverage(0),
        }
    }

    /// Adds a reading on the present mount, µT in body axes, with the attitude of its time, body
    /// to earth.
    #[inline(never)]
    pub fn add(&mut self, attitude: Quaternion, reading_ut: Vector3) {
        let Vector3 { x, y, z } = reading_ut.scale(1.0 / UNIT_UT);
        let row = [x, y, z, 1.0];
        for (sums, left) in self.squares.iter_mut().zip(row) {
            accumulate(sums, left, &row);
        }
        for (column, axis) in AXES.into_iter().enumerate() {
            let Vector3 { x, y, z } = attitude.rotate(axis);
            for (sums, element) in self.products.iter_mut().zip([x, y, z]) {
                if let Some(sum) = sums.get_mut(column) {
                    accumulate(sum, element, &row);
                }
            }
        }
        self.coverage.add(attitude);
        self.readings = self.readings.saturating_add(1);
    }

    /// Returns the number of readings.
    pub const fn readings(&self) -> u32 {
        self.readings
    }

    /// Returns the directions that the vehicle has shown.
    pub const fn coverage(&self) -> Coverage {
        self.coverage
    }

    /// Fits the readings, which were taken on this mount.
    ///
    /// # Errors
    ///
    /// Returns a [`CompassFitError`] if the coverage or the residual is too poor.
    #[inline(never)]
    pub fn fit(&self, mount: Mount) -> Result<CompassFit, CompassFitError> {
        if self.readings < MIN_READINGS {
            return Err(CompassFitError::TooFew {
                have: self.readings,
            });
        }
        let percent = self.coverage.percent();
        let poor = CompassFitError::Coverage { percent };
        if percent < MIN_PERCENT {
            let missing = self.coverage.missing_side();
            return Err(missing.map_or(poor, CompassFitError::Missing));
        }
        let solved = self.solve_all().ok_or(CompassFitError::Unchanging)?;
        let matrix = self.explained(&solved);
        let (field, first) = largest(&matrix);
        let deflated = deflate(&matrix, field, first);
        let (_, second) = largest(&deflated);
        // A NaN fails every comparison.
        let is_determined = first > 0.0 && second < MAX_SECOND;
        if !is_determined {
            return Err(poor);
        }
        let unexplained = libm::sqrtf((1.0 - first).max(0.0));
        if unexplained > MAX_RESIDUAL {
            return Err(CompassFitError::Inconsistent {
                percent: (100.0 * unexplained) as u16,
            });
        }
        self.result(mount, field, unexplained, &solved)
    }

    /// Scales the solution of the regression for this field.
    #[inline(never)]
    fn result(
        &self,
        mount: Mount,
        field: Vector3,
        unexplained: f32,
        solved: &[[Row; 3]; 3],
    ) -> Result<CompassFit, CompassFitError> {
        let mut rows = [[0.0; 4]; 3];
        for (solutions, part) in solved.iter().zip([field.x, field.y, field.z]) {
            for (row, solution) in rows.iter_mut().zip(solutions) {
                accumulate(row, part, solution);
            }
        }
        let [x, y, z] = rows.map(|[x, y, z, _]| Vector3::new(x, y, z));
        let determinant = x.cross(y).dot(z);
        // A mirrored solution belongs to the opposite field.
        let scale = 1.0 / cube_root(determinant);
        let strength_ut = UNIT_UT * scale.abs();
        if !STRENGTHS_UT.contains(&strength_ut) {
            return Err(CompassFitError::Strength { strength_ut });
        }
        let [bx, by, bz] = rows.map(|[.., constant]| -constant * scale * UNIT_UT);
        let matrix = [x, y, z].map(|row| row.scale(scale));
        let (mount, matrix) = remount(mount, &matrix);
        Ok(CompassFit {
            mount,
            correction: CompassCorrection {
                matrix,
                hard_iron_ut: Vector3::new(bx, by, bz),
            },
            strength_ut,
            dip_rad: dip_rad(field.scale(scale)),
            residual_ut: unexplained * strength_ut,
        })
    }

    /// Solves the regression for each element of R; `None` if the readings do not span three axes.
    fn solve_all(&self) -> Option<[[Row; 3]; 3]> {
        let mut solved = self.products;
        for solution in solved.iter_mut().flatten() {
            *solution = self.solve(*solution)?;
        }
        Some(solved)
    }

    /// Returns the matrix whose quadratic form is the explained share of a field.
    fn explained(&self, solved: &[[Row; 3]; 3]) -> [Vector3; 3] {
        let mut matrix = [Vector3::ZERO; 3];
        let share = 1.0 / self.readings as f32;
        for (line, sums) in matrix.iter_mut().zip(&self.products) {
            for (axis, solutions) in AXES.iter().zip(solved) {
                for (sum, solution) in sums.iter().zip(solutions) {
                    *line = *line + axis.scale(share * dot(sum, solution));
                }
            }
        }
        matrix
    }

    /// Solves squares · x = right by elimination; `None` if the readings do not span three axes.
    #[inline(never)]
    fn solve(&self, right: Row) -> Option<Row> {
        let (mut matrix, mut right) = (self.squares, right);
        for pivot in 0..4 {
            let (above, below) = matrix.split_at_mut_checked(pivot + 1)?;
            let line = above.last()?;
            let diagonal = *line.get(pivot)?;
            // A NaN fails every comparison.
            let is_regular = diagonal > 1.0e-4 * self.readings as f32;
            if !is_regular {
                return None;
            }
            let value = *right.get(pivot)?;
            for (offset, other) in below.iter_mut().enumerate() {
                let factor = other.get(pivot)? / diagonal;
                accumulate(other, -factor, line);
                *right.get_mut(pivot + 1 + offset)? -= factor * value;
            }
        }
        let mut solution = [0.0; 4];
        for (pivot, line) in matrix.iter().enumerate().rev() {
            let known = dot(line, &solution);
            *solution.get_mut(pivot)? = (right.get(pivot)? - known) / line.get(pivot)?;
        }
        Some(solution)
    }
}

impl Default for CompassFitter {
    fn default() -> Self {
        Self::new()
    }
}

const AXES: [Vector3; 3] = [
    Vector3::new(1.0, 0.0, 0.0),
    Vector3::new(0.0, 1.0, 0.0),
    Vector3::new(0.0, 0.0, 1.0),
];

/// Adds `factor` times a row to sums.
#[inline(never)]
fn accumulate(sums: &mut Row, factor: f32, row: &Row) {
    for (sum, element) in sums.iter_mut().zip(row) {
        *sum += factor * element;
    }
}

#[inline(never)]
fn dot(a: &Row, b: &Row) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the eigenvector of the largest eigenvalue of a positive matrix, and that value.
#[inline(never)]
fn largest(matrix: &[Vector3; 3]) -> (Vector3, f32) {
    let times = |v: Vector3| times(matrix, v);
    let mut vector = Vector3::new(0.6, 0.48, 0.64);
    for _ in 0..STEPS {
        let next = times(vector);
        let length = next.norm();
        if length > 0.0 {
            vector = next.scale(1.0 / length);
        }
    }
    (vector, vector.dot(times(vector)))
}

/// Multiplies a matrix, by its rows, by a vector.
#[inline(never)]
fn times(matrix: &[Vector3; 3], vector: Vector3) -> Vector3 {
    let [x, y, z] = matrix;
    Vector3::new(x.dot(vector), y.dot(vector), z.dot(vector))
}

/// Returns the cube root by Newton's method: `libm` computes in double precision.
fn cube_root(value: f32) -> f32 {
    let mut root = if value < 0.0 { -1.0 } else { 1.0 };
    for _ in 0..STEPS {
        root = (2.0 * root + value / (root * root)) / 3.0;
    }
    root
}

/// Returns the angle of a field below the horizon, rad.
fn dip_rad(field: Vector3) -> f32 {
    let horizontal = libm::sqrtf(field.x * field.x + field.y * field.y);
    libm::atan2f(field.z, horizontal)
}

/// Removes an eigenvector from a matrix.
fn deflate(matrix: &[Vector3; 3], vector: Vector3, value: f32) -> [Vector3; 3] {
    let [x, y, z] = *matrix;
    [
        x - vector.scale(value * vector.x),
        y - vector.scale(value * vector.y),
        z - vector.scale(value * vector.z),
    ]
}

/// Splits a matrix for readings on a mount into the nearest mount, and the matrix on that one.
#[inline(never)]
fn remount(mount: Mount, matrix: &[Vector3; 3]) -> (Mount, [Vector3; 3]) {
    let images = AXES.map(|axis| times(matrix, mount.to_body(axis).0));
    let mut best = (mount, f32::MIN);
    for candidate in Mount::ALL {
        let alike = AXES.iter().zip(images);
        let score = alike
            .map(|(axis, image)| candidate.to_body(*axis).0.dot(image))
            .sum();
        if score > best.1 {
            best = (candidate, score);
        }
    }
    let (found, _) = best;
    let mut remounted = [Vector3::ZERO; 3];
    for (axis, image) in AXES.iter().zip(images) {
        let BodyVector(body) = found.to_body(*axis);
        for (row, part) in remounted.iter_mut().zip([image.x, image.y, image.z]) {
            *row = *row + body.scale(part);
        }
    }
    (found, remounted)
}
