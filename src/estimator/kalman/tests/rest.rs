//! Rests, and steady motions that read like rests.

use super::covariance_step::{dense, is_positive};
use super::*;

#[test]
fn a_large_offset_at_rest_is_removed_within_three_seconds() {
    for axis in [
        Vector3::new(1.0, 0.0, 0.0),
        Vector3::new(0.0, -1.0, 0.0),
        Vector3::new(0.0, 0.0, 1.0),
        Vector3::new(0.577, 0.577, -0.577),
    ] {
        let mut world = World::at_rest(from_degrees(20.0, 10.0, 0.0));
        world.bias_rad_s = axis.scale(radians(20.0));
        let mut estimator = estimator();
        assert!(!world.run(&mut estimator, 500).is_bias_known);
        let estimate = world.run(&mut estimator, 2500);
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(error < 0.5, "{axis:?}: {error}");
        assert!(estimate.is_bias_known);
        let left = filter(&estimator).bias_rad_s() - world.bias_rad_s;
        assert!(degrees(left.norm()) < 0.3, "{left:?}");
    }
}

/// An axis of the accelerometer is stuck at the start, and comes back: the same readings as those
/// of a steady acceleration.
#[test]
fn a_rest_that_contradicts_the_tilt_for_long_corrects_it() {
    for offset_m_s2 in [-12.0, -3.4, 1.7, 3.4, 4.5, 12.0] {
        for stuck_ms in [900, 3_000, 6_000] {
            for axis in [Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0)] {
                let mut world = World::at_rest(from_degrees(-20.0, 15.0, 0.0));
                let mut estimator = estimator();
                world.force_bias_m_s2 = axis.scale(offset_m_s2);
                world.run(&mut estimator, stuck_ms);
                world.force_bias_m_s2 = Vector3::ZERO;
                let (mut wrong_ms, mut error) = (0, 0.0);
                for _ in 0..1_200 {
                    let estimate = world.run(&mut estimator, 10);
                    error = world.tilt_error_degrees(estimate.attitude);
                    let allowed = degrees(6.0 * estimate.tilt_sigma_rad()).max(5.0);
                    wrong_ms += 10 * u32::from(estimate.is_bias_known && error > allowed);
                }
                let text = format!("{offset_m_s2} for {stuck_ms} ms");
                assert!(
                    error < 4.0 && filter(&estimator).is_bias_known(),
                    "{text}: {error}"
                );
                // No vehicle that keeps its height reads a tilt that is so wrong.
                let is_steep = offset_m_s2.abs() > 10.0 && stuck_ms > 1_000;
                let longest_ms = if is_steep { 0 } else { 7_500 };
                assert!(wrong_ms <= longest_ms, "{text}: wrong for {wrong_ms} ms");
            }
        }
    }
}

/// After a jerk at the start the first rest corrects the tilt by much. A motion that begins right
/// then must not take the correction for a changed bias, as in campaign flight 352000409.
#[test]
fn motion_right_after_the_first_rest_keeps_the_bias_known() {
    for acceleration_m_s2 in [4.0, 6.0, 7.0, 8.0, 9.0] {
        for milliseconds in [150, 200, 250, 300, 350, 400] {
            let mut world = World::at_rest(Quaternion::IDENTITY);
            let mut estimator = estimator();
            world.acceleration_m_s2.x = acceleration_m_s2;
            world.run(&mut estimator, milliseconds);
            world.acceleration_m_s2 = Vector3::ZERO;
            while !world.run(&mut estimator, 1).is_bias_known {
                assert!(world.t_us < 5_000_000, "{acceleration_m_s2}");
            }
            for step in 0..400 {
                let share = libm::sinf(0.015 * step as f32);
                world.rate_rad_s = Vector3::new(-1.0, 0.5, -1.6).scale(share);
                let estimate = world.run(&mut estimator, 5);
                let text = format!("{acceleration_m_s2} for {milliseconds} ms: {step}");
                assert!(estimate.is_bias_known, "{text}");
            }
        }
    }
}

#[test]
fn the_first_rest_replaces_a_wrong_stored_offset() {
    for off in [0.3, 1.0, 5.0] {
        let mut world = World::at_rest(from_degrees(10.0, -20.0, 0.0));
        world.bias_rad_s = Vector3::new(radians(off), 0.0, radians(-off));
        let mut estimator = estimator();
        estimator.filter_mut().set_bias(Vector3::ZERO, radians(0.1));
        let estimate = world.run(&mut estimator, 1500);
        let left = filter(&estimator).bias_rad_s() - world.bias_rad_s;
        assert!(degrees(left.norm()) < 0.1, "{off}: {left:?}");
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(error < 0.5, "{off}: {error}");
    }
}

/// At some rates, such as 10, 20, 50 and 100 Hz, the first check of a rest's drift is late.
#[test]
fn a_start_at_rest_makes_the_bias_known_at_every_rate() {
    const RATES_HZ: [u64; 18] = [
        10, 20, 25, 40, 45, 50, 55, 62, 75, 83, 91, 100, 111, 125, 143, 167, 200, 500,
    ];
    // A drift from zero reads like a swing with the large bias, like a turn with the small one.
    let biases_rad_s = [
        Vector3::new(0.03, -0.02, 0.05),
        Vector3::new(0.003, -0.002, 0.001),
    ];
    let cases = biases_rad_s
        .into_iter()
        .flat_map(|bias_rad_s| RATES_HZ.map(|rate_hz| (bias_rad_s, rate_hz)));
    for (bias_rad_s, rate_hz) in cases {
        let period_us = 1_000_000 / rate_hz;
        let mut world = World::at_rest(from_degrees(10.0, -20.0, 0.0));
        world.bias_rad_s = bias_rad_s;
        let mut estimator = estimator();
        estimator
            .filter_mut()
            .set_sample_period(period_us as f32 * 1.0e-6);
        let run = |world: &mut World, estimator: &mut Estimator, milliseconds: u64| {
            let mut estimate = Estimate::default();
            for _ in 0..milliseconds * 1000 / period_us {
                estimate = estimator.update(&world.sample(period_us));
            }
            estimate
        };
        // 0.8 s at rest, a covariance step, and the samples in which it is computed.
        let known_after_ms = if rate_hz < 40 { 1_800 } else { 1_400 };
        let estimate = run(&mut world, &mut estimator, known_after_ms);
        assert!(estimate.is_bias_known, "{rate_hz} Hz");
        run(&mut world, &mut estimator, 8_000);
        world.rate_rad_s = Vector3::new(0.3, 0.0, 0.2);
        run(&mut world, &mut estimator, 3_000);
        world.rate_rad_s = Vector3::ZERO;
        world.t_us += 700_000;
        for _ in 0..30 {
            let estimate = run(&mut world, &mut estimator, 100);
            assert!(estimate.is_bias_known, "{rate_hz} Hz, after a gap");
        }
    }
}

/// The sample after a pause is one sample, with its noise. The drift of a rest must not be measured
/// from it.
#[test]
fn a_pause_at_rest_leaves_the_bias_known() {
    for seed in 0..60 {
        for pause_us in [110_000, 200_000, 390_000, 480_000] {
            let mut world = World::at_rest(from_degrees(15.0, 35.0, 0.0));
            world.random = Random(4000 + seed);
            world.force_noise = 0.08;
            let mut estimator = estimator();
            estimator.filter_mut().set_sample_period(1.0e-3);
            let estimate = world.run(&mut estimator, 2_300);
            assert!(estimate.is_bias_known, "seed {seed}");
            world.t_us += pause_us;
            for _ in 0..25 {
                let is_known = world.run(&mut estimator, 100).is_bias_known;
                assert!(is_known, "seed {seed}, pause of {pause_us} us");
            }
        }
    }
}

/// With an offset of 20 °/s about the vertical, motion in a hand misleads the filter. The bias
/// must not become known.
#[test]
fn only_rest_makes_the_bias_known() {
    for seed in 0..8 {
        let mut random = Random(2000 + seed);
        let mut world = World::at_rest(from_degrees(20.0 * random.next(), 0.0, 0.0));
        world.bias_rad_s = random.vector(radians(2.0));
        world.bias_rad_s.z += radians(if seed % 2 == 0 { 20.0 } else { -20.0 });
        let mut estimator = estimator();
        let mut hand = Hand::default();
        for _ in 0..60_000 {
            hand.moves(&mut world, &mut random);
            assert!(!world.run(&mut estimator, 1).is_bias_known, "seed {seed}");
        }
        world.rate_rad_s = Vector3::ZERO;
        world.acceleration_m_s2 = Vector3::ZERO;
        // 1.6 s until the average has forgotten 46 °/s, 0.8 s of quiet, and a step of the
        // covariance is due every 0.22 s.
        let estimate = world.run(&mut estimator, 3_000);
        assert!(estimate.is_bias_known, "seed {seed}");
        let error = world.tilt_error_degrees(estimate.attitude);
        assert!(error < 2.0, "seed {seed}: {error}");
        let left = filter(&estimator).bias_rad_s() - world.bias_rad_s;
        // The estimate still contains part of the earlier average.
        assert!(degrees(left.norm()) < 0.4, "seed {seed}: {left:?}");
    }
}

#[test]
fn an_armed_filter_does_not_treat_a_steady_turn_as_rest() {
    let left = |armed: bool| {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        let mut estimator = estimator();
        estimator.filter_mut().set_armed(armed);
        // 3 °/s about the vertical reads like rest on all six axes.
        world.rate_rad_s = Vector3::new(0.0, 0.0, radians(3.0));
        world.run(&mut estimator, 5_000);
        degrees(filter(&estimator).bias_rad_s().z)
    };
    assert!((left(false) - 3.0).abs() < 0.2);
    assert!(left(true).abs() < 0.2);
}

/// Neither gyroscope nor accelerometer changes in such a turn, as at rest. But no offset is so
/// large.
#[test]
fn a_steady_turn_faster_than_any_offset_is_motion() {
    let mut estimator = Estimator::new();
    let rate = Vector3::new(0.0, 0.0, radians(100.0));
    let mut estimate = Estimate::default();
    for millisecond in 0..5_000 {
        estimate = estimator.update(&sample(millisecond * 1_000, Quaternion::IDENTITY, rate));
    }
    assert!((estimate.body_rates_rad_s.z - radians(100.0)).abs() < radians(1.0));
}

/// The first rest contradicts the stored offset. Then samples are missing, and the body turns.
#[test]
fn a_rest_before_a_pause_does_not_show_the_tilt_after_it() {
    for pause_us in [100_000, 400_000, 2_000_000] {
        let mut world = World::at_rest(from_degrees(10.0, -20.0, 0.0));
        world.bias_rad_s = Vector3::new(radians(5.0), 0.0, radians(-5.0));
        let mut estimator = estimator();
        estimator.filter_mut().set_sample_period(1.0e-3);
        estimator.filter_mut().set_bias(Vector3::ZERO, radians(0.1));
        let contradicts = (0..2_000).any(|_| {
            world.run(&mut estimator, 1);
            filter(&estimator).tilt == Tilt::Restarting
        });
        assert!(contradicts);
        world.rate_rad_s = Vector3::new(0.0, radians(45.0) * 1.0e6 / pause_us as f32, 0.0);
        world.sample(pause_us);
        world.rate_rad_s = Vector3::ZERO;
        for _ in 0..1_000 {
            let estimate = world.run(&mut estimator, 1);
            let error = world.tilt_error_degrees(estimate.attitude);
            let allowed = larger(5.0, 6.0 * estimate.tilt_sigma_rad().to_degrees());
            assert!(error < allowed, "{pause_us}: {error} of {allowed}");
        }
    }
}

/// Returns a world with an offset, and an estimator in the covariance step of its first rest.
fn in_first_rest() -> (World, Estimator) {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    world.bias_rad_s = Vector3::new(radians(4.0), radians(-4.0), radians(4.0));
    let mut estimator = estimator();
    while !filter(&estimator).is_first_rest {
        world.run(&mut estimator, 1);
    }
    (world, estimator)
}

/// The step of the first rest reduces the bias's variance first, and corrects the bias last. A
/// wrong sample between both abandons it.
#[test]
fn a_first_rest_that_is_cut_short_measures_no_bias() {
    let mut cut_short = 0;
    for slices in 1..60 {
        let (mut world, mut estimator) = in_first_rest();
        world.run(&mut estimator, slices);
        let filter = estimator.filter_mut();
        cut_short += u32::from(filter.step.is_under_way());
        filter.inflate_motion(0.01);
        assert!(is_positive(&dense(&filter.step.covariance)), "{slices}");
        let error = filter.bias_rad_s() - world.bias_rad_s;
        let largest = error.x.abs().max(error.y.abs()).max(error.z.abs());
        let sigma = libm::sqrtf(filter.largest_bias_variance());
        assert!(largest < 6.0 * sigma, "{slices}: {largest} of {sigma}");
        let estimate = world.run(&mut estimator, 3_000);
        assert!(estimate.is_bias_known, "{slices}");
    }
    assert!(cut_short > 20, "{cut_short}");
}

/// Then the bias must not run away from what the rest has shown, while no other rest is taken.
#[test]
fn a_first_rest_that_is_cut_short_leads_no_bias_astray() {
    for slices in 1..30 {
        let (mut world, mut estimator) = in_first_rest();
        world.run(&mut estimator, slices);
        let filter = estimator.filter_mut();
        filter.inflate_motion(0.01);
        filter.set_armed(true);
        world.run(&mut estimator, 5_000);
        let error = estimator.filter().bias_rad_s() - world.bias_rad_s;
        assert!(error.is_within(radians(4.5)), "{slices}: {error:?}");
    }
}

/// The step after a first rest is abandoned: the rest has measured the bias all the same.
#[test]
fn a_first_rest_counts_once_its_step_is_complete() {
    let (mut world, mut estimator) = in_first_rest();
    // To the end of this step, and to the beginning of the next one.
    for is_under_way in [false, true] {
        while filter(&estimator).step.is_under_way() != is_under_way {
            world.run(&mut estimator, 1);
        }
    }
    let filter = estimator.filter_mut();
    let before = filter.largest_bias_variance();
    filter.inflate_motion(0.01);
    assert!(filter.has_rested);
    assert_eq!(filter.largest_bias_variance(), before);
}

/// At rest an offset that changes is found within 5 s, whichever its axis. Until then the attitude
/// is not valid, or as wrong as σ allows.
#[test]
fn a_changed_offset_is_found_at_rest_and_sigma_covers_the_error() {
    let axes = [
        Vector3::new(1.0, 0.0, 0.0),
        Vector3::new(0.0, -1.0, 0.0),
        Vector3::new(0.0, 0.0, 1.0),
        Vector3::new(-0.6, 0.6, -0.5),
    ];
    for (seed, axis) in (40..).zip(axes) {
        for size in [1.0, 2.0, 4.0, 8.0, 20.0] {
            let mut random = Random(seed);
            let pose = from_degrees(40.0 * random.next(), 40.0 * random.next(), 0.0);
            let mut world = World::at_rest(pose);
            world.bias_rad_s = random.vector(radians(3.0));
            let mut estimator = estimator();
            world.run(&mut estimator, 5_000);
            world.bias_rad_s = world.bias_rad_s + axis.scale(radians(size));
            for millisecond in 0..5_000 {
                let estimate = world.run(&mut estimator, 1);
                let error = world.tilt_error_degrees(estimate.attitude);
                let allowed = degrees(6.0 * estimate.tilt_sigma_rad()).max(5.0);
                let is_right = !estimate.is_bias_known || error < allowed;
                assert!(is_right, "{axis:?} {size}: {error} at {millisecond} ms");
            }
            assert!(world.run(&mut estimator, 1).is_bias_known);
            let left = filter(&estimator).bias_rad_s() - world.bias_rad_s;
            assert!(degrees(left.norm()) < 0.3, "{axis:?} {size}: {left:?}");
        }
    }
}

/// A person turns a level body by hand, about the vertical, for two seconds. The offset must not
/// change.
#[test]
fn a_turn_about_the_vertical_is_no_offset() {
    let mut random = Random(7);
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    world.run(&mut estimator, 4_000);
    for _ in 0..60 {
        // A hand trembles by a few degrees per second.
        world.rate_rad_s = Vector3::new(0.0, 0.0, radians(8.0 + 1.2 * random.normal()));
        world.run(&mut estimator, 100);
        let bias = filter(&estimator).bias_rad_s();
        assert!(degrees(bias.norm()) < 0.3, "{bias:?}");
    }
}

/// The check of the rest may be a sample older than its measurement.
#[test]
fn the_first_rest_counts_in_time_at_any_rate() {
    const LONGEST_MS: [(u64, u64); 5] = [
        (1_000, 900),
        (1_350, 950),
        (2_000, 950),
        (5_000, 1_200),
        (10_000, 1_700),
    ];
    for (period_us, longest_ms) in LONGEST_MS {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        let mut estimator = estimator();
        let mut t_us = 0;
        while !estimator.estimate().is_bias_known {
            estimator.update(&world.sample(period_us));
            t_us += period_us;
            assert!(t_us < 1_000 * longest_ms, "a sample each {period_us} us");
        }
    }
}

/// A turn while armed says nothing about the offset when it ends.
#[test]
fn a_turn_that_goes_on_after_disarming_is_no_offset_at_once() {
    let mut world = World::at_rest(Quaternion::IDENTITY);
    let mut estimator = estimator();
    world.run(&mut estimator, 3_000);
    estimator.filter_mut().set_armed(true);
    world.rate_rad_s = Vector3::new(0.0, 0.0, radians(5.0));
    world.run(&mut estimator, 8_000);
    estimator.filter_mut().set_armed(false);
    world.run(&mut estimator, 2_000);
    let bias_deg_s = degrees(filter(&estimator).bias_rad_s().z);
    assert!(bias_deg_s.abs() < 0.3, "{bias_deg_s}");
}

/// A rover that vibrates a little turns smoothly. The same vibration at rest does not hide a
/// changed offset.
#[test]
fn a_steady_rate_that_vibrates_more_than_at_rest_is_a_turn() {
    for (seed, rate_deg_s) in (50..).zip([3.0, 8.0, 20.0]) {
        for vibrates_at_rest in [false, true] {
            let mut world = World::at_rest(Quaternion::IDENTITY);
            world.random = Random(seed);
            let (sensor_noise, vibration) = (world.rate_noise, radians(0.25));
            world.rate_noise = if vibrates_at_rest {
                vibration
            } else {
                sensor_noise
            };
            let mut estimator = estimator();
            world.run(&mut estimator, 6_000);
            world.rate_noise = vibration;
            world.rate_rad_s = Vector3::new(0.0, 0.0, radians(rate_deg_s));
            world.run(
                &mut estimator,
                if vibrates_at_rest { 5_000 } else { 30_000 },
            );
            let bias_deg_s = degrees(filter(&estimator).bias_rad_s().z);
            let expected_deg_s = if vibrates_at_rest { rate_deg_s } else { 0.0 };
            let error_deg_s = bias_deg_s - expected_deg_s;
            assert!(
                error_deg_s.abs() < 0.4,
                "{rate_deg_s}, {vibrates_at_rest}: {bias_deg_s}"
            );
        }
    }
}

/// A turn about a slanted axis that neither sensor shows as motion. Without a rest before it, it
/// must not be measured as the bias; after a rest it must not change the bias.
#[test]
fn a_slow_turn_is_no_rest() {
    let axis = Vector3::new(0.5, -0.33, 0.8);
    for rate_deg_s in [1.5, 3.0, 8.0, 25.0] {
        for has_rested in [false, true] {
            let mut world = World::at_rest(from_degrees(10.0, -20.0, 0.0));
            world.bias_rad_s = Vector3::new(radians(1.0), radians(-2.0), radians(0.5));
            let mut estimator = estimator();
            if has_rested {
                world.run(&mut estimator, 3_000);
            }
            for step in 0..2_000_u16 {
                // After a rest the turn begins within 3 s, without a jerk.
                let share = if has_rested {
                    (f32::from(step) / 600.0).min(1.0)
                } else {
                    1.0
                };
                world.rate_rad_s = axis.scale(radians(share * rate_deg_s));
                let estimate = world.run(&mut estimator, 5);
                let error = world.tilt_error_degrees(estimate.attitude);
                let allowed = degrees(6.0 * estimate.tilt_sigma_rad()).max(5.0);
                let is_right = !estimate.is_bias_known || error < allowed;
                assert!(is_right, "{rate_deg_s}, {has_rested}: {error}");
                // The slowest turn is taken for a rest until gravity has turned by 0.6°.
                let is_known_rightly = estimate.is_bias_known == has_rested || rate_deg_s < 2.0;
                assert!(is_known_rightly, "{rate_deg_s}, {has_rested}");
            }
            world.rate_rad_s = Vector3::ZERO;
            assert!(world.run(&mut estimator, 4_000).is_bias_known);
            let left = filter(&estimator).bias_rad_s() - world.bias_rad_s;
            assert!(degrees(left.norm()) < 0.3, "{rate_deg_s}: {left:?}");
        }
    }
}

/// σ of the bias may be large after contradictions, or in a changing temperature. A slow turn is
/// then within the gate, and must not be measured as the bias at once.
#[test]
fn a_rest_measures_no_bias_far_from_that_of_the_last_rest_at_once() {
    // Degrees a second, and whether the next rest may measure it at once.
    for (rate_deg_s, is_near) in [(0.3, true), (2.0, false)] {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        let mut estimator = estimator();
        world.run(&mut estimator, 3_000);
        assert!(estimator.filter().is_bias_known());
        estimator
            .filter_mut()
            .set_added_bias_walk(square(radians(5.0)));
        world.rate_rad_s = Vector3::new(0.0, 0.0, radians(rate_deg_s));
        for step in 0..250 {
            world.run(&mut estimator, 10);
            let bias_deg_s = degrees(filter(&estimator).bias_rad_s().z);
            assert!(is_near || bias_deg_s.abs() < 0.5, "{step}: {bias_deg_s}");
        }
        let sigma_deg_s = degrees(filter(&estimator).largest_bias_sigma_rad_s());
        assert!(
            is_near || sigma_deg_s > 1.0,
            "the gate is wide: {sigma_deg_s}"
        );
        let bias_deg_s = degrees(filter(&estimator).bias_rad_s().z);
        assert!(!is_near || bias_deg_s > 0.1, "{bias_deg_s}");
    }
}
