//! Sample rate of a log, as the divider of a sensor with the same rate.

/// Rows whose times show the usual time between rows.
pub const ROWS_AHEAD: usize = 101;

/// Returns the divider of a sensor with the rate of these first rows, by the median of their steps.
/// Rows may come irregularly, so the period is rounded up.
#[must_use]
pub fn sample_rate_divider(times_us: &[i64]) -> u8 {
    divider_of_period(median_step_us(times_us))
}

/// Returns the divider of the sensor of these first bursts, by the median of their steps. The
/// sensor's clock is some percent off, so the period is rounded to the nearest millisecond.
#[must_use]
pub fn divider_of_bursts(times_us: &[i64]) -> u8 {
    let nearest_us = median_step_us(times_us).saturating_add(500) / 1_000 * 1_000;
    divider_of_period(nearest_us)
}

/// Returns the median of the steps between these times, µs; zero without a step.
#[must_use]
pub fn median_step_us(times_us: &[i64]) -> u64 {
    let pairs = times_us.windows(2);
    let mut steps_us: Vec<u64> = pairs.map(|pair| pair[0].abs_diff(pair[1])).collect();
    steps_us.sort_unstable();
    steps_us.get(steps_us.len() / 2).copied().unwrap_or(0)
}

/// Returns the divider of a sensor with this period, µs, rounded up.
#[must_use]
pub fn divider_of_period(period_us: u64) -> u8 {
    let periods = period_us.div_ceil(1_000).saturating_sub(1);
    periods.try_into().unwrap_or(u8::MAX)
}

/// Returns a time of a log for the library, which counts from zero: the order is kept.
#[must_use]
pub fn unsigned(time_us: i64) -> u64 {
    time_us.cast_unsigned() ^ (1 << 63)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_off_changes_the_divider_of_no_sensor() {
        let times = |step_us: i64| -> Vec<i64> { (0..50).map(|row| row * step_us).collect() };
        for (step_us, of_bursts, of_rows) in [
            (0, 0, 0),
            (125, 0, 0),
            (950, 0, 0),
            (1_000, 0, 0),
            (1_050, 0, 1),
            (4_980, 4, 4),
            (5_020, 4, 5),
            (10_000, 9, 9),
            (1_000_000, 255, 255),
        ] {
            assert_eq!(divider_of_bursts(&times(step_us)), of_bursts, "{step_us}");
            assert_eq!(sample_rate_divider(&times(step_us)), of_rows, "{step_us}");
        }
        assert_eq!(divider_of_bursts(&[i64::MIN, i64::MAX]), 255);
        assert_eq!(divider_of_bursts(&[]), 0);
    }
}
