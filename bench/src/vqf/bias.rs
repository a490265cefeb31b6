//! Estimation of the gyroscope's bias in VQF, in motion and at rest.
//!
//! A Kalman filter with the bias as its state, which is constant but for a slow forgetting. At
//! rest the low-passed rate is the bias. In motion each inclination correction shows which rate
//! tilted the frame: the horizontal part of the low-passed bias in earth axes. The vertical part
//! is not observable in motion. A weak measurement of zero takes its place.

use aplomb_models::motion::geometry::{Quaternion, Vector, add, dot, scale, subtract};

use super::low_pass::LowPass;

const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// The axes of the sensor.
const AXES: [Vector; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Largest bias of an axis, and largest disagreement of a measurement: 2 °/s.
pub const LIMIT_RAD_S: f64 = 2.0 * DEGREE;
/// σ of the bias at start: 0.5 °/s.
const FIRST_SIGMA_RAD_S: f64 = 0.5 * DEGREE;
/// σ that the bias gains from zero within [`FORGETTING_S`]: 0.1 °/s.
const FORGOTTEN_SIGMA_RAD_S: f64 = 0.1 * DEGREE;
const FORGETTING_S: f64 = 100.0;
/// σ to which motion leads: 0.1 °/s.
const MOTION_SIGMA_RAD_S: f64 = 0.1 * DEGREE;
/// σ to which a rest leads: 0.03 °/s.
const REST_SIGMA_RAD_S: f64 = 0.03 * DEGREE;
/// Weight of the vertical axis in motion against the horizontal ones.
const VERTICAL_WEIGHT: f64 = 1e-4;

/// Estimator of the bias.
pub struct BiasEstimator {
    step_s: f64,
    bias_rad_s: Vector,
    /// Covariance of the bias, (rad/s)².
    covariance: [Vector; 3],
    /// Rotation sensor → earth, row by row.
    rotation: LowPass<9>,
    /// Horizontal part of the bias in earth axes.
    horizontal_bias: LowPass<2>,
    /// Growth of a variance in one step, (rad/s)².
    growth: f64,
    /// Variances of the measurements, (rad/s)².
    motion_variance: f64,
    rest_variance: f64,
}

/// Measurement of all three parts of the bias.
struct Measurement {
    /// Direction of each part in sensor axes.
    directions: [Vector; 3],
    /// Measured minus expected parts, rad/s.
    disagreement_rad_s: Vector,
    /// Variances of the parts, (rad/s)².
    variances: Vector,
}

impl BiasEstimator {
    /// Creates an estimator for samples that are `step_s` apart. The specific force is low-passed
    /// with the time constant `time_s`, s.
    pub fn new(time_s: f64, step_s: f64) -> Self {
        let growth = FORGOTTEN_SIGMA_RAD_S * FORGOTTEN_SIGMA_RAD_S * step_s / FORGETTING_S;
        // With this variance of a measurement the filter settles at the stated σ: P²/V + P.
        let leads_to = |sigma: f64| {
            let variance = sigma * sigma;
            variance * variance / growth + variance
        };
        let first = FIRST_SIGMA_RAD_S * FIRST_SIGMA_RAD_S;
        Self {
            step_s,
            bias_rad_s: [0.0; 3],
            covariance: AXES.map(|axis| scale(axis, first)),
            rotation: LowPass::new(time_s, step_s),
            horizontal_bias: LowPass::new(time_s, step_s),
            growth,
            motion_variance: leads_to(MOTION_SIGMA_RAD_S),
            rest_variance: leads_to(REST_SIGMA_RAD_S),
        }
    }

    /// Returns the bias, rad/s.
    pub const fn bias_rad_s(&self) -> Vector {
        self.bias_rad_s
    }

    /// Takes one step: the corrected attitude without magnetometer, the low-passed "up" in earth
    /// axes before that correction, and at rest the mean rate.
    pub fn update(&mut self, attitude: Quaternion, up: Vector, at_rest_rad_s: Option<Vector>) {
        // The low-pass filters go on at rest.
        let motion = self.motion(attitude, up);
        let measurement = at_rest_rad_s.map_or(motion, |rate_rad_s| Measurement {
            directions: AXES,
            disagreement_rad_s: subtract(rate_rad_s, self.bias_rad_s),
            variances: [self.rest_variance; 3],
        });
        for axis in 0..3 {
            let variance = &mut self.covariance[axis][axis];
            if *variance < FIRST_SIGMA_RAD_S * FIRST_SIGMA_RAD_S {
                *variance += self.growth;
            }
        }
        self.correct(&measurement);
    }

    /// Returns the measurement by an inclination correction.
    fn motion(&mut self, attitude: Quaternion, up: Vector) -> Measurement {
        let columns = AXES.map(|axis| attitude.rotate(axis));
        let row = |row: usize| columns.map(|column| column[row]);
        let horizontal = [0, 1].map(|part| dot(row(part), self.bias_rad_s));
        let horizontal = self.horizontal_bias.update(horizontal);
        let ([a, b, c], [d, e, f], [g, h, i]) = (row(0), row(1), row(2));
        let smooth = self.rotation.update([a, b, c, d, e, f, g, h, i]);
        let directions = [0, 3, 6].map(|row| [smooth[row], smooth[row + 1], smooth[row + 2]]);
        // Rates that tilt "up" like this in one step.
        let tilting = [-up[1] / self.step_s, up[0] / self.step_s];
        let measured = [tilting[0] + horizontal[0], tilting[1] + horizontal[1], 0.0];
        let expected = directions.map(|direction| dot(direction, self.bias_rad_s));
        let vertical = self.motion_variance / VERTICAL_WEIGHT;
        Measurement {
            directions,
            disagreement_rad_s: subtract(measured, expected),
            variances: [self.motion_variance, self.motion_variance, vertical],
        }
    }

    /// Corrects the bias, part by part: the noises of the parts are independent.
    fn correct(&mut self, measurement: &Measurement) {
        let limited = measurement.disagreement_rad_s.map(limit);
        let before = self.bias_rad_s;
        let parts = measurement.directions.into_iter().zip(limited);
        for ((direction, limited), variance) in parts.zip(measurement.variances) {
            let toward = self.covariance.map(|row| dot(row, direction));
            let gain = scale(toward, 1.0 / (dot(direction, toward) + variance));
            // The parts before have corrected some of the disagreement.
            let corrected = dot(direction, subtract(self.bias_rad_s, before));
            let change = scale(gain, limited - corrected);
            self.bias_rad_s = add(self.bias_rad_s, change);
            for (row, gain) in self.covariance.iter_mut().zip(gain) {
                *row = subtract(*row, scale(toward, gain));
            }
        }
        self.bias_rad_s = self.bias_rad_s.map(limit);
    }
}

/// Limits each axis by itself.
fn limit(rate_rad_s: f64) -> f64 {
    rate_rad_s.clamp(-LIMIT_RAD_S, LIMIT_RAD_S)
}
