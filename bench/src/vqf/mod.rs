//! VQF, a filter to compare with, with and without magnetometer.
//!
//! Written from D. Laidig and T. Seel, *VQF: Highly accurate IMU orientation estimation with bias
//! estimation and magnetic disturbance rejection*, Information Fusion 91, 2023, with the default
//! parameters of its authors. All arithmetic is `f64`. The tests hold it to the attitudes of the
//! authors' own package.
//!
//! The attitude is a product of three turns, each for one sensor:
//!
//! | turn | from, to | module |
//! |---|---|---|
//! | strapdown integration of the rates | sensor, almost-inertial frame | here |
//! | inclination correction by the specific force | almost-inertial, level frame | here |
//! | heading correction by the field | level frame; east, north, up | [`heading`] |
//!
//! The almost-inertial frame turns by the drift of the gyroscope alone. In it accelerations of the
//! body average to zero, and gravity remains: a [low-pass filter](low_pass) takes that average.
//! [`bias`] estimates the gyroscope's bias from the corrections and from the [rests](rest).

mod bias;
mod heading;
mod low_pass;
mod rest;
#[cfg(test)]
mod tests;

use aplomb_models::motion::geometry::{Quaternion, Vector, norm, scale, subtract};

use bias::BiasEstimator;
use heading::HeadingCorrection;
use low_pass::LowPass;
use rest::RestDetector;

/// Time constant of the specific force's low-pass filter, s: the default of the authors.
pub const FORCE_S: f64 = 3.0;

/// Cosine of half a correction below which it is half a turn.
const SMALLEST_COSINE: f64 = 1e-6;

const IDENTITY: Quaternion = Quaternion {
    w: 1.0,
    x: 0.0,
    y: 0.0,
    z: 0.0,
};

/// The filter.
pub struct Vqf {
    step_s: f64,
    /// Turn from the sensor to the almost-inertial frame: the paper's "gyroscope strapdown
    /// integration".
    strapdown: Quaternion,
    /// Turn from there to the level frame: the paper's "inclination correction".
    inclination: Quaternion,
    /// Specific force in the almost-inertial frame.
    force: LowPass<3>,
    bias: BiasEstimator,
    rest: RestDetector,
    heading: HeadingCorrection,
}

impl Vqf {
    /// Creates a filter with this time constant of the specific force, s, usually [`FORCE_S`].
    /// Samples are `step_s` apart, and readings of the magnetometer `field_step_s`.
    pub fn new(force_s: f64, step_s: f64, field_step_s: f64) -> Self {
        Self {
            step_s,
            strapdown: IDENTITY,
            inclination: IDENTITY,
            force: LowPass::new(force_s, step_s),
            bias: BiasEstimator::new(force_s, step_s),
            rest: RestDetector::new(step_s),
            heading: HeadingCorrection::new(field_step_s),
        }
    }

    /// Takes a sample: rate of the step to it, rad/s, and specific force, m/s², in sensor axes.
    /// A zero force gives no correction.
    pub fn update(&mut self, rate_rad_s: Vector, force_m_s2: Vector) {
        self.rest.add_rate(rate_rad_s);
        let turn = scale(subtract(rate_rad_s, self.bias.bias_rad_s()), self.step_s);
        let turn = Quaternion::from_rotation_vector(turn);
        self.strapdown = self.strapdown.multiply(turn).normalized();
        if force_m_s2 != [0.0; 3] {
            self.rest.add_force(force_m_s2);
            self.correct_inclination(force_m_s2);
        }
    }

    /// Takes a reading of the magnetometer of the last sample, in sensor axes and any unit.
    pub fn update_field(&mut self, field: Vector) {
        if field != [0.0; 3] {
            let level = self.level_attitude().rotate(field);
            self.heading
                .update(level, norm(self.rest.mean_rate_rad_s()));
        }
    }

    /// Returns the turn from the sensor to the level frame, whose heading is any.
    pub fn level_attitude(&self) -> Quaternion {
        self.inclination.multiply(self.strapdown)
    }

    /// Returns the turn from the sensor to east, north, up.
    pub fn attitude(&self) -> Quaternion {
        let turn = Quaternion::from_rotation_vector([0.0, 0.0, self.heading.offset_rad()]);
        turn.multiply(self.level_attitude())
    }

    /// Returns the estimated bias of the gyroscope, rad/s.
    #[cfg(test)]
    pub const fn bias_rad_s(&self) -> Vector {
        self.bias.bias_rad_s()
    }

    /// Turns the level frame so that the low-passed force points up, by the shortest turn.
    fn correct_inclination(&mut self, force_m_s2: Vector) {
        let smooth = self.force.update(self.strapdown.rotate(force_m_s2));
        let level = self.inclination.rotate(smooth);
        let up = scale(level, 1.0 / norm(level).max(f64::MIN_POSITIVE));
        let cosine = (0.5 * (up[2] + 1.0)).sqrt();
        let turn = if cosine > SMALLEST_COSINE {
            Quaternion::new(cosine, 0.5 * up[1] / cosine, -0.5 * up[0] / cosine, 0.0)
        } else {
            Quaternion::new(0.0, 1.0, 0.0, 0.0)
        };
        self.inclination = turn.multiply(self.inclination).normalized();
        let at_rest_rad_s = self.rest.rate_at_rest_rad_s();
        self.bias.update(self.level_attitude(), up, at_rest_rad_s);
    }
}
