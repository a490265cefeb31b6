//! Calibration of the accelerometer from the rests or the nearly still moments of a recording.

use aplomb::attitude::Vector3;
use aplomb::calibration::accelerometer::{self, AccelerometerFit, FitError, Pose, PoseCollector};
use aplomb::calibration::{
    ImuReading, NoiseModel, SensorSetup, StationaryDetector, StationaryMean, StationaryProgress,
};
use aplomb::mpu6050::LowPass;

use super::gyroscope::Turns;
use super::report::Found;
use super::samples::Sample;
use super::{LEAST_ROWS, Recording};

/// Length of a rest, s. The device wants a second, which a recording made by hand seldom has.
const REST_S: f64 = 0.5;
/// Length of a nearly still moment, s: three periods of a hand's tremor (about 10 Hz) average out.
const STILL_S: f64 = 0.3;
/// Largest standard deviation of its rates about any axis, °/s.
const STILL_SPREAD_DEGREES_S: f64 = 10.0;
/// Largest angle it turns by, °. The mean force of a turn is too small: by 10⁻⁴ at 3°.
const STILL_TURN_DEGREES: f64 = 2.0;
/// Largest zero-rate offset of a gyroscope, °/s (product specification, 6.1).
const ZERO_RATE_DEGREES_S: f64 = 20.0;
/// Fewest nearly still moments: each is only nearly at rest.
const LEAST_STILL_POSES: usize = 24;
/// Fewest sides that rests show if rests are meant: the missing ones are named then.
const SIDES_OF_RESTS: usize = 3;
/// Number of sides.
const SIDES: usize = 6;
/// Largest angle from a side that still shows it: cosine of 30°.
const SIDE_COSINE: f32 = 0.866;
/// Test of a nearly still moment, for the user.
const STILL: &str = "rates that vary by at most 10 °/s, and a turn of at most 2°";

impl Recording {
    /// Finds the calibration of the accelerometer, and of the gyroscope's scale. The error is the
    /// reason why there is none.
    pub fn accelerometer(&self, report: &mut String) -> Result<Found, String> {
        let rested = self.rests();
        let error = match accelerometer::fit(rested.collector.readings()) {
            Ok(fit) => {
                rested.describe(report);
                let poses = rested.collector.readings().to_vec();
                return Ok(Found {
                    rule: "rest",
                    gyroscope: rested.turns.fit(&fit, &poses),
                    poses,
                    fit,
                });
            }
            Err(error) => error,
        };
        let why = rested.refusal(&error, self);
        let missing = missing_sides(rested.collector.readings());
        if SIDES - missing.len() >= SIDES_OF_RESTS {
            return Err(match error {
                FitError::TooFew { .. } if !missing.is_empty() => {
                    format!(
                        "{why}: lay it still on the missing sides, {}",
                        missing.join(", ")
                    )
                }
                _ => why,
            });
        }
        let still = self.still_moments();
        let fit = still.fit().map_err(|reason| format!("{why}; {reason}"))?;
        let found = Found {
            rule: "nearly_still",
            poses: still.poses,
            fit,
            gyroscope: Err("nearly still moments are no reference for turns: lay it still".into()),
        };
        found
            .check_held_out()
            .map_err(|reason| format!("{why}; {reason}"))?;
        *report += &format!(
            "{why}\ninstead: {} nearly still moments of {STILL_S} s, of {}: {STILL}\n",
            found.poses.len(),
            still.windows,
        );
        Ok(found)
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
    fn still_moments(&self) -> StillMoments {
        let per_degree_s = f64::from(self.settings.sensor.gyroscope_range.counts_per_degree_s());
        let per_g = f64::from(self.settings.sensor.accelerometer_range.counts_per_g());
        let windows = self.samples.chunks_exact(self.rows_in(STILL_S));
        let windows: Vec<Window> = windows
            .filter(|window| {
                !window
                    .windows(2)
                    .any(|pair| self.is_pause(pair[0].t_us, pair[1].t_us))
            })
            .map(|window| Window::new(window, per_degree_s, per_g))
            .collect();
        // A hand turns to and fro, so the median rate is the offset. One beyond the datasheet's is
        // a turn that goes on.
        let offset = [0, 1, 2].map(|axis| {
            let mut rates: Vec<f64> = windows
                .iter()
                .map(|window| window.degrees_s[axis])
                .collect();
            rates.sort_unstable_by(f64::total_cmp);
            let median = rates.get(rates.len() / 2).copied().unwrap_or(0.0);
            median.clamp(-ZERO_RATE_DEGREES_S, ZERO_RATE_DEGREES_S)
        });
        let still = windows
            .iter()
            .filter(|window| window.is_nearly_still(offset));
        StillMoments {
            windows: windows.len(),
            calmest_degrees_s: windows.iter().fold(f64::INFINITY, |calmest, window| {
                calmest.min(window.spread_degrees_s)
            }),
            poses: still.map(|window| window.force_g).collect(),
        }
    }
}

/// Means of a short time.
struct Window {
    degrees_s: [f64; 3],
    /// Standard deviation of the rates about the worst axis.
    spread_degrees_s: f64,
    force_g: Vector3,
    is_saturated: bool,
}

impl Window {
    fn new(samples: &[Sample], per_degree_s: f64, per_g: f64) -> Self {
        let [gyroscope, accelerometer] = [
            statistics(samples.iter().map(|sample| sample.raw.gyroscope.0)),
            statistics(samples.iter().map(|sample| sample.raw.accelerometer.0)),
        ];
        let [x, y, z] = accelerometer.mean.map(|mean| (mean / per_g) as f32);
        Self {
            degrees_s: gyroscope.mean.map(|mean| mean / per_degree_s),
            spread_degrees_s: gyroscope.sigma.into_iter().fold(0.0, f64::max) / per_degree_s,
            force_g: Vector3::new(x, y, z),
            is_saturated: samples.iter().any(|sample| {
                sample.raw.gyroscope.is_saturated() || sample.raw.accelerometer.is_saturated()
            }),
        }
    }

    /// Returns whether it hardly turns, with this offset of the gyroscope.
    fn is_nearly_still(&self, offset_degrees_s: [f64; 3]) -> bool {
        let [x, y, z] = [0, 1, 2].map(|axis| self.degrees_s[axis] - offset_degrees_s[axis]);
        let turn_degrees = STILL_S * (x * x + y * y + z * z).sqrt();
        self.spread_degrees_s <= STILL_SPREAD_DEGREES_S
            && turn_degrees <= STILL_TURN_DEGREES
            && !self.is_saturated
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
            let repeated = self.repeated;
            *report += &format!("{repeated} rests repeat a pose: used for the turns alone\n");
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
            let calmest = recording.still_moments().calmest_degrees_s;
            let most = self.moved.iter().max_by_key(|(_, number)| *number);
            let most = most.map_or(String::new(), |(reason, number)| {
                format!(" ({reason}, {number} times)")
            });
            return format!(
                "too restless for the device's rule: it never rests for {REST_S} s; \
                 in the calmest {STILL_S} s the rates vary by {calmest:.1} °/s{most}"
            );
        }
        let moved: usize = self.moved.iter().map(|(_, number)| number).sum();
        format!(
            "its {} rests of {REST_S} s are not enough: {error} \
             (moved {moved} times, {} rests repeat a pose)",
            self.rests, self.repeated
        )
    }
}

/// Returns the names of the sides that no reading shows up.
fn missing_sides(readings: &[Vector3]) -> Vec<String> {
    let is_shown = |up: Vector3| {
        let shows = |reading: &Vector3| reading.dot(up) > SIDE_COSINE * reading.norm();
        readings.iter().any(shows)
    };
    let sides = Pose::GUIDE.into_iter().take(SIDES);
    let missing = sides.filter(|side| !is_shown(side.up()));
    missing.map(|side| side.to_string()).collect()
}

/// Moments that are nearly at rest.
struct StillMoments {
    windows: usize,
    calmest_degrees_s: f64,
    poses: Vec<Vector3>,
}

impl StillMoments {
    fn fit(&self) -> Result<AccelerometerFit, String> {
        let which = format!(
            "its {} nearly still moments ({STILL}) do not serve either",
            self.poses.len(),
        );
        if self.poses.len() < LEAST_STILL_POSES {
            return Err(format!("{which}: {LEAST_STILL_POSES} are needed"));
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
