//! Picture of the README: the heading through a disturbance, the library's and VQF's.

use aplomb::attitude::Quaternion;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb_models::compass::{Magnetism, PassingMagnet};
use aplomb_models::motion::geometry::{Vector, norm, scale};
use aplomb_plot::chart::{Chart, FIRST, FRAME, Panel, SHADE, Shade};
use aplomb_plot::picture::{Color, Picture};
use aplomb_plot::timeline::Trace;
use aplomb_recordings::heading::error_deg;
use aplomb_recordings::simulated::errors;

use crate::heading;
use crate::marg::Choice;
use crate::recording::Recording;
use crate::simulated;

/// Seed of the flight: the first beyond those of the tuning.
const SEED: u64 = simulated::FIRST_EVALUATION_SEED;
const SIZE: (u32, u32) = (1200, 640);
/// Samples from one drawn point to the next.
const STRIDE: usize = 25;
const OURS: Color = Color(213, 30, 60);
/// Field of the magnet from which on its time is shaded, µT.
const VISIBLE_UT: f64 = 3.0;
/// Hard iron of 8 µT, as from a screw or a battery: the compass was not calibrated.
const HARD_IRON_UT: Vector = [3.0, 6.2, -4.0];
/// Field of the motors in a hover, µT.
const MOTORS_UT: f64 = 3.0;

/// Share of the usual offset of the gyroscope that is left, as after a calibration: VQF's
/// corrections reach 2 °/s.
const OFFSET_SHARE: f64 = 0.1;

/// A magnet of 2 A·m² that passes below the compass, 25 cm away and slowly.
const MAGNET: PassingMagnet = PassingMagnet {
    closest_s: 30.0,
    stands: false,
    closest_m: [0.1, 0.0, 0.23],
    velocity_m_s: [0.0, 0.08, 0.0],
    moment_a_m2: [0.0, 1.6, 1.2],
};

/// Simulates the flight.
pub fn flight() -> Recording {
    let magnetism = Magnetism {
        magnet: Some(MAGNET),
        hard_iron_ut: HARD_IRON_UT,
        ..Magnetism::calibrated(SEED).with_motors(SEED, MOTORS_UT)
    };
    let mut errors = errors(SEED, AccelerometerKnowledge::Factory);
    errors.gyroscope.offset = scale(errors.gyroscope.offset, OFFSET_SHARE);
    simulated::flight_with_compass(SEED, errors, magnetism, CompassKnowledge::Factory)
}

/// Time in s with the error of a heading in degrees.
type Row = (f64, f64);

/// Draws the picture.
pub fn draw(recording: &Recording) -> Picture {
    let runs = [
        (vqf_errors(recording), FIRST, "VQF 9D"),
        (our_errors(recording), OURS, "aplomb"),
    ];
    let traces = runs.each_ref().map(|(rows, color, _)| {
        let drawn = rows.iter().step_by(STRIDE);
        (Trace::through(drawn.copied()), *color)
    });
    let strengths = Trace::through(strengths(recording));
    let errors = traces.iter().map(|(trace, color)| (*color, "", trace));
    let strength = vec![(FRAME, "", &strengths)];
    let legend = runs.iter().rev().map(|(rows, color, name)| {
        let squares: f64 = rows.iter().map(|(_, error)| error * error).sum();
        let rms = (squares / rows.len().max(1) as f64).sqrt();
        (*color, format!("{name}, {rms:.1}° rms"))
    });
    let end_s = recording
        .samples
        .last()
        .map_or(1.0, |last| last.t_us as f64 * 1e-6);
    Chart {
        width: SIZE.0,
        height: SIZE.1,
        title: "Simulated flight: 8 µT of hard iron, 3 µT of motor currents, and a passing magnet"
            .to_owned(),
        subtitle: String::new(),
        legend: legend.collect(),
        time_s: (0.0, end_s),
        time_name: "time (s)",
        panels: vec![
            Panel::around("error of the heading (degrees)", 20.0, errors.collect()),
            Panel::around("measured field's strength (µT)", 20.0, strength),
        ],
        shades: vec![Shade {
            span_s: disturbed_s(),
            color: SHADE,
            name: "magnet".to_owned(),
        }],
        lanes: Vec::new(),
        others: Vec::new(),
    }
    .draw()
}

fn our_errors(recording: &Recording) -> Vec<Row> {
    let mut rows = Vec::new();
    heading::run(recording, |index, heading| {
        let row = heading.and_then(|(attitude, _)| row(recording, index, attitude));
        rows.extend(row);
    });
    rows
}

fn vqf_errors(recording: &Recording) -> Vec<Row> {
    let mut rows = Vec::new();
    heading::run_peer(Choice::Vqf, recording, |index, attitude| {
        rows.extend(row(recording, index, attitude));
    });
    rows
}

/// Returns the row of an absolute attitude, if its truth counts.
fn row(recording: &Recording, index: usize, attitude: Quaternion) -> Option<Row> {
    let truth = heading::truth_at(recording, index)?;
    let compass = recording.compass.as_ref()?;
    let error = error_deg(attitude, truth, compass.mount);
    Some((recording.samples.get(index)?.t_us as f64 * 1e-6, error))
}

/// Returns the strength of each reading.
fn strengths(recording: &Recording) -> impl Iterator<Item = Row> {
    let fields = recording.compass.iter().flat_map(|compass| &compass.fields);
    let rows = recording.samples.iter().zip(fields);
    rows.filter_map(|(sample, field)| {
        let [x, y, z] = field.as_ref()?.ut.map(f64::from);
        Some((sample.t_us as f64 * 1e-6, (x * x + y * y + z * z).sqrt()))
    })
}

/// Returns the time in which the magnet's field is visible, s.
fn disturbed_s() -> (f64, f64) {
    let is_visible = |at_s: &f64| norm(MAGNET.field_ut(*at_s)) > VISIBLE_UT;
    let times = (0..6_000)
        .map(|index| f64::from(index) * 0.01)
        .filter(is_visible);
    let (mut start_s, mut end_s) = (f64::INFINITY, f64::NEG_INFINITY);
    for at_s in times {
        start_s = start_s.min(at_s);
        end_s = end_s.max(at_s);
    }
    (start_s, end_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_magnet_disturbs_for_seconds_and_the_picture_is_small() {
        let (start_s, end_s) = disturbed_s();
        assert!(
            end_s - start_s > 3.0 && start_s > 20.0 && end_s < 40.0,
            "{start_s} {end_s}"
        );
        let recording = flight();
        // Magnetic north is the truth's, so both headings are right before the magnet.
        for rows in [our_errors(&recording), vqf_errors(&recording)] {
            let before: Vec<f64> = rows
                .iter()
                .filter(|row| row.0 < start_s)
                .map(|row| row.1.abs())
                .collect();
            let mean = before.iter().sum::<f64>() / before.len() as f64;
            assert!(mean < 10.0, "{mean}");
        }
        let picture = draw(&recording).png();
        assert!(picture.starts_with(b"\x89PNG") && picture.len() < 200 * 1024);
    }
}
