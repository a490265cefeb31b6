//! The rule for faults of the compass: the firmware flags one that it must have met.
//!
//! The rule asks for no count. The firmware counts the beginning of a fault. The next fault may
//! begin before the compass is sound again, and is then not counted. The flag stays set meanwhile.

use aplomb::health::Flags;

use super::Case;
use crate::faults::{FaultKind, ScheduledFault};
use crate::recorder::Record;

/// Longest time from the beginning of a fault to its flag, ns. The latest row of docs/faults.md has
/// 540 ms: readings that repeat.
const NOTICED_NS: u64 = 600_000_000;

/// The shortest stall that the firmware must meet, and the time from its end to its flag, ns: the
/// firmware addresses the compass at least once in 40 ms, and frees the bus first.
const SHORTEST_STALL_NS: u64 = 40_000_000;
const AFTER_STALL_NS: u64 = 40_000_000;

/// Time after another fault in which the compass may not be in use yet, ns: a start, or the pause
/// after a stall.
const AFTER_OTHERS_NS: u64 = 1_700_000_000;

/// Checks the flag of each fault of the compass that nothing hides. A save stops all transfers.
pub(super) fn check_flags(case: &Case, record: &Record, failures: &mut Vec<String>) {
    if case.conditions.save_s.is_some() {
        return;
    }
    let faults = &case.schedule.faults;
    for fault in faults.iter().filter(|fault| fault.kind.is_of_compass()) {
        let Some(due_ns) = due_ns(fault) else {
            continue;
        };
        let hides = |other: &ScheduledFault| {
            let end_ns = other.end_ns().saturating_add(AFTER_OTHERS_NS);
            other != fault && other.start_ns < due_ns && fault.start_ns < end_ns
        };
        if faults.iter().any(hides) {
            continue;
        }
        let during = fault.start_ns..=due_ns;
        let is_flagged = record.samples.iter().any(|sample| {
            during.contains(&sample.published_ns)
                && sample.snapshot.flags.contains(Flags::COMPASS_FAULT)
        });
        if !is_flagged {
            let after_ms = (due_ns - fault.start_ns) / 1_000_000;
            failures.push(format!("no COMPASS_FAULT within {after_ms} ms: {fault}"));
        }
    }
}

/// Returns the time at which the flag is due; `None` for a fault that the firmware may miss.
fn due_ns(fault: &ScheduledFault) -> Option<u64> {
    let (shortest_ns, due_ns) = if fault.kind == FaultKind::CompassStall {
        (SHORTEST_STALL_NS, fault.end_ns() + AFTER_STALL_NS)
    } else {
        (NOTICED_NS, fault.start_ns + NOTICED_NS)
    };
    (fault.duration_ns >= shortest_ns).then_some(due_ns)
}
