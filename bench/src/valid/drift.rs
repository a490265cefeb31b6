//! Temperatures that change in motion. The gyroscope's offset follows the die's temperature, which
//! the bursts show. A register of a clone may jump, and the offset does not follow. The attitude
//! must not be `VALID` and wrong.

use std::sync::LazyLock;

use aplomb::attitude::{BodyVector, Vector3};
use aplomb::calibration::TemperatureModel;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Part, RawSample};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::units::{STANDARD_GRAVITY_M_S2, radians};
use aplomb_models::motion::geometry::Vector;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::truth::up_in_body;
use aplomb_recordings::simulated::samples;

use super::{Judged, seeds};
use crate::parallel;
use crate::recording::Recording;

/// Change of the temperature, °C in a minute and in all: indoors to a frosty day.
const CELSIUS_PER_MINUTE: f64 = 6.0;
const MOST_CELSIUS: f64 = 25.0;
/// Change of the offset, °/s per °C: the largest of the product specification, §6.1.
const DRIFT_DEGREES_S: f64 = 0.16;
/// Counts of the temperature per °C (register map §4.18).
const COUNTS_PER_CELSIUS: f64 = 340.0;
/// Jump of a register, °C, and its beginning, s.
const JUMP_CELSIUS: f64 = 20.0;
const JUMP_S: f64 = 100.0;
/// Directions of the drift, in sensor axes.
const AXES: [Vector; 4] = [
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [-0.6, -0.6, -0.52],
];
/// Length of the flights, s.
const FLIGHT_SECONDS: u64 = 240;

/// Temperatures of a sensor above that of its motion, °C.
struct Warmer {
    register: f64,
    die: f64,
}

/// Motion of a sensor: times, readings, and the true direction of up where it counts.
struct Motion {
    name: String,
    knowledge: AccelerometerKnowledge,
    rows: Vec<(u64, RawSample, Option<Vector>)>,
}

impl Motion {
    /// Simulates a flight of a sensor as it leaves the factory.
    fn flight(seed: u64) -> Self {
        let flown = samples(Box::new(Quadrotor::by_seed(seed)), seed, FLIGHT_SECONDS);
        let rows = flown.map(|simulated| {
            let truth = simulated.truth;
            let attitude = truth.attitude.filter(|_| truth.scored);
            (simulated.t_us, simulated.raw, attitude.map(up_in_body))
        });
        Self {
            name: format!("flight {seed}"),
            knowledge: AccelerometerKnowledge::Factory,
            rows: rows.collect(),
        }
    }

    /// Takes the motion of a recording in SI units.
    fn of(recording: &Recording) -> Self {
        let Settings { mount, sensor, .. } = Settings::new(&Part::MPU_6050);
        let per_m_s2 = sensor.accelerometer_range.counts_per_g() / STANDARD_GRAVITY_M_S2;
        let per_rad_s = sensor.gyroscope_range.counts_per_degree_s() / radians(1.0);
        let counts = |vector: Vector3, scale: f32| {
            let Vector3 { x, y, z } = mount.to_sensor(BodyVector(vector));
            [x, y, z].map(|value| (scale * value).round() as i16)
        };
        let rows = recording.samples.iter().zip(&recording.true_up);
        let rows = rows.map(|(sample, true_up)| {
            let mut raw = RawSample::default();
            raw.accelerometer.0 = counts(sample.specific_force_m_s2, per_m_s2);
            raw.gyroscope.0 = counts(sample.angular_rate_rad_s, per_rad_s);
            (sample.t_us, raw, *true_up)
        });
        Self {
            name: recording.name.clone(),
            knowledge: recording.accelerometer,
            rows: rows.collect(),
        }
    }

    /// Returns the time for which the attitude was wrong and `VALID`, ms, and the root mean square
    /// of its errors, degrees. The offset drifts in this direction with the die's temperature,
    /// which a function of the time in seconds gives.
    fn fly(
        &self,
        axis: Vector,
        model: Option<TemperatureModel>,
        warmer: impl Fn(f64) -> Warmer,
    ) -> (f64, f64) {
        let (first_us, last_us) = (self.rows[0].0, self.rows[self.rows.len() - 1].0);
        let period_us = (last_us - first_us) as f64 / (self.rows.len() - 1) as f64;
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.sensor.sample_rate_divider = (period_us / 1_000.0).round() as u8 - 1;
        let counts_per_degree_s = settings.sensor.gyroscope_range.counts_per_degree_s();
        settings.calibration.temperature = model;
        let mut pipeline = Pipeline::new(&settings);
        pipeline.set_accelerometer_knowledge(self.knowledge);
        let (mut wrong, mut squares, mut judged) = (0_u32, 0.0, 0_u32);
        for (t_us, raw, true_up) in &self.rows {
            let Warmer { register, die } = warmer((t_us - first_us) as f64 / 1.0e6);
            let drift = DRIFT_DEGREES_S * die * f64::from(counts_per_degree_s);
            let mut raw = *raw;
            raw.temperature.0 += (COUNTS_PER_CELSIUS * register) as i16;
            for (counts, share) in raw.gyroscope.0.iter_mut().zip(axis) {
                *counts = counts.saturating_add((share * drift).round() as i16);
            }
            let burst = Burst {
                bytes: raw.encode(),
                captured_at_us: *t_us,
                missed_before: 0,
            };
            let snapshot = pipeline.update(&burst, BoardFlags::SCALES_VERIFIED);
            if let Some(true_up) = *true_up {
                let result = Judged::new(&snapshot, true_up);
                wrong += u32::from(result.is_wrong);
                squares += result.error_deg * result.error_deg;
                judged += 1;
            }
        }
        assert!(judged > 0, "{}: no row with truth", self.name);
        let wrong_ms = f64::from(wrong) * period_us / 1_000.0;
        (wrong_ms, (squares / f64::from(judged)).sqrt())
    }
}

/// Returns the temperatures of a die that warms.
fn warming(seconds: f64) -> Warmer {
    let celsius = (CELSIUS_PER_MINUTE / 60.0 * seconds).min(MOST_CELSIUS);
    Warmer {
        register: celsius,
        die: celsius,
    }
}

/// Returns the model of a sensor whose offset drifts in this direction.
fn model(axis: Vector) -> TemperatureModel {
    let [x, y, z] = axis.map(|share| radians((share * DRIFT_DEGREES_S) as f32));
    TemperatureModel {
        reference_celsius: 35.0,
        offset_rad_s: Vector3::ZERO,
        slope_rad_s_per_celsius: Vector3::new(x, y, z),
        curvature_rad_s_per_celsius2: Vector3::ZERO,
        coldest_celsius: 10.0,
        warmest_celsius: 60.0,
    }
}

/// Eight flights.
static FLIGHTS: LazyLock<Vec<Motion>> = LazyLock::new(|| {
    let seeds = seeds(9_101..9_109);
    parallel::map(&seeds, |seed| Motion::flight(*seed))
});

/// Before the filter followed the temperature, 13 of these 88 motions were wrong and `VALID`, for
/// up to five seconds each, and the hand-held ones 2.4° off.
#[test]
fn an_offset_that_drifts_with_the_temperature_is_never_wrong_and_valid() {
    let fly = |motion: &Motion, axis| motion.fly(axis, None, warming);
    // The largest mean error, degrees.
    check("flights", &FLIGHTS, 3.2, fly);
    match crate::folders::recordings_of(&["broad"]) {
        None => println!("skipped: no recordings"),
        Some(recordings) => {
            let motions: Vec<Motion> = recordings.iter().map(Motion::of).collect();
            check("BROAD", &motions, 1.2, fly);
        }
    }
}

/// Before the filter told such a jump from a change of the die, 21 of 32 flights were wrong and
/// `VALID` with one of ten seconds.
#[test]
fn a_register_that_jumps_in_the_range_of_a_model_is_never_wrong_and_valid() {
    for (seconds, most_deg) in [(10.0, 1.7), (1_000.0, 2.1)] {
        let jumping = |time_s: f64| Warmer {
            register: if (0.0..seconds).contains(&(time_s - JUMP_S)) {
                JUMP_CELSIUS
            } else {
                0.0
            },
            die: 0.0,
        };
        let fly = |motion: &Motion, axis| motion.fly(axis, Some(model(axis)), jumping);
        check(&format!("jump of {seconds} s"), &FLIGHTS, most_deg, fly);
    }
}

fn check(
    set: &str,
    motions: &[Motion],
    most_deg: f64,
    fly: impl Fn(&Motion, Vector) -> (f64, f64) + Sync,
) {
    let outcomes = parallel::map(motions, |motion| AXES.map(|axis| fly(motion, axis)));
    for (motion, outcomes) in motions.iter().zip(&outcomes) {
        for (axis, (wrong_ms, _)) in AXES.iter().zip(outcomes) {
            assert_eq!(*wrong_ms, 0.0, "{set}, {} {axis:?}: ms", motion.name);
        }
    }
    let errors: Vec<f64> = outcomes.iter().flatten().map(|(_, deg)| *deg).collect();
    let mean_deg = errors.iter().sum::<f64>() / errors.len() as f64;
    println!("{set}: {} motions, error {mean_deg:.2}°", errors.len());
    assert!(mean_deg < most_deg, "{set}: {mean_deg} degrees");
}
