//! A screen as a picture, for the README: each cell with its letter, block or Braille pattern.

use embedded_graphics::mono_font::iso_8859_1::FONT_10X20;
use embedded_graphics::mono_font::iso_8859_7;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, PrimitiveStyle, Rectangle, Triangle};
use embedded_graphics::text::Alignment;
use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};

use crate::plot::Canvas;

/// A cell's size, pixels: that of the font.
const CELL: Size = Size::new(10, 20);
/// The letters' base line, from the upper edge.
const BASE_LINE: i32 = 15;
/// Around the whole.
const MARGIN: i32 = 10;

const BACKGROUND: Rgb888 = Rgb888::new(24, 24, 28);
const FOREGROUND: Rgb888 = Rgb888::new(208, 208, 208);

/// The picture as a PNG file.
pub fn png(screen: &Buffer) -> Result<Vec<u8>, png::EncodingError> {
    let area = screen.area;
    let pixels = |cells: u16, size: u32| i32::from(cells) * size as i32 + 2 * MARGIN;
    let (width, height) = (
        pixels(area.width, CELL.width),
        pixels(area.height, CELL.height),
    );
    let mut canvas = Canvas::new(width, height);
    let whole = Size::new(width.unsigned_abs(), height.unsigned_abs());
    fill(&mut canvas, Point::zero(), whole, BACKGROUND);
    for position in area.positions() {
        let column = i32::from(position.x - area.x) * CELL.width as i32;
        let row = i32::from(position.y - area.y) * CELL.height as i32;
        let corner = Point::new(MARGIN + column, MARGIN + row);
        draw(&mut canvas, &screen[position], corner);
    }
    canvas.png()
}

fn draw(canvas: &mut Canvas, cell: &Cell, corner: Point) {
    let colour = rgb(cell.fg).unwrap_or(FOREGROUND);
    fill(canvas, corner, CELL, rgb(cell.bg).unwrap_or(BACKGROUND));
    let (width, height) = (CELL.width, CELL.height);
    let centre = corner + Point::new(width as i32 / 2, height as i32 / 2);
    let style = PrimitiveStyle::with_fill(colour);
    let Some(symbol) = cell.symbol().chars().next() else {
        return;
    };
    match symbol {
        ' ' => {}
        // Lower parts of a block, in eighths; then left parts.
        '▁'..='█' => {
            let part = height * (symbol as u32 - '▁' as u32 + 1) / 8;
            let top = corner + Point::new(0, (height - part) as i32);
            fill(canvas, top, Size::new(width, part), colour);
        }
        '▉'..='▏' => {
            let part = width * ('▏' as u32 - symbol as u32 + 1) / 8;
            fill(canvas, corner, Size::new(part, height), colour);
        }
        '\u{2800}'..='\u{28FF}' => {
            let pattern = symbol as u32 - 0x2800;
            // Points 1, 2, 3, 7 are on the left and 4, 5, 6, 8 on the right.
            for (bit, (x, y)) in (0..).zip([
                (0, 0),
                (0, 1),
                (0, 2),
                (1, 0),
                (1, 1),
                (1, 2),
                (0, 3),
                (1, 3),
            ]) {
                if pattern >> bit & 1 == 1 {
                    let at = corner + Point::new(5 * x, 1 + 5 * y);
                    fill(canvas, at, Size::new(4, 4), colour);
                }
            }
        }
        '─' => fill(
            canvas,
            centre - Point::new(5, 0),
            Size::new(width, 1),
            colour,
        ),
        '━' => fill(
            canvas,
            centre - Point::new(5, 2),
            Size::new(width, 4),
            colour,
        ),
        '●' => {
            let Ok(()) = Circle::with_center(centre, 9)
                .into_styled(style)
                .draw(canvas);
        }
        '◆' => {
            let right = centre + Point::new(5, 0);
            let left = centre - Point::new(5, 0);
            for tip in [-6, 6] {
                let tip = centre + Point::new(0, tip);
                let Ok(()) = Triangle::new(left, tip, right)
                    .into_styled(style)
                    .draw(canvas);
            }
        }
        '▲' => {
            let (left, right) = (centre + Point::new(-5, 5), centre + Point::new(5, 5));
            let Ok(()) = Triangle::new(left, centre - Point::new(0, 6), right)
                .into_styled(style)
                .draw(canvas);
        }
        _ => {
            let is_greek = ('Α'..='ω').contains(&symbol);
            let font = if is_greek {
                &iso_8859_7::FONT_10X20
            } else {
                &FONT_10X20
            };
            // There is no bold font of this size: it is drawn twice.
            let strokes = if cell.modifier.contains(Modifier::BOLD) {
                2
            } else {
                1
            };
            for stroke in 0..strokes {
                let at = corner + Point::new(stroke, BASE_LINE);
                canvas.text(cell.symbol(), at, Alignment::Left, font, colour);
            }
        }
    }
}

fn fill(canvas: &mut Canvas, corner: Point, size: Size, colour: Rgb888) {
    let Ok(()) = canvas.fill_solid(&Rectangle::new(corner, size), colour);
}

/// The colour of a number as terminals have it (xterm): a cube of 6 × 6 × 6, then 24 greys.
fn rgb(colour: Color) -> Option<Rgb888> {
    let Color::Indexed(number) = colour else {
        return None;
    };
    let level = |step: u8| if step == 0 { 0 } else { 55 + 40 * step };
    match number {
        0..16 => None,
        16..232 => {
            let place = number - 16;
            Some(Rgb888::new(
                level(place / 36),
                level(place / 6 % 6),
                level(place % 6),
            ))
        }
        232.. => {
            let grey = 8 + 10 * (number - 232);
            Some(Rgb888::new(grey, grey, grey))
        }
    }
}
