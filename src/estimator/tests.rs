//! Tests of every filter behind the gate, and of the samples that the gate rejects.

use super::classic::{AxisKalman, Tutorial};
use super::*;
use crate::attitude::{EulerAngles, Quaternion, Vector3};
use crate::units::STANDARD_GRAVITY_M_S2;

const GRAVITY: Vector3 = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);

/// Returns an ideal sensor's sample in this attitude, turning at this rate without acceleration.
pub(crate) fn sample(t_us: u64, attitude: Quaternion, rate_rad_s: Vector3) -> Sample {
    Sample {
        t_us,
        specific_force_m_s2: attitude.conjugate().rotate(GRAVITY),
        angular_rate_rad_s: rate_rad_s,
        ..Sample::default()
    }
}

pub(crate) fn from_degrees(roll: f32, pitch: f32, yaw: f32) -> Quaternion {
    Quaternion::from_euler(EulerAngles {
        roll_rad: roll.to_radians(),
        pitch_rad: pitch.to_radians(),
        yaw_rad: yaw.to_radians(),
    })
}

/// Returns the angle between two attitudes, in degrees.
pub(crate) fn angle_between(a: Quaternion, b: Quaternion) -> f32 {
    let difference = a.conjugate().multiply(b).normalize();
    let vector = Vector3::new(difference.x, difference.y, difference.z);
    2.0 * f32::atan2(vector.norm(), difference.w.abs()).to_degrees()
}

fn is_rotation(attitude: Quaternion) -> bool {
    (attitude.dot(attitude) - 1.0).abs() < 1e-3
}

/// Any of the filters, so that one loop tests them all.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a test has room for it")]
enum Any {
    Kalman(Kalman),
    AxisKalman(AxisKalman),
    Tutorial(Tutorial),
}

impl Any {
    fn get(&self) -> &dyn Filter {
        match self {
            Self::Kalman(filter) => filter,
            Self::AxisKalman(filter) => filter,
            Self::Tutorial(filter) => filter,
        }
    }

    fn get_mut(&mut self) -> &mut dyn Filter {
        match self {
            Self::Kalman(filter) => filter,
            Self::AxisKalman(filter) => filter,
            Self::Tutorial(filter) => filter,
        }
    }
}

impl Filter for Any {
    fn restart(&mut self) {
        self.get_mut().restart();
    }

    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        self.get_mut().start(sample, shows_gravity);
    }

    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        self.get_mut().update(sample, dt_s, shows_gravity);
    }

    fn attitude(&self) -> Quaternion {
        self.get().attitude()
    }

    fn body_rates_rad_s(&self) -> Vector3 {
        self.get().body_rates_rad_s()
    }
}

fn all() -> [Estimator<Any>; 3] {
    [
        Any::Kalman(Kalman::new()),
        Any::AxisKalman(AxisKalman::new()),
        Any::Tutorial(Tutorial::new()),
    ]
    .map(Estimator::with_filter)
}

#[test]
fn the_first_sample_sets_the_tilt_and_yaw_is_zero() {
    for mut estimator in all() {
        let pose = from_degrees(35.0, -20.0, 0.0);
        let estimate = estimator.update(&sample(1_000, pose, Vector3::ZERO));
        assert_eq!(estimate.issues, Issues::empty());
        // The classic angles are not Euler angles: its roll is that of a level nose.
        let tolerance = match estimator.filter {
            Any::Kalman(_) | Any::AxisKalman(_) => 1e-3,
            Any::Tutorial(_) => 4.0,
        };
        assert!(angle_between(estimate.attitude, pose) < tolerance);
        assert!(estimate.attitude.to_euler().yaw_rad.abs() < 1e-6);
    }
}

#[test]
fn a_rejected_sample_changes_nothing() {
    for mut estimator in all() {
        let pose = from_degrees(10.0, 0.0, 0.0);
        let rate = Vector3::new(0.1, 0.2, 0.3);
        let good = estimator.update(&sample(1_000, pose, rate));
        let before = estimator;
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 401.0, f32::MIN] {
            let mut wrong_force = sample(2_000, pose, rate);
            wrong_force.specific_force_m_s2.y = bad;
            let mut wrong_rate = sample(2_000, pose, rate);
            wrong_rate.angular_rate_rad_s.z = bad;
            for wrong in [wrong_force, wrong_rate] {
                let estimate = estimator.update(&wrong);
                assert!(estimate.issues.contains(Issues::REJECTED));
                assert_eq!(estimate.attitude, good.attitude);
                assert_eq!(estimate.body_rates_rad_s, rate);
                assert_eq!(estimator, before);
            }
        }
        // Every axis at full scale, ±16 g and ±2000 °/s.
        let full_scale = Sample {
            specific_force_m_s2: Vector3::new(157.0, -157.0, 157.0),
            angular_rate_rad_s: Vector3::new(-34.9, 34.9, 34.9),
            ..sample(2_000, pose, rate)
        };
        let estimate = estimator.update(&full_scale);
        assert!(!estimate.issues.contains(Issues::REJECTED));
    }
}

#[test]
fn a_lost_sample_is_bridged_by_the_next() {
    // 100 °/s of roll; the estimator does not see the samples between 40 and 60 ms.
    let rate = Vector3::new(100_f32.to_radians(), 0.0, 0.0);
    let mut estimator = Estimator::with_filter(AxisKalman::new());
    for millisecond in (0..100).filter(|ms| !(40..60).contains(ms)) {
        let pose = from_degrees(0.1 * millisecond as f32, 0.0, 0.0);
        let estimate = estimator.update(&sample(1_000 * millisecond, pose, rate));
        assert!(angle_between(estimate.attitude, pose) < 1e-3);
        // The first sample's rate is a jump from zero.
        assert_eq!(estimate.issues - Issues::RATE_JUMP, Issues::empty());
    }
}

#[test]
fn a_time_that_does_not_increase_holds_the_attitude() {
    let rate = Vector3::new(1.0, 0.0, 0.0);
    for mut estimator in all() {
        let pose = from_degrees(5.0, 5.0, 0.0);
        let held = estimator.update(&sample(1_000_000, pose, rate)).attitude;
        for t_us in [1_000_000, 999_999, 0] {
            let estimate = estimator.update(&sample(t_us, pose, rate));
            assert!(estimate.issues.contains(Issues::TIME_WENT_BACK), "{t_us}");
            assert_eq!(estimate.attitude, held);
        }
        // The time went back to zero, and continues from there.
        let estimate = estimator.update(&sample(10_000, pose, rate));
        assert_eq!(estimate.issues, Issues::empty());
        assert_ne!(estimate.attitude, held);
    }
}

#[test]
fn a_gap_resets_the_tilt_and_keeps_yaw() {
    let mut estimator = Estimator::with_filter(AxisKalman::new());
    let turn = Vector3::new(0.0, 0.0, 1.0);
    for millisecond in 0..=500 {
        estimator.update(&sample(millisecond * 1000, Quaternion::IDENTITY, turn));
    }
    let yaw = estimator.estimate().attitude.to_euler().yaw_rad;
    assert!((yaw - 0.5).abs() < 1e-3);
    let pose = from_degrees(60.0, -40.0, 0.0);
    let t_us = 500_000 + LONGEST_STEP_US;
    let estimate = estimator.update(&sample(t_us, pose, Vector3::ZERO));
    assert!(!estimate.issues.contains(Issues::GAP));
    let estimate = estimator.update(&sample(t_us + LONGEST_STEP_US + 1, pose, Vector3::ZERO));
    assert!(estimate.issues.contains(Issues::GAP));
    let angles = estimate.attitude.to_euler();
    assert!((angles.roll_rad.to_degrees() - 60.0).abs() < 1e-3);
    assert!((angles.pitch_rad.to_degrees() + 40.0).abs() < 1e-3);
}

#[test]
fn without_gravity_only_the_gyroscope_turns_the_attitude() {
    let rate = Vector3::new(0.5, 0.0, 0.0);
    let mut estimator = Estimator::with_filter(AxisKalman::new());
    estimator.update(&sample(0, Quaternion::IDENTITY, rate));
    for millisecond in 1..=1000 {
        let mut falling = sample(millisecond * 1000, Quaternion::IDENTITY, rate);
        // The remaining force points the wrong way.
        falling.specific_force_m_s2 = Vector3::new(0.9 * LEAST_SPECIFIC_FORCE_M_S2, 0.0, 0.0);
        let estimate = estimator.update(&falling);
        assert!(estimate.issues.contains(Issues::NO_GRAVITY));
    }
    let angles = estimator.estimate().attitude.to_euler();
    assert!((angles.roll_rad - 0.5).abs() < 1e-4, "{angles:?}");
    assert!(angles.pitch_rad.abs() < 1e-4);
}

#[test]
fn a_start_in_free_fall_finds_the_tilt_later() {
    for mut estimator in all() {
        for millisecond in 0..10 {
            let mut falling = sample(millisecond * 1000, Quaternion::IDENTITY, Vector3::ZERO);
            falling.specific_force_m_s2 = Vector3::ZERO;
            let estimate = estimator.update(&falling);
            assert!(estimate.issues.contains(Issues::NO_GRAVITY));
            assert_eq!(estimate.attitude, Quaternion::IDENTITY);
        }
        let pose = from_degrees(0.0, 30.0, 0.0);
        let estimate = estimator.update(&sample(10_000, pose, Vector3::ZERO));
        assert!(angle_between(estimate.attitude, pose) < 0.1);
    }
}

#[test]
fn a_restart_zeroes_yaw_and_sets_the_tilt_from_the_next_sample() {
    for mut estimator in all() {
        for millisecond in 0..300 {
            let rate = Vector3::new(0.3, 0.0, 1.0);
            estimator.update(&sample(millisecond * 1000, Quaternion::IDENTITY, rate));
        }
        assert!(estimator.estimate().attitude.to_euler().yaw_rad > 0.2);
        estimator.restart();
        let pose = from_degrees(0.0, 10.0, 0.0);
        let estimate = estimator.update(&sample(300_000, pose, Vector3::ZERO));
        assert!(angle_between(estimate.attitude, pose) < 0.1);
        // The jump is no motion, so the classic rate does not contain it.
        if let Any::Tutorial(filter) = estimator.filter {
            let angles = filter.angles();
            assert_eq!(angles.pitch_rate_deg_s, 0.0);
        }
    }
}

#[test]
fn a_restart_keeps_the_sign_of_the_quaternion() {
    for mut estimator in all() {
        // A steady turn about the vertical must not be taken for rest.
        if let Any::Kalman(filter) = &mut estimator.filter {
            filter.set_armed(true);
        }
        // After 300° of yaw the scalar part is negative.
        for millisecond in 0..3_000 {
            let rate = Vector3::new(0.0, 0.0, 100_f32.to_radians());
            estimator.update(&sample(millisecond * 1000, Quaternion::IDENTITY, rate));
        }
        let before = estimator.estimate().attitude;
        assert!(before.w < -0.8);
        estimator.restart();
        let level = sample(3_000_000, Quaternion::IDENTITY, Vector3::ZERO);
        let after = estimator.update(&level).attitude;
        assert!(after.w < -0.99 && after.dot(before) > 0.8, "{after:?}");
    }
}

#[test]
fn any_input_leaves_a_rotation_and_good_samples_restore_it() {
    let extremes = [
        0.0,
        -0.0,
        f32::NAN,
        f32::INFINITY,
        f32::MAX,
        f32::MIN_POSITIVE,
        9_999.0,
        -999.0,
        1.0,
        -9.8,
    ];
    let times = [0, 1, 1, 700_000, 700_001, u64::MAX, 3, 1_000_003, 1_000_103];
    for mut estimator in all() {
        let mut index = 0_usize;
        let mut next = || {
            index = index
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            index >> 33
        };
        for _ in 0..50_000 {
            let mut number = || extremes[next() % extremes.len()];
            let specific_force_m_s2 = Vector3::new(number(), number(), number());
            let angular_rate_rad_s = Vector3::new(number(), number(), number());
            let estimate = estimator.update(&Sample {
                t_us: times[next() % times.len()],
                specific_force_m_s2,
                angular_rate_rad_s,
                ..Sample::default()
            });
            assert!(is_rotation(estimate.attitude), "{estimate:?}");
            assert!(estimate.body_rates_rad_s.is_within(1.0e3));
        }
        let pose = from_degrees(12.0, 0.0, 0.0);
        let mut last = estimator.estimate().attitude;
        for millisecond in 0..8_000 {
            let good = sample(2_000_000_000 + millisecond * 1000, pose, Vector3::ZERO);
            last = estimator.update(&good).attitude;
        }
        let tilt_error = (last.down_in_body() - pose.down_in_body()).norm();
        // The accelerometer bias that the extreme samples caused decays more slowly.
        let tolerance = match estimator.filter {
            Any::Kalman(_) => 2e-2,
            Any::AxisKalman(_) | Any::Tutorial(_) => 2e-3,
        };
        assert!(tilt_error < tolerance, "{:?}", estimator.filter);
    }
}
