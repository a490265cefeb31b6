//! Accelerations, falls and readings that contradict the tilt.

use super::covariance_step::{dense, is_positive};
use super::*;

#[test]
fn a_long_acceleration_tilts_little_and_briefly() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    world.run(&mut estimator, 20_000);
    world.acceleration_m_s2 = Vector3::new(3.0, 0.0, 0.0);
    let worst = world.worst_error_degrees(&mut estimator, 5_000);
    world.acceleration_m_s2 = Vector3::ZERO;
    assert!(worst < 3.5, "{worst}");
    let estimate = world.run(&mut estimator, 5_000);
    let error = world.tilt_error_degrees(estimate.attitude);
    assert!(error < 1.0, "{error}");
}

/// Moves for half a minute without a rest, and ends without a rate.
fn wander(world: &mut World, estimator: &mut Estimator<Kalman>) {
    for millisecond in 0..30_000 {
        let phase = 2.0e-3 * millisecond as f32;
        world.rate_rad_s.y = 0.1 * phase.cos();
        world.acceleration_m_s2 = Vector3::new(phase.sin(), (1.3 * phase).cos(), 0.0);
        world.run(estimator, 1);
    }
    world.rate_rad_s = Vector3::ZERO;
}

/// The vehicle starts in motion and was never at rest. Then it flies steadily at 15 m/s, which
/// reads like rest.
#[test]
fn steady_motion_after_a_long_acceleration_restores_the_tilt() {
    for bias_rad_s in [Vector3::ZERO, Vector3::new(0.04, -0.03, 0.05)] {
        let mut world = World::at_rest(from_degrees(0.0, 20.0, 0.0));
        world.bias_rad_s = bias_rad_s;
        let mut estimator = estimator();
        wander(&mut world, &mut estimator);
        world.acceleration_m_s2 = Vector3::new(3.0, 0.0, 0.0);
        let mut worst: f32 = 0.0;
        for _ in 0..50 {
            let estimate = world.run(&mut estimator, 100);
            worst = worst.max(world.tilt_error_degrees(estimate.attitude));
        }
        assert!(worst < 3.5, "{worst}");
        world.acceleration_m_s2 = Vector3::ZERO;
        let estimate = world.run(&mut estimator, 5_000);
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(error < 0.5, "{error}");
    }
}

/// A vehicle that was never at rest has its first rest while it coasts at up to 20 m/s. The
/// velocity is no error of the tilt.
#[test]
fn a_first_rest_while_coasting_keeps_the_promise() {
    for acceleration_m_s2 in [2.0, 3.0, 4.0] {
        for (seconds, direction_rad) in [(2, 0.0_f32), (3, 0.7), (4, 3.0), (5, 1.5), (5, 0.7)] {
            let mut world = World::at_rest(from_degrees(0.0, 20.0, 0.0));
            world.bias_rad_s = Vector3::new(0.04, -0.03, 0.05);
            let mut estimator = estimator();
            wander(&mut world, &mut estimator);
            let direction = Vector3::new(direction_rad.cos(), direction_rad.sin(), 0.0);
            world.acceleration_m_s2 = direction.scale(acceleration_m_s2);
            world.run(&mut estimator, 1_000 * seconds);
            world.acceleration_m_s2 = Vector3::ZERO;
            for _ in 0..100 {
                let estimate = world.run(&mut estimator, 100);
                let error_deg = world.tilt_error_degrees(estimate.attitude);
                let allowed_deg = degrees(6.0 * estimate.tilt_sigma_rad()).max(5.0);
                let text = format!("{acceleration_m_s2} m/s² for {seconds} s: {error_deg}°");
                assert!(error_deg < allowed_deg, "{text}");
            }
            let error_deg = world.tilt_error_degrees(estimator.estimate().attitude);
            assert!(error_deg < 0.5 && estimator.estimate().is_bias_known);
        }
    }
}

#[test]
fn implausible_readings_leave_a_filter_that_recovers() {
    let (mut rests, mut slow, mut broken) = (0, 0, 0);
    for seed in 1..200 {
        for rest in rests_after_implausible_readings(seed) {
            rests += 1;
            slow += i32::from(rest.error_deg > 2.0);
            broken += i32::from(rest.is_promise_broken);
        }
    }
    // After 12 s hardly any still converges: 1 of 15,000 with these and other seeds.
    assert!(600 * slow < rests, "{slow} of {rests}");
    // After 3 s none of the 15,000 breaks the promise.
    assert_eq!(broken, 0, "of {rests}");
}

struct RestAfterReadings {
    /// Error of the tilt at its end, degrees.
    error_deg: f32,
    /// True if a valid tilt was wrong by more than it may be.
    is_promise_broken: bool,
}

/// Feeds readings that no sensor delivers, with rests of 12 s between them.
fn rests_after_implausible_readings(seed: u64) -> Vec<RestAfterReadings> {
    let mut rests = Vec::new();
    let mut random = Random(seed);
    let mut estimator = estimator();
    let mut t_us = 0_u64;
    for round in 0..200 {
        for _ in 0..200 {
            t_us +=
                [0, 1, 100, 1000, 20_000, 500_000, 600_000][(random.next().abs() * 6.99) as usize];
            let scale = [
                0.0,
                1.0e-20,
                1.0,
                30.0,
                900.0,
                5.0e3,
                f32::NAN,
                f32::INFINITY,
            ][(random.next().abs() * 7.99) as usize];
            let mut sample = Sample {
                t_us,
                specific_force_m_s2: random.vector(scale),
                angular_rate_rad_s: random.vector(scale.min(300.0)),
                ..Sample::default()
            };
            sample.is_rate_saturated = random.next() > 0.8;
            sample.is_force_saturated = random.next() > 0.8;
            let estimate = estimator.update(&sample);
            let q = estimate.attitude;
            assert!((q.dot(q) - 1.0).abs() < 1.0e-3, "{estimate:?}");
            let filter = filter(&estimator);
            assert!(filter.tilt_sigma_rad() >= 0.0);
            assert!(filter.bias_rad_s().is_within(LARGEST_GYROSCOPE_BIAS_RAD_S));
            assert!(filter.linear_acceleration_m_s2().is_within(1.0e5));
        }
        if round % 20 == 0 {
            let mut world = World::at_rest(from_degrees(40.0 * random.next(), 30.0, 0.0));
            world.t_us = t_us;
            let mut rest = RestAfterReadings {
                error_deg: 0.0,
                is_promise_broken: false,
            };
            for milliseconds in [3_000, 9_000] {
                let estimate = world.run(&mut estimator, milliseconds);
                rest.error_deg = world.tilt_error_degrees(estimate.attitude);
                let sigma = filter(&estimator).tilt_sigma_rad().to_degrees();
                let is_promised = estimate.is_bias_known || milliseconds == 9_000;
                rest.is_promise_broken |= is_promised && rest.error_deg > (6.0 * sigma).max(5.0);
            }
            rests.push(rest);
            while filter(&estimator).step.is_under_way() {
                world.run(&mut estimator, 1);
            }
            assert!(is_positive(&dense(&filter(&estimator).step.covariance)));
            t_us = world.t_us;
        }
    }
    rests
}

/// Found in a recording that starts in fast motion: the tilt was 170° wrong for 20 s, because no
/// interval of the shaking showed gravity for long.
#[test]
fn shaking_does_not_hide_that_the_tilt_is_wrong() {
    for seed in 1..20 {
        let mut random = Random(seed);
        let attitude = from_degrees(180.0 * random.next(), 80.0 * random.next(), 0.0);
        let mut world = World::at_rest(attitude);
        let mut estimator = estimator();
        world.run(&mut estimator, 400);
        let over = Quaternion::from_rotation_vector(Vector3::new(2.8, 0.3 * random.next(), 0.0));
        let filter = estimator.filter_mut();
        filter.nominal.attitude = over.multiply(filter.nominal.attitude);
        filter.reset_tilt_and_velocity(square(filter.tuning.start_tilt_rad));
        let shaking = random.vector(12.0);
        let phase = 3.0 * random.next();
        let mut error = f32::INFINITY;
        for millisecond in 0..3_000_u16 {
            let wave = (0.02 * f32::from(millisecond) + phase).sin();
            world.acceleration_m_s2 = shaking.scale(wave);
            let estimate = world.run(&mut estimator, 1);
            error = world.tilt_error_degrees(estimate.attitude);
        }
        assert!(error < 40.0, "{seed}: {error}");
    }
}

/// A drone that dashes sideways with 1.1 g, and falls with 0.3 g, reads a force 58° from up. The
/// other two have means of about one g, over 45° from up, with their ends.
#[test]
fn a_dash_is_no_wrong_tilt() {
    let dash = [(11.0, 3.0, 1_200), (-11.0, -3.0, 1_200)];
    let bank_and_fall = [(17.0, 0.0, 1_100), (0.0, 9.0, 440), (-17.0, -3.6, 1_100)];
    let steep_bank = [(13.8, 4.8, 1_200), (-13.8, -4.8, 1_200), (0.0, 0.0, 1_000)];
    for manoeuvre in [dash.as_slice(), &bank_and_fall, &steep_bank] {
        for begin_ms in (0..2_000).step_by(100) {
            let mut world = World::at_rest(Quaternion::IDENTITY);
            let mut estimator = estimator();
            world.run(&mut estimator, 3_000 + begin_ms);
            let mut worst: f32 = 0.0;
            for (north, down, milliseconds) in manoeuvre.iter().copied().chain([(0.0, 0.0, 2_500)])
            {
                world.acceleration_m_s2 = Vector3::new(north, 0.0, down);
                worst = worst.max(world.worst_error_degrees(&mut estimator, milliseconds));
            }
            assert!(worst < 10.0, "{manoeuvre:?} at {begin_ms} ms: {worst}");
        }
    }
}

/// An aeroplane that pushes over reads a force towards the ground. Its attitude stays right, and is
/// not `VALID` from 1.8 s on.
#[test]
fn a_push_over_is_no_wrong_tilt() {
    for push_ms in [1_000, 2_000, 3_000] {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        let mut estimator = estimator();
        world.run(&mut estimator, 3_000);
        estimator.filter_mut().set_armed(true);
        world.acceleration_m_s2 = Vector3::new(0.0, 0.0, 1.9 * STANDARD_GRAVITY_M_S2);
        for millisecond in 0..push_ms {
            let estimate = world.run(&mut estimator, 1);
            assert!(world.tilt_error_degrees(estimate.attitude) < 5.0);
            let is_certain = estimate.tilt_sigma_rad() < USABLE_TILT_RAD;
            assert!(millisecond < 1_800 || !is_certain, "{millisecond} ms");
        }
        world.acceleration_m_s2 = Vector3::ZERO;
        let estimate = world.run(&mut estimator, 500);
        assert!(world.tilt_error_degrees(estimate.attitude) < 5.0);
        assert!(estimate.tilt_sigma_rad() < radians(10.0));
    }
}

/// A tilt that is wrong, and whose σ is small, is not believed from 1.8 s on, and right after 5 s.
#[test]
fn a_certain_tilt_that_is_wrong_is_set_within_five_seconds() {
    let mut world = World::at_rest(from_degrees(10.0, 20.0, 0.0));
    let mut estimator = estimator();
    world.run(&mut estimator, 4_000);
    estimator.filter_mut().set_armed(true);
    let over = Quaternion::from_rotation_vector(Vector3::new(2.8, 0.3, 0.0));
    let filter = estimator.filter_mut();
    filter.nominal.attitude = over.multiply(filter.nominal.attitude);
    assert!(world.run(&mut estimator, 1).tilt_sigma_rad() < radians(5.0));
    world.run(&mut estimator, 1_800);
    for _ in 0..3_200 {
        let estimate = world.run(&mut estimator, 1);
        assert!(estimate.tilt_sigma_rad() > radians(10.0));
    }
    let estimate = world.run(&mut estimator, 100);
    let error = world.tilt_error_degrees(estimate.attitude);
    assert!(error < 10.0, "{error}");
}

/// A roll ends the comparison with the last rest. Readings of free fall are no rest either.
#[test]
fn free_fall_after_a_roll_leaves_the_tilt_certain() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    world.run(&mut estimator, 4_000);
    world.rate_rad_s = Vector3::new(1.5, 0.0, 0.0);
    world.run(&mut estimator, 500);
    world.rate_rad_s = Vector3::ZERO;
    world.acceleration_m_s2 = Vector3::new(0.0, 0.0, STANDARD_GRAVITY_M_S2);
    for millisecond in 0..600 {
        let estimate = world.run(&mut estimator, 1);
        let sigma = degrees(estimate.tilt_sigma_rad());
        assert!(sigma < 5.0, "{sigma} at {millisecond} ms");
    }
}

/// The forces before a reset of the motion say nothing of the tilt after it.
#[test]
fn a_reset_of_the_motion_begins_the_comparison_anew() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    world.rate_rad_s = Vector3::new(0.1, 0.0, 0.0);
    let mut estimator = estimator();
    world.run(&mut estimator, 400);
    estimator.filter_mut().inflate_motion(0.03);
    world.run(&mut estimator, 1_000);
    let filter = estimator.filter_mut();
    assert!(filter.force_sum != ForceSum::NONE);
    filter.inflate_motion(0.03);
    assert_eq!(filter.force_sum, ForceSum::NONE);
}
