//! Compass: the heading with its σ, a tape of directions, and the field's strength and dip.
//!
//! The tape is the rose of a compass, unrolled: the vehicle's heading is in its middle, and
//! directions clockwise of it are to the right.

use aplomb::telemetry::heading::Line;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};

use super::letters::{number, put};

const BACK: Color = Color::Indexed(237);
const TEXT: Color = Color::Indexed(252);
const FAINT: Color = Color::Indexed(244);
const VALID: Color = Color::Indexed(77);

const DEGREES_PER_COLUMN: f64 = 2.5;

/// Magnetic field at the compass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// Strength, µT. That of the earth is 22 to 67.
    pub strength_ut: f64,
    /// Angle below the horizon, degrees.
    pub dip_deg: f64,
}

impl Field {
    /// Returns the field with these components, µT forward, right and down, at this attitude.
    pub fn new([x, y, z]: [f64; 3], roll_deg: f64, pitch_deg: f64) -> Self {
        let (roll_sine, roll_cosine) = roll_deg.to_radians().sin_cos();
        let (pitch_sine, pitch_cosine) = pitch_deg.to_radians().sin_cos();
        let down = -x * pitch_sine + (y * roll_sine + z * roll_cosine) * pitch_cosine;
        let strength_ut = (x * x + y * y + z * z).sqrt();
        Self {
            strength_ut,
            dip_deg: (down / strength_ut.max(1e-9))
                .clamp(-1.0, 1.0)
                .asin()
                .to_degrees(),
        }
    }
}

/// Draws the heading with its σ in a row: green if it is valid.
pub fn draw_heading(heading: &Line, area: Rect, row: u16, buffer: &mut Buffer) {
    let style = style_of(heading);
    put(buffer, area, 0, row, "head", style);
    let angle = number(Some(heading.heading_deg), 8, "°");
    put(buffer, area, 6, row, &angle, style);
    let sigma = number(Some(heading.sigma_deg), 0, "°");
    put(buffer, area, 17, row, &format!("± {sigma}"), style);
}

/// Draws the tape in the last row of an area, and the field above it.
pub fn draw_tape(heading: &Line, field: Option<Field>, area: Rect, buffer: &mut Buffer) {
    let row = area.height - 1;
    let text = tape(heading.heading_deg.into(), area.width.into());
    put(buffer, area, 0, row, &text, Style::new().bg(BACK).fg(TEXT));
    let mark = style_of(heading).bg(BACK);
    put(buffer, area, area.width / 2, row - 1, "▼", mark);
    if let Some(field) = field {
        let text = format!(" {:.1} µT, dip {:.0}° ", field.strength_ut, field.dip_deg);
        put(
            buffer,
            area,
            0,
            row - 1,
            &text,
            Style::new().bg(BACK).fg(TEXT),
        );
    }
}

fn style_of(heading: &Line) -> Style {
    let colour = if heading.is_valid { VALID } else { FAINT };
    Style::new().fg(colour).add_modifier(Modifier::BOLD)
}

/// Returns the directions around a heading. A label that is cut at an end is left out.
fn tape(heading_deg: f64, width: usize) -> String {
    let mut row = vec![' '; width];
    let middle = (width / 2) as f64;
    for direction_deg in (0..360).step_by(10) {
        let label = match direction_deg {
            0 => "N".to_owned(),
            90 => "E".to_owned(),
            180 => "S".to_owned(),
            270 => "W".to_owned(),
            _ if direction_deg % 30 == 0 => direction_deg.to_string(),
            _ => "·".to_owned(),
        };
        let offset_deg = f64::from(direction_deg) - heading_deg;
        let offset_deg = offset_deg - 360.0 * (offset_deg / 360.0).round();
        let column = (middle + offset_deg / DEGREES_PER_COLUMN).round() as isize;
        let letters = label.chars().count();
        let start = usize::try_from(column - letters as isize / 2);
        let places = start
            .ok()
            .and_then(|start| row.get_mut(start..start + letters));
        for (place, letter) in places.into_iter().flatten().zip(label.chars()) {
            *place = letter;
        }
    }
    row.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tape_has_the_heading_in_its_middle() {
        assert_eq!(tape(0.0, 41), "·   ·  330  ·   ·   N   ·   ·  30   ·   ·");
        for heading_deg in [0.0, 5.0, 90.0, 182.0, 270.0, 359.9] {
            let text = tape(heading_deg, 61);
            assert_eq!(text.chars().count(), 61);
            let place = |name: char| text.chars().position(|letter| letter == name);
            for (name, direction_deg) in [('N', 0.0), ('E', 90.0), ('S', 180.0), ('W', 270.0)] {
                let offset_deg = (direction_deg - heading_deg + 540.0) % 360.0 - 180.0;
                let column = 30.0 + offset_deg / DEGREES_PER_COLUMN;
                let expected = (0.0..=60.0).contains(&column);
                assert_eq!(place(name).is_some(), expected, "{name} in {text}");
                if let Some(place) = place(name) {
                    assert!((place as f64 - column).abs() <= 0.5, "{name} in {text}");
                }
            }
        }
    }

    #[test]
    fn the_dip_is_that_below_the_horizon_in_any_attitude() {
        let level = Field::new([18.6, 0.0, 46.1], 0.0, 0.0);
        assert!((level.strength_ut - 49.7).abs() < 0.1, "{level:?}");
        assert!((level.dip_deg - 68.0).abs() < 0.1, "{level:?}");
        // Right wing down by 90°: down is to the right.
        let banked = Field::new([18.6, 46.1, 0.0], 90.0, 0.0);
        assert!((banked.dip_deg - 68.0).abs() < 0.1, "{banked:?}");
        // Nose down by 90°: down is forward.
        let dived = Field::new([46.1, 0.0, -18.6], 0.0, -90.0);
        assert!((dived.dip_deg - 68.0).abs() < 0.1, "{dived:?}");
        assert_eq!(Field::new([0.0; 3], 0.0, 0.0).dip_deg, 0.0);
    }
}
