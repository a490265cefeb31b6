//! Flights by chance with faults by chance, and what must hold in every one of them.
//!
//! - No hang, no crash, and no reset but the one that a `watchdog-hang` asks for.
//! - A tilt that is wrong by more than the larger of 5° and six σ is never published as valid.
//! - The attitude is valid for 99.5 % of the time without a fault after start-up, and again within the deadline after
//!   each fault: 20 ms after the end of a fault of the bus, 250 ms after a reset or the sensor's first possible
//!   acknowledge, and after a fault of what the sensor measures.
//! - Something is published every 20 ms while the core runs: if nothing is known, that nothing is known.
//! - Without a fault no data-ready edge is without its sample, and times are right to a microsecond.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;

use crate::faults::{FaultKind, ScheduledFault};
use crate::flight::{Outcome, Run};
use crate::motion::quadrotor::{Quadrotor, REST_S};
use crate::motion::rest::Rest;
use crate::motion::swing::{Later, Swing};
use crate::motion::{Motion, Quaternion, inclination_error_rad};
use crate::profile::CRASHES;
use crate::random::Random;
use crate::schedule::Schedule;

/// The rule's angle, degrees, and its factor of σ.
const ALLOWED_DEG: f64 = 5.0;
const ALLOWED_SIGMAS: f64 = 6.0;

/// The share of fault-free time in which the attitude must be valid.
const VALID_SHARE: f64 = 0.995;

/// Deadlines of recovery, ns.
const BUS_DEADLINE_NS: u64 = 20_000_000;
const RESET_DEADLINE_NS: u64 = 250_000_000;

/// The longest pause between publications while the core runs, ns.
const LONGEST_SILENCE_NS: u64 = 20_000_000;

/// From an edge to the end of its burst, and some more, ns.
const IN_FLIGHT_NS: u64 = 1_000_000;

/// Valid for this long without a break is recovered, ns.
const STEADY_NS: u64 = 5_000_000;

/// A valid snapshot covers this much time until the next one, ns: two periods.
const COVERED_NS: u64 = 2_000_000;

/// The motion begins after this much rest, s: the gyroscope's offset has been measured by then.
const MOTION_REST_S: f64 = 1.45;

/// What a run goes on for after its last deadline, ns, and after the start of a hang, within which the watchdog must bite.
const TAIL_NS: u64 = 300_000_000;
const WATCHDOG_NS: u64 = 3_000_000_000;

/// What is flown, and what goes wrong.
#[derive(Clone, Debug)]
pub struct Case {
    /// The seed that all the rest follows from.
    pub seed: u64,
    /// The faults.
    pub schedule: Schedule,
    /// How long, s.
    pub seconds: f64,
}

impl Case {
    /// The case of this seed. Consecutive seeds begin with consecutive classes of faults.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
        Self::new(seed, Schedule::by_seed(seed))
    }

    /// A flight of this seed with these faults.
    #[must_use]
    pub fn new(seed: u64, schedule: Schedule) -> Self {
        let over_ns = |fault: &ScheduledFault| match fault.end_ns() {
            _ if fault.kind == FaultKind::WatchdogHang => fault.start_ns + WATCHDOG_NS,
            u64::MAX => fault.start_ns + RESET_DEADLINE_NS,
            // The sensor takes up to 90 ms to start.
            end_ns if fault.kind == FaultKind::SensorBrownout => {
                end_ns + 100_000_000 + RESET_DEADLINE_NS
            }
            end_ns => end_ns + deadline_ns(fault.kind).unwrap_or(0),
        };
        let last_ns = schedule
            .faults
            .iter()
            .map(over_ns)
            .max()
            .unwrap_or(2_000_000_000);
        Self {
            seed,
            schedule,
            seconds: (last_ns + TAIL_NS) as f64 * 1e-9,
        }
    }

    /// How the board moves: a flight, a swing, or not at all.
    #[must_use]
    pub fn motion(&self) -> Box<dyn Motion> {
        let mut random = Random::new(self.seed, "motion of a case");
        let kind = random.uniform(0.0, 1.0);
        if kind < 0.5 {
            Box::new(Swing::by_seed(self.seed, MOTION_REST_S))
        } else if kind < 0.8 {
            Box::new(Later {
                motion: Quadrotor::by_seed(self.seed),
                by_s: REST_S - MOTION_REST_S,
            })
        } else {
            let mut angle = || random.uniform(-0.7, 0.7);
            Box::new(Rest::new(Quaternion::from_euler(angle(), angle(), 0.0)))
        }
    }

    /// Flies it.
    ///
    /// # Errors
    ///
    /// When the image cannot be used, or the emulator gives up or panics.
    pub fn fly(&self, firmware: &Path) -> Result<Outcome, String> {
        let needs_probe = self
            .schedule
            .faults
            .iter()
            .any(|fault| fault.kind == FaultKind::ProbeDetach);
        let mut run = Run::new(firmware)
            .seed(self.seed)
            .seconds(self.seconds)
            .boxed_motion(self.motion())
            .schedule(&self.schedule)
            .without_account();
        if !needs_probe {
            run = run.without_probe();
        }
        match catch_unwind(AssertUnwindSafe(|| run.run())) {
            Ok(outcome) => outcome.map_err(|error| error.to_string()),
            Err(_) => Err("the emulator panicked".into()),
        }
    }
}

/// The deadline of the recovery from a fault; `None` if nothing may be seen of it at all.
#[must_use]
pub fn deadline_ns(kind: FaultKind) -> Option<u64> {
    match kind {
        FaultKind::UartFlood | FaultKind::UartNoise | FaultKind::ProbeDetach => None,
        FaultKind::SensorBrownout
        | FaultKind::RegisterFlip(..)
        | FaultKind::Frozen
        | FaultKind::Zeros
        | FaultKind::Ones
        | FaultKind::Saturated(_)
        | FaultKind::CrystalDies
        | FaultKind::WatchdogHang => Some(RESET_DEADLINE_NS),
        _ => Some(BUS_DEADLINE_NS),
    }
}

/// What became of one fault.
#[derive(Clone, Debug)]
pub struct FaultReport {
    /// Its class.
    pub class: &'static str,
    /// Whether the firmware noticed: a counter, a flag, or a message.
    pub is_detected: bool,
    /// From its end to a valid attitude again, ns; `None` if that did not come in time.
    pub recovery_ns: Option<u64>,
}

/// What became of a case.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// A report for each fault.
    pub faults: Vec<FaultReport>,
    /// What should have held and did not.
    pub failures: Vec<String>,
}

/// A fault, or several that follow too closely to tell apart.
#[derive(Clone, Debug)]
struct Episode {
    start_ns: u64,
    /// When the last of them is over, so that recovery can begin.
    end_ns: u64,
    /// When the attitude must be valid again.
    due_ns: u64,
    faults: Vec<ScheduledFault>,
}

/// Flies a case and judges it.
#[must_use]
pub fn run(case: &Case, firmware: &Path) -> Report {
    match case.fly(firmware) {
        Ok(outcome) => judge(case, &outcome),
        Err(error) => Report {
            faults: Vec::new(),
            failures: vec![error],
        },
    }
}

/// Judges what came of a case.
#[must_use]
pub fn judge(case: &Case, outcome: &Outcome) -> Report {
    let published = publications(outcome);
    let judge = Judge {
        outcome,
        valid: valid_spans(&published),
        published,
        episodes: episodes(case, outcome),
    };
    let mut report = Report::default();
    judge.the_processor(case, &mut report.failures);
    judge.the_rule(case, &mut report.failures);
    judge.recovery(&mut report);
    judge.fault_free_time(&mut report.failures);
    judge.silence(case, &mut report.failures);
    report
}

/// A snapshot of either kind.
#[derive(Clone, Copy, Debug)]
struct Publication {
    at_ns: u64,
    snapshot: Snapshot,
    tilt_sigma_rad: Option<f64>,
    /// The true attitude at its sample, if that is known from the sample.
    truth: Option<Quaternion>,
}

/// All snapshots, in the order of their publication.
fn publications(outcome: &Outcome) -> Vec<Publication> {
    let samples = outcome.samples().iter().map(|sample| Publication {
        at_ns: sample.published_ns,
        snapshot: sample.snapshot,
        tilt_sigma_rad: sample.tilt_sigma_rad,
        truth: sample.edge.and_then(|edge| edge.truth.attitude),
    });
    let stale = outcome.record.stale.iter().map(|stale| Publication {
        at_ns: stale.published_ns,
        snapshot: stale.snapshot,
        tilt_sigma_rad: stale.tilt_sigma_rad,
        truth: None,
    });
    let mut all: Vec<Publication> = samples.chain(stale).collect();
    all.sort_by_key(|publication| publication.at_ns);
    all
}

struct Judge<'a> {
    outcome: &'a Outcome,
    published: Vec<Publication>,
    /// When the published attitude was valid, ns.
    valid: Vec<(u64, u64)>,
    episodes: Vec<Episode>,
}

impl Judge<'_> {
    fn end_ns(&self) -> u64 {
        self.outcome.record.last.1
    }

    /// Nothing but a hang that was asked for resets the processor, and nothing crashes it.
    fn the_processor(&self, case: &Case, failures: &mut Vec<String>) {
        let hangs = case
            .schedule
            .faults
            .iter()
            .filter(|fault| fault.kind == FaultKind::WatchdogHang)
            .count();
        let resets = &self.outcome.record.resets_ns;
        if resets.len() > hangs {
            let at: Vec<String> = resets.iter().map(|&at_ns| seconds(at_ns)).collect();
            failures.push(format!(
                "{} resets, {hangs} asked for: at {} s",
                resets.len(),
                at.join(", ")
            ));
        }
        if resets.len() < hangs {
            failures.push("the core hung, and no watchdog reset it".into());
        }
        let instructions = &self.outcome.record.instructions;
        let crashed: u64 = CRASHES
            .filter_map(|exception| instructions.get(exception))
            .sum();
        if crashed > 0 {
            failures.push("a fault handler ran: a crash or a panic".into());
        }
    }

    /// What is far wrong is not valid.
    fn the_rule(&self, case: &Case, failures: &mut Vec<String>) {
        let mut motion = case.motion();
        let mut worst: Option<(f64, f64, u64)> = None;
        let mut count = 0;
        for sample in &self.published {
            if !sample.snapshot.flags.contains(Flags::VALID) {
                continue;
            }
            let at_publication = || motion.at(sample.at_ns as f64 * 1e-9).attitude;
            let Some(truth) = sample.truth.or_else(at_publication) else {
                continue;
            };
            let error_deg = tilt_error_deg(sample, truth);
            let sigma_deg = sample.tilt_sigma_rad.unwrap_or(0.0).to_degrees();
            let allowed_deg = ALLOWED_DEG.max(ALLOWED_SIGMAS * sigma_deg);
            // A comparison that is false for what is not a number.
            let is_allowed = error_deg <= allowed_deg;
            if !is_allowed {
                count += 1;
                if worst.is_none_or(|(error, ..)| error_deg > error) {
                    worst = Some((error_deg, sigma_deg, sample.at_ns));
                }
            }
        }
        if let Some((error_deg, sigma_deg, at_ns)) = worst {
            failures.push(format!(
                "{count} attitudes published as valid were wrong, the worst by {error_deg:.1} degrees with a sigma of {sigma_deg:.2} at {} s",
                seconds(at_ns)
            ));
        }
    }

    /// Every episode ends in time.
    fn recovery(&self, report: &mut Report) {
        for episode in &self.episodes {
            // Steadily valid from here on, unless it was valid all the time.
            let back_ns = self
                .valid
                .iter()
                .find(|&&(start, end)| {
                    let from = start.max(episode.end_ns);
                    end > from && (end - from >= STEADY_NS || end + COVERED_NS > self.end_ns())
                })
                .map(|&(start, _)| start.max(episode.end_ns));
            let recovery_ns = back_ns
                .filter(|&back_ns| back_ns <= episode.due_ns)
                .map(|back_ns| back_ns - episode.end_ns);
            if recovery_ns.is_none() {
                let took = back_ns.map_or("not by the end".into(), |back_ns| {
                    format!("after {:.1} ms", (back_ns - episode.end_ns) as f64 * 1e-6)
                });
                report.failures.push(format!(
                    "valid again {took}, allowed are {:.1} ms: {}",
                    (episode.due_ns - episode.end_ns) as f64 * 1e-6,
                    names(&episode.faults)
                ));
            }
            for fault in &episode.faults {
                report.faults.push(FaultReport {
                    class: fault.kind.name(),
                    is_detected: self.is_detected(episode),
                    recovery_ns,
                });
            }
        }
    }

    /// Whether the firmware has counted, flagged or said anything from the beginning of an episode to its deadline.
    fn is_detected(&self, episode: &Episode) -> bool {
        let during = |at_ns: u64| (episode.start_ns..=episode.due_ns).contains(&at_ns);
        let is_counted = self
            .outcome
            .record
            .health
            .iter()
            .skip(1)
            .any(|reading| during(reading.at_ns));
        let is_flagged = self
            .outcome
            .samples()
            .iter()
            .any(|sample| during(sample.published_ns) && sample.snapshot.flags != Flags::VALID);
        let is_said = self
            .outcome
            .uart_lines
            .iter()
            .any(|line| during(line.at_ns) && line.text.starts_with('#'));
        is_counted || is_flagged || is_said
    }

    /// Between the episodes all is well.
    fn fault_free_time(&self, failures: &mut Vec<String>) {
        let Some(&(first_ns, _)) = self.valid.first() else {
            failures.push("the attitude was never valid".into());
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
        self.missed(&is_free, failures);
        self.times(&is_free, failures);
    }

    /// No edge without its sample.
    fn missed(&self, is_free: &impl Fn(u64) -> bool, failures: &mut Vec<String>) {
        let mut published: Vec<u64> = self
            .outcome
            .samples()
            .iter()
            .filter_map(|sample| Some(sample.edge?.index))
            .collect();
        published.sort_unstable();
        let missed: Vec<u64> = self
            .outcome
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

    /// Times follow the edges, and never go back.
    fn times(&self, is_free: &impl Fn(u64) -> bool, failures: &mut Vec<String>) {
        let mut worst: Option<(f64, u64)> = None;
        for pair in self.outcome.samples().windows(2) {
            let [before, after] = pair else { continue };
            let was_reset = self
                .outcome
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
            let told_us = (after.snapshot.t_us - before.snapshot.t_us) as f64;
            let error_us = (told_us - true_us).abs();
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

    /// Something is published all the time.
    fn silence(&self, case: &Case, failures: &mut Vec<String>) {
        let Some(first) = self.published.first() else {
            return;
        };
        let mut last_ns = first.at_ns;
        let ends = std::iter::once(self.end_ns());
        let published = self.published.iter().map(|sample| sample.at_ns);
        let mut longest: Option<(u64, u64)> = None;
        for at_ns in published.chain(ends) {
            let held = case
                .schedule
                .faults
                .iter()
                .filter(|fault| {
                    matches!(fault.kind, FaultKind::CoreStall | FaultKind::WatchdogHang)
                })
                .any(|fault| fault.start_ns < at_ns && fault.end_ns() > last_ns);
            let was_reset = self
                .outcome
                .record
                .resets_ns
                .iter()
                .any(|&reset_ns| (last_ns..=at_ns).contains(&reset_ns));
            let gap_ns = at_ns - last_ns;
            if !held && !was_reset && longest.is_none_or(|(longest_ns, _)| gap_ns > longest_ns) {
                longest = Some((gap_ns, last_ns));
            }
            last_ns = at_ns;
        }
        if let Some((gap_ns, at_ns)) = longest.filter(|&(gap_ns, _)| gap_ns > LONGEST_SILENCE_NS) {
            failures.push(format!(
                "nothing was published for {:.1} ms from {} s on",
                gap_ns as f64 * 1e-6,
                seconds(at_ns)
            ));
        }
    }
}

/// The times at which the attitude that was published last is valid and fresh.
fn valid_spans(samples: &[Publication]) -> Vec<(u64, u64)> {
    let mut spans: Vec<(u64, u64)> = Vec::new();
    for (nth, sample) in samples.iter().enumerate() {
        if !sample.snapshot.flags.contains(Flags::VALID) {
            continue;
        }
        let start_ns = sample.at_ns;
        let next_ns = samples.get(nth + 1).map_or(u64::MAX, |next| next.at_ns);
        let end_ns = next_ns.min(start_ns + COVERED_NS);
        match spans.last_mut() {
            Some(last) if last.1 == start_ns => last.1 = end_ns,
            _ => spans.push((start_ns, end_ns)),
        }
    }
    spans
}

/// The faults in groups that can be told apart.
fn episodes(case: &Case, outcome: &Outcome) -> Vec<Episode> {
    let mut episodes: Vec<Episode> = Vec::new();
    for fault in &case.schedule.faults {
        let end_ns = end_ns(fault, outcome);
        let deadline_ns = deadline_ns(fault.kind);
        let episode = Episode {
            start_ns: fault.start_ns,
            end_ns,
            due_ns: end_ns + deadline_ns.unwrap_or(0),
            faults: vec![*fault],
        };
        match episodes.last_mut() {
            Some(last) if last.due_ns >= episode.start_ns => {
                last.end_ns = last.end_ns.max(episode.end_ns);
                last.due_ns = last.due_ns.max(episode.due_ns);
                last.faults.push(*fault);
            }
            _ => episodes.push(episode),
        }
    }
    episodes
}

/// When a fault is over, so that the firmware can recover from it.
fn end_ns(fault: &ScheduledFault, outcome: &Outcome) -> u64 {
    let first_after =
        |times: &[u64], from_ns: u64| times.iter().copied().find(|&at_ns| at_ns >= from_ns);
    match fault.kind {
        FaultKind::SensorBrownout => {
            first_after(&outcome.record.sensor_ready_ns, fault.end_ns()).unwrap_or(fault.end_ns())
        }
        FaultKind::WatchdogHang => {
            first_after(&outcome.record.resets_ns, fault.start_ns).unwrap_or(fault.start_ns)
        }
        FaultKind::CrystalDies => fault.start_ns,
        // Nothing is asked of them while they last, and everything else goes on.
        _ => fault.end_ns(),
    }
}

fn tilt_error_deg(sample: &Publication, truth: Quaternion) -> f64 {
    let attitude = sample.snapshot.attitude;
    let [w, x, y, z] = [attitude.w, attitude.x, attitude.y, attitude.z].map(f64::from);
    inclination_error_rad(Quaternion { w, x, y, z }, truth).to_degrees()
}

fn names(faults: &[ScheduledFault]) -> String {
    let names: Vec<String> = faults.iter().map(ScheduledFault::to_string).collect();
    names.join(", then ")
}

fn seconds(at_ns: u64) -> String {
    format!("{:.4}", at_ns as f64 * 1e-9)
}

/// The table of a campaign: a row for each class.
#[derive(Clone, Debug, Default)]
pub struct Table {
    rows: BTreeMap<&'static str, Row>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Row {
    faults: u32,
    detected: u32,
    recovered: u32,
    worst_ns: u64,
}

impl Table {
    /// Takes a case's report into account.
    pub fn add(&mut self, report: &Report) {
        for fault in &report.faults {
            let row = self.rows.entry(fault.class).or_default();
            row.faults += 1;
            row.detected += u32::from(fault.is_detected);
            if let Some(recovery_ns) = fault.recovery_ns {
                row.recovered += 1;
                row.worst_ns = row.worst_ns.max(recovery_ns);
            }
        }
    }
}

impl std::fmt::Display for Table {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut text = format!(
            "{:<18} {:>7} {:>9} {:>10} {:>17}\n",
            "fault", "runs", "detected", "recovered", "worst recovery ms"
        );
        for class in Schedule::classes() {
            let row = self.rows.get(class).copied().unwrap_or_default();
            writeln!(
                text,
                "{class:<18} {:>7} {:>9} {:>10} {:>17.1}",
                row.faults,
                row.detected,
                row.recovered,
                row.worst_ns as f64 * 1e-6
            )?;
        }
        formatter.write_str(&text)
    }
}
