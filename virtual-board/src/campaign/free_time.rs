//! The rules for the time without a fault.

use aplomb::health::Flags;
use aplomb_models::sensor::DataReady;

use super::episodes::Episode;
use super::judge::{COVERED_NS, Judge, Publication, first_and_count, seconds};
use super::{Case, RESET_DEADLINE_NS, deadline_ns};
use crate::faults::FaultKind;
use crate::recorder::Sample;

/// The share of fault-free time in which the attitude must be valid.
const VALID_SHARE: f64 = 0.995;

/// Flags that need a cause, which may be over for some of them.
const OF_A_CAUSE: Flags = Flags::INVALIDATING
    .union(Flags::MISSED)
    .union(Flags::GAP)
    .union(Flags::BUS_FAULT)
    .union(Flags::SENSOR_RESET)
    .union(Flags::LATE)
    .union(Flags::POLLED)
    .union(Flags::ACCELEROMETER_SATURATED)
    .union(Flags::VIBRATION)
    .union(Flags::COMPASS_FAULT)
    .union(Flags::INTERNAL_CLOCK);

/// Flags of an attitude by the internal oscillator.
const BY_INTERNAL_OSCILLATOR: Flags = Flags::INTERNAL_CLOCK.union(Flags::DEGRADED);

/// The longest time without a cause in which attitudes may be degraded, ns: when a motion begins,
/// the filter has to confirm its offset.
const LONGEST_DEGRADED_NS: u64 = 1_000_000_000;

/// The shortest pause of the samples that may leave an uncertain tilt, ns.
const UNCERTAIN_NS: u64 = 50_000_000;

/// The largest allowed error of the rates: degrees per second, and a share of the true rates. An
/// offset that motion alone has shown, the sensor's scale and its noise are within. The change of
/// the rates within the filter's delay is added, because the filter smooths it.
const ALLOWED_RATE_DEG_S: f64 = 6.0;
const ALLOWED_RATE_SHARE: f64 = 0.05;

/// Number of edges from the motion that a sample shows to its own edge, and their longest time, ns:
/// the delay of the sensor's low-pass filter is 1.9 ms.
const EDGES_OF_DELAY: usize = 2;
const LONGEST_DELAY_NS: u64 = 3_000_000;

/// The timer captures an edge some of its clock's cycles later, µs.
const SYNCHRONISED_US: f64 = 0.1;

/// The time that the timer loses when the crystal dies, at most, µs.
const LOST_WITH_CRYSTAL_US: f64 = 30.0;

/// From an edge to the end of its burst, and some more, ns.
const IN_FLIGHT_NS: u64 = 1_000_000;

impl Judge<'_> {
    /// Checks that the attitude is valid between the episodes.
    pub(super) fn check_fault_free_time(&self, case: &Case, failures: &mut Vec<String>) {
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
        self.check_traces(case, &is_free, failures);
        self.check_samples(&is_free, failures);
        self.check_times(&is_free, failures);
        self.check_degraded(case, &is_free, failures);
        self.check_clock(case, &is_free, failures);
        self.check_rates(&is_free, failures);
    }

    /// Checks that each flag has a cause, and that no fault leaves its flags behind.
    fn check_traces(
        &self,
        case: &Case,
        is_free: &impl Fn(u64) -> bool,
        failures: &mut Vec<String>,
    ) {
        let has_no_cause = |sample: &&Publication| {
            let flags = sample.snapshot.flags & OF_A_CAUSE;
            is_free(sample.at_ns) && !self.explained(case, sample.at_ns).contains(flags)
        };
        let flagged = self.published.iter().filter(has_no_cause);
        if let Some((first, count)) = first_and_count(flagged) {
            failures.push(format!(
                "{count} attitudes flagged without a fault, the first with {} at {} s",
                first.snapshot.flags,
                seconds(first.at_ns)
            ));
        }
    }

    /// Checks that attitudes are not degraded for long without a cause.
    fn check_degraded(
        &self,
        case: &Case,
        is_free: &impl Fn(u64) -> bool,
        failures: &mut Vec<String>,
    ) {
        let mut since_ns = None;
        for sample in &self.published {
            let lacks_cause = sample.snapshot.flags.contains(Flags::DEGRADED)
                && is_free(sample.at_ns)
                && !self.explained(case, sample.at_ns).contains(Flags::DEGRADED);
            since_ns = lacks_cause.then(|| since_ns.unwrap_or(sample.at_ns));
            if since_ns.is_some_and(|since_ns| sample.at_ns - since_ns > LONGEST_DEGRADED_NS) {
                failures.push(format!(
                    "degraded for more than a second without a cause, until {} s",
                    seconds(sample.at_ns)
                ));
                return;
            }
        }
    }

    /// Returns the flags that may be left of what happened before this time.
    fn explained(&self, case: &Case, at_ns: u64) -> Flags {
        let mut explained = Flags::empty();
        explained.set(BY_INTERNAL_OSCILLATOR, case.conditions.lacks_crystal);
        for episode in self.episodes.iter().filter(|it| it.start_ns < at_ns) {
            if episode.has_save || leaves_uncertain(episode) {
                explained |= Flags::DEGRADED;
            }
            // After a fault of the bus the firmware starts the compass anew.
            let may_stop_compass = |kind| {
                !matches!(
                    kind,
                    FaultKind::UartFlood | FaultKind::UartNoise | FaultKind::ProbeDetach
                )
            };
            let mut kinds = episode.faults.iter().map(|fault| fault.kind);
            if episode.has_save || kinds.clone().any(may_stop_compass) {
                explained |= Flags::COMPASS_FAULT;
            }
            if kinds.any(|kind| kind == FaultKind::CrystalDies) {
                explained |= BY_INTERNAL_OSCILLATOR;
            }
        }
        explained
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

    /// Checks that each time is that of its edge, in whole microseconds.
    fn check_clock(&self, case: &Case, is_free: &impl Fn(u64) -> bool, failures: &mut Vec<String>) {
        let faults = || case.schedule.faults.iter();
        let has_lost_time = |at_ns: u64| {
            faults().any(|fault| fault.kind == FaultKind::CrystalDies && fault.start_ns < at_ns)
        };
        let late_us = |sample: &Sample| {
            let edge = free_edge(sample, is_free)?;
            let late_us = sample.snapshot.t_us as f64 - sample.true_t_us?;
            let allowed_us = if has_lost_time(edge.time_ns) {
                LOST_WITH_CRYSTAL_US
            } else {
                1.0
            };
            (!(-allowed_us..=SYNCHRONISED_US).contains(&late_us)).then_some((late_us, edge.time_ns))
        };
        let wrong = self.record.samples.iter().filter_map(late_us);
        if let Some(((late_us, at_ns), count)) = first_and_count(wrong) {
            failures.push(format!(
                "{count} times were not those of their edges, \
                 the first off by {late_us:.1} us at {} s",
                seconds(at_ns)
            ));
        }
    }

    /// Checks the rates of certain attitudes, at the time of the motion that their samples show.
    fn check_rates(&self, is_free: &impl Fn(u64) -> bool, failures: &mut Vec<String>) {
        let is_certain = |sample: &&Sample| {
            let flags = sample.snapshot.flags;
            let uncertain = Flags::DEGRADED | Flags::CALIBRATING;
            flags.contains(Flags::VALID) && !flags.intersects(uncertain)
        };
        let wrong_deg_s = |sample: &Sample| {
            let edge = free_edge(sample, is_free)?;
            let truth = self.shown_by(&edge)?.truth.body_rates_rad_s;
            let rates = sample.snapshot.body_rates_rad_s;
            let rates = [rates.x, rates.y, rates.z].map(f64::from);
            let error: [f64; 3] = std::array::from_fn(|axis| rates[axis] - truth[axis]);
            let error_deg_s = length(error).to_degrees();
            let now = edge.truth.body_rates_rad_s;
            let change: [f64; 3] = std::array::from_fn(|axis| now[axis] - truth[axis]);
            let share_rad_s = ALLOWED_RATE_SHARE * length(truth) + length(change);
            let allowed_deg_s = ALLOWED_RATE_DEG_S + share_rad_s.to_degrees();
            // False for NaN.
            let is_allowed = error_deg_s <= allowed_deg_s;
            (!is_allowed).then_some((error_deg_s, edge.time_ns))
        };
        let certain = self.record.samples.iter().filter(is_certain);
        let wrong = certain.filter_map(wrong_deg_s);
        if let Some(((error_deg_s, at_ns), count)) = first_and_count(wrong) {
            failures.push(format!(
                "{count} rates were wrong, the first by {error_deg_s:.1} degrees/s at {} s",
                seconds(at_ns)
            ));
        }
    }

    /// Returns the edge at whose time the motion was that of the sample of this edge.
    fn shown_by(&self, edge: &DataReady) -> Option<&DataReady> {
        let edges = &self.record.edges;
        let place = edges.binary_search_by_key(&edge.index, |edge| edge.index);
        let shown = edges.get(place.ok()?.checked_sub(EDGES_OF_DELAY)?)?;
        (edge.time_ns - shown.time_ns <= LONGEST_DELAY_NS).then_some(shown)
    }
}

/// Returns true if σ may still be large after an episode: the core started again, the data were
/// wrong, or no samples came for a while.
fn leaves_uncertain(episode: &Episode) -> bool {
    let may = |kind| deadline_ns(kind).is_some_and(|due_ns| due_ns >= RESET_DEADLINE_NS);
    let stops = |kind| deadline_ns(kind).is_some();
    let mut kinds = episode.faults.iter().map(|fault| fault.kind);
    kinds.clone().any(may) || kinds.any(stops) && episode.end_ns - episode.start_ns >= UNCERTAIN_NS
}

/// Returns the edge of a sample, if it is known and there is no fault at that time. A burst that
/// the timer starts within a fault has none: it reads the sample of the last edge before it again.
fn free_edge(sample: &Sample, is_free: &impl Fn(u64) -> bool) -> Option<DataReady> {
    let is_polled = sample.snapshot.flags.contains(Flags::POLLED);
    let is_read_again = is_polled && !is_free(sample.published_ns);
    let edge = sample.edge.filter(|_| sample.is_new && !is_read_again);
    edge.filter(|edge| is_free(edge.time_ns))
}

fn length(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}
