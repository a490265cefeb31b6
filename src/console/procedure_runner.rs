//! Runner of one procedure at a time, on the module's stationary detector.

use super::answer::{Kind, Reply};
use super::module::Module;
use super::procedure::{Procedure, Step};
use crate::calibration::{Calibration, Mount, NoiseModel, StationaryProgress};
use crate::health::Flags;

/// Running procedure, if there is one.
#[derive(Debug)]
pub(super) struct ProcedureRunner {
    noise: NoiseModel,
    sample_rate_hz: f32,
    current: Option<Procedure>,
    /// Time of the last report, µs.
    reported_at_us: u32,
}

impl ProcedureRunner {
    pub(super) const fn new(noise: NoiseModel, sample_rate_hz: f32) -> Self {
        Self {
            noise,
            sample_rate_hz,
            current: None,
            reported_at_us: 0,
        }
    }

    pub(super) const fn noise(&self) -> &NoiseModel {
        &self.noise
    }

    pub(super) const fn current(&self) -> Option<&Procedure> {
        self.current.as_ref()
    }

    /// Starts a procedure, and answers with its instruction. `now_us` may wrap.
    pub(super) fn start(
        &mut self,
        procedure: Procedure,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        if module.state().sensor.is_none() {
            return reply.error(format_args!("{}: there is no sensor yet", procedure.name()));
        }
        let kind = procedure.instruction(reply);
        module.take_detector_progress();
        module.start_detector(self.samples(&procedure));
        self.reported_at_us = now_us;
        self.current = Some(procedure);
        kind
    }

    /// Aborts the running procedure and returns it; `None` if none is running.
    pub(super) fn abort(&mut self, module: &mut dyn Module) -> Option<Procedure> {
        let procedure = self.current.take()?;
        module.stop_detector();
        Some(procedure)
    }

    /// Ends the running procedure with the data so far, or reports that they are not enough.
    pub(super) fn finish(
        &mut self,
        calibration: &mut Calibration,
        mount: Mount,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        let Some(procedure) = &mut self.current else {
            return reply.error(format_args!("calibrate done: nothing goes on"));
        };
        let kind = procedure.finish(Kind::Error, calibration, mount, reply);
        if kind == Kind::Done {
            self.end(kind, calibration, module);
        }
        kind
    }

    /// Continues the running procedure with the detector's progress. `now_us` may wrap.
    #[inline(never)]
    pub(super) fn poll(
        &mut self,
        now_us: u32,
        calibration: &mut Calibration,
        mount: Mount,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Option<Kind> {
        let samples = self.samples(self.current.as_ref()?);
        let procedure = self.current.as_mut()?;
        if let Some(progress) = module.take_detector_progress() {
            let step = procedure.on_progress(&progress, calibration, mount, &self.noise, reply);
            if let Step::Ended(kind) = step {
                self.end(kind, calibration, module);
                return Some(kind);
            }
            if matches!(progress, StationaryProgress::Done(_)) {
                module.start_detector(samples);
            }
            if let Step::Answered(kind) = step {
                self.reported_at_us = now_us;
                return Some(kind);
            }
        }
        let procedure = self.current.as_mut()?;
        if now_us.wrapping_sub(self.reported_at_us) < procedure.report_period_us() {
            return None;
        }
        self.reported_at_us = now_us;
        if module.state().flags.intersects(Flags::NO_MEASUREMENT) {
            return Some(procedure.report_no_data(reply));
        }
        procedure.report(module.detector_percent(), reply)
    }

    /// Returns the number of samples that a procedure averages.
    fn samples(&self, procedure: &Procedure) -> u16 {
        (procedure.duration_s() * self.sample_rate_hz) as u16
    }

    /// Ends the running procedure; `Kind::Done` puts the new calibration in use.
    fn end(&mut self, kind: Kind, calibration: &Calibration, module: &mut dyn Module) {
        self.current = None;
        module.stop_detector();
        if kind == Kind::Done {
            module.set_calibration(calibration);
        }
    }
}
