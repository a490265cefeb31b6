//! Fit of the gyroscope's scale and cross-axis terms to turns.

use core::fmt;

use super::super::cholesky::{Cholesky, NormalEquations, PARAMETERS, dot};
use super::super::matrix::Matrix3;
use super::super::model::AccelerometerCorrection;
use super::turn::Turn;
use crate::attitude::Vector3;
use crate::units::{STANDARD_GRAVITY_M_S2, degrees, radians};

/// Largest number of turns.
pub const MAX_TURNS: usize = 16;
/// Smallest number of turns for a fit.
pub const MIN_TURNS: usize = 8;

/// Largest growth of a pose's error, rad, in an element of the matrix. The guide's eleven turns
/// have 0.7.
const MAX_AMPLIFICATION: f32 = 1.5;
/// Largest scale error or cross-axis term of a sensor: 3 % and 2 % (product specification §6.1),
/// and a margin. The console's `gyro-matrix` takes no more. `Calibration::check` takes 0.1, which
/// includes the rounding.
const MAX_MATRIX_ERROR: f32 = 0.0999;
/// Largest residual of turns between poses at rest, rad.
const MAX_RESIDUAL_RAD: f32 = radians(1.0);

/// Result of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeFit {
    /// Correction of the rates.
    pub matrix: Matrix3,
    /// Root mean square of the angle between the directions after a turn by the accelerometer and
    /// by the uncorrected rates, rad.
    pub residual_before_rad: f32,
    /// Root mean square of that angle with corrected rates, rad.
    pub residual_after_rad: f32,
    /// Number of turns.
    pub turns: usize,
}

impl fmt::Display for GyroscopeFit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let centidegrees = |angle_rad: f32| (degrees(angle_rad) * 100.0 + 0.5) as u32;
        let before = centidegrees(self.residual_before_rad);
        let after = centidegrees(self.residual_after_rad);
        write!(
            formatter,
            "{} turns, gyroscope scale and cross-axis: residual {}.{:02} deg before, \
             {}.{:02} deg after",
            self.turns,
            before / 100,
            before % 100,
            after / 100,
            after % 100,
        )
    }
}

/// Reason why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum GyroscopeFitError {
    /// Fewer than [`MIN_TURNS`] turns were collected.
    TooFew {
        /// Number of turns.
        have: usize,
    },
    /// The turns do not determine every element.
    BadGeometry,
    /// No working sensor has such a matrix.
    Implausible,
    /// The turns contradict each other.
    Inconsistent {
        /// Root mean square of the residual after the fit, rad.
        residual_rad: f32,
    },
}

impl fmt::Display for GyroscopeFitError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFew { have } => write!(formatter, "{have} of at least {MIN_TURNS} turns"),
            Self::BadGeometry => formatter.write_str(
                "the turns do not show every axis: lay it in the twelve poses, in another order",
            ),
            Self::Implausible => formatter.write_str(
                "no sensor has such scales: were all poses at rest, and is the range right?",
            ),
            Self::Inconsistent { residual_rad } => write!(
                formatter,
                "the turns contradict the poses by {} deg: turn it more slowly",
                (degrees(*residual_rad) + 0.5) as u32
            ),
        }
    }
}

impl core::error::Error for GyroscopeFitError {}

/// Collects turns, and fits the gyroscope's matrix to them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TurnCollector {
    count: usize,
    turns: [Option<Turn>; MAX_TURNS],
}

impl Default for TurnCollector {
    fn default() -> Self {
        Self::new()
    }
}

impl TurnCollector {
    /// Creates an empty collector.
    pub const fn new() -> Self {
        Self {
            count: 0,
            turns: [None; MAX_TURNS],
        }
    }

    /// Adds a turn. Beyond [`MAX_TURNS`] the oldest one is forgotten.
    pub fn add(&mut self, turn: &Turn) {
        if let Some(place) = self.turns.get_mut(self.count % MAX_TURNS) {
            *place = Some(*turn);
        }
        self.count += 1;
    }

    /// Fits the matrix, with this correction of the accelerometer's readings.
    ///
    /// The correction has to include cross-axis terms: the directions of the poses are the
    /// reference.
    ///
    /// # Errors
    ///
    /// Returns a [`GyroscopeFitError`]; more turns may help.
    pub fn fit(
        &self,
        accelerometer: &AccelerometerCorrection,
    ) -> Result<GyroscopeFit, GyroscopeFitError> {
        let turns = self.count.min(MAX_TURNS);
        if turns < MIN_TURNS {
            return Err(GyroscopeFitError::TooFew { have: turns });
        }
        let mut normal = NormalEquations::NONE;
        let mut squares_before = 0.0;
        for turn in self.turns.iter().flatten() {
            let Equations { slopes, difference } = Equations::of(turn, accelerometer);
            normal.add(&slopes.map(|slope| slope.x), difference.x);
            normal.add(&slopes.map(|slope| slope.y), difference.y);
            normal.add(&slopes.map(|slope| slope.z), difference.z);
            squares_before += difference.dot(difference);
        }
        let factored = Cholesky::factor(&normal.matrix)
            .filter(|factored| {
                factored.largest_inverse_diagonal() <= MAX_AMPLIFICATION * MAX_AMPLIFICATION
            })
            .ok_or(GyroscopeFitError::BadGeometry)?;
        let errors = factored.solve(&normal.right);
        // The squares that are left, by the normal equations.
        let squares_after = squares_before - dot(&errors, &normal.right);
        let residual_rad = |squares: f32| libm::sqrtf(squares.max(0.0) / turns as f32);
        let residual_after_rad = residual_rad(squares_after);
        // A NaN fails every comparison.
        if !errors.iter().all(|error| error.abs() <= MAX_MATRIX_ERROR) {
            return Err(GyroscopeFitError::Implausible);
        }
        if residual_after_rad > MAX_RESIDUAL_RAD {
            return Err(GyroscopeFitError::Inconsistent {
                residual_rad: residual_after_rad,
            });
        }
        let [xx, xy, xz, yx, yy, yz, zx, zy, zz] = errors;
        Ok(GyroscopeFit {
            matrix: Matrix3 {
                rows: [
                    Vector3::new(1.0 - xx, -xy, -xz),
                    Vector3::new(-yx, 1.0 - yy, -yz),
                    Vector3::new(-zx, -zy, 1.0 - zz),
                ],
            },
            residual_before_rad: residual_rad(squares_before),
            residual_after_rad,
            turns,
        })
    }
}

/// Equations of one turn for the elements E_jl by rows:
/// up₀ − R·up₁ = δ × (up₀ + R·up₁)/2.
struct Equations {
    /// Derivative of δ × (up₀ + R·up₁)/2 by each element.
    slopes: [Vector3; PARAMETERS],
    /// Difference up₀ − R·up₁.
    difference: Vector3,
}

impl Equations {
    fn of(turn: &Turn, accelerometer: &AccelerometerCorrection) -> Self {
        let up = |reading_g: Vector3| {
            let force = accelerometer.apply(reading_g.scale(STANDARD_GRAVITY_M_S2));
            force.scale(1.0 / force.norm().max(1.0))
        };
        let (before, after) = (up(turn.start), turn.integral.at_start(up(turn.end)));
        let middle = (before + after).scale(0.5);
        let mut slopes = [Vector3::ZERO; PARAMETERS];
        for (slope, effect) in slopes.iter_mut().zip(turn.integral.effects.as_flattened()) {
            *slope = middle.cross(*effect);
        }
        Self {
            slopes,
            difference: before - after,
        }
    }
}
