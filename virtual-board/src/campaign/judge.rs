//! The judge of a flight: which of the campaign's rules the record of the flight breaks.

use std::ops::{Range, RangeInclusive};

use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use aplomb_models::motion::{Quaternion, inclination_error_rad};

use super::episodes::{Episode, LONGEST_ERASE_NS, STEADY_NS, end_ns, episodes, save_ns};
use super::{Case, FaultReport, Report};
use crate::faults::{FaultKind, ScheduledFault};
use crate::flight::UartLine;
use crate::profile::CRASHES;
use crate::recorder::{Record, Sample};
use crate::summary::{estimate, valid_heading_deg};

/// The largest allowed error of a valid tilt: degrees, and multiples of σ.
const ALLOWED_DEG: f64 = 5.0;
const ALLOWED_SIGMAS: f64 = 6.0;

/// σ of the tilt above which an attitude must be degraded, and from which it must not be valid,
/// degrees: six σ are then half a turn.
const DEGRADED_SIGMA_DEG: f64 = 5.0;
const LOST_SIGMA_DEG: f64 = 30.0;

/// The largest allowed error of a valid heading, degrees, or as many σ.
const ALLOWED_HEADING_DEG: f64 = 15.0;

/// Longest time from the beginning of a stuck axis in motion to its flag, ns: two windows of
/// samples.
const STUCK_NS: u64 = 260_000_000;

/// The longest pause between publications while the core runs, ns.
const LONGEST_SILENCE_NS: u64 = 20_000_000;

/// The longest pause between two lines of telemetry, of which there are 50 a second, ns.
const LONGEST_UART_SILENCE_NS: u64 = 100_000_000;

/// A valid snapshot covers this much time until the next one, ns: two periods.
pub(super) const COVERED_NS: u64 = 2_000_000;

/// Judges what came of a case.
#[must_use]
pub fn judge(case: &Case, record: &Record, uart_lines: &[UartLine]) -> Report {
    let published = publications(record);
    let judge = Judge {
        record,
        uart_lines,
        valid: valid_spans(&published),
        published,
        episodes: episodes(case, record),
    };
    let mut report = Report::default();
    judge.check_processor(case, &mut report.failures);
    judge.check_tilt(case, &mut report.failures);
    super::clock::check_flags(case, record, &mut report);
    super::compass::check_flags(case, record, &mut report.failures);
    judge.check_heading(&mut report.failures);
    judge.check_recovery(case, &mut report);
    judge.check_flags(&mut report.failures);
    judge.check_fault_free_time(case, &mut report.failures);
    judge.check_silence(case, &mut report.failures);
    report
}

/// A snapshot of either kind.
#[derive(Clone, Copy, Debug)]
pub(super) struct Publication {
    pub(super) at_ns: u64,
    pub(super) snapshot: Snapshot,
    /// The true attitude at its sample, if that is known from the sample.
    truth: Option<Quaternion>,
}

/// All snapshots, in the order of their publication.
fn publications(record: &Record) -> Vec<Publication> {
    let samples = record.samples.iter().map(|sample| Publication {
        at_ns: sample.published_ns,
        snapshot: sample.snapshot,
        truth: sample.edge.and_then(|edge| edge.truth.attitude),
    });
    let stale = record.stale.iter().map(|stale| Publication {
        at_ns: stale.published_ns,
        snapshot: stale.snapshot,
        truth: None,
    });
    let mut all: Vec<Publication> = samples.chain(stale).collect();
    all.sort_by_key(|publication| publication.at_ns);
    all
}

pub(super) struct Judge<'a> {
    pub(super) record: &'a Record,
    uart_lines: &'a [UartLine],
    pub(super) published: Vec<Publication>,
    /// Spans in which the published attitude was valid, ns.
    pub(super) valid: Vec<(u64, u64)>,
    pub(super) episodes: Vec<Episode>,
}

impl Judge<'_> {
    pub(super) fn end_ns(&self) -> u64 {
        self.record.last.1
    }

    /// Checks that only the scheduled faults reset or crash the processor.
    fn check_processor(&self, case: &Case, failures: &mut Vec<String>) {
        let count = |is_asked_for: fn(&FaultKind) -> bool| {
            let faults = case.schedule.faults.iter();
            faults.filter(|fault| is_asked_for(&fault.kind)).count()
        };
        let asked_for = count(FaultKind::resets);
        let crashes =
            count(|kind| matches!(kind, FaultKind::Crash | FaultKind::StackOverflow(_))) as u64;
        let resets = &self.record.resets_ns;
        if resets.len() > asked_for {
            let at: Vec<String> = resets.iter().map(|&at_ns| seconds(at_ns)).collect();
            failures.push(format!(
                "{} resets, {asked_for} asked for: at {} s",
                resets.len(),
                at.join(", ")
            ));
        }
        if resets.len() < asked_for {
            failures.push("the core hung or crashed, and nothing reset it".into());
        }
        let instructions = &self.record.instructions;
        let crashed: u64 = CRASHES
            .filter_map(|exception| instructions.get(exception))
            .sum();
        if crashed > crashes {
            failures.push("a fault handler ran: a crash or a panic".into());
        }
    }

    /// Checks that no attitude is valid and far from the truth.
    fn check_tilt(&self, case: &Case, failures: &mut Vec<String>) {
        let mut motion = case.motion_by_core_time();
        let mut worst: Option<(f64, f64, u64)> = None;
        let mut count = 0;
        for sample in &self.published {
            if !sample.snapshot.flags.contains(Flags::VALID) || is_unnoticed(case, sample.at_ns) {
                continue;
            }
            let at_publication = || motion.at(sample.at_ns as f64 * 1e-9).attitude;
            let Some(truth) = sample.truth.or_else(at_publication) else {
                continue;
            };
            let error_deg = tilt_error_deg(sample, truth);
            let sigma_deg = f64::from(sample.snapshot.tilt_sigma_rad()).to_degrees();
            let allowed_deg = ALLOWED_DEG.max(ALLOWED_SIGMAS * sigma_deg);
            // False for NaN.
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
                "{count} attitudes published as valid were wrong, \
                 the worst by {error_deg:.1} degrees with a sigma of {sigma_deg:.2} at {} s",
                seconds(at_ns)
            ));
        }
    }

    /// Checks that the flags fit σ, and that no attitude is valid without a whole new burst.
    fn check_flags(&self, failures: &mut Vec<String>) {
        let is_wrong = |snapshot: &Snapshot| {
            let sigma_deg = f64::from(snapshot.tilt_sigma_rad()).to_degrees();
            let (is_valid, is_degraded) = (
                snapshot.flags.contains(Flags::VALID),
                snapshot.flags.contains(Flags::DEGRADED),
            );
            // Either is false for NaN.
            let (is_certain, is_known) =
                (sigma_deg <= DEGRADED_SIGMA_DEG, sigma_deg < LOST_SIGMA_DEG);
            is_valid && !is_known || !is_degraded && !is_certain
        };
        let wrong = self.published.iter().filter(|it| is_wrong(&it.snapshot));
        if let Some((first, count)) = first_and_count(wrong) {
            failures.push(format!(
                "{count} attitudes with flags that deny their sigma, the first with {} at {} s",
                first.snapshot.flags,
                seconds(first.at_ns)
            ));
        }
        let is_old =
            |sample: &&Sample| !sample.is_new && sample.snapshot.flags.contains(Flags::VALID);
        let old = self.record.samples.iter().filter(is_old);
        if let Some((first, count)) = first_and_count(old) {
            failures.push(format!(
                "{count} attitudes were valid without a whole new burst, the first at {} s",
                seconds(first.published_ns)
            ));
        }
    }

    /// Checks that no heading is valid and far from the truth.
    fn check_heading(&self, failures: &mut Vec<String>) {
        let mut worst: Option<(f64, f64, u64)> = None;
        let mut count = 0;
        for sample in &self.record.samples {
            let (Some(heading), Some(error_deg)) =
                (sample.valid_heading(), valid_heading_deg(sample))
            else {
                continue;
            };
            let sigma_deg = f64::from(heading.sigma_rad).to_degrees();
            // False for NaN.
            let is_allowed = error_deg <= ALLOWED_HEADING_DEG.max(ALLOWED_SIGMAS * sigma_deg);
            if !is_allowed {
                count += 1;
                if worst.is_none_or(|(error, ..)| error_deg > error) {
                    worst = Some((error_deg, sigma_deg, sample.published_ns));
                }
            }
        }
        if let Some((error_deg, sigma_deg, at_ns)) = worst {
            failures.push(format!(
                "{count} headings published as valid were wrong, \
                 the worst by {error_deg:.1} degrees with a sigma of {sigma_deg:.2} at {} s",
                seconds(at_ns)
            ));
        }
    }

    /// Checks that every episode ends in time.
    fn check_recovery(&self, case: &Case, report: &mut Report) {
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
                let is_detected = self.is_detected(episode, fault);
                report.faults.push(FaultReport {
                    kind: fault.kind.name(),
                    is_detected,
                    recovery_ns,
                });
                // Among several faults, one may hide another. The firmware addresses a compass
                // seldom, or not at all after a stall: such a fault may come to nothing. So does
                // the crystal's second death: until a reset the core runs without it.
                let is_alone = episode.faults.len() == 1
                    && !episode.has_save
                    && !fault.kind.is_of_compass()
                    && !super::clock::is_unused_crystal(case, self.record, fault);
                if is_alone && !is_detected && !fault.kind.counted().is_empty() {
                    let counted = self.record.counted(fault.start_ns, episode.due_ns);
                    report.failures.push(format!(
                        "not counted as one of {:?}, but as {counted:?}: {fault}",
                        fault.kind.counted()
                    ));
                }
            }
        }
    }

    /// Returns true if the firmware detected a fault during its episode, up to the deadline: it
    /// counted one of the fault's classes. A fault without a class of its own shows by a flag or a
    /// message.
    fn is_detected(&self, episode: &Episode, fault: &ScheduledFault) -> bool {
        let last_ns = episode.faults.iter().map(ScheduledFault::end_ns);
        let last_ns = last_ns.filter(|&end_ns| end_ns != u64::MAX).max();
        let until_ns = episode.due_ns.max(last_ns.unwrap_or(0));
        let during = |at_ns: u64| (episode.start_ns..=until_ns).contains(&at_ns);
        let classes = fault.kind.counted();
        if !classes.is_empty() {
            let counted = self.record.counted(fault.start_ns, until_ns);
            return counted.iter().any(|class| classes.contains(class));
        }
        let is_flagged = self
            .published
            .iter()
            .any(|sample| during(sample.at_ns) && sample.snapshot.flags != Flags::VALID);
        let is_reported = self
            .uart_lines
            .iter()
            .any(|line| during(line.at_ns) && line.text.starts_with('#'));
        is_flagged || is_reported
    }

    /// Checks that snapshots and telemetry never pause for long.
    fn check_silence(&self, case: &Case, failures: &mut Vec<String>) {
        let published: Vec<u64> = self.published.iter().map(|sample| sample.at_ns).collect();
        // No telemetry is due before the first attitude.
        let first_ns = published.first().copied().unwrap_or(u64::MAX);
        let lines = self.uart_lines.iter().map(|line| line.at_ns);
        let mut lines: Vec<u64> = lines.filter(|&at_ns| at_ns >= first_ns).collect();
        // The pause before a line begins with the first snapshot, also after a reset.
        lines.extend(published.first());
        lines.extend(self.starts_ns().map(|start| *start.end()));
        lines.retain(|&at_ns| at_ns <= self.end_ns());
        lines.sort_unstable();
        for (times_ns, longest_ns, what) in [
            (published, LONGEST_SILENCE_NS, "nothing was published"),
            (lines, LONGEST_UART_SILENCE_NS, "no line came by UART"),
        ] {
            let gap = self.longest_gap(case, times_ns);
            if let Some((gap_ns, at_ns)) = gap.filter(|&(gap_ns, _)| gap_ns > longest_ns) {
                failures.push(format!(
                    "{what} for {:.1} ms from {} s on",
                    gap_ns as f64 * 1e-6,
                    seconds(at_ns)
                ));
            }
        }
    }

    /// The times from each reset to the first attitude after it, before which no telemetry is due.
    fn starts_ns(&self) -> impl Iterator<Item = RangeInclusive<u64>> {
        self.record.resets_ns.iter().map(|&reset_ns| {
            let mut published = self.published.iter().map(|sample| sample.at_ns);
            let first_ns = published.find(|&at_ns| at_ns > reset_ns);
            reset_ns..=first_ns.unwrap_or(u64::MAX)
        })
    }

    /// Returns the longest pause between these times, or to the end, while the core runs, with its
    /// start.
    fn longest_gap(&self, case: &Case, mut times_ns: Vec<u64>) -> Option<(u64, u64)> {
        if times_ns.is_empty() {
            return None;
        }
        times_ns.push(self.end_ns());
        times_ns
            .windows(2)
            .map(|pair| pair[0]..pair[1])
            .filter(|pause| !self.is_allowed(case, pause))
            .map(|pause| (self.awake_ns(case, &pause), pause.start))
            .max_by_key(|&(gap_ns, _)| gap_ns)
    }

    /// Returns true if a pause may be of any length.
    fn is_allowed(&self, case: &Case, pause: &Range<u64>) -> bool {
        is_of_erase(case, pause)
            || self.is_of_start_without_sensor(case, pause)
            || self.is_of_reset(pause)
    }

    /// Returns the part of a pause in which the core runs, ns. A hang ends at its reset.
    fn awake_ns(&self, case: &Case, pause: &Range<u64>) -> u64 {
        let stops = |fault: &&ScheduledFault| {
            matches!(fault.kind, FaultKind::CoreStall | FaultKind::WatchdogHang)
        };
        let stopped = case.schedule.faults.iter().filter(stops).map(|fault| {
            let end_ns = end_ns(fault, self.record).min(pause.end);
            end_ns.saturating_sub(fault.start_ns.max(pause.start))
        });
        (pause.end - pause.start).saturating_sub(stopped.sum())
    }

    /// Returns true if the pause begins in a start without the sensor, which sends no telemetry.
    fn is_of_start_without_sensor(&self, case: &Case, pause: &Range<u64>) -> bool {
        let lacks_sensor = |start: &RangeInclusive<u64>| {
            case.schedule.faults.iter().any(|fault| {
                fault.kind.stops_sensor()
                    && fault.start_ns <= *start.end()
                    && end_ns(fault, self.record) >= *start.start()
            })
        };
        self.starts_ns().any(|start| {
            (*start.start()..*start.end()).contains(&pause.start) && lacks_sensor(&start)
        })
    }

    /// Returns true if the core is reset in the pause.
    fn is_of_reset(&self, pause: &Range<u64>) -> bool {
        let mut resets = self.record.resets_ns.iter();
        resets.any(|reset_ns| (pause.start..=pause.end).contains(reset_ns))
    }
}

/// Returns true if the pause is that of a save's erase, and no longer.
fn is_of_erase(case: &Case, pause: &Range<u64>) -> bool {
    pause.end - pause.start <= LONGEST_ERASE_NS
        && save_ns(case).is_some_and(|save| save.start < pause.end && save.end > pause.start)
}

/// Returns whether an axis has been stuck for so short a time that nothing shows it yet.
fn is_unnoticed(case: &Case, at_ns: u64) -> bool {
    let mut faults = case.schedule.faults.iter();
    faults.any(|fault| {
        let from_ns = fault.start_ns;
        matches!(fault.kind, FaultKind::Stuck(_)) && (from_ns..from_ns + STUCK_NS).contains(&at_ns)
    })
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

fn tilt_error_deg(sample: &Publication, truth: Quaternion) -> f64 {
    inclination_error_rad(estimate(&sample.snapshot), truth).to_degrees()
}

fn names(faults: &[ScheduledFault]) -> String {
    let mut names: Vec<String> = faults.iter().map(ScheduledFault::to_string).collect();
    if names.is_empty() {
        names.push("save".into());
    }
    names.join(", then ")
}

/// Returns the first of some findings, and their number; `None` without one.
pub(super) fn first_and_count<T>(mut findings: impl Iterator<Item = T>) -> Option<(T, usize)> {
    let first = findings.next()?;
    Some((first, 1 + findings.count()))
}

pub(super) fn seconds(at_ns: u64) -> String {
    format!("{:.4}", at_ns as f64 * 1e-9)
}
