//! Picture of the README: the default filter, VQF and the classic one through a simulated flight.

use aplomb_models::motion::geometry::angle_between;
use aplomb_plot::chart::{Chart, Curve, Panel, TRUTH};
use aplomb_plot::picture::{Color, Picture};
use aplomb_plot::timeline::Trace;
use aplomb_recordings::attitude::up_in_body;

use crate::filter::{Choice, Filter};
use crate::recording::Recording;
use crate::simulated::FIRST_EVALUATION_SEED;

/// Seed of the flight: the first beyond those of the tuning.
pub const SEED: u64 = FIRST_EVALUATION_SEED;

/// Filters with their colours, the best last, so that no other covers it. The colours also differ
/// for the colour-blind (Okabe and Ito, 2008).
const FILTERS: [(Choice, &str, Color); 3] = [
    (Choice::Classic, "classic", Color(230, 159, 0)),
    (Choice::Vqf, "VQF", Color(0, 114, 178)),
    (Choice::Kalman, "aplomb", Color(213, 30, 60)),
];

const SIZE: (u32, u32) = (1200, 900);
/// Samples from one drawn point to the next.
const STRIDE: usize = 25;

/// Time in s, with roll, pitch and error of a filter or the truth in degrees.
type Row = (f64, [f64; 3]);

/// Draws the picture.
pub fn flight(recording: &Recording) -> Picture {
    let truth = truth(recording);
    let runs = FILTERS.map(|(choice, _, color)| (run(recording, choice), color));
    let panel = |name: &str, of: usize| {
        let trace = |rows: &[Row]| Trace::through(rows.iter().map(|(at_s, row)| (*at_s, row[of])));
        let traces = runs.each_ref().map(|(rows, color)| (trace(rows), *color));
        let curves = traces.iter().map(|(trace, color)| (*color, "", trace));
        let mut panel = Panel::around(&format!("{name} (degrees)"), 20.0, curves.collect());
        if name == ERROR {
            panel.range.0 = 0.0;
        } else {
            let truth = Curve::new(TRUTH, "", &trace(&truth));
            panel.curves.insert(0, truth);
        }
        panel
    };
    let filters = FILTERS.into_iter().rev().map(|(choice, name, color)| {
        let filter = Filter::new(choice, recording.step_s(), recording.delay_us);
        let rms = recording.rms(filter);
        (color, format!("{name}, {rms:.1}° rms"))
    });
    let last_us = recording.samples.last().map_or(1, |last| last.t_us);
    let chart = Chart {
        width: SIZE.0,
        height: SIZE.1,
        title: format!(
            "Simulated {}: manoeuvres of up to 1 g, gyroscope offset 4 °/s, not calibrated",
            recording.name
        ),
        subtitle: String::new(),
        legend: filters.chain([(TRUTH, "truth".to_owned())]).collect(),
        time_s: (0.0, last_us as f64 * 1e-6),
        time_name: "time (s)",
        panels: vec![panel("roll", 0), panel("pitch", 1), panel(ERROR, 2)],
        shades: Vec::new(),
        lanes: Vec::new(),
        others: Vec::new(),
    };
    chart.draw()
}

const ERROR: &str = "inclination error";

fn truth(recording: &Recording) -> Vec<Row> {
    let rows = recording.samples.iter().zip(&recording.true_up);
    rows.step_by(STRIDE)
        .filter_map(|(sample, up)| Some((sample.t_us as f64 * 1e-6, values((*up)?, (*up)?))))
        .collect()
}

fn run(recording: &Recording, choice: Choice) -> Vec<Row> {
    let mut filter = Filter::new(choice, recording.step_s(), recording.delay_us);
    let rows = recording.samples.iter().zip(&recording.true_up);
    rows.enumerate()
        .filter_map(|(index, (sample, true_up))| {
            let up = up_in_body(filter.update(sample).attitude);
            let is_drawn = index.is_multiple_of(STRIDE);
            let true_up = true_up.filter(|_| is_drawn)?;
            let estimated = [up.x, up.y, up.z].map(f64::from);
            Some((sample.t_us as f64 * 1e-6, values(estimated, true_up)))
        })
        .collect()
}

/// Returns roll and pitch of a body with this "up", and the angle to the true "up", degrees.
fn values(up: [f64; 3], true_up: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = up;
    let (roll, pitch) = ((-y).atan2(-z), x.clamp(-1.0, 1.0).asin());
    [roll, pitch, angle_between(up, true_up)].map(f64::to_degrees)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated;

    #[test]
    fn roll_and_pitch_are_those_of_up() {
        let up = up_in_body(aplomb::attitude::Quaternion::from_euler(
            aplomb::attitude::EulerAngles {
                roll_rad: 0.5,
                pitch_rad: -0.3,
                yaw_rad: 2.0,
            },
        ));
        let up = [up.x, up.y, up.z].map(f64::from);
        let [roll, pitch, error] = values(up, [0.0, 0.0, -1.0]);
        assert!((roll - 0.5_f64.to_degrees()).abs() < 1e-4);
        assert!((pitch + 0.3_f64.to_degrees()).abs() < 1e-4);
        let expected = (0.5_f64.cos() * 0.3_f64.cos()).acos().to_degrees();
        assert!((error - expected).abs() < 1e-4);
    }

    #[test]
    fn the_picture_is_one_and_small() {
        let picture = flight(&simulated::flight(SEED)).png();
        assert!(picture.starts_with(b"\x89PNG"));
        assert!(picture.len() < 200 * 1024, "{} bytes", picture.len());
    }
}
