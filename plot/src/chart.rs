//! Charts of curves over time, one above the other. Beneath them are rows for flags and faults,
//! which last for a while.
//!
//! Beneath those there may be panels with an axis of their own, such as a spectrum's.

use crate::picture::{Align, At, Color, Font, Picture};
use crate::timeline::Trace;

/// Dark letters.
pub const INK: Color = Color(30, 34, 42);
/// Frames and secondary texts.
pub const FRAME: Color = Color(110, 116, 126);
const GRID: Color = Color(218, 221, 226);
/// A curve of the truth.
pub const TRUTH: Color = Color(150, 156, 166);
/// A curve about the first axis.
pub const FIRST: Color = Color(0, 101, 189);
/// A curve about the second axis. Also a good state.
pub const SECOND: Color = Color(0, 135, 90);
/// A curve about the third axis.
pub const THIRD: Color = Color(176, 84, 0);
/// An error. Also a bad state.
pub const ERROR: Color = Color(190, 30, 60);
/// The area in which an error is expected.
pub const EXPECTED: Color = Color(236, 226, 240);
/// A time of rest.
pub const SHADE: Color = Color(238, 240, 244);
/// A fault.
pub const FAULT_SHADE: Color = Color(255, 222, 214);
const FAULT_INK: Color = Color(165, 50, 20);

/// No panel of angles shows less than so many degrees.
pub const NARROWEST_DEG: f64 = 2.0;

/// Margins of the panels, in pixels.
const LEFT: f32 = 110.0;
const MARGIN_RIGHT: f32 = 25.0;
const TOP: f32 = 104.0;
const GAP: f32 = 42.0;
/// Height of an axis with its numbers and its name, beneath a panel.
const AXIS: f32 = 56.0;
/// The height of a lane.
const LANE: f32 = 17.0;
/// The narrowest span of a shade and of a lane.
const NARROWEST_SHADE: f32 = 2.0;
const NARROWEST_SPAN: f32 = 1.0;

/// A chart of so many pixels.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Width, in pixels.
    pub width: u32,
    /// Height, in pixels.
    pub height: u32,
    /// The first line.
    pub title: String,
    /// The second line.
    pub subtitle: String,
    /// The meanings of the colours, on the second line.
    pub legend: Vec<(Color, String)>,
    /// The time that is shown, s.
    pub time_s: (f64, f64),
    /// The name of the time axis.
    pub time_name: &'static str,
    /// The panels over time, from above.
    pub panels: Vec<Panel>,
    /// Spans of time in all of them.
    pub shades: Vec<Shade>,
    /// Rows beneath them.
    pub lanes: Vec<Lane>,
    /// Panels with an axis of their own, beneath those.
    pub others: Vec<(Panel, Axis)>,
}

/// Curves in one frame.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// The quantity, and its unit.
    pub name: String,
    /// The curves; the later ones cover the earlier ones.
    pub curves: Vec<Curve>,
    /// The values of its lower and its upper edge; logarithms if `is_logarithmic`.
    pub range: (f64, f64),
    /// Numbers are powers of ten.
    pub is_logarithmic: bool,
    /// Texts at points, each with a ring.
    pub annotations: Vec<((f64, f64), String)>,
}

/// An axis of a panel's own, from zero on.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Value at the upper end.
    pub end: f64,
    /// The quantity, and its unit.
    pub name: &'static str,
}

/// A curve.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Colour of the curve.
    pub color: Color,
    /// Parts without interruption: times and values.
    pub lines: Vec<Vec<(f64, f64)>>,
    /// The text of the legend. Empty: the legend leaves the curve out.
    pub meaning: String,
    /// Manner of drawing.
    pub style: Style,
}

/// Manner in which a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Style {
    /// A line, so many pixels wide.
    Line(f32),
    /// The area between it and the lower edge.
    Area,
}

/// A span of time.
#[derive(Clone, Debug)]
pub struct Shade {
    /// Start and end, s.
    pub span_s: (f64, f64),
    /// Colour of the shade.
    pub color: Color,
    /// Name of the shade, printed in the first panel.
    pub name: String,
}

/// A row of spans of time.
#[derive(Clone, Debug)]
pub struct Lane {
    /// Name of the lane.
    pub name: String,
    /// Colour of the spans.
    pub color: Color,
    /// Start and end of each, s.
    pub spans_s: Vec<(f64, f64)>,
}

impl Curve {
    /// A curve of the usual width. That of the truth is wider, since others cover it.
    #[must_use]
    pub fn new(color: Color, meaning: &str, trace: &Trace) -> Self {
        Self {
            color,
            lines: trace.lines(),
            meaning: meaning.to_owned(),
            style: Style::Line(if color == TRUTH { 5.0 } else { 2.0 }),
        }
    }
}

impl Panel {
    /// A panel whose range holds these curves with some room, and is never narrower than this.
    #[must_use]
    pub fn around(name: &str, narrowest: f64, curves: Vec<(Color, &str, &Trace)>) -> Self {
        let ranges = curves.iter().filter_map(|(.., trace)| trace.range());
        let range = ranges.reduce(|one, other| (one.0.min(other.0), one.1.max(other.1)));
        let (low, high) = range.unwrap_or((0.0, 0.0));
        let room = ((high - low) * 0.03).max((narrowest - (high - low)) / 2.0);
        let curves = curves.into_iter();
        Self {
            name: name.to_owned(),
            curves: curves
                .map(|(color, meaning, trace)| Curve::new(color, meaning, trace))
                .collect(),
            range: (low - room, high + room),
            ..Self::default()
        }
    }
}

impl Chart {
    /// Draws it.
    #[must_use]
    pub fn draw(&self) -> Picture {
        let mut picture = Picture::new(self.width, self.height);
        let (width, height) = (self.width as f32, self.height as f32);
        let right = width - MARGIN_RIGHT;
        let lanes_height = self.lanes.len() as f32 * LANE;
        let count = |length: usize| length as f32;
        let (panels, others) = (count(self.panels.len()), count(self.others.len()));
        let available = height - TOP - 10.0 - lanes_height - AXIS;
        let between = GAP * (panels - 1.0).max(0.0) + (GAP + AXIS - 14.0) * others;
        let panel_height = ((available - between) / (panels + others).max(1.0)).floor();

        let mut place = Place {
            left: LEFT,
            right,
            top: TOP,
            bottom: TOP + panel_height,
            across: self.time_s,
            range: (0.0, 1.0),
        };
        for (nth, panel) in self.panels.iter().enumerate() {
            place.range = panel.range;
            for shade in &self.shades {
                let x = place.span(shade.span_s, NARROWEST_SHADE);
                picture.rectangle((x.0, place.top), (x.1, place.bottom), shade.color);
            }
            let is_last = nth + 1 == self.panels.len();
            panel.draw(&mut picture, &place, is_last);
            if nth == 0 {
                self.name_shades(&mut picture, &place);
            }
            if !is_last {
                place.move_down(panel_height + GAP);
            }
        }
        let y = self.draw_lanes(&mut picture, &place);
        place.move_down(y - place.bottom + GAP);
        self.draw_others(&mut picture, place, panel_height);
        self.draw_head(&mut picture);
        picture
    }

    /// Draws the lanes beneath the panels, and the name of the time axis beneath these. Returns the
    /// height of that name.
    fn draw_lanes(&self, picture: &mut Picture, place: &Place) -> f32 {
        let mut y = place.bottom + 29.0;
        for lane in &self.lanes {
            lane.draw(picture, place, y);
            y += LANE;
        }
        y += 14.0;
        let at = (place.middle(), y);
        picture.text(self.time_name, at, Font::Normal, INK, Align::Center);
        y
    }

    /// Draws the panels with an axis of their own, the first of them at `place`.
    fn draw_others(&self, picture: &mut Picture, mut place: Place, panel_height: f32) {
        for (panel, axis) in &self.others {
            place.top = place.bottom.max(place.top);
            place.bottom = place.top + panel_height;
            let own = Place {
                across: (0.0, axis.end),
                range: panel.range,
                ..place
            };
            panel.draw(picture, &own, true);
            let at = (place.middle(), own.bottom + 40.0);
            picture.text(axis.name, at, Font::Normal, INK, Align::Center);
            place.move_down(panel_height + GAP + AXIS - 14.0);
        }
    }

    /// Draws the title, the subtitle and the legend.
    fn draw_head(&self, picture: &mut Picture) {
        picture.text(&self.title, (LEFT, 26.0), Font::Large, INK, Align::Left);
        picture.text(
            &self.subtitle,
            (LEFT, 53.0),
            Font::Normal,
            FRAME,
            Align::Left,
        );
        let mut x = LEFT;
        for (color, meaning) in &self.legend {
            picture.line(vec![(x, 53.0), (x + 24.0, 53.0)], *color, 4.0);
            picture.text(meaning, (x + 32.0, 53.0), Font::Large, INK, Align::Left);
            x += 32.0 + Font::Large.width() * meaning.chars().count() as f32 + 36.0;
        }
    }

    /// Writes names into the first panel, one beneath the other.
    fn name_shades(&self, picture: &mut Picture, place: &Place) {
        let named = self.shades.iter().filter(|shade| !shade.name.is_empty());
        for (nth, shade) in named.enumerate() {
            let (color, font) = match shade.color {
                FAULT_SHADE => (FAULT_INK, Font::Tiny),
                _ => (FRAME, Font::Normal),
            };
            let (start, end) = place.span(shade.span_s, NARROWEST_SHADE);
            let length = font.width() * shade.name.chars().count() as f32;
            if font == Font::Normal {
                // In the lower corner, if there is room.
                if end - start > length {
                    let at = (start + 6.0, place.bottom - 14.0);
                    picture.text(&shade.name, at, font, color, Align::Left);
                }
                continue;
            }
            let y = place.top + 9.0 + (nth % 5) as f32 * 13.0;
            // A name near the right edge is written to the left of its fault.
            let (x, align) = if start + 3.0 + length > place.right {
                (start - 3.0, Align::Right)
            } else {
                (start + 3.0, Align::Left)
            };
            picture.text(&shade.name, (x, y), font, color, align);
        }
    }
}

impl Lane {
    fn draw(&self, picture: &mut Picture, place: &Place, top: f32) {
        for &span_s in &self.spans_s {
            let x = place.span(span_s, NARROWEST_SPAN);
            picture.rectangle((x.0, top), (x.1, top + LANE - 5.0), self.color);
        }
        let at = (LEFT - 8.0, top + (LANE - 5.0) / 2.0);
        picture.text(&self.name, at, Font::Tiny, INK, Align::Right);
    }
}

impl Panel {
    fn draw(&self, picture: &mut Picture, place: &Place, has_numbers: bool) {
        let across_step = decimal_step(place.across, 12.0);
        let step = match self.is_logarithmic {
            true => decimal_step(self.range, 6.0).max(1.0),
            false => value_step(self.range),
        };
        for tick in ticks(place.across, across_step) {
            let x = place.x(tick);
            picture.line(vec![(x, place.top), (x, place.bottom)], GRID, 1.0);
        }
        for tick in ticks(self.range, step) {
            let y = place.y(tick);
            picture.line(vec![(place.left, y), (place.right, y)], GRID, 1.0);
        }
        for curve in &self.curves {
            for line in &curve.lines {
                curve.draw(line, picture, place);
            }
        }
        let (left, top, right, bottom) = (place.left, place.top, place.right, place.bottom);
        let frame = [
            (left, top),
            (right, top),
            (right, bottom),
            (left, bottom),
            (left, top),
        ];
        picture.line(frame.to_vec(), FRAME, 1.0);
        for ((x, y), annotation) in &self.annotations {
            let at = (place.x(*x), place.y(*y));
            picture.ring(at, 5.0, INK);
            picture.text(
                annotation,
                (at.0 + 10.0, at.1.max(top + 10.0)),
                Font::Normal,
                INK,
                Align::Left,
            );
        }
        for tick in ticks(self.range, step) {
            let label = match self.is_logarithmic {
                true => power_of_ten(tick),
                false => number(tick, step),
            };
            picture.text(
                &label,
                (left - 8.0, place.y(tick)),
                Font::Normal,
                INK,
                Align::Right,
            );
        }
        if has_numbers {
            for tick in ticks(place.across, across_step) {
                let at = (place.x(tick), bottom + 15.0);
                picture.text(
                    &number(tick, across_step),
                    at,
                    Font::Normal,
                    INK,
                    Align::Center,
                );
            }
        }
        self.draw_head(picture, place);
    }

    /// Draws the name and the legend above the frame.
    fn draw_head(&self, picture: &mut Picture, place: &Place) {
        let line = place.top - 13.0;
        let at = (place.left, line);
        picture.text(&self.name, at, Font::Bold, INK, Align::Left);
        let mut x = place.right;
        for curve in self
            .curves
            .iter()
            .rev()
            .filter(|curve| !curve.meaning.is_empty())
        {
            picture.text(&curve.meaning, (x, line), Font::Normal, INK, Align::Right);
            x -= Font::Normal.width() * curve.meaning.chars().count() as f32 + 8.0;
            let half = match curve.style {
                Style::Line(_) => 2.0,
                Style::Area => 6.0,
            };
            picture.rectangle((x - 26.0, line - half), (x, line + half), curve.color);
            x -= 26.0 + 24.0;
        }
    }
}

impl Curve {
    fn draw(&self, line: &[(f64, f64)], picture: &mut Picture, place: &Place) {
        let mut points: Vec<At> = line
            .iter()
            .map(|&(x, y)| (place.x(x), place.y(y).clamp(place.top, place.bottom)))
            .collect();
        match self.style {
            Style::Line(width) => {
                if let [(x, y)] = points[..] {
                    // One value alone is a dot.
                    points.push((x + width, y));
                }
                picture.line(points, self.color, width);
            }
            Style::Area => {
                if let (Some(first), Some(last)) = (points.first(), points.last()) {
                    let corners = [(last.0, place.bottom), (first.0, place.bottom)];
                    points.extend(corners);
                    picture.area(points, self.color);
                }
            }
        }
    }
}

/// The panel of the inclination error, in degrees, and of what it was expected to be.
#[must_use]
pub fn error_panel(errors: &Trace, three_sigma: Option<&Trace>) -> Panel {
    let meaning = "angle between estimated and true vertical";
    let mut panel = Panel::around(
        "inclination error (degrees)",
        NARROWEST_DEG,
        vec![(ERROR, meaning, errors)],
    );
    panel.range.0 = 0.0;
    if let Some(three_sigma) = three_sigma {
        panel.curves.insert(
            0,
            Curve {
                style: Style::Area,
                ..Curve::new(EXPECTED, "within 3 sigma", three_sigma)
            },
        );
    }
    panel
}

/// Returns a lane for each flag that is ever set; `good` is the one that means well and comes
/// first.
#[must_use]
pub fn flag_lanes<'a>(
    flags: impl IntoIterator<Item = (&'a str, Vec<(f64, f64)>)>,
    good: &str,
) -> Vec<Lane> {
    let (first, others): (Vec<_>, Vec<_>) = flags
        .into_iter()
        .filter(|(_, spans_s)| !spans_s.is_empty())
        .partition(|(name, _)| *name == good);
    let lanes = first.into_iter().chain(others);
    let lanes = lanes.map(|(name, spans_s)| Lane {
        // The longest names have no room.
        name: name
            .to_lowercase()
            .replace('_', " ")
            .replace("gyroscope", "gyro")
            .replace("accelerometer", "accel"),
        color: if name == good { SECOND } else { ERROR },
        spans_s,
    });
    lanes.collect()
}

/// A panel's place in the picture, and what its edges stand for.
#[derive(Clone, Copy, Debug)]
struct Place {
    left: f32,
    right: f32,
    top: f32,
    bottom: f32,
    across: (f64, f64),
    range: (f64, f64),
}

impl Place {
    fn move_down(&mut self, by: f32) {
        self.top += by;
        self.bottom += by;
    }

    fn middle(&self) -> f32 {
        (self.left + self.right) / 2.0
    }

    fn x(&self, across: f64) -> f32 {
        let width = (self.across.1 - self.across.0).max(1e-9);
        let share = ((across - self.across.0) / width).clamp(0.0, 1.0);
        self.left + share as f32 * (self.right - self.left)
    }

    fn y(&self, value: f64) -> f32 {
        let share = (value - self.range.0) / (self.range.1 - self.range.0).max(1e-30);
        self.bottom - share as f32 * (self.bottom - self.top)
    }

    /// Returns the start and the end of a span, in pixels.
    fn span(&self, (start_s, end_s): (f64, f64), narrowest: f32) -> (f32, f32) {
        let start = self.x(start_s);
        (start, self.x(end_s).max(start + narrowest).min(self.right))
    }
}

/// Round values in a range.
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

/// A step for angles and rates in degrees. Wide ranges up to a turn use parts of a right angle.
fn value_step(range: (f64, f64)) -> f64 {
    let rough = (range.1 - range.0) / 6.0;
    if (10.0..=90.0).contains(&rough) {
        let parts = [15.0, 30.0, 45.0, 90.0];
        parts
            .into_iter()
            .find(|&part| part >= rough)
            .unwrap_or(90.0)
    } else {
        decimal_step(range, 5.0)
    }
}

/// A tick's label: as many decimals as the step between ticks needs.
fn number(value: f64, step: f64) -> String {
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    format!("{:.decimals$}", value + 0.0)
}

/// The label of a logarithm.
fn power_of_ten(logarithm: f64) -> String {
    match logarithm.round() as i32 {
        0 => "1".to_owned(),
        exponent => format!("1e{exponent}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks((-0.3, 1.2), 0.5), [0.0, 0.5, 1.0]);
        assert_eq!(decimal_step((0.0, 60.0), 12.0), 5.0);
        assert_eq!(decimal_step((0.0, 3_600.0), 12.0), 500.0);
        assert_eq!(value_step((-180.0, 180.0)), 90.0);
        assert_eq!(value_step((-45.0, 45.0)), 15.0);
        assert_eq!(value_step((-1_500.0, 1_500.0)), 1_000.0);
        assert_eq!(number(-0.0, 0.5), "0.0");
        assert_eq!(power_of_ten(-3.0), "1e-3");
    }

    #[test]
    fn a_chart_has_its_panels_in_order_and_within_the_picture() {
        let trace = Trace::through((0..100).map(|nth| (f64::from(nth) * 0.1, f64::from(nth))));
        let panel = |name: &str| Panel::around(name, 2.0, vec![(FIRST, "what", &trace)]);
        let chart = Chart {
            width: 800,
            height: 900,
            title: "title".into(),
            subtitle: "subtitle".into(),
            legend: Vec::new(),
            time_s: (0.0, 10.0),
            time_name: "time",
            panels: vec![panel("one"), panel("two")],
            shades: vec![Shade {
                span_s: (1.0, 2.0),
                color: FAULT_SHADE,
                name: "fault".into(),
            }],
            lanes: vec![Lane {
                name: "lane".into(),
                color: ERROR,
                spans_s: vec![(2.0, 3.0)],
            }],
            others: vec![(
                panel("three"),
                Axis {
                    end: 500.0,
                    name: "frequency",
                },
            )],
        };
        let svg = chart.draw().svg();
        let height_of = |text: &str| -> f32 {
            let end = svg.find(&format!(">{text}</text>")).expect(text);
            let start = svg[..end].rfind(" y=\"").unwrap() + 4;
            svg[start..].split('"').next().unwrap().parse().unwrap()
        };
        let order = [
            "title",
            "subtitle",
            "one",
            "two",
            "lane",
            "time",
            "three",
            "frequency",
        ];
        let heights = order.map(height_of);
        assert!(heights.is_sorted(), "{heights:?}");
        assert!(heights[7] < 895.0, "{heights:?}");
    }
}
