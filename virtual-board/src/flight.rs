//! A run of the firmware on the virtual board, from power-up for as long as asked.
//!
//! ```no_run
//! use virtual_board::faults::Fault;
//! use virtual_board::flight::Run;
//!
//! let outcome = Run::new("flight.elf").seed(7).seconds(3.0).fault(Fault::NoCrystal).run()?;
//! assert!(outcome.reports("no crystal"));
//! # Ok::<(), virtual_board::Error>(())
//! ```

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use rigless::emulator::{self, Start};
use rigless::image::Image;
use rigless::mcu::Mcu as _;
use rigless::session::Session;
use rigless::time::VirtualNanos;

use crate::Error;
use crate::board::{BOARDS, Board, BoardModel};
use crate::checks::Rule;
use crate::crystal::HighSpeedInput;
use crate::faults::{Fault, ScheduledFault, internal_time, nanoseconds, scheduled};
use crate::fitted::BusDevices;
use crate::flash::{FlashRecord, SharedCells};
use crate::image::Firmware;
use crate::kit::Kit;
use crate::mcu::{ChipIdentity, Microcontroller, SentByte, Terminal};
use crate::probe::{LogLine, Probe};
use crate::profile::{PoolKey, ProcessorPool, Profile};
use crate::recorder::{NoObserver, Observer, Record, Recorder, Sample};
use crate::schedule::Schedule;
use crate::script::Script;
use crate::summary::Summary;
use aplomb_models::compass::CompassConfig;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::swing::ByOtherClock;
use aplomb_models::motion::{Motion, Mount};
use aplomb_models::sensor::{Sensor, SensorConfig, SensorErrors};

/// The settings of a run.
pub struct Run {
    firmware: PathBuf,
    board: BoardModel,
    seed: u64,
    seconds: f64,
    mount: Mount,
    kit: Kit,
    sensor_address: u8,
    /// A compass instead of the kit's.
    compass: Option<CompassConfig>,
    /// The motion, and true if it is a recording: then the sensor adds no errors of its own.
    motion: Option<(Box<dyn Motion>, bool)>,
    faults: Vec<Fault>,
    script: Vec<SentByte>,
    errors: Option<SensorErrors>,
    flash: FlashRecord,
    has_probe: bool,
    steps_everything: bool,
    has_account: bool,
    pool: Option<Arc<ProcessorPool>>,
    has_memory_protection: bool,
    observer: Box<dyn Observer>,
}

impl Run {
    /// A run of an image: 30 s of the simulated flight of seed 1 on the first board, with a probe,
    /// without faults.
    #[must_use]
    pub fn new(firmware: impl Into<PathBuf>) -> Self {
        Self {
            firmware: firmware.into(),
            board: BOARDS[0],
            seed: 1,
            seconds: 30.0,
            mount: Mount::default(),
            kit: Kit::default(),
            sensor_address: 0x68,
            compass: None,
            motion: None,
            faults: Vec::new(),
            script: Vec::new(),
            errors: None,
            flash: FlashRecord::blank(),
            has_probe: true,
            steps_everything: false,
            has_account: true,
            pool: None,
            has_memory_protection: true,
            observer: Box::new(NoObserver),
        }
    }

    /// Seeds the sensor, the simulated flight, and the content of the RAM at power-up.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets the length of the run, in virtual seconds from power-up.
    #[must_use]
    pub fn seconds(mut self, seconds: f64) -> Self {
        self.seconds = seconds;
        self
    }

    /// Selects the board.
    #[must_use]
    pub fn board(mut self, board: BoardModel) -> Self {
        self.board = board;
        self
    }

    /// Mounts the sensor in the vehicle. The image must have been built for the same mount.
    #[must_use]
    pub fn mount(mut self, mount: Mount) -> Self {
        self.mount = mount;
        self
    }

    /// Selects the sensor board.
    #[must_use]
    pub fn kit(mut self, kit: Kit) -> Self {
        self.kit = kit;
        self
    }

    /// Wires the sensor's AD0, which selects its bus address: 0x68 low, 0x69 high.
    #[must_use]
    pub fn sensor_address(mut self, address: u8) -> Self {
        self.sensor_address = address;
        self
    }

    /// Fits this compass instead of the kit's.
    #[must_use]
    pub fn compass(mut self, config: CompassConfig) -> Self {
        self.compass = Some(config);
        self
    }

    /// Moves the board by this motion instead of the simulated flight.
    #[must_use]
    pub fn motion(mut self, motion: impl Motion + 'static) -> Self {
        self.motion = Some((Box::new(motion), false));
        self
    }

    /// Moves the board by a motion that is chosen at run time.
    #[must_use]
    pub fn boxed_motion(mut self, motion: Box<dyn Motion>) -> Self {
        self.motion = Some((motion, false));
        self
    }

    /// Moves the board as recorded. The recording's own sensor errors are the only ones.
    #[must_use]
    pub fn recording(mut self, recording: impl Motion + 'static) -> Self {
        self.motion = Some((Box::new(recording), true));
        self
    }

    /// Adds a fault.
    #[must_use]
    pub fn fault(mut self, fault: Fault) -> Self {
        self.faults.push(fault);
        self
    }

    /// Sends a line to the UART, `at_s` seconds after power-up or as soon as the lines before it
    /// have been sent.
    #[must_use]
    pub fn command(self, at_s: f64, line: &str) -> Self {
        self.send(at_s, format!("{line}\n").as_bytes())
    }

    /// Sends the commands of a script.
    #[must_use]
    pub fn commands(self, script: &Script) -> Self {
        let lines = script.lines().iter();
        lines.fold(self, |run, (at_s, line)| run.command(*at_s, line))
    }

    /// Sends bytes to the UART, `at_s` seconds after power-up or as soon as those before them have
    /// been sent.
    #[must_use]
    pub fn send(mut self, at_s: f64, bytes: &[u8]) -> Self {
        let at_ns = nanoseconds(at_s);
        let sent = bytes.iter().map(|&byte| SentByte { at_ns, byte });
        self.script.extend(sent);
        self
    }

    /// Fits a sensor with these errors instead of those of the seed.
    #[must_use]
    pub fn sensor_errors(mut self, errors: SensorErrors) -> Self {
        self.errors = Some(errors);
        self
    }

    /// Adds the faults of a schedule.
    #[must_use]
    pub fn schedule(mut self, schedule: &Schedule) -> Self {
        self.faults
            .extend(schedule.faults.iter().copied().map(Fault::Scheduled));
        self
    }

    /// Starts with these bytes in the calibration slots, as [`FlashRecord::holding`] takes them.
    #[must_use]
    pub fn flash(mut self, bytes: Vec<u8>) -> Self {
        self.flash = FlashRecord::holding(bytes);
        self
    }

    /// Leaves the log buffer unread, as without a debug probe.
    #[must_use]
    pub fn without_probe(mut self) -> Self {
        self.has_probe = false;
        self
    }

    /// Executes one instruction at a time: the reference for the account of instructions. Slow.
    #[must_use]
    pub fn step_everything(mut self) -> Self {
        self.steps_everything = true;
        self
    }

    /// Keeps no account of instructions, which is faster.
    #[must_use]
    pub fn without_account(mut self) -> Self {
        self.has_account = false;
        self
    }

    /// Flies on a core without the memory protection unit, as from a pool.
    #[must_use]
    pub fn without_memory_protection(mut self) -> Self {
        self.has_memory_protection = false;
        self
    }

    /// Flies with a processor from this pool, so that the image is not translated again. Keeps no
    /// account of instructions. The core has no memory protection unit.
    #[must_use]
    pub fn pool(mut self, pool: &Arc<ProcessorPool>) -> Self {
        self.pool = Some(Arc::clone(pool));
        self.has_memory_protection = false;
        self.has_account = false;
        self.steps_everything = false;
        self
    }

    /// Reports the run to an observer while it goes on.
    #[must_use]
    pub fn observer(mut self, observer: impl Observer + 'static) -> Self {
        self.observer = Box::new(observer);
        self
    }

    /// Makes the run.
    ///
    /// # Errors
    ///
    /// When the image cannot be used, or the emulator gives up.
    pub fn run(mut self) -> Result<Outcome, Error> {
        let firmware = Firmware::read(&self.firmware)?;
        let scheduled: Vec<ScheduledFault> = scheduled(&self.faults).copied().collect();
        let timer_starts_at = self.faults.iter().find_map(|fault| match fault {
            Fault::TimerStartsAt(count) => Some(*count),
            _ => None,
        });
        let profile = Arc::new(Mutex::new(self.profile()));
        let cells = SharedCells::new(self.flash.clone());
        let pool = self.pool.take().map(|pool| {
            let image = Arc::from(firmware.bytes.as_slice());
            let core_hz = self.board.core_hz;
            (pool, PoolKey { core_hz, image })
        });
        let board = Board::new(
            self.board,
            self.controller(cells.clone())?,
            firmware.handlers.clone(),
            Arc::clone(&profile),
            cells.clone(),
        )
        .pool(pool)
        .memory_protection(self.has_memory_protection);
        let probe = firmware
            .log_channel
            .filter(|_| self.has_probe)
            .and_then(|at| Probe::attach(&firmware.bytes, at));
        let recorder = Recorder::new(
            &firmware,
            nanoseconds(self.seconds),
            probe,
            timer_starts_at,
            &scheduled,
            Arc::clone(&profile),
            self.observer,
        )
        .seed(self.seed);

        let started = Instant::now();
        let images = [
            Image::new(&firmware.path, firmware.bytes.clone(), None).map_err(Error::emulator)?
        ];
        let session = Session::new(Box::new(board), 0, VirtualNanos(0)).map_err(Error::emulator)?;
        let mut finished =
            emulator::run(session, &Start::new(&images), recorder).map_err(Error::emulator)?;
        let wall_seconds = started.elapsed().as_secs_f64();
        if let Some(error) = finished.session.take_error() {
            return Err(Error::emulator(error));
        }
        let record = finished.driver.into_record();
        let violations = violations(&finished.session);
        let issues = issues(&finished.session, &violations, &profile);
        Ok(Outcome {
            summary: Summary::of(&record, &firmware, self.board.core_hz, wall_seconds),
            uart_lines: lines(&record),
            record,
            faults: scheduled,
            flash: cells.record(),
            violations,
            issues,
        })
    }

    /// Returns the sensor on its motion. Takes the motion out of the settings.
    fn sensor(&mut self) -> Sensor {
        let (motion, is_recording) = match self.motion.take() {
            Some(motion) => motion,
            None => (
                Box::new(Quadrotor::by_seed(self.seed)) as Box<dyn Motion>,
                false,
            ),
        };
        let motion: Box<dyn Motion> = match internal_time(&self.faults) {
            Some((error, from_ns)) => Box::new(ByOtherClock {
                motion,
                from_s: from_ns as f64 * 1e-9,
                error,
            }),
            None => motion,
        };
        let config = if is_recording {
            SensorConfig::for_recording(self.seed)
        } else {
            SensorConfig::new(self.seed)
        };
        Sensor::new(
            SensorConfig {
                mount: self.mount,
                address: self.sensor_address,
                who_am_i: self.kit.who_am_i(),
                errors: self.errors.take().unwrap_or(config.errors),
                ..config
            },
            motion,
        )
    }

    /// Returns the microcontroller with the sensor, the faults and the script. Takes the motion and
    /// the faults out of the settings.
    fn controller(&mut self, cells: SharedCells) -> Result<Microcontroller, Error> {
        let input = if self.faults.contains(&Fault::NoCrystal) {
            HighSpeedInput::Nothing
        } else {
            self.board.input
        };
        let garbled = self.faults.iter().find_map(|fault| match fault {
            Fault::ReceptionGarbled {
                noise_per_million,
                framing_per_million,
            } => Some((*noise_per_million, *framing_per_million)),
            _ => None,
        });
        let watchdog_hz = self.faults.iter().find_map(|fault| match fault {
            Fault::WatchdogClock(hz) => Some(*hz),
            _ => None,
        });
        let revision = self.faults.iter().find_map(|fault| match fault {
            Fault::ChipRevision(revision) => Some(*revision),
            _ => None,
        });
        let mut identity = ChipIdentity {
            device: self.board.device_id,
            revision: revision.unwrap_or(ChipIdentity::STM32F405_Y.revision),
        };
        let is_stm32f405 = identity.device == ChipIdentity::STM32F405_Y.device;
        if is_stm32f405 && identity.revision == ChipIdentity::STM32F405_A.revision {
            identity = ChipIdentity::STM32F405_A;
        }
        let has_slow_starts = self.faults.contains(&Fault::SlowStart);
        let leaves_no_time_for_stop = self.faults.contains(&Fault::NoTimeForStop);
        let is_watchdog_slow = self.faults.contains(&Fault::SlowWatchdog);
        let sensor = self.sensor();
        let compass = self.compass.take();
        let compass = compass.or_else(|| self.kit.compass(self.seed, self.mount));
        let mut controller = Microcontroller::new(
            BusDevices::new(sensor, std::mem::take(&mut self.faults)).with_compass(compass),
            input,
            Terminal::new(&self.script),
            cells,
        )
        .map_err(Error::emulator)?;
        if has_slow_starts {
            controller.let_starts_take_time();
        }
        if leaves_no_time_for_stop {
            controller.leave_no_time_for_stop();
        }
        if let Some(hz) = watchdog_hz {
            controller.calibrate_watchdog(hz);
        }
        if is_watchdog_slow {
            controller.slow_watchdog();
        }
        controller.identify(identity);
        controller.fit(self.board.regulator, self.board.core_hz);
        if let Some((noise, framing)) = garbled {
            controller.garble_reception(self.seed, noise, framing);
        }
        Ok(controller)
    }

    /// Returns the account of instructions that the settings ask for.
    fn profile(&self) -> Profile {
        if self.steps_everything {
            Profile::stepping_everything()
        } else if !self.has_account {
            Profile::crashes_only()
        } else {
            Profile::default()
        }
    }
}

/// The outcome of a run.
#[derive(Debug)]
pub struct Outcome {
    /// The figures.
    pub summary: Summary,
    /// The lines that came out of the UART.
    pub uart_lines: Vec<UartLine>,
    /// The record of the run.
    pub record: Record,
    /// The faults of the schedule.
    pub faults: Vec<ScheduledFault>,
    /// The calibration slots, and what was done to them.
    pub flash: FlashRecord,
    /// Rules of [`checks`](crate::checks) that the firmware has broken, with their places. Also
    /// accesses to no register, refused accesses, writes that nothing models, and interrupts
    /// without a line. Each fails a campaign's flight, and `fly`.
    pub violations: Vec<String>,
    /// Violations, resets, and gaps in the account of instructions. Empty in a sound run.
    pub issues: Vec<String>,
}

/// A line from the UART.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UartLine {
    /// Arrival of the line feed, ns since power-up.
    pub at_ns: u64,
    /// The line, without the line feed.
    pub text: String,
}

impl Outcome {
    /// The published samples.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        &self.record.samples
    }

    /// The lines of the firmware's log.
    #[must_use]
    pub fn log(&self) -> &[LogLine] {
        &self.record.log
    }

    /// Returns true if both outputs, UART and log, have a line that contains this text.
    #[must_use]
    pub fn reports(&self, text: &str) -> bool {
        self.uart_reports(text) && self.log().iter().any(|line| line.text.contains(text))
    }

    /// Returns true if the UART has a line that contains this text.
    #[must_use]
    pub fn uart_reports(&self, text: &str) -> bool {
        self.uart_lines.iter().any(|line| line.text.contains(text))
    }
}

/// The UART's bytes as lines.
fn lines(record: &Record) -> Vec<UartLine> {
    record
        .received
        .split_inclusive(|received| received.byte == b'\n')
        .filter_map(|line| {
            let bytes: Vec<u8> = line.iter().map(|received| received.byte).collect();
            let text = String::from_utf8_lossy(&bytes).trim_end().to_owned();
            line.last().map(|last| UartLine {
                at_ns: last.at_ns,
                text,
            })
        })
        .collect()
}

/// Lists the rules for accesses that the firmware has broken, and accesses that do nothing.
fn violations(session: &Session<Board>) -> Vec<String> {
    // Wait states too few for the clock, above all (RM0090, 3.5.1).
    let told = session
        .told()
        .map(|told| format!("{}.{}: {}", told.instance, told.register, told.reason));
    let controller = &session.board().controller;
    let checks = controller.checks();
    let refused = session.refused().iter();
    let (gated, refused): (Vec<_>, Vec<_>) = refused.partition(|(_, fault)| fault.is_shut_gate());
    for (&address, _) in gated {
        checks.note_at(Rule::Clocked, address);
    }
    let model = session.board().model;
    checks.note_absent(controller.bus(), |peripheral| model.lacks(peripheral));
    let prefetch = controller.prefetches_on_revision_a();
    let prefetch = prefetch.then(|| "FLASH.ACR: the prefetch is on, on revision A (ES0182)".into());
    let own = checks.violations();
    let own = own.iter().map(ToString::to_string);
    let unmapped = session.unmapped().into_iter();
    let unmapped = unmapped.map(|unmapped| format!("no such address: {unmapped}"));
    let refused = refused.into_iter();
    let refused = refused.map(|(address, fault)| format!("refused at {address:#010x}: {fault:?}"));
    let unmodelled = session.unimplemented().values();
    let unmodelled = unmodelled.filter(|access| access.writes > 0).map(|access| {
        format!(
            "not modelled: {}.{} written at {:#010x}",
            access.instance, access.register, access.program_counter
        )
    });
    let unrouted = session.unrouted().iter();
    let unrouted = unrouted.map(|unrouted| format!("an interrupt without a line: {unrouted:?}"));
    let rules = told.chain(own).chain(prefetch);
    let without_effect = unmapped.chain(refused).chain(unmodelled).chain(unrouted);
    rules.chain(without_effect).collect()
}

/// Lists the events that a sound run does not have.
fn issues(
    session: &Session<Board>,
    violations: &[String],
    profile: &Mutex<Profile>,
) -> Vec<String> {
    let resets = session.resets().iter();
    let mut issues: Vec<String> = resets
        .map(|reset| format!("reset at {} ns: {:?}", reset.at.0, reset.cause))
        .collect();
    issues.extend_from_slice(violations);
    let unexplained = profile.lock().map_or(1, |profile| profile.unexplained());
    if unexplained > 0 {
        issues.push(format!(
            "{unexplained} changes of context that the instruction account cannot explain"
        ));
    }
    issues
}
