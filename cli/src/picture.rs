//! The README's picture: the default filter, VQF and the classic one through a simulated flight.

use aplomb::estimator::FilterKind;
use embedded_graphics::mono_font::MonoFont;
use embedded_graphics::mono_font::iso_8859_1::{FONT_9X15, FONT_10X20};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::Alignment;
use virtual_board::motion::geometry::angle_between;

use crate::filter::{Choice, Filter, up_in_body};
use crate::plot::Canvas;
use crate::recording::Recording;
use crate::simulated::FIRST_EVALUATION_SEED;

/// The flight that is drawn: the first of those that nothing was tuned on.
pub const SEED: u64 = FIRST_EVALUATION_SEED;

/// The best last, so that no other covers it. Colours differ for the colour-blind too (Okabe and Ito, 2008).
const FILTERS: [(Choice, &str, Rgb888); 3] = [
    (
        Choice::Library(FilterKind::Classic),
        "classic",
        Rgb888::new(230, 159, 0),
    ),
    (Choice::Vqf, "VQF", Rgb888::new(0, 114, 178)),
    (
        Choice::Library(FilterKind::Kalman),
        "aplomb",
        Rgb888::new(213, 30, 60),
    ),
];

const WIDTH: i32 = 1000;
const LEFT: i32 = 60;
const RIGHT: i32 = WIDTH - 20;
/// Curves are drawn this much larger and then averaged down, which smooths them.
const SCALE: i32 = 3;
/// One point in so many samples is drawn.
const STRIDE: usize = 25;
const TRUTH: Rgb888 = Rgb888::new(170, 170, 170);
const TEXT: Rgb888 = Rgb888::new(40, 40, 40);
const FAINT: Rgb888 = Rgb888::new(225, 225, 225);

/// A panel's place in the picture, and what its edges stand for.
struct Panel {
    name: &'static str,
    top: i32,
    bottom: i32,
    /// Degrees.
    low: f64,
    high: f64,
    grid: f64,
    seconds: f64,
}

/// What a filter or the truth says at one time: roll, pitch and error in degrees, where there is a truth.
type Row = (f64, [f64; 3]);

/// The picture as a PNG file.
pub fn flight(recording: &Recording) -> Result<Vec<u8>, png::EncodingError> {
    let seconds = recording
        .samples
        .last()
        .map_or(1.0, |last| last.t_us as f64 * 1e-6);
    let panel = |name, top, bottom, (low, high), grid| Panel {
        name,
        top,
        bottom,
        low,
        high,
        grid,
        seconds,
    };
    let truth = truth(recording);
    let runs = FILTERS.map(|(choice, _, colour)| (run(recording, choice), colour));
    let all = || runs.iter().flat_map(|(rows, _)| rows).chain(&truth);
    let range = |of: usize| {
        let values = all().map(|(_, values)| values[of]);
        let (low, high) = values.fold((0.0_f64, 0.0_f64), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        ((low / 10.0).floor() * 10.0, (high / 10.0).ceil() * 10.0)
    };
    let panels = [
        panel("roll in degrees", 88, 238, range(0), 20.0),
        panel("pitch in degrees", 286, 436, range(1), 20.0),
        panel("inclination error in degrees", 484, 664, range(2), 10.0),
    ];
    let mut large = Canvas::new(WIDTH * SCALE, 712 * SCALE);
    for (index, panel) in panels.iter().enumerate() {
        panel.grid(&mut large);
        if index < 2 {
            panel.curve(&mut large, &truth, index, TRUTH, 4.0);
        }
        for (rows, colour) in &runs {
            panel.curve(&mut large, rows, index, *colour, 1.6);
        }
    }
    let mut canvas = large.reduced(SCALE.unsigned_abs());
    for panel in &panels {
        panel.annotate(&mut canvas);
    }
    let title = format!(
        "Simulated {}: manoeuvres of up to 1 g, gyroscope offset 4 °/s, not calibrated",
        recording.name
    );
    say(&mut canvas, &title, LEFT, 24, &FONT_10X20, TEXT);
    let mut x = LEFT;
    for (choice, name, colour) in FILTERS.into_iter().rev() {
        let filter = Filter::new(choice, recording.step_s(), recording.delay_us);
        let rms = recording.rms(filter);
        x = legend(&mut canvas, &format!("{name}, {rms:.1}° rms"), x, colour);
    }
    legend(&mut canvas, "truth", x, TRUTH);
    canvas.png()
}

/// Writes what a colour means, and says where the next may stand.
fn legend(canvas: &mut Canvas, text: &str, x: i32, colour: Rgb888) -> i32 {
    canvas.line(Point::new(x, 47), Point::new(x + 24, 47), colour, 4);
    say(canvas, text, x + 32, 53, &FONT_10X20, TEXT);
    x + 32 + 10 * text.chars().count() as i32 + 36
}

fn say(canvas: &mut Canvas, text: &str, x: i32, y: i32, font: &MonoFont<'_>, colour: Rgb888) {
    canvas.text(text, Point::new(x, y), Alignment::Left, font, colour);
}

impl Panel {
    fn x(&self, time_s: f64) -> f64 {
        f64::from(LEFT) + time_s / self.seconds * f64::from(RIGHT - LEFT)
    }

    fn y(&self, degrees: f64) -> f64 {
        let share = (degrees - self.low) / (self.high - self.low);
        f64::from(self.bottom) - share * f64::from(self.bottom - self.top)
    }

    /// The values to which there are lines.
    fn marks(&self) -> impl Iterator<Item = f64> {
        let (first, last) = (
            (self.low / self.grid).ceil(),
            (self.high / self.grid).floor(),
        );
        (first as i32..=last as i32).map(|nth| f64::from(nth) * self.grid)
    }

    fn grid(&self, large: &mut Canvas) {
        for degrees in self.marks() {
            let (start, end) = ((0.0, degrees), (self.seconds, degrees));
            self.line(large, start, end, FAINT, 1.0);
        }
        for tens in 0..=(self.seconds / 10.0) as i32 {
            let time_s = f64::from(tens) * 10.0;
            self.line(large, (time_s, self.low), (time_s, self.high), FAINT, 1.0);
        }
    }

    /// Draws column `of` of the rows, with gaps where an angle wraps or nothing is known.
    fn curve(&self, large: &mut Canvas, rows: &[Row], of: usize, colour: Rgb888, width: f64) {
        for pair in rows.windows(2) {
            let [(start_s, start), (end_s, end)] = pair else {
                continue;
            };
            let is_near = (end[of] - start[of]).abs() < 180.0 && end_s - start_s < 1.0;
            if is_near {
                let (start, end) = ((*start_s, start[of]), (*end_s, end[of]));
                self.line(large, start, end, colour, width);
            }
        }
    }

    fn line(
        &self,
        large: &mut Canvas,
        start: (f64, f64),
        end: (f64, f64),
        colour: Rgb888,
        width: f64,
    ) {
        let scale = f64::from(SCALE);
        let point = |(time_s, degrees): (f64, f64)| {
            let (x, y) = (self.x(time_s) * scale, self.y(degrees) * scale);
            Point::new(x.round() as i32, y.round() as i32)
        };
        large.line(point(start), point(end), colour, (width * scale) as u32);
    }

    fn annotate(&self, canvas: &mut Canvas) {
        say(canvas, self.name, LEFT, self.top - 8, &FONT_10X20, TEXT);
        for degrees in self.marks() {
            let at = Point::new(LEFT - 8, self.y(degrees).round() as i32 + 5);
            canvas.text(&degrees.to_string(), at, Alignment::Right, &FONT_9X15, TEXT);
        }
        for tens in 0..=(self.seconds / 10.0) as i32 {
            let time_s = f64::from(tens) * 10.0;
            let at = Point::new(self.x(time_s).round() as i32, self.bottom + 16);
            let unit = if tens == 0 { " s" } else { "" };
            canvas.text(
                &format!("{time_s}{unit}"),
                at,
                Alignment::Center,
                &FONT_9X15,
                TEXT,
            );
        }
    }
}

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

/// Roll and pitch of a body that has its "up" there, and the angle to the true "up", in degrees.
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
        let picture = flight(&simulated::flight(SEED)).unwrap();
        assert!(picture.starts_with(b"\x89PNG"));
        assert!(picture.len() < 200 * 1024, "{} bytes", picture.len());
    }
}
