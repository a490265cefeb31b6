//! Parameters of the sensor: what motion shows of them, and their priors.

use super::covariance_step::{dense, is_positive};
use super::*;

/// Motion shows the accelerometer's offset, and rest does not. The next run continues with it.
#[test]
fn motion_makes_the_accelerometer_s_offset_certain() {
    let offset = Vector3::new(0.3, -0.2, 0.0);
    for seed in 0..4 {
        let mut random = Random(8000 + seed);
        let mut world = World::at_rest(from_degrees(5.0, 0.0, 0.0));
        world.force_bias_m_s2 = offset;
        let mut estimator = estimator();
        let knowledge = AccelerometerKnowledge::Factory;
        estimator
            .filter_mut()
            .set_accelerometer_knowledge(knowledge);
        world.run(&mut estimator, 60_000);
        let certain = |estimator: &Estimator| filter(estimator).certain_accelerometer_bias_m_s2();
        assert_eq!(certain(&estimator), None, "{seed}");
        let mut hand = Hand::default();
        for _ in 0..60_000 {
            hand.moves(&mut world, &mut random);
            world.run(&mut estimator, 1);
        }
        let found = certain(&estimator).expect("certain");
        assert!(
            (found - offset).norm() < 0.5 * offset.norm(),
            "{seed}: {found:?}"
        );
        let kept = [found.x, found.y];
        let mut next = Estimator::new();
        let start = WarmStart {
            accelerometer_bias_m_s2: kept,
            ..warm_start(&world)
        };
        next.resume(&start, world.t_us);
        let resumed = filter(&next).accelerometer_bias_m_s2();
        assert_eq!(resumed, Vector3::new(found.x, found.y, 0.0));
    }
}

/// Scale and accelerometer bias return to their priors while no motion shows them, and so does
/// their σ.
#[test]
fn parameters_return_to_their_priors() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    world.run(&mut estimator, 1000);
    let filter = estimator.filter_mut();
    let priors = filter.parameter_priors;
    for parameter in 3..PARAMETERS {
        let variance = 0.01 * priors.variance(parameter);
        filter
            .step
            .covariance
            .scale_parameter(parameter, 0.0, variance);
    }
    filter.nominal.scale_parameter(3, 0.0);
    let mut nominal = filter.nominal;
    for _ in 0..2 * 4545 {
        filter.interval.duration_s = 0.22;
        filter.relax_parameter(0.22);
    }
    // Two time constants: exp(−4) of the difference of the variances is left.
    for parameter in 3..PARAMETERS {
        let variance = priors.variance(parameter);
        let share = filter.step.covariance.parameter_variance(parameter) / variance;
        let expected = 1.0 - 0.99 * (-4.0_f32).exp();
        assert!((share - expected).abs() < 2.0e-3, "{parameter}: {share}");
    }
    assert!(is_positive(&dense(&filter.step.covariance)));
    nominal.accelerometer_bias_m_s2 = Vector3::new(0.1, -0.2, 0.3);
    for parameter in 12..PARAMETERS {
        nominal.scale_parameter(parameter, 0.5);
    }
    let halved = Vector3::new(0.05, -0.1, 0.15);
    assert_eq!(nominal.accelerometer_bias_m_s2, halved);
}

#[test]
fn an_unknown_accelerometer_has_a_larger_sigma_at_rest() {
    let sigma = |knowledge| {
        let mut world = World::at_rest(from_degrees(10.0, 5.0, 0.0));
        let mut estimator = estimator();
        estimator
            .filter_mut()
            .set_accelerometer_knowledge(knowledge);
        world.run(&mut estimator, 20_000).tilt_sigma_rad()
    };
    let knowledge = [
        AccelerometerKnowledge::Factory,
        AccelerometerKnowledge::SixPoses,
        AccelerometerKnowledge::Calibrated,
    ];
    for knowledge in knowledge {
        // Two axes of tilt, and the reported share.
        let expected =
            1.414 * REPORTED_SIGMA_SCALE * knowledge.sigma_m_s2() / STANDARD_GRAVITY_M_S2;
        let found = sigma(knowledge);
        assert!(
            (found / expected - 1.0).abs() < 0.15,
            "{knowledge:?}: {found}"
        );
    }
    // New knowledge counts at once, and keeps the attitude.
    let mut world = World::at_rest(from_degrees(10.0, 5.0, 0.0));
    let mut estimator = estimator();
    let before = world.run(&mut estimator, 5_000);
    estimator
        .filter_mut()
        .set_accelerometer_knowledge(AccelerometerKnowledge::Factory);
    let sigmas = filter(&estimator).accelerometer_bias_sigma_m_s2();
    assert!((sigmas.x - AccelerometerKnowledge::Factory.sigma_m_s2()).abs() < 1.0e-4);
    let after = world.run(&mut estimator, 1);
    assert!(angle_between(before.attitude, after.attitude) < radians(0.1));
}

/// In a turn by 90° the scale counts: a calibrated gyroscope has less of an error than a factory
/// one.
#[test]
fn a_calibrated_gyroscope_has_a_smaller_sigma_in_a_turn() {
    let sigma_after_turns = |knowledge| {
        let mut world = World::at_rest(from_degrees(0.0, 60.0, 0.0));
        let mut estimator = estimator();
        estimator.filter_mut().set_gyroscope_knowledge(knowledge);
        world.run(&mut estimator, 3_000);
        world.rate_rad_s = Vector3::new(radians(90.0), 0.0, 0.0);
        world.run(&mut estimator, 1_000).tilt_sigma_rad()
    };
    let factory = sigma_after_turns(GyroscopeKnowledge::Factory);
    let calibrated = sigma_after_turns(GyroscopeKnowledge::Calibrated);
    assert!(calibrated < 0.8 * factory, "{calibrated} of {factory}");
}
