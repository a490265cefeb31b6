//! Commands that set the compass, its mount, its hard iron and the declination.

use super::super::answer::{Kind, Reply, Triple};
use super::super::command::{Command, CompassChoice};
use super::super::module::Module;
use super::Console;
use crate::attitude::Quaternion;
use crate::calibration::{CompassCorrection, Mount};
use crate::units::radians;

impl Console {
    /// Returns the body axes: the mount, and the level trim.
    pub(super) fn body_axes(&self) -> (Mount, Quaternion) {
        let level = self.working.calibration.level;
        (self.mount(), level.unwrap_or(Quaternion::IDENTITY))
    }

    /// Moves the compass to the present body axes, which were these before. Its correction turns
    /// with the level. A correction that belongs to another mount is lost. Returns whether one was.
    pub(super) fn follow_body_axes(
        &mut self,
        before: (Mount, Quaternion),
        module: &mut dyn Module,
    ) -> bool {
        let (mount, level) = self.body_axes();
        if (mount, level) == before {
            return false;
        }
        let (mount_before, level_before) = before;
        let settings = &mut self.working.compass;
        let has_lost = mount != mount_before && settings.correction.take().is_some();
        if let Some(correction) = &mut settings.correction {
            *correction = correction.turned(level.multiply(level_before.conjugate()));
        }
        module.set_compass(settings, mount);
        has_lost
    }

    /// Keeps the mount in use if this kind of answer shows a new correction of the compass. A later
    /// build may have another default, to which the correction does not belong. Returns the kind.
    pub(super) fn keep_mount(&mut self, kind: Option<Kind>) -> Option<Kind> {
        if kind == Some(Kind::Done) {
            self.working.calibration.mount = Some(self.mount());
        }
        kind
    }

    /// Sets the compass or its mount. A correction that belongs to another one is lost.
    pub(super) fn set_compass(
        &mut self,
        choice: CompassChoice,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        let imu_mount = self.mount();
        let settings = &mut self.working.compass;
        let is_other = match choice {
            CompassChoice::Part(choice) => {
                core::mem::replace(&mut settings.choice, choice) != choice
            }
            CompassChoice::Mount(mount) => {
                settings.mount.replace(mount).unwrap_or(imu_mount) != mount
            }
            CompassChoice::Keep => return self.keep_hard_iron(module, reply),
        };
        let has_lost = is_other && settings.correction.take().is_some();
        module.set_compass(settings, imu_mount);
        let lost = if has_lost {
            ", it is to be calibrated again"
        } else {
            ""
        };
        reply.ok(format_args!(
            "{}{lost}; \"save\" keeps it",
            Command::Compass(choice)
        ))
    }

    /// Adds the hard iron that the heading filter has found to the compass's correction.
    fn keep_hard_iron(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        let correction = self.working.compass.correction;
        if correction.is_some_and(|correction| correction.has_soft_iron()) {
            return reply.error(format_args!(
                "compass keep: its calibration is better; \"calibrate compass\" renews it"
            ));
        }
        let Some(found_ut) = module.state().compass.hard_iron_ut else {
            return reply.error(format_args!(
                "compass keep: the hard iron is not certain yet; turn the vehicle about two axes, \
                 until \"status\" shows hard_iron_ut"
            ));
        };
        let correction = &mut self.working.compass.correction;
        let correction = correction.get_or_insert(CompassCorrection::NONE);
        correction.hard_iron_ut = correction.hard_iron_ut + found_ut;
        let kept_ut = Triple(correction.hard_iron_ut, 1);
        module.set_compass(&self.working.compass, self.mount());
        self.keep_mount(Some(Kind::Done));
        reply.ok(format_args!(
            "compass keep: hard iron {kept_ut} uT, and the heading restarts with it; \
             \"save\" keeps it"
        ))
    }

    /// Sets the declination, in hundredths of a degree. The compass goes on as it is.
    pub(super) fn set_declination(
        &mut self,
        centidegrees: i16,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        self.working.compass.declination_rad = radians(f32::from(centidegrees) * 0.01);
        module.set_compass(&self.working.compass, self.mount());
        let north = if centidegrees == 0 {
            "magnetic"
        } else {
            "true"
        };
        reply.ok(format_args!(
            "{}, the heading is from {north} north; \"save\" keeps it",
            Command::Declination(centidegrees)
        ))
    }
}
