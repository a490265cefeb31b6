//! Random flights with random faults, and the rules that every flight must keep.
//!
//! - No hang, no crash, and no reset except after a `watchdog-hang`, a `crash` or a
//!   `stack-overflow`, and when the supply is back.
//! - A tilt that is wrong by more than the larger of 5° and six σ is never published as valid,
//!   nor a heading that is wrong by more than the larger of 15° and six σ. No attitude is valid
//!   without a burst that the sensor delivered. A tilt is degraded from a σ of 5° on, and not
//!   valid from one of 30° on.
//! - The attitude is valid for 99.5 % of the time without a fault after start-up, and again within
//!   the deadline after each fault. The deadline is 20 ms after the end of a bus fault. It is 250
//!   ms after a reset, the sensor's first possible acknowledge, a fault of the sensor's data, the
//!   crystal's death and a save. It is 1.7 s after a failure of the supply, and 5 s after a stuck
//!   axis, whose first 0.26 s are not judged.
//! - A snapshot is published every 20 ms while the core runs; without data it is flagged stale. A
//!   line of telemetry comes every 100 ms.
//! - No access breaks a rule of [`checks`](crate::checks). Each access has its register and its
//!   model, and each interrupt its line.
//! - A fault of the compass that nothing hides is flagged in 0.6 s, a long stall 40 ms after its
//!   end.
//! - By the internal oscillator each attitude has its flags, and a save leaves the old record or
//!   the new one.
//! - Without a fault no data-ready edge is without its sample, times are right to a microsecond,
//!   and rates to 6 °/s, 5 %, and their change in 2 ms. Each flag has a cause. Without one an
//!   attitude is not degraded for longer than a second.

mod clock;
mod compass;
mod conditions;
mod coverage;
mod episodes;
mod free_time;
mod journal;
mod judge;
mod slots;
mod table;
#[cfg(test)]
mod tests;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use aplomb_models::compass::{CompassConfig, Part};
use aplomb_models::motion::quadrotor::{Quadrotor, REST_S};
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::{ByOtherClock, Later, Moving, Swing};
use aplomb_models::motion::{Motion, Quaternion};
use aplomb_models::random::Random;

pub use conditions::Conditions;
pub use coverage::Coverage;
pub use journal::Entry;
pub use judge::judge;
pub use table::Table;

use crate::faults::{FaultKind, ScheduledFault};
use crate::flight::{Outcome, Run};
use crate::kit::Kit;
use crate::profile::ProcessorPool;
use crate::schedule::{FIRST_FAULT_S, Schedule};

/// Deadlines of recovery, ns.
const BUS_DEADLINE_NS: u64 = 20_000_000;
const RESET_DEADLINE_NS: u64 = 250_000_000;
/// As after the first power-up: the gyroscope's offset is measured anew.
const POWER_DEADLINE_NS: u64 = (FIRST_FAULT_S * 1e9) as u64;
/// The tilt is lost, and found again from the flight's accelerations.
const TILT_DEADLINE_NS: u64 = 5_000_000_000;

/// The motion begins after this much rest, s: the gyroscope's offset has been measured by then.
const MOTION_REST_S: f64 = 1.45;

/// Time that a run continues after its last deadline, ns; and time from a hang to the latest reset
/// by the watchdog.
const TAIL_NS: u64 = 300_000_000;
const WATCHDOG_NS: u64 = 3_000_000_000;

/// Addresses that the memory protection unit refuses, where there is one.
const BELOW_RAM: std::ops::Range<u64> = 0x1FFF_8000..0x2000_0000;

/// A flight and its faults.
#[derive(Clone, Debug)]
pub struct Case {
    /// The seed that all the rest follows from.
    pub seed: u64,
    /// The faults.
    pub schedule: Schedule,
    /// Duration, s.
    pub seconds: f64,
    /// Time of motion before the rest, from power-up on, s; zero for a start at rest.
    pub moving_s: f64,
    /// The clocks, and a save.
    pub conditions: Conditions,
}

/// Shares of the flights that last [`LONG_S`], and that start in motion.
const LONG_SHARE: f64 = 0.03;
const MOVING_SHARE: f64 = 0.05;
/// Share of the flights without a fault of a compass that have one.
const COMPASS_SHARE: f64 = 0.1;
/// Duration of a long flight, and the time by which its faults come later at most, s.
const LONG_S: f64 = 20.0;
const LATEST_S: f64 = 12.0;
/// Time of motion of a start in motion, s, and the rest after it beyond [`MOTION_REST_S`]: a bias
/// that motion has shown takes longer to be measured.
const MOVING_S: f64 = 2.0;
const EXTRA_REST_S: f64 = 1.5;
/// Rest beyond [`MOTION_REST_S`] in a flight with a save, s: the save stops the sensor.
const EXTRA_REST_FOR_SAVE_S: f64 = 1.6;

impl Case {
    /// The case of this seed. Consecutive seeds begin with consecutive kinds of faults.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
        let case = Self::with_schedule_by_seed(seed);
        let is_plain = case.moving_s == 0.0 && case.seconds < LONG_S;
        conditions::draw_stuck_axis(conditions::draw(case, is_plain))
    }

    fn with_schedule_by_seed(seed: u64) -> Self {
        let schedule = Schedule::by_seed(seed);
        let mut random = Random::new(seed, "course of a case");
        let course = random.uniform(0.0, 1.0);
        if course < LONG_SHARE {
            let later_s = random.uniform(0.0, LATEST_S);
            let case = Self::new(seed, schedule.later(later_s));
            Self {
                seconds: case.seconds.max(LONG_S),
                ..case
            }
        } else if course < LONG_SHARE + MOVING_SHARE {
            Self {
                moving_s: MOVING_S,
                ..Self::new(seed, schedule.later(MOVING_S + EXTRA_REST_S))
            }
        } else {
            Self::new(seed, schedule)
        }
    }

    /// A flight of this seed with these faults.
    #[must_use]
    pub fn new(seed: u64, schedule: Schedule) -> Self {
        let over_ns = |fault: &ScheduledFault| match fault.end_ns() {
            _ if fault.kind.resets() => fault.start_ns + WATCHDOG_NS,
            u64::MAX => fault.start_ns + RESET_DEADLINE_NS,
            // The sensor takes up to 90 ms to start.
            end_ns if fault.kind.stops_sensor() => end_ns + 100_000_000 + RESET_DEADLINE_NS,
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
            moving_s: 0.0,
            conditions: Conditions::default(),
        }
    }

    /// Motion of the board by the core's time, which passes by the oscillator that times the core.
    #[must_use]
    pub fn motion_by_core_time(&self) -> Box<dyn Motion> {
        let motion = self.motion();
        match self.conditions.core_time(&self.schedule) {
            Some((error, from_ns)) => Box::new(ByOtherClock {
                motion,
                from_s: from_ns as f64 * 1e-9,
                error,
            }),
            None => motion,
        }
    }

    /// Motion of the board: a flight, a swing, or none at all.
    #[must_use]
    pub fn motion(&self) -> Box<dyn Motion> {
        let mut random = Random::new(self.seed, "motion of a case");
        let kind = random.uniform(0.0, 1.0);
        if self.moving_s > 0.0 {
            return Box::new(Moving {
                swing: Swing::by_seed(self.seed, MOTION_REST_S + EXTRA_REST_S),
                first_s: self.moving_s,
            });
        }
        let rest_s = match self.conditions.save_s {
            // After a loss of supply the gyroscope's offset is measured again.
            _ if self.loses_power() => f64::INFINITY,
            Some(_) => MOTION_REST_S + EXTRA_REST_FOR_SAVE_S,
            None => MOTION_REST_S,
        };
        // A long flight moves, unless its supply fails.
        let kind = if self.seconds < LONG_S {
            kind
        } else {
            0.8 * kind
        };
        if kind < 0.5 && rest_s.is_finite() {
            Box::new(Swing::by_seed(self.seed, rest_s))
        } else if kind < 0.8 && rest_s.is_finite() {
            Box::new(Later {
                motion: Quadrotor::by_seed(self.seed),
                by_s: REST_S - rest_s,
            })
        } else {
            let mut angle = || random.uniform(-0.7, 0.7);
            Box::new(Rest::new(Quaternion::from_euler(angle(), angle(), 0.0)))
        }
    }

    /// Returns true if the supply fails in flight.
    fn loses_power(&self) -> bool {
        let mut faults = self.schedule.faults.iter();
        faults.any(|fault| fault.kind.stops_core())
    }

    /// Flies it.
    ///
    /// # Errors
    ///
    /// When the image cannot be used, or the emulator gives up or panics.
    pub fn fly(&self, firmware: &Path) -> Result<Outcome, String> {
        Self::run_guarded(self.run(firmware))
    }

    /// Flies it with a processor from a pool: the same flight in a fraction of the time.
    ///
    /// # Errors
    ///
    /// As [`Self::fly`].
    pub fn fly_pooled(
        &self,
        pool: &Arc<ProcessorPool>,
        firmware: &Path,
    ) -> Result<Outcome, String> {
        Self::run_guarded(self.run(firmware).pool(pool))
    }

    /// Returns the settings of its run.
    fn run(&self, firmware: &Path) -> Run {
        let needs_probe = self
            .schedule
            .faults
            .iter()
            .any(|fault| fault.kind == FaultKind::ProbeDetach);
        let (kit, compass) = self.kit();
        let mut run = Run::new(firmware)
            .kit(kit)
            .seed(self.seed)
            .seconds(self.seconds)
            .boxed_motion(self.motion())
            .schedule(&self.schedule)
            .without_memory_protection()
            .without_account();
        if let Some(part) = compass {
            run = run.compass(CompassConfig::new(self.seed, part));
        }
        if !needs_probe {
            run = run.without_probe();
        }
        if let Some(save_s) = self.conditions.save_s {
            let rate = format!("rate {}", slots::SAVED_HZ);
            run = run.flash(slots::with_record());
            run = run.command(save_s - 0.1, &rate).command(save_s, "save");
        }
        self.conditions.faults().fold(run, Run::fault)
    }

    /// Returns the sensor board, and a compass beside it. A fault of the compass has one of all
    /// compasses, most other flights none. Drawn from a stream of its own.
    fn kit(&self) -> (Kit, Option<Part>) {
        let mut random = Random::new(self.seed, "kit of a case");
        let has_compass = {
            let mut faults = self.schedule.faults.iter();
            faults.any(|fault| fault.kind.is_of_compass())
        };
        if random.uniform(0.0, 1.0) >= COMPASS_SHARE && !has_compass {
            return (Kit::Mpu6050, None);
        }
        match random.uniform(0.0, 4.0) as u8 {
            0 => (Kit::Mpu9250, None),
            1 => (Kit::Mpu6050, Some(Part::Hmc5883l)),
            2 => (Kit::Mpu6050, Some(Part::Qmc5883p)),
            _ => (Kit::Gy87, None),
        }
    }

    fn run_guarded(run: Run) -> Result<Outcome, String> {
        match catch_unwind(AssertUnwindSafe(|| run.run())) {
            Ok(outcome) => outcome.map_err(|error| error.to_string()),
            Err(_) => Err("the emulator panicked".into()),
        }
    }
}

/// Returns the deadline of the recovery from a fault; `None` if the fault must leave no trace.
#[must_use]
pub fn deadline_ns(kind: FaultKind) -> Option<u64> {
    match kind {
        FaultKind::UartFlood
        | FaultKind::UartNoise
        | FaultKind::ProbeDetach
        | FaultKind::CompassSilent
        | FaultKind::CompassFrozen
        | FaultKind::CompassZeros
        | FaultKind::CompassOverflow
        | FaultKind::CompassGarbled
        | FaultKind::CompassNeverReady
        | FaultKind::CompassIdentity(_) => None,
        FaultKind::Stuck(_) => Some(TILT_DEADLINE_NS),
        FaultKind::SupplySag(_) if kind.stops_core() => Some(POWER_DEADLINE_NS),
        FaultKind::SupplySag(_) if !kind.stops_sensor() => None,
        FaultKind::SupplySag(_)
        | FaultKind::SensorBrownout
        | FaultKind::RegisterFlip(..)
        | FaultKind::Frozen
        | FaultKind::Zeros
        | FaultKind::Ones
        | FaultKind::Saturated(_)
        | FaultKind::CrystalDies
        | FaultKind::WatchdogHang
        | FaultKind::Crash
        | FaultKind::StackOverflow(_) => Some(RESET_DEADLINE_NS),
        FaultKind::AddressNack(_)
        | FaultKind::DataNack(_)
        | FaultKind::BurstStall
        | FaultKind::SdaLow(_)
        | FaultKind::SclLow
        | FaultKind::BusError(_)
        | FaultKind::ArbitrationLost
        | FaultKind::DmaError
        | FaultKind::IntMissing
        | FaultKind::IntHigh
        | FaultKind::IntLow
        | FaultKind::IntGlitch(_)
        | FaultKind::SensorSilent
        | FaultKind::Temperature(_)
        | FaultKind::CoreStall
        | FaultKind::AttitudeLate
        | FaultKind::DebuggerReset
        | FaultKind::CompassStall => Some(BUS_DEADLINE_NS),
    }
}

/// The outcome of one fault.
#[derive(Clone, Debug)]
pub struct FaultReport {
    /// Name of the kind of the fault.
    pub kind: &'static str,
    /// True if the firmware noticed it: by a counter, a flag, or a message.
    pub is_detected: bool,
    /// Time from its end to a valid attitude, ns; `None` if recovery missed the deadline.
    pub recovery_ns: Option<u64>,
}

/// The outcome of a case.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// A report for each fault.
    pub faults: Vec<FaultReport>,
    /// The rules that the flight broke.
    pub failures: Vec<String>,
}

/// Flies a case with a processor from a pool, and judges it. The outcome is there if the run
/// came to its end.
#[must_use]
pub fn run(case: &Case, pool: &Arc<ProcessorPool>, firmware: &Path) -> (Report, Option<Outcome>) {
    match case.fly_pooled(pool, firmware) {
        Ok(outcome) => (report(case, &outcome), Some(outcome)),
        Err(error) => {
            let report = Report {
                faults: Vec::new(),
                failures: vec![error],
            };
            (report, None)
        }
    }
}

/// Judges a flight by all rules: those of the record, of the registers, and of a save.
#[must_use]
pub fn report(case: &Case, outcome: &Outcome) -> Report {
    let mut report = judge(case, &outcome.record, &outcome.uart_lines);
    let violations = outcome.violations.iter();
    let own = violations.filter(|violation| !is_expected(case, violation));
    report.failures.extend(own.cloned());
    if case.conditions.save_s.is_some() {
        let slots = &outcome.flash.bytes;
        let may_be_silent = may_lose_answer(case);
        let lines = &outcome.uart_lines;
        slots::check(slots, lines, may_be_silent, &mut report.failures);
    }
    report
}

/// Returns true if a save, or its answer, may be lost: the core resets, or the UART's line is not
/// free. In a sag that the core survives, the firmware answers.
fn may_lose_answer(case: &Case) -> bool {
    let mut faults = case.schedule.faults.iter();
    let loses = |kind| matches!(kind, FaultKind::UartFlood | FaultKind::UartNoise);
    faults.any(|fault| fault.kind.resets() || loses(fault.kind))
}

/// Returns true if a fault of the case explains a violation.
///
/// - Too few wait states, if the supply is below 2.7 V: the core is outside of its specification
///   (docs/chip.md).
/// - Stores in the 32 KiB below RAM, if the stack overflows: a campaign's core has no memory
///   protection unit, which would refuse them.
fn is_expected(case: &Case, violation: &str) -> bool {
    let has = |is_cause: fn(FaultKind) -> bool| {
        let mut faults = case.schedule.faults.iter();
        faults.any(|fault| is_cause(fault.kind))
    };
    let sags = |kind| matches!(kind, FaultKind::SupplySag(millivolts) if millivolts < 2_700);
    let overflows = |kind| matches!(kind, FaultKind::StackOverflow(_));
    let address = violation.strip_prefix("no such address: unmapped at=0x");
    let address = address.and_then(|rest| u64::from_str_radix(rest.get(..8)?, 16).ok());
    violation.starts_with("FLASH.ACR") && has(sags)
        || address.is_some_and(|at| BELOW_RAM.contains(&at)) && has(overflows)
}
