//! The fit against readings with known iron.

use super::*;
use crate::attitude::{BodyVector, EulerAngles, Quaternion, Vector3};
use crate::calibration::Mount;

/// Berlin's field with north at a yaw of 0.7 rad, µT.
const STRENGTH_UT: f32 = 49.7;
const DIP_RAD: f32 = 1.187;

fn field() -> Vector3 {
    let (north, down) = (STRENGTH_UT * DIP_RAD.cos(), STRENGTH_UT * DIP_RAD.sin());
    Vector3::new(north * 0.7_f32.cos(), north * 0.7_f32.sin(), down)
}

/// Soft iron with gains that differ by 20 %, and strong hard iron.
const SOFT: [Vector3; 3] = [
    Vector3::new(1.10, 0.03, -0.02),
    Vector3::new(0.01, 0.92, 0.04),
    Vector3::new(0.02, -0.03, 0.98),
];
const HARD: Vector3 = Vector3::new(60.0, -35.0, 20.0);

/// Motion of a person who turns the vehicle about all axes for 30 s, to and fro.
fn attitude(t_s: f32) -> Quaternion {
    Quaternion::from_euler(EulerAngles {
        roll_rad: 3.0 * (0.9 * t_s).sin(),
        pitch_rad: 1.5 * (0.53 * t_s + 0.4).sin(),
        yaw_rad: 2.8 * (0.31 * t_s).sin(),
    })
}

/// Small deterministic noise.
fn noise(seed: &mut u32) -> f32 {
    *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*seed >> 8) as f32 / (1 << 23) as f32 - 1.0
}

/// Reading in body axes for an attitude, of a compass with iron.
fn reading(attitude: Quaternion, seed: &mut u32) -> Vector3 {
    let body = attitude.conjugate().rotate(field());
    let [x, y, z] = SOFT.map(|row| row.dot(body));
    let noise = Vector3::new(noise(seed), noise(seed), noise(seed));
    Vector3::new(x, y, z) + HARD + noise.scale(0.7)
}

fn fitter(seconds: f32, motion: impl Fn(f32) -> Quaternion) -> CompassFitter {
    let (mut fitter, mut seed) = (CompassFitter::new(), 7);
    for nth in 0..(50.0 * seconds) as u16 {
        let attitude = motion(f32::from(nth) * 0.02);
        fitter.add(attitude, reading(attitude, &mut seed));
    }
    fitter
}

/// Largest angle between the corrected field and the true one, degrees.
fn worst_error_deg(fit: &CompassFit, mounted: impl Fn(Vector3) -> Vector3) -> f32 {
    let mut seed = 3;
    let mut worst = 0.0_f32;
    for nth in 0..200 {
        let attitude = attitude(100.0 + nth as f32 * 0.17);
        let found = fit.correction.apply(mounted(reading(attitude, &mut seed)));
        let truth = attitude.conjugate().rotate(field());
        let angle = found.cross(truth).norm().atan2(found.dot(truth));
        worst = worst.max(angle.to_degrees());
    }
    worst
}

#[test]
fn iron_gains_and_field_are_found() {
    let fit = fitter(30.0, attitude).fit(Mount::Z_UP).expect("it fits");
    assert_eq!(fit.mount, Mount::Z_UP);
    assert!((fit.dip_rad - DIP_RAD).abs() < 0.02, "{fit:?}");
    assert!(
        (fit.strength_ut / STRENGTH_UT - 1.0).abs() < 0.03,
        "{fit:?}"
    );
    assert!(fit.residual_ut < 1.0, "{fit:?}");
    let worst = worst_error_deg(&fit, |body| body);
    assert!(worst < 3.0, "{worst}");
    // Without a correction the field is wrong by far more.
    let nothing = CompassFit {
        correction: CompassCorrection::NONE,
        ..fit
    };
    assert!(worst_error_deg(&nothing, |body| body) > 40.0);
}

#[test]
fn a_compass_on_an_unknown_mount_is_fitted_with_its_mount() {
    let truth = Mount::parse("-y+x").expect("a mount");
    for assumed in [Mount::Z_UP, Mount::Z_DOWN, truth] {
        let to_assumed = |body: Vector3| assumed.to_body(truth.to_sensor(BodyVector(body))).0;
        let (mut fitter, mut seed) = (CompassFitter::new(), 7);
        for nth in 0..1_500_u16 {
            let attitude = attitude(f32::from(nth) * 0.02);
            fitter.add(attitude, to_assumed(reading(attitude, &mut seed)));
        }
        let fit = fitter.fit(assumed).expect("it fits");
        assert_eq!(fit.mount, truth, "assumed {assumed}");
        let on_found = |body: Vector3| fit.mount.to_body(truth.to_sensor(BodyVector(body))).0;
        let worst = worst_error_deg(&fit, on_found);
        assert!(worst < 3.0, "{assumed}: {worst}");
    }
}

#[test]
fn too_little_motion_is_refused_with_the_reason() {
    let refusal = |fitter: CompassFitter| fitter.fit(Mount::Z_UP).expect_err("it is refused");
    let short = refusal(fitter(5.0, attitude));
    assert_eq!(short, CompassFitError::TooFew { have: 250 });
    let yaw_only = |t_s: f32| {
        Quaternion::from_euler(EulerAngles {
            roll_rad: 0.0,
            pitch_rad: 0.0,
            yaw_rad: t_s,
        })
    };
    let level = refusal(fitter(30.0, yaw_only));
    assert_eq!(level, CompassFitError::Missing(Side::Nose));
    assert_eq!(level.to_string(), "it was never nose down");
    let still = refusal(fitter(30.0, |_| Quaternion::IDENTITY));
    assert!(matches!(still, CompassFitError::Missing(_)), "{still}");
}

#[test]
fn readings_that_contradict_the_motion_are_refused() {
    // A magnet that stays where it is while the vehicle turns.
    let (mut fitter, mut seed) = (CompassFitter::new(), 7);
    for nth in 0..1_500_u16 {
        let attitude = attitude(f32::from(nth) * 0.02);
        let wave = (f32::from(nth) * 0.05).sin();
        let magnet = Vector3::new(25.0 * wave, 0.0, -15.0 * wave);
        fitter.add(attitude, reading(attitude, &mut seed) + magnet);
    }
    let error = fitter.fit(Mount::Z_UP).expect_err("it is refused");
    assert!(
        matches!(error, CompassFitError::Inconsistent { .. }),
        "{error}"
    );
    assert!(error.to_string().contains("go away from iron"));
}

/// A computer's recording may have a reading in each row, at 1 kHz for minutes.
#[test]
fn no_number_of_readings_hides_a_contradiction() {
    let (mut fitter, mut seed) = (CompassFitter::new(), 7);
    for nth in 0..80_000_u32 {
        let t_s = nth as f32 * 0.001;
        let attitude = attitude(t_s);
        let wave = (t_s * 2.5).sin();
        let magnet = Vector3::new(25.0 * wave, 0.0, -15.0 * wave);
        fitter.add(attitude, reading(attitude, &mut seed) + magnet);
    }
    assert_eq!(fitter.readings(), 80_000);
    let error = fitter.fit(Mount::Z_UP).expect_err("it is refused");
    let is_found = matches!(error, CompassFitError::Inconsistent { .. });
    assert!(is_found, "{error}");
}

#[test]
fn a_dead_axis_is_named() {
    for dead in [Vector3::new(0.0, 1.0, 1.0), Vector3::ZERO] {
        let (mut fitter, mut seed) = (CompassFitter::new(), 7);
        for nth in 0..1_500_u16 {
            let attitude = attitude(f32::from(nth) * 0.02);
            let Vector3 { x, y, z } = reading(attitude, &mut seed);
            fitter.add(attitude, Vector3::new(dead.x * x, dead.y * y, dead.z * z));
        }
        let error = fitter.fit(Mount::Z_UP).expect_err("it is refused");
        assert_eq!(error, CompassFitError::Unchanging);
    }
}

/// The gyroscope's scale error of 1 % turns the attitude slowly.
#[test]
fn an_attitude_that_drifts_a_little_is_good_enough() {
    let (mut fitter, mut seed) = (CompassFitter::new(), 7);
    for nth in 0..1_500_u16 {
        let t_s = f32::from(nth) * 0.02;
        let truth = attitude(t_s);
        let drift = Quaternion::from_rotation_vector(Vector3::new(0.0, 0.0, 0.0015 * t_s));
        fitter.add(drift.multiply(truth), reading(truth, &mut seed));
    }
    let fit = fitter.fit(Mount::Z_UP).expect("it fits");
    let worst = worst_error_deg(&fit, |body| body);
    assert!(worst < 4.0, "{worst}");
}

#[test]
fn coverage_grows_with_the_directions() {
    let mut coverage = Coverage::default();
    assert_eq!(
        (coverage.percent(), coverage.missing_side()),
        (0, Some(Side::Nose))
    );
    coverage.add(Quaternion::IDENTITY);
    assert_eq!(coverage.percent(), 16);
    assert_eq!(fitter(30.0, attitude).coverage().missing_side(), None);
}
