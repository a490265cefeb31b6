//! Scale and cross-axis terms of the gyroscope, from the turns between the rests of a recording.

use aplomb::attitude::Vector3;
use aplomb::calibration::accelerometer::{AccelerometerFit, MIN_CROSS_AXIS_POSES};
use aplomb::calibration::gyroscope::{
    GyroscopeFit, GyroscopeFitError, TurnCollector, TurnIntegrator,
};
use aplomb::calibration::{Matrix3, NoiseModel, StationaryMean};
use aplomb::console::command::Command;

use super::samples::Sample;

/// Smallest angle between the poses before and after a turn that counts: cosine of 35°, so that
/// the gyroscope's error leaves it above the fit's 30°.
const LEAST_TURN_COSINE: f32 = 0.819;
/// Smallest product of two axes of a pose halfway between them, which is up to 0.5.
const LEAST_EDGE: f32 = 0.25;

/// Turns between the rests so far.
pub struct Turns {
    integrator: TurnIntegrator,
    collector: TurnCollector,
    /// Accelerometer's mean in the last rest, counts.
    last_rest: Option<Vector3>,
    /// Number of turns with a gap or a full-scale rate.
    lost: usize,
    /// Number of turns that the gyroscope shows too short or too long.
    misfit: usize,
}

impl Turns {
    /// Creates an empty collection, for counts of this scale.
    pub fn new(noise: &NoiseModel) -> Self {
        Self {
            integrator: TurnIntegrator::new(noise),
            collector: TurnCollector::new(),
            last_rest: None,
            lost: 0,
            misfit: 0,
        }
    }

    /// Adds a sample.
    pub fn update(&mut self, sample: &Sample) {
        let t_us = sample.t_us.cast_unsigned();
        self.integrator.update(sample.raw.gyroscope.0, t_us);
    }

    /// Ends the turn at this rest.
    pub fn finish(&mut self, at_rest: &StationaryMean) {
        let force = at_rest.accelerometer_counts;
        let is_turn = self.last_rest.replace(force).is_some_and(|before| {
            force.dot(before) < LEAST_TURN_COSINE * force.norm() * before.norm()
        });
        let is_lost = self.integrator.is_waiting();
        match self.integrator.finish(at_rest) {
            Some(turn) => self.collector.add(&turn),
            None if is_turn && is_lost => self.lost += 1,
            None if is_turn => self.misfit += 1,
            None => {}
        }
    }

    /// Fits the matrix. The error is the reason why there is none.
    pub fn fit(
        &self,
        accelerometer: &AccelerometerFit,
        poses: &[Vector3],
    ) -> Result<GyroscopeFit, String> {
        if !accelerometer.has_cross_axis {
            return Err(match accelerometer.poses {
                0..MIN_CROSS_AXIS_POSES => {
                    "it needs the accelerometer's cross-axis terms: nine poses at least".into()
                }
                _ => format!(
                    "it needs the accelerometer's cross-axis terms: lay it also halfway between {}",
                    missing_edges(poses)
                ),
            });
        }
        let fit = self.collector.fit(&accelerometer.correction);
        fit.map_err(|error| {
            let mut text = error.to_string();
            if error == GyroscopeFitError::Implausible {
                text += " Or an axis has the wrong sign, or two are exchanged";
            }
            if self.lost > 0 {
                text += &format!(
                    "; {} with a gap of more than 25 ms or a full-scale rate: record at \
                     100 Hz or more, and turn it more slowly",
                    self.lost
                );
            }
            if self.misfit > 0 {
                text += &format!(
                    "; {} shorter than 30° or longer than 720° by the gyroscope: turn it \
                     straight from pose to pose, or is the range wrong?",
                    self.misfit
                );
            }
            text
        })
    }
}

/// Returns the pairs of axes that no pose lies halfway between.
fn missing_edges(poses: &[Vector3]) -> String {
    let shows = |edge: fn(&Vector3) -> f32| {
        let is_shown = |pose: &Vector3| edge(pose).abs() > LEAST_EDGE * pose.dot(*pose);
        poses.iter().any(is_shown)
    };
    let pairs = [
        ("x and y", shows(|pose| pose.x * pose.y)),
        ("x and z", shows(|pose| pose.x * pose.z)),
        ("y and z", shows(|pose| pose.y * pose.z)),
    ];
    let missing = pairs.iter().filter(|(_, is_shown)| !is_shown);
    let missing: Vec<&str> = missing.map(|(pair, _)| *pair).collect();
    match missing[..] {
        [] => "two sides, with other edges down".to_owned(),
        _ => missing.join(", "),
    }
}

/// Appends the result to the report, with the command that sets it on the board.
pub fn describe(found: &Result<GyroscopeFit, String>, report: &mut String) {
    match found {
        Ok(fit) => {
            let command = Command::GyroscopeMatrix(fit.matrix.to_ten_thousandths());
            *report += &format!("{fit}\non the board: {command}\n");
        }
        Err(reason) => *report += &format!("gyroscope scale not found: {reason}\n"),
    }
}

/// Calibration of the gyroscope in the form of the JSON.
#[derive(serde::Serialize)]
pub struct GyroscopeSummary {
    turns: usize,
    matrix: [[f32; 3]; 3],
    residual_before_deg: f32,
    residual_after_deg: f32,
}

impl GyroscopeSummary {
    pub fn of(fit: &GyroscopeFit) -> Self {
        let Matrix3 { rows } = fit.matrix;
        Self {
            turns: fit.turns,
            matrix: rows.map(|row| [row.x, row.y, row.z]),
            residual_before_deg: fit.residual_before_rad.to_degrees(),
            residual_after_deg: fit.residual_after_rad.to_degrees(),
        }
    }
}

#[cfg(test)]
mod tests {
    use aplomb::calibration::accelerometer::Pose;

    use super::*;

    #[test]
    fn the_missing_edges_are_named() {
        let mut poses: Vec<Vector3> = Pose::GUIDE.iter().take(6).map(|pose| pose.up()).collect();
        assert_eq!(missing_edges(&poses), "x and y, x and z, y and z");
        poses.push(Vector3::new(0.7, -0.7, 0.0));
        assert_eq!(missing_edges(&poses), "x and z, y and z");
        poses.extend(Pose::GUIDE.map(Pose::up));
        assert_eq!(missing_edges(&poses), "two sides, with other edges down");
    }
}
