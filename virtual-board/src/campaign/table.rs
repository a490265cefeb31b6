//! The table of a campaign.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::FaultReport;
use super::conditions::NO_CRYSTAL;
use crate::schedule::Schedule;

/// The table of a campaign: a row for each kind of fault.
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
    /// Adds the faults of a case.
    pub fn add(&mut self, faults: &[FaultReport]) {
        for fault in faults {
            let row = self.rows.entry(fault.kind).or_default();
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
        for kind in Schedule::kinds().chain([NO_CRYSTAL]) {
            let row = self.rows.get(kind).copied().unwrap_or_default();
            writeln!(
                text,
                "{kind:<18} {:>7} {:>9} {:>10} {:>17.1}",
                row.faults,
                row.detected,
                row.recovered,
                row.worst_ns as f64 * 1e-6
            )?;
        }
        formatter.write_str(&text)
    }
}
