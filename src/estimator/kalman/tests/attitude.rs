//! Attitude, rates, acceleration and σ in healthy motion.

use super::super::propagation::Transition;
use super::*;
use crate::attitude::BodyVector;

#[test]
fn the_attitude_belongs_to_the_time_of_the_sample() {
    let rate = Vector3::new(radians(300.0), radians(-100.0), radians(50.0));
    let delay_us = 4000;
    let mut world = World::at_rest(Quaternion::IDENTITY);
    world.rate_noise = 0.0;
    let mut estimator = estimator();
    estimator.filter_mut().set_delay_us(delay_us);
    world.run(&mut estimator, 2_000);
    world.rate_rad_s = rate;
    let mut waiting = std::collections::VecDeque::new();
    for index in 0..500 {
        let now = world.sample(1000);
        waiting.push_back(now);
        if waiting.len() <= 4 {
            let mut still = World::at_rest(Quaternion::IDENTITY).sample(1000);
            still.t_us = now.t_us;
            still.angular_rate_rad_s = Vector3::ZERO;
            estimator.update(&still);
            continue;
        }
        let mut sample = waiting.pop_front().unwrap_or(now);
        sample.t_us = now.t_us;
        let estimate = estimator.update(&sample);
        if index > 10 {
            // 1.3° without: 320 °/s for 4 ms. The step in the rate costs half a sample.
            let error = world.tilt_error_degrees(estimate.attitude);
            assert!(error < 0.35, "{index}: {error}");
        }
    }
}

#[test]
fn a_delay_that_no_sensor_has_is_not_used() {
    let turn_deg = |delay_us| {
        let mut estimator = Estimator::new();
        estimator.filter_mut().set_delay_us(delay_us);
        let (level, rate) = (Vector3::new(0.0, 0.0, -9.81), Vector3::new(0.0, 0.0, 1.0));
        let estimate = estimator.update(&Sample::new(1_000, BodyVector(level), BodyVector(rate)));
        estimate.euler().yaw_rad.to_degrees()
    };
    let at_once = turn_deg(0);
    assert!((turn_deg(LONGEST_DELAY_US) - at_once - 5.73).abs() < 0.01);
    assert_eq!(turn_deg(LONGEST_DELAY_US + 1), at_once);
    assert_eq!(turn_deg(1_900_000), at_once);
}

#[test]
fn attitude_and_rates_are_continuous_in_every_attitude() {
    let mut random = Random(3);
    for _ in 0..20 {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        let mut estimator = estimator();
        let mut last = world.run(&mut estimator, 1500);
        let (mut steepest, mut upside_down): (f32, bool) = (0.0, false);
        let mut target = Vector3::ZERO;
        for index in 0..6_000 {
            if index % 500 == 0 {
                target = random.vector(radians(400.0));
            }
            world.rate_rad_s = world.rate_rad_s + (target - world.rate_rad_s).scale(0.01);
            let estimate = world.run(&mut estimator, 1);
            let most = 2.0 * 1.0e-3 * world.rate_rad_s.norm() + 0.02;
            let step = radians(angle_between(last.attitude, estimate.attitude));
            assert!(step < most, "{step} rad in a step");
            assert!(
                last.attitude.dot(estimate.attitude) > 0.99,
                "no change of sign"
            );
            let jump = (estimate.body_rates_rad_s - last.body_rates_rad_s).norm();
            assert!(
                jump < radians(15.0) + 0.05 * world.rate_rad_s.norm(),
                "{jump} rad/s"
            );
            let error = world.tilt_error_degrees(estimate.attitude);
            assert!(error < 2.0, "{index}: {error}");
            let down = world.attitude.down_in_body();
            steepest = steepest.max(down.x.abs());
            upside_down |= down.z < -0.5;
            last = estimate;
        }
        assert!(steepest > 0.9 && upside_down, "the motion goes everywhere");
    }
}

#[test]
fn any_sample_period_gives_the_same_attitude() {
    // The same motion at 1 kHz, and at steps between 0.2 and 40 ms.
    let mut random = Random(5);
    let mut world = World::at_rest(from_degrees(10.0, 5.0, 0.0));
    let mut estimator = estimator();
    for index in 0..4_000_u32 {
        world.rate_rad_s = Vector3::new(0.5, -0.3, 0.8).scale((index as f32 * 0.01).sin());
        let dt_us = (200.0 + 4000.0 * (random.next() + 1.0)) as u64;
        let dt_us = if index % 50 == 0 { 40_000 } else { dt_us };
        let estimate = estimator.update(&world.sample(dt_us));
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(index < 1000 || error < 1.5, "{index}: {error}");
    }
}

#[test]
fn three_sigma_hold_99_percent_of_the_errors() {
    let (mut within, mut total) = (0_u32, 0_u32);
    let mut ratios = Vec::new();
    for seed in 0..16 {
        let mut random = Random(1000 + seed);
        let mut world = World::at_rest(from_degrees(
            30.0 * random.next(),
            20.0 * random.next(),
            0.0,
        ));
        world.random = Random(seed);
        world.bias_rad_s = random.vector(radians(3.0));
        world.force_bias_m_s2 = random.vector(0.05);
        let mut estimator = estimator();
        let mut hand = Hand::default();
        for index in 0..40_000_u32 {
            hand.moves(&mut world, &mut random);
            let estimate = world.run(&mut estimator, 1);
            if index > 1_000 && index % 20 == 0 {
                let error = world.tilt_error_degrees(estimate.attitude);
                // Without the factor for an unknown bias: this is about the covariance.
                let scale = if estimate.is_bias_known {
                    1.0
                } else {
                    UNKNOWN_BIAS_SIGMA_SCALE
                };
                let sigma = filter(&estimator).tilt_sigma_rad() / scale;
                let ratio = error / degrees(sigma);
                total += 1;
                within += u32::from(ratio < 3.0);
                ratios.push(ratio);
            }
        }
        let left = filter(&estimator).bias_rad_s() - world.bias_rad_s;
        let sigma = filter(&estimator).bias_sigma_rad_s();
        assert!(
            left.x.abs() < 4.0 * sigma.x
                && left.y.abs() < 4.0 * sigma.y
                && left.z.abs() < 4.0 * sigma.z
        );
    }
    ratios.sort_by(f32::total_cmp);
    let median = ratios[ratios.len() / 2];
    let share = within as f32 / total as f32;
    assert!(share >= 0.99, "{share} within 3 σ, median {median}");
    assert!((0.3..1.2).contains(&median), "{median}");
}

#[test]
fn linear_acceleration_excludes_gravity() {
    let mut world = World::at_rest(from_degrees(0.0, 30.0, 0.0));
    world.force_noise = 0.0;
    let mut estimator = estimator();
    world.run(&mut estimator, 3000);
    assert!(filter(&estimator).linear_acceleration_m_s2().norm() < 0.1);
    world.acceleration_m_s2 = Vector3::new(2.0, 0.0, 0.0);
    world.run(&mut estimator, 10);
    let expected = world.attitude.conjugate().rotate(world.acceleration_m_s2);
    let found = filter(&estimator).linear_acceleration_m_s2();
    assert!((found - expected).norm() < 0.1, "{found:?}");
}

/// A body whose axis goes round on a cone reads a steady rate about it, although it does not turn
/// about it. For a rotation by φ about u it is sin φ·du − (1 − cos φ)·u × du.
#[test]
fn rotation_and_velocity_of_a_cone_are_integrated_between_earth_steps() {
    const STEP_S: f32 = 1.0e-3;
    const ROUND_RAD_S: f32 = core::f32::consts::TAU * 50.0;
    let cone = radians(1.5);
    let attitude = |seconds: f32| {
        let (sine, cosine) = (ROUND_RAD_S * seconds).sin_cos();
        Quaternion::from_rotation_vector(Vector3::new(cosine, sine, 0.0).scale(cone))
    };
    let force_earth = Vector3::new(3.0, -2.0, -STANDARD_GRAVITY_M_S2);
    let mut nominal = NominalState::new();
    nominal.attitude = attitude(0.0);
    let mut transition = Transition::IDENTITY;
    let mut gained = Vector3::ZERO;
    for index in 0..=1_000 {
        let seconds = index as f32 * STEP_S;
        let (sine, cosine) = (ROUND_RAD_S * seconds).sin_cos();
        let across = ROUND_RAD_S * cone.sin();
        let along = -ROUND_RAD_S * (1.0 - cone.cos());
        let rate = Vector3::new(-sine * across, cosine * across, along);
        let force = attitude(seconds).conjugate().rotate(force_earth);
        if index == 0 {
            nominal.start(rate, force);
        } else if nominal.integrate(rate, force, STEP_S) > 0.0199 {
            gained = gained
                + nominal
                    .step_in_earth_axes(&mut transition)
                    .force_integral_ned_m_s;
        }
    }
    let turned = attitude(1.0).conjugate().multiply(nominal.attitude);
    let error = 2.0 * turned.x.hypot(turned.y).hypot(turned.z);
    assert!(error.to_degrees() < 0.25, "{}", error.to_degrees());
    assert!((gained - force_earth).norm() < 0.02, "{gained:?}");
}
