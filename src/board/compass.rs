//! Compass task: runs the compass's session in the attitude task, one transfer per turn.
//!
//! The attitude task calls [`round`](CompassTask::round) every few samples, after publication. A
//! turn has three rounds: request of the transfer, its outcome one sample later, and the
//! housekeeping of the sensor. Each needs the bus for less than the gap between two bursts.

use core::sync::atomic::{AtomicBool, Ordering};

use super::burst_reader::{self, CompassTransfers};
use super::retained;
use crate::attitude::{BodyVector, Quaternion};
use crate::calibration::CompassAlignment;
use crate::calibration::compass::CompassFitter;
use crate::compass::{Choice, Condition, Fault, PartId, Session};
use crate::fault::FaultClass;
use crate::pipeline::Snapshot;
use crate::units::MagneticField;

/// Samples from a request to its outcome, to the housekeeping, and to the next request: 10 ms.
const SAMPLES: [u8; 3] = [1, 4, 5];

/// Work of a round for the attitude task.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Round {
    /// Samples until the next round.
    pub samples: u8,
    /// True if it is a round of the sensor's housekeeping.
    pub keeps_house: bool,
    /// Field of a new reading, and the time of its middle on the microsecond timer.
    pub reading: Option<(MagneticField, u32)>,
}

/// True if the state has changed since telemetry reported it.
static HAS_CHANGED: AtomicBool = AtomicBool::new(false);

/// Returns whether the state has changed since the last call.
pub fn take_change() -> bool {
    HAS_CHANGED.load(Ordering::Relaxed) && HAS_CHANGED.swap(false, Ordering::Relaxed)
}

/// Session with the compass, and its place in the vehicle.
pub struct CompassTask {
    session: Session,
    transfers: CompassTransfers,
    alignment: CompassAlignment,
    phase: u8,
    field: Option<MagneticField>,
    /// Readings for a fit, while a calibration collects them.
    fitter: Option<CompassFitter>,
    reported: (bool, Option<Fault>),
}

impl CompassTask {
    /// Creates the task with a compass of this choice.
    pub const fn new(choice: Choice, alignment: CompassAlignment) -> Self {
        Self {
            session: Session::new(choice),
            transfers: CompassTransfers::new(),
            alignment,
            phase: 0,
            field: None,
            fitter: None,
            reported: (false, None),
        }
    }

    /// Searches a compass of this choice.
    pub fn choose(&mut self, choice: Choice) {
        self.session = Session::new(choice);
        self.field = None;
    }

    /// Configures the compass again.
    pub fn restart(&mut self) {
        self.session.restart();
    }

    /// Sets the place in the vehicle.
    pub const fn set_alignment(&mut self, alignment: CompassAlignment) {
        self.alignment = alignment;
    }

    /// Returns the choice.
    pub const fn choice(&self) -> Choice {
        self.session.choice()
    }

    /// Returns the session.
    pub const fn session(&self) -> &Session {
        &self.session
    }

    /// Returns the condition of the compass.
    pub fn condition(&self) -> Condition {
        Condition {
            part: self
                .session
                .name()
                .zip(self.session.part().map(PartId::address)),
            fault: self.session.fault(),
            field: self.field,
        }
    }

    /// Collects readings for a fit from now on.
    pub const fn start_fitter(&mut self) {
        self.fitter = Some(CompassFitter::new());
    }

    /// Stops collecting.
    pub const fn stop_fitter(&mut self) {
        self.fitter = None;
    }

    /// Returns the readings so far.
    pub const fn fitter(&self) -> Option<CompassFitter> {
        self.fitter
    }

    /// Performs a round. `without` is the number of samples between two rounds of housekeeping
    /// without a compass.
    pub fn round(&mut self, without: u8, snapshot: &Snapshot) -> Round {
        let mut round = Round {
            samples: without,
            keeps_house: true,
            reading: None,
        };
        if self.session.is_idle() {
            self.report_change();
            return round;
        }
        match self.phase {
            0 => {
                if let Some(transfer) = self.session.next_transfer() {
                    self.transfers.request(transfer);
                }
            }
            1 => round.reading = self.take_reading(snapshot),
            _ => {}
        }
        round.keeps_house = self.phase == 2;
        if let Some(samples) = SAMPLES.get(usize::from(self.phase)) {
            round.samples = *samples;
        }
        self.phase = (self.phase + 1) % SAMPLES.len() as u8;
        round
    }

    #[inline(never)]
    fn take_reading(&mut self, snapshot: &Snapshot) -> Option<(MagneticField, u32)> {
        let Self {
            session, transfers, ..
        } = self;
        let (reading, started_us) =
            transfers.take(|outcome, started_us| (session.finish(outcome), started_us))?;
        self.report_change();
        let reading_ut = reading?;
        let measured_us = started_us.wrapping_sub(self.session.mean_age_us());
        if let Some(fitter) = &mut self.fitter {
            // The attitude of the snapshot, turned back to the time of the measurement.
            let age_s = (snapshot.t_us as u32).wrapping_sub(measured_us) as i32 as f32 * 1.0e-6;
            let back = Quaternion::from_rotation_vector(snapshot.body_rates_rad_s.scale(-age_s));
            let BodyVector(body_ut) = self.alignment.mount.to_body(reading_ut);
            fitter.add(snapshot.attitude.multiply(back), body_ut);
        }
        let field = self.alignment.apply(reading_ut);
        self.field = Some(field);
        Some((field, measured_us))
    }

    /// Counts and flags a fault that begins, and announces any change.
    fn report_change(&mut self) {
        let fault = self.session.fault();
        let now = (self.session.is_running() && fault.is_none(), fault);
        if now == self.reported {
            return;
        }
        if fault.is_some() {
            self.field = None;
        }
        if fault.is_some() && self.reported.1.is_none() {
            retained::count(FaultClass::Compass);
        }
        burst_reader::set_compass_fault(fault.is_some());
        self.reported = now;
        HAS_CHANGED.store(true, Ordering::Relaxed);
    }
}
