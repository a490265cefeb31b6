//! Picture of the accuracy: one dot for each recording, one line for each filter, one block for
//! each set.

use aplomb_plot::picture::{Align, Color, Font, Picture};
use aplomb_recordings::score::median;

use crate::recording::Reference;
use crate::results::Set;

const WIDTH: u32 = 1000;
const LEFT: f32 = 130.0;
const RIGHT: f32 = WIDTH as f32 - 30.0;
const ROW: u32 = 22;
/// Ends of the logarithmic axis, degrees.
const AXIS: (f64, f64) = (0.1, 100.0);
const GRID: [f64; 10] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];

const TEXT: Color = Color(40, 40, 40);
const FAINT: Color = Color(222, 222, 222);
const OURS: Color = Color(200, 60, 30);
const OTHERS: Color = Color(60, 100, 160);

/// Returns the picture.
pub fn picture(names: &[&str], sets: &[Set]) -> Picture {
    let block_height = ROW * (names.len() as u32 + 2);
    let mut picture = Picture::new(WIDTH, 60 + block_height * sets.len() as u32);
    let title = "Inclination error in degrees (root mean square of each recording; bar: median)";
    picture.text(title, (20.0, 24.0), Font::SmallBold, TEXT, Align::Left);
    for (index, set) in sets.iter().enumerate() {
        let top = 50 + block_height * index as u32;
        block(&mut picture, names, set, top as f32);
    }
    picture
}

/// Returns the place of an error on the axis.
fn place(degrees: f64) -> f32 {
    let (low, high) = (AXIS.0.log10(), AXIS.1.log10());
    let share = (degrees.clamp(AXIS.0, AXIS.1).log10() - low) / (high - low);
    LEFT + share as f32 * (RIGHT - LEFT)
}

fn block(picture: &mut Picture, names: &[&str], set: &Set, top: f32) {
    let row = ROW as f32;
    let bottom = top + row * (names.len() as f32 + 1.0) - 6.0;
    for degrees in GRID {
        let x = place(degrees);
        picture.line(vec![(x, top + row), (x, bottom)], FAINT, 1.0);
        let label = degrees.to_string();
        picture.text(&label, (x, bottom + 10.0), Font::Small, TEXT, Align::Center);
    }
    let title = match set.reference {
        Reference::Truth => set.name.clone(),
        Reference::Rest => format!("{}, without truth: only where it rests", set.name),
    };
    picture.text(
        &title,
        (20.0, top + 8.0),
        Font::SmallBold,
        TEXT,
        Align::Left,
    );
    for (index, (name, rms)) in names.iter().zip(&set.rms).enumerate() {
        let y = top + row * (index as f32 + 1.0) + 8.0;
        let color = if index == 0 { OURS } else { OTHERS };
        picture.text(name, (LEFT - 12.0, y), Font::Small, color, Align::Right);
        for degrees in rms {
            picture.ring((place(*degrees), y), 3.0, color);
        }
        let x = place(median(rms));
        picture.line(vec![(x, y - 8.0), (x, y + 8.0)], color, 3.0);
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
        assert!((place(1.0) - place(0.1) - (place(10.0) - place(1.0))).abs() < 1e-3);
    }
}
