//! The conditions of a flight besides its faults: the clocks, the supply, and a `save`.
//!
//! They are drawn from a stream of their own, so a seed keeps its motion and its faults. A flight
//! with a save has a sag besides; its motion begins later, or it rests, and its faults come later.

use std::fmt;

use aplomb_models::random::Random;

use super::Case;
use crate::faults::{Axis, CORE_MILLIVOLTS, Fault, FaultKind, ScheduledFault, internal_time};
use crate::schedule::Schedule;

/// The kind of a start without a crystal, in the tables of a campaign.
pub const NO_CRYSTAL: &str = "no-crystal";

/// Shares of the flights that start without a crystal, that save while the supply sags, and that
/// save while the supply fails.
const NO_CRYSTAL_SHARE: f64 = 0.05;
const SAG_SHARE: f64 = 0.04;
const CUT_SHARE: f64 = 0.02;
/// Share of the saves in a sag that the other faults come on top of.
const ON_TOP_SHARE: f64 = 0.3;
/// Share of the flights with a stuck axis, the time of its beginning after that of the first
/// fault, and its length, s.
const STUCK_SHARE: f64 = 0.03;
const STUCK_AFTER_S: std::ops::Range<f64> = 0.0..0.5;
const STUCK_S: std::ops::Range<f64> = 0.02..1.5;

/// Error of the internal oscillator, from −40 °C to 105 °C (STM32F405 datasheet, "HSI
/// oscillator characteristics").
const INTERNAL_ERROR: std::ops::Range<f64> = -0.08..0.045;
/// Frequency of the watchdog's oscillator, Hz (STM32F405 datasheet, "LSI oscillator
/// characteristics"), by the core's clock.
const WATCHDOG_HZ: std::ops::Range<f64> = 17_000.0..47_000.0;

/// Times of a save, s, and of the sag after it. An erase takes half a second.
const SAVE_S: std::ops::Range<f64> = 1.75..1.95;
const SAG_AFTER_S: std::ops::Range<f64> = -0.05..0.7;
/// A sag: its length, s, and its voltage, mV. The sensor needs 2,375, the flash 2,700, and the
/// firmware's detector looks at 2,840.
const SAG_S: std::ops::Range<f64> = 0.02..0.8;
const SAG_MILLIVOLTS: std::ops::Range<f64> = 2_380.0..2_840.0;
/// A supply that fails: its beginning after the save, s, its length, s, and its voltage, mV.
const CUT_AFTER_S: std::ops::Range<f64> = -0.02..0.7;
const CUT_S: std::ops::Range<f64> = 0.002..0.2;
const CUT_MILLIVOLTS: std::ops::Range<f64> = 0.0..(CORE_MILLIVOLTS as f64);

/// Length of a flight after its save, s: the pause, the deadline after it, and the tail.
const SAVE_ENDS_S: f64 = 1.3;

/// Time by which other faults come later than a save, s, and later than a failure of the supply,
/// after which the gyroscope's offset is measured again.
const AFTER_SAVE_S: f64 = 1.3;
const AFTER_CUT_S: f64 = 2.9;

/// The clocks of a flight, and its save.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// True if the crystal does not start.
    pub lacks_crystal: bool,
    /// Error of the internal oscillator, as a share: +0.01 runs 1 % fast.
    pub internal_error: f64,
    /// Frequency of the watchdog's oscillator, Hz.
    pub watchdog_hz: u64,
    /// Time of a `save`, s.
    pub save_s: Option<f64>,
}

impl Default for Conditions {
    /// Exact clocks, a crystal, and no save.
    fn default() -> Self {
        Self {
            lacks_crystal: false,
            internal_error: 0.0,
            watchdog_hz: 32_000,
            save_s: None,
        }
    }
}

impl Conditions {
    /// The faults of a run that make these conditions.
    pub(super) fn faults(self) -> impl Iterator<Item = Fault> {
        let crystal = self.lacks_crystal.then_some(Fault::NoCrystal);
        let internal = Fault::InternalOscillator(self.internal_error);
        let internal = (self.internal_error != 0.0).then_some(internal);
        let watchdog = Some(Fault::WatchdogClock(self.watchdog_hz));
        [crystal, internal, watchdog].into_iter().flatten()
    }

    /// Error of the core's time, as a share, and its beginning, ns, if there is one.
    pub(super) fn core_time(self, schedule: &Schedule) -> Option<(f64, u64)> {
        let faults = schedule.faults.iter().copied().map(Fault::Scheduled);
        let faults: Vec<Fault> = faults.chain(self.faults()).collect();
        internal_time(&faults)
    }
}

/// Draws the conditions of a case. `is_plain` if it starts at rest and lasts no longer than its
/// faults.
pub(super) fn draw(case: Case, is_plain: bool) -> Case {
    let mut random = Random::new(case.seed, "conditions of a case");
    let kind = random.uniform(0.0, 1.0);
    // Steps that the printed form shows.
    let error = random.uniform(INTERNAL_ERROR.start, INTERNAL_ERROR.end);
    let error = (error * 1e4).round() / 1e4;
    let watchdog_hz = random.uniform(WATCHDOG_HZ.start, WATCHDOG_HZ.end) as u64;
    let dies = |fault: &&ScheduledFault| fault.kind == FaultKind::CrystalDies;
    let death = case.schedule.faults.iter().find(dies).copied();
    let resets = case.schedule.faults.iter().any(|fault| fault.kind.resets());
    // After a reset a crystal that is back times the core again.
    let comes_back = resets && death.is_some_and(|fault| fault.duration_ns > 0);
    let lacks_crystal = kind < NO_CRYSTAL_SHARE && death.is_none();
    let is_internal = lacks_crystal || death.is_some() && !comes_back;
    let conditions = Conditions {
        lacks_crystal,
        internal_error: if is_internal { error } else { 0.0 },
        watchdog_hz,
        save_s: None,
    };
    let case = Case { conditions, ..case };
    let is_sag = (NO_CRYSTAL_SHARE..NO_CRYSTAL_SHARE + SAG_SHARE).contains(&kind);
    let is_cut =
        (NO_CRYSTAL_SHARE + SAG_SHARE..NO_CRYSTAL_SHARE + SAG_SHARE + CUT_SHARE).contains(&kind);
    if is_plain && is_sag {
        with_save(case, &mut random, false)
    } else if is_plain && is_cut && death.is_none() {
        with_save(case, &mut random, true)
    } else {
        case
    }
}

/// Gives some of the cases a stuck axis of the gyroscope besides, unless the core starts again: a
/// start takes what it reads for the offset.
pub(super) fn draw_stuck_axis(case: Case) -> Case {
    let mut random = Random::new(case.seed, "stuck axis of a case");
    let mut draw = |range: std::ops::Range<f64>| random.uniform(range.start, range.end);
    let faults = &case.schedule.faults;
    let Some(first) = faults.first() else {
        return case;
    };
    if draw(0.0..1.0) >= STUCK_SHARE || faults.iter().any(|fault| fault.kind.resets()) {
        return case;
    }
    let axis = [Axis::GyroscopeX, Axis::GyroscopeY, Axis::GyroscopeZ][draw(0.0..3.0) as usize % 3];
    let microseconds = |seconds: f64| (seconds * 1e6).round() as u64 * 1_000;
    let stuck = ScheduledFault {
        start_ns: first.start_ns + microseconds(draw(STUCK_AFTER_S)),
        duration_ns: microseconds(draw(STUCK_S)),
        kind: FaultKind::Stuck(axis),
    };
    let mut schedule = case.schedule.clone();
    schedule.faults.push(stuck);
    schedule.faults.sort_by_key(|fault| fault.start_ns);
    let new = Case::new(case.seed, schedule);
    Case {
        seconds: new.seconds.max(case.seconds),
        schedule: new.schedule,
        ..case
    }
}

/// Adds a save in a sag, or one in which the supply fails.
fn with_save(case: Case, random: &mut Random, is_cut: bool) -> Case {
    let (after_s, lasts_s, millivolts) = if is_cut {
        (CUT_AFTER_S, CUT_S, CUT_MILLIVOLTS)
    } else {
        (SAG_AFTER_S, SAG_S, SAG_MILLIVOLTS)
    };
    let mut draw = |range: std::ops::Range<f64>| random.uniform(range.start, range.end);
    let save_s = (draw(SAVE_S) * 1e6).round() * 1e-6;
    let microseconds = |seconds: f64| (seconds * 1e6).round() as u64 * 1_000;
    let sag = ScheduledFault {
        start_ns: microseconds(save_s + draw(after_s)),
        duration_ns: microseconds(draw(lasts_s)),
        kind: FaultKind::SupplySag(draw(millivolts) as u32),
    };
    let faults = &case.schedule.faults;
    // The watchdog has a longer limit during a save.
    let hangs = faults
        .iter()
        .any(|fault| fault.kind == FaultKind::WatchdogHang);
    let later_s = match draw(0.0..1.0) {
        _ if is_cut => AFTER_CUT_S,
        share if share < ON_TOP_SHARE && !hangs => 0.0,
        _ => AFTER_SAVE_S,
    };
    let mut schedule = case.schedule.later(later_s);
    schedule.faults.push(sag);
    schedule.faults.sort_by_key(|fault| fault.start_ns);
    let conditions = Conditions {
        save_s: Some(save_s),
        ..case.conditions
    };
    let new = Case::new(case.seed, schedule);
    Case {
        conditions,
        seconds: new.seconds.max(save_s + SAVE_ENDS_S),
        ..new
    }
}

impl fmt::Display for Conditions {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.lacks_crystal {
            writeln!(formatter, "no crystal")?;
        }
        if self.internal_error != 0.0 {
            let percent = 100.0 * self.internal_error;
            writeln!(formatter, "internal oscillator off by {percent:+.2} %")?;
        }
        if let Some(save_s) = self.save_s {
            writeln!(formatter, "a save at {save_s:.6} s")?;
        }
        writeln!(
            formatter,
            "watchdog's oscillator at {} Hz",
            self.watchdog_hz
        )
    }
}
