//! The promise of a valid heading in simulated flights: with hard and soft iron, motor currents,
//! and a magnet that passes while the vehicle starts.
//!
//! The library's pipeline gets what a sensor would measure. Nothing of its own judges it.

use aplomb::attitude::{BodyVector, Quaternion as Attitude, Vector3};
use aplomb::estimator::Sample;
use aplomb::estimator::heading::{CompassKnowledge, HeadingEstimate};
use aplomb::health::Flags;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{CompassPipeline, Settings, Snapshot};
use aplomb::units::MagneticField;
use aplomb_models::compass::field::PassingMagnet;
use aplomb_models::compass::{EarthField, Magnetism};
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::{Motion, Quaternion, Vector, heading_error_rad};
use aplomb_models::random::Random;
use aplomb_models::sensor::SensorErrors;

const FLIGHTS: u64 = 48;
const SECONDS: u64 = 20;
/// Time between two readings, and their age, in samples of 1 ms.
const READING_SAMPLES: u64 = 20;
const AGE_SAMPLES: u64 = 9;
/// Temperature of the chip, °C.
const CHIP_C: f64 = 35.0;

/// A flight with its magnetism.
struct Flight {
    motion: Quadrotor,
    errors: SensorErrors,
    magnetism: Magnetism,
    random: Random,
    pipeline: CompassPipeline,
    is_calibrated: bool,
}

/// Errors of the valid headings of a flight.
#[derive(Debug, Default)]
struct Figures {
    samples: u64,
    valid: u64,
    worst_deg: f64,
}

impl Flight {
    fn new(seed: u64, is_calibrated: bool) -> Self {
        let mut random = Random::new(seed, "heading flights");
        let (_, earth) = EarthField::PLACES[seed as usize % 6];
        let mut magnetism = Magnetism {
            earth,
            ..Magnetism::typical(seed)
        };
        let mut vector = |size: f64| [0; 3].map(|_| size * random.normal());
        if seed % 3 == 1 {
            magnetism.motors_ut = vector(4.0);
        }
        if seed % 3 == 2 {
            let [x, y, z] = vector(0.5);
            magnetism.magnet = Some(PassingMagnet {
                closest_s: 3.0 + x.abs() * 6.0,
                stands: false,
                closest_m: [0.3 + y.abs(), 0.2, z],
                velocity_m_s: vector(0.5),
                moment_a_m2: vector(1.0),
            });
        }
        let knowledge = if is_calibrated {
            CompassKnowledge::Calibrated
        } else {
            CompassKnowledge::Factory
        };
        let settings = Settings {
            sensor_delay_us: Some(0),
            ..Settings::new(&Part::MPU_6050)
        };
        Self {
            motion: Quadrotor::by_seed(seed),
            errors: SensorErrors::typical(seed),
            magnetism,
            random,
            pipeline: CompassPipeline::new(&settings, knowledge),
            is_calibrated,
        }
    }

    /// The reading of a field, which a calibration corrects exactly.
    fn reading(&mut self, field: Vector) -> MagneticField {
        let noise = [0; 3].map(|_| 0.6 * self.random.normal());
        let mut reading = [0, 1, 2].map(|axis| field[axis] + noise[axis]);
        if self.is_calibrated {
            let iron = self.magnetism.hard_iron_ut;
            let clean = [0, 1, 2].map(|axis| reading[axis] - iron[axis]);
            reading = solve(self.magnetism.soft_iron, clean);
        }
        MagneticField {
            ut: reading.map(|part| part as f32),
        }
    }

    fn fly(&mut self, seed: u64) -> Figures {
        let mut figures = Figures::default();
        let mut waiting = None;
        for index in 1..=1_000 * SECONDS {
            let time_s = index as f64 * 1e-3;
            let truth = self.motion.at(time_s);
            let force = self
                .errors
                .distort_specific_force(truth.specific_force_m_s2, CHIP_C);
            let rates = self.errors.distort_rates(
                truth.body_rates_rad_s,
                truth.specific_force_m_s2,
                CHIP_C,
                time_s,
            );
            let vector = |vector: Vector, noise: Vector| {
                let [x, y, z] = [0, 1, 2].map(|axis| (vector[axis] + noise[axis]) as f32);
                BodyVector(Vector3::new(x, y, z))
            };
            let noise = [0; 6].map(|_| self.random.normal());
            let sample = Sample::new(
                1_000 * index,
                vector(force, [noise[0], noise[1], noise[2]].map(|it| 0.05 * it)),
                vector(rates, [noise[3], noise[4], noise[5]].map(|it| 1.5e-3 * it)),
            );
            let snapshot = self.pipeline.update_sample(&sample);
            if index % READING_SAMPLES == 0 {
                let field = self.magnetism.at(time_s, &truth);
                waiting = Some((index + AGE_SAMPLES, self.reading(field)));
            }
            if let Some((_, field)) = waiting.take_if(|(due, _)| *due == index) {
                self.pipeline
                    .update_field(field, 1_000 * AGE_SAMPLES as u32);
            }
            figures.samples += 1;
            if snapshot.flags.contains(Flags::HEADING_VALID)
                && let (Some(heading), Some(truth)) = (self.pipeline.heading(), truth.attitude)
            {
                figures.valid += 1;
                let error_deg = heading_error_deg(&snapshot, &heading, truth);
                let sigma_deg = f64::from(heading.sigma_rad).to_degrees();
                figures.worst_deg = figures.worst_deg.max(error_deg);
                assert!(
                    error_deg <= (6.0 * sigma_deg).max(15.0),
                    "flight {seed} at {time_s} s: {error_deg} degrees, sigma {sigma_deg}"
                );
            }
        }
        figures
    }
}

/// Solves m·x = v by Cramer's rule.
fn solve(m: [Vector; 3], v: Vector) -> Vector {
    let determinant = |[a, b, c]: [Vector; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    [0, 1, 2].map(|column| {
        let mut replaced = m;
        for (row, value) in replaced.iter_mut().zip(v) {
            row[column] = value;
        }
        determinant(replaced) / determinant(m)
    })
}

/// The size of the error of a heading, degrees.
fn heading_error_deg(snapshot: &Snapshot, heading: &HeadingEstimate, truth: Quaternion) -> f64 {
    let Attitude { w, x, y, z } = snapshot.attitude;
    let estimate = Quaternion::new(w.into(), x.into(), y.into(), z.into());
    let to_north = [0.0, 0.0, f64::from(heading.yaw_offset_rad)];
    let absolute = Quaternion::from_rotation_vector(to_north).multiply(estimate);
    heading_error_rad(absolute, truth).to_degrees().abs()
}

/// Prints how often the heading is valid, and its largest error.
#[test]
fn a_valid_heading_is_never_wrong() {
    for (name, is_calibrated, least_share) in [("calibrated", true, 0.5), ("factory", false, 0.2)] {
        let mut all = Figures::default();
        for seed in 0..FLIGHTS {
            let figures = Flight::new(seed, is_calibrated).fly(seed);
            all.samples += figures.samples;
            all.valid += figures.valid;
            all.worst_deg = all.worst_deg.max(figures.worst_deg);
        }
        let share = all.valid as f64 / all.samples as f64;
        println!(
            "{name}: valid {share:.3}, at most {:.1} degrees wrong",
            all.worst_deg
        );
        assert!(share > least_share, "{name}: {share}");
    }
}
