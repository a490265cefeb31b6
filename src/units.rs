//! Units, the constants between them, and time.
//!
//! Quantities are SI and carry their unit in the name (`_rad_s`, `_m_s2`, `_us`); degrees appear
//! only where people read or where a datasheet is quoted. Time is microseconds since start in 64
//! bits, made from a 32-bit hardware counter by [`CounterExtender`].

/// Standard gravity in m/s² (exact by definition, BIPM SI brochure).
pub const STANDARD_GRAVITY_M_S2: f32 = 9.80665;

/// Degrees in one radian.
pub const DEGREES_PER_RADIAN: f32 = 180.0 / core::f32::consts::PI;

/// Radians in one degree.
pub const RADIANS_PER_DEGREE: f32 = core::f32::consts::PI / 180.0;

/// Seconds in one microsecond.
pub const SECONDS_PER_MICROSECOND: f32 = 1.0e-6;

/// Converts degrees (or degrees per second) to radians (or radians per second).
#[inline]
pub const fn radians(degrees: f32) -> f32 {
    degrees * RADIANS_PER_DEGREE
}

/// Converts radians (or radians per second) to degrees (or degrees per second).
#[inline]
pub const fn degrees(radians: f32) -> f32 {
    radians * DEGREES_PER_RADIAN
}

/// Extends a free-running 32-bit counter to 64 bits.
///
/// At 1 MHz the counter wraps every 71.6 minutes. The overflow interrupt calls
/// [`overflow`](Self::overflow); everyone else asks [`extend`](Self::extend) or
/// [`extend_capture`](Self::extend_capture). Neither depends on the overflow interrupt having run
/// in time, only on it running within half a turn (35 minutes).
///
/// Results are counts since the counter started at zero: microseconds at 1 MHz.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CounterExtender {
    overflows: u32,
}

impl CounterExtender {
    /// Half a turn of the counter: a smaller count is young, a larger one is old.
    const HALF_TURN: u32 = 1 << 31;

    /// An extender for a counter that has not wrapped yet.
    pub const fn new() -> Self {
        Self { overflows: 0 }
    }

    /// Notes one wrap; the overflow interrupt calls it, once, as it clears the update flag.
    pub fn overflow(&mut self) {
        self.overflows = self.overflows.wrapping_add(1);
    }

    /// Extends a count that was just read.
    ///
    /// `overflow_pending` says that the update flag is set and [`overflow`](Self::overflow) has not
    /// run for it yet. Read the count first and the flag second: then a small count with the flag
    /// set is after the wrap, and a large one was read just before it.
    pub const fn extend(&self, count: u32, overflow_pending: bool) -> u64 {
        let after_pending_wrap = overflow_pending && count < Self::HALF_TURN;
        let turns = self.overflows as u64 + after_pending_wrap as u64;
        (turns << 32) | count as u64
    }

    /// Extends a count that the hardware captured up to one turn before `count_now` was read.
    ///
    /// A capture can be older than a wrap that has been handled already; measuring it backwards
    /// from the present makes its age, not its value, decide. `count_now` and `overflow_pending`
    /// are those of [`extend`](Self::extend).
    pub const fn extend_capture(
        &self,
        captured_count: u32,
        count_now: u32,
        overflow_pending: bool,
    ) -> u64 {
        let age = count_now.wrapping_sub(captured_count);
        self.extend(count_now, overflow_pending)
            .saturating_sub(age as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN: u64 = 1 << 32;

    #[test]
    fn degrees_and_radians_are_inverse() {
        assert_eq!(radians(180.0), core::f32::consts::PI);
        assert_eq!(degrees(core::f32::consts::PI), 180.0);
        assert!((degrees(radians(12.5)) - 12.5).abs() < 1e-5);
    }

    #[test]
    fn a_count_extends_on_both_sides_of_a_wrap() {
        let mut extender = CounterExtender::new();
        assert_eq!(extender.extend(7, false), 7);
        assert_eq!(extender.extend(u32::MAX, false), TURN - 1);
        // The flag rose after the count was read: the count is still before the wrap.
        assert_eq!(extender.extend(u32::MAX, true), TURN - 1);
        // The counter wrapped, its interrupt has not run yet.
        assert_eq!(extender.extend(0, true), TURN);
        extender.overflow();
        assert_eq!(extender.extend(0, false), TURN);
        assert_eq!(extender.extend(5, false), TURN + 5);
    }

    #[test]
    fn a_capture_before_the_wrap_stays_before_it() {
        let mut extender = CounterExtender::new();
        // Captured 16 before the wrap, asked for 4 after it, in the three orders of events.
        assert_eq!(extender.extend_capture(u32::MAX - 15, 4, true), TURN - 16);
        extender.overflow();
        assert_eq!(extender.extend_capture(u32::MAX - 15, 4, false), TURN - 16);
        assert_eq!(extender.extend_capture(2, 4, false), TURN + 2);
        // A capture of the very start, asked for at once.
        assert_eq!(CounterExtender::new().extend_capture(0, 0, false), 0);
    }

    #[test]
    fn extended_time_never_goes_back_over_many_wraps() {
        let mut extender = CounterExtender::new();
        let mut last = 0;
        let mut time: u64 = 0;
        let mut handled = 0;
        while time < 5 * TURN {
            let wraps = time >> 32;
            // The interrupt is late by up to one step.
            let pending = wraps > handled;
            let extended = extender.extend(time as u32, pending);
            assert_eq!(extended, time);
            assert!(extended >= last);
            last = extended;
            if pending {
                extender.overflow();
                handled += 1;
            }
            time += 123_456_789;
        }
        assert_eq!(handled, 4);
    }
}
