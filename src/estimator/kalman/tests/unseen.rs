//! Motion that no sample shows: pauses and full-scale readings.

use super::*;

/// In a flight of the campaign, 97 ms at full scale gave a mean of one g sideways. The attitude
/// restarted from that mean, 63° off.
#[test]
fn short_full_scale_readings_are_not_used_as_gravity() {
    for milliseconds in (60..160).step_by(10) {
        for (x, y) in [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)] {
            let mut world = World::at_rest(from_degrees(30.0 * y, -30.0 * x, 0.0));
            let mut estimator = estimator();
            world.run(&mut estimator, 3_000);
            world.rate_rad_s = Vector3::new(0.1, -0.1, 0.05);
            for _ in 0..milliseconds {
                let mut sample = world.sample(1000);
                let full_scale = Vector3::new(x, y, 0.0).scale(16.0 * STANDARD_GRAVITY_M_S2);
                let across = Vector3::new(1.0 - x.abs(), 1.0 - y.abs(), 1.0);
                let Vector3 { x, y, z } = sample.specific_force_m_s2;
                sample.specific_force_m_s2 =
                    Vector3::new(x * across.x, y * across.y, z) + full_scale;
                sample.is_force_saturated = true;
                estimator.update(&sample);
            }
            let worst = world.worst_error_degrees(&mut estimator, 2_000);
            assert!(worst < 20.0, "{milliseconds} ms: {worst}");
        }
    }
}

#[test]
fn no_single_sample_counts_for_a_whole_pause() {
    for rate_degrees_s in [112.0, -400.0] {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        let mut estimator = estimator();
        estimator.filter_mut().set_sample_period(1.0e-3);
        world.run(&mut estimator, 3000);
        let mut first = world.sample(250_000);
        first.angular_rate_rad_s.x = radians(rate_degrees_s);
        first.specific_force_m_s2.y = 100.0;
        let estimate = estimator.update(&first);
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(error < 1.0, "{error}");
        let estimate = world.run(&mut estimator, 2000);
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(error < 1.0, "{error} after it");
    }
}

#[test]
fn a_tilt_that_a_pause_hides_is_taken_from_gravity() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    estimator.filter_mut().set_sample_period(1.0e-3);
    world.run(&mut estimator, 3000);
    world.rate_rad_s = Vector3::new(radians(250.0), 0.0, 0.0);
    world.run(&mut estimator, 200);
    // It turns by 75° more, and stops, while nothing is read.
    world.sample(300_000);
    world.rate_rad_s = Vector3::ZERO;
    let estimate = estimator.update(&world.sample(50_000));
    assert_eq!(estimate.tilt_variance_rad2, f32::INFINITY);
    // At first from one sample, then from the mean of 0.15 s.
    for (milliseconds, sigmas_degrees) in [(1, 30.0..50.0), (170, 10.0..20.0)] {
        let estimate = world.run(&mut estimator, milliseconds);
        let error = world.tilt_error_degrees(estimate.attitude);
        let sigma = estimate.tilt_sigma_rad().to_degrees();
        assert!(
            error < 1.0 && sigmas_degrees.contains(&sigma),
            "{error}, {sigma}"
        );
    }
}

#[test]
fn a_steady_turn_continues_through_a_pause() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    estimator.filter_mut().set_sample_period(1.0e-3);
    world.run(&mut estimator, 3000);
    world.rate_rad_s = Vector3::new(radians(100.0), 0.0, 0.0);
    world.run(&mut estimator, 200);
    let estimate = estimator.update(&world.sample(100_000));
    let error = world.tilt_error_degrees(estimate.attitude);
    assert!(error < 1.0, "{error}");
}

/// A gyroscope that clips for a moment keeps the attitude: gravity alone would know less in motion.
#[test]
fn a_short_full_scale_reading_does_not_restart_the_filter() {
    let mut world = World::at_rest(from_degrees(30.0, 0.0, 90.0));
    let mut estimator = estimator();
    world.run(&mut estimator, 4_000);
    // An acceleration from now on would set a wrong tilt.
    world.acceleration_m_s2 = Vector3::new(0.0, 6.0, 0.0);
    for _ in 0..35 {
        let mut sample = world.sample(1_000);
        sample.is_rate_saturated = true;
        sample.angular_rate_rad_s.z = radians(400.0);
        estimator.update(&sample);
    }
    // The turn slows down to what the sensor measures.
    let mut sample = world.sample(1_000);
    sample.angular_rate_rad_s.z = radians(390.0);
    estimator.update(&sample);
    let estimate = world.run(&mut estimator, 1);
    let error = world.tilt_error_degrees(estimate.attitude);
    assert!(error < 20.0, "{error}");
    assert!(error < degrees(6.0 * estimate.tilt_sigma_rad()), "{error}");
}

/// Full scale at 400 °/s hides 24° in 0.3 s and 36° in 0.45 s. Gravity shows the tilt better
/// from 30° on.
#[test]
fn full_scale_readings_lose_the_tilt_only_if_they_hide_much() {
    for (milliseconds, expected) in [(300, Tilt::Known), (450, Tilt::Lost)] {
        let mut world = World::at_rest(from_degrees(30.0, 0.0, 90.0));
        let mut estimator = estimator();
        world.run(&mut estimator, 4_000);
        for _ in 0..milliseconds {
            let mut sample = world.sample(1_000);
            sample.is_rate_saturated = true;
            sample.angular_rate_rad_s.z = radians(400.0);
            estimator.update(&sample);
        }
        let mut sample = world.sample(1_000);
        sample.angular_rate_rad_s.z = radians(390.0);
        estimator.update(&sample);
        assert_eq!(filter(&estimator).tilt, expected, "{milliseconds} ms");
    }
}

pub(super) fn at_full_scale(mut sample: Sample) -> Sample {
    sample.specific_force_m_s2.x = 16.0 * STANDARD_GRAVITY_M_S2;
    sample.is_force_saturated = true;
    sample
}

/// After a start in motion the tilt is uncertain, and a velocity would correct it by much.
#[test]
fn a_force_at_full_scale_corrects_no_tilt() {
    for milliseconds in [30, 100, 300, 1_000] {
        let mut world = World::at_rest(from_degrees(20.0, 10.0, 0.0));
        let mut estimator = estimator();
        world.acceleration_m_s2 = Vector3::new(2.0, -1.0, 0.0);
        world.run(&mut estimator, 200);
        world.acceleration_m_s2 = Vector3::ZERO;
        for _ in 0..milliseconds {
            let estimate = estimator.update(&at_full_scale(world.sample(1_000)));
            let error = world.tilt_error_degrees(estimate.attitude);
            assert!(error < 20.0, "{milliseconds} ms: {error}");
        }
        for _ in 0..1_000 {
            let estimate = world.run(&mut estimator, 1);
            let error = world.tilt_error_degrees(estimate.attitude);
            assert!(error < 20.0, "{milliseconds} ms: {error}");
        }
    }
}

/// In a loop the force exceeds full scale, and the mean of the clipped readings may point down.
#[test]
fn a_clipped_force_sets_no_tilt() {
    let mut world = World::at_rest(from_degrees(20.0, 10.0, 0.0));
    let mut estimator = estimator();
    world.acceleration_m_s2 = Vector3::new(2.0, -1.0, 0.0);
    world.run(&mut estimator, 200);
    world.acceleration_m_s2 = Vector3::ZERO;
    for _ in 0..3_000 {
        let mut sample = world.sample(1_000);
        sample.specific_force_m_s2 = -sample.specific_force_m_s2;
        sample.is_force_saturated = true;
        let estimate = estimator.update(&sample);
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(error < 45.0, "{error}");
    }
}

/// Runs an armed vehicle until a second after a pause.
fn armed_with_a_pause(pause_us: u64) -> (World, Estimator) {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    estimator.filter_mut().set_sample_period(1.0e-3);
    world.run(&mut estimator, 3_000);
    estimator.filter_mut().set_armed(true);
    world.run(&mut estimator, 1_000);
    assert_eq!(filter(&estimator).confirmation, Confirmation::Confirmed);
    estimator.update(&world.sample(pause_us));
    world.run(&mut estimator, 1_000);
    (world, estimator)
}

/// In a pause the vehicle may have begun a turn, which the filter then takes for level flight.
#[test]
fn after_a_pause_that_hides_a_turn_motion_has_to_confirm_the_bias() {
    for pause_us in [90_000, 250_000, 450_000, 2_000_000] {
        let (mut world, mut estimator) = armed_with_a_pause(pause_us);
        assert_eq!(filter(&estimator).confirmation, Confirmation::Suspect);
        let sigma = degrees(filter(&estimator).tilt_sigma_rad());
        assert!(sigma > 6.3, "{pause_us}: {sigma}");
        world.run(&mut estimator, 29_000);
        assert_eq!(filter(&estimator).confirmation, Confirmation::Confirmed);
        let sigma = degrees(filter(&estimator).tilt_sigma_rad());
        assert!(sigma < 4.0, "{pause_us}: {sigma}");
    }
    // One of 50 ms, as after a fault of the bus, does not.
    let (_, estimator) = armed_with_a_pause(50_000);
    assert_eq!(filter(&estimator).confirmation, Confirmation::Confirmed);
}

/// A rest shows the bias itself, so nothing has to be waited for.
#[test]
fn after_a_pause_a_rest_confirms_the_bias_within_a_second() {
    let (mut world, mut estimator) = armed_with_a_pause(250_000);
    estimator.filter_mut().set_armed(false);
    world.run(&mut estimator, 1_000);
    estimator.filter_mut().set_armed(true);
    world.run(&mut estimator, 1_000);
    assert_eq!(filter(&estimator).confirmation, Confirmation::Confirmed);
}

/// At few samples a second a changing rate makes σ grow, but nothing is hidden.
#[test]
fn a_changing_rate_at_few_samples_a_second_is_no_pause() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    world.run(&mut estimator, 3_000);
    estimator.filter_mut().set_sample_period(50.0e-3);
    estimator.filter_mut().set_armed(true);
    for step in 0..20 {
        let sign = if step % 2 == 0 { 1.0 } else { -1.0 };
        world.rate_rad_s = Vector3::new(sign * radians(100.0), 0.0, 0.0);
        estimator.update(&world.sample(50_000));
        let confirmation = filter(&estimator).confirmation;
        assert_ne!(confirmation, Confirmation::Suspect, "{step}");
    }
}

/// An arm that whirls a sensor of ±2 g clips its accelerometer all the time. The gyroscope shows
/// the turn.
#[test]
fn a_clipped_force_in_a_turn_loses_no_tilt() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    world.run(&mut estimator, 3_000);
    world.rate_rad_s = Vector3::new(7.0, 0.0, 0.0);
    let mut worst: f32 = 0.0;
    for millisecond in 0..3_000 {
        let mut sample = world.sample(1000);
        // Away from the shoulder.
        sample.specific_force_m_s2.y -= 7.0 * 7.0 * 0.6;
        sample.is_force_saturated = millisecond % 800 < 750;
        let estimate = estimator.update(&sample);
        worst = worst.max(world.tilt_error_degrees(estimate.attitude));
    }
    assert!(worst < 10.0, "{worst}");
}

/// Free fall from the first sample on: no tilt has been known, so a pause loses none.
#[test]
fn yaw_begins_at_zero_after_a_pause_in_a_fall() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    estimator.filter_mut().set_sample_period(1.0e-3);
    world.acceleration_m_s2.z = STANDARD_GRAVITY_M_S2;
    world.rate_rad_s.z = 3.0;
    world.run(&mut estimator, 300);
    // A turn that may have ended anywhere in the pause.
    world.rate_rad_s.z = 0.0;
    estimator.update(&world.sample(490_000));
    world.acceleration_m_s2.z = 0.0;
    let estimate = world.run(&mut estimator, 1);
    let yaw_deg = degrees(estimate.euler().yaw_rad);
    assert!(yaw_deg.abs() < 0.5, "{yaw_deg}");
}
