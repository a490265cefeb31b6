//! The accelerometer's offset, scale and cross-axis terms, from poses at rest.
//!
//! At rest the specific force is one g whatever the pose. The fit finds offset o and symmetric matrix M so that
//! |M·(reading − o)| is one g in every pose, by Gauss-Newton on the differences (what a chip may
//! have by its datasheet is so close to none that it converges in three or four steps). A pose needs to be still, not exact.
//!
//! - Six poses, one for each side, give offset and scale of each axis.
//! - From nine well-spread poses on, the three cross-axis terms are fitted too; the guide then asks for edges.
//! - What a magnitude cannot show is a rotation of the whole triad: that is [`level`](super::level)'s part.
//!
//! How much the poses say is not guessed: from the normal equations follows by how much an error of one pose may grow in a parameter;
//! beyond 2.5 times the geometry is refused, with the directions that are missing.
//!
//! Units are g inside; [`AccelerometerCorrection`] is in m/s².

use core::fmt;

use super::Axis;
use super::record::AccelerometerCorrection;
use super::rest::{AtRest, RestScale};
use crate::attitude::Vector3;
use crate::units::STANDARD_GRAVITY_M_S2;

/// So many poses are kept.
pub const MOST_POSES: usize = 24;
/// From here on cross-axis terms can be fitted.
pub const CROSS_AXIS_POSES: usize = 9;
/// Offset and scale of three axes need so many.
pub const LEAST_POSES: usize = 6;

/// Two poses nearer than this (cosine of 20°) are the same one.
const SAME_POSE_COSINE: f32 = 0.939_692_6;
/// A pose belongs to a direction within this (cosine of 30°).
const DIRECTION_COSINE: f32 = 0.866_025_4;
/// An error of every pose may grow by so much in a parameter. Six exact poses have 0.71, nineteen random ones about 1.
const MOST_AMPLIFICATION: f32 = 2.5;
/// What a specific force at rest may read, in g (80 mg on each axis, 3 %; product specification §6.2).
const LEAST_GRAVITY_G: f32 = 0.8;
const MOST_GRAVITY_G: f32 = 1.2;
/// No sensor's offset is larger, in g: 80 mg, 60 mg over temperature (ibidem), and some more.
const LARGEST_OFFSET_G: f32 = 0.2;
/// Nor its scale error or a cross-axis term: 3 % and 2 % (ibidem), and some more.
const LARGEST_MATRIX_ERROR: f32 = 0.1;
/// Poses that disagree by more than this after the fit were not at rest, or not in a field of one g, g.
const LARGEST_RESIDUAL_G: f32 = 0.05;
/// Gauss-Newton steps; three or four are enough.
const MOST_STEPS: usize = 8;
/// A step below this changes nothing any more.
const SMALL_STEP: f32 = 1.0e-6;

/// Offset x y z, matrix xx yy zz, xy xz yz.
const PARAMETERS: usize = 9;

impl AccelerometerCorrection {
    /// No correction.
    pub const NONE: Self = Self {
        offset_m_s2: Vector3::ZERO,
        matrix: [1.0, 1.0, 1.0, 0.0, 0.0, 0.0],
    };

    /// A reading, corrected: m/s² in sensor axes.
    pub fn apply(&self, reading_m_s2: Vector3) -> Vector3 {
        self.times(reading_m_s2 - self.offset_m_s2)
    }

    /// A vector times the matrix.
    pub(crate) fn times(&self, v: Vector3) -> Vector3 {
        let [xx, yy, zz, xy, xz, yz] = self.matrix;
        Vector3::new(
            xx * v.x + xy * v.y + xz * v.z,
            xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z,
        )
    }
}

/// A pose to ask for: the direction that points up, in sensor axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Pose {
    /// One axis, up (`false`) or down (`true`).
    Side(Axis, bool),
    /// The direction between two axes, each up or down.
    Edge((Axis, bool), (Axis, bool)),
}

/// Six sides, then six edges, such that two of them lie across from each other in every plane of two axes.
const GUIDE: [Pose; 12] = {
    use Axis::{X, Y, Z};
    [
        Pose::Side(Z, false),
        Pose::Side(Z, true),
        Pose::Side(X, false),
        Pose::Side(X, true),
        Pose::Side(Y, false),
        Pose::Side(Y, true),
        Pose::Edge((X, false), (Y, false)),
        Pose::Edge((X, false), (Y, true)),
        Pose::Edge((X, false), (Z, false)),
        Pose::Edge((X, false), (Z, true)),
        Pose::Edge((Y, false), (Z, false)),
        Pose::Edge((Y, false), (Z, true)),
    ]
};

impl Pose {
    /// The poses of the guide, in its order: six sides, then six edges.
    pub const GUIDE: [Self; 12] = GUIDE;

    /// What points up, in sensor axes.
    pub fn up(self) -> Vector3 {
        match self {
            Self::Side(axis, is_down) => unit(axis, is_down),
            Self::Edge((first, first_is_down), (second, second_is_down)) => {
                (unit(first, first_is_down) + unit(second, second_is_down))
                    .scale(core::f32::consts::FRAC_1_SQRT_2)
            }
        }
    }
}

impl fmt::Display for Pose {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let way = |is_down: bool| if is_down { "down" } else { "up" };
        match *self {
            Self::Side(axis, is_down) => write!(formatter, "{axis} {}", way(is_down)),
            Self::Edge((first, first_is_down), (second, second_is_down)) => write!(
                formatter,
                "{first} {} and {second} {}, halfway between",
                way(first_is_down),
                way(second_is_down)
            ),
        }
    }
}

/// Collects poses and fits them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PoseCollector {
    g_per_count: f32,
    count: usize,
    /// In g.
    poses: [Vector3; MOST_POSES],
}

/// What a pose was taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PoseAccepted {
    /// How many there are now.
    pub count: u8,
    /// The pose of the guide that it is, if it is near one.
    pub pose: Option<Pose>,
}

/// Why a pose was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PoseRefused {
    /// It is within 20° of one that there is: which one, counted from 1.
    Repeated {
        /// That pose's number.
        number: u8,
    },
    /// The specific force is not about one g.
    NoGravity,
    /// An axis reads full scale.
    Saturated,
    /// There is no room for more.
    Full,
}

impl fmt::Display for PoseRefused {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Repeated { number } => {
                write!(
                    formatter,
                    "this is pose {number} again: turn it to another side"
                )
            }
            Self::NoGravity => formatter.write_str("the accelerometer reads no gravity"),
            Self::Saturated => formatter.write_str("the accelerometer reads full scale"),
            Self::Full => write!(formatter, "there are {MOST_POSES} poses already"),
        }
    }
}

impl core::error::Error for PoseRefused {}

impl PoseCollector {
    /// A collector for readings of this scale.
    pub fn new(scale: &RestScale) -> Self {
        Self {
            g_per_count: 1.0 / scale.counts_per_g,
            count: 0,
            poses: [Vector3::ZERO; MOST_POSES],
        }
    }

    /// Takes the mean of a rest.
    ///
    /// # Errors
    ///
    /// [`PoseRefused`]; those that there are stay.
    pub fn add(&mut self, at_rest: &AtRest) -> Result<PoseAccepted, PoseRefused> {
        let counts = at_rest.accelerometer_counts;
        if !counts.is_within(f32::from(i16::MAX) - 1.0) {
            return Err(PoseRefused::Saturated);
        }
        let pose = counts.scale(self.g_per_count);
        let norm = pose.norm();
        if !(LEAST_GRAVITY_G..=MOST_GRAVITY_G).contains(&norm) {
            return Err(PoseRefused::NoGravity);
        }
        let is_same = |other: &Vector3| pose.dot(*other) > SAME_POSE_COSINE * norm * other.norm();
        if let Some(index) = self.poses().iter().position(is_same) {
            let number = index as u8 + 1;
            return Err(PoseRefused::Repeated { number });
        }
        let place = self.poses.get_mut(self.count).ok_or(PoseRefused::Full)?;
        *place = pose;
        self.count += 1;
        Ok(PoseAccepted {
            count: self.count as u8,
            pose: GUIDE
                .into_iter()
                .find(|guide| guide.up().dot(pose) > DIRECTION_COSINE * norm),
        })
    }

    /// How many poses there are.
    pub const fn count(&self) -> usize {
        self.count
    }

    /// The pose to ask for next: the first of the guide that no pose is near to; the first of all when every one is there.
    pub fn next_pose(&self) -> Pose {
        let [first, ..] = GUIDE;
        let is_missing = |guide: &Pose| !covers(self.poses(), guide.up());
        GUIDE.into_iter().find(is_missing).unwrap_or(first)
    }

    /// Fits what there is: with at least nine well-spread poses all nine parameters, else offset and scale.
    ///
    /// # Errors
    ///
    /// [`FitError`]; more poses may mend it.
    pub fn fit(&self) -> Result<AccelerometerFit, FitError> {
        fit(self.poses())
    }

    /// The poses, in g along the sensor's axes.
    pub fn poses(&self) -> &[Vector3] {
        self.poses.get(..self.count).unwrap_or(&self.poses)
    }
}

/// What a fit found.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AccelerometerFit {
    /// What readings need.
    pub correction: AccelerometerCorrection,
    /// Root mean square of what the poses' magnitudes lack to one g, before.
    pub residual_before_g: f32,
    /// And after.
    pub residual_after_g: f32,
    /// How many poses there were.
    pub poses: usize,
    /// Whether cross-axis terms were fitted, or are taken for zero.
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

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FitError {
    /// Fewer than six poses.
    TooFew {
        /// So many there are.
        have: usize,
    },
    /// They leave some parameters open.
    BadGeometry {
        /// The sides that no pose shows; there may be none if the poses lie on a cone.
        missing: MissingSides,
    },
    /// The result is none that a working sensor has.
    Implausible,
    /// The poses contradict each other.
    Inconsistent {
        /// Root mean square of what is left, g.
        residual_g: f32,
    },
}

impl fmt::Display for FitError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooFew { have } => {
                write!(formatter, "{have} of at least {LEAST_POSES} poses")
            }
            Self::BadGeometry { missing } if missing.is_empty() => formatter
                .write_str("the poses are too much alike: add some tilted halfway between two sides"),
            Self::BadGeometry { missing } => write!(
                formatter,
                "the poses do not show every direction: missing {missing}"
            ),
            Self::Implausible => formatter.write_str(
                "no sensor has such an offset or scale: were all poses at rest, and is the range right?",
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

/// The sides of the sensor that no pose has up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MissingSides([bool; 6]);

impl MissingSides {
    fn of(poses: &[Vector3]) -> Self {
        let [a, b, c, d, e, f, ..] = GUIDE;
        Self([a, b, c, d, e, f].map(|side| !covers(poses, side.up())))
    }

    /// Whether every side is there.
    pub fn is_empty(self) -> bool {
        !self.0.contains(&true)
    }

    /// The sides.
    pub fn sides(self) -> impl Iterator<Item = Pose> {
        GUIDE
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

/// Fits poses: mean readings at rest in g along the sensor's axes, as many as there are.
///
/// # Errors
///
/// [`FitError`].
pub fn fit(poses: &[Vector3]) -> Result<AccelerometerFit, FitError> {
    if poses.len() < LEAST_POSES {
        return Err(FitError::TooFew { have: poses.len() });
    }
    let bad_geometry = FitError::BadGeometry {
        missing: MissingSides::of(poses),
    };
    let full = (poses.len() >= CROSS_AXIS_POSES)
        .then(|| solve(poses, true))
        .flatten();
    let has_cross_axis = full.is_some();
    let model = full.or_else(|| solve(poses, false)).ok_or(bad_geometry)?;
    let residual_after_g = model.residual_g(poses);
    if !model.is_plausible() {
        return Err(FitError::Implausible);
    }
    let is_consistent = residual_after_g <= LARGEST_RESIDUAL_G;
    if !is_consistent {
        return Err(FitError::Inconsistent {
            residual_g: residual_after_g,
        });
    }
    Ok(AccelerometerFit {
        correction: model.in_m_s2(),
        residual_before_g: Model::START.residual_g(poses),
        residual_after_g,
        poses: poses.len(),
        has_cross_axis,
    })
}

/// Gauss-Newton; `None` if the poses leave a parameter open.
fn solve(poses: &[Vector3], with_cross_axis: bool) -> Option<Model> {
    let mut model = Model::START;
    for _ in 0..MOST_STEPS {
        let (normal, right) = model.equations(poses, with_cross_axis);
        let factor = Cholesky::of(&normal)?;
        let step = factor.solve(&right);
        let largest = step
            .iter()
            .fold(0.0_f32, |largest, part| largest.max(part.abs()));
        for (parameter, change) in model.parameters_mut().zip(step) {
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
    let (normal, _) = model.equations(poses, with_cross_axis);
    let is_well_conditioned = Cholesky::of(&normal)?.largest_inverse_diagonal()
        <= MOST_AMPLIFICATION * MOST_AMPLIFICATION;
    is_well_conditioned.then_some(model)
}

/// f = matrix · (reading − offset), in g.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Model {
    offset: [f32; 3],
    matrix: [f32; 6],
}

impl Model {
    const START: Self = Self {
        offset: [0.0; 3],
        matrix: [1.0, 1.0, 1.0, 0.0, 0.0, 0.0],
    };

    fn parameters_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.offset.iter_mut().chain(&mut self.matrix)
    }

    fn in_m_s2(&self) -> AccelerometerCorrection {
        let [x, y, z] = self.offset;
        AccelerometerCorrection {
            offset_m_s2: Vector3::new(x, y, z).scale(STANDARD_GRAVITY_M_S2),
            matrix: self.matrix,
        }
    }

    /// The reading without its offset, and that times the matrix.
    fn apply(&self, pose: Vector3) -> (Vector3, Vector3) {
        let [x, y, z] = self.offset;
        let difference = pose - Vector3::new(x, y, z);
        let correction = AccelerometerCorrection {
            offset_m_s2: Vector3::ZERO,
            matrix: self.matrix,
        };
        (difference, correction.times(difference))
    }

    /// Root mean square of | |f| − 1 |.
    fn residual_g(&self, poses: &[Vector3]) -> f32 {
        let mut sum = 0.0;
        for pose in poses {
            let error = self.apply(*pose).1.norm() - 1.0;
            sum += error * error;
        }
        libm::sqrtf(sum / poses.len().max(1) as f32)
    }

    fn is_plausible(&self) -> bool {
        let [xx, yy, zz, xy, xz, yz] = self.matrix;
        let errors = [xx - 1.0, yy - 1.0, zz - 1.0, xy, xz, yz];
        self.offset
            .iter()
            .all(|part| part.abs() <= LARGEST_OFFSET_G)
            && errors
                .iter()
                .all(|error| error.abs() <= LARGEST_MATRIX_ERROR)
    }

    /// JᵀJ and Jᵀr of r = |f| − 1.
    fn equations(&self, poses: &[Vector3], with_cross_axis: bool) -> ([Row; PARAMETERS], Row) {
        let mut normal = [[0.0; PARAMETERS]; PARAMETERS];
        let mut right = [0.0; PARAMETERS];
        for pose in poses {
            let (d, f) = self.apply(*pose);
            let norm = f.norm().max(0.1);
            let u = f.scale(1.0 / norm);
            // ∂|f|/∂o = −M·u and ∂|f|/∂M_jk = u_j·d_k + u_k·d_j.
            let slope = -self.apply_matrix(u);
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
            let residual = norm - 1.0;
            for ((equation, right), left) in normal.iter_mut().zip(&mut right).zip(row) {
                for (sum, other) in equation.iter_mut().zip(row) {
                    *sum += left * other;
                }
                *right += left * residual;
            }
        }
        if !with_cross_axis {
            // Three equations that say "no change".
            for (index, equation) in normal.iter_mut().enumerate().skip(6) {
                if let Some(diagonal) = equation.get_mut(index) {
                    *diagonal = 1.0;
                }
            }
        }
        (normal, right)
    }

    fn apply_matrix(&self, v: Vector3) -> Vector3 {
        let correction = AccelerometerCorrection {
            offset_m_s2: Vector3::ZERO,
            matrix: self.matrix,
        };
        correction.times(v)
    }
}

type Row = [f32; PARAMETERS];

/// The lower triangle L of a matrix L·Lᵀ.
struct Cholesky([Row; PARAMETERS]);

impl Cholesky {
    /// `None` if the matrix is singular as far as `f32` can tell.
    fn of(matrix: &[Row; PARAMETERS]) -> Option<Self> {
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

    /// x of L·Lᵀ·x = right.
    fn solve(&self, right: &Row) -> Row {
        let mut x = *right;
        // L·y = right from above, then Lᵀ·x = y from below; what is solved is spread at once.
        for index in 0..PARAMETERS {
            let column = self.0.map(|row| entry(&row, index));
            eliminate(&mut x, &column, index, index + 1..PARAMETERS);
        }
        for (index, row) in self.0.iter().enumerate().rev() {
            eliminate(&mut x, row, index, 0..index);
        }
        x
    }

    /// The largest variance of a parameter per variance of a pose.
    fn largest_inverse_diagonal(&self) -> f32 {
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

/// Solves for one unknown and takes it out of the others of this range.
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

fn dot(a: &Row, b: &Row) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn entry(row: &Row, index: usize) -> f32 {
    row.get(index).copied().unwrap_or(1.0)
}

/// Whether a pose has this direction up, within 30°.
fn covers(poses: &[Vector3], up: Vector3) -> bool {
    poses
        .iter()
        .any(|pose| pose.dot(up) > DIRECTION_COSINE * pose.norm())
}

fn unit(axis: Axis, is_down: bool) -> Vector3 {
    let length = if is_down { -1.0 } else { 1.0 };
    match axis {
        Axis::X => Vector3::new(length, 0.0, 0.0),
        Axis::Y => Vector3::new(0.0, length, 0.0),
        Axis::Z => Vector3::new(0.0, 0.0, length),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::radians;

    const SCALE: RestScale = RestScale {
        counts_per_degree_s: 16.4,
        counts_per_g: 2048.0,
        gyroscope_sigma_counts: 1.2,
        accelerometer_sigma_counts: 11.0,
        gyroscope_correlation: 2.7,
        accelerometer_correlation: 2.7,
    };

    /// A sensor with every error: reading = S·f + o, in g.
    fn reading(force: Vector3) -> Vector3 {
        Vector3::new(
            1.02 * force.x + 0.008 * force.y - 0.004 * force.z + 0.03,
            0.008 * force.x + 0.985 * force.y + 0.006 * force.z - 0.045,
            -0.004 * force.x + 0.006 * force.y + 1.01 * force.z + 0.06,
        )
    }

    fn at_rest(reading_g: Vector3) -> AtRest {
        AtRest {
            accelerometer_counts: reading_g.scale(SCALE.counts_per_g),
            samples: 1000,
            ..AtRest::default()
        }
    }

    fn collected(poses: impl IntoIterator<Item = Pose>) -> PoseCollector {
        let mut collector = PoseCollector::new(&SCALE);
        for pose in poses {
            collector
                .add(&at_rest(reading(pose.up())))
                .expect("a new pose");
        }
        collector
    }

    #[test]
    fn twelve_poses_find_all_nine_parameters() {
        let fit = collected(GUIDE).fit().expect("a fit");
        assert!(fit.has_cross_axis);
        assert_eq!(fit.poses, 12);
        assert!(
            fit.residual_before_g > 0.03 && fit.residual_after_g < 1e-5,
            "{fit:?}"
        );
        for force in [Vector3::new(0.48, -0.6, 0.64), Vector3::new(-0.8, 0.6, 0.0)] {
            let read = reading(force).scale(STANDARD_GRAVITY_M_S2);
            let corrected = fit
                .correction
                .apply(read)
                .scale(1.0 / STANDARD_GRAVITY_M_S2);
            assert!((corrected - force).norm() < 1e-4, "{corrected:?}");
        }
        let text = fit.to_string();
        assert!(
            text.starts_with("12 poses, offset, scale and cross-axis: residual "),
            "{text}"
        );
        assert!(text.ends_with(", 0.00 mg after"), "{text}");
    }

    #[test]
    fn six_poses_find_offset_and_scale() {
        let fit = collected(GUIDE.into_iter().take(6)).fit().expect("a fit");
        assert!(!fit.has_cross_axis);
        assert_eq!(fit.correction.matrix[3..], [0.0; 3]);
        let offset = fit
            .correction
            .offset_m_s2
            .scale(1.0 / STANDARD_GRAVITY_M_S2);
        // What the cross-axis terms turn into is of second order.
        assert!(
            (offset - Vector3::new(0.03, -0.045, 0.06)).is_within(2e-3),
            "{offset:?}"
        );
        assert!((fit.correction.matrix[0] - 1.0 / 1.02).abs() < 1e-3);
    }

    #[test]
    fn the_guide_goes_through_its_poses_and_says_them_plainly() {
        let mut collector = PoseCollector::new(&SCALE);
        for (index, pose) in GUIDE.into_iter().enumerate() {
            assert_eq!(collector.next_pose(), pose);
            assert_eq!(collector.count(), index);
            let accepted = collector.add(&at_rest(reading(pose.up()))).expect("new");
            assert_eq!(
                (usize::from(accepted.count), accepted.pose),
                (index + 1, Some(pose))
            );
        }
        assert_eq!(collector.next_pose(), GUIDE[0]);
        assert_eq!(GUIDE[0].to_string(), "z up");
        assert_eq!(GUIDE[7].to_string(), "x up and y down, halfway between");
    }

    #[test]
    fn poses_that_say_nothing_new_are_refused() {
        let mut collector = collected(GUIDE.into_iter().take(2));
        let almost = Vector3::new(0.2, 0.2, 0.96);
        let refused = collector.add(&at_rest(reading(almost))).unwrap_err();
        assert_eq!(refused, PoseRefused::Repeated { number: 1 });
        assert_eq!(
            refused.to_string(),
            "this is pose 1 again: turn it to another side"
        );
        let fall = collector.add(&at_rest(Vector3::new(0.1, 0.0, 0.3)));
        assert_eq!(fall, Err(PoseRefused::NoGravity));
        let nan = collector.add(&at_rest(Vector3::new(f32::NAN, 0.0, 1.0)));
        assert_eq!(nan, Err(PoseRefused::Saturated));
        let full_scale = AtRest {
            accelerometer_counts: Vector3::new(32767.0, 0.0, 0.0),
            ..AtRest::default()
        };
        assert_eq!(collector.add(&full_scale), Err(PoseRefused::Saturated));
        assert_eq!(collector.count(), 2, "what was refused is not there");
    }

    #[test]
    fn there_is_an_end_to_the_poses() {
        let mut collector = PoseCollector::new(&SCALE);
        // A spiral whose turns are 20° apart and more.
        let mut refused = None;
        for index in 0..40 {
            let z = 1.0 - (2.0 * index as f32 + 1.0) / 40.0;
            let (sine, cosine) = (index as f32 * 2.399_963).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let pose = Vector3::new(across * cosine, across * sine, z);
            if let Err(reason) = collector.add(&at_rest(pose)) {
                refused = Some(reason);
            }
        }
        assert_eq!(refused, Some(PoseRefused::Full));
        assert_eq!(collector.count(), MOST_POSES);
        assert!(collector.fit().expect("a perfect sensor").residual_after_g < 1e-5);
    }

    #[test]
    fn bad_geometry_is_refused_with_what_is_missing() {
        let few = collected(GUIDE.into_iter().take(4)).fit().unwrap_err();
        assert_eq!(few.to_string(), "4 of at least 6 poses");
        // Never upside down nor on its sides: a ring of poses and its pole.
        let ring = (0..8).map(|index| {
            let (sine, cosine) = (index as f32 * 0.785).sin_cos();
            reading(Vector3::new(0.5 * cosine, 0.5 * sine, 0.866))
        });
        let poses: std::vec::Vec<_> = ring.chain([reading(Vector3::new(0.0, 0.0, 1.0))]).collect();
        let error = fit(&poses).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the poses do not show every direction: missing z down, x up, x down, y up, y down"
        );
        // All six sides but one.
        let poses: std::vec::Vec<_> = [0, 2, 3, 4, 5, 6]
            .map(|index| reading(GUIDE[index].up()))
            .to_vec();
        let error = fit(&poses).unwrap_err();
        assert!(error.to_string().ends_with("missing z down"), "{error}");
    }

    #[test]
    fn a_geometry_that_is_regular_but_weak_is_refused() {
        // Three rings down to 70° from z up: scale and offset of z can hardly be told apart.
        let ring = |polar: f32, number: u32| {
            (0..number).map(move |index| {
                let azimuth = core::f32::consts::TAU * index as f32 / number as f32;
                let (sine, cosine) = azimuth.sin_cos();
                let across = polar.sin();
                reading(Vector3::new(across * cosine, across * sine, polar.cos()))
            })
        };
        let cap = |widest: f32| -> std::vec::Vec<Vector3> {
            ring(0.0, 1)
                .chain(ring(radians(35.0), 6))
                .chain(ring(radians(widest), 8))
                .collect()
        };
        let error = fit(&cap(70.0)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the poses do not show every direction: missing z down"
        );
        assert!(fit(&cap(140.0)).is_ok());
    }

    #[test]
    fn what_no_sensor_does_is_refused() {
        let poses = GUIDE.map(|pose| pose.up().scale(1.18));
        assert_eq!(fit(&poses), Err(FitError::Implausible));
        let mut poses = GUIDE.map(|pose| reading(pose.up()));
        poses[6] = poses[6].scale(1.25);
        poses[9] = poses[9].scale(0.75);
        let error = fit(&poses).unwrap_err();
        assert!(
            matches!(error, FitError::Inconsistent { .. } | FitError::Implausible),
            "{error}"
        );
        assert!(fit(&[Vector3::new(f32::NAN, 0.0, 0.0); 12]).is_err());
        assert!(fit(&[Vector3::ZERO; 12]).is_err());
    }

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
        let solved = Cholesky::of(&matrix).expect("regular").solve(&right);
        for (found, expected) in solved.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{solved:?}");
        }
        assert!(Cholesky::of(&[[1.0; PARAMETERS]; PARAMETERS]).is_none());
    }
}
