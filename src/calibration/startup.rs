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
/// How far the accelerometer's mean may lie from one g, in g: 80 mg of offset on each axis and 3 %
/// of sensitivity (product specification §6.2) make 0.17.
const GRAVITY_TOLERANCE_G: f32 = 0.2;

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
    pub gyroscope_counts: [f32; 3],
    /// The accelerometer's mean: gravity, as mounted and as tilted, plus its offset.
    pub accelerometer_counts: [f32; 3],
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

        let window = core::mem::replace(&mut self.window, Window::EMPTY);
        if self.has_moved(&window, temperature_celsius) {
            self.restart();
            return Progress::Moved;
        }
        self.first_window.get_or_insert(window.mean());
        self.count += window.count;
        self.gyroscope_sum = add(self.gyroscope_sum, window.gyroscope.sum);
        self.accelerometer_sum = add(self.accelerometer_sum, window.accelerometer.sum);
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

    fn has_moved(&self, window: &Window, temperature_celsius: f32) -> bool {
        let StartupScale {
            counts_per_degree_s,
            counts_per_g,
        } = self.scale;
        let mean = window.mean();
        let spreads = window.gyroscope.spread() > GYROSCOPE_SPREAD_DEGREES_S * counts_per_degree_s
            || window.accelerometer.spread() > ACCELEROMETER_SPREAD_G * counts_per_g;
        let turns = largest(mean.gyroscope_counts)
            > zero_rate_limit_degrees_s(temperature_celsius) * counts_per_degree_s;
        let gravity_g = norm(mean.accelerometer_counts) / counts_per_g;
        let is_off_gravity = (gravity_g - 1.0).abs() > GRAVITY_TOLERANCE_G;
        // A short last window has too much noise of its own to be compared.
        let drifts = window.count >= WINDOW / 2
            && self.first_window.is_some_and(|first| {
                let gyroscope = subtract(mean.gyroscope_counts, first.gyroscope_counts);
                let accelerometer = subtract(mean.accelerometer_counts, first.accelerometer_counts);
                largest(gyroscope) > GYROSCOPE_DRIFT_DEGREES_S * counts_per_degree_s
                    || largest(accelerometer) > ACCELEROMETER_DRIFT_G * counts_per_g
            });
        spreads || turns || is_off_gravity || drifts
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

    /// The widest axis, in counts.
    fn spread(&self) -> f32 {
        let spreads = zip(self.greatest, self.least, |greatest, least| {
            (i32::from(greatest) - i32::from(least)) as f32
        });
        largest(spreads)
    }
}

fn zip<A, B, C>([ax, ay, az]: [A; 3], [bx, by, bz]: [B; 3], f: impl Fn(A, B) -> C) -> [C; 3] {
    [f(ax, bx), f(ay, by), f(az, bz)]
}

fn add(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    zip(a, b, |a, b| a + b)
}

fn subtract(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    zip(a, b, |a, b| a - b)
}

fn largest([x, y, z]: [f32; 3]) -> f32 {
    x.abs().max(y.abs()).max(z.abs())
}

fn norm([x, y, z]: [f32; 3]) -> f32 {
    libm::sqrtf(x * x + y * y + z * z)
}

/// Sum over count; the whole part and the remainder apart, because `f32` cannot hold every `i32`.
fn mean(sum: [i32; 3], count: u16) -> [f32; 3] {
    let count = i32::from(count.max(1));
    sum.map(|sum| (sum / count) as f32 + (sum % count) as f32 / count as f32)
}
