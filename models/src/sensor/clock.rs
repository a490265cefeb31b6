//! The chip's own clock: when its converters sample, in the world's nanoseconds.
//!
//! The internal sampling grid runs at 8 kHz (register map r4.2, sections 4.2 and 4.3). The chip's 8
//! kHz is as good as its clock source. The tolerance is ±1 % with a gyroscope as reference, and
//! ±5 % with the relaxation oscillator (product specification r3.4, section 6.6). The grid is
//! absolute, an anchor plus a count of ticks, so nothing accumulates.

use crate::random::Random;

/// Internal ticks in a second by the chip's own reckoning.
pub const TICKS_PER_SECOND: f64 = 8000.0;

/// Error of this chip's clock sources from nominal, as a share: +0.01 runs 1 % fast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockErrors {
    /// CLKSEL 1, 2, 3: locked to a gyroscope's drive oscillator. Within ±0.01.
    pub gyroscope: f64,
    /// CLKSEL 0: the internal relaxation oscillator. Within ±0.05.
    pub internal: f64,
}

impl ClockErrors {
    /// No error at all.
    pub const NONE: Self = Self {
        gyroscope: 0.0,
        internal: 0.0,
    };

    /// Drawn within the datasheet's tolerance.
    #[must_use]
    pub fn draw(seed: u64) -> Self {
        let mut random = Random::new(seed, "sensor clock");
        Self {
            gyroscope: random.uniform(-0.01, 0.01),
            internal: random.uniform(-0.05, 0.05),
        }
    }

    /// The source's error for a CLKSEL field, or `None` if that source does not run.
    ///
    /// No external clock is wired to CLKIN (CLKSEL 4 and 5), 6 is reserved, and 7 stops the clock
    /// (section 4.28).
    #[must_use]
    pub fn of_source(&self, clock_select: u8) -> Option<f64> {
        match clock_select {
            0 => Some(self.internal),
            1..=3 => Some(self.gyroscope),
            _ => None,
        }
    }
}

/// A running grid of ticks.
#[derive(Clone, Copy, Debug)]
pub struct SampleClock {
    anchor_ns: u64,
    tick_ns: f64,
    ticks: u64,
}

impl SampleClock {
    /// A grid whose tick zero is at `anchor_ns`, with ticks of nominal length `tick_s` seconds by a
    /// clock off by `error`.
    #[must_use]
    pub fn new(anchor_ns: u64, tick_s: f64, error: f64) -> Self {
        Self {
            anchor_ns,
            tick_ns: tick_s * 1e9 / (1.0 + error),
            ticks: 0,
        }
    }

    /// Ticks taken since the anchor.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// The instant of tick number `tick`, to the nearest nanosecond.
    #[must_use]
    pub fn instant_ns(&self, tick: u64) -> u64 {
        self.anchor_ns + (tick as f64 * self.tick_ns).round() as u64
    }

    /// Takes the next tick if it is not later than `now_ns`, and returns its time.
    pub fn take_tick(&mut self, now_ns: u64) -> Option<u64> {
        let instant = self.instant_ns(self.ticks + 1);
        if instant > now_ns {
            return None;
        }
        self.ticks += 1;
        Some(instant)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_do_not_drift_from_their_grid() {
        let mut clock = SampleClock::new(1000, 1.0 / TICKS_PER_SECOND, 0.003);
        let mut last = 0;
        for _ in 0..8_000_000 {
            last = clock.take_tick(u64::MAX / 2).unwrap();
        }
        let expected = 1000.0 + 1e12 / 1.003;
        assert!((last as f64 - expected).abs() <= 1.0, "{last} {expected}");
    }

    #[test]
    fn a_tick_is_taken_only_when_its_time_has_come() {
        let mut clock = SampleClock::new(0, 1.0 / TICKS_PER_SECOND, 0.0);
        assert_eq!(clock.take_tick(124_999), None);
        assert_eq!(clock.take_tick(125_000), Some(125_000));
        assert_eq!(clock.take_tick(200_000), None);
        assert_eq!(clock.ticks(), 1);
    }

    #[test]
    fn the_tolerances_are_the_datasheets_and_the_seed_matters() {
        let drawn: Vec<ClockErrors> = (0..200).map(ClockErrors::draw).collect();
        assert!(
            drawn
                .iter()
                .all(|errors| errors.gyroscope.abs() <= 0.01 && errors.internal.abs() <= 0.05)
        );
        assert!(drawn.iter().any(|errors| errors.gyroscope.abs() > 0.008));
        assert_ne!(drawn[0], drawn[1]);
        assert_eq!(drawn[3], ClockErrors::draw(3));
        assert_eq!(drawn[0].of_source(1), Some(drawn[0].gyroscope));
        assert_eq!(drawn[0].of_source(0), Some(drawn[0].internal));
        assert_eq!(drawn[0].of_source(7), None);
    }
}
