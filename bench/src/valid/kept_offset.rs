//! The accelerometer's offset that one flight shows, in the next flight of the same chip.

use aplomb::attitude::Vector3;
use aplomb::calibration::Mount;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_recordings::simulated::{errors, samples_with};

use super::{Judged, seeds};
use crate::parallel;
use crate::recording::Recording;
use crate::simulated;

/// Length of a flight, s, and start of the time that counts, µs.
const SECONDS: u64 = 60;
const START_US: u64 = 5_000_000;

/// Flies this route with this chip, whose accelerometer is not calibrated.
fn flight(chip: u64, route: u64) -> Recording {
    let errors = errors(chip, AccelerometerKnowledge::Factory);
    let flown = samples_with(Box::new(Quadrotor::by_seed(route)), route, errors, SECONDS);
    simulated::recording("simulated", format!("chip {chip}, route {route}"), flown)
}

/// Returns the pipeline after a flight from which this offset is subtracted, and the root mean
/// square of its tilt error, degrees.
fn fly(flight: &Recording, settings: &Settings, offset_m_s2: Vector3) -> (Pipeline, f64) {
    let mut pipeline = Pipeline::new(settings);
    let (mut squares, mut rows) = (0.0, 0_u32);
    for (sample, up) in flight.samples.iter().zip(&flight.true_up) {
        let mut sample = *sample;
        sample.specific_force_m_s2 = sample.specific_force_m_s2 - offset_m_s2;
        let snapshot = pipeline.update_sample(&sample);
        if let Some(up) = up.filter(|_| sample.t_us >= START_US) {
            squares += Judged::new(&snapshot, up).error_deg.powi(2);
            rows += 1;
        }
    }
    (pipeline, (squares / f64::from(rows)).sqrt())
}

#[test]
fn the_offset_of_a_flight_serves_the_next() {
    let chips = seeds(710_000..710_024);
    let errors_deg = parallel::map(&chips, |chip| {
        let mut settings = Settings::new(&Part::MPU_6050);
        let (taught, _) = fly(&flight(*chip, chip + 500), &settings, Vector3::ZERO);
        let next = flight(*chip, *chip);
        let (_, before_deg) = fly(&next, &settings, Vector3::ZERO);
        let Some(offset) = taught.certain_accelerometer_offset_m_s2() else {
            return (before_deg, before_deg, false);
        };
        let calibration = &mut settings.calibration;
        calibration.add_accelerometer_offset(offset, Mount::Z_UP);
        (before_deg, fly(&next, &settings, offset).1, true)
    });
    let mean = |error: fn(&(f64, f64, bool)) -> f64| {
        errors_deg.iter().map(error).sum::<f64>() / errors_deg.len() as f64
    };
    let (before_deg, after_deg) = (mean(|both| both.0), mean(|both| both.1));
    let certain = errors_deg.iter().filter(|flown| flown.2).count();
    println!(
        "{certain} of {} chips have a certain offset; mean error {before_deg:.2} deg, then \
         {after_deg:.2} deg",
        errors_deg.len()
    );
    assert!(certain * 4 > errors_deg.len() * 3, "{certain}");
    assert!(after_deg < 0.93 * before_deg, "{before_deg} {after_deg}");
}
