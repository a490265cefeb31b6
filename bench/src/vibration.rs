//! Error of the filters against the strength and the frequency of vibration.
//!
//! The flights and hovers are simulated, with vibration on all axes of both sensors (see
//! `aplomb_models::motion::vibration`). The sensor is the modelled MPU-6050 at the firmware's
//! settings: converters at 8 kHz that clip at ±16 g and ±2000 °/s, the low-pass filter, and
//! samples at 1 kHz. It has noise and its rate error per g, but no offset and no error of scale.
//! So the errors are those of the vibration.

use std::fmt::Write as _;

use aplomb::units::STANDARD_GRAVITY_M_S2;
use aplomb_models::motion::Motion;
use aplomb_models::motion::quadrotor::{Flight, Quadrotor, REST_S};
use aplomb_models::motion::route::Route;
use aplomb_models::motion::vibration::{Strength, Vibrating};
use aplomb_models::sensor::SensorErrors;
use aplomb_recordings::simulated::samples_with;
use aplomb_recordings::vibration::LIMIT_G;

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
#[derive(Clone, Copy, Debug, PartialEq)]
struct Outcome {
    /// Root mean square of each filter's inclination error, degrees.
    rms_deg: [f64; FILTERS.len()],
    /// The vibration counts as too strong.
    is_too_strong: bool,
}

/// Returns the tables, one for flights and one for hovers.
pub fn tables() -> String {
    let mut text = format!(
        "Inclination error in degrees, {} / {} / {}: root mean square of each run of {SECONDS} s \
         after 5 s, mean of seeds {} to {}.\n*: reported as too strong, above {LIMIT_G} g.\n",
        FILTERS[0].name(),
        FILTERS[1].name(),
        FILTERS[2].name(),
        EVALUATION_SEEDS.start,
        EVALUATION_SEEDS.start + SEEDS as u64 - 1,
    );
    for kind in [Kind::Flight, Kind::Hover] {
        let name = match kind {
            Kind::Flight => "flight",
            Kind::Hover => "hover",
        };
        let _ = write!(text, "\n| {name}: g rms per axis |");
        for frequency_hz in FREQUENCIES_HZ {
            let _ = write!(text, " {frequency_hz} Hz |");
        }
        let _ = writeln!(text, "\n|---|{}", "---|".repeat(FREQUENCIES_HZ.len()));
        for strength_g in STRENGTHS_G {
            let _ = write!(text, "| {strength_g} |");
            for cell in row(kind, strength_g) {
                let _ = write!(text, " {cell} |");
            }
            text.push('\n');
        }
    }
    text
}

/// Returns the cells of one strength, one for each frequency.
fn row(kind: Kind, strength_g: f64) -> Vec<String> {
    let mut cases = Vec::new();
    for frequency_hz in FREQUENCIES_HZ {
        let seeds = EVALUATION_SEEDS.take(SEEDS);
        cases.extend(seeds.map(|seed| Case {
            kind,
            strength_g,
            frequency_hz,
            seed,
        }));
    }
    if strength_g == 0.0 {
        // Without vibration all frequencies are one.
        cases.truncate(SEEDS);
    }
    let outcomes = parallel::map_with_bar("shaking", &cases, |case| case.run(SECONDS));
    let mut cells: Vec<String> = outcomes.chunks(SEEDS).map(cell).collect();
    cells.resize(FREQUENCIES_HZ.len(), String::new());
    cells
}

fn cell(outcomes: &[Outcome]) -> String {
    let mean = |index: usize| {
        let sum: f64 = outcomes.iter().map(|outcome| outcome.rms_deg[index]).sum();
        format!("{:.2}", sum / outcomes.len() as f64)
    };
    let is_too_strong = outcomes.iter().any(|outcome| outcome.is_too_strong);
    let mark = if is_too_strong { " *" } else { "" };
    format!("{} / {} / {}{mark}", mean(0), mean(1), mean(2))
}

impl Case {
    fn run(self, seconds: u64) -> Outcome {
        let recording = self.recording(seconds);
        Outcome {
            rms_deg: FILTERS
                .map(|filter| recording.score(filter).map_or(f64::NAN, |score| score.rms)),
            is_too_strong: recording.vibration().message().is_some(),
        }
    }

    fn recording(self, seconds: u64) -> Recording {
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
            samples_with(motion, self.seed, errors, seconds),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_vibration_that_harms_is_reported() {
        let hover = |strength_g, frequency_hz| {
            let case = Case {
                kind: Kind::Hover,
                strength_g,
                frequency_hz,
                seed: 1_000,
            };
            case.run(25)
        };
        let harmless = [(0.0, 100.0), (2.0, 50.0), (4.0, 100.0), (2.0, 250.0)];
        for (strength_g, frequency_hz) in harmless {
            let outcome = hover(strength_g, frequency_hz);
            assert!(outcome.rms_deg[0] < 0.4, "{outcome:?}");
            assert!(!outcome.is_too_strong, "{outcome:?}");
        }
        let outcome = hover(10.0, 50.0);
        assert!(outcome.rms_deg[0] > 1.5, "{outcome:?}");
        assert!(outcome.is_too_strong, "{outcome:?}");
    }
}
