//! Sample rate of a log, as the divider of a sensor with the same rate.

/// Rows whose times show the usual time between rows.
pub const ROWS_AHEAD: usize = 101;

/// Returns the divider of a sensor with the rate of these first rows, by the median of their steps.
/// Rows may come irregularly, so the period is rounded up.
#[must_use]
pub fn sample_rate_divider(times_us: &[i64]) -> u8 {
    let pairs = times_us.windows(2);
    let mut steps_us: Vec<u64> = pairs.map(|pair| pair[0].abs_diff(pair[1])).collect();
    steps_us.sort_unstable();
    let median_us = steps_us.get(steps_us.len() / 2).copied().unwrap_or(0);
    divider_of_period(median_us)
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
