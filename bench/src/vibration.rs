//! Error of the filters against the strength and the frequency of vibration.
//!
//! The flights and hovers are simulated, with vibration on all axes of both sensors (see
//! `aplomb_models::motion::vibration`). The sensor is the modelled MPU-6050 at the firmware's
//! settings: converters at 8 kHz that clip at ±16 g and ±2000 °/s, the low-pass filter, and samples
//! at 1 kHz. It has noise and its rate error per g, but no offset and no error of scale. So the
//! errors are those of the vibration.

use std::fmt::Write as _;

use aplomb::units::STANDARD_GRAVITY_M_S2;
use aplomb_models::motion::Motion;
use aplomb_models::motion::quadrotor::{Flight, Quadrotor, REST_S};
use aplomb_models::motion::route::Route;
use aplomb_models::motion::vibration::{Strength, Vibrating};
use aplomb_models::sensor::SensorErrors;
use aplomb_recordings::simulated::samples_with;

use crate::filter::Choice;
use crate::parallel;
use crate::recording::Recording;
use crate::simulated::{EVALUATION_SEEDS, recording};

/// Strengths of the vibration, g root mean square on each axis.
const STRENGTHS_G: [f64; 7] = [0.0, 0.5, 1.0, 2.0, 4.0, 6.0, 8.0];
/// Frequencies of the fundamental, Hz.
const FREQUENCIES_HZ: [f64; 5] = [50.0, 100.0, 150.0, 200.0, 250.0];
/// Lever of the rocking, m: about that of a rotor's arm on a small vehicle.
const LEVER_M: f64 = 0.1;
/// Number of flights, and of hovers.
const SEEDS: usize = 4;
/// Length of a flight, s.
const SECONDS: u64 = 60;
const FILTERS: [Choice; 3] = [Choice::Kalman, Choice::Vqf, Choice::Madgwick];

/// Kind of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Flight,
    Hover,
}

/// One run.
#[derive(Clone, Copy, Debug)]
struct Case {
    kind: Kind,
    strength_g: f64,
    frequency_hz: f64,
    seed: u64,
}

/// Result of one run.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    /// Root mean square of each filter's inclination error, degrees.
    rms_deg: [f64; FILTERS.len()],
    /// Observables.
    step: f64,
    spread: f64,
    largest: f64,
    saturated: f64,
}

/// Returns the tables.
pub fn tables() -> String {
    let mut cases = Vec::new();
    for kind in [Kind::Flight, Kind::Hover] {
        for strength_g in STRENGTHS_G {
            for frequency_hz in FREQUENCIES_HZ {
                // Without vibration all frequencies are one.
                if strength_g == 0.0 && frequency_hz != FREQUENCIES_HZ[0] {
                    continue;
                }
                let seeds = EVALUATION_SEEDS.take(SEEDS);
                cases.extend(seeds.map(|seed| Case {
                    kind,
                    strength_g,
                    frequency_hz,
                    seed,
                }));
            }
        }
    }
    let outcomes = parallel::map_with_bar("shaking", &cases, |case| case.run());
    let mut text = String::new();
    for (cases, outcomes) in cases.chunks(SEEDS).zip(outcomes.chunks(SEEDS)) {
        let case = cases[0];
        let mean = |value: &dyn Fn(&Outcome) -> f64| {
            outcomes.iter().map(value).sum::<f64>() / outcomes.len() as f64
        };
        let _ = writeln!(
            text,
            "{:?} {:>4} {:>4}  {:6.2} {:6.2} {:6.2}   step {:6.2} spread {:6.2} largest {:6.1} sat {:.5}",
            case.kind,
            case.strength_g,
            case.frequency_hz,
            mean(&|o| o.rms_deg[0]),
            mean(&|o| o.rms_deg[1]),
            mean(&|o| o.rms_deg[2]),
            mean(&|o| o.step),
            mean(&|o| o.spread),
            mean(&|o| o.largest),
            mean(&|o| o.saturated)
        );
    }
    text
}

impl Case {
    fn run(self) -> Outcome {
        let recording = self.recording();
        let mut rms_deg = [0.0; FILTERS.len()];
        for (rms_deg, filter) in rms_deg.iter_mut().zip(FILTERS) {
            *rms_deg = recording.score(filter).map_or(f64::NAN, |score| score.rms);
        }
        let samples = &recording.samples[6_000..];
        let n = samples.len() as f64;
        let g = f64::from(STANDARD_GRAVITY_M_S2);
        let step = (samples
            .windows(2)
            .map(|p| {
                let d = p[1].specific_force_m_s2 - p[0].specific_force_m_s2;
                f64::from(d.dot(d))
            })
            .sum::<f64>()
            / n)
            .sqrt()
            / g;
        let spread = (samples
            .chunks(100)
            .map(|c| {
                let mut mean = aplomb::attitude::Vector3::ZERO;
                for s in c {
                    mean = mean + s.specific_force_m_s2.scale(1.0 / c.len() as f32);
                }
                c.iter()
                    .map(|s| {
                        let d = s.specific_force_m_s2 - mean;
                        f64::from(d.dot(d))
                    })
                    .sum::<f64>()
            })
            .sum::<f64>()
            / n)
            .sqrt()
            / g;
        let largest = samples
            .iter()
            .map(|s| {
                let f = s.specific_force_m_s2;
                f.x.abs().max(f.y.abs()).max(f.z.abs())
            })
            .fold(0.0, f32::max);
        let saturated = samples
            .iter()
            .filter(|s| s.is_force_saturated || s.is_rate_saturated)
            .count() as f64
            / n;
        Outcome {
            rms_deg,
            step,
            spread,
            largest: f64::from(largest) / g,
            saturated,
        }
    }

    fn recording(self) -> Recording {
        let mut flight = Flight::by_seed(self.seed);
        if self.kind == Kind::Hover {
            flight.route = Route::hover();
        }
        let strength = Strength {
            force_rms_m_s2: self.strength_g * f64::from(STANDARD_GRAVITY_M_S2),
            frequency_hz: self.frequency_hz,
            lever_m: LEVER_M,
            start_s: REST_S,
            growth_s: 1.0,
        };
        let motion: Box<dyn Motion> =
            Box::new(Vibrating::new(Quadrotor::new(flight), strength, self.seed));
        let mut errors = SensorErrors::none();
        let typical = SensorErrors::typical(self.seed);
        errors.accelerometer.noise_density = typical.accelerometer.noise_density;
        errors.gyroscope.noise_density = typical.gyroscope.noise_density;
        errors.rate_per_specific_force = typical.rate_per_specific_force;
        let name = format!("{self:?}");
        recording(
            "vibration",
            name,
            samples_with(motion, self.seed, errors, SECONDS),
        )
    }
}
