//! Dispatch: receives lines, and runs the command of each.

mod compass_commands;
mod line_commands;

#[cfg(test)]
mod tests;

use core::fmt;

use super::answer::{Kind, Reply, Triple};
use super::baud::{BaudChange, BaudPoll};
use super::command::{Calibrate, Command, CommandForms, Measure, MountChoice, ParseError};
use super::compass_procedure::{self, CompassProcedure};
use super::line::LineAssembler;
use super::line_errors::LineErrors;
use super::measure;
use super::module::{Job, Module, Outcome};
use super::preferences::usable_preferences;
use super::procedure::{self, Procedure};
use super::procedure_runner::ProcedureRunner;
use super::status::{RecordText, Status};
use crate::calibration::{Matrix3, Mount, NoiseModel};
use crate::compass::{self, Choice};
use crate::settings::storage::{self, Loaded};
use crate::settings::{Preferences, Record};

/// Pause after which noise does not belong to the line that follows, µs.
const NOISE_PAUSE_US: u32 = 1_000_000;

/// Console: parses lines, runs their commands, and writes the answers.
#[derive(Debug)]
pub struct Console {
    line: LineAssembler,
    /// Time of the last received byte, or of the last that was garbled, µs.
    heard_at_us: u32,
    errors: LineErrors,
    /// Record in use.
    working: Record,
    /// Record in flash.
    stored: Record,
    /// True if the start found a problem in flash, until a save succeeds.
    has_problem: bool,
    /// Mount without a stored one.
    default_mount: Mount,
    /// Choice of the compass without a stored one.
    default_compass: Choice,
    is_armed: bool,
    procedures: ProcedureRunner,
    compass: CompassProcedure,
    /// Job under way; other input waits for its end.
    job: Option<Job>,
    baud: BaudChange,
}

impl Console {
    /// Creates a console with the content of the flash at start, and replaces impossible
    /// preferences by their defaults. After a problem there, the record counts as unsaved.
    ///
    /// `noise` and `sample_rate_hz` describe the configured sensor. `default_mount` is in use while
    /// the record has no mount, and `default_compass` while there is no record. `is_armed` is true
    /// after a reset of an armed module.
    pub fn new(
        loaded: Loaded,
        noise: NoiseModel,
        sample_rate_hz: f32,
        default_mount: Mount,
        default_compass: Choice,
        is_armed: bool,
    ) -> Self {
        let stored = (loaded.record).unwrap_or(Record::with_compass(default_compass));
        Self {
            line: LineAssembler::new(),
            heard_at_us: 0,
            errors: LineErrors::new(),
            working: Record {
                preferences: usable_preferences(stored.preferences),
                ..stored
            },
            stored,
            has_problem: loaded.problem.is_some(),
            default_mount,
            default_compass,
            is_armed,
            procedures: ProcedureRunner::new(noise, sample_rate_hz),
            compass: CompassProcedure::new(),
            job: None,
            baud: BaudChange::Steady,
        }
    }

    /// Continues with a record that was in use before a reset, saved or not.
    pub fn continue_with(&mut self, record: Record) {
        self.working = Record {
            preferences: usable_preferences(record.preferences),
            ..record
        };
    }

    /// Returns the record in use.
    pub const fn working(&self) -> &Record {
        &self.working
    }

    /// Returns the record in flash.
    pub const fn stored(&self) -> &Record {
        &self.stored
    }

    /// Returns whether a save is due: the record in use differs from the one in flash, or the start
    /// found a problem there.
    pub fn has_unsaved(&self) -> bool {
        self.has_problem || !storage::has_same_bytes(&self.working, &self.stored)
    }

    /// Returns whether the module is armed.
    pub const fn is_armed(&self) -> bool {
        self.is_armed
    }

    /// Returns whether commands have to wait: for a job's end, or for a change of the baud rate.
    pub const fn is_busy(&self) -> bool {
        self.job.is_some() || self.baud.is_changing()
    }

    /// Returns whether a job, a procedure or a change of the baud rate is under way.
    #[inline(never)]
    pub fn is_working(&self) -> bool {
        self.is_busy() || self.running().is_some()
    }

    /// Returns the mount in use.
    #[inline(never)]
    pub fn mount(&self) -> Mount {
        self.working.calibration.mount.unwrap_or(self.default_mount)
    }

    /// Runs the work that is due, and writes at most one line to `output`, without its end. Returns
    /// the kind of that line.
    ///
    /// Call it at least ten times a second, when there is room for a line of
    /// [`ANSWER_CAPACITY`](super::answer::ANSWER_CAPACITY) bytes. Received bytes wait until their
    /// answer can be sent. `now_us` is a clock in µs that may wrap.
    pub fn poll(
        &mut self,
        now_us: u32,
        module: &mut dyn Module,
        output: &mut dyn fmt::Write,
    ) -> Option<Kind> {
        let reply = &mut Reply(output);
        if module.take_reception_error() {
            self.line.discard_line();
            self.heard_at_us = now_us;
        }
        if let Some(job) = self.job {
            let outcome = module.take_outcome()?;
            self.job = None;
            return Some(self.finish_job(job, &outcome, reply));
        }
        let baud = self.working.preferences.baud;
        match self.baud.poll(baud, now_us, &mut self.line, module, reply) {
            BaudPoll::Idle => {}
            BaudPoll::Busy => return None,
            BaudPoll::Answered(kind) => return Some(kind),
        }
        let (axes, mount) = (self.body_axes(), self.mount());
        let calibration = &mut self.working.calibration;
        let ended = (self.procedures).poll(now_us, calibration, mount, module, reply);
        self.follow_body_axes(axes, module);
        ended
            .or_else(|| {
                if !compass::IS_BUILT_IN {
                    return None;
                }
                let settings = &mut self.working.compass;
                let kind = self.compass.poll(now_us, settings, mount, module, reply);
                self.keep_mount(kind)
            })
            .or_else(|| self.errors.report_dropped(now_us, reply))
            .or_else(|| self.read(now_us, module, reply))
    }

    /// Runs a command and writes its answer to `output`. `now_us` is a clock in µs that may wrap.
    ///
    /// Call it only while the console is not [busy](Self::is_busy).
    pub fn execute(
        &mut self,
        command: Command,
        now_us: u32,
        module: &mut dyn Module,
        output: &mut dyn fmt::Write,
    ) -> Kind {
        self.dispatch(command, now_us, module, &mut Reply(output))
    }

    /// Returns the baud rate in use, or the requested one. The record has it once it is confirmed.
    pub fn baud(&self) -> u32 {
        let requested = self.baud.requested();
        requested.unwrap_or(self.working.preferences.baud)
    }

    /// Keeps a new baud rate, at which the other end was understood. Returns whether there was one.
    pub fn confirm_baud(&mut self) -> bool {
        let confirmed = self.baud.confirm();
        self.working.preferences.baud = confirmed.unwrap_or(self.working.preferences.baud);
        confirmed.is_some()
    }

    /// Runs a command unless it is refused.
    fn dispatch(
        &mut self,
        command: Command,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        self.confirm_baud();
        if let Some(refusal) = self.refusal(command, reply) {
            return refusal;
        }
        match command {
            Command::Compass(_)
            | Command::Declination(_)
            | Command::Calibrate(Calibrate::Compass)
                if !compass::IS_BUILT_IN =>
            {
                no_compass(reply)
            }
            Command::Help => reply.ok(format_args!("help: {CommandForms}")),
            Command::Status => self.status(module, reply),
            Command::Show => reply.ok(format_args!("show: {}", RecordText(&self.working))),
            Command::Save => self.save(module, reply),
            Command::Forget => self.forget(module, reply),
            Command::SelfTest => self.begin(Job::SelfTest, module, reply),
            Command::Registers => self.begin(Job::ReadBack, module, reply),
            Command::Measure(what) => measure::run(what, module, reply),
            Command::Arm => self.arm(module, reply),
            Command::Disarm => self.disarm(module, reply),
            Command::Calibrate(Calibrate::Stop) => self.stop(module, reply),
            Command::Calibrate(Calibrate::Compass) => self.compass.start(now_us, module, reply),
            Command::Calibrate(Calibrate::Done) => self.finish_procedure(module, reply),
            Command::Calibrate(Calibrate::Gyroscope) => {
                self.start(Procedure::gyroscope(), now_us, module, reply)
            }
            Command::Calibrate(Calibrate::Accelerometer) => {
                let procedure = Procedure::accelerometer(self.procedures.noise());
                self.start(procedure, now_us, module, reply)
            }
            Command::Calibrate(Calibrate::Keep) => self.keep_accelerometer_offset(module, reply),
            Command::Calibrate(Calibrate::Level) => {
                self.start(Procedure::level(), now_us, module, reply)
            }
            Command::Calibrate(Calibrate::Temperature) => {
                self.start(Procedure::temperature(), now_us, module, reply)
            }
            Command::GyroscopeMatrix(elements) => self.set_gyroscope(elements, module, reply),
            Command::Mount(MountChoice::Find) => {
                self.start(Procedure::mount(), now_us, module, reply)
            }
            Command::Mount(MountChoice::Named(mount)) => self.set_mount(mount, module, reply),
            Command::Compass(choice) => self.set_compass(choice, module, reply),
            Command::Declination(angle) => self.set_declination(angle, module, reply),
            Command::Rate(rate_hz) => {
                let preferences = Preferences {
                    rate_hz,
                    ..self.working.preferences
                };
                self.set_preferences(preferences, reply)
            }
            Command::Format(format) => {
                let preferences = Preferences {
                    format,
                    ..self.working.preferences
                };
                self.set_preferences(preferences, reply)
            }
            Command::Baud(baud) => self.request_baud(baud, reply),
        }
    }

    /// Ends the running procedure with the data so far.
    fn finish_procedure(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        let (axes, mount) = (self.body_axes(), self.mount());
        if self.is_compass_running() {
            let settings = &mut self.working.compass;
            let kind = self.compass.finish(settings, mount, module, reply);
            self.keep_mount(Some(kind));
            return kind;
        }
        let calibration = &mut self.working.calibration;
        let kind = self.procedures.finish(calibration, mount, module, reply);
        self.follow_body_axes(axes, module);
        kind
    }

    fn start(
        &mut self,
        procedure: Procedure,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        self.procedures.start(procedure, now_us, module, reply)
    }

    /// Sets the mount. A level trim that belongs to another mount is lost.
    fn set_mount(&mut self, mount: Mount, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        let axes = self.body_axes();
        let had_level = self.working.calibration.level.is_some();
        procedure::set_mount(&mut self.working.calibration, mount, axes.0);
        module.set_calibration(&self.working.calibration);
        let has_lost_level = had_level && self.working.calibration.level.is_none();
        let has_lost_compass = self.follow_body_axes(axes, module);
        let lost = match (has_lost_level, has_lost_compass) {
            (true, true) => ", its level and its compass are to be calibrated again",
            (true, false) => ", its level is to be calibrated again",
            (false, true) => ", its compass is to be calibrated again",
            (false, false) => "",
        };
        reply.ok(format_args!("mount {mount}{lost}; \"save\" keeps it"))
    }

    /// Sets the gyroscope's matrix. Nine zeros remove it.
    fn set_gyroscope(
        &mut self,
        elements: [i16; 9],
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        let matrix = Matrix3::from_ten_thousandths(elements);
        let is_given = elements != [0; 9];
        self.working.calibration.gyroscope_matrix = is_given.then_some(matrix);
        module.set_calibration(&self.working.calibration);
        reply.ok(format_args!(
            "gyro-matrix: the filter starts again if it is new; \"save\" keeps it"
        ))
    }

    /// Adds the offset that the filter has found to the accelerometer's correction.
    fn keep_accelerometer_offset(
        &mut self,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Kind {
        let (axes, mount) = (self.body_axes(), self.mount());
        let calibration = &mut self.working.calibration;
        let correction = calibration.accelerometer;
        if correction.is_some_and(|correction| correction.is_from_poses()) {
            return reply.error(format_args!(
                "calibrate keep: the accelerometer's calibration is better; \
                 \"calibrate accel\" renews it"
            ));
        }
        let Some(found_m_s2) = module.state().accelerometer_offset_m_s2 else {
            return reply.error(format_args!(
                "calibrate keep: the accelerometer's offset is not certain yet; fly or turn the \
                 vehicle, until \"status\" shows accel_found_m_s2"
            ));
        };
        calibration.add_accelerometer_offset(found_m_s2, mount);
        module.set_calibration(calibration);
        self.follow_body_axes(axes, module);
        let found_m_s2 = Triple(found_m_s2, 3);
        reply.ok(format_args!(
            "calibrate keep: added accelerometer offset {found_m_s2} m/s2 forward, right, down; \
             \"save\" keeps it"
        ))
    }

    /// Refuses a command that must not run while armed, or while a procedure is running.
    fn refusal(&self, command: Command, reply: &mut Reply<'_>) -> Option<Kind> {
        use Command::{Arm, Disarm, Format, Help, Rate, Show, Status};
        let is_safe = matches!(
            command,
            Help | Status | Show | Arm | Disarm | Command::Measure(Measure::Show | Measure::Off)
        );
        if self.is_armed && !is_safe {
            return Some(reply.error(format_args!("refused while armed: \"disarm\" first")));
        }
        let is_compatible = is_safe
            || matches!(
                command,
                Rate(_)
                    | Format(_)
                    | Command::Declination(_)
                    | Command::Measure(_)
                    | Command::Calibrate(Calibrate::Done | Calibrate::Stop)
            );
        match self.running() {
            Some(name) if !is_compatible => Some(reply.error(format_args!(
                "refused while \"{name}\" goes on: \"calibrate stop\" ends it"
            ))),
            _ => None,
        }
    }

    fn is_compass_running(&self) -> bool {
        compass::IS_BUILT_IN && self.compass.is_running()
    }

    /// Returns the name of the running procedure.
    pub fn running(&self) -> Option<&'static str> {
        if self.is_compass_running() {
            return Some(compass_procedure::NAME);
        }
        self.procedures.current().map(Procedure::name)
    }

    /// Aborts the running procedure, and returns its name.
    fn abort(&mut self, module: &mut dyn Module) -> Option<&'static str> {
        if compass::IS_BUILT_IN && self.compass.abort(module) {
            return Some(compass_procedure::NAME);
        }
        let procedure = self.procedures.abort(module)?;
        Some(procedure.name())
    }

    /// Starts to store the working record, if a save is due.
    fn save(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        if !self.has_unsaved() {
            return reply.ok(format_args!(
                "save: nothing has changed, nothing is written"
            ));
        }
        self.begin(Job::Save, module, reply)
    }

    /// Begins a job.
    fn begin(&mut self, job: Job, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        self.job = Some(job);
        module.begin(job);
        let name = job_name(job);
        reply.ok(format_args!("{name}: the sensor stops for a second"))
    }

    /// Reports the result of a job.
    fn finish_job(&mut self, job: Job, outcome: &Outcome, reply: &mut Reply<'_>) -> Kind {
        if job == Job::Save && outcome.is_ok {
            self.stored = self.working;
            self.has_problem = false;
        }
        let name = job_name(job);
        let kind = if outcome.is_ok {
            Kind::Done
        } else {
            Kind::Failed
        };
        reply.write(kind, format_args!("{name}: {}", outcome.text))
    }

    /// Clears the working record. The baud rate stays, so that the next command is understood.
    fn forget(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        let defaults = Preferences::default();
        self.working = Record {
            preferences: usable_preferences(Preferences {
                baud: self.working.preferences.baud,
                ..defaults
            }),
            ..Record::with_compass(self.default_compass)
        };
        module.set_calibration(&self.working.calibration);
        module.set_compass(&self.working.compass, self.mount());
        reply.ok(format_args!(
            "forget: nothing is calibrated, mount {}; \
             \"save\" makes it permanent, a restart undoes it",
            self.default_mount
        ))
    }

    /// Arms, and aborts a running procedure.
    fn arm(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        self.is_armed = true;
        let aborted = self.abort(module);
        module.set_armed(true);
        match aborted {
            Some(name) => reply.ok(format_args!("arm: \"{name}\" is given up")),
            None => reply.ok(format_args!("arm")),
        }
    }

    /// Disarms.
    fn disarm(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        self.is_armed = false;
        module.set_armed(false);
        reply.ok(format_args!("disarm"))
    }

    /// Aborts the running procedure.
    fn stop(&mut self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        match self.abort(module) {
            Some(name) => reply.ok(format_args!("calibrate stop: \"{name}\" is given up")),
            None => reply.ok(format_args!("calibrate stop: nothing went on")),
        }
    }

    /// Reads bytes until one ends a line that gets an answer. Noise is forgotten after a pause.
    fn read(
        &mut self,
        now_us: u32,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> Option<Kind> {
        while let Some(byte) = module.receive() {
            self.heard_at_us = now_us;
            let command: Result<Command, ParseError> = match self.line.push(byte) {
                None => continue,
                Some(Ok(line)) => line.parse(),
                Some(Err(_)) => {
                    self.errors.drop_line();
                    continue;
                }
            };
            match command {
                Ok(command) => return Some(self.dispatch(command, now_us, module, reply)),
                Err(error) if self.errors.may_answer(now_us) => {
                    return Some(reply.error(format_args!("{error}")));
                }
                Err(_) => self.errors.drop_line(),
            }
        }
        if now_us.wrapping_sub(self.heard_at_us) >= NOISE_PAUSE_US {
            self.line.forget_noise();
        }
        None
    }

    /// Answers `status`.
    fn status(&self, module: &mut dyn Module, reply: &mut Reply<'_>) -> Kind {
        let status = Status {
            state: &module.state(),
            calibration: &self.working.calibration,
            compass: &self.working.compass,
            mount: self.mount(),
            is_armed: self.is_armed,
            has_unsaved: self.has_unsaved(),
            lines_dropped: self.errors.dropped,
            doing: self.running(),
            procedure: self.procedures.current(),
        };
        reply.ok(format_args!("status: {status}"))
    }
}

/// Returns the command that starts a job.
const fn job_name(job: Job) -> &'static str {
    match job {
        Job::Save => "save",
        Job::SelfTest => "self-test",
        Job::ReadBack => "registers",
    }
}

/// Refuses a command about a compass.
fn no_compass(reply: &mut Reply<'_>) -> Kind {
    reply.error(format_args!(
        "this firmware has no compass: build it with the feature \"compass\""
    ))
}
