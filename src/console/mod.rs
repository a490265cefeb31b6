//! What a person or a program at the other end of the UART can ask for: bytes in, one line out for each command.
//!
//! | module | what it knows |
//! |---|---|
//! | [`mod@line`] | how bytes become lines, and which are dropped |
//! | [`command`] | the words, and what was probably meant |
//! | [`answer`] | the lines that go back |
//! | `ground_station` | MAVLink's requests as commands |
//! | `procedure` | the measurements, rest by rest |
//!
//! [`Console`] holds the *working record* (what is in use) and the *stored* one (what is in flash). Every command changes
//! the working record alone; `save` makes it the stored one, and only if they differ. The console reaches the rest of
//! the module through [`Module`], so that it is tested without hardware.
//!
//! # Noise
//!
//! Nothing that a noisy line brings changes what is stored. A line with a byte that is not printable ASCII is dropped, and so
//! is everything that the receiver flagged. Of random bytes, the line `save` comes once in 2⁻⁴⁶ per byte (a line end, four
//! letters, a line end, of two line ends that there are), and stores nothing unless something was changed before: by a person, who
//! is then saved the trouble, or by noise that hit a command such as `rate 9`, once in 2⁻⁵⁹ per byte. A day of nothing but noise at
//! 921,600 baud is 2³³ bytes: both happen in that order with a probability of 10⁻¹².
//!
//! Nor is noise answered line by line: lines that cannot be read are counted and told once a second, and wrong commands
//! have a budget of [`WRONG_ANSWERS`], which refills by two a second.

pub mod answer;
pub mod command;
#[cfg(feature = "mavlink")]
pub mod ground_station;
pub mod line;
mod nearest;
mod procedure;
#[cfg(test)]
mod tests;

use core::fmt;

use answer::{Decimal, Kind, Reply, Triple};
use command::{BAUD_RATES, Calibrate, Command, Form, MountChoice, RATES_HZ};
use line::LineAssembler;
use procedure::{Procedure, Step};

use crate::attitude::Vector3;
use crate::calibration::{Calibration, Mount, Preferences, Record, RestProgress, RestScale};
use crate::health::Flags;
use crate::mpu6050::Part;
use crate::telemetry;
use crate::units::degrees;

/// So many wrong commands are answered at once.
pub const WRONG_ANSWERS: u8 = 4;
/// One more is answered after this time, µs.
const WRONG_ANSWER_PERIOD_US: u32 = 500_000;
/// Dropped lines are told no more often, µs.
const DROPPED_PERIOD_US: u32 = 1_000_000;
/// After a change of the baud rate a command has to come within this time, µs, or the old rate comes back.
const BAUD_TRIAL_US: u32 = 10_000_000;

/// What the console needs of the module that it commands.
pub trait Module {
    /// The next byte that was received.
    fn receive(&mut self) -> Option<u8>;

    /// Whether what was received since the last call was garbled or lost in part.
    fn take_reception_error(&mut self) -> bool;

    /// How the module is.
    fn state(&mut self) -> State;

    /// Uses this calibration from now on.
    fn set_calibration(&mut self, calibration: &Calibration);

    /// Watches for a rest of so many samples.
    fn start_rest(&mut self, samples: u16);

    /// Does not watch any more.
    fn stop_rest(&mut self);

    /// What the watch has seen since the last call.
    fn take_rest(&mut self) -> Option<RestProgress>;

    /// How much of the rest is over, 0 to 100.
    fn rest_percent(&mut self) -> u8;

    /// Armed, nothing is done that is only safe on the ground.
    fn set_armed(&mut self, is_armed: bool);

    /// Sends and receives at this rate, if everything has gone out; else false, and nothing changes.
    fn set_baud(&mut self, baud: u32) -> bool;

    /// Begins what needs the sensor to stop. One at a time; [`Module::take_outcome`] tells its end.
    fn begin(&mut self, task: Task);

    /// How the task ended.
    fn take_outcome(&mut self) -> Option<Outcome>;
}

/// What needs the sensor to stop for a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Task {
    /// Stores this record.
    Save(Record),
    /// Tests the sensor.
    SelfTest,
}

/// How a task ended: well, or with what stood in its way, and what there is to say about it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// Whether it ended well.
    pub is_ok: bool,
    /// What there is to say, short.
    pub text: heapless::String<{ Outcome::CAPACITY }>,
}

impl Outcome {
    /// Room for what there is to say, in bytes.
    pub const CAPACITY: usize = 200;

    /// An outcome with something to say; what does not fit is left out.
    pub fn new(is_ok: bool, said: impl fmt::Display) -> Self {
        use fmt::Write;
        let mut text = heapless::String::new();
        write!(text, "{said}").ok();
        Self { is_ok, text }
    }
}

/// How the module is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// What there is to say about the latest attitude; nothing if there has been none.
    pub flags: Flags,
    /// The sensor, once it is configured, and its address.
    pub sensor: Option<(&'static Part, u8)>,
    /// The die temperature, °C.
    pub temperature_celsius: f32,
    /// The gyroscope's offset that is left, rad/s in body axes.
    pub bias_rad_s: Vector3,
    /// σ of that, of its worst axis.
    pub bias_sigma_rad_s: f32,
    /// σ of the tilt.
    pub tilt_sigma_rad: f32,
    /// Bursts that failed since the start.
    pub bursts_failed: u16,
    /// Times that the receiver saw errors or lost bytes, since power came: a reset does not forget them.
    pub reception_errors: u32,
    /// Snapshots that could not be sent in time, since power came.
    pub frames_dropped: u32,
}

/// The console.
#[derive(Debug)]
pub struct Console {
    line: LineAssembler,
    working: Record,
    stored: Record,
    scale: RestScale,
    sample_rate_hz: f32,
    default_mount: Mount,
    is_armed: bool,
    procedure: Option<Procedure>,
    said_at_us: u32,
    task: Option<Task>,
    baud: Baud,
    dropped: u32,
    dropped_untold: u32,
    dropped_told_at_us: u32,
    wrong_answers: u8,
    wrong_refilled_at_us: u32,
}

/// The state of a change of the baud rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Baud {
    Steady,
    /// To change to it as soon as the answer is out.
    Asked(u32),
    /// Changed, and nobody has been understood yet.
    Trial {
        now: u32,
        since_us: u32,
    },
    /// To change back, since nobody has.
    Failed {
        tried: u32,
    },
}

impl Console {
    /// A console that found this record in flash, for a sensor with these scales, with the mount that the firmware was built
    /// for. What of the record makes no sense is replaced by its default.
    pub fn new(
        stored: Option<Record>,
        scale: RestScale,
        sample_rate_hz: f32,
        default_mount: Mount,
    ) -> Self {
        let stored = stored.unwrap_or_default();
        Self {
            line: LineAssembler::new(),
            working: Record {
                preferences: sane(stored.preferences),
                ..stored
            },
            stored,
            scale,
            sample_rate_hz,
            default_mount,
            is_armed: false,
            procedure: None,
            said_at_us: 0,
            task: None,
            baud: Baud::Steady,
            dropped: 0,
            dropped_untold: 0,
            dropped_told_at_us: 0,
            wrong_answers: WRONG_ANSWERS,
            wrong_refilled_at_us: 0,
        }
    }

    /// What is in use.
    pub const fn working(&self) -> &Record {
        &self.working
    }

    /// What is in flash.
    pub const fn stored(&self) -> &Record {
        &self.stored
    }

    /// Whether `save` would change what is stored.
    pub fn has_unsaved(&self) -> bool {
        self.working != self.stored
    }

    /// Whether the module is armed.
    pub const fn is_armed(&self) -> bool {
        self.is_armed
    }

    /// The mount in use.
    pub fn mount(&self) -> Mount {
        self.working.calibration.mount.unwrap_or(self.default_mount)
    }

    /// Does what is due and writes the next line to send, if there is one, without its end. `now_us` may wrap.
    ///
    /// To be called whenever there is room for a line ([`answer::ANSWER_CAPACITY`]), at least ten times a second; one line at a
    /// time, so that whatever comes in waits until its answer can go out.
    pub fn poll(
        &mut self,
        now_us: u32,
        module: &mut dyn Module,
        output: &mut dyn fmt::Write,
    ) -> Option<Kind> {
        let reply = &mut Reply(output);
        if module.take_reception_error() {
            self.line.spoil();
        }
        if let Some(task) = self.task {
            let outcome = module.take_outcome()?;
            self.task = None;
            return Some(self.ended(task, &outcome, reply));
        }
        if let Some(answer) = self.change_baud(now_us, module, reply) {
            return answer;
        }
        self.rest(now_us, module, reply)
            .or_else(|| self.tell_dropped(now_us, reply))
            .or_else(|| self.read(now_us, module, reply))
    }

    /// Does what a command asks for, and writes the answer.
    pub fn execute(
        &mut self,
        command: Command,
        now_us: u32,
        module: &mut dyn Module,
        output: &mut dyn fmt::Write,
    ) -> Kind {
        self.carry_out(command, now_us, module, &mut Reply(output))
    }

    fn carry_out(
        &mut self,
        command: Command,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        if let Baud::Trial { now, .. } = self.baud {
            self.baud = Baud::Steady;
            self.working.preferences.baud = now;
        }
        if let Some(refusal) = self.refusal(command, reply) {
            return refusal;
        }
        match command {
            Command::Help => reply.ok(format_args!("help: {Forms}")),
            Command::Status => self.status(&module.state(), reply),
            Command::Show => self.show(reply),
            Command::Save => self.save(module, reply),
            Command::Forget => self.forget(module, reply),
            Command::SelfTest => {
                self.task = Some(Task::SelfTest);
                module.begin(Task::SelfTest);
                reply.ok(format_args!("self-test: the sensor stops for a second"))
            }
            Command::Arm => self.arm(module, reply),
            Command::Disarm => {
                self.is_armed = false;
                module.set_armed(false);
                reply.ok(format_args!("disarm"))
            }
            Command::Calibrate(Calibrate::Stop) => self.stop(module, reply),
            Command::Calibrate(Calibrate::Done) => self.finish(module, reply),
            Command::Calibrate(Calibrate::Gyroscope) => {
                self.start(Procedure::gyroscope(), now_us, module, reply)
            }
            Command::Calibrate(Calibrate::Accelerometer) => {
                self.start(Procedure::accelerometer(&self.scale), now_us, module, reply)
            }
            Command::Calibrate(Calibrate::Level) => {
                self.start(Procedure::level(), now_us, module, reply)
            }
            Command::Calibrate(Calibrate::Temperature) => {
                self.start(Procedure::temperature(), now_us, module, reply)
            }
            Command::Mount(MountChoice::Find) => {
                self.start(Procedure::mount(), now_us, module, reply)
            }
            Command::Mount(MountChoice::Named(mount)) => {
                let before = self.mount();
                let had_level = self.working.calibration.level.is_some();
                procedure::set_mount(&mut self.working.calibration, mount, before);
                module.set_calibration(&self.working.calibration);
                let has_lost = had_level && self.working.calibration.level.is_none();
                let lost = if has_lost {
                    ", its level is to be calibrated again"
                } else {
                    ""
                };
                reply.ok(format_args!("mount {mount}{lost}; \"save\" keeps it"))
            }
            Command::Rate(rate_hz) => {
                let preferences = Preferences {
                    rate_hz,
                    ..self.working.preferences
                };
                self.prefer(preferences, reply)
            }
            Command::Format(format) => {
                let preferences = Preferences {
                    format,
                    ..self.working.preferences
                };
                self.prefer(preferences, reply)
            }
            Command::Baud(baud) => self.ask_baud(baud, reply),
        }
    }

    /// Why a command is refused now.
    fn refusal(&self, command: Command, reply: &mut Reply<'_>) -> Option<Kind> {
        use Command::{Arm, Disarm, Format, Help, Rate, Show, Status};
        if self.is_armed && !matches!(command, Help | Status | Show | Arm | Disarm) {
            return Some(reply.error(format_args!("refused while armed: \"disarm\" first")));
        }
        let is_compatible = matches!(
            command,
            Help | Status
                | Show
                | Arm
                | Disarm
                | Rate(_)
                | Format(_)
                | Command::Calibrate(Calibrate::Done | Calibrate::Stop)
        );
        match &self.procedure {
            Some(procedure) if !is_compatible => Some(reply.error(format_args!(
                "refused while \"{}\" goes on: \"calibrate stop\" ends it",
                procedure.name()
            ))),
            _ => None,
        }
    }

    fn save(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        if !self.has_unsaved() {
            return reply.ok(format_args!(
                "save: nothing has changed, nothing is written"
            ));
        }
        let task = Task::Save(self.working);
        self.task = Some(task);
        module.begin(task);
        reply.ok(format_args!("save: the sensor stops for a second"))
    }

    /// A task has ended.
    fn ended(&mut self, task: Task, outcome: &Outcome, reply: &mut Reply<'_>) -> Kind {
        let name = match task {
            Task::Save(record) => {
                if outcome.is_ok {
                    self.stored = record;
                }
                "save"
            }
            Task::SelfTest => "self-test",
        };
        let kind = if outcome.is_ok {
            Kind::Done
        } else {
            Kind::Failed
        };
        reply.say(kind, format_args!("{name}: {}", outcome.text))
    }

    /// The baud rate stays, so that whoever says this is still understood.
    fn forget(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        let defaults = Preferences::default();
        self.working = Record {
            preferences: sane(Preferences {
                baud: self.working.preferences.baud,
                ..defaults
            }),
            ..Record::default()
        };
        module.set_calibration(&self.working.calibration);
        reply.ok(format_args!(
            "forget: nothing is calibrated, mount {}; \"save\" makes it permanent, a restart undoes it",
            self.default_mount
        ))
    }

    fn arm(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        self.is_armed = true;
        let given_up = self.procedure.take();
        if given_up.is_some() {
            module.stop_rest();
        }
        module.set_armed(true);
        match given_up {
            Some(procedure) => reply.ok(format_args!("arm: \"{}\" is given up", procedure.name())),
            None => reply.ok(format_args!("arm")),
        }
    }

    fn start(
        &mut self,
        procedure: Procedure,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        if module.state().sensor.is_none() {
            return reply.error(format_args!("{}: there is no sensor yet", procedure.name()));
        }
        let said = procedure.instruction(reply);
        module.take_rest();
        module.start_rest(self.samples(&procedure));
        self.said_at_us = now_us;
        self.procedure = Some(procedure);
        said
    }

    fn samples(&self, procedure: &Procedure) -> u16 {
        (procedure.rest_s() * self.sample_rate_hz) as u16
    }

    fn stop(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        match self.procedure.take() {
            Some(procedure) => {
                module.stop_rest();
                reply.ok(format_args!(
                    "calibrate stop: \"{}\" is given up",
                    procedure.name()
                ))
            }
            None => reply.ok(format_args!("calibrate stop: nothing went on")),
        }
    }

    fn finish(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        let Some(procedure) = &self.procedure else {
            return reply.error(format_args!("calibrate done: nothing goes on"));
        };
        match procedure.finish(&mut self.working.calibration, reply) {
            Some(kind) => {
                self.end(kind, module);
                kind
            }
            None => Kind::Error,
        }
    }

    fn end(&mut self, kind: Kind, module: &mut dyn Module) {
        self.procedure = None;
        module.stop_rest();
        if kind == Kind::Done {
            module.set_calibration(&self.working.calibration);
        }
    }

    /// Lets the measurement go on that is under way.
    fn rest(
        &mut self,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Option<Kind> {
        let mount = self.mount();
        let samples = self.samples(self.procedure.as_ref()?);
        let procedure = self.procedure.as_mut()?;
        if let Some(progress) = module.take_rest() {
            let calibration = &mut self.working.calibration;
            let step = procedure.rest(&progress, calibration, mount, &self.scale, reply);
            if let Step::End(kind) = step {
                self.end(kind, module);
                return Some(kind);
            }
            if matches!(progress, RestProgress::Done(_)) {
                module.start_rest(samples);
            }
            if let Step::Said(kind) = step {
                self.said_at_us = now_us;
                return Some(kind);
            }
        }
        let procedure = self.procedure.as_mut()?;
        if now_us.wrapping_sub(self.said_at_us) < procedure.silence_us() {
            return None;
        }
        self.said_at_us = now_us;
        procedure.report(module.rest_percent(), reply)
    }

    /// New preferences, if the line carries them.
    fn prefer(&mut self, preferences: Preferences, reply: &mut Reply<'_>) -> Kind {
        let Preferences {
            format,
            rate_hz,
            baud,
        } = preferences;
        let most = telemetry::largest_rate_hz(format, baud);
        if most == 0 {
            return reply.error(format_args!(
                "{} takes more than {baud} baud: a higher baud rate first",
                format.name()
            ));
        }
        if u32::from(rate_hz) > most {
            return reply.error(format_args!(
                "{rate_hz} lines of {} a second are too many for {baud} baud: \"rate {most}\" fits, or a higher baud rate",
                format.name()
            ));
        }
        self.working.preferences = preferences;
        reply.ok(format_args!(
            "{}, {rate_hz} a second; \"save\" keeps it",
            format.name()
        ))
    }

    fn ask_baud(&mut self, baud: u32, reply: &mut Reply<'_>) -> Kind {
        let Preferences {
            format,
            rate_hz,
            baud: before,
        } = self.working.preferences;
        let most = telemetry::largest_rate_hz(format, baud);
        if most == 0 {
            return reply.error(format_args!(
                "{baud} baud are too few for {}: another format first",
                format.name()
            ));
        }
        if u32::from(rate_hz) > most {
            return reply.error(format_args!(
                "{baud} baud are too few for {rate_hz} lines of {} a second: \"rate {most}\" first",
                format.name()
            ));
        }
        if baud == before {
            return reply.ok(format_args!("baud {baud}: as before"));
        }
        self.baud = Baud::Asked(baud);
        reply.ok(format_args!(
            "baud {baud} from now on; say something at {baud} within 10 s, or it is {before} again"
        ))
    }

    /// Goes on with a change of the baud rate. `Some` ends the poll, with or without an answer.
    fn change_baud(
        &mut self,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Option<Option<Kind>> {
        let before = self.working.preferences.baud;
        match self.baud {
            Baud::Steady => None,
            Baud::Asked(baud) => {
                if module.set_baud(baud) {
                    self.line = LineAssembler::new();
                    self.baud = Baud::Trial {
                        now: baud,
                        since_us: now_us,
                    };
                }
                Some(None)
            }
            Baud::Trial { now, since_us } => {
                if now_us.wrapping_sub(since_us) < BAUD_TRIAL_US {
                    return None;
                }
                self.baud = Baud::Failed { tried: now };
                Some(None)
            }
            Baud::Failed { tried } => {
                if !module.set_baud(before) {
                    return Some(None);
                }
                self.line = LineAssembler::new();
                self.baud = Baud::Steady;
                Some(Some(reply.say(
                    Kind::Failed,
                    format_args!("baud: nothing was understood at {tried}, it is {before} again"),
                )))
            }
        }
    }

    /// Reads bytes until one ends a line that has an answer.
    fn read(
        &mut self,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Option<Kind> {
        while let Some(byte) = module.receive() {
            let command = match self.line.push(byte) {
                None => continue,
                Some(Ok(line)) => command::parse(line),
                Some(Err(_)) => {
                    self.drop_line();
                    continue;
                }
            };
            match command {
                Ok(command) => return Some(self.carry_out(command, now_us, module, reply)),
                Err(wrong) if self.may_answer_wrong(now_us) => {
                    return Some(reply.error(format_args!("{wrong}")));
                }
                Err(_) => self.drop_line(),
            }
        }
        None
    }

    fn drop_line(&mut self) {
        self.dropped = self.dropped.saturating_add(1);
        self.dropped_untold = self.dropped_untold.saturating_add(1);
    }

    fn may_answer_wrong(&mut self, now_us: u32) -> bool {
        let periods = now_us.wrapping_sub(self.wrong_refilled_at_us) / WRONG_ANSWER_PERIOD_US;
        if periods > 0 {
            self.wrong_refilled_at_us = now_us;
            let refilled = u32::from(self.wrong_answers).saturating_add(periods);
            self.wrong_answers = refilled.min(u32::from(WRONG_ANSWERS)) as u8;
        }
        let is_left = self.wrong_answers > 0;
        self.wrong_answers = self.wrong_answers.saturating_sub(1);
        is_left
    }

    fn tell_dropped(&mut self, now_us: u32, reply: &mut Reply<'_>) -> Option<Kind> {
        let is_due = now_us.wrapping_sub(self.dropped_told_at_us) >= DROPPED_PERIOD_US;
        if self.dropped_untold == 0 || !is_due {
            return None;
        }
        self.dropped_told_at_us = now_us;
        let count = core::mem::take(&mut self.dropped_untold);
        let lines = if count == 1 { "line" } else { "lines" };
        Some(reply.error(format_args!(
            "{count} {lines} dropped: too long, unreadable or too many wrong ones; is the baud rate right?"
        )))
    }

    fn status(&self, state: &State, reply: &mut Reply<'_>) -> Kind {
        let yes_no = |is: bool| if is { "yes" } else { "no" };
        let mount = self.mount();
        let is_default = self.working.calibration.mount.is_none();
        reply.ok(format_args!(
            "status: flags={} sensor={} mount={mount}{} calibrated={} bias_dps={} bias_sigma_dps={} tilt_sigma_deg={} \
             temperature_c={} armed={} unsaved={} bursts_failed={} uart_errors={} lines_dropped={} \
             frames_dropped={}{}",
            state.flags,
            Sensor(state.sensor),
            if is_default { "(default)" } else { "" },
            Calibrated(&self.working.calibration),
            Triple(state.bias_rad_s.scale(degrees(1.0)), 3),
            Decimal(degrees(state.bias_sigma_rad_s), 3),
            Decimal(degrees(state.tilt_sigma_rad), 2),
            Decimal(state.temperature_celsius, 1),
            yes_no(self.is_armed),
            yes_no(self.has_unsaved()),
            state.bursts_failed,
            state.reception_errors,
            self.dropped,
            state.frames_dropped,
            GoingOn(self.procedure.as_ref()),
        ))
    }

    fn show(&self, reply: &mut Reply<'_>) -> Kind {
        reply.ok(format_args!("show: {}", Shown(&self.working)))
    }
}

/// Preferences that can be worked with, whatever was stored.
fn sane(preferences: Preferences) -> Preferences {
    let defaults = Preferences::default();
    let baud = if BAUD_RATES.contains(&preferences.baud) {
        preferences.baud
    } else {
        defaults.baud
    };
    // The flight log needs a fast line.
    let format = if telemetry::largest_rate_hz(preferences.format, baud) > 0 {
        preferences.format
    } else {
        defaults.format
    };
    let most = telemetry::largest_rate_hz(format, baud).min(u32::from(*RATES_HZ.end()));
    Preferences {
        format,
        rate_hz: preferences.rate_hz.max(*RATES_HZ.start()).min(most as u16),
        baud,
    }
}

/// Every command.
struct Forms;

impl fmt::Display for Forms {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        Form::all()
            .iter()
            .enumerate()
            .try_for_each(|(index, form)| {
                let separator = if index == 0 { "" } else { ", " };
                write!(formatter, "{separator}{form}")
            })
    }
}

struct Sensor(Option<(&'static Part, u8)>);

impl fmt::Display for Sensor {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some((part, address)) => write!(formatter, "{}@0x{address:02x}", part.name),
            None => formatter.write_str("none"),
        }
    }
}

/// What is calibrated, by name.
struct Calibrated<'a>(&'a Calibration);

impl fmt::Display for Calibrated<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = [
            (self.0.gyroscope.is_some(), "gyro"),
            (self.0.accelerometer.is_some(), "accel"),
            (self.0.level.is_some(), "level"),
            (self.0.temperature.is_some(), "temperature"),
        ];
        let mut separator = "";
        for (_, name) in names.into_iter().filter(|(is_there, _)| *is_there) {
            write!(formatter, "{separator}{name}")?;
            separator = ",";
        }
        formatter.write_str(if separator.is_empty() { "none" } else { "" })
    }
}

struct GoingOn<'a>(Option<&'a Procedure>);

impl fmt::Display for GoingOn<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(procedure) = self.0 else {
            return Ok(());
        };
        write!(formatter, " doing=\"{}", procedure.name())?;
        if let Some(detail) = procedure.detail() {
            write!(formatter, ", {detail}")?;
        }
        formatter.write_str("\"")
    }
}

/// A record in words.
struct Shown<'a>(&'a Record);

impl fmt::Display for Shown<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Record {
            calibration,
            preferences,
        } = self.0;
        formatter.write_str("mount=")?;
        match calibration.mount {
            Some(mount) => write!(formatter, "{mount}")?,
            None => formatter.write_str("default")?,
        }
        formatter.write_str(" gyro=")?;
        match calibration.gyroscope {
            Some(gyroscope) => write!(
                formatter,
                "{}@{}C",
                Triple(gyroscope.offset_rad_s.scale(degrees(1.0)), 3),
                Decimal(gyroscope.temperature_celsius, 1)
            )?,
            None => formatter.write_str("none")?,
        }
        formatter.write_str(" temperature=")?;
        match calibration.temperature {
            Some(model) => write!(
                formatter,
                "{}..{}C",
                Decimal(model.coldest_celsius, 1),
                Decimal(model.warmest_celsius, 1)
            )?,
            None => formatter.write_str("none")?,
        }
        formatter.write_str(" accel_offset=")?;
        match calibration.accelerometer {
            Some(correction) => {
                let [xx, yy, zz, xy, xz, yz] = correction.matrix;
                write!(
                    formatter,
                    "{} accel_matrix={},{}",
                    Triple(correction.offset_m_s2, 3),
                    Triple(Vector3::new(xx, yy, zz), 4),
                    Triple(Vector3::new(xy, xz, yz), 4)
                )?;
            }
            None => formatter.write_str("none")?,
        }
        formatter.write_str(" level=")?;
        match calibration.level {
            Some(trim) => {
                let angles = trim.to_euler();
                let angle = |radians| Decimal(degrees(radians), 2);
                write!(
                    formatter,
                    "{},{}",
                    angle(angles.roll_rad),
                    angle(angles.pitch_rad)
                )?;
            }
            None => formatter.write_str("none")?,
        }
        let Preferences {
            format,
            rate_hz,
            baud,
        } = preferences;
        write!(
            formatter,
            " format={} rate={rate_hz} baud={baud}",
            format.name()
        )
    }
}
