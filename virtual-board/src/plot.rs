//! `attitude.png`: roll, pitch and yaw against the truth, and the inclination error, over time. In a flight with faults
//! these are shaded and named, and a row for each flag shows when it was set.
//!
//! Curves are drawn three times as large and averaged down, which smooths them; letters are drawn afterwards, sharp.

use std::io::{self, Write};

use aplomb::health::Flags;
use embedded_graphics::Drawable;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::ascii::{FONT_6X12, FONT_9X18, FONT_9X18_BOLD, FONT_10X20};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use embedded_graphics::prelude::Pixel;
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};

use crate::flight::Outcome;
use crate::motion::Quaternion;
use crate::recorder::Sample;
use crate::summary::inclination_deg;

/// The picture, in pixels.
const WIDTH: usize = 1600;
const HEIGHT: usize = 1280;
/// How much larger the curves are drawn.
const SCALE: usize = 3;

/// Where the panels are, in pixels.
const LEFT: usize = 110;
const RIGHT: usize = 1575;
const TOP: usize = 104;
const BOTTOM: usize = 1215;
const GAP: usize = 42;

/// The height of a flag's row, in pixels.
const ROW: usize = 17;
/// The narrowest shade of a fault, in pixels of the large picture.
const NARROWEST: f64 = 6.0;

/// Half a curve's width, in pixels.
const HALF_STROKE: f64 = 1.0;

/// A change of angle from one sample to the next that means that it wrapped, in degrees.
const WRAP_DEG: f64 = 180.0;

const BACKGROUND: Rgb888 = Rgb888::new(255, 255, 255);
const SHADE: Rgb888 = Rgb888::new(238, 240, 244);
const FAULT_SHADE: Rgb888 = Rgb888::new(255, 222, 214);
const FAULT_INK: Rgb888 = Rgb888::new(165, 50, 20);
const GRID: Rgb888 = Rgb888::new(218, 221, 226);
const FRAME: Rgb888 = Rgb888::new(110, 116, 126);
const INK: Rgb888 = Rgb888::new(30, 34, 42);
const TRUTH: Rgb888 = Rgb888::new(150, 156, 166);
const ROLL: Rgb888 = Rgb888::new(0, 101, 189);
const PITCH: Rgb888 = Rgb888::new(0, 135, 90);
const YAW: Rgb888 = Rgb888::new(176, 84, 0);
const ERROR: Rgb888 = Rgb888::new(190, 30, 60);

/// What the picture says about the flight.
#[derive(Clone, Debug)]
pub struct Labels {
    /// The first line, for instance the board and the motion.
    pub title: String,
    /// The second line, for instance the figures.
    pub subtitle: String,
}

/// A curve: times in seconds and values.
struct Curve {
    color: Rgb888,
    points: Vec<(f64, f64)>,
}

struct Panel {
    name: &'static str,
    unit: &'static str,
    curves: Vec<(Curve, &'static str)>,
    /// Whether the values are angles that wrap at ±180.
    wraps: bool,
    range: (f64, f64),
}

/// Draws the picture as a PNG file.
///
/// # Errors
///
/// When the writer refuses.
pub fn write(to: &mut impl Write, outcome: &Outcome, labels: &Labels) -> io::Result<()> {
    let pixels = draw(outcome.samples(), &Timeline::of(outcome), labels);
    let mut encoder = png::Encoder::new(to, WIDTH as u32, HEIGHT as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    Ok(writer.finish()?)
}

/// The picture's pixels, row by row.
fn draw(samples: &[Sample], timeline: &Timeline, labels: &Labels) -> Vec<u8> {
    let time_s = |sample: &Sample| sample.published_ns as f64 * 1e-9;
    let end_s = samples.last().map_or(1.0, time_s);
    let panels = panels(samples, time_s);
    let still_until_s = samples
        .iter()
        .filter(|sample| sample.snapshot.flags.contains(Flags::CALIBRATING))
        .map(time_s)
        .reduce(f64::max);

    // Beneath the panels each flag has a row of its own, if there are faults to show.
    let rows_height = match timeline.flags.len() {
        0 => 0,
        rows => rows * ROW + GAP,
    };
    let panels_height = BOTTOM - TOP - rows_height - GAP * (panels.len() - 1);
    let height = panels_height / panels.len();
    let places: Vec<Place> = (0..panels.len())
        .zip(&panels)
        .map(|(nth, panel)| Place {
            top: TOP + nth * (height + GAP),
            bottom: TOP + nth * (height + GAP) + height,
            time_s: (0.0, end_s),
            range: panel.range,
        })
        .collect();

    let mut large = Canvas::new(WIDTH * SCALE, HEIGHT * SCALE);
    for (panel, place) in panels.iter().zip(&places) {
        if let Some(until_s) = still_until_s {
            large.fill(
                place.x(0.0),
                place.y_top(),
                place.x(until_s),
                place.y_bottom(),
                SHADE,
            );
        }
        for fault in &timeline.faults {
            large.fill(
                place.x(fault.start_s),
                place.y_top(),
                place.x(fault.end_s).max(place.x(fault.start_s) + NARROWEST),
                place.y_bottom(),
                FAULT_SHADE,
            );
        }
        for tick in ticks(place.time_s, decimal_step(place.time_s, 12.0)) {
            large.fill(
                place.x(tick) - 1.0,
                place.y_top(),
                place.x(tick) + 1.0,
                place.y_bottom(),
                GRID,
            );
        }
        for tick in ticks(place.range, angle_step(place.range)) {
            large.fill(
                place.x(0.0),
                place.y(tick) - 1.0,
                place.x(end_s),
                place.y(tick) + 1.0,
                GRID,
            );
        }
        for (curve, _) in &panel.curves {
            large.curve(curve, place, panel.wraps);
        }
    }
    let rows_top = BOTTOM - rows_height + GAP;
    if let Some(place) = places.first() {
        for (nth, (name, spans)) in timeline.flags.iter().enumerate() {
            let top = ((rows_top + nth * ROW) * SCALE) as f64;
            let bottom = top + ((ROW - 5) * SCALE) as f64;
            let color = if *name == "VALID" { PITCH } else { ERROR };
            for &(start_s, end_s) in spans {
                large.fill(
                    place.x(start_s),
                    top,
                    place.x(end_s).max(place.x(start_s) + NARROWEST / 2.0),
                    bottom,
                    color,
                );
            }
        }
    }
    let mut canvas = large.reduced(SCALE);
    canvas.name_faults(timeline, &places);
    for (nth, (name, _)) in timeline.flags.iter().enumerate() {
        let y = rows_top + nth * ROW - 1;
        let name = name.to_lowercase().replace('_', " ");
        // The longest names have no room.
        let name = name
            .replace("gyroscope", "gyro")
            .replace("accelerometer", "accel");
        canvas.text(&name, LEFT - 8, y, &FONT_6X12, INK, Alignment::Right);
    }
    for (nth, (panel, place)) in panels.iter().zip(&places).enumerate() {
        canvas.annotate(panel, place, nth + 1 == panels.len());
    }
    if let (Some(until_s), Some(place)) = (still_until_s, places.first())
        && place.x(until_s) / SCALE as f64 > (LEFT + 60) as f64
    {
        canvas.text(
            "at rest",
            LEFT + 6,
            place.bottom - 22,
            &FONT_9X18,
            FRAME,
            Alignment::Left,
        );
    }
    canvas.text(&labels.title, LEFT, 16, &FONT_10X20, INK, Alignment::Left);
    canvas.text(
        &labels.subtitle,
        LEFT,
        44,
        &FONT_9X18,
        FRAME,
        Alignment::Left,
    );
    canvas.text(
        "time since power-up (s)",
        (LEFT + RIGHT) / 2,
        BOTTOM + 34,
        &FONT_9X18,
        INK,
        Alignment::Center,
    );
    canvas.pixels
}

/// What went wrong, and what the firmware said of it.
#[derive(Debug, Default)]
struct Timeline {
    faults: Vec<FaultSpan>,
    /// Flags with the times at which they were set; those that last from beginning to end or never come are left out.
    flags: Vec<(&'static str, Vec<(f64, f64)>)>,
}

#[derive(Debug)]
struct FaultSpan {
    start_s: f64,
    end_s: f64,
    name: String,
}

impl Timeline {
    /// Empty if nothing was to go wrong.
    fn of(outcome: &Outcome) -> Self {
        if outcome.faults.is_empty() {
            return Self::default();
        }
        let end_ns = outcome.record.last.1;
        let faults = outcome.faults.iter().map(|fault| FaultSpan {
            start_s: fault.start_ns as f64 * 1e-9,
            end_s: fault.end_ns().min(end_ns) as f64 * 1e-9,
            name: fault.kind.to_string(),
        });
        let samples = outcome.samples().iter();
        let mut flags: Vec<(u64, Flags)> = samples
            .map(|sample| (sample.published_ns, sample.snapshot.flags))
            .chain(
                outcome
                    .record
                    .stale
                    .iter()
                    .map(|stale| (stale.published_ns, stale.snapshot.flags)),
            )
            .collect();
        flags.sort_by_key(|&(at_ns, _)| at_ns);
        let valid_first = Flags::NAMES
            .into_iter()
            .filter(|&(flag, _)| flag == Flags::VALID)
            .chain(
                Flags::NAMES
                    .into_iter()
                    .filter(|&(flag, _)| flag != Flags::VALID),
            );
        let rows = valid_first.map(|(flag, name)| (name, spans(&flags, flag, end_ns)));
        Self {
            faults: faults.collect(),
            flags: rows.filter(|(_, spans)| !spans.is_empty()).collect(),
        }
    }
}

/// When a flag was set, in seconds: each publication stands until the next one.
fn spans(published: &[(u64, Flags)], flag: Flags, end_ns: u64) -> Vec<(f64, f64)> {
    let mut spans: Vec<(f64, f64)> = Vec::new();
    for (nth, &(at_ns, flags)) in published.iter().enumerate() {
        if !flags.contains(flag) {
            continue;
        }
        let next_ns = published.get(nth + 1).map_or(end_ns, |next| next.0);
        let (start_s, end_s) = (at_ns as f64 * 1e-9, next_ns as f64 * 1e-9);
        match spans.last_mut() {
            Some(last) if last.1 == start_s => last.1 = end_s,
            _ => spans.push((start_s, end_s)),
        }
    }
    spans
}

/// The four panels.
fn panels(samples: &[Sample], time_s: impl Fn(&Sample) -> f64) -> Vec<Panel> {
    let heading_deg = heading_difference_deg(samples);
    let estimated = |angle: fn(&Sample) -> f64| -> Vec<(f64, f64)> {
        samples
            .iter()
            .map(|sample| (time_s(sample), angle(sample)))
            .collect()
    };
    let truth = |angle: usize, shift_deg: f64| -> Vec<(f64, f64)> {
        let known = samples
            .iter()
            .filter_map(|sample| Some((time_s(sample), sample.edge?.truth.attitude?)));
        known
            .map(|(at_s, attitude)| (at_s, wrapped_deg(euler_deg(attitude)[angle] + shift_deg)))
            .collect()
    };
    let angle = |name, color, wraps, estimate: Vec<(f64, f64)>, truth: Vec<(f64, f64)>| {
        let range = range_of(estimate.iter().chain(&truth));
        let mut curves = vec![(
            Curve {
                color,
                points: estimate,
            },
            "estimate",
        )];
        if !truth.is_empty() {
            curves.insert(
                0,
                (
                    Curve {
                        color: TRUTH,
                        points: truth,
                    },
                    "truth",
                ),
            );
        }
        Panel {
            name,
            unit: "degrees",
            curves,
            wraps,
            range,
        }
    };
    let mut panels = vec![
        angle(
            "roll",
            ROLL,
            true,
            estimated(|sample| f64::from(sample.snapshot.euler().roll_rad).to_degrees()),
            truth(0, 0.0),
        ),
        angle(
            "pitch",
            PITCH,
            false,
            estimated(|sample| f64::from(sample.snapshot.euler().pitch_rad).to_degrees()),
            truth(1, 0.0),
        ),
        angle(
            "yaw, relative",
            YAW,
            true,
            estimated(|sample| f64::from(sample.snapshot.euler().yaw_rad).to_degrees()),
            truth(2, heading_deg),
        ),
    ];
    let errors: Vec<(f64, f64)> = samples
        .iter()
        .filter_map(|sample| Some((time_s(sample), inclination_deg(sample)?)))
        .collect();
    if !errors.is_empty() {
        let (_, high) = range_of(errors.iter());
        panels.push(Panel {
            name: "inclination error",
            unit: "degrees",
            curves: vec![(
                Curve {
                    color: ERROR,
                    points: errors,
                },
                "angle between estimated and true vertical",
            )],
            wraps: false,
            range: (0.0, high),
        });
    }
    panels
}

/// What to add to the true yaw so that it starts where the estimate does: the estimate's zero is the heading at rest.
fn heading_difference_deg(samples: &[Sample]) -> f64 {
    let first = samples.iter().find_map(|sample| {
        let attitude = sample.edge?.truth.attitude?;
        let is_ready = !sample.snapshot.flags.contains(Flags::CALIBRATING);
        is_ready.then(|| {
            f64::from(sample.snapshot.euler().yaw_rad).to_degrees() - euler_deg(attitude)[2]
        })
    });
    first.unwrap_or(0.0)
}

/// Roll, pitch and yaw of a body → earth attitude, in degrees.
#[must_use]
pub fn euler_deg(attitude: Quaternion) -> [f64; 3] {
    let Quaternion { w, x, y, z } = attitude;
    let roll = libm::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
    let pitch = libm::asin((2.0 * (w * y - z * x)).clamp(-1.0, 1.0));
    let yaw = libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
    [roll, pitch, yaw].map(f64::to_degrees)
}

/// An angle in degrees in (−180, 180].
fn wrapped_deg(angle_deg: f64) -> f64 {
    angle_deg - 360.0 * ((angle_deg - 180.0) / 360.0).ceil()
}

/// The range of values with some room, never narrower than two degrees.
fn range_of<'a>(points: impl Iterator<Item = &'a (f64, f64)>) -> (f64, f64) {
    let (low, high) = points
        .map(|point| point.1)
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
    if low > high {
        return (-1.0, 1.0);
    }
    let room = ((high - low) * 0.03)
        .max(1.0 - (high - low) / 2.0)
        .max(0.05);
    (low - room, high + room)
}

/// Round values in a range, about as many as wanted.
fn ticks((low, high): (f64, f64), step: f64) -> Vec<f64> {
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|nth| nth as f64 * step).collect()
}

/// 1, 2 or 5 times a power of ten, so that there are about as many ticks as wanted.
fn decimal_step((low, high): (f64, f64), wanted: f64) -> f64 {
    let rough = (high - low).max(1e-9) / wanted;
    let power = 10.0_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .find(|factor| factor * power >= rough);
    factor.unwrap_or(10.0) * power
}

/// The same for angles: wide ranges in parts of a right angle.
fn angle_step(range: (f64, f64)) -> f64 {
    let step = decimal_step(range, 5.0);
    let parts = [15.0, 30.0, 45.0, 90.0];
    let rough = (range.1 - range.0) / 5.0;
    if rough > 10.0 {
        parts
            .into_iter()
            .find(|&part| part >= rough)
            .unwrap_or(90.0)
    } else {
        step
    }
}

/// A panel's place in the picture, and what its edges stand for.
struct Place {
    top: usize,
    bottom: usize,
    time_s: (f64, f64),
    range: (f64, f64),
}

impl Place {
    /// Coordinates in the large picture.
    fn x(&self, time_s: f64) -> f64 {
        let share = (time_s - self.time_s.0) / (self.time_s.1 - self.time_s.0);
        SCALE as f64 * (LEFT as f64 + share * (RIGHT - LEFT) as f64)
    }

    fn y(&self, value: f64) -> f64 {
        let share = (value - self.range.0) / (self.range.1 - self.range.0);
        SCALE as f64 * (self.bottom as f64 - share * (self.bottom - self.top) as f64)
    }

    fn y_top(&self) -> f64 {
        (self.top * SCALE) as f64
    }

    fn y_bottom(&self) -> f64 {
        (self.bottom * SCALE) as f64
    }
}

/// A picture in memory.
struct Canvas {
    width: usize,
    height: usize,
    /// Red, green and blue, row by row.
    pixels: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Self {
        let white = [BACKGROUND.r(), BACKGROUND.g(), BACKGROUND.b()];
        Self {
            width,
            height,
            pixels: white.repeat(width * height),
        }
    }

    fn set(&mut self, x: usize, y: usize, color: Rgb888) {
        if x < self.width
            && y < self.height
            && let Some(pixel) = self.pixels.get_mut(3 * (y * self.width + x)..)
            && let Some(pixel) = pixel.first_chunk_mut()
        {
            *pixel = [color.r(), color.g(), color.b()];
        }
    }

    /// Fills a rectangle.
    fn fill(&mut self, left: f64, top: f64, right: f64, bottom: f64, color: Rgb888) {
        for y in top.round().max(0.0) as usize..bottom.round().max(0.0) as usize {
            for x in left.round().max(0.0) as usize..right.round().max(0.0) as usize {
                self.set(x, y, color);
            }
        }
    }

    /// Draws a curve, column by column, with a gap where the values wrap.
    fn curve(&mut self, curve: &Curve, place: &Place, wraps: bool) {
        let half = HALF_STROKE * SCALE as f64;
        for pair in curve.points.windows(2) {
            let &[(start_s, start), (end_s, end)] = pair else {
                continue;
            };
            if !start.is_finite() || !end.is_finite() || (wraps && (end - start).abs() > WRAP_DEG) {
                continue;
            }
            let (x_start, x_end) = (place.x(start_s), place.x(end_s));
            let (y_start, y_end) = (place.y(start), place.y(end));
            let (first, last) = (
                (x_start - half / 2.0) as usize,
                (x_end + half / 2.0) as usize,
            );
            for column in first..=last {
                let share = |x: f64| ((x - x_start) / (x_end - x_start).max(1e-9)).clamp(0.0, 1.0);
                let y_at = |share: f64| y_start + share * (y_end - y_start);
                let (enter, leave) = (y_at(share(column as f64)), y_at(share(column as f64 + 1.0)));
                let top = (enter.min(leave) - half).clamp(place.y_top(), place.y_bottom());
                let bottom = (enter.max(leave) + half).clamp(place.y_top(), place.y_bottom());
                for row in top.round() as usize..bottom.round() as usize {
                    self.set(column, row, curve.color);
                }
            }
        }
    }

    /// The picture `factor` times smaller, each pixel the mean of those it covers.
    fn reduced(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let mut sums = vec![0_u32; 3 * width * height];
        for (nth, row) in self
            .pixels
            .chunks_exact(3 * self.width)
            .take(height * factor)
            .enumerate()
        {
            let into = &mut sums[3 * width * (nth / factor)..][..3 * width];
            for (nth, pixel) in row.chunks_exact(3).take(width * factor).enumerate() {
                for (sum, &value) in into[3 * (nth / factor)..].iter_mut().zip(pixel) {
                    *sum += u32::from(value);
                }
            }
        }
        let count = (factor * factor) as u32;
        Self {
            width,
            height,
            pixels: sums.into_iter().map(|sum| (sum / count) as u8).collect(),
        }
    }

    /// Draws a panel's frame, its tick labels, its name and its legend.
    fn annotate(&mut self, panel: &Panel, place: &Place, is_last: bool) {
        for x in LEFT..=RIGHT {
            self.set(x, place.top, FRAME);
            self.set(x, place.bottom, FRAME);
        }
        for y in place.top..=place.bottom {
            self.set(LEFT, y, FRAME);
            self.set(RIGHT, y, FRAME);
        }
        let pixel = |coordinate: f64| (coordinate / SCALE as f64).round() as usize;
        for tick in ticks(place.range, angle_step(place.range)) {
            let label = number(tick, angle_step(place.range));
            self.text(
                &label,
                LEFT - 8,
                pixel(place.y(tick)) - 9,
                &FONT_9X18,
                INK,
                Alignment::Right,
            );
        }
        if is_last {
            for tick in ticks(place.time_s, decimal_step(place.time_s, 12.0)) {
                let label = number(tick, decimal_step(place.time_s, 12.0));
                self.text(
                    &label,
                    pixel(place.x(tick)),
                    place.bottom + 6,
                    &FONT_9X18,
                    INK,
                    Alignment::Center,
                );
            }
        }
        let name = format!("{} ({})", panel.name, panel.unit);
        let line = place.top - 22;
        self.text(&name, LEFT, line, &FONT_9X18_BOLD, INK, Alignment::Left);
        let mut right = RIGHT;
        for (curve, meaning) in panel.curves.iter().rev() {
            self.text(meaning, right, line, &FONT_9X18, INK, Alignment::Right);
            right -= 9 * meaning.len() + 8;
            self.fill(
                (right - 26) as f64,
                (line + 7) as f64,
                right as f64,
                (line + 11) as f64,
                curve.color,
            );
            right -= 26 + 24;
        }
    }

    /// Writes the faults' names into the first panel, one beneath the other.
    fn name_faults(&mut self, timeline: &Timeline, places: &[Place]) {
        let Some(place) = places.first() else { return };
        for (nth, fault) in timeline.faults.iter().enumerate() {
            let x = (place.x(fault.start_s) / SCALE as f64) as usize + 3;
            let y = place.top + 3 + nth % 5 * 13;
            // A name near the right edge is written to the left of its fault.
            let (x, alignment) = if x + 6 * fault.name.len() > RIGHT {
                (x - 6, Alignment::Right)
            } else {
                (x, Alignment::Left)
            };
            self.text(&fault.name, x, y, &FONT_6X12, FAULT_INK, alignment);
        }
    }

    fn text(
        &mut self,
        text: &str,
        x: usize,
        y: usize,
        font: &MonoFont<'_>,
        color: Rgb888,
        alignment: Alignment,
    ) {
        let style = TextStyleBuilder::new()
            .alignment(alignment)
            .baseline(Baseline::Top)
            .build();
        let at = Point::new(x as i32, y as i32);
        let text = Text::with_text_style(text, at, MonoTextStyle::new(font, color), style);
        // Drawing into memory cannot fail.
        let _ = text.draw(self);
    }
}

/// A tick's label: as many decimals as the step between ticks needs.
fn number(value: f64, step: f64) -> String {
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    format!("{:.decimals$}", value + 0.0)
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = std::convert::Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Self::Error> {
        for Pixel(at, color) in pixels {
            if let (Ok(x), Ok(y)) = (usize::try_from(at.x), usize::try_from(at.y)) {
                self.set(x, y, color);
            }
        }
        Ok(())
    }
}
