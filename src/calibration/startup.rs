//! The average at rest: what the gyroscope reads when nothing turns.
//!
//! The sums are integer and exact. While they grow, windows of [`WINDOW`] samples are checked for
//! signs of motion; any of them restarts the average:
//!
//! - a gyroscope or accelerometer axis that spreads too far within a window,
//! - a window whose mean differs from the first window's (a slow turn shows in the accelerometer),
//! - a gyroscope mean that no zero-rate offset explains (a fast steady turn about the vertical),
//! - an accelerometer mean that is not about one g (free fall, a sensor that returns zeros).
//!
//! One motion looks exactly like rest to these six sensors: a steady turn about the vertical, slower
//! than the zero-rate offset that the datasheet allows. It ends up in the offset.

use crate::attitude::Vector3;

/// Samples per window: 0.1 s at 1 kHz, in which a window's mean has a noise of about 0.01 °/s and
/// 1 mg (product specification §6.1, §6.2).
const WINDOW: u16 = 100;

/// Widest spread of a gyroscope axis at rest, in °/s: about 25 times the noise of the widest filter
/// (0.005 °/s/√Hz over 256 Hz), so that a poor clone passes and a hand does not.
const GYROSCOPE_SPREAD_DEGREES_S: f32 = 2.0;
/// Widest spread of an accelerometer axis at rest, in g: 25 times the noise (400 µg/√Hz over 260 Hz)
/// and still less than a knock on the table.
const ACCELEROMETER_SPREAD_G: f32 = 0.2;
/// How far a window's gyroscope mean may lie from the first window's, in °/s.
const GYROSCOPE_DRIFT_DEGREES_S: f32 = 0.5;
/// How far a window's accelerometer mean may lie from the first window's, in g: a tilt of 1.1°, which
/// a turn of 1.3 °/s about a level axis makes in the default average.
const ACCELEROMETER_DRIFT_G: f32 = 0.02;
/// Zero-rate offset at 25 °C, in °/s (product specification §6.1).
const ZERO_RATE_DEGREES_S: f32 = 20.0;
/// What temperature may add to it from 25 °C to either end of its range, in °/s and °C (ibidem).
const ZERO_RATE_TEMPERATURE_DEGREES_S: f32 = 20.0;
const ZERO_RATE_TEMPERATURE_RANGE_CELSIUS: f32 = 60.0;
/// For the sensitivity's own 3 % and the noise, in °/s.
const ZERO_RATE_TOLERANCE_DEGREES_S: f32 = 1.0;
/// What the accelerometer's mean may measure at rest, in g: 80 mg of offset on each axis and 3 % of
/// sensitivity (product specification §6.2) make 0.17 of error.
const LEAST_GRAVITY_G: f32 = 0.8;
const MOST_GRAVITY_G: f32 = 1.2;

/// The largest sum, 65535 samples of −32768, fits its integer.
const _: () = assert!((u16::MAX as i64) * (i16::MIN as i64) >= i32::MIN as i64);

/// The scales that turn the limits above into counts.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StartupScale {
    /// Gyroscope counts per °/s.
    pub counts_per_degree_s: f32,
    /// Accelerometer counts per g.
    pub counts_per_g: f32,
}

/// The mean readings at rest, in counts along the sensor's axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AtRest {
    /// The gyroscope's zero-rate offset.
    pub gyroscope_counts: Vector3,
    /// The accelerometer's mean: gravity, as mounted and as tilted, plus its offset.
    pub accelerometer_counts: Vector3,
}

/// What a sample did to the average.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Progress {
    /// It joined; more are needed.
    Averaging,
    /// It completed a window in which the sensor moved: everything so far is thrown away.
    Moved,
    /// It was the last one.
    Done(AtRest),
}

/// The running average. After [`Progress::Done`] it starts over.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StartupAverage {
    samples: u16,
    scale: StartupScale,
    count: u16,
    gyroscope_sum: [i32; 3],
    accelerometer_sum: [i32; 3],
    window: Window,
    first_window: Option<AtRest>,
}

impl StartupAverage {
    /// An average of `samples` samples (none counts as one).
    pub const fn new(samples: u16, scale: StartupScale) -> Self {
        Self {
            samples: if samples == 0 { 1 } else { samples },
            scale,
            count: 0,
            gyroscope_sum: [0; 3],
            accelerometer_sum: [0; 3],
            window: Window::EMPTY,
            first_window: None,
        }
    }

    /// Takes one sample, in counts along the sensor's axes, with the die temperature in °C.
    pub fn update(
        &mut self,
        gyroscope: [i16; 3],
        accelerometer: [i16; 3],
        temperature_celsius: f32,
    ) -> Progress {
        self.window.add(gyroscope, accelerometer);
        let is_last = self.window.count >= self.samples - self.count;
        if self.window.count < WINDOW && !is_last {
            return Progress::Averaging;
        }

        let window_mean = self.window.mean();
        if self.has_moved(&window_mean, temperature_celsius) {
            self.restart();
            return Progress::Moved;
        }
        self.first_window.get_or_insert(window_mean);
        self.count += self.window.count;
        self.gyroscope_sum = add(self.gyroscope_sum, self.window.gyroscope.sum);
        self.accelerometer_sum = add(self.accelerometer_sum, self.window.accelerometer.sum);
        self.window = Window::EMPTY;
        if !is_last {
            return Progress::Averaging;
        }

        let at_rest = AtRest {
            gyroscope_counts: mean(self.gyroscope_sum, self.count),
            accelerometer_counts: mean(self.accelerometer_sum, self.count),
        };
        self.restart();
        Progress::Done(at_rest)
    }

    fn restart(&mut self) {
        *self = Self::new(self.samples, self.scale);
    }

    fn has_moved(&self, mean: &AtRest, temperature_celsius: f32) -> bool {
        let degree_s = self.scale.counts_per_degree_s;
        let g = self.scale.counts_per_g;
        let Window {
            count,
            gyroscope,
            accelerometer,
        } = &self.window;

        let is_still = gyroscope
            .spread()
            .is_within(GYROSCOPE_SPREAD_DEGREES_S * degree_s)
            && accelerometer.spread().is_within(ACCELEROMETER_SPREAD_G * g);
        let is_offset = mean
            .gyroscope_counts
            .is_within(zero_rate_limit_degrees_s(temperature_celsius) * degree_s);
        let gravity_squared = mean.accelerometer_counts.dot(mean.accelerometer_counts) / (g * g);
        let is_gravity = (LEAST_GRAVITY_G * LEAST_GRAVITY_G..=MOST_GRAVITY_G * MOST_GRAVITY_G)
            .contains(&gravity_squared);
        // A short last window has too much noise of its own to be compared.
        let is_steady = *count < WINDOW / 2
            || self.first_window.is_none_or(|first| {
                (mean.gyroscope_counts - first.gyroscope_counts)
                    .is_within(GYROSCOPE_DRIFT_DEGREES_S * degree_s)
                    && (mean.accelerometer_counts - first.accelerometer_counts)
                        .is_within(ACCELEROMETER_DRIFT_G * g)
            });
        !(is_still && is_offset && is_gravity && is_steady)
    }
}

/// The largest zero-rate offset the datasheet allows at this temperature, in °/s.
fn zero_rate_limit_degrees_s(temperature_celsius: f32) -> f32 {
    let away = (temperature_celsius - 25.0).abs() / ZERO_RATE_TEMPERATURE_RANGE_CELSIUS;
    ZERO_RATE_DEGREES_S
        + ZERO_RATE_TEMPERATURE_DEGREES_S * away.min(1.0)
        + ZERO_RATE_TOLERANCE_DEGREES_S
}

/// Sums and extremes of the samples since the last check.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Window {
    count: u16,
    gyroscope: Axes,
    accelerometer: Axes,
}

impl Window {
    const EMPTY: Self = Self {
        count: 0,
        gyroscope: Axes::EMPTY,
        accelerometer: Axes::EMPTY,
    };

    fn add(&mut self, gyroscope: [i16; 3], accelerometer: [i16; 3]) {
        self.count += 1;
        self.gyroscope.add(gyroscope);
        self.accelerometer.add(accelerometer);
    }

    fn mean(&self) -> AtRest {
        AtRest {
            gyroscope_counts: mean(self.gyroscope.sum, self.count),
            accelerometer_counts: mean(self.accelerometer.sum, self.count),
        }
    }
}

/// Sum, least and greatest of each axis.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Axes {
    sum: [i32; 3],
    least: [i16; 3],
    greatest: [i16; 3],
}

impl Axes {
    const EMPTY: Self = Self {
        sum: [0; 3],
        least: [i16::MAX; 3],
        greatest: [i16::MIN; 3],
    };

    fn add(&mut self, counts: [i16; 3]) {
        self.sum = add(self.sum, counts.map(i32::from));
        self.least = zip(self.least, counts, i16::min);
        self.greatest = zip(self.greatest, counts, i16::max);
    }

    /// Greatest minus least, in counts.
    fn spread(&self) -> Vector3 {
        let [x, y, z] = zip(self.greatest, self.least, |greatest, least| {
            (i32::from(greatest) - i32::from(least)) as f32
        });
        Vector3::new(x, y, z)
    }
}

fn zip<A, B, C>([ax, ay, az]: [A; 3], [bx, by, bz]: [B; 3], f: impl Fn(A, B) -> C) -> [C; 3] {
    [f(ax, bx), f(ay, by), f(az, bz)]
}

fn add(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    zip(a, b, |a, b| a + b)
}

/// Sum over count. The sum is exact, so this is within one rounding of the exact mean's own.
fn mean([x, y, z]: [i32; 3], count: u16) -> Vector3 {
    let count = f32::from(count.max(1));
    Vector3::new(x as f32 / count, y as f32 / count, z as f32 / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ±250 °/s and ±2 g.
    const FINE: StartupScale = StartupScale {
        counts_per_degree_s: 131.0,
        counts_per_g: 16384.0,
    };
    /// ±2000 °/s and ±16 g, the default.
    const COARSE: StartupScale = StartupScale {
        counts_per_degree_s: 16.4,
        counts_per_g: 2048.0,
    };
    const LEVEL: [i16; 3] = [0, 0, 2048];

    /// A small generator of noise, uniform in ±`amplitude` counts.
    struct Noise(u32);

    impl Noise {
        fn next(&mut self, amplitude: i16) -> i16 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let span = i32::from(amplitude) * 2 + 1;
            ((self.0 >> 8) as i32 % span - i32::from(amplitude)) as i16
        }
    }

    /// Feeds samples until something other than `Averaging` comes; its index and itself.
    fn first_event(
        average: &mut StartupAverage,
        mut sample: impl FnMut(u32) -> ([i16; 3], [i16; 3]),
    ) -> (u32, Progress) {
        for index in 0..100_000 {
            let (gyroscope, accelerometer) = sample(index);
            match average.update(gyroscope, accelerometer, 25.0) {
                Progress::Averaging => {}
                event => return (index, event),
            }
        }
        panic!("nothing happened");
    }

    #[test]
    fn the_classic_example_has_the_offset_minus_158_25() {
        // The readings have tenths, so a count here is a tenth of theirs.
        let tenths = [
            -1584, -1729, -1342, -1551, -1312, -1468, -1731, -1886, -1427, -1795,
        ];
        let scale = StartupScale {
            counts_per_degree_s: 10.0 * FINE.counts_per_degree_s,
            ..FINE
        };
        let mut average = StartupAverage::new(10, scale);
        let (index, event) = first_event(&mut average, |index| {
            ([tenths[index as usize], 0, 0], [0, 0, -16384])
        });
        assert_eq!(index, 9);
        let Progress::Done(at_rest) = event else {
            panic!("{event:?}");
        };
        assert_eq!(at_rest.gyroscope_counts, Vector3::new(-1582.5, 0.0, 0.0));
        assert_eq!(at_rest.gyroscope_counts.x / 10.0, -158.25);
        // Face down, the classic accelerometer offset is the mean plus one g.
        assert_eq!(at_rest.accelerometer_counts.z + 16384.0, 0.0);
    }

    #[test]
    fn noise_of_the_sensor_is_rest_and_is_averaged_exactly() {
        let mut noise = Noise(1);
        let (mut gyroscope_sum, mut accelerometer_sum) = ([0_i64; 3], [0_i64; 3]);
        let mut average = StartupAverage::new(1000, COARSE);
        let (index, event) = first_event(&mut average, |_| {
            // About the real noise: 1.5 and 17 counts, here with wider tails; offsets of 12 °/s.
            let gyroscope = [200, -150, 7].map(|offset| offset + noise.next(5));
            let accelerometer = [40, -60, 2100].map(|mean| mean + noise.next(50));
            for axis in 0..3 {
                gyroscope_sum[axis] += i64::from(gyroscope[axis]);
                accelerometer_sum[axis] += i64::from(accelerometer[axis]);
            }
            (gyroscope, accelerometer)
        });
        assert_eq!(index, 999);
        let Progress::Done(at_rest) = event else {
            panic!("{event:?}");
        };
        let [gyroscope, accelerometer] = [gyroscope_sum, accelerometer_sum]
            .map(|sum| sum.map(|sum| (sum as f64 / 1000.0) as f32))
            .map(|[x, y, z]| Vector3::new(x, y, z));
        assert_eq!(at_rest.gyroscope_counts, gyroscope);
        assert_eq!(at_rest.accelerometer_counts, accelerometer);
    }

    #[test]
    fn a_short_movement_restarts_the_average_at_the_end_of_its_window() {
        let mut average = StartupAverage::new(1000, COARSE);
        // 10 °/s on one sample out of a thousand.
        let bump = |index: u32| ([if index == 640 { 164 } else { 0 }, 0, 0], LEVEL);
        assert_eq!(first_event(&mut average, bump), (699, Progress::Moved));
        // From here on a full average is needed again.
        let (index, event) = first_event(&mut average, |_| ([3, 0, 0], LEVEL));
        assert_eq!(index, 999);
        let Progress::Done(at_rest) = event else {
            panic!("{event:?}");
        };
        assert_eq!(at_rest.gyroscope_counts, Vector3::new(3.0, 0.0, 0.0));
    }

    #[test]
    fn a_movement_in_the_short_last_window_counts_too() {
        let mut average = StartupAverage::new(110, COARSE);
        let bump = |index: u32| ([if index == 105 { 164 } else { 0 }, 0, 0], LEVEL);
        assert_eq!(first_event(&mut average, bump), (109, Progress::Moved));
    }

    #[test]
    fn a_knock_shows_in_the_accelerometer() {
        let mut average = StartupAverage::new(1000, COARSE);
        let knock = |index: u32| ([0; 3], [0, 0, if index == 10 { 2600 } else { 2048 }]);
        assert_eq!(first_event(&mut average, knock), (99, Progress::Moved));
    }

    #[test]
    fn a_slow_turn_about_a_level_axis_shows_in_the_accelerometer() {
        for degrees_s in [3.0_f32, 10.0, 19.0] {
            let mut average = StartupAverage::new(1000, COARSE);
            let (index, event) = first_event(&mut average, |index| {
                let angle = (degrees_s * index as f32 * 1e-3).to_radians();
                let force = [
                    0,
                    (2048.0 * angle.sin()) as i16,
                    (2048.0 * angle.cos()) as i16,
                ];
                ([(degrees_s * 16.4) as i16, 0, 0], force)
            });
            assert_eq!(event, Progress::Moved, "{degrees_s}");
            assert!(index < 999, "{degrees_s}");
        }
    }

    #[test]
    fn a_turn_that_begins_is_not_an_offset() {
        // 1 °/s about the vertical, from the middle on: the accelerometer sees nothing.
        let mut average = StartupAverage::new(1000, COARSE);
        let turn = |index: u32| ([0, 0, if index < 500 { 0 } else { 16 }], LEVEL);
        assert_eq!(first_event(&mut average, turn), (599, Progress::Moved));
    }

    #[test]
    fn a_steady_turn_is_an_offset_only_within_the_datasheet() {
        let at = |degrees_s: f32, celsius: f32| {
            let mut average = StartupAverage::new(100, COARSE);
            let counts = (degrees_s * COARSE.counts_per_degree_s) as i16;
            let mut last = Progress::Averaging;
            for _ in 0..100 {
                last = average.update([0, 0, counts], LEVEL, celsius);
            }
            last != Progress::Moved
        };
        assert!(at(20.0, 25.0));
        assert!(at(-20.0, 25.0));
        assert!(!at(22.0, 25.0));
        assert!(!at(-22.0, 25.0));
        // Heat and cold allow more, and no temperature allows everything.
        assert!(at(39.0, 85.0));
        assert!(at(-32.0, -15.0));
        assert!(!at(42.0, 85.0));
        assert!(!at(42.0, 3000.0));
        assert!(!at(2000.0, 25.0));
    }

    #[test]
    fn what_feels_no_gravity_is_not_at_rest() {
        for force in [[0, 0, 0], [0, 0, 1500], [1500, 1500, 1500], [-32768; 3]] {
            let mut average = StartupAverage::new(1000, COARSE);
            let event = first_event(&mut average, |_| ([0; 3], force));
            assert_eq!(event, (99, Progress::Moved), "{force:?}");
        }
        // Any pose with one g will do, offsets included.
        for force in [
            [2048, 0, 0],
            [0, -2048, 0],
            [1182, -1182, 1182],
            [0, 0, 2300],
        ] {
            let mut average = StartupAverage::new(1000, COARSE);
            let (_, event) = first_event(&mut average, |_| ([0; 3], force));
            assert!(matches!(event, Progress::Done(_)), "{force:?}");
        }
    }

    #[test]
    fn the_longest_average_of_the_largest_counts_is_exact() {
        // A scale at which full-scale counts are a plausible offset and a plausible gravity.
        let scale = StartupScale {
            counts_per_degree_s: 32768.0 / 20.0,
            counts_per_g: 32768.0,
        };
        for extreme in [i16::MIN, i16::MAX] {
            let mut average = StartupAverage::new(u16::MAX, scale);
            let (index, event) = first_event(&mut average, |_| ([extreme; 3], [0, 0, extreme]));
            assert_eq!(index, u32::from(u16::MAX) - 1);
            let Progress::Done(at_rest) = event else {
                panic!("{event:?}");
            };
            let expected = f32::from(extreme);
            assert_eq!(
                at_rest.gyroscope_counts,
                Vector3::new(expected, expected, expected)
            );
            assert_eq!(at_rest.accelerometer_counts.z, f32::from(extreme));
        }
    }

    #[test]
    fn every_length_ends_on_its_last_sample() {
        for samples in [0, 1, 2, 99, 100, 101, 149, 150, 199, 200, 201, 1001] {
            let mut average = StartupAverage::new(samples, COARSE);
            let (index, event) = first_event(&mut average, |_| ([1; 3], LEVEL));
            assert_eq!(index, u32::from(samples.max(1)) - 1);
            assert!(matches!(event, Progress::Done(_)), "{samples}");
        }
    }

    #[test]
    fn a_short_last_window_is_not_compared() {
        // One sample's noise, 0.6 °/s and 30 mg, would be a drift in a mean of a hundred.
        let mut average = StartupAverage::new(101, COARSE);
        let (index, event) = first_event(&mut average, |index| {
            if index < 100 {
                ([0; 3], LEVEL)
            } else {
                ([10, 0, 0], [60, 0, 2048])
            }
        });
        assert_eq!(index, 100);
        assert!(matches!(event, Progress::Done(_)), "{event:?}");
    }
}
