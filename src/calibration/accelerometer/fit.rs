//! Fit of offset, scale and cross-axis terms to the readings of poses.

use core::fmt;

use super::super::cholesky::{Cholesky, NormalEquations, PARAMETERS};
use super::super::matrix::SymmetricMatrix;
use super::super::model::AccelerometerCorrection;
use super::pose::{Pose, covers};
use crate::attitude::Vector3;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Smallest number of poses for a fit of offset and scale.
pub const MIN_POSES: usize = 6;
/// Smallest number of poses for a fit with cross-axis terms.
pub const MIN_CROSS_AXIS_POSES: usize = 9;

/// Largest growth of a pose's error in a parameter. Six exact poses have 0.71, nineteen random ones
/// about 1.
const MAX_AMPLIFICATION: f32 = 2.5;
/// Largest residual of poses at rest in a field of one g, g.
const MAX_RESIDUAL_G: f32 = 0.05;
/// Largest number of Gauss-Newton steps; three or four are enough.
const MAX_STEPS: usize = 8;
/// Step below which the solution has converged.
const SMALL_STEP: f32 = 1.0e-6;
/// Number of parameters without cross-axis terms.
const DIAGONAL_PARAMETERS: usize = 6;

/// Result of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AccelerometerFit {
    /// Correction of the readings.
    pub correction: AccelerometerCorrection,
    /// Root mean square of |reading| − 1 g before the correction, g.
    pub residual_before_g: f32,
    /// Root mean square of |reading| − 1 g after the correction, g.
    pub residual_after_g: f32,
    /// Number of poses.
    pub poses: usize,
    /// True if the cross-axis terms were fitted; otherwise they are zero.
    pub has_cross_axis: bool,
}

impl fmt::Display for AccelerometerFit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let micro_g = |g: f32| (g * 1.0e6 + 0.5) as u32;
        let (before, after) = (
            micro_g(self.residual_before_g),
            micro_g(self.residual_after_g),
        );
        write!(
            formatter,
            "{} poses, {}: residual {}.{:02} mg before, {}.{:02} mg after",
            self.poses,
            if self.has_cross_axis {
                "offset, scale and cross-axis"
            } else {
                "offset and scale"
            },
            before / 1000,
            before % 1000 / 10,
            after / 1000,
            after % 1000 / 10,
        )
    }
}

/// Reason why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum FitError {
    /// Fewer than [`MIN_POSES`] poses were given.
    TooFew {
        /// Number of poses.
        have: usize,
    },
    /// The poses do not determine every parameter.
    BadGeometry {
        /// Sides that no pose shows; none are missing if the poses lie on a cone.
        missing: MissingSides,
    },
    /// No working sensor has such parameters.
    Implausible,
    /// The poses contradict each other.
    Inconsistent {
        /// Root mean square of the residual after the fit, g.
        residual_g: f32,
    },
}

impl fmt::Display for FitError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFew { have } => {
                write!(formatter, "{have} of at least {MIN_POSES} poses")
            }
            Self::BadGeometry { missing } if missing.is_empty() => formatter.write_str(
                "the poses are too much alike: add some tilted halfway between two sides",
            ),
            Self::BadGeometry { missing } => write!(
                formatter,
                "the poses do not show every direction: missing {missing}"
            ),
            Self::Implausible => formatter.write_str(
                "no sensor has such an offset or scale: \
                 were all poses at rest, and is the range right?",
            ),
            Self::Inconsistent { residual_g } => write!(
                formatter,
                "the poses contradict each other by {} mg: one was not at rest",
                (residual_g * 1000.0 + 0.5) as u32
            ),
        }
    }
}

impl core::error::Error for FitError {}

/// Sides of the sensor that no pose shows up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MissingSides([bool; 6]);

impl MissingSides {
    fn of(readings: &[Vector3]) -> Self {
        let [a, b, c, d, e, f, ..] = Pose::GUIDE;
        Self([a, b, c, d, e, f].map(|side| !covers(readings, side.up())))
    }

    /// Returns whether no side is missing.
    pub fn is_empty(self) -> bool {
        !self.0.contains(&true)
    }

    /// Returns the missing sides.
    pub fn sides(self) -> impl Iterator<Item = Pose> {
        Pose::GUIDE
            .into_iter()
            .zip(self.0)
            .filter_map(|(side, is_missing)| is_missing.then_some(side))
    }
}

impl fmt::Display for MissingSides {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, side) in self.sides().enumerate() {
            let separator = if index == 0 { "" } else { ", " };
            write!(formatter, "{separator}{side}")?;
        }
        Ok(())
    }
}

/// Fits the mean readings of poses, g along the sensor's axes.
///
/// Fits all nine parameters to nine well-spread poses or more, else offset and scale.
///
/// # Errors
///
/// Returns a [`FitError`] if there are too few poses, if they do not determine the parameters, or
/// if the result is implausible.
pub fn fit(readings: &[Vector3]) -> Result<AccelerometerFit, FitError> {
    if readings.len() < MIN_POSES {
        return Err(FitError::TooFew {
            have: readings.len(),
        });
    }
    let bad_geometry = FitError::BadGeometry {
        missing: MissingSides::of(readings),
    };
    let full = (readings.len() >= MIN_CROSS_AXIS_POSES)
        .then(|| solve(readings, true))
        .flatten();
    let has_cross_axis = full.is_some();
    let model = full
        .or_else(|| solve(readings, false))
        .ok_or(bad_geometry)?;
    let residual_after_g = model.residual_g(readings);
    let correction = model.in_m_s2();
    if !correction.is_plausible() {
        return Err(FitError::Implausible);
    }
    let is_consistent = residual_after_g <= MAX_RESIDUAL_G;
    if !is_consistent {
        return Err(FitError::Inconsistent {
            residual_g: residual_after_g,
        });
    }
    Ok(AccelerometerFit {
        correction,
        residual_before_g: Model::START.residual_g(readings),
        residual_after_g,
        poses: readings.len(),
        has_cross_axis,
    })
}

/// Solves by Gauss-Newton; `None` if the readings do not determine a parameter.
fn solve(readings: &[Vector3], with_cross_axis: bool) -> Option<Model> {
    let mut model = Model::START;
    for _ in 0..MAX_STEPS {
        let normal = model.equations(readings, with_cross_axis);
        let step = Cholesky::factor(&normal.matrix)?.solve(&normal.right);
        let largest = step
            .iter()
            .fold(0.0_f32, |largest, part| largest.max(part.abs()));
        for (parameter, change) in model.parameters_mut().into_iter().zip(step) {
            *parameter -= change;
        }
        // A NaN fails every comparison.
        let is_converging = largest < 1.0;
        if !is_converging {
            return None;
        }
        if largest < SMALL_STEP {
            break;
        }
    }
    let normal = model.equations(readings, with_cross_axis);
    let is_well_conditioned = Cholesky::factor(&normal.matrix)?.largest_inverse_diagonal()
        <= MAX_AMPLIFICATION * MAX_AMPLIFICATION;
    is_well_conditioned.then_some(model)
}

/// Model f = matrix · (reading − offset), in g.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Model {
    offset: Vector3,
    matrix: SymmetricMatrix,
}

impl Model {
    const START: Self = Self {
        offset: Vector3::ZERO,
        matrix: SymmetricMatrix::IDENTITY,
    };

    /// Returns the parameters in the order of the equations.
    fn parameters_mut(&mut self) -> [&mut f32; PARAMETERS] {
        let Self { offset, matrix } = self;
        [
            &mut offset.x,
            &mut offset.y,
            &mut offset.z,
            &mut matrix.xx,
            &mut matrix.yy,
            &mut matrix.zz,
            &mut matrix.xy,
            &mut matrix.xz,
            &mut matrix.yz,
        ]
    }

    fn in_m_s2(&self) -> AccelerometerCorrection {
        AccelerometerCorrection {
            offset_m_s2: self.offset.scale(STANDARD_GRAVITY_M_S2),
            matrix: self.matrix,
        }
    }

    /// Returns the root mean square of |f| − 1.
    fn residual_g(&self, readings: &[Vector3]) -> f32 {
        let mut sum = 0.0;
        for reading in readings {
            let error = self.matrix.times(*reading - self.offset).norm() - 1.0;
            sum += error * error;
        }
        libm::sqrtf(sum / readings.len().max(1) as f32)
    }

    /// Returns the equations of the residual r = |f| − 1.
    fn equations(&self, readings: &[Vector3], with_cross_axis: bool) -> NormalEquations {
        let mut normal = NormalEquations::NONE;
        for reading in readings {
            let d = *reading - self.offset;
            let f = self.matrix.times(d);
            let norm = f.norm().max(0.1);
            let u = f.scale(1.0 / norm);
            // ∂|f|/∂o = −M·u and ∂|f|/∂M_jk = u_j·d_k + u_k·d_j.
            let slope = -self.matrix.times(u);
            let cross = if with_cross_axis { 1.0 } else { 0.0 };
            let row = [
                slope.x,
                slope.y,
                slope.z,
                u.x * d.x,
                u.y * d.y,
                u.z * d.z,
                cross * (u.x * d.y + u.y * d.x),
                cross * (u.x * d.z + u.z * d.x),
                cross * (u.y * d.z + u.z * d.y),
            ];
            normal.add(&row, norm - 1.0);
        }
        if !with_cross_axis {
            // Three equations that keep the cross-axis terms at zero.
            for (index, equation) in normal
                .matrix
                .iter_mut()
                .enumerate()
                .skip(DIAGONAL_PARAMETERS)
            {
                if let Some(diagonal) = equation.get_mut(index) {
                    *diagonal = 1.0;
                }
            }
        }
        normal
    }
}
