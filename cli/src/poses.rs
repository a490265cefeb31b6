//! Picture of the poses of the accelerometer calibration: a breakout board on a table, on each of
//! its six sides.
//!
//! A parallel projection, seen from the front, the right and above. The board's axes are those
//! printed on it.

use aplomb_plot::picture::{Align, At, Color, Font, Picture};

const CELL: f32 = 250.0;
const MARGIN: f32 = 20.0;
const TITLE: f32 = 44.0;
/// Pixels per unit of length.
const SCALE: f64 = 52.0;
/// Half the size of the board along x, y and z.
const HALF: Vector = [1.15, 0.8, 0.1];
/// Half the side of the chip.
const HALF_CHIP: f64 = 0.28;
/// Direction of view, rad: to the right of the front, and above the table.
const AZIMUTH: f64 = 0.45;
const ELEVATION: f64 = 0.5;

const TEXT: Color = Color(40, 40, 40);
const FRONT: Color = Color(52, 98, 163);
const BACK: Color = Color(125, 150, 186);
const EDGE: Color = Color(36, 70, 118);
const CHIP: Color = Color(30, 30, 34);
const MARK: Color = Color(235, 235, 235);
const TABLE: Color = Color(240, 237, 230);
const AXES: [Color; 3] = [Color(200, 40, 40), Color(20, 140, 60), Color(235, 140, 0)];

type Vector = [f64; 3];

/// Pose: its name, an explanation, and the directions of the board's x, y and z in a world of
/// right, away, up.
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

/// Poses in the order in which the firmware asks for them.
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

/// Draws the picture.
pub fn draw() -> Picture {
    let (width, height) = (3.0 * CELL + 2.0 * MARGIN, 2.0 * CELL + TITLE + MARGIN);
    let mut picture = Picture::new(width as u32, height as u32);
    let title = "Lay the sensor still in each position, in any order; a few degrees off do no harm";
    picture.text(title, (MARGIN, 22.0), Font::SmallBold, TEXT, Align::Left);
    for (index, pose) in POSES.iter().enumerate() {
        let (column, row) = ((index % 3) as f32, (index / 3) as f32);
        let corner = (MARGIN + column * CELL, TITLE + row * CELL);
        draw_pose(&mut picture, index + 1, pose, corner);
    }
    picture
}

fn draw_pose(picture: &mut Picture, number: usize, pose: &Pose, corner: At) {
    // The board stands on the table: its lowest point is at height zero.
    let height = (0..3)
        .map(|axis| HALF[axis] * pose.axes[axis][2].abs())
        .sum::<f64>();
    let centre = (corner.0 + CELL / 2.0, corner.1 + 160.0);
    let at = |board: Vector| project(pose, board, height, centre);
    let corners = [(-1.5, -1.1), (1.5, -1.1), (1.5, 1.1), (-1.5, 1.1)];
    let table = corners.map(|(x, y)| flat([x, y, 0.0], centre));
    picture.area(table.to_vec(), TABLE);
    // Arrows that point away from the viewer are behind the board.
    let is_in_front = |axis: usize| dot(pose.axes[axis], viewer()) > 0.0;
    for axis in (0..3).filter(|axis| !is_in_front(*axis)) {
        arrow(picture, axis, &at);
    }
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            if sign * dot(pose.axes[axis], viewer()) <= 0.0 {
                continue;
            }
            let color = match (axis, sign > 0.0) {
                (2, true) => FRONT,
                (2, false) => BACK,
                _ => EDGE,
            };
            let across = [HALF[(axis + 1) % 3], HALF[(axis + 2) % 3]];
            let side = face(axis, sign * HALF[axis], across);
            picture.area(side.map(at).to_vec(), color);
            if axis == 2 && sign > 0.0 {
                let chip = face(2, HALF[2], [HALF_CHIP; 2]);
                picture.area(chip.map(at).to_vec(), CHIP);
                let mark = face(2, HALF[2], [0.05; 2]).map(|[x, y, z]| [x - 0.18, y + 0.18, z]);
                picture.area(mark.map(at).to_vec(), MARK);
            }
        }
    }
    for axis in (0..3).filter(|axis| is_in_front(*axis)) {
        arrow(picture, axis, &at);
    }
    let (x, y) = (corner.0 + CELL / 2.0, corner.1 + CELL - 28.0);
    let name = format!("{number}  {}", pose.name);
    picture.text(&name, (x, y), Font::SmallBold, TEXT, Align::Center);
    picture.text(pose.hint, (x, y + 17.0), Font::Small, TEXT, Align::Center);
}

/// Returns the corners of a rectangle across an axis at this distance, by its half sizes along the
/// next two axes.
fn face(axis: usize, distance: f64, [first, second]: [f64; 2]) -> [Vector; 4] {
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| {
        let mut corner = [0.0; 3];
        corner[axis] = distance;
        corner[(axis + 1) % 3] = a * first;
        corner[(axis + 2) % 3] = b * second;
        corner
    })
}

/// Draws an arrow along an axis of the board, from its surface.
fn arrow(picture: &mut Picture, axis: usize, at: &impl Fn(Vector) -> At) {
    let along = |length: f64| {
        let mut point = [0.0; 3];
        point[axis] = length;
        at(point)
    };
    let (start, end) = (HALF[axis], HALF[axis] + 0.55);
    picture.line(vec![along(start), along(end)], AXES[axis], 3.0);
    let (tip, base) = (along(end + 0.12), along(end - 0.08));
    let across = ((base.1 - tip.1) / 2.0, (tip.0 - base.0) / 2.0);
    let head = vec![
        tip,
        (base.0 + across.0, base.1 + across.1),
        (base.0 - across.0, base.1 - across.1),
    ];
    picture.area(head, AXES[axis]);
    let name = ["x", "y", "z"][axis];
    picture.text(
        name,
        along(end + 0.35),
        Font::SmallBold,
        AXES[axis],
        Align::Center,
    );
}

/// Projects a point of the board.
fn project(pose: &Pose, board: Vector, height: f64, centre: At) -> At {
    let mut world =
        [0, 1, 2].map(|row| (0..3).map(|axis| pose.axes[axis][row] * board[axis]).sum());
    world[2] += height;
    flat(world, centre)
}

/// Projects a point of the world onto a picture with this centre.
fn flat(world: Vector, centre: At) -> At {
    let right = [AZIMUTH.cos(), AZIMUTH.sin(), 0.0];
    let [vx, vy, vz] = viewer();
    let up = [
        vy * right[2] - vz * right[1],
        vz * right[0] - vx * right[2],
        vx * right[1] - vy * right[0],
    ];
    let pixels = |direction: Vector| (SCALE * dot(world, direction)) as f32;
    (centre.0 + pixels(right), centre.1 - pixels(up))
}

/// Returns the direction from the scene to the viewer.
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
            // The picture and the guide agree on the axis that points up.
            let up = asked.up();
            let height: f64 = [up.x, up.y, up.z]
                .into_iter()
                .zip(pose.axes)
                .map(|(part, axis)| f64::from(part) * axis[2])
                .sum();
            assert_eq!(height, 1.0, "{}", pose.name);
            // The axes are right-handed.
            let [[xx, xy, xz], [yx, yy, yz], z] = pose.axes;
            let cross = [xy * yz - xz * yy, xz * yx - xx * yz, xx * yy - xy * yx];
            assert_eq!(cross, z, "{}", pose.name);
        }
    }

    #[test]
    fn the_picture_is_small() {
        let picture = draw().png();
        assert!(
            (2_000..100_000).contains(&picture.len()),
            "{}",
            picture.len()
        );
    }
}
