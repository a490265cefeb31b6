//! Tests of the filter on simulated sensors. The files in `tests/` have one subject each.

mod attitude;
mod covariance_step;
mod motion;
mod parameters;
mod rest;
mod starts;
mod unseen;

use super::propagation::PARAMETERS;
use super::tilt_variance::{REPORTED_SIGMA_SCALE, UNKNOWN_BIAS_SIGMA_SCALE};
use super::tuning::LARGEST_GYROSCOPE_BIAS_RAD_S;
use super::*;
use crate::estimator::tests::{angle_between, from_degrees, sample};
use crate::estimator::{Estimate, Estimator};
use crate::serialize::{StateReader, StateWriter};
use crate::units::degrees;

/// Random numbers (a linear congruence with the multiplier of Numerical Recipes).
struct Random(u64);

impl Random {
    /// Returns a number uniform in ±1.
    fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
    }

    /// Returns a nearly normal number, σ = 1.
    fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.next()).sum::<f32>() * 0.5
    }

    fn vector(&mut self, sigma: f32) -> Vector3 {
        Vector3::new(self.normal(), self.normal(), self.normal()).scale(sigma)
    }
}

/// Body that turns and accelerates smoothly, with its sensors.
struct World {
    attitude: Quaternion,
    rate_rad_s: Vector3,
    acceleration_m_s2: Vector3,
    bias_rad_s: Vector3,
    force_bias_m_s2: Vector3,
    rate_noise: f32,
    force_noise: f32,
    random: Random,
    t_us: u64,
}

impl World {
    fn at_rest(attitude: Quaternion) -> Self {
        Self {
            attitude,
            rate_rad_s: Vector3::ZERO,
            acceleration_m_s2: Vector3::ZERO,
            bias_rad_s: Vector3::ZERO,
            force_bias_m_s2: Vector3::ZERO,
            // 0.005 °/s/√Hz over 188 Hz, 400 µg/√Hz over 184 Hz.
            rate_noise: radians(0.07),
            force_noise: 0.053,
            random: Random(7),
            t_us: 0,
        }
    }

    /// Advances the time with the present rate and acceleration (earth axes), and returns a sample.
    fn sample(&mut self, dt_us: u64) -> Sample {
        self.t_us += dt_us;
        let turn = self.rate_rad_s.scale(dt_us as f32 * 1.0e-6);
        self.attitude = self
            .attitude
            .multiply(Quaternion::from_rotation_vector(turn))
            .normalize();
        let gravity = Vector3::new(0.0, 0.0, STANDARD_GRAVITY_M_S2);
        let force = self
            .attitude
            .conjugate()
            .rotate(self.acceleration_m_s2 - gravity);
        Sample {
            t_us: self.t_us,
            specific_force_m_s2: force
                + self.force_bias_m_s2
                + self.random.vector(self.force_noise),
            angular_rate_rad_s: self.rate_rad_s
                + self.bias_rad_s
                + self.random.vector(self.rate_noise),
            ..Sample::default()
        }
    }

    fn tilt_error_degrees(&self, attitude: Quaternion) -> f32 {
        let cross = self.attitude.down_in_body().cross(attitude.down_in_body());
        let cosine = self.attitude.down_in_body().dot(attitude.down_in_body());
        degrees(f32::atan2(cross.norm(), cosine))
    }

    /// Runs this number of milliseconds at 1 kHz.
    fn run(&mut self, estimator: &mut Estimator, milliseconds: u32) -> Estimate {
        let mut estimate = Estimate::default();
        for _ in 0..milliseconds {
            estimate = estimator.update(&self.sample(1000));
        }
        estimate
    }

    /// Runs this number of milliseconds at 1 kHz, and returns the largest error of the tilt.
    fn worst_error_degrees(&mut self, estimator: &mut Estimator, milliseconds: u32) -> f32 {
        let mut worst: f32 = 0.0;
        for _ in 0..milliseconds {
            let estimate = self.run(estimator, 1);
            worst = worst.max(self.tilt_error_degrees(estimate.attitude));
        }
        worst
    }
}

/// Motion of a hand, which returns to its start.
#[derive(Default)]
struct Hand {
    samples: u32,
    velocity: Vector3,
    jerk: Vector3,
    swing: Vector3,
}

impl Hand {
    /// Moves the world for the next sample, at 1 kHz.
    fn moves(&mut self, world: &mut World, random: &mut Random) {
        if self.samples.is_multiple_of(300) {
            self.jerk = random.vector(2.5);
            self.swing = random.vector(0.8);
        }
        self.samples += 1;
        let wanted = self.jerk - self.velocity.scale(1.5);
        world.acceleration_m_s2 =
            world.acceleration_m_s2 + (wanted - world.acceleration_m_s2).scale(0.01);
        self.velocity = self.velocity + world.acceleration_m_s2.scale(1.0e-3);
        world.rate_rad_s = world.rate_rad_s + (self.swing - world.rate_rad_s).scale(0.01);
    }
}

fn estimator() -> Estimator {
    Estimator::new()
}

fn filter(estimator: &Estimator) -> &Kalman {
    estimator.filter()
}

/// State that a reset keeps in this world: the bias is known, the tilt to 21°, and the vehicle
/// has stayed in place.
fn warm_start(world: &World) -> WarmStart {
    WarmStart {
        attitude: world.attitude,
        tilt_sigma_rad: radians(21.0),
        bias_rad_s: world.bias_rad_s,
        bias_change_rad_s: Vector3::ZERO,
        bias_sigma_rad_s: radians(0.2),
        accelerometer_bias_m_s2: [0.0; 2],
        squared_velocity_m2_s2: 0.0,
    }
}
