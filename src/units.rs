//! Units, the constants between them, and time.
//!
//! Quantities are SI and carry their unit in the name (`_rad_s`, `_m_s2`, `_us`). Degrees appear
//! only in text for people and in quotes of a datasheet. Time is microseconds since start in 64
//! bits; [`CounterExtender`] makes it from a 32-bit hardware counter.
//!
//! ```
//! use aplomb::units::{degrees, radians};
//!
//! assert_eq!(degrees(radians(180.0)), 180.0);
//! ```

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

/// Magnetic field in microtesla, in body axes: forward, right, down. The earth's field is 25 to 65
/// µT.
///
/// ```
/// use aplomb::units::MagneticField;
///
/// let level_and_north = MagneticField { ut: [20.0, 0.0, 45.0] };
/// assert!(level_and_north.ut[2] > 0.0, "north of the equator the field points down");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MagneticField {
    /// Components along forward, right and down, µT.
    pub ut: [f32; 3],
}

/// Extends a free-running 32-bit counter to 64 bits.
///
/// At 1 MHz the counter wraps every 71.6 minutes. Each count extends the previous one, so callers
/// have no overflow to handle. A count must lie within half a turn (35 minutes at 1 MHz) of the
/// previous one. It may be older: a hardware capture is often read after a later count.
///
/// ```
/// use aplomb::units::CounterExtender;
///
/// let mut extender = CounterExtender::new(u32::MAX);
/// assert_eq!(extender.extend(4), (1 << 32) + 4);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CounterExtender {
    latest: u64,
}

impl CounterExtender {
    /// Creates an extender for a counter at this count, which has not wrapped.
    pub const fn new(count: u32) -> Self {
        Self {
            latest: count as u64,
        }
    }

    /// Extends a count. At 1 MHz the result is in µs since the counter was at zero.
    #[inline]
    pub const fn extend(&mut self, count: u32) -> u64 {
        let step = count.wrapping_sub(self.latest as u32).cast_signed();
        self.latest = self.latest.wrapping_add_signed(step as i64);
        self.latest
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
        let mut extender = CounterExtender::new(0);
        assert_eq!(extender.extend(7), 7);
        assert_eq!(extender.extend((1 << 31) - 1), (1 << 31) - 1);
        assert_eq!(extender.extend(u32::MAX - 1), TURN - 2);
        assert_eq!(extender.extend(5), TURN + 5);
        // A capture from before the wrap, read after a later count.
        assert_eq!(extender.extend(u32::MAX - 15), TURN - 16);
        assert_eq!(extender.extend(6), TURN + 6);
        // A capture of the very start, read at once.
        assert_eq!(CounterExtender::new(0).extend(0), 0);
    }

    #[test]
    fn extended_time_never_goes_back_over_many_wraps() {
        let mut extender = CounterExtender::new(0);
        let mut time: u64 = 0;
        while time < 5 * TURN {
            assert_eq!(extender.extend(time as u32), time);
            time += 123_456_789;
        }
    }
}
