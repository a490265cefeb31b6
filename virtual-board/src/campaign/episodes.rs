//! Episodes: the faults of a flight in groups, each with its deadline.

use super::{Case, RESET_DEADLINE_NS, deadline_ns};
use crate::faults::{FaultKind, ScheduledFault, nanoseconds};
use crate::recorder::Record;

/// The pause of a save, ns: 0.6 s, and the sensor's settings after it. An erase, which is half a
/// second of it, stalls the core (src/board/flash.rs).
pub(super) const SAVE_NS: u64 = 750_000_000;
pub(super) const LONGEST_ERASE_NS: u64 = 520_000_000;

/// Valid for this long without a break is recovered, ns.
pub(super) const STEADY_NS: u64 = 5_000_000;

/// A fault, or several that follow each other too closely to separate.
#[derive(Clone, Debug)]
pub(super) struct Episode {
    pub(super) start_ns: u64,
    /// End of the last of them, from which recovery can begin.
    pub(super) end_ns: u64,
    /// Deadline for a valid attitude.
    pub(super) due_ns: u64,
    pub(super) faults: Vec<ScheduledFault>,
    pub(super) has_save: bool,
}

/// Groups the faults, and a save, into episodes.
pub(super) fn episodes(case: &Case, record: &Record) -> Vec<Episode> {
    let of_fault = |fault: &ScheduledFault| {
        let end_ns = end_ns(fault, record);
        Episode {
            start_ns: fault.start_ns,
            end_ns,
            due_ns: end_ns + deadline_ns(fault.kind).unwrap_or(0),
            faults: vec![*fault],
            has_save: false,
        }
    };
    let of_save = save_ns(case).map(|save| Episode {
        start_ns: save.start,
        end_ns: save.end,
        due_ns: save.end + RESET_DEADLINE_NS,
        faults: Vec::new(),
        has_save: true,
    });
    let mut all: Vec<Episode> = case.schedule.faults.iter().map(of_fault).collect();
    all.extend(of_save);
    all.sort_by_key(|episode| episode.start_ns);
    let mut episodes: Vec<Episode> = Vec::new();
    for episode in all {
        match episodes.last_mut() {
            // A fault that begins before the attitude can have recovered belongs to the last
            // episode.
            Some(last) if last.due_ns + STEADY_NS >= episode.start_ns => {
                last.end_ns = last.end_ns.max(episode.end_ns);
                last.due_ns = last.due_ns.max(episode.due_ns);
                last.faults.extend(episode.faults);
                last.has_save |= episode.has_save;
            }
            _ => episodes.push(episode),
        }
    }
    episodes
}

/// Returns the time of a save: the sensor stops. If the crystal dies in the erase, the core's timer
/// runs slower until the erase ends, and the firmware's pause lasts longer, by up to an erase.
pub(super) fn save_ns(case: &Case) -> Option<std::ops::Range<u64>> {
    let start_ns = nanoseconds(case.conditions.save_s?);
    let mut faults = case.schedule.faults.iter();
    let slows = |fault: &ScheduledFault| {
        fault.kind == FaultKind::CrystalDies
            && (start_ns..start_ns + LONGEST_ERASE_NS).contains(&fault.start_ns)
    };
    let longer_ns = if faults.any(slows) {
        LONGEST_ERASE_NS
    } else {
        0
    };
    Some(start_ns..start_ns + SAVE_NS + longer_ns)
}

/// Returns the time at which a fault is over, so that the firmware can recover from it.
pub(super) fn end_ns(fault: &ScheduledFault, record: &Record) -> u64 {
    let first_after =
        |times: &[u64], from_ns: u64| times.iter().copied().find(|&at_ns| at_ns >= from_ns);
    match fault.kind {
        kind if kind.stops_sensor() && !kind.resets() => {
            first_after(&record.sensor_ready_ns, fault.end_ns()).unwrap_or(fault.end_ns())
        }
        kind if kind.resets() => {
            first_after(&record.resets_ns, fault.start_ns).unwrap_or(fault.start_ns)
        }
        FaultKind::CrystalDies => fault.start_ns,
        // Such faults leave no trace.
        kind if deadline_ns(kind).is_none() => fault.start_ns,
        _ => fault.end_ns(),
    }
}
