//! Tests of the heading filter on simulated motion, with a truth that shares no code with it.

use super::*;
use crate::attitude::{BodyVector, EulerAngles, Quaternion};
use crate::estimator::kalman::{AccelerometerKnowledge, PAUSE_RATE_RAD_S, WarmStart};
use crate::estimator::{Estimator, Sample};
use crate::serialize::{StateReader, StateWriter};
use crate::units::{STANDARD_GRAVITY_M_S2, degrees, radians};

/// Earth's field in north, east, down, µT: that of central Europe.
const EARTH_UT: Vector3 = Vector3::new(20.0, 0.0, 44.0);

/// Body with an IMU and a compass, and the filters that follow it.
struct Flight {
    truth: Quaternion,
    estimator: Estimator,
    heading: Heading,
    /// Field beside that of the earth: in body axes, and in earth axes, µT.
    iron_ut: Vector3,
    disturbance_ut: Vector3,
    /// Offset of the gyroscope, rad/s.
    offset_rad_s: Vector3,
    step_us: u64,
    t_us: u64,
    reading_us: u64,
    reading_period_us: u64,
    noise: u32,
}

impl Flight {
    fn new(heading_deg: f32, knowledge: CompassKnowledge) -> Self {
        Self {
            truth: Quaternion::from_euler(EulerAngles {
                yaw_rad: radians(heading_deg),
                ..EulerAngles::default()
            }),
            estimator: Estimator::new(),
            heading: Heading::new(knowledge),
            iron_ut: Vector3::ZERO,
            disturbance_ut: Vector3::ZERO,
            offset_rad_s: Vector3::ZERO,
            step_us: 2_000,
            t_us: 0,
            reading_us: 0,
            reading_period_us: 10_000,
            noise: 1,
        }
    }

    fn noise(&mut self, amplitude: f32) -> Vector3 {
        let mut next = || {
            // Numerical Recipes' linear congruential generator.
            self.noise = self.noise.wrapping_mul(1_664_525);
            self.noise = self.noise.wrapping_add(1_013_904_223);
            amplitude * (self.noise >> 8) as f32 / (1 << 23) as f32 - amplitude
        };
        Vector3::new(next(), next(), next())
    }

    /// Takes one sample, after a step at these rates.
    fn step(&mut self, rate_rad_s: Vector3) {
        let dt_s = self.step_us as f32 * SECONDS_PER_MICROSECOND;
        let turn = Quaternion::from_rotation_vector(rate_rad_s.scale(dt_s));
        self.truth = self.truth.multiply(turn).normalize();
        self.t_us += self.step_us;
        let to_body = self.truth.conjugate();
        let up = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
        let force = to_body.rotate(up) + self.noise(0.05);
        let rate = rate_rad_s + self.offset_rad_s + self.noise(0.002);
        self.estimator
            .update(&Sample::new(self.t_us, BodyVector(force), BodyVector(rate)));
        self.heading.update(self.estimator.filter(), dt_s);
        if self.t_us >= self.reading_us {
            self.reading_us += self.reading_period_us;
            let field = to_body.rotate(EARTH_UT + self.disturbance_ut) + self.iron_ut;
            let Vector3 { x, y, z } = field + self.noise(0.5);
            self.heading.add_field(MagneticField { ut: [x, y, z] }, 0);
        }
    }

    fn rest(&mut self, seconds: f32) {
        self.run(seconds, |_| Vector3::ZERO);
    }

    /// Turns about all axes.
    fn tumble(&mut self, seconds: f32) {
        self.run(seconds, |t_s| {
            let swing = |amplitude, rad_s: f32| amplitude * libm::sinf(rad_s * t_s);
            Vector3::new(swing(1.5, 1.1), swing(1.2, 1.7), swing(1.3, 0.6))
        });
    }

    fn run(&mut self, seconds: f32, rate_rad_s: impl Fn(f32) -> Vector3) {
        let steps = (seconds * 1.0e6 / self.step_us as f32) as u64;
        for _ in 0..steps {
            let t_s = self.t_us as f32 * SECONDS_PER_MICROSECOND;
            self.step(rate_rad_s(t_s));
            self.check_promise();
        }
    }

    /// Checks the promise of a valid heading.
    fn check_promise(&self) {
        if let Some(estimate) = self.heading.estimate().filter(|it| it.is_valid) {
            let error = self.error_deg().unwrap_or(f32::NAN).abs();
            let promised = (6.0 * degrees(estimate.sigma_rad)).max(15.0);
            assert!(error <= promised, "{} s: {error}", self.t_us / 1_000_000);
        }
    }

    /// Returns the error of the heading, degrees: the twist about down.
    fn error_deg(&self) -> Option<f32> {
        let estimate = self.heading.estimate()?;
        let turn = Vector3::new(0.0, 0.0, estimate.yaw_offset_rad);
        let absolute =
            Quaternion::from_rotation_vector(turn).multiply(self.estimator.estimate().attitude);
        let error = absolute.multiply(self.truth.conjugate());
        Some(degrees(wrap_pi(2.0 * libm::atan2f(error.z, error.w))))
    }

    fn assert_error_below(&self, limit_deg: f32) {
        let error = self.error_deg().expect("a heading");
        assert!(error.abs() < limit_deg, "{error}");
    }
}

#[test]
fn heading_is_clockwise_from_north_at_rest() {
    for heading_deg in [0.0, 90.0, 179.0, -90.0, -37.0] {
        let mut flight = Flight::new(heading_deg, CompassKnowledge::Calibrated);
        flight.rest(3.0);
        let estimate = flight.heading.estimate().expect("a heading");
        let yaw_rad = flight.estimator.estimate().euler().yaw_rad;
        let error = degrees(estimate.heading_rad(yaw_rad)) - heading_deg;
        assert!(error.abs() < 1.5, "{heading_deg}: {error}");
        // At rest nothing tells the earth's field from that of a magnet.
        assert!(!estimate.is_valid, "{heading_deg}: {estimate:?}");
        flight.tumble(6.0);
        let estimate = flight.heading.estimate().expect("a heading");
        assert!(estimate.is_valid, "{heading_deg}: {estimate:?}");
        flight.rest(60.0);
        let estimate = flight.heading.estimate().expect("a heading");
        assert!(estimate.is_valid, "{heading_deg}: {estimate:?}");
    }
}

#[test]
fn without_a_reading_there_is_no_heading() {
    let mut estimator = Estimator::new();
    let mut heading = Heading::new(CompassKnowledge::Calibrated);
    let force = BodyVector::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
    for index in 0..5_000_u64 {
        estimator.update(&Sample::new(1_000 * index, force, BodyVector::ZERO));
        heading.update(estimator.filter(), 0.001);
        assert_eq!(heading.estimate(), None, "{index}");
    }
}

#[test]
fn a_magnet_beside_the_body_is_never_north() {
    let mut flight = Flight::new(20.0, CompassKnowledge::Calibrated);
    flight.disturbance_ut = Vector3::new(-35.0, 20.0, 5.0);
    flight.rest(5.0);
    let error = flight.error_deg().expect("a heading");
    assert!(error.abs() > 90.0, "{error}");
    flight.disturbance_ut = Vector3::ZERO;
    flight.tumble(40.0);
    flight.assert_error_below(5.0);
    assert!(flight.heading.estimate().is_some_and(|it| it.is_valid));
}

/// A kept tilt that is 26° wrong is corrected while the body swings about one axis.
#[test]
fn a_correction_of_the_tilt_is_no_turn() {
    let mut flight = Flight::new(0.0, CompassKnowledge::Factory);
    flight.iron_ut = Vector3::new(0.0, 40.0, 0.0);
    let start = WarmStart {
        attitude: Quaternion::from_euler(EulerAngles {
            roll_rad: radians(26.0),
            ..EulerAngles::default()
        }),
        tilt_sigma_rad: radians(21.0),
        bias_rad_s: Vector3::ZERO,
        bias_change_rad_s: Vector3::ZERO,
        bias_sigma_rad_s: radians(0.1),
        accelerometer_bias_m_s2: [0.0; 2],
        squared_velocity_m2_s2: 0.0,
    };
    flight.estimator.resume(&start, flight.t_us);
    for _ in 0..40 {
        flight.run(0.5, |t_s| {
            Vector3::new(0.0, 1.2 * libm::sinf(1.5 * t_s), 0.0)
        });
        assert!(!flight.heading.has_two_axes, "{} us", flight.t_us);
    }
    let is_valid = |flight: &Flight| flight.heading.estimate().is_some_and(|it| it.is_valid);
    assert!(!is_valid(&flight));
    flight.tumble(20.0);
    assert!(flight.heading.has_two_axes && is_valid(&flight));
}

#[test]
fn a_restart_has_no_heading_before_a_reading() {
    let mut flight = Flight::new(20.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    flight.tumble(10.0);
    flight.heading.contradiction = 1.0e6;
    flight.heading.contradicted_s = 1.0e3;
    for _ in 0..1_000 {
        flight.step(Vector3::ZERO);
        let estimate = flight.heading.estimate();
        assert!(estimate.is_none_or(|it| it.sigma_rad > radians(1.0)));
    }
    assert!(flight.heading.contradicted_s < 10.0, "it has restarted");
}

/// A restart opens the hard iron, which turns about one axis do not show.
#[test]
fn after_a_restart_turns_about_one_axis_are_too_few() {
    let is_valid = |flight: &Flight| flight.heading.estimate().is_some_and(|it| it.is_valid);
    for knowledge in [CompassKnowledge::Calibrated, CompassKnowledge::HardIron] {
        let mut flight = Flight::new(20.0, knowledge);
        flight.rest(3.0);
        flight.tumble(10.0);
        assert!(is_valid(&flight));
        flight.heading.contradiction = 1.0e6;
        flight.heading.contradicted_s = 1.0e3;
        for _ in 0..30 {
            flight.run(1.0, |t_s| Vector3::new(0.0, 0.0, libm::sinf(t_s)));
            assert!(!is_valid(&flight), "{} us", flight.t_us);
        }
        // Only the second axis is missing.
        assert!(flight.heading.inconsistency < flight.heading.tuning.valid_inconsistency);
        assert!(!flight.heading.has_two_axes);
        flight.tumble(20.0);
        assert!(is_valid(&flight));
    }
}

/// The axis of a small turn is uncertain: a wobble of a few degrees must not make a turn about the
/// vertical one about two axes. A vehicle on wheels does not show its hard iron.
#[test]
fn turns_about_the_vertical_with_a_wobble_are_too_few() {
    let mut flight = Flight::new(20.0, CompassKnowledge::Factory);
    flight.iron_ut = Vector3::new(12.0, -9.0, 5.0);
    flight.rest(3.0);
    flight.estimator.filter_mut().set_armed(true);
    let mut turned = 0.0_f32;
    for _ in 0..120 {
        // Rolls by 4° and turns by 115° to each side.
        flight.run(1.0, |t_s| {
            let (roll, yaw) = (libm::cosf(2.0 * t_s), libm::cosf(0.3 * t_s));
            Vector3::new(2.0 * radians(4.0) * roll, 0.0, 0.3 * 2.0 * yaw)
        });
        assert!(!flight.heading.has_two_axes, "{} us", flight.t_us);
        turned = turned.max(flight.heading.largest_turn.norm());
    }
    // The turns themselves count.
    assert!(turned > 0.3, "{turned}");
    flight.tumble(20.0);
    assert!(flight.heading.has_two_axes);
}

/// A vehicle that stays level shows the tilt filter nothing about the offset about down.
#[test]
fn an_offset_that_drifts_does_not_leave_the_heading_behind() {
    for drift_deg_s in [0.0, 1.0, -1.0] {
        let mut flight = Flight::new(20.0, CompassKnowledge::Calibrated);
        flight.rest(4.0);
        flight.estimator.filter_mut().set_armed(true);
        // A drift over five minutes, as of a sensor that warms up by 6 °C.
        let mut largest_deg = 0.0_f32;
        for second in 0..360_u16 {
            let share = (f32::from(second) / 300.0).min(1.0);
            flight.offset_rad_s = Vector3::new(0.0, 0.0, share * radians(drift_deg_s));
            flight.run(1.0, |t_s| {
                let wobble = 0.1 * libm::cosf(1.3 * t_s);
                Vector3::new(wobble, 0.0, 0.25 * libm::cosf(0.2 * t_s))
            });
            if second > 20 {
                largest_deg = largest_deg.max(flight.error_deg().expect("a heading").abs());
            }
        }
        assert!(largest_deg < 10.0, "{drift_deg_s}: {largest_deg}");
        assert!(flight.heading.estimate().is_some_and(|it| it.is_valid));
    }
}

/// The rest finds the offset that the heading filter has followed.
#[test]
fn a_rest_after_a_drift_does_not_turn_the_heading() {
    let mut flight = Flight::new(20.0, CompassKnowledge::Calibrated);
    flight.rest(4.0);
    let drive = |flight: &mut Flight| {
        flight.run(1.0, |t_s| {
            let wobble = 0.1 * libm::cosf(1.3 * t_s);
            Vector3::new(wobble, 0.0, 0.25 * libm::cosf(0.2 * t_s))
        });
    };
    flight.estimator.filter_mut().set_armed(true);
    for second in 0..300_u16 {
        let share = f32::from(second) / 300.0;
        flight.offset_rad_s = Vector3::new(0.0, 0.0, share * radians(0.5));
        drive(&mut flight);
    }
    let drift_deg_s = degrees(flight.heading.drift_rad_s);
    assert!(drift_deg_s.abs() > 0.2, "{drift_deg_s}");
    flight.estimator.filter_mut().set_armed(false);
    flight.rest(8.0);
    let drift_deg_s = degrees(flight.heading.drift_rad_s);
    assert!(drift_deg_s.abs() < 0.1, "{drift_deg_s}");
    flight.estimator.filter_mut().set_armed(true);
    for _ in 0..60 {
        drive(&mut flight);
        flight.assert_error_below(3.0);
    }
}

#[test]
fn a_reset_keeps_the_settings_alone() {
    let mut flight = Flight::new(20.0, CompassKnowledge::Factory);
    flight.heading.set_declination(0.1);
    flight.tumble(10.0);
    assert!(flight.heading.estimate().is_some());
    let changes = flight.heading.changes();
    flight.heading.reset();
    assert_ne!(flight.heading.changes(), changes);
    let mut fresh = Heading::new(CompassKnowledge::Factory);
    fresh.set_declination(0.1);
    fresh.changes = flight.heading.changes;
    assert_eq!(flight.heading, fresh);
}

#[test]
fn a_declination_turns_the_heading_to_true_north() {
    let mut flight = Flight::new(20.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    let magnetic = flight.heading.estimate().expect("a heading");
    flight.heading.set_declination(radians(12.0));
    let at_once = flight.heading.estimate().expect("a heading");
    let turned = degrees(at_once.yaw_offset_rad - magnetic.yaw_offset_rad);
    assert!((turned - 12.0).abs() < 1e-4, "{turned}");
    flight.rest(2.0);
    let later = flight.heading.estimate().expect("a heading");
    let turned = degrees(later.yaw_offset_rad - magnetic.yaw_offset_rad);
    assert!((turned - 12.0).abs() < 1.0, "{turned}");
}

#[test]
fn hard_iron_that_nobody_calibrated_is_found_in_motion() {
    let mut flight = Flight::new(70.0, CompassKnowledge::Factory);
    flight.iron_ut = Vector3::new(120.0, -130.0, 95.0);
    flight.rest(2.0);
    // At rest nothing tells hard iron from the earth's field.
    let is_valid = |flight: &Flight| flight.heading.estimate().is_some_and(|it| it.is_valid);
    assert!(!is_valid(&flight));
    flight.tumble(20.0);
    flight.assert_error_below(3.0);
    assert!(is_valid(&flight));
    let found = flight.heading.hard_iron_ut() - flight.iron_ut;
    assert!(found.norm() < 4.0, "{found:?}");
    let sigma = flight.heading.hard_iron_sigma_ut();
    assert!(
        found.is_within(4.0 * sigma.x.max(sigma.y).max(sigma.z)),
        "{sigma:?}"
    );
}

/// A run finds the hard iron, and the next one starts with it: the heading is known without a turn,
/// and valid after turns about one axis.
#[test]
fn the_hard_iron_of_an_earlier_run_serves_the_next() {
    let mut first = Flight::new(70.0, CompassKnowledge::Factory);
    first.iron_ut = Vector3::new(120.0, -130.0, 95.0);
    first.rest(2.0);
    assert_eq!(first.heading.certain_hard_iron_ut(), None);
    first.tumble(20.0);
    let found = first.heading.certain_hard_iron_ut().expect("it is certain");
    let mut next = Flight::new(-20.0, CompassKnowledge::HardIron);
    next.iron_ut = first.iron_ut - found;
    next.rest(4.0);
    let estimate = next.heading.estimate().expect("a heading");
    assert!(!estimate.is_valid);
    next.run(10.0, |t_s| Vector3::new(0.0, 0.0, libm::sinf(t_s)));
    next.assert_error_below(8.0);
    assert!(next.heading.estimate().expect("a heading").is_valid);
}

#[test]
fn the_heading_survives_a_passing_magnet() {
    let mut flight = Flight::new(-120.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    flight.tumble(10.0);
    flight.disturbance_ut = Vector3::new(-15.0, 25.0, -10.0);
    flight.tumble(3.0);
    flight.assert_error_below(15.0);
    flight.disturbance_ut = Vector3::ZERO;
    flight.tumble(10.0);
    flight.assert_error_below(3.0);
}

#[test]
fn a_magnet_that_stays_on_the_body_is_learned() {
    let mut flight = Flight::new(10.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    flight.tumble(10.0);
    flight.iron_ut = Vector3::new(12.0, -9.0, 5.0);
    flight.tumble(30.0);
    flight.assert_error_below(4.0);
    let found = flight.heading.hard_iron_ut() - flight.iron_ut;
    assert!(found.norm() < 5.0, "{found:?}");
}

/// An excess opens the hard iron for about a second, whether readings follow or not.
#[test]
fn a_silence_after_a_disturbance_leaves_the_hard_iron_known() {
    let largest_ut = |flight: &Flight| {
        let Vector3 { x, y, z } = flight.heading.hard_iron_sigma_ut();
        x.max(y).max(z)
    };
    let mut flight = Flight::new(10.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    flight.tumble(10.0);
    flight.disturbance_ut = Vector3::new(-150.0, 250.0, -100.0);
    flight.tumble(0.5);
    assert!(flight.heading.excess > 3_000.0, "{}", flight.heading.excess);
    flight.reading_us = u64::MAX;
    flight.tumble(60.0);
    let silent_ut = largest_ut(&flight);
    assert!(silent_ut < 20.0, "{silent_ut}");
    flight.disturbance_ut = Vector3::ZERO;
    flight.reading_us = flight.t_us;
    // The inconsistency of the disturbance has to end.
    flight.tumble(25.0);
    flight.assert_error_below(3.0);
    assert!(flight.heading.estimate().is_some_and(|it| it.is_valid));
}

/// Yaw drifts, so turns count from an attitude of the last 15 s: at every sample rate, and after a
/// silence.
#[test]
fn turns_count_for_15_s() {
    for step_us in [1_000, 10_000, 20_000] {
        let mut flight = Flight::new(10.0, CompassKnowledge::Calibrated);
        flight.step_us = step_us;
        flight.rest(3.0);
        let mut first = flight.heading.first_attitude;
        let mut taken_s = 0.0;
        let mut ages_s = [0.0; 3];
        for (place, age_s) in ages_s.iter_mut().enumerate() {
            while flight.heading.first_attitude == first {
                flight.tumble(0.1);
                // The last window is silent after 10 s.
                if place == 2 && flight.t_us as f32 * 1.0e-6 - taken_s > 10.0 {
                    flight.reading_us = flight.t_us + 8_000_000;
                    flight.tumble(9.0);
                }
            }
            let t_s = flight.t_us as f32 * SECONDS_PER_MICROSECOND;
            *age_s = t_s - taken_s;
            (first, taken_s) = (flight.heading.first_attitude, t_s);
        }
        let [_, second, silent] = ages_s;
        assert!((14.5..15.6).contains(&second), "{step_us} us: {ages_s:?}");
        assert!((18.5..19.6).contains(&silent), "{step_us} us: {ages_s:?}");
    }
}

#[test]
fn any_sample_rate_gives_the_heading() {
    // Above 250 Hz the step runs in slices, below at once. Beyond 20 ms an interval has few
    // samples.
    for step_us in [1_000, 2_000, 3_500, 5_000, 10_000, 20_000] {
        let mut flight = Flight::new(140.0, CompassKnowledge::Factory);
        flight.step_us = step_us;
        flight.iron_ut = Vector3::new(30.0, 10.0, -20.0);
        flight.rest(2.0);
        flight.tumble(20.0);
        flight.assert_error_below(3.0);
    }
}

#[test]
fn the_gyroscopes_offset_does_not_turn_the_heading() {
    let mut flight = Flight::new(30.0, CompassKnowledge::Calibrated);
    flight.offset_rad_s = Vector3::new(radians(2.0), radians(-3.0), radians(4.0));
    flight.rest(5.0);
    flight.tumble(20.0);
    flight.assert_error_below(3.0);
    flight.rest(20.0);
    flight.assert_error_below(3.0);
}

/// At 100 Hz a step of the tilt filter takes 0.3 s. The offset that the first rest finds turns the
/// level frame meanwhile, by 1.2°.
#[test]
fn an_offset_that_a_rest_finds_late_does_not_turn_the_heading() {
    const FLIGHTS: u16 = 24;
    let mut mean_deg = 0.0;
    for noise in 0..FLIGHTS {
        let mut flight = Flight::new(30.0, CompassKnowledge::Calibrated);
        flight.noise = noise.into();
        flight.step_us = 10_000;
        flight.offset_rad_s = Vector3::new(0.0, 0.0, radians(4.0));
        flight.rest(4.0);
        mean_deg += flight.error_deg().expect("a heading") / f32::from(FLIGHTS);
    }
    assert!(mean_deg.abs() < 0.5, "{mean_deg}");
}

#[test]
fn a_gap_forgets_the_heading_and_finds_it_again() {
    let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    assert!(flight.heading.estimate().is_some());
    // Unseen: a turn by 90°.
    let turn = Vector3::new(0.0, 0.0, radians(90.0));
    flight.truth = Quaternion::from_rotation_vector(turn).multiply(flight.truth);
    flight.t_us += 2_000_000;
    flight.reading_us = flight.t_us;
    flight.step(Vector3::ZERO);
    assert_eq!(flight.heading.estimate(), None);
    flight.rest(3.0);
    flight.assert_error_below(1.5);
}

/// At the first rest after a pause the tilt filter knows the velocity 4,000 times better. The field
/// must follow it whatever the phase of the steps. Before, some of these headings were lost until
/// the next motion.
#[test]
fn a_rest_after_a_gap_does_not_lose_the_heading() {
    for phase in 0..48_u8 {
        let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
        flight.rest(3.0 + 0.01 * f32::from(phase));
        flight.t_us += 2_000_000;
        flight.reading_us = flight.t_us;
        flight.rest(1.5);
        assert!(flight.heading.estimate().is_some(), "{phase}");
        for _ in 0..150 {
            flight.rest(0.01);
            assert!(flight.heading.estimate().is_some(), "{phase}");
        }
        flight.assert_error_below(1.5);
    }
}

/// The tilt filter may have abandoned a step, and know more than the correlations show.
#[test]
fn a_gap_forgets_the_correlations_with_the_tilt_filter() {
    let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    flight.tumble(20.0);
    let correlates = |flight: &Flight| {
        let mut entries = flight.heading.covariance.cross.iter().flatten();
        entries.any(|entry| *entry != 0.0)
    };
    assert!(correlates(&flight));
    flight.t_us += 2_000_000;
    flight.reading_us = flight.t_us;
    flight.step(Vector3::ZERO);
    assert!(!correlates(&flight));
}

/// A changed knowledge resets the tilt filter before it gets the next sample.
#[test]
fn a_reset_between_two_samples_is_noticed() {
    let kinds = [
        AccelerometerKnowledge::Calibrated,
        AccelerometerKnowledge::Factory,
    ];
    for step_us in [1_000, 4_000, 20_000] {
        let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
        flight.step_us = step_us;
        flight.rest(3.0);
        for (trial, kind) in kinds.into_iter().cycle().take(40).enumerate() {
            flight.tumble(0.5 + 0.001 * trial as f32);
            assert!(flight.heading.covariance.is_correlated());
            flight
                .estimator
                .filter_mut()
                .set_accelerometer_knowledge(kind);
            flight.step(Vector3::ZERO);
            let mut entries = flight.heading.covariance.cross.iter().flatten();
            assert!(
                entries.all(|entry| *entry == 0.0),
                "{step_us} us, trial {trial}"
            );
            // No step follows over an interval of no length.
            assert_eq!(
                flight.heading.next_slice,
                FieldSlice::Idle,
                "{step_us} us, trial {trial}"
            );
        }
    }
}

#[test]
fn a_reset_ends_a_step_that_has_begun_before_any_measurement() {
    let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
    while flight.heading.next_slice == FieldSlice::Idle {
        flight.step(Vector3::ZERO);
    }
    assert!(!flight.heading.covariance.is_correlated());
    flight
        .estimator
        .filter_mut()
        .set_accelerometer_knowledge(AccelerometerKnowledge::Factory);
    flight.step(Vector3::ZERO);
    assert_eq!(flight.heading.next_slice, FieldSlice::Idle);
    // It goes on as after any start.
    flight.rest(1.0);
    assert!(flight.heading.covariance.is_correlated());
}

const JOINT: usize = STATES + ERROR_STATES;

/// Returns the joint covariance of the heading filter and the tilt filter.
fn joint_covariance(flight: &Flight) -> [[f64; JOINT]; JOINT] {
    let (heading, kalman) = (&flight.heading.covariance, flight.estimator.filter());
    let of_kalman: [_; ERROR_STATES] = core::array::from_fn(|state| {
        let mut column = [0.0; ERROR_STATES];
        match state {
            0 => kalman.add_tilt_columns([1.0, 0.0], &mut column),
            1 => kalman.add_tilt_columns([0.0, 1.0], &mut column),
            2 => kalman.add_velocity_columns([1.0, 0.0], &mut column),
            3 => kalman.add_velocity_columns([0.0, 1.0], &mut column),
            _ => kalman.add_parameter_column(state - 4, 1.0, &mut column),
        }
        column
    });
    let entry = |row: usize, column: usize| match (row < STATES, column < STATES) {
        (true, true) => heading.entry(row, column),
        (true, false) => heading.cross_entry(row, column - STATES),
        (false, true) => heading.cross_entry(column, row - STATES),
        (false, false) => of_kalman[row - STATES][column - STATES],
    };
    core::array::from_fn(|row| core::array::from_fn(|column| entry(row, column).into()))
}

/// Returns the least pivot of a covariance's correlation matrix: positive if it is definite.
fn least_pivot(covariance: &[[f64; JOINT]; JOINT]) -> f64 {
    let sigma: [f64; JOINT] = core::array::from_fn(|state| covariance[state][state].sqrt());
    let mut rest = *covariance;
    for (row, entries) in rest.iter_mut().enumerate() {
        for (column, entry) in entries.iter_mut().enumerate() {
            *entry /= sigma[row] * sigma[column];
        }
    }
    let mut least = f64::INFINITY;
    for pivot in 0..JOINT {
        let pivots = rest[pivot];
        least = least.min(pivots[pivot]);
        for entries in rest.iter_mut().skip(pivot + 1) {
            let factor = entries[pivot] / pivots[pivot];
            for (entry, above) in entries.iter_mut().zip(pivots) {
                *entry -= factor * above;
            }
        }
    }
    least
}

/// The heading filter has to repeat each step of the tilt filter. Otherwise measurements of the one
/// shrink the covariance of the other by too much.
#[test]
fn the_joint_covariance_is_positive_definite() {
    let swing = |t_s: f32| Vector3::new(-0.65, -0.7, -0.3).scale(2.0 * libm::sinf(2.5 * t_s));
    for knowledge in CompassKnowledge::ALL {
        let mut flight = Flight::new(20.0, knowledge);
        flight.step_us = 1_000;
        flight.rest(2.0);
        let mut checks = 0;
        for second in 0..90 {
            match second {
                0..40 => flight.run(1.0, swing),
                60..70 => flight.tumble(1.0),
                _ => flight.rest(1.0),
            }
            if flight.heading.next_slice == FieldSlice::Idle
                && !flight.estimator.filter().is_step_under_way()
            {
                let least = least_pivot(&joint_covariance(&flight));
                assert!(least > 0.0, "{knowledge:?}, {second} s: {least}");
                checks += 1;
            }
        }
        assert!(checks > 20, "{checks}");
    }
}

#[test]
fn a_pause_widens_the_heading() {
    let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
    flight.estimator.filter_mut().set_sample_period(0.002);
    flight.tumble(20.0);
    flight.rest(3.0);
    let sigma = |flight: &Flight| flight.heading.estimate().expect("a heading").sigma_rad;
    let before = sigma(&flight);
    flight.heading.has_reading = false;
    flight.reading_us = u64::MAX;
    flight.step_us = 400_000;
    flight.step(Vector3::ZERO);
    flight.step_us = 2_000;
    flight.rest(0.5);
    assert!(
        sigma(&flight) > before + radians(5.0),
        "{} {before}",
        sigma(&flight)
    );
}

/// A vehicle may turn while no sample comes. σ shows it from the first sample on, and after the
/// step that was under way.
#[test]
fn a_turn_in_a_pause_keeps_the_promise_from_the_first_sample_on() {
    for (pause_us, turn_deg) in [(200_000, 34.0), (300_000, 26.0), (480_000, 83.0)] {
        for phase in 0..25 {
            let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
            flight.estimator.filter_mut().set_sample_period(0.001);
            flight.step_us = 1_000;
            flight.rest(3.0);
            flight.tumble(10.0);
            flight.rest(0.5 + 0.01 * phase as f32);
            assert!(flight.heading.estimate().is_some_and(|it| it.is_valid));
            let turn = Quaternion::from_euler(EulerAngles {
                yaw_rad: radians(turn_deg),
                ..EulerAngles::default()
            });
            flight.truth = turn.multiply(flight.truth);
            flight.step_us = pause_us;
            flight.step(Vector3::ZERO);
            flight.check_promise();
            flight.step_us = 1_000;
            let hidden_rad = PAUSE_RATE_RAD_S * pause_us as f32 * SECONDS_PER_MICROSECOND;
            for _ in 0..50 {
                flight.rest(0.001);
                let estimate = flight.heading.estimate();
                assert!(estimate.is_none_or(|it| it.sigma_rad > 0.99 * hidden_rad));
            }
            flight.rest(3.0);
        }
    }
}

/// A log may have a reading in each row.
#[test]
fn a_reading_with_each_sample_is_as_good_as_one_in_ten() {
    for step_us in [1_000, 1_250, 2_000] {
        let mut flight = Flight::new(50.0, CompassKnowledge::Calibrated);
        flight.step_us = step_us;
        flight.reading_period_us = 0;
        flight.rest(3.0);
        flight.tumble(10.0);
        flight.assert_error_below(3.0);
        assert!(flight.heading.estimate().is_some_and(|it| it.is_valid));
        let changes = flight.heading.changes();
        flight.tumble(1.0);
        assert_ne!(flight.heading.changes(), changes);
    }
}

#[test]
fn a_heading_without_readings_is_valid_for_a_second() {
    let is_valid = |flight: &Flight| flight.heading.estimate().is_some_and(|it| it.is_valid);
    for step_us in [1_000, 10_000] {
        let mut flight = Flight::new(-60.0, CompassKnowledge::Calibrated);
        flight.step_us = step_us;
        flight.rest(3.0);
        flight.tumble(5.0);
        assert!(is_valid(&flight));
        flight.reading_us = u64::MAX;
        flight.tumble(0.6);
        assert!(is_valid(&flight), "{step_us}");
        flight.tumble(1.2);
        assert!(!is_valid(&flight), "{step_us}");
        // The heading itself goes on with the gyroscope.
        flight.assert_error_below(3.0);
        flight.reading_us = flight.t_us;
        flight.tumble(0.8);
        assert!(is_valid(&flight), "{step_us}");
    }
}

#[test]
fn an_update_to_a_time_is_an_update_by_its_step() {
    let mut flight = Flight::new(20.0, CompassKnowledge::Calibrated);
    flight.step(Vector3::ZERO);
    let mut other = flight.heading;
    other.update_to(flight.estimator.filter(), flight.t_us);
    for index in 0..2_000 {
        flight.step(Vector3::new(0.5, -0.3, 0.2));
        other.update_to(flight.estimator.filter(), flight.t_us);
        // A sample that the tilt filter has rejected.
        other.update_to(flight.estimator.filter(), flight.t_us);
        if flight.heading.has_reading {
            other.add_field(
                MagneticField {
                    ut: flight.heading.reading_ut,
                },
                0,
            );
        }
        assert_eq!((other.updated_us, other.has_started), (flight.t_us, true));
        let changes = other.changes;
        let without_time = Heading {
            updated_us: 0,
            ..other
        };
        assert_eq!(without_time, flight.heading, "{index} {changes}");
    }
    assert!(flight.heading.estimate().is_some());
}

#[test]
fn readings_that_no_compass_delivers_do_no_harm() {
    let mut flight = Flight::new(80.0, CompassKnowledge::Calibrated);
    flight.rest(3.0);
    // A sum of 15,000 µT or more is rejected.
    for bad in [f32::NAN, f32::INFINITY, -1.0e30, 9_000.0, 4_900.0, 0.0] {
        for _ in 0..500 {
            flight.step(Vector3::ZERO);
            let field = MagneticField {
                ut: [bad, -bad, bad],
            };
            let before = flight.heading;
            flight.heading.add_field(field, 0);
            let is_taken = flight.heading.reading_ut == field.ut && flight.heading.has_reading;
            assert_eq!(is_taken, bad.abs() < 5_000.0, "{bad}");
            // A reading that waits stays.
            assert!(is_taken || flight.heading == before);
            if let Some(estimate) = flight.heading.estimate() {
                assert!(estimate.yaw_offset_rad.abs() < 3.2 && estimate.sigma_rad > 0.0);
            }
        }
    }
    assert!(flight.heading.state.iter().all(|state| state.is_finite()));
    flight.tumble(20.0);
    flight.assert_error_below(3.0);
}

#[test]
fn a_restart_clears_numbers_that_are_none() {
    for bad in [f32::NAN, f32::INFINITY] {
        let mut flight = Flight::new(80.0, CompassKnowledge::Calibrated);
        flight.rest(3.0);
        flight.heading.covariance.add(IRON + 1, FIELD, bad);
        flight.heading.covariance.cross = [[bad; ERROR_STATES]; 6];
        flight.heading.state = [bad; STATES];
        flight.tumble(1.0);
        assert!(
            joint_covariance(&flight)[..STATES]
                .iter()
                .flatten()
                .all(|it| it.is_finite())
        );
        flight.tumble(20.0);
        flight.assert_error_below(3.0);
    }
}

#[test]
fn a_restored_state_continues_to_the_bit() {
    let mut flight = Flight::new(80.0, CompassKnowledge::Factory);
    flight.step_us = 1_000;
    flight.tumble(3.0);
    let mut phases = 0;
    // Every phase of a step, and more than a step.
    for _ in 0..400 {
        flight.step(Vector3::new(0.5, -0.3, 0.2));
        let mut bytes = [0; 2_048];
        let mut copy = flight.heading;
        let mut writer = StateWriter::new(&mut bytes, 0);
        copy.visit_state(&mut writer);
        let length = writer.length().expect("a byte form");
        let mut restored = Heading::new(CompassKnowledge::HardIron);
        let mut reader = StateReader::new(&bytes[..length]);
        restored.visit_state(&mut reader);
        assert!(reader.is_complete());
        assert_eq!(restored, flight.heading);
        phases += u32::from(restored.next_slice != FieldSlice::Idle);
    }
    assert!(phases > 100, "{phases}");
}

#[test]
fn a_step_is_complete_before_the_tilt_filter_begins_its_next() {
    let mut flight = Flight::new(0.0, CompassKnowledge::Factory);
    for step_us in [1_000, 1_250, 2_000, 4_000] {
        flight.step_us = step_us;
        for index in 0..3_000 {
            let was_idle = matches!(
                flight.heading.next_slice,
                FieldSlice::Idle | FieldSlice::Waiting
            );
            let before = flight.heading.open;
            flight.step(Vector3::new(0.4, 0.1, -0.2));
            let has_closed = flight.heading.open != before;
            assert!(!has_closed || was_idle, "{step_us} µs, step {index}");
        }
    }
}

/// A simulator's sensor has no noise, and lies exactly as it is told. An axis that points straight
/// down is turned by no bias of its own.
#[test]
fn the_heading_is_known_with_any_axis_straight_down() {
    let axes = [
        Vector3::new(1.0, 0.0, 0.0),
        Vector3::new(0.0, 1.0, 0.0),
        Vector3::new(0.0, 0.0, 1.0),
    ];
    for (place, down) in axes.iter().enumerate() {
        for sign in [1.0, -1.0] {
            let down = down.scale(sign);
            let north = axes[(place + 1) % 3];
            let mut estimator = Estimator::new();
            let mut heading = Heading::new(CompassKnowledge::Calibrated);
            let force = BodyVector(down.scale(-STANDARD_GRAVITY_M_S2));
            let field = down.scale(EARTH_UT.z) + north.scale(EARTH_UT.x);
            let ut = [field.x, field.y, field.z];
            for index in 0..5_000_u64 {
                estimator.update(&Sample::new(1_000 * index, force, BodyVector::ZERO));
                heading.update(estimator.filter(), 0.001);
                if index % 10 == 0 {
                    heading.add_field(MagneticField { ut }, 5_000);
                }
            }
            assert!(heading.estimate().is_some(), "down is {down:?}");
        }
    }
}

/// With an unknown bias no turn is known well enough, and those before it are in question too.
#[test]
fn no_turns_count_while_the_bias_is_unknown() {
    use crate::estimator::filter::Filter as _;
    let mut flight = Flight::new(20.0, CompassKnowledge::Calibrated);
    for _ in 0..200 {
        flight.tumble(0.1);
        assert!(!flight.estimator.filter().is_bias_known());
        assert_eq!(flight.heading.verified_s, 0.0, "{} us", flight.t_us);
    }
    flight.rest(5.0);
    flight.tumble(5.0);
    assert!(flight.heading.verified_s > 0.0);
    let filter = flight.estimator.filter_mut();
    filter.set_bias(Vector3::ZERO, radians(5.0));
    flight.tumble(1.0);
    assert!(!flight.estimator.filter().is_bias_known());
    assert_eq!(flight.heading.verified_s, 0.0);
}

/// The next run would subtract it from readings that are corrected already.
#[test]
fn a_calibrated_compass_has_no_hard_iron_to_keep() {
    for (knowledge, has_iron) in [
        (CompassKnowledge::Factory, true),
        (CompassKnowledge::HardIron, true),
        (CompassKnowledge::Calibrated, false),
    ] {
        let mut flight = Flight::new(70.0, knowledge);
        flight.rest(2.0);
        flight.tumble(20.0);
        assert!(flight.heading.estimate().is_some_and(|it| it.is_valid));
        let found = flight.heading.certain_hard_iron_ut();
        assert_eq!(found.is_some(), has_iron, "{knowledge:?}");
    }
}
