//! Random flights with random faults, and the rules that every flight must keep.
//!
//! - No hang, no crash, and no reset except after a `watchdog-hang`, a `crash` or a
//!   `stack-overflow`.
//! - A tilt that is wrong by more than the larger of 5° and six σ is never published as valid.
//! - The attitude is valid for 99.5 % of the time without a fault after start-up, and again within
//!   the deadline after each fault. The deadline is 20 ms after the end of a bus fault. It is 250
//!   ms after a reset, after the sensor's first possible acknowledge, and after a fault of the
//!   sensor's data.
//! - A snapshot is published every 20 ms while the core runs; without data it is flagged stale. A
//!   line of telemetry comes every 100 ms.
//! - No access to a register breaks a rule of [`checks`](crate::checks).
//! - Without a fault no data-ready edge is without its sample, and times are right to a
//!   microsecond.

mod coverage;
mod judge;
mod table;
#[cfg(test)]
mod tests;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use aplomb_models::motion::quadrotor::{Quadrotor, REST_S};
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::{Later, Moving, Swing};
use aplomb_models::motion::{Motion, Quaternion};
use aplomb_models::random::Random;

pub use coverage::Coverage;
pub use judge::judge;
pub use table::Table;

use crate::faults::{FaultKind, ScheduledFault};
use crate::flight::{Outcome, Run};
use crate::kit::Kit;
use crate::profile::Garage;
use crate::schedule::Schedule;

/// Deadlines of recovery, ns.
const BUS_DEADLINE_NS: u64 = 20_000_000;
const RESET_DEADLINE_NS: u64 = 250_000_000;

/// The motion begins after this much rest, s: the gyroscope's offset has been measured by then.
const MOTION_REST_S: f64 = 1.45;

/// Time that a run continues after its last deadline, ns; and time from a hang to the latest reset
/// by the watchdog.
const TAIL_NS: u64 = 300_000_000;
const WATCHDOG_NS: u64 = 3_000_000_000;

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
}

/// Shares of the flights that last [`LONG_S`], and that start in motion.
const LONG_SHARE: f64 = 0.03;
const MOVING_SHARE: f64 = 0.05;
/// Duration of a long flight, and the time by which its faults come later at most, s.
const LONG_S: f64 = 20.0;
const LATEST_S: f64 = 12.0;
/// Time of motion of a start in motion, s, and the longer rest after it: a bias that motion has
/// shown takes longer to be measured.
const MOVING_S: f64 = 2.0;
const LONGER_REST_S: f64 = 1.5;

impl Case {
    /// The case of this seed. Consecutive seeds begin with consecutive classes of faults.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
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
                ..Self::new(seed, schedule.later(MOVING_S + LONGER_REST_S))
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
            moving_s: 0.0,
        }
    }

    /// Motion of the board: a flight, a swing, or none at all.
    #[must_use]
    pub fn motion(&self) -> Box<dyn Motion> {
        let mut random = Random::new(self.seed, "motion of a case");
        let kind = random.uniform(0.0, 1.0);
        if self.moving_s > 0.0 {
            return Box::new(Moving {
                swing: Swing::by_seed(self.seed, MOTION_REST_S + LONGER_REST_S),
                first_s: self.moving_s,
            });
        }
        // A long flight is one in motion.
        let kind = if self.seconds < LONG_S {
            kind
        } else {
            0.8 * kind
        };
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
        Self::end(self.run(firmware))
    }

    /// Flies it with a processor from a garage: the same flight in a fraction of the time.
    ///
    /// # Errors
    ///
    /// As [`Self::fly`].
    pub fn fly_from(&self, garage: &Arc<Garage>, firmware: &Path) -> Result<Outcome, String> {
        Self::end(self.run(firmware).garage(garage))
    }

    /// Returns the settings of its run.
    fn run(&self, firmware: &Path) -> Run {
        let needs_probe = self
            .schedule
            .faults
            .iter()
            .any(|fault| fault.kind == FaultKind::ProbeDetach);
        let faults = &self.schedule.faults;
        let has_compass = faults.iter().any(|fault| fault.kind.is_of_compass());
        let mut run = Run::new(firmware)
            .kit(if has_compass { Kit::Gy87 } else { Kit::Mpu6050 })
            .seed(self.seed)
            .seconds(self.seconds)
            .boxed_motion(self.motion())
            .schedule(&self.schedule)
            .without_account();
        if !needs_probe {
            run = run.without_probe();
        }
        run
    }

    fn end(run: Run) -> Result<Outcome, String> {
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
        FaultKind::UartFlood | FaultKind::UartNoise | FaultKind::ProbeDetach => None,
        FaultKind::CompassStall => Some(BUS_DEADLINE_NS),
        kind if kind.is_of_compass() => None,
        FaultKind::SensorBrownout
        | FaultKind::RegisterFlip(..)
        | FaultKind::Frozen
        | FaultKind::Zeros
        | FaultKind::Ones
        | FaultKind::Saturated(_)
        | FaultKind::CrystalDies
        | FaultKind::WatchdogHang
        | FaultKind::Crash
        | FaultKind::StackOverflow => Some(RESET_DEADLINE_NS),
        _ => Some(BUS_DEADLINE_NS),
    }
}

/// The outcome of one fault.
#[derive(Clone, Debug)]
pub struct FaultReport {
    /// Class of the fault.
    pub class: &'static str,
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

/// Flies a case with a processor from a garage, and judges it. The outcome is there if the run
/// came to its end.
#[must_use]
pub fn run(case: &Case, garage: &Arc<Garage>, firmware: &Path) -> (Report, Option<Outcome>) {
    match case.fly_from(garage, firmware) {
        Ok(outcome) => {
            let mut report = judge(case, &outcome.record, &outcome.uart_lines);
            report.failures.extend_from_slice(&outcome.violations);
            (report, Some(outcome))
        }
        Err(error) => {
            let report = Report {
                faults: Vec::new(),
                failures: vec![error],
            };
            (report, None)
        }
    }
}
