//! Pictures of areas, lines and letters, drawn as PNG or as SVG.
//!
//! A picture is a list of shapes, in the order in which they cover each other. Coordinates are
//! pixels from the upper left corner. As PNG its letters are of fixed size and need no font file.

use std::fmt::Write as _;

use embedded_graphics::Drawable;
use embedded_graphics::draw_target::DrawTarget;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::iso_8859_1::{
    FONT_6X12, FONT_9X15, FONT_9X15_BOLD, FONT_9X18, FONT_9X18_BOLD, FONT_10X20,
};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle, iso_8859_7};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::{Pixel, RgbColor};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, PremultipliedColorU8, Stroke,
    Transform,
};

/// A point: x to the right, y down.
pub type At = (f32, f32);

/// Red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Color(pub u8, pub u8, pub u8);

/// Fonts. All letters of a font are equally wide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Font {
    /// 6 × 12 pixels.
    Tiny,
    /// 9 × 15 pixels.
    Small,
    /// 9 × 15 pixels, bold.
    SmallBold,
    /// 9 × 18 pixels.
    Normal,
    /// 9 × 18 pixels, bold.
    Bold,
    /// 10 × 20 pixels.
    Large,
}

impl Font {
    /// The letters for this text: those with Greek ones among them, if it has any.
    fn bitmap(self, text: &str) -> &'static MonoFont<'static> {
        let is_greek = text.chars().any(|letter| ('Α'..='ω').contains(&letter));
        match self {
            Self::Tiny if is_greek => &iso_8859_7::FONT_6X12,
            Self::Small if is_greek => &iso_8859_7::FONT_9X15,
            Self::SmallBold if is_greek => &iso_8859_7::FONT_9X15_BOLD,
            Self::Normal if is_greek => &iso_8859_7::FONT_9X18,
            Self::Bold if is_greek => &iso_8859_7::FONT_9X18_BOLD,
            Self::Large if is_greek => &iso_8859_7::FONT_10X20,
            Self::Tiny => &FONT_6X12,
            Self::Small => &FONT_9X15,
            Self::SmallBold => &FONT_9X15_BOLD,
            Self::Normal => &FONT_9X18,
            Self::Bold => &FONT_9X18_BOLD,
            Self::Large => &FONT_10X20,
        }
    }

    /// The width of a letter, in pixels.
    #[must_use]
    pub fn width(self) -> f32 {
        self.bitmap("").character_size.width as f32
    }
}

/// Part of a text that is at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// The text begins there.
    Left,
    /// The text is centred there.
    Center,
    /// The text ends there.
    Right,
}

#[derive(Clone, Debug)]
enum Shape {
    Area(Vec<At>, Color),
    Line(Vec<At>, Color, f32),
    Ring(At, f32, Color),
    Text {
        text: String,
        /// The middle of its line.
        at: At,
        font: Font,
        color: Color,
        align: Align,
    },
}

/// A picture on white.
#[derive(Clone, Debug)]
pub struct Picture {
    width: u32,
    height: u32,
    shapes: Vec<Shape>,
}

impl Picture {
    /// A white picture of so many pixels, at least one each way.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width: width.max(1),
            height: height.max(1),
            shapes: Vec::new(),
        }
    }

    /// Fills a polygon.
    pub fn area(&mut self, corners: Vec<At>, color: Color) {
        self.shapes.push(Shape::Area(corners, color));
    }

    /// Fills a rectangle between two corners.
    pub fn rectangle(&mut self, (left, top): At, (right, bottom): At, color: Color) {
        let corners = vec![(left, top), (right, top), (right, bottom), (left, bottom)];
        self.area(corners, color);
    }

    /// Draws from point to point.
    pub fn line(&mut self, points: Vec<At>, color: Color, width: f32) {
        self.shapes.push(Shape::Line(points, color, width));
    }

    /// Draws a circle, one pixel wide.
    pub fn ring(&mut self, center: At, radius: f32, color: Color) {
        self.shapes.push(Shape::Ring(center, radius, color));
    }

    /// Writes a line of text whose middle is at this height.
    pub fn text(&mut self, text: &str, at: At, font: Font, color: Color, align: Align) {
        self.shapes.push(Shape::Text {
            text: text.to_owned(),
            at,
            font,
            color,
            align,
        });
    }

    /// Returns a PNG file. Empty if there is no memory for it.
    #[must_use]
    pub fn png(&self) -> Vec<u8> {
        let Some(mut pixels) = Pixmap::new(self.width, self.height) else {
            return Vec::new();
        };
        pixels.fill(tiny_skia::Color::WHITE);
        for shape in &self.shapes {
            draw(shape, &mut pixels);
        }
        pixels.encode_png().unwrap_or_default()
    }

    /// Returns an SVG file.
    #[must_use]
    pub fn svg(&self) -> String {
        let (width, height) = (self.width, self.height);
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        );
        for shape in &self.shapes {
            // A string takes everything.
            let _ = write_svg(shape, &mut text);
        }
        text.push_str("</svg>\n");
        text
    }
}

fn draw(shape: &Shape, pixels: &mut Pixmap) {
    let paint = |&Color(red, green, blue): &Color| {
        let mut paint = Paint::default();
        paint.set_color_rgba8(red, green, blue, 255);
        paint
    };
    let pen = |width: f32| Stroke {
        width,
        line_cap: LineCap::Butt,
        line_join: LineJoin::Bevel,
        ..Stroke::default()
    };
    let here = Transform::identity();
    match shape {
        Shape::Area(corners, color) => {
            if let Some(path) = path(corners, true) {
                pixels.fill_path(&path, &paint(color), FillRule::Winding, here, None);
            }
        }
        Shape::Line(points, color, width) => {
            if let Some(path) = path(points, false) {
                pixels.stroke_path(&path, &paint(color), &pen(*width), here, None);
            }
        }
        &Shape::Ring((x, y), radius, ref color) => {
            if let Some(path) = PathBuilder::from_circle(x, y, radius) {
                pixels.stroke_path(&path, &paint(color), &pen(1.0), here, None);
            }
        }
        &Shape::Text {
            ref text,
            at: (x, y),
            font,
            color: Color(red, green, blue),
            align,
        } => {
            let alignment = match align {
                Align::Left => Alignment::Left,
                Align::Center => Alignment::Center,
                Align::Right => Alignment::Right,
            };
            let style = TextStyleBuilder::new()
                .alignment(alignment)
                .baseline(Baseline::Middle)
                .build();
            let letters = MonoTextStyle::new(font.bitmap(text), Rgb888::new(red, green, blue));
            let at = Point::new(x.round() as i32, y.round() as i32);
            let Ok(_) = Text::with_text_style(text, at, letters, style).draw(&mut Letters(pixels));
        }
    }
}

fn path(points: &[At], is_closed: bool) -> Option<Path> {
    let mut builder = PathBuilder::new();
    let (&(x, y), rest) = points.split_first()?;
    builder.move_to(x, y);
    for &(x, y) in rest {
        builder.line_to(x, y);
    }
    if is_closed {
        builder.close();
    }
    builder.finish()
}

/// Pixels on which letters are drawn.
struct Letters<'a>(&'a mut Pixmap);

impl OriginDimensions for Letters<'_> {
    fn size(&self) -> Size {
        Size::new(self.0.width(), self.0.height())
    }
}

impl DrawTarget for Letters<'_> {
    type Color = Rgb888;
    type Error = std::convert::Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        letters: I,
    ) -> Result<(), Self::Error> {
        let (width, height) = (self.0.width(), self.0.height());
        for Pixel(at, color) in letters {
            let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y)) else {
                continue;
            };
            let opaque = PremultipliedColorU8::from_rgba(color.r(), color.g(), color.b(), 255);
            if x < width
                && y < height
                && let Some(color) = opaque
                && let Some(place) = self.0.pixels_mut().get_mut((y * width + x) as usize)
            {
                *place = color;
            }
        }
        Ok(())
    }
}

fn write_svg(shape: &Shape, svg: &mut String) -> std::fmt::Result {
    let hex = |Color(red, green, blue): Color| format!("#{red:02x}{green:02x}{blue:02x}");
    let list = |points: &[At]| {
        let points = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}"));
        points.collect::<Vec<_>>().join(" ")
    };
    match shape {
        Shape::Area(corners, color) => writeln!(
            svg,
            "<polygon points=\"{}\" fill=\"{}\"/>",
            list(corners),
            hex(*color)
        ),
        Shape::Line(points, color, width) => writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" \
             stroke-width=\"{width}\" stroke-linejoin=\"bevel\"/>",
            list(points),
            hex(*color)
        ),
        Shape::Ring((x, y), radius, color) => writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"none\" stroke=\"{}\"/>",
            hex(*color)
        ),
        Shape::Text {
            text,
            at: (x, y),
            font,
            color,
            align,
        } => {
            let anchor = match align {
                Align::Left => "start",
                Align::Center => "middle",
                Align::Right => "end",
            };
            let weight = match font {
                Font::SmallBold | Font::Bold => "bold",
                _ => "normal",
            };
            let escaped = text
                .replace('&', "&amp;")
                .replace('<', "&lt;")
                .replace('>', "&gt;");
            // The letters of common monospaced fonts are 0.6 times as wide as high.
            let size = font.width() / 0.6;
            writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" dominant-baseline=\"central\" \
                 text-anchor=\"{anchor}\" font-family=\"monospace\" \
                 font-size=\"{size:.1}\" font-weight=\"{weight}\" fill=\"{}\">{escaped}</text>",
                hex(*color)
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INK: Color = Color(10, 20, 30);

    fn picture() -> Picture {
        let mut picture = Picture::new(60, 40);
        picture.rectangle((10.0, 10.0), (20.0, 20.0), INK);
        picture.line(vec![(-5.0, 30.0), (100.0, 30.0)], INK, 2.0);
        picture.ring((40.0, 15.0), 5.0, INK);
        picture.text("<&>", (2.0, 5.0), Font::Tiny, INK, Align::Left);
        picture
    }

    #[test]
    fn a_png_has_the_pixels() {
        let pixels = Pixmap::decode_png(&picture().png()).unwrap();
        let at = |x, y| {
            let color = pixels.pixel(x, y).unwrap();
            Color(color.red(), color.green(), color.blue())
        };
        let white = Color(255, 255, 255);
        assert_eq!((pixels.width(), pixels.height()), (60, 40));
        // The line goes beyond both sides.
        for (x, y) in [(10, 10), (19, 19), (0, 30), (59, 29)] {
            assert_eq!(at(x, y), INK, "{x} {y}");
        }
        for (x, y) in [(20, 20), (9, 15), (40, 15), (30, 33)] {
            assert_eq!(at(x, y), white, "{x} {y}");
        }
        let letters = (0..10).flat_map(|y| (2..20).map(move |x| (x, y)));
        let inked = letters.filter(|&(x, y)| at(x, y) == INK).count();
        assert!((15..60).contains(&inked), "{inked}");
    }

    #[test]
    fn an_svg_has_every_shape_and_no_bare_mark_up() {
        let svg = picture().svg();
        for part in [
            "<polygon points=\"10.0,10.0 20.0,10.0 20.0,20.0 10.0,20.0\" fill=\"#0a141e\"/>",
            "<polyline points=\"-5.0,30.0 100.0,30.0\"",
            "<circle cx=\"40.0\" cy=\"15.0\" r=\"5\"",
            ">&lt;&amp;&gt;</text>",
        ] {
            assert!(svg.contains(part), "{part} is not in {svg}");
        }
        assert_eq!(svg.matches('<').count(), svg.matches('>').count());
    }

    #[test]
    fn nothing_and_points_that_are_no_numbers_are_drawn_as_nothing() {
        let mut picture = Picture::new(0, 0);
        picture.line(vec![], INK, 1.0);
        picture.line(vec![(1.0, 1.0)], INK, 1.0);
        picture.area(vec![(f32::NAN, 0.0), (1.0, f32::INFINITY)], INK);
        assert!(picture.png().starts_with(b"\x89PNG"));
    }
}
