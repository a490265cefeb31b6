//! The rules for flights by the internal oscillator.

use aplomb::health::Flags;

use super::conditions::NO_CRYSTAL;
use super::{Case, FaultReport, Report};
use crate::faults::{FaultKind, ScheduledFault};
use crate::recorder::Record;

/// Time from the crystal's death to the first flagged attitude, ns. The fault's recovery may take
/// longer.
const FLAGGED_NS: u64 = super::BUS_DEADLINE_NS;

/// Returns true if the crystal dies while the core runs by the internal oscillator, because the
/// crystal has died before, and no reset has come between.
pub(super) fn is_unused_crystal(case: &Case, record: &Record, fault: &ScheduledFault) -> bool {
    let dies = |fault: &ScheduledFault| fault.kind == FaultKind::CrystalDies;
    let mut faults = case.schedule.faults.iter();
    dies(fault)
        && faults.any(|earlier| {
            let between = earlier.start_ns..fault.start_ns;
            dies(earlier)
                && !between.is_empty()
                && !record.resets_ns.iter().any(|at_ns| between.contains(at_ns))
        })
}

/// Checks that each snapshot by the internal oscillator has its flags.
pub(super) fn check_flags(case: &Case, record: &Record, report: &mut Report) {
    let faults = case.schedule.faults.iter();
    let mut dies = faults.filter(|fault| fault.kind == FaultKind::CrystalDies);
    let from_ns = if case.conditions.lacks_crystal {
        0
    } else if let Some(fault) = dies.next() {
        fault.start_ns + FLAGGED_NS
    } else {
        return;
    };
    // After a reset the crystal may be back.
    let resets = record.resets_ns.iter().copied();
    let to_ns = resets.filter(|_| !case.conditions.lacks_crystal).min();
    let range = from_ns..to_ns.unwrap_or(u64::MAX);
    let samples = record.samples.iter();
    let unflagged = samples.filter(|sample| {
        let flags = sample.snapshot.flags;
        let expected = Flags::INTERNAL_CLOCK | Flags::DEGRADED;
        range.contains(&sample.published_ns) && !flags.contains(expected)
    });
    let count = unflagged.count();
    if count > 0 {
        report.failures.push(format!(
            "{count} attitudes by the internal oscillator without INTERNAL_CLOCK and DEGRADED"
        ));
    }
    if case.conditions.lacks_crystal {
        report.faults.push(FaultReport {
            kind: NO_CRYSTAL,
            is_detected: count == 0,
            recovery_ns: Some(0),
        });
    }
}
