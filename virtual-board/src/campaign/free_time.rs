//! The rules for the time without a fault.

use aplomb::health::Flags;

use super::judge::{COVERED_NS, Judge, Publication, seconds};

/// The share of fault-free time in which the attitude must be valid.
const VALID_SHARE: f64 = 0.995;

/// Flags that show a fault of the sensor, its bus or its interrupt, while it lasts.
const OF_A_FAULT: Flags = Flags::INVALIDATING
    .union(Flags::MISSED)
    .union(Flags::GAP)
    .union(Flags::BUS_FAULT)
    .union(Flags::SENSOR_RESET)
    .union(Flags::LATE)
    .union(Flags::POLLED);

/// From an edge to the end of its burst, and some more, ns.
const IN_FLIGHT_NS: u64 = 1_000_000;

impl Judge<'_> {
    /// Checks that the attitude is valid between the episodes.
    pub(super) fn check_fault_free_time(&self, failures: &mut Vec<String>) {
        // While σ falls at a start, it may pass its limit more than once.
        let is_settled = |sample: &&Publication| {
            let flags = sample.snapshot.flags;
            flags.contains(Flags::VALID) && !flags.contains(Flags::CALIBRATING)
        };
        let Some(first_ns) = self.published.iter().find(is_settled).map(|it| it.at_ns) else {
            failures.push("the attitude was never valid with a known offset".into());
            return;
        };
        if self
            .episodes
            .first()
            .is_some_and(|first| first_ns > first.start_ns)
        {
            failures.push(format!(
                "not valid before the first fault: only at {} s",
                seconds(first_ns)
            ));
        }
        // Samples of the last moments may still be on their way.
        let end_ns = self.end_ns().saturating_sub(COVERED_NS);
        let is_free = |at_ns: u64| {
            (first_ns..end_ns).contains(&at_ns)
                && !self.episodes.iter().any(|episode| {
                    // The burst of an edge shortly before the fault is still under way.
                    (episode.start_ns.saturating_sub(IN_FLIGHT_NS)..=episode.due_ns)
                        .contains(&at_ns)
                })
        };
        let step_ns = 100_000;
        let (mut free, mut valid) = (0_u64, 0_u64);
        let mut spans = self.valid.iter().peekable();
        for at_ns in (first_ns..end_ns).step_by(step_ns) {
            while spans.next_if(|&&(_, end)| end <= at_ns).is_some() {}
            if is_free(at_ns) {
                free += 1;
                valid += u64::from(spans.peek().is_some_and(|&&(start, _)| start <= at_ns));
            }
        }
        let share = valid as f64 / free.max(1) as f64;
        if share < VALID_SHARE {
            failures.push(format!(
                "valid for {:.2} % of the time without a fault",
                100.0 * share
            ));
        }
        self.check_traces(&is_free, failures);
        self.check_samples(&is_free, failures);
        self.check_times(&is_free, failures);
    }

    /// Checks that no fault leaves its flags behind.
    fn check_traces(&self, is_free: &impl Fn(u64) -> bool, failures: &mut Vec<String>) {
        let mut flagged = self
            .published
            .iter()
            .filter(|sample| is_free(sample.at_ns) && sample.snapshot.flags.intersects(OF_A_FAULT));
        if let Some(first) = flagged.next() {
            failures.push(format!(
                "{} attitudes flagged without a fault, the first with {} at {} s",
                1 + flagged.count(),
                first.snapshot.flags,
                seconds(first.at_ns)
            ));
        }
    }

    /// Checks that each edge without a fault has its sample.
    fn check_samples(&self, is_free: &impl Fn(u64) -> bool, failures: &mut Vec<String>) {
        let mut published: Vec<u64> = self
            .record
            .samples
            .iter()
            .filter_map(|sample| Some(sample.edge?.index))
            .collect();
        published.sort_unstable();
        let missed: Vec<u64> = self
            .record
            .edges
            .iter()
            .filter(|edge| is_free(edge.time_ns) && published.binary_search(&edge.index).is_err())
            .map(|edge| edge.time_ns)
            .collect();
        if let Some(&first_ns) = missed.first() {
            failures.push(format!(
                "{} samples missed without a fault, the first at {} s",
                missed.len(),
                seconds(first_ns)
            ));
        }
    }

    /// Checks that times follow the edges and never go back.
    fn check_times(&self, is_free: &impl Fn(u64) -> bool, failures: &mut Vec<String>) {
        let mut worst: Option<(f64, u64)> = None;
        for pair in self.record.samples.windows(2) {
            let [before, after] = pair else { continue };
            let was_reset = self
                .record
                .resets_ns
                .iter()
                .any(|&at_ns| (before.published_ns..=after.published_ns).contains(&at_ns));
            if was_reset {
                continue;
            }
            if after.snapshot.t_us < before.snapshot.t_us {
                failures.push(format!(
                    "time went back from {} us to {} us",
                    before.snapshot.t_us, after.snapshot.t_us
                ));
                return;
            }
            let (Some(first), Some(second)) = (before.edge, after.edge) else {
                continue;
            };
            if !is_free(first.time_ns) || !is_free(second.time_ns) || second.index == first.index {
                continue;
            }
            let true_us = (second.time_ns - first.time_ns) as f64 * 1e-3;
            let published_us = (after.snapshot.t_us - before.snapshot.t_us) as f64;
            let error_us = (published_us - true_us).abs();
            if error_us > 1.0 && worst.is_none_or(|(worst_us, _)| error_us > worst_us) {
                worst = Some((error_us, second.time_ns));
            }
        }
        if let Some((error_us, at_ns)) = worst {
            failures.push(format!(
                "a step of time was wrong by {error_us:.1} us without a fault, at {} s",
                seconds(at_ns)
            ));
        }
    }
}
