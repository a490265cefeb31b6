//! Points finer than letters: two across and four down in each cell, as Braille patterns.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;

/// Points across a cell.
pub const ACROSS: i32 = 2;
/// Points down a cell.
pub const DOWN: i32 = 4;

/// Bits of the points by row and column. U+2800 plus the bits is the pattern (Unicode, block
/// Braille Patterns).
const BITS: [[u8; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];

/// Field of points; (0, 0) is at the top left.
pub struct Dots {
    area: Rect,
    cells: Vec<(u8, Color)>,
}

impl Dots {
    /// Creates an empty field on the cells of this area.
    pub fn new(area: Rect) -> Self {
        Self {
            area,
            cells: vec![(0, Color::Reset); usize::from(area.width) * usize::from(area.height)],
        }
    }

    /// Sets a point, if it is inside. A cell has the colour of its last point.
    pub fn set(&mut self, x: i32, y: i32, colour: Color) {
        let width = i32::from(self.area.width);
        if (0..width * ACROSS).contains(&x) && (0..i32::from(self.area.height) * DOWN).contains(&y)
        {
            let (cell, colour_of_cell) = &mut self.cells[(y / DOWN * width + x / ACROSS) as usize];
            *cell |= BITS[(y % DOWN) as usize][(x % ACROSS) as usize];
            *colour_of_cell = colour;
        }
    }

    /// Sets the points of a line.
    pub fn line(&mut self, start: (f64, f64), end: (f64, f64), colour: Color) {
        let (across, down) = (end.0 - start.0, end.1 - start.1);
        let steps = across.abs().max(down.abs()).ceil().clamp(1.0, 4096.0);
        for step in 0..=steps as i32 {
            let share = f64::from(step) / steps;
            let (x, y) = (start.0 + share * across, start.1 + share * down);
            self.set(x.floor() as i32, y.floor() as i32, colour);
        }
    }

    /// Writes the patterns over the present background, where `may_cover` allows it.
    pub fn draw(&self, buffer: &mut Buffer, may_cover: impl Fn(&str) -> bool) {
        for (index, (pattern, colour)) in (0..).zip(&self.cells) {
            if *pattern == 0 {
                continue;
            }
            let (row, column) = (index / self.area.width, index % self.area.width);
            let place = (self.area.x + column, self.area.y + row);
            if let Some(cell) = buffer.cell_mut(place)
                && may_cover(cell.symbol())
                && let Some(letter) = char::from_u32(0x2800 + u32::from(*pattern))
            {
                cell.set_char(letter).set_fg(*colour);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_become_patterns_and_what_is_outside_does_not() {
        let area = Rect::new(0, 0, 2, 1);
        let mut buffer = Buffer::empty(area);
        let mut dots = Dots::new(area);
        dots.line((0.5, 0.5), (3.5, 3.5), Color::Red);
        dots.line((-5.0, 9.0), (9.0, 9.0), Color::Red);
        dots.draw(&mut buffer, |_| true);
        // Points 1 and 5, then 3 and 8.
        assert_eq!(buffer.content()[0].symbol(), "\u{2811}");
        assert_eq!(buffer.content()[1].symbol(), "\u{2884}");
    }
}
