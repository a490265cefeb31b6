//! Orientation of the sensor on the body: one of the 24 ways to put one set of right-handed axes on
//! another.
//!
//! A mount is named by where two body axes point in sensor axes: forward, then down. `+x-z` is
//! sensor X forward and sensor −Z down, the chip's face up. The matrices here are built from the
//! name and from nothing else.

use super::geometry::{Quaternion, Vector, cross, dot};

/// The fixed rotation between sensor axes and body axes. It only permutes and negates, so it is
/// exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// Forward, right and down, each as a unit vector in sensor axes: the rows of the matrix sensor
    /// → body.
    body_axes: [Vector; 3],
}

impl Mount {
    /// Chip face up, X forward: `+x-z`. The default.
    pub const Z_UP: Self = Self {
        body_axes: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
    };

    /// Parses a name such as `+x-z`, or one of the aliases `z-up` and `z-down`.
    ///
    /// `None` if it is no name, or if the two axes are not at right angles.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        let name = match name {
            "z-up" => "+x-z",
            "z-down" => "+x+z",
            other => other,
        };
        let &[forward_sign, forward_axis, down_sign, down_axis] = name.as_bytes() else {
            return None;
        };
        let forward = signed_axis(forward_sign, forward_axis)?;
        let down = signed_axis(down_sign, down_axis)?;
        if dot(forward, down) != 0.0 {
            return None;
        }
        // Adding zero turns the −0 that the products leave behind into 0.
        let right = cross(down, forward).map(|component| component + 0.0);
        Some(Self {
            body_axes: [forward, right, down],
        })
    }

    /// All 24 names.
    #[must_use]
    pub fn names() -> Vec<String> {
        let axes = ["+x", "-x", "+y", "-y", "+z", "-z"];
        axes.iter()
            .flat_map(|forward| axes.iter().map(move |down| format!("{forward}{down}")))
            .filter(|name| Self::parse(name).is_some())
            .collect()
    }

    /// A vector given in sensor axes, in body axes.
    #[must_use]
    pub fn to_body(&self, sensor: Vector) -> Vector {
        self.body_axes.map(|axis| dot(axis, sensor))
    }

    /// A vector given in body axes, in sensor axes.
    #[must_use]
    pub fn to_sensor(&self, body: Vector) -> Vector {
        [0, 1, 2].map(|column| dot([0, 1, 2].map(|row| self.body_axes[row][column]), body))
    }

    /// The rotation from body axes to sensor axes.
    #[must_use]
    pub fn body_to_sensor(&self) -> Quaternion {
        Quaternion::from_matrix(self.body_axes).conjugate()
    }
}

impl Default for Mount {
    fn default() -> Self {
        Self::Z_UP
    }
}

/// The unit vector that a sign and an axis letter name.
fn signed_axis(sign: u8, axis: u8) -> Option<Vector> {
    let value = match sign {
        b'+' => 1.0,
        b'-' => -1.0,
        _ => return None,
    };
    match axis {
        b'x' => Some([value, 0.0, 0.0]),
        b'y' => Some([0.0, value, 0.0]),
        b'z' => Some([0.0, 0.0, value]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::geometry::{norm, subtract};

    #[test]
    fn there_are_24_mounts_all_different_and_all_right_handed() {
        let names = Mount::names();
        assert_eq!(names.len(), 24);
        let mounts: Vec<Mount> = names
            .iter()
            .map(|name| Mount::parse(name).unwrap())
            .collect();
        for (index, mount) in mounts.iter().enumerate() {
            let [forward, right, down] = mount.body_axes;
            assert_eq!(cross(forward, right), down, "{}", names[index]);
            assert!(mounts[..index].iter().all(|other| other != mount));
        }
    }

    #[test]
    fn the_two_usual_mounts_are_as_documented() {
        let vector = [1.0, 2.0, 3.0];
        assert_eq!(Mount::default().to_body(vector), [1.0, -2.0, -3.0]);
        assert_eq!(Mount::parse("z-up").unwrap(), Mount::Z_UP);
        assert_eq!(Mount::parse("+x-z").unwrap(), Mount::Z_UP);
        assert_eq!(Mount::parse("z-down").unwrap().to_body(vector), vector);
        assert_eq!(Mount::parse("+x+z"), Mount::parse("z-down"));
    }

    #[test]
    fn the_name_says_where_forward_and_down_point() {
        let mount = Mount::parse("-y+x").unwrap();
        assert_eq!(mount.to_sensor([1.0, 0.0, 0.0]), [0.0, -1.0, 0.0]);
        assert_eq!(mount.to_sensor([0.0, 0.0, 1.0]), [1.0, 0.0, 0.0]);
    }

    #[test]
    fn to_sensor_undoes_to_body_exactly_and_the_quaternion_agrees() {
        let vector = [0.1, -0.25, 7.3];
        for name in Mount::names() {
            let mount = Mount::parse(&name).unwrap();
            assert_eq!(mount.to_sensor(mount.to_body(vector)), vector);
            let rotated = mount.body_to_sensor().rotate(mount.to_body(vector));
            assert!(
                norm(subtract(rotated, vector)) < 1e-12,
                "{name}: {rotated:?}"
            );
        }
    }

    #[test]
    fn what_is_no_mount_is_refused() {
        for name in [
            "", "+x", "+x+x", "+x-x", "x-z", "+x-w", "+x-z ", "z-Up", "*x-z",
        ] {
            assert_eq!(Mount::parse(name), None, "{name}");
        }
    }
}
