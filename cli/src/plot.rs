//! The picture of `aplomb bench`: one dot for each recording, one line for each filter, one block for each set.

use std::convert::Infallible;

use embedded_graphics::mono_font::iso_8859_1::{FONT_9X15, FONT_9X15_BOLD};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, PrimitiveStyle, Rectangle};
use embedded_graphics::text::{Alignment, Text};

use crate::bench::Set;
use crate::recording::Reference;
use crate::score::median;

const WIDTH: i32 = 1000;
const LEFT: i32 = 130;
const RIGHT: i32 = WIDTH - 30;
const ROW: i32 = 22;
/// The axis is logarithmic, from here to there, in degrees.
const AXIS: (f64, f64) = (0.1, 100.0);
const GRID: [f64; 10] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];

/// The colour of letters.
pub const TEXT: Rgb888 = Rgb888::new(40, 40, 40);
const FAINT: Rgb888 = Rgb888::new(222, 222, 222);
const OURS: Rgb888 = Rgb888::new(200, 60, 30);
const OTHERS: Rgb888 = Rgb888::new(60, 100, 160);

/// The picture as a PNG file.
pub fn accuracy(names: &[&str], sets: &[Set]) -> Result<Vec<u8>, png::EncodingError> {
    let block = ROW * (names.len() as i32 + 2);
    let mut canvas = Canvas::new(WIDTH, 60 + block * sets.len() as i32);
    let title = "Inclination error in degrees (root mean square of each recording; bar: median)";
    canvas.text(
        title,
        Point::new(20, 28),
        Alignment::Left,
        &FONT_9X15_BOLD,
        TEXT,
    );
    for (index, set) in sets.iter().enumerate() {
        let top = 50 + block * index as i32;
        canvas.block(names, set, top);
    }
    canvas.png()
}

/// Where an error lies on the axis.
fn place(degrees: f64) -> i32 {
    let (low, high) = (AXIS.0.log10(), AXIS.1.log10());
    let share = (degrees.clamp(AXIS.0, AXIS.1).log10() - low) / (high - low);
    LEFT + (share * f64::from(RIGHT - LEFT)).round() as i32
}

/// A picture in memory.
pub struct Canvas {
    size: Size,
    /// Red, green and blue, row by row.
    pixels: Vec<u8>,
}

impl Canvas {
    /// A white picture.
    pub fn new(width: i32, height: i32) -> Self {
        let size = Size::new(width.unsigned_abs(), height.unsigned_abs());
        Self {
            size,
            pixels: vec![255; (3 * size.width * size.height) as usize],
        }
    }

    fn block(&mut self, names: &[&str], set: &Set, top: i32) {
        let bottom = top + ROW * (names.len() as i32 + 1) - 6;
        for degrees in GRID {
            let x = place(degrees);
            self.line(Point::new(x, top + ROW), Point::new(x, bottom), FAINT, 1);
            let below = Point::new(x, bottom + 14);
            self.text(
                &degrees.to_string(),
                below,
                Alignment::Center,
                &FONT_9X15,
                TEXT,
            );
        }
        let title = match set.reference {
            Reference::Truth => set.name.clone(),
            Reference::Rest => format!("{}, without truth: only where it rests", set.name),
        };
        self.text(
            &title,
            Point::new(20, top + 12),
            Alignment::Left,
            &FONT_9X15_BOLD,
            TEXT,
        );
        for (index, (name, rms)) in names.iter().zip(&set.rms).enumerate() {
            let y = top + ROW * (index as i32 + 1) + 8;
            let colour = if index == 0 { OURS } else { OTHERS };
            self.text(
                name,
                Point::new(LEFT - 12, y + 4),
                Alignment::Right,
                &FONT_9X15,
                colour,
            );
            for degrees in rms {
                let dot = Circle::with_center(Point::new(place(*degrees), y), 7);
                let style = PrimitiveStyle::with_stroke(colour, 1);
                let Ok(()) = dot.into_styled(style).draw(self);
            }
            let x = place(median(rms));
            self.line(Point::new(x, y - 8), Point::new(x, y + 8), colour, 3);
        }
    }

    /// Draws a straight line.
    pub fn line(&mut self, start: Point, end: Point, colour: Rgb888, width: u32) {
        let style = PrimitiveStyle::with_stroke(colour, width);
        let Ok(()) = Line::new(start, end).into_styled(style).draw(self);
    }

    /// Writes a text; `at` is on its base line.
    pub fn text(
        &mut self,
        text: &str,
        at: Point,
        alignment: Alignment,
        font: &MonoFont<'_>,
        colour: Rgb888,
    ) {
        let style = MonoTextStyle::new(font, colour);
        let Ok(_) = Text::with_alignment(text, at, style, alignment).draw(self);
    }

    /// The picture so many times smaller, each pixel the mean of those it covers.
    pub fn reduced(&self, factor: u32) -> Self {
        let size = self.size / factor;
        let mut pixels = Vec::with_capacity((3 * size.width * size.height) as usize);
        for y in 0..size.height {
            for x in 0..size.width {
                for colour in 0..3 {
                    let covered = (0..factor * factor).map(|nth| {
                        let (x, y) = (factor * x + nth % factor, factor * y + nth / factor);
                        let place = 3 * (y * self.size.width + x) + colour;
                        u32::from(self.pixels[place as usize])
                    });
                    pixels.push((covered.sum::<u32>() / (factor * factor)) as u8);
                }
            }
        }
        Self { size, pixels }
    }

    /// As a PNG file.
    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.size.width, self.size.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(&self.pixels)?;
        Ok(file)
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        self.size
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        let area = Rectangle::new(Point::zero(), self.size);
        for Pixel(point, colour) in pixels {
            if area.contains(point) {
                let start = 3
                    * (point.y.unsigned_abs() * self.size.width + point.x.unsigned_abs()) as usize;
                let bytes = [colour.r(), colour.g(), colour.b()];
                self.pixels[start..start + 3].copy_from_slice(&bytes);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_lie_on_a_logarithmic_axis() {
        assert_eq!(place(0.1), LEFT);
        assert_eq!(place(100.0), RIGHT);
        assert_eq!(place(0.001), LEFT);
        assert_eq!(place(1.0) - place(0.1), place(10.0) - place(1.0));
    }

    #[test]
    fn a_smaller_picture_has_the_mean_of_the_pixels() {
        let mut canvas = Canvas::new(6, 4);
        let Ok(()) = canvas.draw_iter([Pixel(Point::new(0, 0), Rgb888::new(55, 255, 255))]);
        let small = canvas.reduced(2);
        assert_eq!(small.size, Size::new(3, 2));
        assert_eq!(small.pixels[..4], [205, 255, 255, 255]);
    }

    #[test]
    fn what_is_outside_is_not_drawn() {
        let mut canvas = Canvas::new(10, 10);
        canvas.line(Point::new(-50, 5), Point::new(50, 5), TEXT, 1);
        let drawn = canvas
            .pixels
            .iter()
            .filter(|byte| **byte == TEXT.r())
            .count();
        assert_eq!(drawn, 30);
    }
}
