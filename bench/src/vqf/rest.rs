//! Rest detection of VQF.
//!
//! The sensor rests once both signals have stayed near their low-passed values for a while.

use aplomb_models::motion::geometry::{Vector, dot, subtract};

use super::bias::LIMIT_RAD_S;
use super::low_pass::LowPass;

/// Time constant of the signals' references, s.
const REFERENCE_S: f64 = 0.5;
/// Least distance of a rate from its reference that is motion: 2 °/s.
const RATE_THRESHOLD_RAD_S: f64 = 2.0 / 180.0 * std::f64::consts::PI;
/// Least distance of a specific force from its reference that is motion.
const FORCE_THRESHOLD_M_S2: f64 = 0.5;
/// Least time without motion, s.
const SHORTEST_S: f64 = 1.5;

/// Rest detector.
pub struct RestDetector {
    step_s: f64,
    rates: LowPass<3>,
    forces: LowPass<3>,
    /// Low-passed rate, rad/s.
    mean_rate_rad_s: Vector,
    still_s: f64,
    is_at_rest: bool,
}

impl RestDetector {
    /// Creates a detector for samples that are `step_s` apart.
    pub fn new(step_s: f64) -> Self {
        Self {
            step_s,
            rates: LowPass::new(REFERENCE_S, step_s),
            forces: LowPass::new(REFERENCE_S, step_s),
            mean_rate_rad_s: [0.0; 3],
            still_s: 0.0,
            is_at_rest: false,
        }
    }

    /// Takes a measured rate. A mean rate that no bias explains is motion too.
    pub fn add_rate(&mut self, rate_rad_s: Vector) {
        let mean = self.rates.update(rate_rad_s);
        self.mean_rate_rad_s = mean;
        let is_fast = mean.iter().any(|axis| axis.abs() > LIMIT_RAD_S);
        if is_fast || differ(rate_rad_s, mean, RATE_THRESHOLD_RAD_S) {
            self.note_motion();
        }
    }

    /// Takes the specific force of the same sample.
    pub fn add_force(&mut self, force_m_s2: Vector) {
        let mean = self.forces.update(force_m_s2);
        if differ(force_m_s2, mean, FORCE_THRESHOLD_M_S2) {
            self.note_motion();
            return;
        }
        self.still_s += self.step_s;
        self.is_at_rest |= self.still_s >= SHORTEST_S;
    }

    /// Returns the low-passed rate, rad/s.
    pub const fn mean_rate_rad_s(&self) -> Vector {
        self.mean_rate_rad_s
    }

    /// Returns the rate at rest, which is the gyroscope's bias, rad/s; `None` in motion.
    pub fn rate_at_rest_rad_s(&self) -> Option<Vector> {
        self.is_at_rest.then_some(self.mean_rate_rad_s)
    }

    fn note_motion(&mut self) {
        self.still_s = 0.0;
        self.is_at_rest = false;
    }
}

/// Returns whether two vectors differ by this much or more.
fn differ(left: Vector, right: Vector, least: f64) -> bool {
    let difference = subtract(left, right);
    dot(difference, difference) >= least * least
}
