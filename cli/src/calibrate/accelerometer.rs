//! Calibration of the accelerometer from the rests or the slow moments of a recording.

use aplomb::attitude::Vector3;
use aplomb::calibration::accelerometer::{self, AccelerometerFit, FitError, PoseCollector};
use aplomb::calibration::{
    ImuReading, NoiseModel, SensorSetup, StationaryDetector, StationaryMean, StationaryProgress,
};
use aplomb::mpu6050::LowPass;

use super::gyroscope::Turns;
use super::report::Found;
use super::{LEAST_ROWS, Recording};

/// Length of a rest, s. The device wants a second, which a recording made by hand seldom has.
const REST_S: f64 = 0.5;
/// Length of a slow moment, s: three periods of a hand's tremor (about 10 Hz) average out.
const SLOW_S: f64 = 0.3;
/// Largest spread of a slow moment's rates (standard deviation of the worst axis), °/s.
const SLOW_SPREAD_DEGREES_S: f64 = 10.0;
/// Fewest slow moments: each is only nearly at rest.
const LEAST_SLOW_POSES: usize = 24;

impl Recording {
    /// Finds the calibration of the accelerometer, and of the gyroscope's scale. The error is the
    /// reason why there is none.
    pub fn accelerometer(&self, report: &mut String) -> Result<Found, String> {
        let rested = self.rests();
        let error = match accelerometer::fit(rested.collector.readings()) {
            Ok(fit) => {
                rested.describe(report);
                return Ok(Found {
                    rule: "rest",
                    poses: rested.collector.readings().to_vec(),
                    fit,
                    gyroscope: rested.turns.fit(&fit),
                });
            }
            Err(error) => error,
        };
        let slow = self.slow_moments();
        let why = rested.refusal(&error, self);
        let fit = slow.fit().map_err(|reason| format!("{why}; {reason}"))?;
        *report += &format!(
            "{why}\ninstead: {} slow moments of {SLOW_S} s with a gyroscope spread of at most \
             {SLOW_SPREAD_DEGREES_S} °/s, of {}\n",
            slow.poses.len(),
            slow.windows,
        );
        Ok(Found {
            rule: "slow",
            poses: slow.poses,
            fit,
            gyroscope: Err("slow moments are no reference for turns: lay it still".to_owned()),
        })
    }

    fn rows_in(&self, seconds: f64) -> usize {
        ((seconds * 1e6 / self.step_us as f64) as usize).clamp(LEAST_ROWS, usize::from(u16::MAX))
    }

    /// Returns the rests by the device's rule.
    fn rests(&self) -> Rested {
        let sensor = &self.settings.sensor;
        let noise = NoiseModel::new(&SensorSetup {
            gyroscope_counts_per_degree_s: sensor.gyroscope_range.counts_per_degree_s(),
            accelerometer_counts_per_g: sensor.accelerometer_range.counts_per_g(),
            // The log does not name its filter; the widest one has the most noise.
            gyroscope_bandwidth_hz: LowPass::Hertz256.gyroscope_bandwidth_hz().into(),
            accelerometer_bandwidth_hz: LowPass::Hertz256.accelerometer_bandwidth_hz().into(),
            sample_rate_hz: 1e6 / self.step_us as f32,
        });
        let rows = self.rows_in(REST_S) as u16;
        let mut detector = StationaryDetector::new(&noise, rows);
        let mut rested = Rested {
            collector: PoseCollector::new(&noise),
            turns: Turns::new(&noise),
            rests: 0,
            repeated: 0,
            refused: Vec::new(),
            moved: Vec::new(),
            taken: Vec::new(),
        };
        let mut last_us = None;
        for sample in &self.samples {
            let before_us = last_us.replace(sample.t_us);
            if before_us.is_some_and(|before_us| self.is_pause(before_us, sample.t_us)) {
                detector = StationaryDetector::new(&noise, rows);
            }
            rested.turns.update(sample);
            let reading = ImuReading {
                gyroscope: sample.raw.gyroscope.0,
                accelerometer: sample.raw.accelerometer.0,
                temperature_celsius: sample.raw.temperature.to_celsius(self.settings.part),
            };
            match detector.update(&reading) {
                StationaryProgress::Collecting => {}
                StationaryProgress::Moved(reason) => count(&mut rested.moved, &reason.to_string()),
                StationaryProgress::Done(mean) => rested.take(sample.t_us, &mean),
            }
        }
        rested
    }

    /// Returns the moments in which the specific force is nearly gravity.
    fn slow_moments(&self) -> SlowMoments {
        let per_degree_s = f64::from(self.settings.sensor.gyroscope_range.counts_per_degree_s());
        let per_g = f64::from(self.settings.sensor.accelerometer_range.counts_per_g());
        let mut slow = SlowMoments {
            windows: 0,
            calmest_degrees_s: f64::INFINITY,
            poses: Vec::new(),
        };
        for window in self.samples.chunks_exact(self.rows_in(SLOW_S)) {
            slow.windows += 1;
            let [gyroscope, accelerometer] = [
                statistics(window.iter().map(|sample| sample.raw.gyroscope.0)),
                statistics(window.iter().map(|sample| sample.raw.accelerometer.0)),
            ];
            let spread = gyroscope.sigma.iter().copied().fold(0.0, f64::max) / per_degree_s;
            slow.calmest_degrees_s = slow.calmest_degrees_s.min(spread);
            let is_saturated = window.iter().any(|sample| {
                sample.raw.gyroscope.is_saturated() || sample.raw.accelerometer.is_saturated()
            });
            if spread <= SLOW_SPREAD_DEGREES_S && !is_saturated {
                let [x, y, z] = accelerometer.mean.map(|mean| (mean / per_g) as f32);
                slow.poses.push(Vector3::new(x, y, z));
            }
        }
        slow
    }
}

struct Statistics {
    mean: [f64; 3],
    sigma: [f64; 3],
}

fn statistics(counts: impl Iterator<Item = [i16; 3]> + Clone) -> Statistics {
    let number = counts.clone().count().max(1) as f64;
    let mean = [0, 1, 2].map(|axis| {
        counts
            .clone()
            .map(|counts| f64::from(counts[axis]))
            .sum::<f64>()
            / number
    });
    let sigma = [0, 1, 2].map(|axis| {
        let squares = counts
            .clone()
            .map(|counts| (f64::from(counts[axis]) - mean[axis]).powi(2));
        (squares.sum::<f64>() / number).sqrt()
    });
    Statistics { mean, sigma }
}

/// Rests by the device's rule.
struct Rested {
    collector: PoseCollector,
    turns: Turns,
    rests: usize,
    repeated: usize,
    refused: Vec<(String, usize)>,
    moved: Vec<(String, usize)>,
    taken: Vec<String>,
}

impl Rested {
    fn take(&mut self, t_us: i64, mean: &StationaryMean) {
        self.rests += 1;
        self.turns.finish(mean);
        match self.collector.add(mean) {
            Ok(accepted) => {
                let pose = accepted
                    .pose
                    .map_or_else(|| "between sides".to_owned(), |pose| pose.to_string());
                self.taken.push(format!(
                    "pose {} at {:.1} s: {pose}",
                    accepted.count,
                    t_us as f64 * 1e-6
                ));
            }
            Err(accelerometer::PoseError::Repeated { .. }) => self.repeated += 1,
            Err(reason) => count(&mut self.refused, &reason.to_string()),
        }
    }

    fn describe(&self, report: &mut String) {
        for line in &self.taken {
            *report += line;
            *report += "\n";
        }
        if self.repeated > 0 {
            *report += &format!("refused {} rests: a pose again\n", self.repeated);
        }
        for (reason, number) in &self.refused {
            *report += &format!("refused {number} rests: {reason}\n");
        }
        for (reason, number) in &self.moved {
            *report += &format!("not at rest {number} times: {reason}\n");
        }
    }

    /// Returns why the device's rule finds no calibration.
    fn refusal(&self, error: &FitError, recording: &Recording) -> String {
        if self.rests == 0 {
            let calmest = recording.slow_moments().calmest_degrees_s;
            let most = self.moved.iter().max_by_key(|(_, number)| *number);
            let most = most.map_or(String::new(), |(reason, number)| {
                format!(" ({reason}, {number} times)")
            });
            return format!(
                "too restless for the device's rule: it never rests for {REST_S} s; \
                 in the calmest {SLOW_S} s the gyroscope spreads by {calmest:.1} °/s{most}"
            );
        }
        let moved: usize = self.moved.iter().map(|(_, number)| number).sum();
        format!(
            "its {} rests of {REST_S} s are not enough: {error} \
             (moved {moved} times, a pose again {} times)",
            self.rests, self.repeated
        )
    }
}

/// Moments that are nearly at rest.
struct SlowMoments {
    windows: usize,
    calmest_degrees_s: f64,
    poses: Vec<Vector3>,
}

impl SlowMoments {
    fn fit(&self) -> Result<AccelerometerFit, String> {
        let which = format!(
            "its {} slow moments (gyroscope spread of at most {SLOW_SPREAD_DEGREES_S} °/s \
             for {SLOW_S} s) do not serve either",
            self.poses.len(),
        );
        if self.poses.len() < LEAST_SLOW_POSES {
            return Err(format!("{which}: {LEAST_SLOW_POSES} are needed"));
        }
        accelerometer::fit(&self.poses).map_err(|error| format!("{which}: {error}"))
    }
}

fn count(counts: &mut Vec<(String, usize)>, reason: &str) {
    match counts.iter_mut().find(|(known, _)| known == reason) {
        Some((_, number)) => *number += 1,
        None => counts.push((reason.to_owned(), 1)),
    }
}
