//! Fits of turns of a gyroscope with known errors.

use super::*;
use crate::attitude::{Quaternion, Vector3};
use crate::calibration::accelerometer::Pose;
use crate::calibration::{AccelerometerCorrection, Matrix3, NoiseModel, StationaryMean};
use crate::units::radians;

const SCALE: NoiseModel = NoiseModel {
    counts_per_degree_s: 16.4,
    counts_per_g: 2048.0,
    gyroscope_sigma_counts: 1.2,
    accelerometer_sigma_counts: 11.0,
    gyroscope_correlation: 2.7,
    accelerometer_correlation: 2.7,
};
const STEP_US: u64 = 1_000;
const OFFSET_DEGREES_S: Vector3 = Vector3::new(3.0, -7.0, 1.5);

/// Sensitivity of a chip near the limits of its datasheet: reading = S·rate + offset.
fn distorted(rate: Vector3) -> Vector3 {
    Vector3::new(
        1.028 * rate.x + 0.015 * rate.y - 0.008 * rate.z,
        -0.012 * rate.x + 0.975 * rate.y + 0.018 * rate.z,
        0.009 * rate.x - 0.016 * rate.y + 1.02 * rate.z,
    )
}

/// Bench on which a hand turns the sensor from pose to pose.
struct Bench {
    /// Sensor to earth, up is z.
    attitude: Quaternion,
    integrator: TurnIntegrator,
    turns: TurnCollector,
    now_us: u64,
}

impl Bench {
    fn new(first: Pose) -> Self {
        let mut bench = Self {
            attitude: shortest(first.up(), Vector3::new(0.0, 0.0, 1.0)),
            integrator: TurnIntegrator::new(&SCALE),
            turns: TurnCollector::new(),
            now_us: 0,
        };
        assert_eq!(bench.integrator.finish(&bench.at_rest()), None);
        bench
    }

    fn at_rest(&self) -> StationaryMean {
        let up = self
            .attitude
            .conjugate()
            .rotate(Vector3::new(0.0, 0.0, 1.0));
        StationaryMean {
            gyroscope_counts: OFFSET_DEGREES_S.scale(SCALE.counts_per_degree_s),
            accelerometer_counts: up.scale(SCALE.counts_per_g),
            ..StationaryMean::default()
        }
    }

    /// Adds a reading of this rate, rad/s in sensor axes, and turns.
    fn turn(&mut self, rate_rad_s: Vector3) {
        let degrees_s = distorted(rate_rad_s.scale(radians(1.0).recip())) + OFFSET_DEGREES_S;
        let counts = degrees_s.scale(SCALE.counts_per_degree_s);
        let counts = [counts.x, counts.y, counts.z].map(|count| count.round() as i16);
        self.integrator.update(counts, self.now_us);
        self.now_us += STEP_US;
        let step_s = STEP_US as f32 * 1e-6;
        let step = Quaternion::from_rotation_vector(rate_rad_s.scale(step_s));
        self.attitude = self.attitude.multiply(step).normalize();
    }

    /// Turns to this pose by the shortest way in 2 s: fast half-way, at rest at both ends.
    fn turn_to(&mut self, pose: Pose) -> Option<Turn> {
        let up = self
            .attitude
            .conjugate()
            .rotate(Vector3::new(0.0, 0.0, 1.0));
        let way = shortest(pose.up(), up);
        let sine = Vector3::new(way.x, way.y, way.z);
        let angle = 2.0 * sine.norm().atan2(way.w);
        let axis = sine.scale(1.0 / sine.norm());
        let steps = 2_000;
        for step in 0..steps {
            let phase = core::f32::consts::TAU * step as f32 / steps as f32;
            self.turn(axis.scale(0.5 * angle * (1.0 - phase.cos())));
        }
        self.turn(Vector3::ZERO);
        let turn = self.integrator.finish(&self.at_rest());
        if let Some(turn) = &turn {
            self.turns.add(turn);
        }
        turn
    }
}

/// Returns the shortest rotation from one unit vector to another; about x or y if they are
/// opposite.
fn shortest(from: Vector3, to: Vector3) -> Quaternion {
    let cosine = from.dot(to);
    if cosine < -0.999 {
        let axis = if from.x.abs() < 0.5 {
            Vector3::new(1.0, 0.0, 0.0)
        } else {
            Vector3::new(0.0, 1.0, 0.0)
        };
        return Quaternion::from_rotation_vector(axis.scale(core::f32::consts::PI));
    }
    let axis = from.cross(to);
    Quaternion::new(1.0 + cosine, axis.x, axis.y, axis.z).normalize()
}

/// Returns the largest element of M·S − 1.
fn largest_error(matrix: &Matrix3) -> f32 {
    let axes = [0, 1, 2].map(|axis| Matrix3::IDENTITY.rows[axis]);
    let errors = axes.map(|axis| matrix.times(distorted(axis)) - axis);
    let errors = errors.iter().flat_map(|error| [error.x, error.y, error.z]);
    errors.fold(0.0, |largest, error| largest.max(error.abs()))
}

fn through(poses: impl IntoIterator<Item = Pose>) -> Bench {
    let mut poses = poses.into_iter();
    let mut bench = Bench::new(poses.next().expect("a pose"));
    for pose in poses {
        bench.turn_to(pose).expect("a turn");
    }
    bench
}

#[test]
fn the_guide_of_twelve_poses_finds_the_matrix() {
    let bench = through(Pose::GUIDE);
    let fit = bench
        .turns
        .fit(&AccelerometerCorrection::NONE)
        .expect("a fit");
    assert_eq!(fit.turns, 11);
    assert!(largest_error(&Matrix3::IDENTITY) > 0.027);
    assert!(
        largest_error(&fit.matrix) < 0.0025,
        "{:?}",
        largest_error(&fit.matrix)
    );
    assert!(fit.residual_before_rad > radians(1.0), "{fit:?}");
    assert!(fit.residual_after_rad < radians(0.15), "{fit:?}");
    let text = fit.to_string();
    assert!(
        text.starts_with("11 turns, gyroscope scale and cross-axis: residual "),
        "{text}"
    );
}
