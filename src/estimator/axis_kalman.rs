//! Roll and pitch by one angle and bias Kalman filter each, around an exact quaternion.
//!
//! The tutorial's two filters, without its two shortcuts: the angles are proper Euler angles from
//! arctangents, and the gyroscope moves them by the full kinematics. The kinematics run on a
//! quaternion, which has no singularity and costs no trigonometry; each sample then corrects it by
//! two scalar innovations, roll and pitch, which arise wrapped to ±π because each is the angle
//! between two directions. A roll correction turns about the forward axis and a pitch correction
//! about the level axis at right angles to it, so that neither touches the other angle or yaw.
//!
//! Near pitch ±90° roll is not defined, and the accelerometer says less and less about it: its
//! variance is R/cos²(pitch), and the gyroscope carries roll across the pole.
//!
//! Terms: "down" is the direction of gravity in body axes, measured as minus the specific force.
//! Cost: two arctangents, two square roots and three divisions per sample.

use super::Measurement;
use super::angle_bias::{AngleBias, R_MEASURE};
use crate::attitude::{Quaternion, Vector3};
use crate::units::radians;

/// No part of the family has a larger zero-rate offset (20 °/s, and 20 more over temperature:
/// product specification §6.1); it bounds what long accelerations can do to the bias.
const LARGEST_BIAS_RAD_S: f32 = radians(40.0);

/// cos² of pitch is not taken smaller than this (0.6° from the pole), where roll has no weight left.
const LEAST_PITCH_COSINE_SQUARED: f32 = 1.0e-4;

/// The filter's state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisKalman {
    attitude: Quaternion,
    /// The last sample's rate: between samples the rate is taken to change linearly.
    rate_rad_s: Vector3,
    roll: AngleBias,
    pitch: AngleBias,
    /// Cosine and sine of roll; they keep their last values at the pole.
    roll_cosine: f32,
    roll_sine: f32,
    has_tilt: bool,
}

impl Default for AxisKalman {
    fn default() -> Self {
        Self::new()
    }
}

impl AxisKalman {
    /// A filter without an attitude.
    pub const fn new() -> Self {
        Self {
            attitude: Quaternion::IDENTITY,
            rate_rad_s: Vector3::ZERO,
            roll: AngleBias::new(),
            pitch: AngleBias::new(),
            roll_cosine: 1.0,
            roll_sine: 0.0,
            has_tilt: false,
        }
    }

    /// Body to earth.
    pub(super) fn attitude(&self) -> Quaternion {
        self.attitude
    }

    /// Forgets everything; the next measurement that shows gravity sets the tilt, with yaw zero.
    pub(super) fn restart(&mut self) {
        *self = Self::new();
    }

    /// Sets roll and pitch from the accelerometer alone and keeps yaw.
    pub(super) fn start(&mut self, measurement: &Measurement) {
        self.roll = AngleBias::new();
        self.pitch = AngleBias::new();
        self.rate_rad_s = measurement.angular_rate_rad_s;
        if let Some(force) = measurement.specific_force_m_s2 {
            self.set_tilt(-force);
        }
    }

    /// One step of `dt_s` seconds.
    pub(super) fn update(&mut self, measurement: &Measurement, dt_s: f32) {
        self.predict(measurement.angular_rate_rad_s, dt_s);
        match measurement.specific_force_m_s2 {
            Some(force) if self.has_tilt => self.correct(-force),
            Some(force) => self.set_tilt(-force),
            None => {}
        }
        self.attitude = self.attitude.normalize();
    }

    fn predict(&mut self, rate_rad_s: Vector3, dt_s: f32) {
        let mean_rate = (self.rate_rad_s + rate_rad_s).scale(0.5);
        self.rate_rad_s = rate_rad_s;
        let bias = self.in_body(self.roll.bias, self.pitch.bias);
        let rotation = Quaternion::from_rotation_vector((mean_rate - bias).scale(dt_s));
        self.attitude = self.attitude.multiply(rotation);
        self.roll.predict(dt_s);
        self.pitch.predict(dt_s);
    }

    fn correct(&mut self, measured: Vector3) {
        let predicted = self.attitude.down_in_body();
        // The part of each direction at right angles to the forward axis: where roll shows.
        let measured_squared = measured.y * measured.y + measured.z * measured.z;
        let predicted_squared = predicted.y * predicted.y + predicted.z * predicted.z;
        let measured_across = libm::sqrtf(measured_squared);
        let predicted_across = libm::sqrtf(predicted_squared);

        // Each innovation is atan2(sin, cos) of the measured minus the predicted angle.
        let roll_innovation = libm::atan2f(
            measured.y * predicted.z - measured.z * predicted.y,
            measured.y * predicted.y + measured.z * predicted.z,
        );
        let pitch_innovation = libm::atan2f(
            predicted.x * measured_across - measured.x * predicted_across,
            measured_across * predicted_across + measured.x * predicted.x,
        );

        let pitch_cosine_squared = (measured_squared
            / (measured_squared + measured.x * measured.x))
            .min(predicted_squared)
            .max(LEAST_PITCH_COSINE_SQUARED);
        let roll_change = self
            .roll
            .correct(roll_innovation, R_MEASURE / pitch_cosine_squared);
        let pitch_change = self.pitch.correct(pitch_innovation, R_MEASURE);
        self.roll.bias = clamp_bias(self.roll.bias);
        self.pitch.bias = clamp_bias(self.pitch.bias);

        if predicted_squared > LEAST_PITCH_COSINE_SQUARED {
            let inverse = 1.0 / predicted_across;
            self.roll_cosine = predicted.z * inverse;
            self.roll_sine = predicted.y * inverse;
        }
        let change = self.in_body(roll_change, pitch_change);
        self.attitude = self
            .attitude
            .multiply(Quaternion::from_rotation_vector(change));
    }

    /// Turns changes of roll and pitch (or their rates) into a rotation vector in body axes.
    fn in_body(&self, roll: f32, pitch: f32) -> Vector3 {
        Vector3::new(roll, pitch * self.roll_cosine, -pitch * self.roll_sine)
    }

    fn set_tilt(&mut self, down: Vector3) {
        let mut angles = self.attitude.to_euler();
        let across = libm::sqrtf(down.y * down.y + down.z * down.z);
        angles.roll_rad = libm::atan2f(down.y, down.z);
        angles.pitch_rad = libm::atan2f(-down.x, across);
        self.attitude = Quaternion::from_euler(angles).with_sign_of(self.attitude);
        let predicted = self.attitude.down_in_body();
        let predicted_across = libm::sqrtf(predicted.y * predicted.y + predicted.z * predicted.z);
        if predicted_across * predicted_across > LEAST_PITCH_COSINE_SQUARED {
            self.roll_cosine = predicted.z / predicted_across;
            self.roll_sine = predicted.y / predicted_across;
        }
        self.has_tilt = true;
    }
}

fn clamp_bias(bias_rad_s: f32) -> f32 {
    bias_rad_s.clamp(-LARGEST_BIAS_RAD_S, LARGEST_BIAS_RAD_S)
}
