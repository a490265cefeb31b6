//! Fits of poses of a sensor with known errors.

use super::*;
use crate::attitude::Vector3;
use crate::calibration::{NoiseModel, StationaryMean};
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

const SCALE: NoiseModel = NoiseModel::FOR_TESTS;

/// A sensor with every error: reading = S·f + o, in g.
fn reading(force: Vector3) -> Vector3 {
    Vector3::new(
        1.02 * force.x + 0.008 * force.y - 0.004 * force.z + 0.03,
        0.008 * force.x + 0.985 * force.y + 0.006 * force.z - 0.045,
        -0.004 * force.x + 0.006 * force.y + 1.01 * force.z + 0.06,
    )
}

fn at_rest(reading_g: Vector3) -> StationaryMean {
    StationaryMean {
        accelerometer_counts: reading_g.scale(SCALE.counts_per_g),
        samples: 1000,
        ..StationaryMean::default()
    }
}

fn collected(poses: impl IntoIterator<Item = Pose>) -> PoseCollector {
    let mut collector = PoseCollector::new(&SCALE);
    for pose in poses {
        collector
            .add(&at_rest(reading(pose.up())))
            .expect("a new pose");
    }
    collector
}

#[test]
fn twelve_poses_find_all_nine_parameters() {
    let fit = collected(Pose::GUIDE).fit().expect("a fit");
    assert!(fit.has_cross_axis);
    assert_eq!(fit.poses, 12);
    assert!(
        fit.residual_before_g > 0.03 && fit.residual_after_g < 1e-5,
        "{fit:?}"
    );
    for force in [Vector3::new(0.48, -0.6, 0.64), Vector3::new(-0.8, 0.6, 0.0)] {
        let read = reading(force).scale(STANDARD_GRAVITY_M_S2);
        let corrected = fit
            .correction
            .apply(read)
            .scale(1.0 / STANDARD_GRAVITY_M_S2);
        assert!((corrected - force).norm() < 1e-4, "{corrected:?}");
    }
    let text = fit.to_string();
    assert!(
        text.starts_with("12 poses, offset, scale and cross-axis: residual "),
        "{text}"
    );
    assert!(text.ends_with(", 0.00 mg after"), "{text}");
}

#[test]
fn six_poses_find_offset_and_scale() {
    let fit = collected(Pose::GUIDE.into_iter().take(6))
        .fit()
        .expect("a fit");
    assert!(!fit.has_cross_axis);
    let matrix = fit.correction.matrix;
    assert_eq!([matrix.xy, matrix.xz, matrix.yz], [0.0; 3]);
    let offset = fit
        .correction
        .offset_m_s2
        .scale(1.0 / STANDARD_GRAVITY_M_S2);
    // The effect of the cross-axis terms is of second order.
    assert!(
        (offset - Vector3::new(0.03, -0.045, 0.06)).is_within(2e-3),
        "{offset:?}"
    );
    assert!((matrix.xx - 1.0 / 1.02).abs() < 1e-3);
}

#[test]
fn the_guide_goes_through_its_poses_and_names_them() {
    let mut collector = PoseCollector::new(&SCALE);
    for (index, pose) in Pose::GUIDE.into_iter().enumerate() {
        assert_eq!(collector.next_pose(), pose);
        assert_eq!(collector.count(), index);
        let accepted = collector.add(&at_rest(reading(pose.up()))).expect("new");
        assert_eq!(
            (usize::from(accepted.count), accepted.pose),
            (index + 1, Some(pose))
        );
    }
    assert_eq!(collector.next_pose(), Pose::GUIDE[0]);
    assert_eq!(Pose::GUIDE[0].to_string(), "z up");
    assert_eq!(
        Pose::GUIDE[7].to_string(),
        "x up and y down, halfway between"
    );
}

#[test]
fn repeated_and_impossible_poses_are_refused() {
    let mut collector = collected(Pose::GUIDE.into_iter().take(2));
    let almost = Vector3::new(0.2, 0.2, 0.96);
    let refused = collector.add(&at_rest(reading(almost))).unwrap_err();
    assert_eq!(refused, PoseError::Repeated { number: 1 });
    assert_eq!(
        refused.to_string(),
        "this is pose 1 again: turn it to another side"
    );
    let fall = collector.add(&at_rest(Vector3::new(0.1, 0.0, 0.3)));
    assert_eq!(fall, Err(PoseError::NoGravity));
    let nan = collector.add(&at_rest(Vector3::new(f32::NAN, 0.0, 1.0)));
    assert_eq!(nan, Err(PoseError::Saturated));
    let full_scale = StationaryMean {
        accelerometer_counts: Vector3::new(32767.0, 0.0, 0.0),
        ..StationaryMean::default()
    };
    assert_eq!(collector.add(&full_scale), Err(PoseError::Saturated));
    assert_eq!(collector.count(), 2, "refused poses are not collected");
}

#[test]
fn the_collector_refuses_a_pose_too_many() {
    let mut collector = PoseCollector::new(&SCALE);
    // A spiral whose turns are 20° apart and more.
    let mut refused = None;
    for index in 0..40 {
        let z = 1.0 - (2.0 * index as f32 + 1.0) / 40.0;
        let (sine, cosine) = (index as f32 * 2.399_963).sin_cos();
        let across = (1.0 - z * z).sqrt();
        let pose = Vector3::new(across * cosine, across * sine, z);
        if let Err(reason) = collector.add(&at_rest(pose)) {
            refused = Some(reason);
        }
    }
    assert_eq!(refused, Some(PoseError::Full));
    assert_eq!(collector.count(), MAX_POSES);
    assert!(collector.fit().expect("a perfect sensor").residual_after_g < 1e-5);
}

#[test]
fn bad_geometry_is_refused_with_what_is_missing() {
    let few = collected(Pose::GUIDE.into_iter().take(4))
        .fit()
        .unwrap_err();
    assert_eq!(few.to_string(), "4 of at least 6 poses");
    // A ring of poses and its pole: never upside down nor on a side.
    let ring = (0..8).map(|index| {
        let (sine, cosine) = (index as f32 * 0.785).sin_cos();
        reading(Vector3::new(0.5 * cosine, 0.5 * sine, 0.866))
    });
    let poses: Vec<_> = ring.chain([reading(Vector3::new(0.0, 0.0, 1.0))]).collect();
    let error = fit(&poses).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the poses do not show every direction: missing z down, x up, x down, y up, y down"
    );
    // All six sides but one.
    let poses: Vec<_> = [0, 2, 3, 4, 5, 6]
        .map(|index| reading(Pose::GUIDE[index].up()))
        .to_vec();
    let error = fit(&poses).unwrap_err();
    assert!(error.to_string().ends_with("missing z down"), "{error}");
}

#[test]
fn a_geometry_that_is_regular_but_weak_is_refused() {
    // Three rings down to 70° from z up: scale and offset of z are hardly separable.
    let ring = |polar: f32, number: u32| {
        (0..number).map(move |index| {
            let azimuth = core::f32::consts::TAU * index as f32 / number as f32;
            let (sine, cosine) = azimuth.sin_cos();
            let across = polar.sin();
            reading(Vector3::new(across * cosine, across * sine, polar.cos()))
        })
    };
    let cap = |widest: f32| -> Vec<Vector3> {
        ring(0.0, 1)
            .chain(ring(radians(35.0), 6))
            .chain(ring(radians(widest), 8))
            .collect()
    };
    let error = fit(&cap(70.0)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the poses do not show every direction: missing z down"
    );
    assert!(fit(&cap(140.0)).is_ok());
}

#[test]
fn impossible_sensors_are_refused() {
    let poses = Pose::GUIDE.map(|pose| pose.up().scale(1.18));
    assert_eq!(fit(&poses), Err(FitError::Implausible));
    let mut poses = Pose::GUIDE.map(|pose| reading(pose.up()));
    poses[6] = poses[6].scale(1.25);
    poses[9] = poses[9].scale(0.75);
    let error = fit(&poses).unwrap_err();
    assert!(
        matches!(error, FitError::Inconsistent { .. } | FitError::Implausible),
        "{error}"
    );
    assert!(fit(&[Vector3::new(f32::NAN, 0.0, 0.0); 12]).is_err());
    assert!(fit(&[Vector3::ZERO; 12]).is_err());
}
