//! Text on the screen: a line of letters in a row, and numbers.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;

/// Writes a text in a row of an area, as far as there is room, and returns its end.
pub fn put(buffer: &mut Buffer, area: Rect, x: u16, y: u16, text: &str, style: Style) -> u16 {
    if x >= area.width || y >= area.height {
        return x;
    }
    let room = usize::from(area.width - x);
    let (end, _) = buffer.set_stringn(area.x + x, area.y + y, text, room, style);
    end - area.x
}

/// Formats a number with two decimals, right-aligned in a width, or a dash.
pub fn number(value: Option<f32>, width: usize, unit: &str) -> String {
    match value {
        // Minus zero is zero.
        Some(value) => format!(
            "{:width$.2}{unit}",
            if value.abs() < 0.005 { 0.0 } else { value }
        ),
        None => format!("{:>width$}", "-"),
    }
}
