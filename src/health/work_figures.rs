//! Statistics of the module's own work, as the command `measure` reports them.
//!
//! The board collects them sample by sample while a measurement runs. Everything is integer
//! arithmetic until a figure is read, so that a measurement of hours loses nothing.
//!
//! ```
//! use aplomb::health::Statistics;
//!
//! let mut period_us = Statistics::new();
//! for value in [999, 1_001, 1_000] {
//!     period_us.add(value);
//! }
//! assert_eq!((period_us.mean(), period_us.most()), (1_000.0, 1_001));
//! ```

/// Pattern with which the unused stack is filled at start.
pub const STACK_PATTERN: u32 = 0xA5A5_A5A5;

/// Longest time between two samples that counts as a period, in µs. A longer one is a pause, as
/// for a save.
const LONGEST_PERIOD_US: u32 = 100_000;

/// Count, mean, extremes and spread of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Statistics {
    count: u32,
    /// First value. The sums are relative to it, so that they stay small and exact.
    first: i32,
    sum: i64,
    squares: u64,
    least: i32,
    most: i32,
}

impl Statistics {
    /// Creates statistics without values.
    pub const fn new() -> Self {
        Self {
            count: 0,
            first: 0,
            sum: 0,
            squares: 0,
            least: 0,
            most: 0,
        }
    }

    /// Adds a value.
    pub fn add(&mut self, value: i32) {
        if self.count == 0 {
            (self.first, self.least, self.most) = (value, value, value);
        }
        let relative = i64::from(value) - i64::from(self.first);
        self.count = self.count.saturating_add(1);
        self.sum = self.sum.saturating_add(relative);
        let square = relative
            .unsigned_abs()
            .saturating_mul(relative.unsigned_abs());
        self.squares = self.squares.saturating_add(square);
        self.least = self.least.min(value);
        self.most = self.most.max(value);
    }

    /// Returns the number of values.
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// Returns the mean; zero without values.
    #[inline(never)]
    pub fn mean(&self) -> f32 {
        self.first as f32 + self.relative_mean()
    }

    /// Returns the least value; zero without values.
    pub const fn least(&self) -> i32 {
        self.least
    }

    /// Returns the largest value; zero without values.
    pub const fn most(&self) -> i32 {
        self.most
    }

    /// Returns the standard deviation; zero without values.
    pub fn deviation(&self) -> f32 {
        let mean = self.relative_mean();
        let variance = self.squares as f32 / self.count.max(1) as f32 - mean * mean;
        libm::sqrtf(variance.max(0.0))
    }

    fn relative_mean(&self) -> f32 {
        self.sum as f32 / self.count.max(1) as f32
    }
}

/// Figures of the core's work, from one data-ready edge to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CoreFigures {
    /// Cycles of a sample: all its interrupts and the attitude task.
    pub sample_cycles: Statistics,
    /// Cycles of a sample's interrupts, without the attitude task.
    pub interrupt_cycles: Statistics,
    /// Cycles of everything that the core executed.
    pub busy_cycles: u64,
    /// Duration of the measurement, µs.
    pub elapsed_us: u64,
}

impl CoreFigures {
    /// Creates figures without samples.
    pub const fn new() -> Self {
        Self {
            sample_cycles: Statistics::new(),
            interrupt_cycles: Statistics::new(),
            busy_cycles: 0,
            elapsed_us: 0,
        }
    }
}

/// Figures of the samples, from one publication to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SampleFigures {
    /// Time from the edge on the INT pin to the published attitude, µs.
    pub edge_to_attitude_us: Statistics,
    /// Time from one edge to the next, µs.
    pub period_us: Statistics,
    /// Samples lost.
    pub missed: u32,
    /// Readings of the accelerometer, the temperature and the gyroscope, in the order of the
    /// registers, in counts.
    pub counts: [Statistics; 7],
    last_us: Option<u64>,
}

impl SampleFigures {
    /// Creates figures without samples.
    pub const fn new() -> Self {
        Self {
            edge_to_attitude_us: Statistics::new(),
            period_us: Statistics::new(),
            missed: 0,
            counts: [Statistics::new(); 7],
            last_us: None,
        }
    }

    /// Returns the number of samples.
    pub const fn count(&self) -> u32 {
        let [x, ..] = &self.counts;
        x.count()
    }

    /// Adds a published sample: its edge's time, the time since that edge, the samples lost before
    /// it, and its bytes.
    ///
    /// The first sample's time since its edge does not count: the start of the measurement may have
    /// delayed it.
    pub fn add(&mut self, edge_us: u64, since_edge_us: u32, missed_before: u8, bytes: &[u8; 14]) {
        self.missed = self.missed.saturating_add(u32::from(missed_before));
        if let Some(last_us) = self.last_us.replace(edge_us) {
            self.edge_to_attitude_us.add(since_edge_us as i32);
            let period_us = edge_us.wrapping_sub(last_us) as u32;
            if missed_before == 0 && period_us <= LONGEST_PERIOD_US {
                self.period_us.add(period_us as i32);
            }
        }
        let (readings, _) = bytes.as_chunks();
        for (statistics, reading) in self.counts.iter_mut().zip(readings) {
            statistics.add(i32::from(i16::from_be_bytes(*reading)));
        }
    }
}

/// Figures of the module's own work, from one run of `measure`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WorkFigures {
    /// Figures of the core's work.
    pub core: CoreFigures,
    /// Figures of the samples.
    pub samples: SampleFigures,
    /// Frequency of the core, MHz.
    pub core_mhz: u32,
    /// Bytes of the stack that were ever used.
    pub stack_used_bytes: u32,
    /// Size of the stack in bytes.
    pub stack_bytes: u32,
}

impl WorkFigures {
    /// Returns the share of the time in which the core did not sleep, in percent.
    pub fn load_percent(&self) -> f32 {
        let available = self.core.elapsed_us as f32 * self.core_mhz as f32;
        if available > 0.0 {
            100.0 * self.core.busy_cycles as f32 / available
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn statistics(values: &[i32]) -> Statistics {
        let mut statistics = Statistics::new();
        values.iter().for_each(|value| statistics.add(*value));
        statistics
    }

    #[test]
    fn statistics_are_those_of_the_textbook() {
        let some = statistics(&[2, 4, 4, 4, 5, 5, 7, 9]);
        assert_eq!((some.count(), some.mean(), some.deviation()), (8, 5.0, 2.0));
        assert_eq!((some.least(), some.most()), (2, 9));
        let none = statistics(&[]);
        assert_eq!((none.count(), none.mean(), none.deviation()), (0, 0.0, 0.0));
        assert_eq!((none.least(), none.most()), (0, 0));
    }

    #[test]
    fn a_small_spread_about_a_large_value_is_not_lost() {
        // A one-count square wave about 2^30, where f32 has steps of 128.
        let values: Vec<i32> = (0..10_000).map(|n| (1 << 30) + n % 2).collect();
        let deviation = statistics(&values).deviation();
        assert!((deviation - 0.5).abs() < 1e-4, "{deviation}");
        let extremes = statistics(&[i32::MIN, i32::MAX]);
        assert!(extremes.deviation().is_finite());
    }

    #[test]
    fn lost_samples_and_pauses_are_no_periods() {
        let mut figures = SampleFigures::new();
        let mut bytes = [0; 14];
        bytes[..2].copy_from_slice(&(-2048_i16).to_be_bytes());
        // The start of the measurement has delayed the first one.
        for (edge_us, since_edge_us, missed) in [
            (1_000, 397, 0),
            (2_001, 388, 0),
            (4_000, 388, 1),
            (5_000, 388, 0),
            (600_000, 388, 0),
            (601_001, 388, 0),
        ] {
            figures.add(edge_us, since_edge_us, missed, &bytes);
        }
        let period_us = figures.period_us;
        assert_eq!((period_us.count(), period_us.least()), (3, 1_000));
        assert_eq!((period_us.most(), figures.missed), (1_001, 1));
        let latency_us = figures.edge_to_attitude_us;
        assert_eq!((latency_us.mean(), latency_us.most()), (388.0, 388));
        let x = figures.counts[0];
        assert_eq!((x.count(), x.mean(), x.deviation()), (6, -2048.0, 0.0));
    }

    #[test]
    fn the_load_is_that_of_the_whole_time() {
        let figures = WorkFigures {
            core: CoreFigures {
                busy_cycles: 1_680_000,
                elapsed_us: 1_000_000,
                ..CoreFigures::default()
            },
            core_mhz: 168,
            ..WorkFigures::default()
        };
        assert_eq!(figures.load_percent(), 1.0);
        assert_eq!(WorkFigures::default().load_percent(), 0.0);
    }
}
