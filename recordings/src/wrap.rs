//! Times of a clock of 32 bits, which begins again after 71.6 minutes, counted on.

/// Microseconds until a clock of 32 bits begins again.
const PERIOD_US: i64 = 1 << 32;
/// Longest time between the rows before and after a wrap, and each from the wrap, µs.
const NEAR_US: i64 = 60_000_000;
/// First times of such clocks: unsigned and signed ones.
const FIRST_US: [i64; 2] = [0, -(1 << 31)];

/// Count of a clock's wraps, row by row.
///
/// ```
/// use aplomb_recordings::wrap::Wraps;
///
/// let mut wraps = Wraps::default();
/// assert_eq!(wraps.count(4_294_967_000), (4_294_967_000, false));
/// assert_eq!(wraps.count(704), (4_294_968_000, true));
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Wraps {
    before_us: Option<i64>,
    offset_us: i64,
}

impl Wraps {
    /// Returns the time since the first row's period began, µs, and whether the clock has wrapped
    /// at this row.
    pub fn count(&mut self, time_us: i64) -> (i64, bool) {
        let before_us = self.before_us.replace(time_us).unwrap_or(time_us);
        let crosses = |before_us: i64, time_us: i64| {
            FIRST_US.into_iter().any(|first_us| {
                let end_us = first_us + PERIOD_US;
                (end_us - NEAR_US..end_us).contains(&before_us)
                    && (first_us..first_us + NEAR_US).contains(&time_us)
            })
        };
        let has_wrapped = crosses(before_us, time_us);
        if has_wrapped {
            self.offset_us += PERIOD_US;
        } else if self.offset_us > 0 && crosses(time_us, before_us) {
            // The row before was damaged.
            self.offset_us -= PERIOD_US;
        }
        (time_us.saturating_add(self.offset_us), has_wrapped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_of_32_bits_are_counted_on() {
        for first_us in FIRST_US {
            let mut wraps = Wraps::default();
            let clock = |time_us: i64| first_us + time_us.rem_euclid(PERIOD_US);
            let mut wrapped = 0;
            for row in 0..400_000 {
                let time_us = row * 40_000;
                let (counted, has_wrapped) = wraps.count(clock(time_us));
                assert_eq!(counted, first_us + time_us);
                wrapped += u32::from(has_wrapped);
            }
            assert_eq!(wrapped, 3);
        }
    }

    #[test]
    fn a_damaged_time_is_no_wrap_for_the_rows_after_it() {
        let mut wraps = Wraps::default();
        let counted = [PERIOD_US - 30_000, 5, PERIOD_US - 10_000].map(|time| wraps.count(time).0);
        assert_eq!(
            counted,
            [PERIOD_US - 30_000, PERIOD_US + 5, PERIOD_US - 10_000]
        );
        // Other steps back stay what they are.
        for times in [[5_000, 0], [1 << 33, 5], [PERIOD_US / 2, 0]] {
            let mut wraps = Wraps::default();
            assert_eq!(
                times.map(|time| wraps.count(time)),
                times.map(|time| (time, false))
            );
        }
    }
}
