//! A body that is laid down in one pose after the other, as in the calibration of an
//! accelerometer.

use super::Motion;
use super::geometry::Quaternion;
use super::truth::Truth;
use super::turn::Turn;

/// Time to lay the body down in its next pose, s.
const TURN_S: f64 = 1.0;

/// Poses with the times at which the body begins to turn into them. It starts level.
///
/// Turning accelerates nothing: the body turns about its sensor.
#[derive(Clone, Debug)]
pub struct Poses {
    turns: Vec<(f64, Turn)>,
}

impl Poses {
    /// The body lies level, and from each time on, in seconds, it is turned into the pose beside
    /// it, body → earth.
    #[must_use]
    pub fn new(poses: &[(f64, Quaternion)]) -> Self {
        let mut before = Quaternion::IDENTITY;
        let turns = poses
            .iter()
            .map(|&(at_s, pose)| {
                let turn = Turn::new(before, pose, TURN_S);
                before = pose;
                (at_s, turn)
            })
            .collect();
        Self { turns }
    }

    /// The twelve poses of a calibration, of which the first is level: the six sides, then six
    /// poses halfway between sides. Each is held for `period_s`, its turn included.
    #[must_use]
    pub fn twelve(period_s: f64) -> Self {
        // Roll and pitch, degrees.
        let degrees = [
            [180.0, 0.0],
            [90.0, 0.0],
            [-90.0, 0.0],
            [0.0, 90.0],
            [0.0, -90.0],
            [45.0, 0.0],
            [-45.0, 0.0],
            [0.0, 45.0],
            [0.0, -45.0],
            [135.0, 20.0],
            [-135.0, -20.0],
        ];
        let poses = degrees.map(|angles: [f64; 2]| {
            let [roll, pitch] = angles.map(f64::to_radians);
            Quaternion::from_euler(roll, pitch, 0.0)
        });
        let times = (1..).map(|nth| f64::from(nth) * period_s);
        Self::new(&times.zip(poses).collect::<Vec<_>>())
    }
}

impl Motion for Poses {
    fn at(&mut self, time_s: f64) -> Truth {
        let turn = self.turns.iter().rev().find(|(at_s, _)| *at_s <= time_s);
        let (attitude, body_rates_rad_s) = match turn {
            None => (Quaternion::IDENTITY, [0.0; 3]),
            Some((at_s, turn)) => turn.at(time_s - at_s),
        };
        Truth::turning(attitude, body_rates_rad_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::geometry::norm;
    use crate::motion::truth::{STANDARD_GRAVITY_M_S2, inclination_error_rad};

    #[test]
    fn it_lies_in_every_pose_and_turns_in_between() {
        let right = Quaternion::from_euler(1.5, 0.0, 0.0);
        let nose_down = Quaternion::from_euler(0.0, -1.5, 0.3);
        let mut poses = Poses::new(&[(2.0, right), (5.0, nose_down)]);
        for (time_s, pose) in [
            (0.0, Quaternion::IDENTITY),
            (1.9, Quaternion::IDENTITY),
            (3.0, right),
            (4.9, right),
            (6.0, nose_down),
            (60.0, nose_down),
        ] {
            let truth = poses.at(time_s);
            assert!(
                inclination_error_rad(truth.attitude.unwrap(), pose) < 1e-9,
                "{time_s}"
            );
            assert_eq!(truth.body_rates_rad_s, [0.0; 3]);
            assert!((norm(truth.specific_force_m_s2) - STANDARD_GRAVITY_M_S2).abs() < 1e-12);
        }
        for time_s in [2.5, 5.5] {
            assert!(norm(poses.at(time_s).body_rates_rad_s) > 1.0, "{time_s}");
        }
    }
}
