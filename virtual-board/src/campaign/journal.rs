//! The journal of a campaign: a line for each flight, so that an interrupted campaign goes on.
//!
//! A line has the seed, `ok` or `failed`, `heading` if a heading was valid or else `-`, the steps
//! of the bus in which the faults began, and the faults:
//! `7 ok heading idle,rd3 sda-low:yes:5200000ns,frozen:no:-`. An empty list is `-`.

use std::fmt;

use super::conditions::NO_CRYSTAL;
use super::{FaultReport, Report};
use crate::bus_step::BusStep;
use crate::recorder::Record;
use crate::schedule::Schedule;

/// One flight.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Seed of the flight.
    pub seed: u64,
    /// True if it broke a rule.
    pub has_failed: bool,
    /// True if a heading was valid, so that the rule for headings has judged one.
    pub has_heading: bool,
    /// Steps of the bus in which its faults began.
    pub steps: Vec<BusStep>,
    /// Faults of the flight, with what came of them.
    pub faults: Vec<FaultReport>,
}

impl Entry {
    /// The entry of a judged flight. The record is there if the run came to its end.
    #[must_use]
    pub fn new(seed: u64, report: &Report, record: Option<&Record>) -> Self {
        let mut samples = record.iter().flat_map(|record| &record.samples);
        Self {
            seed,
            has_failed: !report.failures.is_empty(),
            has_heading: samples.any(|sample| sample.valid_heading().is_some()),
            steps: record.map_or_else(Vec::new, |record| record.steps_at_faults.clone()),
            faults: report.faults.clone(),
        }
    }

    /// Reads a line. `None` if it is not a whole one, as after an interruption.
    #[must_use]
    pub fn parse(line: &str) -> Option<Self> {
        let [seed, verdict, heading, steps, faults] = line.split(' ').collect::<Vec<_>>()[..]
        else {
            return None;
        };
        let step = |name| BusStep::all().find(|step| step.name() == name);
        Some(Self {
            seed: seed.parse().ok()?,
            has_failed: match verdict {
                "ok" => false,
                "failed" => true,
                _ => return None,
            },
            has_heading: match heading {
                "heading" => true,
                "-" => false,
                _ => return None,
            },
            steps: items(steps).map(step).collect::<Option<_>>()?,
            faults: items(faults).map(fault).collect::<Option<_>>()?,
        })
    }
}

fn items(list: &str) -> impl Iterator<Item = &str> {
    list.split(',').filter(|item| *item != "-")
}

fn fault(text: &str) -> Option<FaultReport> {
    let [kind, detected, recovery] = text.split(':').collect::<Vec<_>>()[..] else {
        return None;
    };
    let mut kinds = Schedule::kinds().chain([NO_CRYSTAL]);
    Some(FaultReport {
        kind: kinds.find(|name| *name == kind)?,
        is_detected: detected == "yes",
        recovery_ns: match recovery {
            "-" => None,
            ns => Some(ns.strip_suffix("ns")?.parse().ok()?),
        },
    })
}

impl fmt::Display for Entry {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |items: Vec<String>| match items.is_empty() {
            true => "-".into(),
            false => items.join(","),
        };
        let verdict = if self.has_failed { "failed" } else { "ok" };
        let heading = if self.has_heading { "heading" } else { "-" };
        let steps = self.steps.iter().map(|step| step.name());
        let faults = self.faults.iter().map(|fault| {
            let detected = if fault.is_detected { "yes" } else { "no" };
            let recovery = fault.recovery_ns.map(|ns| format!("{ns}ns"));
            let recovery = recovery.unwrap_or_else(|| "-".into());
            format!("{}:{detected}:{recovery}", fault.kind)
        });
        let (steps, faults) = (list(steps.collect()), list(faults.collect()));
        let seed = self.seed;
        write!(formatter, "{seed} {verdict} {heading} {steps} {faults}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_reads_back_and_a_cut_one_does_not() {
        let fault = |kind, recovery_ns| FaultReport {
            kind,
            is_detected: true,
            recovery_ns,
        };
        let entry = Entry {
            seed: 88_800_043,
            has_failed: false,
            has_heading: true,
            steps: vec![BusStep::Idle, BusStep::Read(3)],
            faults: vec![fault("sda-low", Some(5_200_000)), fault(NO_CRYSTAL, None)],
        };
        let text = entry.to_string();
        assert_eq!(
            text,
            "88800043 ok heading idle,rd3 sda-low:yes:5200000ns,no-crystal:yes:-"
        );
        assert_eq!(Entry::parse(&text).unwrap().to_string(), text);
        for end in 0..text.len() {
            let cut = Entry::parse(&text[..end]).map(|entry| entry.to_string());
            // A whole fault less is a whole line: the reader needs the line feed too.
            let is_shorter = cut.as_deref().is_none_or(|cut| text[..end] == *cut);
            assert!(is_shorter, "{cut:?}");
        }
        let empty = "1 failed - - -";
        assert_eq!(Entry::parse(empty).unwrap().to_string(), empty);
        for wrong in [
            "",
            "x ok - - -",
            "1 fine - - -",
            "1 ok yes - -",
            "1 ok - nowhere -",
            "1 ok - - none:yes:-",
        ] {
            assert!(Entry::parse(wrong).is_none(), "{wrong}");
        }
    }
}
