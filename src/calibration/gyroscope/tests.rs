//! Fits of turns of a gyroscope with known errors.

use super::*;
use crate::attitude::{Quaternion, Vector3};
use crate::calibration::accelerometer::Pose;
use crate::calibration::{AccelerometerCorrection, Matrix3, NoiseModel, StationaryMean};
use crate::units::radians;

const SCALE: NoiseModel = NoiseModel::FOR_TESTS;
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
    /// Offset per specific force along the same axis, °/s per g.
    per_g_degrees_s: f32,
}

impl Bench {
    fn new(first: Pose) -> Self {
        let mut bench = Self {
            attitude: shortest(first.up(), Vector3::new(0.0, 0.0, 1.0)),
            integrator: TurnIntegrator::new(&SCALE),
            turns: TurnCollector::new(),
            now_us: 0,
            per_g_degrees_s: 0.0,
        };
        assert_eq!(bench.integrator.finish(&bench.at_rest()), None);
        bench
    }

    fn up(&self) -> Vector3 {
        let up = Vector3::new(0.0, 0.0, 1.0);
        self.attitude.conjugate().rotate(up)
    }

    fn offset_degrees_s(&self) -> Vector3 {
        OFFSET_DEGREES_S + self.up().scale(self.per_g_degrees_s)
    }

    fn at_rest(&self) -> StationaryMean {
        StationaryMean {
            gyroscope_counts: self.offset_degrees_s().scale(SCALE.counts_per_degree_s),
            accelerometer_counts: self.up().scale(SCALE.counts_per_g),
            ..StationaryMean::default()
        }
    }

    /// Adds a reading of this rate, rad/s in sensor axes, and turns.
    fn turn(&mut self, rate_rad_s: Vector3) {
        let degrees_s = distorted(rate_rad_s.scale(radians(1.0).recip())) + self.offset_degrees_s();
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
        let up = self.up();
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

#[test]
fn turns_about_one_axis_and_too_few_turns_are_refused() {
    let x_up = through(Pose::GUIDE.into_iter().take(4));
    let few = x_up.turns.fit(&AccelerometerCorrection::NONE);
    assert_eq!(few, Err(GyroscopeFitError::TooFew { have: 3 }));
    // To and fro about y alone.
    let [up, _, forward, ..] = Pose::GUIDE;
    let one_axis = through([up, forward].into_iter().cycle().take(12));
    let error = one_axis
        .turns
        .fit(&AccelerometerCorrection::NONE)
        .unwrap_err();
    assert_eq!(error, GyroscopeFitError::BadGeometry);
    assert_eq!(
        error.to_string(),
        "the turns do not show every axis: lay it in the twelve poses, in another order"
    );
}

#[test]
fn poses_that_moved_unseen_and_impossible_scales_are_refused() {
    let mut bench = through(Pose::GUIDE);
    // The sensor turns by 30° between two samples, at each pose.
    let moved = Quaternion::from_rotation_vector(Vector3::new(0.5, 0.2, 0.0));
    for pose in Pose::GUIDE {
        bench.attitude = bench.attitude.multiply(moved).normalize();
        bench.turn_to(pose);
    }
    let error = bench.turns.fit(&AccelerometerCorrection::NONE).unwrap_err();
    let is_refused = matches!(
        error,
        GyroscopeFitError::Inconsistent { .. } | GyroscopeFitError::Implausible
    );
    assert!(is_refused, "{error}");
    // A gyroscope that was read at half its scale.
    let half = NoiseModel {
        counts_per_degree_s: 0.5 * SCALE.counts_per_degree_s,
        ..SCALE
    };
    let mut poses = Pose::GUIDE.into_iter();
    let mut bench = Bench::new(poses.next().expect("a pose"));
    bench.integrator = TurnIntegrator::new(&half);
    bench.integrator.finish(&bench.at_rest());
    for pose in poses {
        bench.turn_to(pose);
    }
    let fit = bench.turns.fit(&AccelerometerCorrection::NONE);
    assert_eq!(fit, Err(GyroscopeFitError::Implausible));
}

#[test]
fn a_turn_with_a_gap_or_full_scale_or_in_place_is_none() {
    let [first, second, ..] = Pose::GUIDE;
    let mut bench = Bench::new(first);
    assert!(bench.turn_to(second).is_some());
    bench.now_us += 30_000;
    bench.turn(Vector3::ZERO);
    let far = bench.now_us;
    assert!(
        bench.turn_to(first).is_some(),
        "the gap was before its start"
    );
    bench.turn(Vector3::ZERO);
    bench.now_us += 30_000;
    assert_eq!(bench.turn_to(second), None, "a gap");
    bench.turn(Vector3::ZERO);
    bench.now_us = far;
    assert_eq!(bench.turn_to(first), None, "time went back");
    assert!(!bench.integrator.is_waiting());
    bench.integrator.update([0, i16::MIN, 0], bench.now_us);
    assert!(bench.integrator.is_waiting());
    assert_eq!(bench.turn_to(second), None, "full scale");
    assert_eq!(bench.integrator.finish(&bench.at_rest()), None, "no turn");
    // Three times to and fro through 180° is too much.
    for _ in 0..3 {
        for sign in [1.0, -1.0] {
            for _ in 0..1_000 {
                bench.turn(Vector3::new(sign * radians(180.0), 0.0, 0.0));
            }
        }
    }
    assert_eq!(bench.turn_to(first), None, "to and fro");
    assert!(bench.turn_to(second).is_some(), "the next one counts");
}

#[test]
fn an_offset_that_depends_on_the_pose_does_not_matter() {
    let mut bench = through(Pose::GUIDE);
    let plain = bench
        .turns
        .fit(&AccelerometerCorrection::NONE)
        .expect("a fit");
    // 0.1 °/s per g, in a turn of 2 s: half of the change counts over the turn.
    bench = Bench::new(Pose::GUIDE[0]);
    bench.per_g_degrees_s = 0.1;
    bench.integrator.finish(&bench.at_rest());
    for pose in Pose::GUIDE.into_iter().skip(1) {
        bench.turn_to(pose);
    }
    let fit = bench
        .turns
        .fit(&AccelerometerCorrection::NONE)
        .expect("a fit");
    let (plain, found) = (largest_error(&plain.matrix), largest_error(&fit.matrix));
    assert!(found < plain + 0.0005, "{plain} {found}");
}
