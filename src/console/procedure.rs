//! Calibration procedures: each takes stationary means, one after the other, until it has enough.

use core::fmt;

use super::answer::{Decimal, Kind, Reply, Triple};
use crate::attitude::Vector3;
use crate::calibration::accelerometer::{AcceptedPose, Pose, PoseCollector, PoseError};
use crate::calibration::level;
use crate::calibration::mount_finder::{MountFinder, MountStep};
use crate::calibration::temperature::TemperatureLearner;
use crate::calibration::{
    Calibration, MotionReason, Mount, NoiseModel, StationaryMean, StationaryProgress,
};
use crate::units::degrees;

/// Duration of the stationary mean of a pose, s.
const POSE_S: u8 = 1;
/// Time at rest that ends an accelerometer calibration with all six sides, s.
const REST_TO_FINISH_S: u8 = 5;
/// Number of repeated poses in a row that this rest gives.
const REPEATS_TO_FINISH: u8 = REST_TO_FINISH_S / POSE_S;

/// Running procedure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Procedure {
    measurement: Measurement,
    /// Motion that was not reported yet.
    motion: Option<MotionReason>,
    /// True if the sensor moved since the last mean.
    has_moved: bool,
}

/// Measurement of a procedure, with the data so far.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "there is one, and it lives in the console; it is reported on 64-bit hosts only"
)]
enum Measurement {
    Gyroscope,
    Accelerometer {
        poses: PoseCollector,
        /// Refused poses in a row.
        repeats: u8,
    },
    Level,
    Temperature(TemperatureLearner),
    Mount(MountFinder),
}

/// Effect of a detector event on a procedure.
pub(super) enum Step {
    /// Nothing to report.
    Continue,
    /// An answer was written; the procedure continues.
    Answered(Kind),
    /// An answer was written, and the procedure has ended. [`Kind::Done`] if it has changed the
    /// calibration.
    Ended(Kind),
}

impl Procedure {
    pub(super) const fn gyroscope() -> Self {
        Self::new(Measurement::Gyroscope)
    }

    pub(super) fn accelerometer(noise: &NoiseModel) -> Self {
        Self::new(Measurement::Accelerometer {
            poses: PoseCollector::new(noise),
            repeats: 0,
        })
    }

    pub(super) const fn level() -> Self {
        Self::new(Measurement::Level)
    }

    pub(super) const fn temperature() -> Self {
        Self::new(Measurement::Temperature(TemperatureLearner::new()))
    }

    pub(super) const fn mount() -> Self {
        Self::new(Measurement::Mount(MountFinder::new()))
    }

    const fn new(measurement: Measurement) -> Self {
        Self {
            measurement,
            motion: None,
            has_moved: false,
        }
    }

    /// Returns the command that starts the procedure.
    #[inline(never)]
    pub(super) const fn name(&self) -> &'static str {
        match self.measurement {
            Measurement::Gyroscope => "calibrate gyro",
            Measurement::Accelerometer { .. } => "calibrate accel",
            Measurement::Level => "calibrate level",
            Measurement::Temperature(_) => "calibrate temperature",
            Measurement::Mount(_) => "mount find",
        }
    }

    /// Returns the duration of a stationary mean, s. The gyroscope's noise of 0.005 °/s/√Hz
    /// averages to 0.002 °/s in four seconds.
    pub(super) const fn duration_s(&self) -> f32 {
        match self.measurement {
            Measurement::Gyroscope => 4.0,
            Measurement::Level | Measurement::Temperature(_) => 2.0,
            Measurement::Accelerometer { .. } | Measurement::Mount(_) => POSE_S as f32,
        }
    }

    /// Writes the first instruction.
    pub(super) fn instruction(&self, reply: &mut Reply<'_>) -> Kind {
        let text = match &self.measurement {
            Measurement::Gyroscope => "keep it still for 4 s, in any pose",
            Measurement::Accelerometer { poses, .. } => {
                return self.write(
                    reply,
                    Kind::Ok,
                    format_args!(
                        "lay it still for 2 s in each pose, \
                         the arrows of the sensor's axes as told; first: {}",
                        poses.next_pose()
                    ),
                );
            }
            Measurement::Level => "keep it still for 2 s with the vehicle level",
            Measurement::Temperature(_) => {
                "let it lie still while it warms up or cools down; \"calibrate done\" ends it"
            }
            Measurement::Mount(_) => {
                "keep it still for 2 s with the vehicle level, then with its nose down"
            }
        };
        self.write(reply, Kind::Ok, format_args!("{text}"))
    }

    /// Returns the shortest time between two progress reports, µs.
    pub(super) const fn report_period_us(&self) -> u32 {
        match self.measurement {
            Measurement::Gyroscope | Measurement::Level => 1_000_000,
            Measurement::Accelerometer { .. } | Measurement::Mount(_) => 5_000_000,
            Measurement::Temperature(_) => 10_000_000,
        }
    }

    /// Writes a progress report, if there is progress or motion to report. `percent` is the share
    /// of the mean that is collected.
    pub(super) fn report(&mut self, percent: u8, reply: &mut Reply<'_>) -> Option<Kind> {
        if let Some(reason) = self.motion.take() {
            return Some(self.progress(reply, format_args!("waits for rest, {reason}")));
        }
        match &self.measurement {
            Measurement::Gyroscope | Measurement::Level => {
                Some(self.progress(reply, format_args!("{percent} %")))
            }
            Measurement::Temperature(learner) => {
                Some(self.progress(reply, format_args!("{}", TemperatureProgress(learner))))
            }
            Measurement::Accelerometer { .. } | Measurement::Mount(_) => None,
        }
    }

    /// Writes that no progress is possible, because the sensor gives no data.
    pub(super) fn report_no_data(&self, reply: &mut Reply<'_>) -> Kind {
        self.progress(reply, format_args!("no data: check the sensor's wires"))
    }

    /// Returns the detail for `status`: the measured range of a temperature calibration.
    pub(super) fn detail(&self) -> Option<impl fmt::Display + '_> {
        match &self.measurement {
            Measurement::Temperature(learner) => Some(TemperatureProgress(learner)),
            _ => None,
        }
    }

    /// Handles a detector event. A procedure that succeeds changes the calibration.
    pub(super) fn on_progress(
        &mut self,
        progress: &StationaryProgress,
        calibration: &mut Calibration,
        mount: Mount,
        noise: &NoiseModel,
        reply: &mut Reply<'_>,
    ) -> Step {
        let mean = match progress {
            StationaryProgress::Collecting => return Step::Continue,
            StationaryProgress::Moved(reason) => {
                self.motion = Some(*reason);
                self.has_moved = true;
                return Step::Continue;
            }
            StationaryProgress::Done(mean) => mean,
        };
        self.motion = None;
        let has_moved = core::mem::take(&mut self.has_moved);
        match &mut self.measurement {
            Measurement::Gyroscope => self.gyroscope_mean(mean, calibration, noise, reply),
            Measurement::Accelerometer { .. } => {
                self.accelerometer_mean(mean, has_moved, calibration, mount, reply)
            }
            Measurement::Level => {
                let force = corrected_force_m_s2(calibration, mean, noise);
                self.level_mean(force, calibration, mount, reply)
            }
            Measurement::Temperature(learner) => {
                let sigma = mean.gyroscope_offset_sigma_rad_s(noise);
                let offset = mean.gyroscope_offset(noise);
                learner.add(offset.temperature_celsius, offset.offset_rad_s, sigma);
                Step::Continue
            }
            Measurement::Mount(finder) => {
                let found = finder.add(corrected_force_m_s2(calibration, mean, noise));
                match found {
                    Ok(MountStep::NoseDown) => Step::Answered(self.progress(
                        reply,
                        format_args!("level is known; now the nose down, as far as it goes"),
                    )),
                    Ok(MountStep::Found(found)) => {
                        set_mount(calibration, found, mount);
                        let lost = if found == mount {
                            ""
                        } else {
                            ", a level or a compass is to be calibrated again"
                        };
                        Step::Ended(self.done(
                            reply,
                            format_args!("mount {found}{lost}; \"save\" keeps it"),
                        ))
                    }
                    Err(error) if has_moved => {
                        Step::Answered(self.progress(reply, format_args!("{error}")))
                    }
                    Err(_) => Step::Continue,
                }
            }
        }
    }

    fn gyroscope_mean(
        &self,
        mean: &StationaryMean,
        calibration: &mut Calibration,
        noise: &NoiseModel,
        reply: &mut Reply<'_>,
    ) -> Step {
        let offset = mean.gyroscope_offset(noise);
        calibration.set_gyroscope_offset(offset);
        Step::Ended(self.done(
            reply,
            format_args!(
                "offset {} deg/s at {} C; \"save\" keeps it",
                Triple(offset.offset_rad_s.scale(degrees(1.0)), 3),
                Decimal(offset.temperature_celsius, 1)
            ),
        ))
    }

    fn accelerometer_mean(
        &mut self,
        mean: &StationaryMean,
        has_moved: bool,
        calibration: &mut Calibration,
        mount: Mount,
        reply: &mut Reply<'_>,
    ) -> Step {
        let Measurement::Accelerometer { poses, repeats } = &mut self.measurement else {
            return Step::Continue;
        };
        let added = poses.add(mean);
        *repeats = match added {
            Ok(_) => 0,
            Err(_) => repeats.saturating_add(1),
        };
        let (next, repeats) = (poses.next_pose(), *repeats);
        let has_sides = !matches!(next, Pose::Side(_));
        match added {
            Ok(accepted) if has_sides => Step::Answered(self.progress(
                reply,
                format_args!(
                    "{}, all six sides are there; keep it still for {REST_TO_FINISH_S} s more, \
                     or go on with: {next}",
                    AcceptedPoseText(accepted)
                ),
            )),
            Ok(accepted) => Step::Answered(self.progress(
                reply,
                format_args!("{}, next: {next}", AcceptedPoseText(accepted)),
            )),
            Err(PoseError::Repeated { .. }) if has_sides && repeats >= REPEATS_TO_FINISH => {
                Step::Ended(self.finish(Kind::Failed, calibration, mount, reply))
            }
            Err(error) if has_moved => {
                Step::Answered(self.progress(reply, format_args!("{error}; next: {next}")))
            }
            Err(_) => Step::Continue,
        }
    }

    fn level_mean(
        &self,
        force_m_s2: Vector3,
        calibration: &mut Calibration,
        mount: Mount,
        reply: &mut Reply<'_>,
    ) -> Step {
        match level::trim(mount.to_body(force_m_s2).0) {
            Ok(trim) => {
                calibration.level = Some(trim);
                // A later build may have another default, to which the trim does not belong.
                calibration.mount = Some(mount);
                let angles = trim.to_euler();
                Step::Ended(self.done(
                    reply,
                    format_args!(
                        "trim {} deg of roll, {} deg of pitch; \"save\" keeps it",
                        Decimal(degrees(angles.roll_rad), 2),
                        Decimal(degrees(angles.pitch_rad), 2)
                    ),
                ))
            }
            Err(error) => Step::Ended(self.write(reply, Kind::Failed, format_args!("{error}"))),
        }
    }

    /// Puts the data so far in use and returns [`Kind::Done`]. Answers with `refused`, and returns
    /// it, if they are not enough. A stored temperature model stays beyond the measured range.
    pub(super) fn finish(
        &mut self,
        refused: Kind,
        calibration: &mut Calibration,
        mount: Mount,
        reply: &mut Reply<'_>,
    ) -> Kind {
        if let (Measurement::Temperature(learner), Some(stored)) =
            (&mut self.measurement, &calibration.temperature)
            && learner.fit().is_ok()
        {
            learner.keep_beyond(stored);
        }
        match &self.measurement {
            Measurement::Accelerometer { poses, .. } => match poses.fit() {
                Ok(fit) => {
                    calibration.set_accelerometer(fit.correction, mount);
                    self.done(reply, format_args!("{fit}; \"save\" keeps it"))
                }
                Err(error) => self.write(reply, refused, format_args!("{error}")),
            },
            Measurement::Temperature(learner) => match learner.fit() {
                Ok(model) => {
                    calibration.temperature = Some(model);
                    let range = TemperatureProgress(learner);
                    self.done(reply, format_args!("{range}; \"save\" keeps it"))
                }
                Err(error) => self.write(reply, refused, format_args!("{error}")),
            },
            _ => self.write(reply, refused, format_args!("it ends by itself")),
        }
    }

    fn progress(&self, reply: &mut Reply<'_>, arguments: fmt::Arguments<'_>) -> Kind {
        self.write(reply, Kind::Progress, arguments)
    }

    fn done(&self, reply: &mut Reply<'_>, arguments: fmt::Arguments<'_>) -> Kind {
        self.write(reply, Kind::Done, arguments)
    }

    #[inline(never)]
    fn write(&self, reply: &mut Reply<'_>, kind: Kind, arguments: fmt::Arguments<'_>) -> Kind {
        reply.write(kind, format_args!("{}: {arguments}", self.name()))
    }
}

/// Sets the mount, and clears a level trim that belongs to another mount.
pub(super) fn set_mount(calibration: &mut Calibration, mount: Mount, before: Mount) {
    calibration.mount = Some(mount);
    if mount != before {
        calibration.level = None;
    }
}

/// Returns the mean specific force with the stored corrections, m/s² in sensor axes.
fn corrected_force_m_s2(
    calibration: &Calibration,
    mean: &StationaryMean,
    noise: &NoiseModel,
) -> Vector3 {
    let reading = mean.specific_force_m_s2(noise);
    calibration
        .accelerometer
        .map_or(reading, |correction| correction.apply(reading))
}

/// Accepted pose as text.
struct AcceptedPoseText(AcceptedPose);

impl fmt::Display for AcceptedPoseText {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let AcceptedPose { count, pose } = self.0;
        write!(formatter, "pose {count}")?;
        match pose {
            Some(pose) => write!(formatter, " is {pose}"),
            None => formatter.write_str(" is tilted"),
        }
    }
}

/// Data of a temperature calibration as text.
struct TemperatureProgress<'a>(&'a TemperatureLearner);

impl fmt::Display for TemperatureProgress<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(range_celsius) = self.0.range_celsius() else {
            return formatter.write_str("nothing seen yet");
        };
        write!(
            formatter,
            "{} temperatures from {} to {} C",
            self.0.points(),
            Decimal(*range_celsius.start(), 1),
            Decimal(*range_celsius.end(), 1)
        )
    }
}
