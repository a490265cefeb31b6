//! The covariance step against plain matrices in `f64`, and the state that it corrects.

use super::super::covariance::Covariance;
use super::super::propagation::{DYNAMIC, PARAMETERS, State, Transition};
use super::super::slices::Measurement;
use super::*;

pub(super) const STATES: usize = DYNAMIC + PARAMETERS;
pub(super) type Matrix = [[f64; STATES]; STATES];

/// The covariance as one matrix.
pub(super) fn dense(covariance: &Covariance) -> Matrix {
    let mut matrix = [[0.0; STATES]; STATES];
    for state in 0..STATES {
        let mut column = Column::ZERO;
        match state {
            0..DYNAMIC => covariance.dynamic_column(state, &mut column),
            _ => covariance.parameter_column(state - DYNAMIC, &mut column),
        }
        let entries = column.dynamic.iter().chain(&column.parameters);
        for (row, entry) in matrix.iter_mut().zip(entries) {
            row[state] = f64::from(*entry);
        }
    }
    matrix
}

/// F of the interval, from its definition in the module's text.
fn dense_transition(transition: &Transition) -> Matrix {
    let mut f = [[0.0; STATES]; STATES];
    for (state, row) in f.iter_mut().enumerate() {
        row[state] = 1.0;
    }
    f[2][1] = f64::from(transition.down_m_s);
    f[3][0] = -f64::from(transition.down_m_s);
    for (parameter, b) in transition.tilt.iter().enumerate() {
        f[0][DYNAMIC + parameter] = -f64::from(b[0]);
        f[1][DYNAMIC + parameter] = -f64::from(b[1]);
        if parameter < 3 {
            f[2][DYNAMIC + GYROSCOPE_PARAMETERS + parameter] = -f64::from(b[0]);
            f[3][DYNAMIC + GYROSCOPE_PARAMETERS + parameter] = -f64::from(b[1]);
        }
    }
    f
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let mut c = [[0.0; STATES]; STATES];
    for row in 0..STATES {
        for column in 0..STATES {
            c[row][column] = (0..STATES).map(|k| a[row][k] * b[k][column]).sum();
        }
    }
    c
}

fn transposed(a: &Matrix) -> Matrix {
    let mut b = [[0.0; STATES]; STATES];
    for row in 0..STATES {
        for column in 0..STATES {
            b[column][row] = a[row][column];
        }
    }
    b
}

/// Returns whether a matrix is positive definite: Cholesky's square roots exist.
pub(super) fn is_positive(a: &Matrix) -> bool {
    let mut l = [[0.0; STATES]; STATES];
    for row in 0..STATES {
        for column in 0..=row {
            let sum: f64 = (0..column).map(|k| l[row][k] * l[column][k]).sum();
            if row == column {
                let square = a[row][row] - sum;
                if square <= 0.0 {
                    return false;
                }
                l[row][row] = square.sqrt();
            } else {
                l[row][column] = (a[row][column] - sum) / l[column][column];
            }
        }
    }
    true
}

/// Returns the largest difference of two covariances, in units of their σ.
fn distance(a: &Matrix, b: &Matrix) -> f64 {
    let mut largest: f64 = 0.0;
    for row in 0..STATES {
        for column in 0..STATES {
            let scale = (b[row][row] * b[column][column]).sqrt();
            largest = largest.max((a[row][column] - b[row][column]).abs() / scale);
        }
    }
    largest
}

fn random_transition(random: &mut Random) -> Transition {
    let mut transition = Transition::IDENTITY;
    for (parameter, b) in transition.tilt.iter_mut().enumerate() {
        let scale = if parameter < 3 { 0.2 } else { 0.4 };
        *b = [scale * random.next(), scale * random.next()];
    }
    transition.down_m_s = -2.0 + random.next();
    transition
}

#[test]
fn the_sliced_step_is_the_kalman_filter_of_the_textbook() {
    let mut random = Random(1);
    let mut step = CovarianceStep::new();
    step.covariance = Kalman::new().step.covariance;
    for (axis, variance) in [0.01, 0.02, 0.03].into_iter().enumerate() {
        step.covariance.scale_parameter(axis, 0.0, variance);
    }
    for (state, variance) in [0.04, 0.04, 0.01, 0.01].into_iter().enumerate() {
        step.covariance.reset_dynamic(state, variance);
    }
    let mut p = dense(&step.covariance);
    for round in 0..200 {
        let transition = random_transition(&mut random);
        let noise = [1.0e-5, 1.0e-3];
        let mut measurements = Vec::new();
        for state in [State::Dynamic(2), State::Dynamic(3)] {
            measurements.push((state, random.next(), 0.5));
        }
        if round % 3 == 0 {
            measurements.push((State::Parameter(round % 5), 0.1 * random.next(), 0.01));
        }

        step.begin(&transition, noise[0], noise[1], 0.2);
        let corrected = loop {
            match step.slice() {
                Progress::Working
                | Progress::Propagated
                | Progress::PreparationDue
                | Progress::Checked => {}
                Progress::MeasurementsDue => {
                    for (state, innovation, variance) in &measurements {
                        step.queue_measurement(Measurement {
                            state: *state,
                            innovation: *innovation,
                            variance: *variance,
                        });
                    }
                }
                Progress::Corrected => break step.correction,
                progress => panic!("{progress:?}"),
            }
        };

        // P ← F·P·Fᵀ + Q, K = P·Hᵀ/s, x ← x + K·(z − H·x), P ← (I − K·H)·P.
        let f = dense_transition(&transition);
        p = product(&product(&f, &p), &transposed(&f));
        for state in 0..DYNAMIC {
            p[state][state] += f64::from(noise[state / 2]);
        }
        let mut x = [0.0; STATES];
        for (state, innovation, variance) in &measurements {
            let measured = match state {
                State::Dynamic(state) => *state,
                State::Parameter(parameter) => DYNAMIC + parameter,
            };
            let s = p[measured][measured] + f64::from(*variance);
            let gain: Vec<f64> = (0..STATES).map(|row| p[row][measured] / s).collect();
            let y = f64::from(*innovation) - x[measured];
            let before = p;
            for row in 0..STATES {
                x[row] += gain[row] * y;
                for column in 0..STATES {
                    p[row][column] -= gain[row] * before[measured][column];
                }
            }
        }

        let ours = dense(&step.covariance);
        assert_eq!(ours, transposed(&ours), "exactly symmetric");
        assert!(is_positive(&ours), "round {round}");
        let off = distance(&ours, &p);
        assert!(off < 2.0e-3, "round {round}: {off}");
        let correction = corrected.dynamic.iter().chain(&corrected.parameters);
        for (state, (ours, exact)) in correction.zip(x).enumerate() {
            let sigma = p[state][state].sqrt();
            let off = (f64::from(*ours) - exact).abs() / sigma;
            assert!(off < 0.02, "round {round}, state {state}: {ours} {exact}");
        }
    }
}

/// The transition propagates a small error as the nominal state does.
#[test]
fn the_transition_is_the_derivative_of_the_nominal_state() {
    // About 25 steps of 8 ms with motion about all axes, with a small error in one state.
    let propagate = |state: usize, error: f32| {
        let mut nominal = NominalState::new();
        nominal.attitude = from_degrees(20.0, -35.0, 50.0);
        let mut dynamic = [0.0; DYNAMIC];
        let mut parameters = [0.0; PARAMETERS];
        match state {
            0..DYNAMIC => dynamic[state] = error,
            _ => parameters[state - DYNAMIC] = error,
        }
        nominal.add_error(&dynamic, &parameters);
        let mut transition = Transition::IDENTITY;
        let mut velocity = nominal.velocity_m_s;
        for index in 0..200 {
            let t = 1.0e-3 * index as f32;
            let rate = Vector3::new(1.0 + t, -2.0 + 3.0 * t, 1.5);
            let force = Vector3::new(1.0, -2.0 * t, -9.0);
            if index == 0 {
                nominal.start(rate, force);
            }
            nominal.integrate(rate, force, 1.0e-3);
            if index % 8 == 7 {
                let step = nominal.step_in_earth_axes(&mut transition);
                velocity[0] += step.force_integral_ned_m_s.x;
                velocity[1] += step.force_integral_ned_m_s.y;
            }
        }
        (nominal.attitude, velocity, transition)
    };
    let (attitude, velocity, transition) = propagate(0, 0.0);
    for state in 0..STATES {
        let error = 2.0e-3;
        let (changed, changed_velocity, _) = propagate(state, error);
        let difference = changed.multiply(attitude.conjugate()).normalize();
        let found = [
            2.0 * difference.x,
            2.0 * difference.y,
            changed_velocity[0] - velocity[0],
            changed_velocity[1] - velocity[1],
        ];
        let mut dynamic = [0.0; DYNAMIC];
        let mut parameters = [0.0; PARAMETERS];
        match state {
            0..DYNAMIC => dynamic[state] = error,
            _ => parameters[state - DYNAMIC] = error,
        }
        transition.apply(&mut dynamic, &parameters);
        // A correction removes the error; here it was added with the same sign.
        for (index, (found, expected)) in found.into_iter().zip(dynamic).enumerate() {
            // F leaves two effects on velocity to the next interval: a bias, integrated twice, and
            // the vertical axis of tilt. They are half of g·T·T/2 at most.
            let tolerance = if index < 2 { 0.06 } else { 1.3 };
            assert!(
                (found - expected).abs() < tolerance * error,
                "state {state} into {index}: {found} {expected}"
            );
        }
    }
}

/// A step corrects the covariance in many slices, and the state in its last one.
#[test]
fn sigma_falls_only_when_the_state_is_corrected() {
    let mut world = World::at_rest(from_degrees(10.0, -20.0, 0.0));
    world.acceleration_m_s2 = Vector3::new(3.0, 1.0, 0.0);
    let mut estimator = estimator();
    world.run(&mut estimator, 200);
    world.acceleration_m_s2 = Vector3::ZERO;
    let mut falls = 0;
    for _ in 0..10_000 {
        let (before, velocity) = {
            let filter = filter(&estimator);
            (
                filter.covariance_tilt_variance(),
                filter.nominal.velocity_m_s,
            )
        };
        world.run(&mut estimator, 1);
        let filter = filter(&estimator);
        if filter.covariance_tilt_variance() < before {
            falls += 1;
            assert!(!filter.step.is_under_way(), "at {} µs", world.t_us);
            // A correction moves the velocity too.
            assert!(filter.nominal.velocity_m_s != velocity);
        }
    }
    assert!(falls > 30, "{falls}");
}

/// A rest measures a bias that motion has contradicted. A wrong sample abandons its step while a
/// measurement is being applied.
#[test]
fn an_abandoned_step_leaves_a_positive_covariance() {
    let mut cut_short = 0;
    for slices in 0..60 {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        let mut estimator = estimator();
        world.run(&mut estimator, 3_000);
        let filter = estimator.filter_mut();
        for axis in 0..3 {
            let covariance = &mut filter.step.covariance;
            covariance.add_to_parameter(axis, square(radians(6.0)));
        }
        filter.rest_detector.interrupt();
        world.bias_rad_s = Vector3::new(radians(4.0), radians(-4.0), radians(4.0));
        while !self::filter(&estimator).rest_watch.begins {
            world.run(&mut estimator, 1);
        }
        world.run(&mut estimator, slices);
        let filter = estimator.filter_mut();
        cut_short += u32::from(filter.step.is_under_way());
        filter.inflate_motion(0.01);
        assert!(is_positive(&dense(&filter.step.covariance)), "{slices}");
    }
    assert!(cut_short > 20, "{cut_short}");
}

/// Kinds of the measurements of a step, in the order of the queue.
fn queue(filter: &Kalman) -> String {
    let kind = |measurement: Measurement| match measurement.state {
        State::Parameter(_) => 'p',
        State::Dynamic(_) => 'v',
    };
    (0..)
        .map_while(|index| filter.step.measurement(index))
        .map(kind)
        .collect()
}

/// The heading filter repeats the columns of the parameters up to the first measurement that is of
/// no parameter (`heading/step.rs`).
#[test]
fn parameters_are_queued_before_the_velocity() {
    // A rest, which measures the bias; a start in motion, with a bias far outside its prior.
    for (is_rest, milliseconds, bias_rad_s) in [(true, 3_000, 0.01), (false, 20_000, 0.4)] {
        let mut world = World::at_rest(Quaternion::IDENTITY);
        world.bias_rad_s = Vector3::new(bias_rad_s, 0.0, 0.0);
        let mut estimator = estimator();
        let (mut hand, mut random) = (Hand::default(), Random(3));
        let mut queues = std::collections::BTreeSet::new();
        for _ in 0..milliseconds {
            if !is_rest {
                hand.moves(&mut world, &mut random);
            }
            world.run(&mut estimator, 1);
            queues.insert(queue(filter(&estimator)));
        }
        assert_eq!(filter(&estimator).has_rested, is_rest);
        assert!(
            queues.iter().any(|queue| queue.starts_with('p')),
            "{queues:?}"
        );
        for queue in queues {
            let rest = queue.trim_start_matches('p').trim_start_matches('v');
            assert_eq!(rest, "", "{queue}");
        }
    }
}
