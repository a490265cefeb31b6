//! Delay of the idle task, for the sensor's configuration.

use super::{timebase, watchdog};

/// Delay with the core asleep. Only the idle task uses it.
pub struct Delay;

impl embedded_hal::delay::DelayNs for Delay {
    fn delay_ns(&mut self, nanoseconds: u32) {
        let start = timebase::now();
        // One more than requested, because the first microsecond may be almost over.
        let limit_us = nanoseconds.div_ceil(1_000) + 1;
        timebase::set_wake_up(start.wrapping_add(limit_us));
        timebase::sleep_until(|| timebase::elapsed(start, limit_us));
        watchdog::report_samples();
    }
}
