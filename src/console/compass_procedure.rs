//! Calibration of the compass: the vehicle is turned about all axes while readings are collected.

use super::answer::{Decimal, Kind, Reply, Triple};
use super::module::Module;
use crate::calibration::Mount;
use crate::calibration::compass::{CompassFit, CompassFitter};
use crate::settings::CompassSettings;
use crate::units::degrees;

/// Duration after which a whole coverage ends the procedure, µs.
const DURATION_US: u32 = 30_000_000;
/// Duration after which the procedure ends anyway, µs.
const LONGEST_US: u32 = 120_000_000;
/// Time between two progress reports, µs.
const REPORT_PERIOD_US: u32 = 2_000_000;
/// Command that starts the procedure.
pub(super) const NAME: &str = "calibrate compass";

/// Running calibration of the compass, if there is one.
#[derive(Debug, Default)]
pub(super) struct CompassProcedure {
    /// Times of the start and of the last report, µs.
    running: Option<(u32, u32)>,
}

impl CompassProcedure {
    pub(super) const fn new() -> Self {
        Self { running: None }
    }

    pub(super) const fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Starts the procedure, and answers with its instruction. `now_us` may wrap.
    pub(super) fn start(
        &mut self,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        let condition = module.state().compass;
        if condition.field.is_none() {
            let reason = condition.fault.map_or("none answers", |fault| fault.name());
            return reply.error(format_args!(
                "{NAME}: there are no readings of a compass ({reason})"
            ));
        }
        module.start_compass_fitter();
        self.running = Some((now_us, now_us));
        reply.ok(format_args!(
            "{NAME}: turn it slowly to and fro about all axes for 30 s, each side down once, \
             away from iron"
        ))
    }

    /// Aborts the procedure. Returns whether it was running.
    pub(super) fn abort(&mut self, module: &mut dyn Module) -> bool {
        let was_running = self.running.take().is_some();
        if was_running {
            module.stop_compass_fitter();
        }
        was_running
    }

    /// Continues the procedure: reports the coverage, and ends with the fit. `now_us` may wrap.
    pub(super) fn poll(
        &mut self,
        now_us: u32,
        settings: &mut CompassSettings,
        imu_mount: Mount,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Option<Kind> {
        let (started_us, reported_us) = self.running?;
        if now_us.wrapping_sub(reported_us) < REPORT_PERIOD_US {
            return None;
        }
        self.running = Some((started_us, now_us));
        let fitter = module.compass_fitter()?;
        let coverage = fitter.coverage();
        let elapsed_us = now_us.wrapping_sub(started_us);
        let is_complete = elapsed_us >= DURATION_US && coverage.percent() == 100;
        if is_complete || elapsed_us >= LONGEST_US {
            return Some(self.end(&fitter, Kind::Failed, settings, imu_mount, module, reply));
        }
        let percent = coverage.percent();
        Some(match coverage.missing_side() {
            Some(side) => reply.write(
                Kind::Progress,
                format_args!("{NAME}: {percent} %, next: {side}"),
            ),
            None if percent < 100 => reply.write(
                Kind::Progress,
                format_args!("{NAME}: {percent} %, next: turn it level through a circle"),
            ),
            None => reply.write(
                Kind::Progress,
                format_args!("{NAME}: {percent} %, go on turning"),
            ),
        })
    }

    /// Ends the procedure with the readings so far, or reports that they are not enough.
    pub(super) fn finish(
        &mut self,
        settings: &mut CompassSettings,
        imu_mount: Mount,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        match module.compass_fitter() {
            Some(fitter) => self.end(&fitter, Kind::Error, settings, imu_mount, module, reply),
            None => reply.error(format_args!("{NAME}: nothing goes on")),
        }
    }

    /// Puts the fit in use. A refused fit is answered with `refused`: the procedure ends if that is
    /// [`Kind::Failed`].
    #[inline(never)]
    fn end(
        &mut self,
        fitter: &CompassFitter,
        refused: Kind,
        settings: &mut CompassSettings,
        imu_mount: Mount,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        let assumed = settings.mount.unwrap_or(imu_mount);
        let fit = match fitter.fit(assumed) {
            Ok(fit) => fit,
            Err(error) => {
                if refused == Kind::Failed {
                    self.abort(module);
                }
                return reply.write(refused, format_args!("{NAME}: {error}"));
            }
        };
        self.abort(module);
        let CompassFit {
            mount, correction, ..
        } = fit;
        settings.correction = Some(correction);
        if mount != assumed {
            settings.mount = Some(mount);
        }
        module.set_compass(settings, imu_mount);
        // No fit tells a compass with a negated axis from one in the opposite field.
        let caution = if fit.dip_rad < 0.0 {
            "; the field points up: right only in the south, else an axis has the wrong sign and \
             the heading is 180 deg wrong"
        } else {
            ""
        };
        reply.write(
            Kind::Done,
            format_args!(
                "{NAME}: mount {mount}, hard iron {} uT, field {} uT, dip {} deg, residual {} \
                 uT{caution}; \"save\" keeps it",
                Triple(correction.hard_iron_ut, 1),
                Decimal(fit.strength_ut, 1),
                Decimal(degrees(fit.dip_rad), 1),
                Decimal(fit.residual_ut, 1),
            ),
        )
    }
}
