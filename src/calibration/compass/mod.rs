//! Compass: its place in the vehicle, its correction, and the fit of the correction.
//!
//! | module | job |
//! |---|---|
//! | `correction` | hard iron, soft iron and gains, applied to a reading |
//! | `fit` | all of them by one linear fit, with the attitudes of the filter |
//! | `coverage` | directions that the vehicle has shown |

mod correction;
mod coverage;
mod fit;
#[cfg(test)]
mod tests;

pub use correction::{CompassAlignment, CompassCorrection};
pub use coverage::{Coverage, Side};
pub use fit::{CompassFit, CompassFitError, CompassFitter};
