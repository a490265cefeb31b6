//! Clipping in recordings without register counts: the axis stops at a largest value.
//!
//! Register counts show saturation by themselves, values in SI units do not: the full scale is
//! unknown. A clipped axis reads its largest value again and again, and never a larger one. The
//! detector works row by row and keeps a few numbers per axis and sign, because offsets make the
//! two ends differ. A plateau needs evidence:
//!
//! - the value is one that a full scale can have: 100 °/s or 1.8 g at least;
//! - it repeats exactly, right after a step towards it of at least 0.5 % of it and eight times the
//!   resolution. The step before counts too, because clipping shortens the last one. A smooth peak
//!   slows down before it repeats a value;
//! - the last step comes from more than half of it. A turn at a constant rate, of a turntable or of
//!   a synthetic recording, starts from rest;
//! - this happens with four equal samples in a row, or twice with two.
//!
//! Then all samples at this value count as saturated. The price of working row by row: the samples
//! of the plateau before its evidence do not count, three at most after a single approach. The
//! resolution is the smallest difference so far, so a start in fast motion delays the evidence by
//! about a second. A larger value later withdraws the plateau. Clipping ahead of a filter, a
//! rotation or a misalignment matrix leaves no equal values, and stays hidden.

use std::fmt::Write as _;

use aplomb_models::motion::Vector;
use aplomb_models::motion::truth::STANDARD_GRAVITY_M_S2;

/// Smallest full scale of an accelerometer, m/s²: ±2 g with room for offset and scale.
const LEAST_FORCE_M_S2: f64 = 1.8 * STANDARD_GRAVITY_M_S2;
/// Smallest full scale of a gyroscope, rad/s: ±125 °/s with room for offset and scale.
const LEAST_RATE_RAD_S: f64 = 100.0 * std::f64::consts::PI / 180.0;
/// Smallest step onto a plateau, as a share of its value.
const LEAST_STEP: f64 = 0.005;
/// Smallest step onto a plateau, in units of the axis's resolution.
const LEAST_STEPS_OF_RESOLUTION: f64 = 8.0;
/// Equal values, as a share: the difference between text of few digits and `f32`.
const TOLERANCE: f64 = 1e-6;
/// Samples in a row that are evidence alone.
const CERTAIN_RUN: u32 = 4;
/// Approaches with two samples in a row that are evidence together.
const CERTAIN_APPROACHES: u32 = 2;

/// Saturation of one row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Saturation {
    /// An accelerometer axis is clipped.
    pub force: bool,
    /// A gyroscope axis is clipped.
    pub rate: bool,
}

/// Detector for the six axes of a recording.
#[derive(Clone, Debug)]
pub struct Plateaus {
    axes: [Axis; 6],
}

impl Default for Plateaus {
    fn default() -> Self {
        let least = |index| match index {
            0..3 => LEAST_FORCE_M_S2,
            _ => LEAST_RATE_RAD_S,
        };
        Self {
            axes: [0, 1, 2, 3, 4, 5].map(|index| Axis::new(least(index))),
        }
    }
}

impl Plateaus {
    /// Takes one row, in m/s² and rad/s, and returns which of its sensors is clipped.
    pub fn check(&mut self, force_m_s2: Vector, rates_rad_s: Vector) -> Saturation {
        let [ax, ay, az, gx, gy, gz] = &mut self.axes;
        let [force_x, force_y, force_z] = force_m_s2;
        let [rate_x, rate_y, rate_z] = rates_rad_s;
        Saturation {
            force: ax.add(force_x) | ay.add(force_y) | az.add(force_z),
            rate: gx.add(rate_x) | gy.add(rate_y) | gz.add(rate_z),
        }
    }

    /// Returns a message if any axis is clipped: sensor, axis, value and number of samples.
    #[must_use]
    pub fn message(&self) -> Option<String> {
        let mut text = String::new();
        for (index, axis) in self.axes.iter().enumerate() {
            let name = ["ax", "ay", "az", "gx", "gy", "gz"][index];
            let (sensor, scale, unit) = match index {
                0..3 => ("accelerometer", STANDARD_GRAVITY_M_S2.recip(), "g"),
                _ => ("gyroscope", 1_f64.to_degrees(), "°/s"),
            };
            for (end, sign) in axis.ends.iter().zip([1.0, -1.0]) {
                if end.is_plateau() {
                    let separator = if text.is_empty() { "" } else { "; " };
                    let _ = write!(
                        text,
                        "{separator}{sensor} {name} at {:.2} {unit} in {} samples",
                        sign * end.value * scale,
                        end.samples
                    );
                }
            }
        }
        (!text.is_empty()).then(|| {
            format!(
                "clipped: {text}. The true values are larger. These samples count as saturated: \
                 record with a larger full scale"
            )
        })
    }
}

/// One axis.
#[derive(Clone, Debug)]
struct Axis {
    least: f64,
    /// Sample before; NaN before the first.
    before: f64,
    /// Last difference between two samples; NaN before the second.
    step: f64,
    /// Smallest difference between two samples.
    resolution: f64,
    /// Upper and lower end.
    ends: [End; 2],
}

impl Axis {
    fn new(least: f64) -> Self {
        Self {
            least,
            before: f64::NAN,
            step: f64::NAN,
            resolution: f64::INFINITY,
            ends: [End::default(); 2],
        }
    }

    /// Takes the next value, and returns true if it is clipped.
    #[inline]
    fn add(&mut self, value: f64) -> bool {
        let before = std::mem::replace(&mut self.before, value);
        let step = value - before;
        let step_before = std::mem::replace(&mut self.step, step);
        if step.abs() < self.resolution && step.abs() > value.abs() * TOLERANCE {
            self.resolution = step.abs();
        }
        if value.abs() < self.least {
            return false;
        }
        let least_step = LEAST_STEPS_OF_RESOLUTION * self.resolution;
        let [upper, lower] = &mut self.ends;
        if value > 0.0 {
            upper.add(value, before, step_before, least_step)
        } else {
            lower.add(-value, -before, -step_before, least_step)
        }
    }
}

/// One end of an axis's range.
#[derive(Clone, Copy, Debug, Default)]
struct End {
    /// Largest value so far.
    value: f64,
    /// Samples at it.
    samples: u64,
    /// Samples at it in a row, up to now.
    run: u32,
    /// The run began with a step that no smooth peak has.
    is_steep: bool,
    /// Longest steep run.
    longest: u32,
    /// Steep runs of two or more.
    approaches: u32,
}

impl End {
    fn is_plateau(&self) -> bool {
        self.longest >= CERTAIN_RUN || self.approaches >= CERTAIN_APPROACHES
    }

    /// Takes a value, the one before it and the step to that, and returns true if it is clipped.
    #[cold]
    #[inline(never)]
    fn add(&mut self, value: f64, before: f64, step_before: f64, least_step: f64) -> bool {
        let margin = TOLERANCE * value;
        if value > self.value + margin {
            *self = Self {
                value,
                ..Self::default()
            };
        } else if value < self.value - margin {
            return false;
        }
        self.samples += 1;
        if before < self.value - margin {
            let step = step_before.max(value - before);
            self.run = 1;
            self.is_steep =
                before > 0.5 * value && step >= LEAST_STEP * value && step >= least_step;
        } else {
            self.run += 1;
            if self.is_steep {
                self.longest = self.longest.max(self.run);
                self.approaches += u32::from(self.run == 2);
            }
        }
        self.is_plateau()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb_models::random::Random;

    const RATE_HZ: f64 = 286.0;
    const DEGREE: f64 = std::f64::consts::PI / 180.0;

    /// Returns a minute of a swing about x: 500 °/s at 0.8 Hz, with noise, in steps of
    /// `resolution`.
    fn swing(resolution: f64) -> Vec<f64> {
        let mut random = Random::new(1, "swing");
        (0..(60.0 * RATE_HZ) as u32)
            .map(|row| {
                let phase = f64::from(row) / RATE_HZ * 0.8 * std::f64::consts::TAU;
                // It begins at rest. Then the amplitude varies, as it does by hand.
                let amplitude = if row < 358 {
                    0.0
                } else {
                    500.0 + 60.0 * libm::sin(0.037 * phase)
                };
                let rate = (amplitude * libm::sin(phase) + 0.1 * random.normal()) * DEGREE;
                (rate / resolution).round() * resolution
            })
            .collect()
    }

    fn check(rates: impl IntoIterator<Item = f64>) -> (u64, Option<String>) {
        let mut plateaus = Plateaus::default();
        let mut saturated = 0;
        for rate in rates {
            let found = plateaus.check([0.0, 0.0, 9.81], [rate, 0.1, 0.0]);
            assert!(!found.force);
            saturated += u64::from(found.rate);
        }
        (saturated, plateaus.message())
    }

    #[test]
    fn a_clipped_axis_is_found_with_its_value_and_nearly_all_its_samples() {
        let limit = 422.0 * DEGREE;
        // An offset that was removed makes the two ends differ.
        let offset = 1.5 * DEGREE;
        for resolution in [1e-3 * DEGREE, 0.061 * DEGREE] {
            let clip = |rate: f64| rate.clamp(-limit, limit) - offset;
            let clipped: Vec<f64> = swing(resolution).into_iter().map(clip).collect();
            let ends = [limit - offset, -limit - offset];
            let is_at_end = |rate: &&f64| ends.contains(*rate);
            let at_end = clipped.iter().filter(is_at_end).count() as u64;
            let (saturated, message) = check(clipped);
            assert!(
                at_end > 2_000 && saturated > at_end - 10,
                "{saturated} of {at_end}"
            );
            assert!(saturated <= at_end);
            let message = message.unwrap();
            assert!(
                message.starts_with("clipped: gyroscope gx at 420.50 °/s in "),
                "{message}"
            );
            assert!(
                message.contains("; gyroscope gx at -423.50 °/s in "),
                "{message}"
            );
        }
    }

    #[test]
    fn both_sensors_and_all_axes_are_watched() {
        for axis in 0..6 {
            let mut plateaus = Plateaus::default();
            let mut found = Saturation::default();
            for rate in swing(0.01 * DEGREE) {
                let mut values = [0.0; 6];
                // As a force: ±4 g of ±5.
                let scale = if axis < 3 {
                    5.0 * STANDARD_GRAVITY_M_S2 / (500.0 * DEGREE)
                } else {
                    1.0
                };
                values[axis] = rate.clamp(-400.0 * DEGREE, 400.0 * DEGREE) * scale;
                let [ax, ay, az, gx, gy, gz] = values;
                let now = plateaus.check([ax, ay, az], [gx, gy, gz]);
                found.force |= now.force;
                found.rate |= now.rate;
            }
            assert_eq!((found.force, found.rate), (axis < 3, axis >= 3));
            let message = plateaus.message().unwrap();
            let expected = [
                "accelerometer ax at 4.00 g",
                "accelerometer ay at 4.00 g",
                "accelerometer az at 4.00 g",
                "gyroscope gx at 400.00 °/s",
                "gyroscope gy at 400.00 °/s",
                "gyroscope gz at 400.00 °/s",
            ];
            assert!(message.contains(expected[axis]), "{message}");
        }
    }

    #[test]
    fn smooth_peaks_are_not_clipped_whatever_their_resolution() {
        // Of 16 bits at ±2000 °/s, of few decimals, and of eight bits.
        for resolution in [0.061 * DEGREE, 0.001, 0.01, 0.1, 2000.0 / 128.0 * DEGREE] {
            assert_eq!(check(swing(resolution)), (0, None), "{resolution}");
        }
        // Without noise, at 1 kHz, where a peak stays within the resolution for a while.
        for hertz in [0.1, 0.5, 2.0] {
            let sine = (0..60_000).map(|row| {
                let rate = 300.0 * libm::sin(f64::from(row) * 1e-3 * hertz * std::f64::consts::TAU);
                (rate / 0.061).round() * 0.061 * DEGREE
            });
            assert_eq!(check(sine), (0, None), "{hertz}");
        }
    }

    #[test]
    fn constant_and_switched_turns_are_not_clipped() {
        let constant = std::iter::repeat_n(200.0 * DEGREE, 10_000);
        assert_eq!(check(constant), (0, None));
        // The noise at rest shows the resolution.
        let switched = (0..10_000).map(|row| match row / 500 % 2 {
            0 => f64::from(row % 7) * 1e-3,
            _ => 200.0 * DEGREE,
        });
        assert_eq!(check(switched), (0, None));
        // No full scale is that small.
        let small = swing(0.061 * DEGREE)
            .into_iter()
            .map(|rate| rate.clamp(-1.7, 1.7));
        assert_eq!(check(small), (0, None));
    }

    #[test]
    fn a_larger_value_withdraws_a_plateau() {
        let limit = 422.0 * DEGREE;
        let clipped = swing(0.001 * DEGREE)
            .into_iter()
            .map(|rate| rate.clamp(-limit, limit));
        let mut plateaus = Plateaus::default();
        for rate in clipped {
            plateaus.check([0.0; 3], [rate, 0.0, 0.0]);
        }
        assert!(plateaus.message().is_some());
        for rate in [430.0 * DEGREE, -430.0 * DEGREE] {
            plateaus.check([0.0; 3], [rate, 0.0, 0.0]);
        }
        assert_eq!(plateaus.message(), None);
    }

    #[test]
    fn values_that_are_no_numbers_are_no_plateau() {
        let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX];
        assert_eq!(check(odd.into_iter().cycle().take(1_000)), (0, None));
    }
}
