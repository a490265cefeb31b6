//! Gyroscope fit: scale and cross-axis terms from turns between stationary poses.
//!
//! The accelerometer, calibrated before, shows up in the poses before and after a turn. The
//! integral of the rates leads from one to the other. The error that is left shows the gyroscope's
//! matrix (Tedaldi, Pretto and Menegatti, "A robust and easy to implement method for IMU
//! calibration without external equipments", ICRA 2014).
//!
//! Let ω be the measured rates, ω − E·ω the true ones, and R(t) the rotation from the axes at
//! time t to those at the start. Then the turn is wrong by the small rotation
//!
//! ```text
//! δ = −Σ_jl (∫R_j·ω_l dt)·E_jl        R_j: column j of R
//! ```
//!
//! [`TurnIntegrator`] integrates R and the nine factors of E, sample by sample. Each turn then
//! gives equations that are linear in E:
//!
//! ```text
//! up₀ − R·up₁ = δ × (up₀ + R·up₁)/2
//! ```
//!
//! [`TurnCollector`] collects turns and solves the equations by least squares.
//!
//! A turn about the vertical shows nothing. The twelve poses of the accelerometer's guide have
//! eleven turns about level axes, which are enough.
//!
//! ```
//! use aplomb::attitude::Vector3;
//! use aplomb::calibration::gyroscope::{TurnCollector, TurnIntegrator};
//! use aplomb::calibration::{AccelerometerCorrection, NoiseModel, SensorSetup, StationaryMean};
//!
//! let noise = NoiseModel::new(&SensorSetup {
//!     gyroscope_counts_per_degree_s: 16.4,
//!     accelerometer_counts_per_g: 2048.0,
//!     gyroscope_bandwidth_hz: 188.0,
//!     accelerometer_bandwidth_hz: 184.0,
//!     sample_rate_hz: 1000.0,
//! });
//! let pose = |x, z| StationaryMean {
//!     accelerometer_counts: Vector3::new(x, 0.0, z),
//!     ..StationaryMean::default()
//! };
//! let mut integrator = TurnIntegrator::new(&noise);
//! let mut turns = TurnCollector::new();
//! // Means come from the stationary detector, readings from the sensor.
//! assert!(integrator.finish(&pose(0.0, 2048.0)).is_none());
//! for sample in 0..=1000 {
//!     integrator.update([0, 1476, 0], 1_000 * sample); // 90 °/s about y for a second
//! }
//! let turn = integrator.finish(&pose(-2048.0, 0.0)).expect("a turn of 90°");
//! turns.add(&turn);
//! let few = turns.fit(&AccelerometerCorrection::NONE).unwrap_err();
//! assert_eq!(few.to_string(), "1 of at least 8 turns");
//! ```

mod fit;
#[cfg(test)]
mod tests;
mod turn;

pub use fit::{GyroscopeFit, GyroscopeFitError, MAX_TURNS, MIN_TURNS, TurnCollector};
pub use turn::{Turn, TurnIntegrator};
