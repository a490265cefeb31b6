//! The combinations that a campaign has flown: pairs of faults, and faults of the bus by its step.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Write as _};

use super::Case;
use super::conditions::NO_CRYSTAL;
use crate::bus_step::BusStep;
use crate::faults::{FaultKind, ScheduledFault};
use crate::schedule::Schedule;

/// Two faults belong together if one begins at most this long after the other has ended, ns.
const TOGETHER_NS: u64 = 50_000_000;

/// The kinds of faults of the bus.
const BUS_KINDS: [&str; 9] = [
    "address-nack",
    "data-nack",
    "burst-stall",
    "sda-low",
    "scl-low",
    "bus-error",
    "arbitration-lost",
    "dma-error",
    "sensor-silent",
];

/// The combinations that have been flown.
#[derive(Clone, Debug, Default)]
pub struct Coverage {
    /// Pairs of kinds, each in the order of the alphabet.
    pairs: BTreeSet<(&'static str, &'static str)>,
    /// Number of times that a fault of the bus began in a step.
    steps: BTreeMap<(&'static str, BusStep), u32>,
}

impl Coverage {
    /// Adds a flight. `steps` are the steps of the bus in which its faults began, in their order.
    pub fn add(&mut self, case: &Case, steps: &[BusStep]) {
        let faults = &case.schedule.faults;
        if case.conditions.lacks_crystal {
            for kind in faults.iter().map(|fault| fault.kind.name()) {
                self.pairs
                    .insert((kind.min(NO_CRYSTAL), kind.max(NO_CRYSTAL)));
            }
        }
        for (nth, first) in faults.iter().enumerate() {
            for second in faults.iter().skip(nth + 1) {
                if is_together(first, second) {
                    let (first, second) = (first.kind.name(), second.kind.name());
                    self.pairs.insert((first.min(second), first.max(second)));
                }
            }
        }
        for (fault, &step) in faults.iter().zip(steps) {
            let kind = fault.kind.name();
            if BUS_KINDS.contains(&kind) {
                *self.steps.entry((kind, step)).or_default() += 1;
            }
        }
    }

    /// Pairs of kinds that have been flown, and all that there are.
    #[must_use]
    pub fn pairs(&self) -> (usize, usize) {
        let kinds: Vec<&str> = Schedule::kinds().chain([NO_CRYSTAL]).collect();
        let pairs = (0..kinds.len()).flat_map(|nth| {
            let first = kinds[nth];
            kinds[nth..].iter().map(move |&second| [first, second])
        });
        (self.pairs.len(), pairs.filter(can_fly).count())
    }

    /// Combinations of a fault of the bus and a step that have been flown, and all that there are.
    #[must_use]
    pub fn steps(&self) -> (usize, usize) {
        let all = BUS_KINDS.len() * BusStep::all().count();
        (self.steps.len(), all)
    }
}

/// Returns true if a seed can draw both kinds for one flight.
fn can_fly(pair: &[&str; 2]) -> bool {
    let resetting = Schedule::examples().filter(FaultKind::resets);
    let resetting: Vec<&str> = resetting.map(|kind| kind.name()).collect();
    let resets = pair.iter().filter(|kind| resetting.contains(kind)).count();
    let has = |kind: &str| pair.contains(&kind);
    let is_twice = |kind: &str| *pair == [kind; 2];
    // A fault that resets the processor is the last of its flight, which then has no stuck axis.
    let is_after_reset = resets == 2 || resets == 1 && has("stuck");
    // Without a crystal none can die, and the conditions have no save with its sag.
    let lacks_crystal = has(NO_CRYSTAL) && (has("crystal-dies") || has("supply-sag"));
    // The conditions add one of these at most.
    let is_second = is_twice(NO_CRYSTAL) || is_twice("supply-sag") || is_twice("stuck");
    !(is_after_reset || lacks_crystal || is_second)
}

fn is_together(first: &ScheduledFault, second: &ScheduledFault) -> bool {
    second.start_ns <= first.end_ns().saturating_add(TOGETHER_NS)
}

impl fmt::Display for Coverage {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (flown, all) = self.pairs();
        let (flown_steps, all_steps) = self.steps();
        writeln!(
            formatter,
            "pairs of faults within 50 ms: {flown} of {all}\n\
             faults of the bus by the step in which they began: {flown_steps} of {all_steps}"
        )?;
        let mut head = format!("{:<17}", "");
        for step in BusStep::all() {
            write!(head, " {:>5}", step.name())?;
        }
        writeln!(formatter, "{head}")?;
        for kind in BUS_KINDS {
            let mut row = format!("{kind:<17}");
            for step in BusStep::all() {
                let count = self.steps.get(&(kind, step)).copied().unwrap_or(0);
                write!(row, " {count:>5}")?;
            }
            writeln!(formatter, "{row}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Enough seeds draw each pair that [`can_fly`] accepts, and no other.
    #[test]
    fn all_pairs_are_those_that_seeds_draw() {
        let mut coverage = Coverage::default();
        for seed in 0..150_000 {
            coverage.add(&Case::by_seed(seed), &[]);
        }
        let (flown, all) = coverage.pairs();
        assert_eq!(flown, all);
        let mut pairs = coverage.pairs.iter();
        let unexpected = pairs.find(|(first, second)| !can_fly(&[first, second]));
        assert_eq!(unexpected, None);
    }
}
