//! Compass reader: runs the compass's session in the attitude task, one transfer per slot.
//!
//! The attitude task calls [`run_phase`](CompassReader::run_phase) every few samples, after
//! publication. A slot of [`SLOT_MS`] has three phases: request of the transfer, its outcome one
//! sample later, and the housekeeping of the sensor. Each needs the bus for less than the gap
//! between two bursts.
//!
//! Another transfer, such as a settings check while polled, may occupy the bus. The transfer then
//! starts later. The next slot takes its outcome before it requests another, so the session
//! always gets an outcome before its next transfer.
//!
//! A good reading goes to the heading filter ([`super::heading`]). Its time is that of the
//! transfer's start, less the part's mean age of a field ([`Session::mean_age_us`]). While the
//! flight log is sent, each reading goes to its queue too.

use core::sync::atomic::{AtomicBool, Ordering};

use super::burst_reader::{self, CompassTransfers};
use super::heading::HeadingPublisher;
use super::retained;
use crate::attitude::{BodyVector, Quaternion};
use crate::calibration::CompassAlignment;
use crate::calibration::compass::CompassFitter;
use crate::compass::{Choice, CompassStatus, Fault, PartId, SLOT_MS, Session};
use crate::estimator::heading::Heading;
use crate::fault::FaultClass;
use crate::health::Flags;
use crate::pipeline::{CompassReading, Pipeline, Snapshot, compass_knowledge};
use crate::units::MagneticField;
use heapless::spsc::Producer;

/// Phases of a slot, in their order.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Requests the next transfer.
    Request,
    /// Takes the outcome of the transfer.
    Outcome,
    /// Leaves the bus to the housekeeping of the sensor.
    Housekeeping,
}

impl Phase {
    /// Returns the next phase, and the number of samples until then.
    const fn next(self) -> (Self, u8) {
        match self {
            Self::Request => (Self::Outcome, 1),
            Self::Outcome => (Self::Housekeeping, 4),
            Self::Housekeeping => (Self::Request, 5),
        }
    }
}

/// The phases of a slot take [`SLOT_MS`] at 1 kHz.
const _: () = {
    let (Phase::Outcome, request) = Phase::Request.next() else {
        panic!("order of the phases");
    };
    let (Phase::Housekeeping, outcome) = Phase::Outcome.next() else {
        panic!("order of the phases");
    };
    let (Phase::Request, housekeeping) = Phase::Housekeeping.next() else {
        panic!("order of the phases");
    };
    assert!((request + outcome + housekeeping) as u32 == SLOT_MS);
};

/// Result of a phase for the attitude task.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PhaseResult {
    /// Samples until the next phase.
    pub samples: u8,
    /// True if the phase was that of the sensor's housekeeping.
    pub is_housekeeping_due: bool,
}

/// True if the state has changed since telemetry reported it.
static HAS_CHANGED: AtomicBool = AtomicBool::new(false);

/// Returns whether the state has changed since the last call.
pub fn take_change() -> bool {
    HAS_CHANGED.load(Ordering::Relaxed) && HAS_CHANGED.swap(false, Ordering::Relaxed)
}

/// True while the flight log needs readings.
static IS_LOGGING: AtomicBool = AtomicBool::new(false);

/// Starts or ends the flow of readings to the flight log.
pub fn set_logging(is_logging: bool) {
    IS_LOGGING.store(is_logging, Ordering::Relaxed);
}

/// Session with the compass, and its place in the vehicle.
pub struct CompassReader {
    session: Session,
    transfers: CompassTransfers,
    alignment: CompassAlignment,
    /// Declination of the place, rad.
    declination_rad: f32,
    heading: HeadingPublisher,
    phase: Phase,
    /// True if the session has started anew since the requested transfer.
    is_transfer_old: bool,
    field: Option<MagneticField>,
    /// Readings for a fit, while a calibration collects them.
    fitter: Option<CompassFitter>,
    reported: (bool, Option<Fault>),
    /// Readings that the heading filter has taken.
    taken: u32,
    to_log: Producer<'static, CompassReading>,
}

impl CompassReader {
    /// Creates the reader with a compass of this choice, at a place with this declination in rad.
    /// `to_log` takes readings for the flight log.
    pub fn new(
        choice: Choice,
        alignment: CompassAlignment,
        declination_rad: f32,
        to_log: Producer<'static, CompassReading>,
    ) -> Self {
        let mut reader = Self {
            session: Session::new(choice),
            transfers: CompassTransfers::new(),
            alignment,
            declination_rad,
            heading: HeadingPublisher::new(compass_knowledge(&alignment)),
            phase: Phase::Request,
            is_transfer_old: false,
            field: None,
            fitter: None,
            reported: (false, None),
            taken: 0,
            to_log,
        };
        reader.heading.set_declination(declination_rad);
        reader
    }

    /// Searches a compass of this choice.
    pub fn choose(&mut self, choice: Choice) {
        self.session = Session::new(choice);
        self.is_transfer_old = !self.transfers.is_free();
        self.field = None;
        self.restart_heading();
    }

    /// Returns the part and its factory trims for a self-test, while it gives readings.
    pub fn compass_under_test(&self) -> Option<(PartId, [u8; 3])> {
        let is_running = self.session.is_running() && self.session.fault().is_none();
        let part = self.session.part().filter(|_| is_running)?;
        Some((part, self.session.trims()))
    }

    /// Configures the compass again.
    pub fn restart(&mut self) {
        self.session.restart();
        self.is_transfer_old = !self.transfers.is_free();
    }

    /// Sets the place in the vehicle. In another place the heading restarts. Returns whether it is
    /// another place.
    pub fn set_alignment(&mut self, alignment: CompassAlignment) -> bool {
        let is_other = alignment != self.alignment;
        if is_other {
            self.alignment = alignment;
            self.restart_heading();
        }
        is_other
    }

    /// Sets the declination of the place, rad. The heading turns with it. Returns whether it was
    /// another.
    pub fn set_declination(&mut self, declination_rad: f32) -> bool {
        let is_other = declination_rad != self.declination_rad;
        if is_other {
            self.declination_rad = declination_rad;
            self.heading.set_declination(declination_rad);
        }
        is_other
    }

    /// Restarts the heading, because the body axes have changed.
    pub fn restart_heading(&mut self) {
        let knowledge = compass_knowledge(&self.alignment);
        self.heading.restart(knowledge, self.declination_rad);
    }

    /// Returns whether the heading filter has to follow each sample.
    pub const fn has_heading(&self) -> bool {
        self.heading.is_running()
    }

    /// Returns the heading filter, or `None` while it waits for a reading, and the number of the
    /// next reading.
    pub const fn heading_filter(&self) -> (Option<&Heading>, u32) {
        (self.heading.filter(), self.taken)
    }

    /// Updates the heading with the last sample.
    #[inline(always)]
    pub fn update_heading(&mut self, pipeline: &Pipeline) {
        self.heading.update(pipeline);
    }

    /// Returns the choice.
    pub const fn choice(&self) -> Choice {
        self.session.choice()
    }

    /// Returns the status of the compass.
    pub fn status(&self) -> CompassStatus {
        CompassStatus {
            part: self
                .session
                .name()
                .zip(self.session.part().map(PartId::address)),
            fault: self.session.fault(),
            field: self.field,
            hard_iron_ut: (self.heading.filter()).and_then(Heading::certain_hard_iron_ut),
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

    /// Performs a phase of the slot. `housekeeping_samples` is the number of samples between two
    /// rounds of housekeeping without a compass.
    pub fn run_phase(
        &mut self,
        housekeeping_samples: u8,
        pipeline: &Pipeline,
        snapshot: &Snapshot,
    ) -> PhaseResult {
        let mut result = PhaseResult {
            samples: housekeeping_samples,
            is_housekeeping_due: true,
        };
        if self.session.is_idle() {
            self.report_change();
            return result;
        }
        match self.phase {
            Phase::Request => {
                self.take_reading(pipeline, snapshot);
                if self.transfers.is_free()
                    && let Some(transfer) = self.session.next_transfer()
                {
                    self.transfers.request(transfer);
                }
            }
            Phase::Outcome => self.take_reading(pipeline, snapshot),
            Phase::Housekeeping => {}
        }
        result.is_housekeeping_due = self.phase == Phase::Housekeeping;
        (self.phase, result.samples) = self.phase.next();
        result
    }

    #[inline(never)]
    fn take_reading(&mut self, pipeline: &Pipeline, snapshot: &Snapshot) {
        let Self {
            session,
            transfers,
            is_transfer_old,
            ..
        } = self;
        let taken = transfers.take(|outcome, started_us| {
            let is_old = core::mem::take(is_transfer_old);
            let reading = if is_old {
                None
            } else {
                session.finish(outcome)
            };
            (reading, started_us)
        });
        let Some((reading, started_us)) = taken else {
            return;
        };
        self.report_change();
        // While samples are no measurements, no attitude belongs to a reading.
        let has_attitude = !snapshot.flags.intersects(Flags::UNUSABLE_SAMPLE);
        let Some(reading_ut) = reading.filter(|_| has_attitude) else {
            return;
        };
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
        let starts_filter = self.heading.add_reading(pipeline, field, measured_us);
        let number = self.taken;
        self.taken = number.wrapping_add(1);
        if IS_LOGGING.load(Ordering::Relaxed) {
            // A reading without room is missing in the log, where the numbers show it.
            let knowledge = compass_knowledge(&self.alignment);
            let reading = CompassReading {
                number,
                sample_t_us: snapshot.t_us,
                measured_us,
                field,
                knowledge,
                declination_rad: self.declination_rad,
                starts_filter,
            };
            self.to_log.enqueue(reading).ok();
        }
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
