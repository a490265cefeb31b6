//! The measurements that a person starts and that go on by themselves: each takes rests, one after the other, until it has
//! what it wants.

use core::fmt;

use super::answer::{Decimal, Kind, Reply, Triple};
use crate::calibration::accelerometer::{Pose, PoseCollector, PoseRefused};
use crate::calibration::level::{self, MountFinder, MountStep};
use crate::calibration::temperature::TemperatureLearner;
use crate::calibration::{AtRest, Calibration, MotionReason, Mount, RestProgress, RestScale};
use crate::units::degrees;

/// An accelerometer that lies still in its last pose so many rests longer is done.
const STILL_RESTS: u8 = 5;

/// A measurement that goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Procedure {
    what: Measurement,
    /// It moved since the last rest, and why that was none.
    moved: Option<MotionReason>,
    has_moved: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, and it lives in the console"
)]
enum Measurement {
    Gyroscope,
    Accelerometer { poses: PoseCollector, still: u8 },
    Level,
    Temperature(TemperatureLearner),
    Mount(MountFinder),
}

/// What became of a rest.
pub(super) enum Step {
    /// Nothing to say.
    Wait,
    /// Something was said.
    Said(Kind),
    /// Something was said, and it has ended: well if the calibration was changed.
    End(Kind),
}

impl Procedure {
    pub(super) const fn gyroscope() -> Self {
        Self::new(Measurement::Gyroscope)
    }

    pub(super) fn accelerometer(scale: &RestScale) -> Self {
        Self::new(Measurement::Accelerometer {
            poses: PoseCollector::new(scale),
            still: 0,
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

    const fn new(what: Measurement) -> Self {
        Self {
            what,
            moved: None,
            has_moved: false,
        }
    }

    /// The command that started it.
    pub(super) const fn name(&self) -> &'static str {
        match self.what {
            Measurement::Gyroscope => "calibrate gyro",
            Measurement::Accelerometer { .. } => "calibrate accel",
            Measurement::Level => "calibrate level",
            Measurement::Temperature(_) => "calibrate temperature",
            Measurement::Mount(_) => "mount find",
        }
    }

    /// How long a rest it takes, s. The gyroscope's noise of 0.005 °/s/√Hz averages to 0.002 °/s in four.
    pub(super) const fn rest_s(&self) -> f32 {
        match self.what {
            Measurement::Gyroscope => 4.0,
            Measurement::Level | Measurement::Temperature(_) => 2.0,
            Measurement::Accelerometer { .. } | Measurement::Mount(_) => 1.0,
        }
    }

    /// What to do first.
    pub(super) fn instruction(&self, reply: &mut Reply<'_>) -> Kind {
        match &self.what {
            Measurement::Gyroscope => self.say(reply, Kind::Ok, "keep it still for 4 s, in any pose"),
            Measurement::Accelerometer { poses, .. } => self.tell(reply,
                Kind::Ok,
                format_args!(
                    "lay it still for 2 s in each pose, the arrows of the sensor's axes as told; first: {}",
                    poses.next_pose()
                ),
            ),
            Measurement::Level => {
                self.say(reply, Kind::Ok, "keep it still for 2 s with the vehicle level")
            }
            Measurement::Temperature(_) => self.say(reply,
                Kind::Ok,
                "let it lie still while it warms up or cools down; \"calibrate done\" ends it",
            ),
            Measurement::Mount(_) => self.say(reply,
                Kind::Ok,
                "keep it still for 2 s with the vehicle level, then with its nose down",
            ),
        }
    }

    /// How long it may be silent while there is something to say, µs.
    pub(super) const fn silence_us(&self) -> u32 {
        match self.what {
            Measurement::Gyroscope | Measurement::Level => 1_000_000,
            Measurement::Accelerometer { .. } | Measurement::Mount(_) => 5_000_000,
            Measurement::Temperature(_) => 10_000_000,
        }
    }

    /// What there is to say after that silence.
    pub(super) fn report(&mut self, rest_percent: u8, reply: &mut Reply<'_>) -> Option<Kind> {
        if let Some(reason) = self.moved.take() {
            return Some(self.tell(
                reply,
                Kind::Progress,
                format_args!("waits for rest, {reason}"),
            ));
        }
        match &self.what {
            Measurement::Gyroscope | Measurement::Level => {
                Some(self.tell(reply, Kind::Progress, format_args!("{rest_percent} %")))
            }
            Measurement::Temperature(learner) => {
                Some(self.tell(reply, Kind::Progress, format_args!("{}", Seen(learner))))
            }
            Measurement::Accelerometer { .. } | Measurement::Mount(_) => None,
        }
    }

    /// For `status`: the range of a temperature calibration.
    pub(super) fn detail(&self) -> Option<impl fmt::Display + '_> {
        match &self.what {
            Measurement::Temperature(learner) => Some(Seen(learner)),
            _ => None,
        }
    }

    /// Takes what the watch over rest says; changes the calibration when it ends well.
    pub(super) fn rest(
        &mut self,
        progress: &RestProgress,
        calibration: &mut Calibration,
        mount: Mount,
        scale: &RestScale,
        reply: &mut Reply<'_>,
    ) -> Step {
        let at_rest = match *progress {
            RestProgress::Collecting => return Step::Wait,
            RestProgress::Moved(reason) => {
                self.moved = Some(reason);
                self.has_moved = true;
                return Step::Wait;
            }
            RestProgress::Done(at_rest) => at_rest,
        };
        self.moved = None;
        let has_moved = core::mem::take(&mut self.has_moved);
        match &mut self.what {
            Measurement::Gyroscope => {
                let offset = at_rest.gyroscope_offset(scale);
                calibration.gyroscope = Some(offset);
                let answer = self.tell(
                    reply,
                    Kind::Done,
                    format_args!(
                        "offset {} deg/s at {} C; \"save\" keeps it",
                        Triple(offset.offset_rad_s.scale(degrees(1.0)), 3),
                        Decimal(offset.temperature_celsius, 1)
                    ),
                );
                Step::End(answer)
            }
            Measurement::Accelerometer { poses, still } => {
                let added = poses.add(&at_rest);
                match added {
                    Ok(_) => *still = 0,
                    Err(_) => *still = still.saturating_add(1),
                }
                let (next, still) = (poses.next_pose(), *still);
                let has_sides = !matches!(next, Pose::Side(..));
                match added {
                    Ok(accepted) => {
                        let taken = Taken {
                            number: accepted.count,
                            pose: accepted.pose,
                        };
                        Step::Said(if has_sides {
                            self.tell(reply,
                                Kind::Progress,
                                format_args!("{taken}, all six sides are there; keep it still for 5 s more, or go on with: {next}"),
                            )
                        } else {
                            self.tell(reply, Kind::Progress, format_args!("{taken}, next: {next}"))
                        })
                    }
                    Err(PoseRefused::Repeated { .. }) if has_sides && still >= STILL_RESTS => {
                        Step::End(self.finish(calibration, reply).unwrap_or(Kind::Failed))
                    }
                    Err(refused) if has_moved => Step::Said(self.tell(
                        reply,
                        Kind::Progress,
                        format_args!("{refused}; next: {next}"),
                    )),
                    Err(_) => Step::Wait,
                }
            }
            Measurement::Level => {
                let force = corrected(calibration, &at_rest, scale);
                match level::level(mount.to_body(force)) {
                    Ok(trim) => {
                        calibration.level = Some(trim);
                        let angles = trim.to_euler();
                        let answer = self.tell(
                            reply,
                            Kind::Done,
                            format_args!(
                                "trim {} deg of roll, {} deg of pitch; \"save\" keeps it",
                                Decimal(degrees(angles.roll_rad), 2),
                                Decimal(degrees(angles.pitch_rad), 2)
                            ),
                        );
                        Step::End(answer)
                    }
                    Err(error) => {
                        Step::End(self.tell(reply, Kind::Failed, format_args!("{error}")))
                    }
                }
            }
            Measurement::Temperature(learner) => {
                let sigma = at_rest.gyroscope_offset_sigma_rad_s(scale);
                let offset = at_rest.gyroscope_offset(scale);
                learner.add(offset.temperature_celsius, offset.offset_rad_s, sigma);
                Step::Wait
            }
            Measurement::Mount(finder) => {
                match finder.add(corrected(calibration, &at_rest, scale)) {
                    Ok(MountStep::NoseDown) => Step::Said(self.say(
                        reply,
                        Kind::Progress,
                        "level is known; now the nose down, as far as it goes",
                    )),
                    Ok(MountStep::Found(found)) => {
                        set_mount(calibration, found, mount);
                        let answer = self.tell(
                            reply,
                            Kind::Done,
                            format_args!("mount {found}; \"save\" keeps it"),
                        );
                        Step::End(answer)
                    }
                    Err(error) if has_moved => {
                        Step::Said(self.tell(reply, Kind::Progress, format_args!("{error}")))
                    }
                    Err(_) => Step::Wait,
                }
            }
        }
    }

    /// Ends it with what there is, if that is enough; else says what is missing, and it goes on.
    pub(super) fn finish(
        &self,
        calibration: &mut Calibration,
        reply: &mut Reply<'_>,
    ) -> Option<Kind> {
        match &self.what {
            Measurement::Accelerometer { poses, .. } => match poses.fit() {
                Ok(fit) => {
                    calibration.accelerometer = Some(fit.correction);
                    return Some(self.tell(
                        reply,
                        Kind::Done,
                        format_args!("{fit}; \"save\" keeps it"),
                    ));
                }
                Err(error) => self.tell(reply, Kind::Error, format_args!("{error}")),
            },
            Measurement::Temperature(learner) => match learner.fit() {
                Ok(model) => {
                    calibration.temperature = Some(model);
                    let seen = Seen(learner);
                    return Some(self.tell(
                        reply,
                        Kind::Done,
                        format_args!("{seen}; \"save\" keeps it"),
                    ));
                }
                Err(error) => self.tell(reply, Kind::Error, format_args!("{error}")),
            },
            _ => self.say(reply, Kind::Error, "it ends by itself"),
        };
        None
    }

    fn say(&self, reply: &mut Reply<'_>, kind: Kind, text: &str) -> Kind {
        self.tell(reply, kind, format_args!("{text}"))
    }

    #[inline(never)]
    fn tell(&self, reply: &mut Reply<'_>, kind: Kind, arguments: fmt::Arguments<'_>) -> Kind {
        reply.say(kind, format_args!("{}: {arguments}", self.name()))
    }
}

/// Sets a mount; a trim that was found with another one goes with that.
pub(super) fn set_mount(calibration: &mut Calibration, mount: Mount, before: Mount) {
    calibration.mount = Some(mount);
    if mount != before {
        calibration.level = None;
    }
}

/// The mean specific force, m/s² in sensor axes.
fn corrected(
    calibration: &Calibration,
    at_rest: &AtRest,
    scale: &RestScale,
) -> crate::attitude::Vector3 {
    let reading = at_rest.specific_force_m_s2(scale);
    calibration
        .accelerometer
        .map_or(reading, |correction| correction.apply(reading))
}

/// A pose that was taken.
struct Taken {
    number: u8,
    pose: Option<Pose>,
}

impl fmt::Display for Taken {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "pose {}", self.number)?;
        match self.pose {
            Some(pose) => write!(formatter, " is {pose}"),
            None => formatter.write_str(" is tilted"),
        }
    }
}

/// What a temperature calibration has seen.
struct Seen<'a>(&'a TemperatureLearner);

impl fmt::Display for Seen<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some((coldest, warmest)) = self.0.range_celsius() else {
            return formatter.write_str("nothing seen yet");
        };
        write!(
            formatter,
            "{} temperatures from {} to {} C",
            self.0.points(),
            Decimal(coldest, 1),
            Decimal(warmest, 1)
        )
    }
}
