//! Selects the changes of the flags that are reported as messages.

use super::flags::Flags;

/// Report of lasting flags: once they are steady, never while they flicker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FlagReport {
    reported: Flags,
    latest: Flags,
    latest_since_us: u32,
}

impl FlagReport {
    /// Shortest duration of reported flags, in µs. Lost bursts and bus recoveries, which are
    /// shorter, have their own messages.
    const STEADY_US: u32 = 200_000;

    /// Creates a report whose last state is a valid attitude. [`Flags::CALIBRATING`] before that
    /// needs no message.
    pub const fn new() -> Self {
        Self {
            reported: Flags::VALID,
            latest: Flags::VALID,
            latest_since_us: 0,
        }
    }

    /// Updates with the flags of an attitude at a time in µs, which may wrap. Returns the lasting
    /// flags if they have to be reported.
    pub fn update(&mut self, flags: Flags, now_us: u32) -> Option<Flags> {
        let lasting = flags & Flags::LASTING;
        let is_starting = flags.contains(Flags::CALIBRATING) && !flags.contains(Flags::VALID);
        if lasting != self.latest || is_starting {
            self.latest = lasting;
            self.latest_since_us = now_us;
        }
        let is_steady = now_us.wrapping_sub(self.latest_since_us) >= Self::STEADY_US;
        if !is_steady || self.reported == lasting {
            return None;
        }
        self.reported = lasting;
        Some(lasting)
    }
}

impl Default for FlagReport {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lasting_flags_are_reported_once_and_flickering_ones_never() {
        let mut report = FlagReport::new();
        // Shortly before the count wraps, an update every 20 ms.
        let mut now_us = u32::MAX - 100_000;
        let mut reports = |flags: Flags, updates: u32| {
            let mut reports = Vec::new();
            for _ in 0..updates {
                now_us = now_us.wrapping_add(20_000);
                reports.extend(report.update(flags, now_us));
            }
            reports
        };
        assert_eq!(reports(Flags::CALIBRATING | Flags::DEGRADED, 100), []);
        let in_motion = Flags::VALID | Flags::DEGRADED;
        assert_eq!(reports(in_motion | Flags::CALIBRATING, 50), [in_motion]);
        assert_eq!(reports(Flags::VALID, 50), [Flags::VALID]);
        assert_eq!(reports(Flags::VALID, 100), []);
        let polled = Flags::VALID | Flags::DEGRADED | Flags::POLLED;
        assert_eq!(reports(polled, 10), [], "not at once");
        assert_eq!(reports(polled | Flags::MISSED, 50), [polled]);
        assert_eq!(reports(Flags::STALE | Flags::DEGRADED, 9), []);
        assert_eq!(reports(polled, 50), []);
        for _ in 0..50 {
            assert_eq!(reports(Flags::VALID, 1), []);
            assert_eq!(reports(Flags::STALE | Flags::DEGRADED, 1), []);
        }
        assert_eq!(reports(Flags::VALID, 50), [Flags::VALID]);
    }
}
