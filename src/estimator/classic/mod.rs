//! The tutorial's filters, for comparison.
//!
//! Neither reports σ, and neither finds the gyroscope's offset well enough in motion. The offset
//! has to be averaged at rest and removed first, as in
//! [`ClassicPipeline`](crate::pipeline::classic::ClassicPipeline).
//!
//! - [`Tutorial`]: the tutorial's formulas, one by one;
//! - [`AxisKalman`]: the same two Kalman filters with exact kinematics.
//!
//! ```
//! use aplomb::attitude::BodyVector;
//! use aplomb::estimator::classic::Tutorial;
//! use aplomb::estimator::{Estimator, Sample};
//!
//! let mut estimator = Estimator::with_filter(Tutorial::new());
//! let level = BodyVector::new(0.0, 0.0, -9.81);
//! estimator.update(&Sample::new(0, level, BodyVector::ZERO));
//! assert!(estimator.filter().angles().roll_deg.abs() < 0.1);
//! ```

mod angle_bias;
mod axis_kalman;
mod tutorial;

pub use axis_kalman::AxisKalman;
pub use tutorial::{ClassicAngles, Tutorial, pitch_deg, roll_deg};
