//! The picture of the poses in which an accelerometer is calibrated: a breakout board on a table, on each of its six sides.
//!
//! A parallel projection, seen from the front, the right and above. The board's axes are those printed on it.

use embedded_graphics::mono_font::iso_8859_1::{FONT_9X15, FONT_9X15_BOLD};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{PrimitiveStyle, Triangle};
use embedded_graphics::text::Alignment;

use crate::plot::{Canvas, TEXT};

const CELL: (i32, i32) = (250, 250);
const MARGIN: i32 = 20;
const TITLE: i32 = 44;
/// Pixels per unit of length.
const SCALE: f64 = 52.0;
/// Half the board: along x, y and z.
const HALF: Vector = [1.15, 0.8, 0.1];
/// The chip on it, half its side, and where its mark for pin 1 is.
const HALF_CHIP: f64 = 0.28;
/// Whence it is seen, in radians: to the right of the front, and above the table.
const AZIMUTH: f64 = 0.45;
const ELEVATION: f64 = 0.5;

const FRONT: Rgb888 = Rgb888::new(52, 98, 163);
const BACK: Rgb888 = Rgb888::new(125, 150, 186);
const EDGE: Rgb888 = Rgb888::new(36, 70, 118);
const CHIP: Rgb888 = Rgb888::new(30, 30, 34);
const MARK: Rgb888 = Rgb888::new(235, 235, 235);
const TABLE: Rgb888 = Rgb888::new(240, 237, 230);
const AXES: [Rgb888; 3] = [
    Rgb888::new(200, 40, 40),
    Rgb888::new(20, 140, 60),
    Rgb888::new(235, 140, 0),
];

type Vector = [f64; 3];

/// A pose: its name, what that means, and where the board's x, y and z point; the world is right, away, up.
struct Pose {
    name: &'static str,
    hint: &'static str,
    axes: [Vector; 3],
}

const RIGHT: Vector = [1.0, 0.0, 0.0];
const LEFT: Vector = [-1.0, 0.0, 0.0];
const AWAY: Vector = [0.0, 1.0, 0.0];
const TOWARDS: Vector = [0.0, -1.0, 0.0];
const UP: Vector = [0.0, 0.0, 1.0];
const DOWN: Vector = [0.0, 0.0, -1.0];

/// In the order in which the firmware asks for them.
const POSES: [Pose; 6] = [
    pose("z up", "flat, chip up", [RIGHT, AWAY, UP]),
    pose("z down", "flat, chip down", [RIGHT, TOWARDS, DOWN]),
    pose("x up", "on edge, x arrow up", [UP, LEFT, TOWARDS]),
    pose("x down", "on edge, x arrow down", [DOWN, RIGHT, TOWARDS]),
    pose("y up", "on edge, y arrow up", [RIGHT, UP, TOWARDS]),
    pose("y down", "on edge, y arrow down", [LEFT, DOWN, TOWARDS]),
];

const fn pose(name: &'static str, hint: &'static str, axes: [Vector; 3]) -> Pose {
    Pose { name, hint, axes }
}

/// The picture as a PNG file.
pub fn draw() -> Result<Vec<u8>, png::EncodingError> {
    let mut canvas = Canvas::new(3 * CELL.0 + 2 * MARGIN, 2 * CELL.1 + TITLE + MARGIN);
    canvas.text(
        "Lay the sensor still in each position, in any order; a few degrees off do no harm",
        Point::new(MARGIN, 26),
        Alignment::Left,
        &FONT_9X15_BOLD,
        TEXT,
    );
    for (index, pose) in (0..).zip(&POSES) {
        let corner = Point::new(MARGIN + index % 3 * CELL.0, TITLE + index / 3 * CELL.1);
        draw_pose(&mut canvas, index + 1, pose, corner);
    }
    canvas.png()
}

fn draw_pose(canvas: &mut Canvas, number: i32, pose: &Pose, corner: Point) {
    // The board stands on the table: its lowest point is at height zero.
    let height = (0..3)
        .map(|axis| HALF[axis] * pose.axes[axis][2].abs())
        .sum::<f64>();
    let centre = corner + Point::new(CELL.0 / 2, 160);
    let at = |board: Vector| project(pose, board, height, centre);
    let on_table = |x: f64, y: f64| centre + flat([x, y, 0.0]);
    quad(
        canvas,
        [
            on_table(-1.5, -1.1),
            on_table(1.5, -1.1),
            on_table(1.5, 1.1),
            on_table(-1.5, 1.1),
        ],
        TABLE,
    );
    // What points away from the viewer is behind the board.
    let is_in_front = |axis: usize| dot(pose.axes[axis], viewer()) > 0.0;
    for axis in (0..3).filter(|axis| !is_in_front(*axis)) {
        arrow(canvas, axis, &at);
    }
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            if sign * dot(pose.axes[axis], viewer()) <= 0.0 {
                continue;
            }
            let colour = match (axis, sign > 0.0) {
                (2, true) => FRONT,
                (2, false) => BACK,
                _ => EDGE,
            };
            quad(
                canvas,
                face(
                    axis,
                    sign * HALF[axis],
                    [HALF[(axis + 1) % 3], HALF[(axis + 2) % 3]],
                )
                .map(at),
                colour,
            );
            if axis == 2 && sign > 0.0 {
                quad(canvas, face(2, HALF[2], [HALF_CHIP; 2]).map(at), CHIP);
                let mark = face(2, HALF[2], [0.05; 2]).map(|[x, y, z]| [x - 0.18, y + 0.18, z]);
                quad(canvas, mark.map(at), MARK);
            }
        }
    }
    for axis in (0..3).filter(|axis| is_in_front(*axis)) {
        arrow(canvas, axis, &at);
    }
    let below = corner + Point::new(CELL.0 / 2, CELL.1 - 24);
    canvas.text(
        &format!("{number}  {}", pose.name),
        below,
        Alignment::Center,
        &FONT_9X15_BOLD,
        TEXT,
    );
    canvas.text(
        pose.hint,
        below + Point::new(0, 17),
        Alignment::Center,
        &FONT_9X15,
        TEXT,
    );
}

/// The corners of a rectangle across an axis at this distance, so large along the two axes that follow it.
fn face(axis: usize, distance: f64, [first, second]: [f64; 2]) -> [Vector; 4] {
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| {
        let mut corner = [0.0; 3];
        corner[axis] = distance;
        corner[(axis + 1) % 3] = a * first;
        corner[(axis + 2) % 3] = b * second;
        corner
    })
}

/// An arrow along an axis of the board, from its surface.
fn arrow(canvas: &mut Canvas, axis: usize, at: &impl Fn(Vector) -> Point) {
    let along = |length: f64| {
        let mut point = [0.0; 3];
        point[axis] = length;
        at(point)
    };
    let (start, end) = (HALF[axis], HALF[axis] + 0.55);
    canvas.line(along(start), along(end), AXES[axis], 3);
    let (tip, base) = (along(end + 0.12), along(end - 0.08));
    let across = (tip - base) / 2;
    let across = Point::new(-across.y, across.x);
    let head = PrimitiveStyle::with_fill(AXES[axis]);
    let Ok(()) = Triangle::new(tip, base + across, base - across)
        .into_styled(head)
        .draw(canvas);
    let letter = along(end + 0.35) + Point::new(0, 5);
    let name = ["x", "y", "z"][axis];
    canvas.text(name, letter, Alignment::Center, &FONT_9X15_BOLD, AXES[axis]);
}

fn quad(canvas: &mut Canvas, [a, b, c, d]: [Point; 4], colour: Rgb888) {
    let style = PrimitiveStyle::with_fill(colour);
    for triangle in [Triangle::new(a, b, c), Triangle::new(a, c, d)] {
        let Ok(()) = triangle.into_styled(style).draw(canvas);
    }
}

/// Where a point of the board is on the picture.
fn project(pose: &Pose, board: Vector, height: f64, centre: Point) -> Point {
    let mut world =
        [0, 1, 2].map(|row| (0..3).map(|axis| pose.axes[axis][row] * board[axis]).sum());
    world[2] += height;
    centre + flat(world)
}

/// A point of the world from the centre of the picture.
fn flat(world: Vector) -> Point {
    let right = [AZIMUTH.cos(), AZIMUTH.sin(), 0.0];
    let [vx, vy, vz] = viewer();
    let up = [
        vy * right[2] - vz * right[1],
        vz * right[0] - vx * right[2],
        vx * right[1] - vy * right[0],
    ];
    let pixels = |direction: Vector| (SCALE * dot(world, direction)).round() as i32;
    Point::new(pixels(right), -pixels(up))
}

/// The direction from the scene to the viewer.
fn viewer() -> Vector {
    [
        AZIMUTH.sin() * ELEVATION.cos(),
        -AZIMUTH.cos() * ELEVATION.cos(),
        ELEVATION.sin(),
    ]
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use aplomb::calibration::accelerometer::Pose as Asked;

    use super::*;

    #[test]
    fn the_picture_shows_what_the_firmware_asks_for() {
        for (pose, asked) in POSES.iter().zip(Asked::GUIDE) {
            assert_eq!(pose.name, asked.to_string());
            // What points up in the picture is what the guide has up.
            let up = asked.up();
            let height: f64 = [up.x, up.y, up.z]
                .into_iter()
                .zip(pose.axes)
                .map(|(part, axis)| f64::from(part) * axis[2])
                .sum();
            assert_eq!(height, 1.0, "{}", pose.name);
            // And the axes are right-handed.
            let [[xx, xy, xz], [yx, yy, yz], z] = pose.axes;
            let cross = [xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx];
            assert_eq!(cross, z, "{}", pose.name);
        }
    }

    #[test]
    fn the_picture_is_small() {
        let picture = draw().expect("a picture");
        assert!(
            (2_000..100_000).contains(&picture.len()),
            "{}",
            picture.len()
        );
    }
}
