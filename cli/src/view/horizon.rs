//! Artificial horizon: sky and ground as the pilot sees them, a ladder of pitch, a scale of
//! roll, and the aircraft.
//!
//! A point of the picture, x to the right and y up from its centre, lies at the elevation θ + (y
//! cos φ − x sin φ) / s, with roll φ (right wing down positive), pitch θ (nose up positive)
//! and s points to a degree: the body's axes are forward-right-down, so with the right wing down
//! there is ground to the right, and the horizon rises on the right.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};

use super::dots::{ACROSS, DOWN, Dots};

pub const SKY: Color = Color::Indexed(25);
pub const GROUND: Color = Color::Indexed(94);
const LADDER: Color = Color::Indexed(255);
const AIRCRAFT: Color = Color::Indexed(226);
/// Background without an attitude.
const NOTHING: Color = Color::Indexed(236);

/// Pitch from the centre to the upper edge, degrees.
const HALF_VIEW_DEG: f64 = 25.0;

/// Parts of a cell, from its lower edge up, and from its left edge on (Unicode, block Block
/// Elements).
const FROM_BELOW: [&str; 9] = [" ", "▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"];
const FROM_LEFT: [&str; 9] = [" ", "▏", "▎", "▍", "▌", "▋", "▊", "▉", "█"];

/// Draws roll and pitch, degrees; without them draws an empty field.
pub fn draw(attitude_deg: Option<(f64, f64)>, area: Rect, buffer: &mut Buffer) {
    let Some((roll_deg, pitch_deg)) = attitude_deg else {
        buffer.set_style(area, Style::new().bg(NOTHING));
        return;
    };
    let view = View::new(roll_deg, pitch_deg, area);
    for row in area.rows() {
        for cell in row.columns() {
            let (symbol, front, back) = view.ground_in(cell);
            if let Some(cell) = buffer.cell_mut((cell.x, cell.y)) {
                cell.set_symbol(symbol).set_fg(front).set_bg(back);
            }
        }
    }
    let mut dots = Dots::new(area);
    view.ladder(&mut dots);
    view.roll_scale(&mut dots);
    dots.draw(buffer, |symbol| symbol == " ");
    view.numbers(buffer);
    aircraft(area, buffer);
}

/// Attitude on an area, with the points of [`Dots`].
struct View {
    area: Rect,
    pitch_deg: f64,
    roll_sine: f64,
    roll_cosine: f64,
    points_per_degree: f64,
    /// Centre, from the area's corner.
    centre: (f64, f64),
}

impl View {
    fn new(roll_deg: f64, pitch_deg: f64, area: Rect) -> Self {
        let (roll_sine, roll_cosine) = roll_deg.to_radians().sin_cos();
        let centre = (
            f64::from(i32::from(area.width) * ACROSS) / 2.0,
            f64::from(i32::from(area.height) * DOWN) / 2.0,
        );
        Self {
            area,
            pitch_deg,
            roll_sine,
            roll_cosine,
            points_per_degree: centre.1 / HALF_VIEW_DEG,
            centre,
        }
    }

    /// Returns the symbol for the ground or sky of a cell, its colour, and the colour behind it.
    fn ground_in(&self, cell: Rect) -> (&'static str, Color, Color) {
        let x = (f64::from(cell.x - self.area.x) + 0.5) * f64::from(ACROSS) - self.centre.0;
        let y = self.centre.1 - (f64::from(cell.y - self.area.y) + 0.5) * f64::from(DOWN);
        // Height of the cell's centre above the horizon, in points along the perpendicular.
        let above =
            self.pitch_deg * self.points_per_degree + y * self.roll_cosine - x * self.roll_sine;
        let (down, across) = (
            f64::from(DOWN) * self.roll_cosine.abs(),
            f64::from(ACROSS) * self.roll_sine.abs(),
        );
        let eighths = |share: f64| (share.clamp(0.0, 1.0) * 8.0).round() as usize;
        // The edge runs rather across the cell or rather down it.
        let (symbols, part, is_ground_first) = if down >= across {
            let part = 0.5 - above / down;
            (&FROM_BELOW, part, self.roll_cosine >= 0.0)
        } else {
            let part = 0.5 - above / across;
            (&FROM_LEFT, part, self.roll_sine < 0.0)
        };
        // The part that the symbol fills is below or to the left.
        let (part, front, back) = if is_ground_first {
            (eighths(part), GROUND, SKY)
        } else {
            (eighths(1.0 - part), SKY, GROUND)
        };
        match part {
            8 => (" ", front, front),
            part => (symbols[part], front, back),
        }
    }

    /// Returns the point at a distance along the horizon to the right, and at an elevation.
    fn point(&self, along: f64, elevation_deg: f64) -> (f64, f64) {
        let up = (elevation_deg - self.pitch_deg) * self.points_per_degree;
        let x = along * self.roll_cosine - up * self.roll_sine;
        let y = along * self.roll_sine + up * self.roll_cosine;
        (self.centre.0 + x, self.centre.1 - y)
    }

    /// Marks of the ladder that are near the middle: degrees, and half their length.
    fn marks(&self) -> impl Iterator<Item = (i32, f64)> {
        let (pitch_deg, width) = (self.pitch_deg, self.centre.0);
        (-9..=9)
            .map(|tens| 10 * tens)
            .filter(move |degrees| {
                *degrees != 0 && (f64::from(*degrees) - pitch_deg).abs() < HALF_VIEW_DEG * 0.72
            })
            .map(move |degrees| (degrees, width * 0.22))
    }

    fn ladder(&self, dots: &mut Dots) {
        for (degrees, half) in self.marks() {
            let elevation = f64::from(degrees);
            let (left, right) = (self.point(-half, elevation), self.point(half, elevation));
            dots.line(left, right, LADDER);
            // The ends point to the horizon.
            let towards = elevation - 2.0 * f64::from(degrees.signum());
            dots.line(left, self.point(-half, towards), LADDER);
            dots.line(right, self.point(half, towards), LADDER);
        }
    }

    fn numbers(&self, buffer: &mut Buffer) {
        for (degrees, half) in self.marks() {
            let (x, y) = self.point(half + 4.0, f64::from(degrees));
            let (column, row) = (x / f64::from(ACROSS), y / f64::from(DOWN));
            let text = degrees.abs().to_string();
            let is_inside = column >= 0.0
                && row >= 0.0
                && column + 2.0 < f64::from(self.area.width)
                && row < f64::from(self.area.height);
            if is_inside {
                let place = (self.area.x + column as u16, self.area.y + row as u16);
                for (letter, x) in text.chars().zip(place.0..) {
                    if let Some(cell) = buffer.cell_mut((x, place.1))
                        && (cell.symbol() == " " || cell.symbol() > "\u{2800}")
                    {
                        cell.set_char(letter).set_fg(LADDER);
                    }
                }
            }
        }
    }

    /// Draws ticks at the angles of bank of real instruments, and the direction of the aircraft's
    /// top.
    fn roll_scale(&self, dots: &mut Dots) {
        let radius = self.centre.1 * 0.94;
        let place = |angle_deg: f64, radius: f64| {
            let (sine, cosine) = angle_deg.to_radians().sin_cos();
            // The scale stands with the sky.
            let (x, y) = (
                sine * self.roll_cosine - cosine * self.roll_sine,
                sine * self.roll_sine + cosine * self.roll_cosine,
            );
            (self.centre.0 + radius * x, self.centre.1 - radius * y)
        };
        for tick_deg in [0.0, 10.0, 20.0, 30.0, 45.0, 60.0_f64] {
            let length = if tick_deg == 0.0 || tick_deg == 30.0 {
                0.84
            } else {
                0.9
            };
            for angle_deg in [-tick_deg, tick_deg] {
                let (outer, inner) = (place(angle_deg, radius), place(angle_deg, radius * length));
                dots.line(outer, inner, LADDER);
            }
        }
    }
}

/// Draws the fixed parts in the middle: the wings, the nose, the pointer of the roll scale.
fn aircraft(area: Rect, buffer: &mut Buffer) {
    let (x, y) = (area.x + area.width / 2, area.y + area.height / 2);
    let style = Style::new().fg(AIRCRAFT).add_modifier(Modifier::BOLD);
    let wing = (area.width / 10).max(3);
    let mut put = |x: u16, y: u16, symbol: &str| {
        if let Some(cell) = buffer.cell_mut((x, y)) {
            // Behind it is what there is most of.
            let is_mostly = |symbols: &[&str; 9]| symbols[4..].contains(&cell.symbol());
            if is_mostly(&FROM_BELOW) || is_mostly(&FROM_LEFT) {
                cell.bg = cell.fg;
            }
            cell.set_symbol(symbol);
            cell.set_style(style);
        }
    };
    for step in 3..3 + wing {
        put(x.saturating_sub(step), y, "━");
        put(x + step, y, "━");
    }
    put(x, y, "◆");
    put(x, area.y + 1, "▲");
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: Rect = Rect::new(0, 0, 40, 20);

    fn drawn(roll_deg: f64, pitch_deg: f64) -> Buffer {
        let mut buffer = Buffer::empty(AREA);
        draw(Some((roll_deg, pitch_deg)), AREA, &mut buffer);
        buffer
    }

    /// Returns the share of ground in a cell: all, a part, nothing.
    fn ground(buffer: &Buffer, x: u16, y: u16) -> f64 {
        let cell = &buffer[(x, y)];
        let part = [FROM_BELOW, FROM_LEFT]
            .iter()
            .find_map(|symbols| symbols.iter().position(|symbol| *symbol == cell.symbol()))
            .unwrap_or_default() as f64
            / 8.0;
        // A mark of the ladder has the colour behind it alone.
        match (cell.fg, cell.bg) {
            (GROUND, SKY) | (_, SKY) => part,
            _ => 1.0 - part,
        }
    }

    fn share_of_ground(buffer: &Buffer) -> f64 {
        let cells = AREA
            .positions()
            .map(|place| ground(buffer, place.x, place.y));
        cells.sum::<f64>() / f64::from(AREA.width * AREA.height)
    }

    /// Returns the rows of ground from below in a column.
    fn height(buffer: &Buffer, x: u16) -> f64 {
        (0..AREA.height).map(|y| ground(buffer, x, y)).sum()
    }

    #[test]
    fn level_has_the_ground_below_and_the_sky_above() {
        let buffer = drawn(0.0, 0.0);
        assert_eq!((ground(&buffer, 1, 0), ground(&buffer, 1, 19)), (0.0, 1.0));
        assert_eq!(height(&buffer, 1), 10.0);
        assert_eq!(height(&buffer, 38), 10.0);
    }

    #[test]
    fn nose_up_shows_more_sky_and_nose_down_more_ground() {
        // 10 of 50 degrees of view are a fifth of the height.
        for (pitch_deg, share) in [(10.0, 0.3), (-10.0, 0.7), (40.0, 0.0), (-90.0, 1.0)] {
            let got = share_of_ground(&drawn(0.0, pitch_deg));
            assert!((got - share).abs() < 0.02, "{pitch_deg}: {got}");
        }
    }

    #[test]
    fn right_wing_down_raises_the_horizon_on_the_right() {
        let buffer = drawn(20.0, 0.0);
        let (left, right) = (height(&buffer, 1), height(&buffer, 38));
        assert!(right > 13.0 && left < 7.0, "{left} {right}");
        // By the tangent of the angle: 37 columns are 18.5 rows' height.
        let slope = (right - left) / 18.5;
        assert!((slope - 20_f64.to_radians().tan()).abs() < 0.05, "{slope}");
        let (left, right) = (
            height(&drawn(-20.0, 0.0), 1),
            height(&drawn(-20.0, 0.0), 38),
        );
        assert!(left > 13.0 && right < 7.0, "{left} {right}");
    }

    #[test]
    fn on_its_side_and_on_its_back() {
        let buffer = drawn(90.0, 0.0);
        assert_eq!((ground(&buffer, 1, 4), ground(&buffer, 38, 4)), (0.0, 1.0));
        let buffer = drawn(-90.0, 0.0);
        assert_eq!((ground(&buffer, 1, 4), ground(&buffer, 38, 4)), (1.0, 0.0));
        let buffer = drawn(180.0, 0.0);
        assert_eq!((ground(&buffer, 1, 0), ground(&buffer, 1, 19)), (1.0, 0.0));
        // Nose above the horizon on its back: more sky still.
        assert!(share_of_ground(&drawn(180.0, 10.0)) < 0.35);
        for roll_deg in -18..=18 {
            let share = share_of_ground(&drawn(f64::from(roll_deg) * 10.0, 0.0));
            assert!((share - 0.5).abs() < 0.03, "{roll_deg}0: {share}");
        }
    }
}
