//! Accelerometer fit: offset, scale and cross-axis terms from stationary poses.
//!
//! At rest the specific force is one g in every pose. The fit finds the offset o and the symmetric
//! matrix M for which |M·(reading − o)| is one g in all poses. It is a Gauss-Newton least
//! squares on
//! |f| − 1 g; chips within their datasheet are so close to the start that three or four steps are
//! enough. A pose needs to be stationary, not exact.
//!
//! - Six poses, one for each side, give offset and scale of each axis.
//! - Nine well-spread poses or more give the three cross-axis terms too; the guide then asks for
//!   edges.
//! - A magnitude cannot show a rotation of the whole triad: [`level`](super::level) finds that.
//!
//! The normal equations show how much the error of one pose can grow in a parameter. The fit
//! refuses a geometry that amplifies it more than 2.5 times, and names the missing directions.
//!
//! Units are g inside; an [`AccelerometerCorrection`](super::AccelerometerCorrection) is in m/s².
//!
//! ```
//! use aplomb::attitude::Vector3;
//! use aplomb::calibration::accelerometer::{Pose, fit};
//!
//! // Mean readings of a sensor with an offset of 30 mg on its X axis, in g.
//! let readings = Pose::GUIDE.map(|pose| pose.up() + Vector3::new(0.03, 0.0, 0.0));
//! let found = fit(&readings)?;
//! assert!((found.correction.offset_m_s2.x - 0.294).abs() < 0.001);
//! assert!(found.has_cross_axis && found.residual_after_g < 1e-5);
//! # Ok::<(), aplomb::calibration::accelerometer::FitError>(())
//! ```

mod collector;
mod fit;
mod pose;
#[cfg(test)]
mod tests;

pub use collector::{AcceptedPose, MAX_POSES, PoseCollector, PoseError};
pub use fit::{AccelerometerFit, FitError, MIN_CROSS_AXIS_POSES, MIN_POSES, MissingSides, fit};
pub use pose::Pose;
