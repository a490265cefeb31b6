//! A screen as a picture, for the README: each cell with its letter, block or Braille pattern.

use aplomb_plot::picture::{Align, At, Color, Font, Picture};
use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color as CellColor, Modifier};

/// Size of a cell, pixels: that of the font.
const CELL: (f32, f32) = (10.0, 20.0);
/// Margin, pixels.
const MARGIN: f32 = 10.0;

const BACKGROUND: Color = Color(24, 24, 28);
const FOREGROUND: Color = Color(208, 208, 208);

/// Draws the picture.
pub fn picture(screen: &Buffer) -> Picture {
    let area = screen.area;
    let width = f32::from(area.width) * CELL.0 + 2.0 * MARGIN;
    let height = f32::from(area.height) * CELL.1 + 2.0 * MARGIN;
    let mut picture = Picture::new(width as u32, height as u32);
    picture.rectangle((0.0, 0.0), (width, height), BACKGROUND);
    for position in area.positions() {
        let corner = (
            MARGIN + f32::from(position.x - area.x) * CELL.0,
            MARGIN + f32::from(position.y - area.y) * CELL.1,
        );
        draw(&mut picture, &screen[position], corner);
    }
    picture
}

fn draw(picture: &mut Picture, cell: &Cell, (left, top): At) {
    let color = rgb(cell.fg).unwrap_or(FOREGROUND);
    let (width, height) = CELL;
    let (right, bottom) = (left + width, top + height);
    let (x, y) = (left + width / 2.0, top + height / 2.0);
    if let Some(background) = rgb(cell.bg) {
        picture.rectangle((left, top), (right, bottom), background);
    }
    let Some(symbol) = cell.symbol().chars().next() else {
        return;
    };
    match symbol {
        ' ' => {}
        // Lower parts of a block, in eighths; then left parts.
        '▁'..='█' => {
            let part = height * (symbol as u32 - '▁' as u32 + 1) as f32 / 8.0;
            picture.rectangle((left, bottom - part), (right, bottom), color);
        }
        '▉'..='▏' => {
            let part = width * ('▏' as u32 - symbol as u32 + 1) as f32 / 8.0;
            picture.rectangle((left, top), (left + part, bottom), color);
        }
        '\u{2800}'..='\u{28FF}' => {
            let pattern = symbol as u32 - 0x2800;
            // Points 1, 2, 3, 7 are on the left and 4, 5, 6, 8 on the right.
            const POINTS: [At; 8] = [
                (0.0, 0.0),
                (0.0, 1.0),
                (0.0, 2.0),
                (1.0, 0.0),
                (1.0, 1.0),
                (1.0, 2.0),
                (0.0, 3.0),
                (1.0, 3.0),
            ];
            for (bit, (column, row)) in POINTS.into_iter().enumerate() {
                if pattern >> bit & 1 == 1 {
                    let (left, top) = (left + 5.0 * column, top + 1.0 + 5.0 * row);
                    picture.rectangle((left, top), (left + 4.0, top + 4.0), color);
                }
            }
        }
        '─' => picture.line(vec![(left, y), (right, y)], color, 1.0),
        '━' => picture.line(vec![(left, y), (right, y)], color, 4.0),
        '●' => {
            let corner = |step: u8| {
                let angle = f32::from(step) * std::f32::consts::TAU / 24.0;
                (x + 4.5 * angle.cos(), y + 4.5 * angle.sin())
            };
            picture.area((0..24).map(corner).collect(), color);
        }
        '◆' => picture.area(
            vec![(left, y), (x, y - 6.0), (right, y), (x, y + 6.0)],
            color,
        ),
        '▲' => picture.area(vec![(left, y + 5.0), (x, y - 6.0), (right, y + 5.0)], color),
        _ => {
            // No bold font of this size exists: the letter is drawn twice.
            let strokes = if cell.modifier.contains(Modifier::BOLD) {
                2
            } else {
                1
            };
            for stroke in 0..strokes {
                let at = (left + stroke as f32, y);
                picture.text(cell.symbol(), at, Font::Large, color, Align::Left);
            }
        }
    }
}

/// Returns the color of a number as in terminals (xterm): a cube of 6 × 6 × 6, then 24 greys.
fn rgb(color: CellColor) -> Option<Color> {
    let CellColor::Indexed(number) = color else {
        return None;
    };
    let level = |step: u8| if step == 0 { 0 } else { 55 + 40 * step };
    match number {
        0..16 => None,
        16..232 => {
            let place = number - 16;
            Some(Color(
                level(place / 36),
                level(place / 6 % 6),
                level(place % 6),
            ))
        }
        232.. => {
            let grey = 8 + 10 * (number - 232);
            Some(Color(grey, grey, grey))
        }
    }
}
