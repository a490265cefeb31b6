//! `aplomb record`: the bytes of a module in a file.

use std::error::Error;
use std::fs::{File, OpenOptions};
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use aplomb_recordings::output::{cannot_write, check_writable, refuse_to_overwrite};
use aplomb_recordings::terminal::{print_message, print_status};

use crate::end_request::end_request;
use crate::i2c::I2cOptions;
use crate::link::{BAUD, LOG_BAUD, Link, Report, which_port};
use crate::stream::{Decoder, Item, field};
use crate::usage::Usage;

/// Longest time until the module answers a command.
const ANSWER: Duration = Duration::from_secs(2);

/// Attempts to have the module send its log.
const COMMANDS: u32 = 2;

/// Time to detect a module that still sends its flight log: it sends 1000 bursts a second.
const LISTEN: Duration = Duration::from_secs(1);

/// Time with unreadable bytes that shows that the module has started again at its own baud rate.
const LOG_PATIENCE: Duration = Duration::from_secs(3);

/// Unreadable bytes that are more than noise.
const UNREAD: usize = 100;

/// Longest wait for bytes that are still on their way when the recording ends.
const DRAIN: Duration = Duration::from_secs(2);

/// Record what the module sends, byte for byte.
///
/// Every byte is in the file as soon as it has come, so that Ctrl-C loses nothing. A port that is
/// unplugged is waited for, and later bytes are appended; with `--log` the log is requested again
/// if need be. The bytes can be played by `aplomb view`; a flight log also by `aplomb replay`.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb record --port /dev/ttyUSB0 --output flight.log --log
  aplomb record --port /dev/ttyUSB0 --output text.uart --seconds 60
  aplomb record --i2c /dev/i2c-1 --output flight.log --seconds 60

Exit code: 0 if attitudes or bursts were recorded, 1 if not, or if the log did not go on after the
port had been gone.")]
pub struct Options {
    /// The module's serial port; without one the ports of this computer are listed
    #[arg(long, conflicts_with = "I2cOptions")]
    port: Option<String>,
    #[command(flatten)]
    sensor: I2cOptions,
    /// The module's baud rate
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// The file to write
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// End after so many seconds. Default: with Ctrl-C
    #[arg(long, allow_negative_numbers = true, value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Have the module send its flight log at 921,600 baud, and what it sent before when the
    /// recording ends. A sensor on a bus always gives a flight log
    #[arg(long, conflicts_with = "i2c")]
    log: bool,
    /// Replace the file if it is there
    #[arg(long)]
    force: bool,
}

fn parse_seconds(text: &str) -> Result<f64, &'static str> {
    let seconds = text.parse().ok();
    seconds
        .filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0)
        .ok_or("it has to be a number above 0")
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    if options.port.is_none() && options.sensor.i2c.is_none() {
        return Err(Usage::from(which_port()).into());
    }
    // A name that is in use is refused before the flight, not after it.
    if options.output == Path::new("-") {
        let reason = "record keeps what it hears in a file: give its name with --output";
        return Err(Usage::from(reason).into());
    }
    let calibration = options.sensor.calibration.as_deref();
    refuse_to_overwrite(&options.output, calibration.as_slice())?;
    let was_there = options.output.exists();
    if was_there && !options.force {
        return Err(exists(&options.output).into());
    }
    let ends = end_request()?;
    let link = match &options.port {
        Some(port) => Link::port(port, options.baud)?,
        None => Link::sensor(options.sensor.open()?.0),
    };
    let mut recorder = Recorder::new(options, link)?;
    if options.log {
        recorder.ask_for_log();
    }
    let result = recorder.run(ends);
    let summary = recorder.summary();
    let is_back = recorder.leave();
    let (counts, bytes) = (recorder.decoder.counts(), recorder.bytes);
    drop(recorder);
    if bytes == 0 && !was_there {
        // An empty file is of no use, and in the way of the next attempt.
        std::fs::remove_file(&options.output).ok();
    }
    if let Err(error) = is_back {
        print_message(&format!("warning: {error}"));
    }
    if bytes > 0 {
        print_message(&summary);
    }
    result?;
    let baud = options.baud;
    if bytes == 0 {
        return Err(format!("nothing has come at {baud} baud").into());
    }
    if counts.attitudes + counts.bursts == 0 {
        let output = options.output.display();
        return Err(format!(
            "nothing of it could be read at {baud} baud: was that the rate? \
             The bytes are in {output}"
        )
        .into());
    }
    Ok(())
}

/// Records the flight log of a module for so many seconds. Replaces the file.
pub fn record_log(
    port: &str,
    baud: u32,
    seconds: u32,
    output: &Path,
) -> Result<(), Box<dyn Error>> {
    run(&Options {
        port: Some(port.to_owned()),
        baud,
        output: output.to_owned(),
        seconds: Some(seconds.into()),
        log: true,
        force: true,
        sensor: I2cOptions::default(),
    })
}

fn exists(path: &Path) -> String {
    format!(
        "{} is there already: choose another name, or --force to replace it",
        path.display()
    )
}

/// Opens the file to write. Its contents stay until the first byte comes.
fn open(path: &Path, may_replace: bool) -> Result<File, String> {
    check_writable(path).map_err(|error| cannot_write(path, &error))?;
    let mut options = OpenOptions::new();
    options.write(true);
    if may_replace {
        options.create(true);
    } else {
        options.create_new(true);
    }
    options.open(path).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => exists(path),
        _ => cannot_write(path, &error),
    })
}

/// Stage of the request for a flight log.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// The module was asked for its format.
    Asked,
    /// The baud rate is being changed.
    Switching,
    /// The module was told to send the log.
    Commanded,
    /// The module sends the log.
    Runs,
    /// The port was gone, or the module has started again: the module may still send the log.
    Listening,
}

/// Request for a flight log, and its progress.
struct LogRequest {
    stage: Stage,
    since: Instant,
    /// Number of commands for the log since the module was asked for its format.
    commands: u32,
    /// Decoder of the answers before the recording begins, or between its parts.
    talk: Decoder,
    /// Bytes received while listening.
    held: Vec<u8>,
    /// Format before the request.
    format: Option<String>,
    /// The module's format or baud rate may have changed.
    is_changed: bool,
    has_run: bool,
    /// Reason why the log does not continue.
    trouble: Option<String>,
    /// Time of the last readable piece, and number of bytes since.
    heard: Instant,
    unread: usize,
}

/// Recorder of a module.
struct Recorder<'a> {
    options: &'a Options,
    file: File,
    link: Link,
    decoder: Decoder,
    bytes: u64,
    gaps: u32,
    is_away: bool,
    started: Instant,
    log: Option<LogRequest>,
}

impl<'a> Recorder<'a> {
    /// Opens the file. That is before any command, so that a failure does not change the module.
    fn new(options: &'a Options, link: Link) -> Result<Self, String> {
        Ok(Self {
            options,
            file: open(&options.output, options.force)?,
            link,
            decoder: Decoder::default(),
            bytes: 0,
            gaps: 0,
            is_away: false,
            started: Instant::now(),
            log: None,
        })
    }

    fn run(&mut self, ends: &AtomicBool) -> Result<(), String> {
        let is_terminal = io::stderr().is_terminal();
        let period = Duration::from_millis(if is_terminal { 200 } else { 10_000 });
        let mut reported = Instant::now();
        while !ends.load(Ordering::Relaxed) && !self.is_complete() {
            if let Some(report) = self.link.next(Duration::from_millis(50)) {
                self.on_report(report)?;
            }
            self.pass_time()?;
            let is_running = self.log.as_ref().is_none_or(|log| log.stage == Stage::Runs);
            if reported.elapsed() >= period && !self.is_away && is_running {
                reported = Instant::now();
                if is_terminal {
                    print_status(&format!("\r\x1b[K{}", self.summary()));
                } else {
                    print_message(&self.summary());
                }
            }
        }
        if is_terminal {
            print_status("\r\x1b[K");
        }
        // Bytes until now belong to the recording.
        let ended = Instant::now();
        while ended.elapsed() < DRAIN
            && let Some(report) = self.link.next(Duration::ZERO)
        {
            self.on_report(report)?;
        }
        let data = self.file.metadata();
        if data.is_ok_and(|data| data.is_file()) {
            self.file
                .sync_all()
                .map_err(|error| cannot_write(&self.options.output, &error))?;
        }
        match &self.log {
            Some(log) if !log.has_run => Err("it was ended before the flight log had begun".into()),
            Some(log) if log.stage != Stage::Runs => {
                let reason = log.trouble.as_deref().unwrap_or("there was no time for it");
                Err(format!("the flight log did not go on in the end: {reason}"))
            }
            _ => Ok(()),
        }
    }

    /// Returns whether the requested seconds are recorded. Those of a flight log count from its
    /// begin.
    fn is_complete(&self) -> bool {
        let has_begun = self.log.as_ref().is_none_or(|log| log.has_run);
        let seconds = self.options.seconds.filter(|_| has_begun);
        seconds.is_some_and(|seconds| self.started.elapsed().as_secs_f64() >= seconds)
    }

    fn on_report(&mut self, report: Report) -> Result<(), String> {
        match report {
            Report::Bytes(bytes) => return self.take(bytes),
            // A sensor that never gave a sample has a wrong wire. A port may be plugged in later.
            Report::Away(reason) if self.is_sensor() && self.decoder.counts().bursts == 0 => {
                return Err(reason);
            }
            Report::Away(reason) => {
                self.decoder.interrupt();
                self.gaps += 1;
                self.is_away = true;
                print_message(&format!("\nthe port is gone ({reason}): waiting for it"));
                if self.log.as_ref().is_some_and(|log| !log.has_run) {
                    return Err("the port was gone before the flight log had begun".into());
                }
                self.listen();
            }
            Report::Back => {
                self.is_away = false;
                print_message("the port is back");
                self.listen();
            }
            Report::Ended(reason) => return Err(reason),
            Report::Switched(Ok(_)) => self.command_log(),
            Report::Switched(Err(reason)) => return self.fail(reason),
        }
        Ok(())
    }

    /// Returns whether a sensor on a bus of this computer is recorded.
    fn is_sensor(&self) -> bool {
        self.options.sensor.i2c.is_some()
    }

    /// Takes received bytes: into the file, unless they are answers.
    fn take(&mut self, bytes: Vec<u8>) -> Result<(), String> {
        let Some(log) = &mut self.log else {
            return self.keep(&bytes);
        };
        match log.stage {
            Stage::Runs => return self.keep(&bytes),
            Stage::Listening => {
                log.talk.push(&bytes, &mut Vec::new());
                log.held.extend(bytes);
                if log.talk.counts().bursts > 0 {
                    let held = std::mem::take(&mut log.held);
                    self.begin();
                    return self.keep(&held);
                }
                return Ok(());
            }
            _ => {}
        }
        // One byte at a time: those after the last answer belong to the log.
        for (index, byte) in bytes.iter().enumerate() {
            let Some(log) = &mut self.log else {
                return Ok(());
            };
            let mut items = Vec::new();
            log.talk.push(&[*byte], &mut items);
            for item in items {
                if let Item::Message(text) = item
                    && self.answer(&text)?
                {
                    return self.keep(bytes.get(index + 1..).unwrap_or_default());
                }
            }
        }
        Ok(())
    }

    /// Takes an answer of the module, and returns whether the log has begun.
    fn answer(&mut self, text: &str) -> Result<bool, String> {
        let Some(log) = &mut self.log else {
            return Ok(false);
        };
        match (log.stage, text.strip_prefix("ok ")) {
            (Stage::Asked, Some(answer)) if answer.starts_with("show:") => {
                let format = field(answer, "format").unwrap_or("text");
                log.format.get_or_insert_with(|| format.to_owned());
                log.is_changed = true;
                if self.options.baud == LOG_BAUD {
                    self.command_log();
                } else {
                    self.enter(Stage::Switching);
                    self.link.switch_baud(LOG_BAUD);
                }
            }
            (Stage::Commanded, Some(answer)) if answer.starts_with("log") => {
                self.begin();
                return Ok(true);
            }
            (Stage::Commanded, None) if text.starts_with("error") => self.fail(text.to_owned())?,
            _ => {}
        }
        Ok(false)
    }

    fn enter(&mut self, stage: Stage) {
        if let Some(log) = &mut self.log {
            log.stage = stage;
            log.since = Instant::now();
        }
    }

    /// Asks the module for its format, at its own baud rate.
    fn ask_for_log(&mut self) {
        let now = Instant::now();
        let log = self.log.get_or_insert_with(|| LogRequest {
            stage: Stage::Asked,
            since: now,
            commands: 0,
            talk: Decoder::default(),
            held: Vec::new(),
            format: None,
            is_changed: false,
            has_run: false,
            trouble: None,
            heard: now,
            unread: 0,
        });
        log.talk = Decoder::default();
        log.commands = 0;
        self.enter(Stage::Asked);
        self.link.set_baud(self.options.baud);
        self.link.send_line("show");
    }

    fn command_log(&mut self) {
        self.enter(Stage::Commanded);
        if let Some(log) = &mut self.log {
            log.commands += 1;
        }
        self.link.send_line("format log");
    }

    /// Begins the log, or continues it.
    fn begin(&mut self) {
        self.enter(Stage::Runs);
        if let Some(log) = &mut self.log {
            (log.heard, log.unread) = (Instant::now(), 0);
            log.trouble = None;
            if std::mem::replace(&mut log.has_run, true) {
                print_message("the flight log goes on");
            } else {
                self.started = Instant::now();
            }
        }
    }

    /// Listens for the log: without a loss of power the module still sends it.
    fn listen(&mut self) {
        if let Some(log) = &mut self.log {
            log.talk = Decoder::default();
            log.held.clear();
            self.enter(Stage::Listening);
            self.link.set_baud(LOG_BAUD);
        }
    }

    /// Handles a failed request: gives up before the log has begun, and tries again later.
    fn fail(&mut self, reason: String) -> Result<(), String> {
        match &mut self.log {
            Some(log) if log.has_run => {
                if log.trouble.replace(reason.clone()).is_none() {
                    print_message(&format!(
                        "the flight log does not go on yet ({reason}): trying again"
                    ));
                }
                self.listen();
                Ok(())
            }
            Some(_) => Err(reason),
            None => Ok(()),
        }
    }

    /// Continues after a timeout.
    fn pass_time(&mut self) -> Result<(), String> {
        let baud = self.options.baud;
        let Some(log) = self.log.as_ref().filter(|_| !self.is_away) else {
            return Ok(());
        };
        let elapsed = log.since.elapsed();
        match log.stage {
            Stage::Asked if elapsed >= ANSWER => self.fail(format!(
                "the module does not answer at {baud} baud: is it aplomb, and is that its rate?"
            )),
            // Noise may have spoilt a line.
            Stage::Commanded if elapsed >= ANSWER && log.commands < COMMANDS => {
                self.command_log();
                Ok(())
            }
            Stage::Commanded if elapsed >= ANSWER => self.fail(format!(
                "the module did not confirm `format log` at {LOG_BAUD} baud"
            )),
            Stage::Listening if elapsed >= LISTEN => {
                self.ask_for_log();
                Ok(())
            }
            Stage::Runs if log.heard.elapsed() >= LOG_PATIENCE && log.unread >= UNREAD => {
                print_message(
                    "what comes cannot be read any more: asking for the flight log again",
                );
                self.decoder.interrupt();
                self.listen();
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Restores the module's format and baud rate.
    fn leave(&self) -> Result<(), String> {
        match &self.log {
            Some(LogRequest {
                is_changed: true,
                format: Some(format),
                ..
            }) => self.link.bring_back(format, self.options.baud),
            _ => Ok(()),
        }
    }

    /// Writes bytes without a buffer, so that they survive this program.
    fn keep(&mut self, bytes: &[u8]) -> Result<(), String> {
        if bytes.is_empty() {
            return Ok(());
        }
        let is_first = self.bytes == 0;
        let is_file = |data: std::fs::Metadata| data.is_file();
        if is_first && self.file.metadata().is_ok_and(is_file) {
            self.file
                .set_len(0)
                .map_err(|error| cannot_write(&self.options.output, &error))?;
        }
        self.file.write_all(bytes).map_err(|error| {
            format!(
                "{}: cannot be written any more: {error}",
                self.options.output.display()
            )
        })?;
        self.bytes += bytes.len() as u64;
        let before = self.decoder.counts().bursts;
        let mut items = Vec::new();
        self.decoder.push(bytes, &mut items);
        if let Some(log) = &mut self.log {
            log.unread += bytes.len();
            if !items.is_empty() || self.decoder.counts().bursts != before {
                (log.heard, log.unread) = (Instant::now(), 0);
            }
        }
        Ok(())
    }

    /// Returns the counts as a line.
    fn summary(&self) -> String {
        use std::fmt::Write as _;
        let counts = self.decoder.counts();
        let mut text = format!(
            "{:.1} s, {} bytes",
            self.started.elapsed().as_secs_f64(),
            self.bytes
        );
        if let Some(format) = self.decoder.format() {
            write!(
                text,
                " of {}: {} attitudes",
                format.name(),
                counts.attitudes
            )
            .ok();
        }
        if counts.bursts > 0 {
            write!(text, ", {} bursts", counts.bursts).ok();
        }
        write!(text, ", {} lost, {} damaged", counts.lost, counts.damaged).ok();
        if self.gaps > 0 {
            write!(text, ", unplugged {} times", self.gaps).ok();
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::i2c::Sampled;
    use aplomb::mpu6050::Burst;

    /// Sensor whose INT pin is not wired.
    struct Unwired;

    impl Sampled for Unwired {
        fn step(&mut self) -> Result<Option<Burst>, String> {
            std::thread::sleep(Duration::from_millis(10));
            Err("no edge comes on gpiochip0:17".to_owned())
        }

        fn is_back(&mut self) -> bool {
            true
        }

        fn is_bus_too_slow(&self) -> bool {
            false
        }

        fn take_bytes(&self) -> Vec<u8> {
            Vec::new()
        }

        fn say(&self, _: &str) {}
    }

    #[test]
    fn a_sensor_that_gives_no_sample_ends_the_recording() {
        let output = std::env::temp_dir().join(format!("aplomb-unwired-{}", std::process::id()));
        let mut sensor = I2cOptions::default();
        sensor.i2c = Some("/dev/i2c-1".into());
        let options = Options {
            port: None,
            sensor,
            baud: BAUD,
            output: output.clone(),
            seconds: Some(3.0),
            log: false,
            force: true,
        };
        let link = Link::sensor(Box::new(Unwired));
        let mut recorder = Recorder::new(&options, link).expect("it opens");
        let result = recorder.run(&AtomicBool::new(false));
        std::fs::remove_file(&output).ok();
        assert_eq!(result, Err("no edge comes on gpiochip0:17".to_owned()));
    }
}
