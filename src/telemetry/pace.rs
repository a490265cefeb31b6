//! Pace of the telemetry task: the periods of its ticks and of its frames.

use crate::settings::OutputFormat;

/// Period of the telemetry task, which also serves the console, and its ticks per frame.
///
/// ```
/// use aplomb::settings::OutputFormat;
/// use aplomb::telemetry::Pace;
///
/// // 10 Hz: five ticks of 20 ms to a frame.
/// let pace = Pace::new(OutputFormat::Text, 10);
/// assert_eq!((pace.period_us, pace.ticks), (20_000, 5));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Pace {
    /// Period of the ticks, µs.
    pub period_us: u32,
    /// Ticks per frame.
    pub ticks: u16,
}

impl Pace {
    /// Lowest rate of the ticks, Hz.
    const MIN_TICKS_HZ: u16 = 50;
    /// Lowest rate of the ticks for the flight log, Hz: its bursts then fill half of the
    /// transmitter's buffer from tick to tick.
    const MIN_LOG_TICKS_HZ: u16 = 100;

    /// Creates the pace for this many frames per second in a format; 0 counts as 1.
    pub const fn new(format: OutputFormat, rate_hz: u16) -> Self {
        let rate_hz = if rate_hz == 0 { 1 } else { rate_hz };
        let min_hz = match format {
            OutputFormat::Log => Self::MIN_LOG_TICKS_HZ,
            _ => Self::MIN_TICKS_HZ,
        };
        let ticks = min_hz.div_ceil(rate_hz);
        Self {
            period_us: 1_000_000 / (rate_hz as u32 * ticks as u32),
            ticks,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_come_fifty_times_a_second_at_least_and_frames_at_their_rate() {
        let pace = |period_us, ticks| Pace { period_us, ticks };
        assert_eq!(Pace::new(OutputFormat::Text, 50), pace(20_000, 1));
        assert_eq!(Pace::new(OutputFormat::Text, 1000), pace(1_000, 1));
        assert_eq!(Pace::new(OutputFormat::Text, 20), pace(16_666, 3));
        assert_eq!(Pace::new(OutputFormat::Text, 1), pace(20_000, 50));
        for rate_hz in 1..=1000 {
            let Pace { period_us, ticks } = Pace::new(OutputFormat::Text, rate_hz);
            assert!(period_us <= 20_000, "{rate_hz}");
            let frame_us = period_us * u32::from(ticks);
            let error = 1.0 - f64::from(frame_us) * f64::from(rate_hz) / 1e6;
            assert!((0.0..=0.001).contains(&error), "{rate_hz}: {error}");
        }
    }
}
