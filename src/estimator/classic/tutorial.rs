//! The classic tutorial's filter, formula by formula, for readers who want to reproduce its
//! numbers.
//!
//! Roll and pitch come from arccosines with signs and lie within ±90°. Each feeds an angle and
//! bias Kalman filter, whose rate input is the gyroscope axis itself. The printed rate is the
//! change of the filtered angle over the time step. In body axes the tutorial's chip lies face
//! down, forward along X, which is the mount `+x+z`. Any other mount gives the same numbers for the
//! same motion.
//!
//! Limits: no angle beyond ±90°, and no coupling of the axes when both are tilted. The resolution
//! near zero is 0.02° (an arccosine of an `f32` near one), and the angle settles slowly at ±90°.

use super::angle_bias::{AngleBias, R_MEASURE};
use crate::attitude::{EulerAngles, Quaternion, Vector3, wrap_pi};
use crate::estimator::filter::Filter;
use crate::estimator::sample::Sample;
use crate::units::{degrees, radians};

/// The tutorial's output: the filtered angles and their rates of change.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ClassicAngles {
    /// Roll in degrees.
    pub roll_deg: f32,
    /// Change of roll over the last step, in °/s.
    pub roll_rate_deg_s: f32,
    /// Pitch in degrees.
    pub pitch_deg: f32,
    /// Change of pitch over the last step, in °/s.
    pub pitch_rate_deg_s: f32,
}

/// Returns the tutorial's roll from the specific force, in degrees. It is negative if y is
/// positive.
pub fn roll_deg(force: Vector3) -> f32 {
    let across = libm::sqrtf(force.x * force.x + force.z * force.z);
    let angle = arccosine_deg(across, force.norm());
    if force.y > 0.0 { -angle } else { angle }
}

/// Returns the tutorial's pitch from the specific force, in degrees. It is negative if x is
/// negative.
pub fn pitch_deg(force: Vector3) -> f32 {
    let across = libm::sqrtf(force.y * force.y + force.z * force.z);
    let angle = arccosine_deg(across, force.norm());
    if force.x < 0.0 { -angle } else { angle }
}

/// Filter state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Tutorial {
    roll: Axis,
    pitch: Axis,
    yaw_rad: f32,
    rate_rad_s: Vector3,
    attitude: Quaternion,
}

impl Filter for Tutorial {
    fn restart(&mut self) {
        *self = Self {
            attitude: Quaternion::IDENTITY.with_sign_of(self.attitude),
            ..Self::new()
        };
    }

    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        self.roll = Axis::new();
        self.pitch = Axis::new();
        if shows_gravity {
            self.roll.set(roll_deg(sample.specific_force_m_s2));
            self.pitch.set(pitch_deg(sample.specific_force_m_s2));
        }
        self.rate_rad_s = sample.angular_rate_rad_s;
        self.set_attitude();
    }

    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        let rate = sample.angular_rate_rad_s;
        let force = shows_gravity.then_some(sample.specific_force_m_s2);
        self.roll.update(degrees(rate.x), force.map(roll_deg), dt_s);
        self.pitch
            .update(degrees(rate.y), force.map(pitch_deg), dt_s);
        self.yaw_rad = wrap_pi(self.yaw_rad + rate.z * dt_s);
        self.rate_rad_s = rate;
        self.set_attitude();
    }

    fn attitude(&self) -> Quaternion {
        self.attitude
    }

    fn body_rates_rad_s(&self) -> Vector3 {
        self.rate_rad_s
    }
}

impl Default for Tutorial {
    fn default() -> Self {
        Self::new()
    }
}

impl Tutorial {
    /// Creates a filter at zero.
    pub const fn new() -> Self {
        Self {
            roll: Axis::new(),
            pitch: Axis::new(),
            yaw_rad: 0.0,
            rate_rad_s: Vector3::ZERO,
            attitude: Quaternion::IDENTITY,
        }
    }

    /// Returns the tutorial's output.
    pub fn angles(&self) -> ClassicAngles {
        ClassicAngles {
            roll_deg: self.roll.angle_deg,
            roll_rate_deg_s: self.roll.rate_deg_s,
            pitch_deg: self.pitch.angle_deg,
            pitch_rate_deg_s: self.pitch.rate_deg_s,
        }
    }

    fn set_attitude(&mut self) {
        let angles = EulerAngles {
            roll_rad: radians(self.roll.angle_deg),
            pitch_rad: radians(self.pitch.angle_deg),
            yaw_rad: self.yaw_rad,
        };
        self.attitude = Quaternion::from_euler(angles).with_sign_of(self.attitude);
    }
}

/// Angle with its filter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Axis {
    angle_deg: f32,
    rate_deg_s: f32,
    filter: AngleBias,
    has_angle: bool,
}

impl Axis {
    const fn new() -> Self {
        Self {
            angle_deg: 0.0,
            rate_deg_s: 0.0,
            filter: AngleBias::new(),
            has_angle: false,
        }
    }

    fn set(&mut self, angle_deg: f32) {
        self.angle_deg = angle_deg;
        self.has_angle = true;
    }

    fn update(&mut self, rate_deg_s: f32, measured_deg: Option<f32>, dt_s: f32) {
        let before_deg = self.angle_deg;
        self.angle_deg += (rate_deg_s - self.filter.bias) * dt_s;
        self.filter.predict(dt_s);
        match measured_deg {
            Some(measured_deg) if self.has_angle => {
                let innovation_deg = measured_deg - self.angle_deg;
                self.angle_deg += self.filter.correct(innovation_deg, R_MEASURE);
            }
            Some(measured_deg) => self.set(measured_deg),
            None => {}
        }
        self.rate_deg_s = (self.angle_deg - before_deg) / dt_s;
    }
}

/// Returns acos(across/norm) in degrees, or zero for a zero force.
fn arccosine_deg(across: f32, norm: f32) -> f32 {
    if norm > 0.0 {
        // The quotient cannot exceed one, where the arccosine ends. `norm` adds a square to the sum
        // of `across`, and rounding keeps the order of sums, roots and quotients.
        degrees(libm::acosf(across / norm))
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::Estimator;
    use crate::estimator::tests::{from_degrees, sample};

    #[test]
    fn the_formulas_agree_with_the_tutorial() {
        // Counts at ±2 g, face down, offsets removed; x, y, z, roll, pitch.
        for (x, y, z, roll, pitch) in [
            (0.0, 0.0, -16384.0, 0.0, 0.0),
            (0.0, -8192.0, -14189.0, 30.0, 0.0),
            (0.0, 8192.0, -14189.0, -30.0, 0.0),
            (8192.0, 0.0, -14189.0, 0.0, 30.0),
            (-8192.0, 0.0, -14189.0, 0.0, -30.0),
            (0.0, -16384.0, 0.0, 90.0, 0.0),
            (-16384.0, 0.0, 0.0, 0.0, -90.0),
            // 70.53° from each axis is 35.26° out of each plane.
            (1000.0, -1000.0, -1000.0, 35.264, 35.264),
            // Past the vertical the angle decreases again.
            (0.0, -8192.0, 14189.0, 30.0, 0.0),
        ] {
            let force = Vector3::new(x, y, z);
            assert!((roll_deg(force) - roll).abs() < 0.02, "{force:?}");
            assert!((pitch_deg(force) - pitch).abs() < 0.02, "{force:?}");
        }
        assert_eq!(roll_deg(Vector3::ZERO), 0.0);
        assert_eq!(pitch_deg(Vector3::ZERO), 0.0);
    }

    #[test]
    fn every_force_is_within_the_range_of_the_arccosine() {
        let mut seed = 1_u32;
        let mut number = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let magnitude = f32::from_bits((seed >> 9) + (0x70 << 23) + (seed & 0x0F80_0000));
            if seed & 1 == 0 { magnitude } else { -magnitude }
        };
        for _ in 0..200_000 {
            let force = Vector3::new(number(), number(), number());
            assert!((-90.001..=90.001).contains(&roll_deg(force)), "{force:?}");
            assert!((-90.001..=90.001).contains(&pitch_deg(force)), "{force:?}");
        }
    }

    #[test]
    fn near_level_the_signs_are_those_of_the_attitude() {
        let force = -from_degrees(3.0, -2.0, 0.0).down_in_body();
        assert!((roll_deg(force) - 3.0).abs() < 0.02);
        assert!((pitch_deg(force) + 2.0).abs() < 0.02);
    }

    #[test]
    fn the_filter_and_the_rate_agree_with_the_tutorial() {
        // The same steps in double precision: predict, update, difference.
        let mut estimator = Estimator::with_filter(Tutorial::new());
        let (mut angle, mut bias) = (0.0_f64, 0.0_f64);
        let (mut p00, mut p01, mut p11) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut t_us = 0;
        for step in 0..4_000_u64 {
            let dt_us = 2_000 + 700 * (step % 3);
            let time = t_us as f64 * 1e-6;
            let roll = 20.0 * (1.5 * time).sin();
            let rate = 30.0 * (1.5 * time).cos() + 4.0;
            let rate_rad_s = Vector3::new((rate as f32).to_radians(), 0.0, 0.0);
            estimator.update(&sample(
                t_us,
                from_degrees(roll as f32, 0.0, 0.0),
                rate_rad_s,
            ));
            if step > 0 {
                let dt = (2_000 + 700 * ((step - 1) % 3)) as f64 * 1e-6;
                let before = angle;
                angle += dt * (rate - bias);
                p00 += dt * (dt * p11 - 2.0 * p01 + 0.001);
                p01 -= dt * p11;
                p11 += 0.003 * dt;
                let s = p00 + 0.03;
                let (k0, k1) = (p00 / s, p01 / s);
                let innovation = roll - angle;
                angle += k0 * innovation;
                bias += k1 * innovation;
                p11 -= k1 * p01;
                p01 -= k0 * p01;
                p00 -= k0 * p00;
                let printed = estimator.filter().angles();
                assert!((f64::from(printed.roll_deg) - angle).abs() < 0.02, "{step}");
                let printed_rate = f64::from(printed.roll_rate_deg_s);
                assert!((printed_rate - (angle - before) / dt).abs() < 0.1, "{step}");
                assert!(printed.pitch_deg.abs() < 0.02);
            }
            t_us += dt_us;
        }
        assert!(
            angle.abs() > 1.0 && (bias - 4.0).abs() < 1.0,
            "{angle} {bias}"
        );
    }

    #[test]
    fn the_quaternion_has_the_same_angles_and_keeps_its_sign() {
        let mut estimator = Estimator::with_filter(Tutorial::new());
        let mut last = estimator.estimate().attitude;
        let rate = Vector3::new(0.0, 0.0, 3.0);
        for millisecond in 0..5_000 {
            let pose = from_degrees(25.0, 0.0, 0.0);
            let attitude = estimator
                .update(&sample(millisecond * 1000, pose, rate))
                .attitude;
            assert!(attitude.dot(last) > 0.9);
            last = attitude;
        }
        let angles = last.to_euler();
        let classic = estimator.filter().angles();
        assert!((angles.roll_rad.to_degrees() - classic.roll_deg).abs() < 1e-3);
        assert!(
            (wrap_pi(angles.yaw_rad - 3.0 * 4.999)).abs() < 1e-2,
            "{angles:?}"
        );
    }
}
