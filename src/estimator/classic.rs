//! The classic tutorial's pipeline, formula by formula, for whoever wants to find its numbers.
//!
//! Roll and pitch come from arccosines with signs and lie within ±90°; each feeds an angle and bias
//! Kalman filter whose rate input is the gyroscope axis itself; the printed rate is the change of
//! the filtered angle over the time step. In body axes its chip lies face down, forward along X,
//! which is the mount `+x+z`; any other mount gives the same numbers for the same motion.
//!
//! What that costs: no angle beyond ±90°, no coupling of the axes when both are tilted, 0.02° of
//! grain near zero (an arccosine of an `f32` near one), and a slow rest at ±90°.

use super::Measurement;
use super::angle_bias::{AngleBias, R_MEASURE};
use crate::attitude::{EulerAngles, Quaternion, Vector3, wrap_pi};
use crate::units::{degrees, radians};

/// What the tutorial prints: angles and the rates at which the filtered angles change.
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

/// The tutorial's roll from the specific force: negative if y is positive. In degrees.
pub fn roll_deg(force: Vector3) -> f32 {
    let across = libm::sqrtf(force.x * force.x + force.z * force.z);
    let angle = arccosine_deg(across, force.norm());
    if force.y > 0.0 { -angle } else { angle }
}

/// The tutorial's pitch from the specific force: negative if x is negative. In degrees.
pub fn pitch_deg(force: Vector3) -> f32 {
    let across = libm::sqrtf(force.y * force.y + force.z * force.z);
    let angle = arccosine_deg(across, force.norm());
    if force.x < 0.0 { -angle } else { angle }
}

/// The filter's state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Classic {
    roll: Axis,
    pitch: Axis,
    yaw_rad: f32,
    attitude: Quaternion,
}

impl Default for Classic {
    fn default() -> Self {
        Self::new()
    }
}

impl Classic {
    /// A filter at zero.
    pub const fn new() -> Self {
        Self {
            roll: Axis::new(),
            pitch: Axis::new(),
            yaw_rad: 0.0,
            attitude: Quaternion::IDENTITY,
        }
    }

    /// Body to earth.
    pub(super) fn attitude(&self) -> Quaternion {
        self.attitude
    }

    /// What the tutorial prints.
    pub(super) fn angles(&self) -> ClassicAngles {
        ClassicAngles {
            roll_deg: self.roll.angle_deg,
            roll_rate_deg_s: self.roll.rate_deg_s,
            pitch_deg: self.pitch.angle_deg,
            pitch_rate_deg_s: self.pitch.rate_deg_s,
        }
    }

    /// Forgets everything; the next measurement that shows gravity sets the angles, with yaw zero.
    pub(super) fn restart(&mut self) {
        *self = Self::new();
    }

    /// Sets the angles from the accelerometer alone and keeps yaw.
    pub(super) fn start(&mut self, measurement: &Measurement) {
        self.roll = Axis::new();
        self.pitch = Axis::new();
        if let Some(force) = measurement.specific_force_m_s2 {
            self.roll.set(roll_deg(force));
            self.pitch.set(pitch_deg(force));
        }
        self.publish();
    }

    /// One step of `dt_s` seconds.
    pub(super) fn update(&mut self, measurement: &Measurement, dt_s: f32) {
        let rate = measurement.angular_rate_rad_s;
        let force = measurement.specific_force_m_s2;
        self.roll.update(degrees(rate.x), force.map(roll_deg), dt_s);
        self.pitch
            .update(degrees(rate.y), force.map(pitch_deg), dt_s);
        self.yaw_rad = wrap_pi(self.yaw_rad + rate.z * dt_s);
        self.publish();
    }

    fn publish(&mut self) {
        let angles = EulerAngles {
            roll_rad: radians(self.roll.angle_deg),
            pitch_rad: radians(self.pitch.angle_deg),
            yaw_rad: self.yaw_rad,
        };
        self.attitude = Quaternion::from_euler(angles).with_sign_of(self.attitude);
    }
}

/// One angle with its filter.
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

/// acos(across/norm) in degrees; zero for no force at all.
fn arccosine_deg(across: f32, norm: f32) -> f32 {
    if norm > 0.0 {
        // Rounding may leave the quotient a hair above one, where the arccosine is not a number.
        degrees(libm::acosf((across / norm).min(1.0)))
    } else {
        0.0
    }
}
