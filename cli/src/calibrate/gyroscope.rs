//! Scale and cross-axis terms of the gyroscope, from the turns between the rests of a recording.

use aplomb::calibration::accelerometer::AccelerometerFit;
use aplomb::calibration::gyroscope::{GyroscopeFit, TurnCollector, TurnIntegrator};
use aplomb::calibration::{Matrix3, NoiseModel, StationaryMean};
use aplomb::console::command::Command;

use super::samples::Sample;

/// Turns between the rests so far.
pub struct Turns {
    integrator: TurnIntegrator,
    collector: TurnCollector,
    /// Number of rests.
    rests: usize,
    /// Number of turns with a gap or a full-scale rate.
    lost: usize,
}

impl Turns {
    /// Creates an empty collection, for counts of this scale.
    pub fn new(noise: &NoiseModel) -> Self {
        Self {
            integrator: TurnIntegrator::new(noise),
            collector: TurnCollector::new(),
            rests: 0,
            lost: 0,
        }
    }

    /// Adds a sample.
    pub fn update(&mut self, sample: &Sample) {
        let t_us = sample.t_us.cast_unsigned();
        self.integrator.update(sample.raw.gyroscope.0, t_us);
    }

    /// Ends the turn at this rest.
    pub fn finish(&mut self, at_rest: &StationaryMean) {
        if self.rests > 0 && self.integrator.is_waiting() {
            self.lost += 1;
        }
        self.rests += 1;
        if let Some(turn) = self.integrator.finish(at_rest) {
            self.collector.add(&turn);
        }
    }

    /// Fits the matrix. The error is the reason why there is none.
    pub fn fit(&self, accelerometer: &AccelerometerFit) -> Result<GyroscopeFit, String> {
        if !accelerometer.has_cross_axis {
            return Err(
                "it needs the accelerometer's cross-axis terms: nine poses at least".into(),
            );
        }
        let fit = self.collector.fit(&accelerometer.correction);
        fit.map_err(|error| match self.lost {
            0 => error.to_string(),
            lost => format!(
                "{error}; {lost} have a gap of more than 25 ms or a full-scale rate: record at \
                 100 Hz or more, and turn it more slowly"
            ),
        })
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
