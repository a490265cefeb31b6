//! `virtual-board`: flies a firmware image on the virtual board. `fly` writes the results of one
//! flight to a folder, `faults` flies a campaign with random faults.

mod arming;
mod campaign_command;
mod live;
mod screen;

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Read as _;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use aplomb_models::motion::Mount;
use aplomb_recordings::motion::Recording;
use aplomb_recordings::output::check_writable;
use aplomb_recordings::quote::quote;
use aplomb_recordings::units::{BadRows, RowOptions};
use clap::{Args, Parser, Subcommand};
use virtual_board::board::{BOARDS, BoardModel};
use virtual_board::flash::SLOT_BYTES;
use virtual_board::flight::{Outcome, Run};
use virtual_board::kit::Kit;
use virtual_board::outputs;
use virtual_board::plot::Labels;
use virtual_board::port::Port;
use virtual_board::schedule::Schedule;
use virtual_board::script::Script;

use arming::Arming;
use campaign_command::Faults;
use live::Live;
use screen::Screen;

/// Default length of the simulated flight, s.
const SECONDS: f64 = 30.0;

/// The longest run, s.
const DAY_S: f64 = 86_400.0;

/// An emulated STM32F4 board with a modelled MPU-6050.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Fly a firmware image and write the results.
    Fly(Box<Fly>),
    /// Fly it many times with random faults, and check each flight.
    Faults(Faults),
}

#[derive(Args)]
struct Fly {
    /// The firmware image; `cargo xtask fly` builds it and gives it.
    #[arg(long, value_name = "PATH")]
    elf: PathBuf,
    /// Replay a recording instead of the simulated flight: CSV, plain or gzip,
    /// `t_us,ax,ay,az,gx,gy,gz[,mx,my,mz][,qw,qx,qy,qz[,mov]][,armed]`. Its compass is not
    /// replayed. Its column `armed` arms and disarms, within 20 ms, unless --commands does, or the
    /// flight is in real time.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    #[command(flatten)]
    rows: RowOptions,
    /// Mount of the sensor: forward, then down, in sensor axes, such as +x-z; or z-up, z-down.
    #[arg(long, value_name = "MOUNT", default_value = "z-up", value_parser = mount)]
    #[arg(env = "APLOMB_MOUNT", hide_env_values = true)]
    #[arg(allow_hyphen_values = true)]
    mount: Mount,
    #[arg(long, value_name = "NAME", default_value = Kit::ALL[0].0, value_parser = kit)]
    #[arg(help = format!("The sensor board: {}", kit_names()))]
    sensor: Kit,
    /// Virtual seconds from power-up. Default: 30, or the whole recording.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    seconds: Option<f64>,
    /// Seeds the flight and the sensor's errors.
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Inject faults: a file with a line `start_s duration_s fault` for each fault, or seed:N for
    /// random faults.
    #[arg(long, value_name = "FILE|seed:N")]
    faults: Option<String>,
    #[arg(long, value_name = "NAME", default_value = BOARDS[0].name, value_parser = board)]
    #[arg(help = format!("The board: {}", board_names()))]
    board: BoardModel,
    /// Send commands to the UART: a file with lines such as `2.5 status`, seconds and command.
    #[arg(long, value_name = "FILE")]
    commands: Option<PathBuf>,
    /// Keep the calibration slots in this file, which is read at the start and written at the end.
    #[arg(long, value_name = "FILE")]
    flash: Option<PathBuf>,
    /// Folder for the files.
    #[arg(long, value_name = "FOLDER", default_value = "target/fly")]
    output: PathBuf,
    /// Fly in real time, for a day by default. The UART's bytes go to standard output. Bytes from
    /// standard input go to the UART, until that ends. No files are written.
    #[arg(long, conflicts_with_all = ["output", "flash"])]
    live: bool,
    /// Like --live, with the UART at a pseudo-terminal, whose name is printed: for `aplomb view
    /// --port`, pymavlink or QGroundControl.
    #[cfg(unix)]
    #[arg(long, conflicts_with_all = ["output", "flash", "live"])]
    pty: bool,
    /// Like --live, with the UART at this TCP port, for one program at a time.
    #[arg(long, value_name = "127.0.0.1:PORT", conflicts_with_all = ["output", "flash", "live"])]
    #[cfg_attr(unix, arg(conflicts_with = "pty"))]
    tcp: Option<SocketAddr>,
}

impl Fly {
    /// Opens the port of a flight in real time; `None` for a flight that writes files.
    fn port(&self) -> Result<Option<Port>, String> {
        #[cfg(unix)]
        if self.pty {
            let opened = Port::pseudo_terminal();
            let (port, name) = opened.map_err(|error| format!("no pseudo-terminal: {error}"))?;
            eprintln!("serial port: {name}");
            return Ok(Some(port));
        }
        if let Some(address) = self.tcp {
            let opened = Port::tcp(address);
            let (port, address) =
                opened.map_err(|error| format!("cannot listen on {address}: {error}"))?;
            eprintln!("serial port: tcp:{address}");
            return Ok(Some(port));
        }
        Ok(self.live.then(Port::standard))
    }
}

fn mount(name: &str) -> Result<Mount, String> {
    Mount::parse(name).ok_or_else(|| {
        format!(
            "there is no such mount; there are z-up, z-down, {}",
            Mount::names().join(", ")
        )
    })
}

fn kit_names() -> String {
    Kit::ALL.map(|(name, _)| name).join(", ")
}

fn kit(name: &str) -> Result<Kit, String> {
    Kit::named(name)
        .ok_or_else(|| format!("there is no such sensor board; there are {}", kit_names()))
}

fn board_names() -> String {
    BOARDS.map(|board| board.name).join(", ")
}

fn board(name: &str) -> Result<BoardModel, String> {
    BoardModel::named(name)
        .ok_or_else(|| format!("there is no such board; there are {}", board_names()))
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| "this is not a number".to_owned())?;
    if seconds > 0.0 && seconds <= DAY_S {
        Ok(seconds)
    } else {
        Err("it must be above 0 and at most 86400".into())
    }
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Fly(options) => fly(&options),
        Command::Faults(options) => campaign_command::faults(&options),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

fn fly(options: &Fly) -> Result<(), String> {
    let mut run = Run::new(&options.elf)
        .board(options.board)
        .mount(options.mount)
        .kit(options.sensor)
        .seed(options.seed);
    let script = match &options.commands {
        Some(path) => Script::open(path).map_err(|error| error.to_string())?,
        None => Script::default(),
    };
    run = run.commands(&script);
    let schedule = match &options.faults {
        Some(argument) => Schedule::from_argument(argument).map_err(|error| error.to_string())?,
        None => Schedule::default(),
    };
    run = run.schedule(&schedule);
    if let Some(path) = options.flash.as_ref().filter(|path| path.exists()) {
        run = run.flash(slots(path)?);
    }
    check_rows(options)?;
    let port = options.port()?;
    let (motion, seconds);
    let mut arming = None;
    match &options.log {
        Some(path) => {
            let recording = recording(options, path)?;
            let end_s = recording.end_s();
            seconds = options.seconds.unwrap_or(end_s).min(end_s);
            let armed = Arming::of(&recording, &script, port.is_some(), seconds);
            run = armed.send(run);
            arming = Some(armed);
            run = run.recording(recording.with_noise(options.seed));
            let name = path.file_name().unwrap_or(path.as_os_str());
            motion = format!("recording {}", name.display());
        }
        None => {
            let usual = if port.is_some() { DAY_S } else { SECONDS };
            seconds = options.seconds.unwrap_or(usual);
            motion = format!("simulated flight, seed {}", options.seed);
        }
    }
    check_ends(options, &script, &schedule, seconds)?;
    run = run.seconds(seconds);
    if let Some(port) = port {
        let run = run.without_account().observer(Live::new(port)).run();
        return run.map(|_| ()).map_err(|error| error.to_string());
    }
    eprintln!("{motion}, on {}", options.board.name);
    for fault in &schedule.faults {
        eprintln!("fault: {fault}");
    }
    let outcome = run
        .observer(Screen::new())
        .run()
        .map_err(|error| error.to_string())?;
    let labels = Labels {
        title: format!("aplomb on the virtual {}: {motion}", options.board.name),
        subtitle: subtitle(&outcome),
    };
    outputs::write(&options.output, &outcome, &labels).map_err(|error| error.to_string())?;
    if let Some(path) = &options.flash {
        check_writable(path)
            .and_then(|()| fs::write(path, &outcome.flash.bytes))
            .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    }
    println!("\n{}", table(&outcome));
    println!("written to {}", options.output.display());
    let ignored = arming.and_then(|arming| arming.check(outcome.samples()));
    for issue in outcome.issues.iter().chain(&ignored) {
        eprintln!("warning: {issue}");
    }
    if outcome.samples().is_empty() {
        return Err("the firmware published no attitude".into());
    }
    if !outcome.violations.is_empty() {
        return Err("the firmware accessed registers wrongly: see the warnings above".into());
    }
    Ok(())
}

/// Reads the recording to fly.
fn recording(options: &Fly, path: &Path) -> Result<Recording, String> {
    let recording = Recording::open_with(path, options.mount, options.rows)
        .map_err(|error| error.to_string())?;
    if recording.end_s() > DAY_S && options.seconds.is_none() {
        return Err(format!(
            "{}: it lasts {:.1} hours: choose the length with --seconds, 86400 at most",
            path.display(),
            recording.end_s() / 3_600.0
        ));
    }
    Ok(recording)
}

/// Reads the calibration slots.
fn slots(path: &Path) -> Result<Vec<u8>, String> {
    let bytes = File::open(path).and_then(|file| {
        let mut bytes = Vec::new();
        // One byte more shows that a file is too long, however long it is.
        file.take(2 * SLOT_BYTES as u64 + 1)
            .read_to_end(&mut bytes)?;
        Ok(bytes)
    });
    let bytes = bytes.map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    if bytes.len() == 2 * SLOT_BYTES {
        return Ok(bytes);
    }
    Err(format!(
        "{} has not {} bytes, as two calibration slots have",
        path.display(),
        2 * SLOT_BYTES
    ))
}

/// Refuses commands and faults of a file that come after the end of the flight.
fn check_ends(
    options: &Fly,
    script: &Script,
    schedule: &Schedule,
    seconds: f64,
) -> Result<(), String> {
    let commands = script
        .lines()
        .iter()
        .map(|(at_s, line)| (*at_s, line.clone()));
    let faults = schedule.faults.iter();
    let faults = faults.map(|fault| (fault.start_ns as f64 * 1e-9, fault.kind.to_string()));
    // Faults by chance are drawn for 30 s, whatever is flown.
    let by_chance = options
        .faults
        .as_deref()
        .is_some_and(|name| name.starts_with("seed:"));
    let late = commands
        .chain(faults.filter(|_| !by_chance))
        .find(|(at_s, _)| *at_s >= seconds);
    match late {
        Some((at_s, entry)) => Err(format!(
            "`{}` at {at_s} s comes after the end of the flight, {seconds} s: \
             fly longer with --seconds, or remove it",
            quote(&entry)
        )),
        None => Ok(()),
    }
}

/// Refuses options for a recording's rows that would change nothing.
fn check_rows(options: &Fly) -> Result<(), String> {
    let given = options.rows.given();
    let unused = given
        .iter()
        .find(|(_, is_given)| *is_given && options.log.is_none());
    if let Some((name, _)) = unused {
        return Err(format!("{name} is for a recording: add --log FILE"));
    }
    if options.rows.bad_rows == Some(BadRows::Keep) {
        return Err(
            "a sensor cannot move by bad rows: --bad-rows takes refuse or skip here".into(),
        );
    }
    Ok(())
}

/// The picture's second line.
fn subtitle(outcome: &Outcome) -> String {
    let summary = &outcome.summary;
    let mut text = format!(
        "{} samples in {:.1} s, {} missed",
        summary.samples, summary.virtual_seconds, summary.missed
    );
    if let (Some(rms), Some(max)) = (summary.inclination_rms_deg, summary.inclination_max_deg) {
        write!(
            text,
            "; inclination error {rms:.2} degrees rms, {max:.2} at most"
        )
        .ok();
    }
    text
}

/// The figures as a short table.
fn table(outcome: &Outcome) -> String {
    let summary = &outcome.summary;
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or("-".into(), |value| format!("{value:.decimals$}"))
    };
    let count = |value: Option<u64>| value.map_or("-".into(), |value| value.to_string());
    let flags = summary.flags.iter();
    let flags: Vec<String> = flags
        .map(|(name, count)| format!("{name} {count}"))
        .collect();
    let rows = [
        (
            "samples, missed",
            format!("{}, {}", summary.samples, summary.missed),
        ),
        (
            "time",
            format!(
                "{:.1} s flown in {:.1} s, {:.1} times real time",
                summary.virtual_seconds,
                summary.wall_seconds,
                summary.virtual_seconds / summary.wall_seconds
            ),
        ),
        (
            "instructions per sample",
            format!(
                "{} mean, {} at most; without the attitude task {} mean",
                number(summary.instructions_per_sample_mean, 0),
                count(summary.instructions_per_sample_max),
                number(summary.io_instructions_per_sample_mean, 0)
            ),
        ),
        (
            "cycles on a chip",
            format!(
                "{} per sample and {} us from edge to attitude at most, by estimate",
                number(summary.cycles_per_sample_estimate, 0),
                number(summary.edge_to_attitude_us_estimate, 0)
            ),
        ),
        (
            "load of the core",
            format!("{} %", number(summary.cpu_load_percent, 2)),
        ),
        (
            "edge to attitude",
            format!(
                "{} us mean, {} us at most",
                number(summary.edge_to_attitude_us_mean, 1),
                number(summary.edge_to_attitude_us_max, 1)
            ),
        ),
        (
            "time stamp error",
            format!("{} us at most", number(summary.timestamp_error_us_max, 2)),
        ),
        (
            "inclination error",
            format!(
                "{} degrees rms, {} at most (mov 1, not CALIBRATING)",
                number(summary.inclination_rms_deg, 2),
                number(summary.inclination_max_deg, 2)
            ),
        ),
        ("attitudes with flags", flags.join(", ")),
        (
            "memory",
            format!(
                "{} bytes of flash, {} of RAM, {} of stack used",
                summary.flash_bytes, summary.ram_bytes, summary.stack_bytes_used
            ),
        ),
    ];
    rows.iter().fold(String::new(), |mut table, (name, value)| {
        writeln!(table, "{name:<24} {value}").ok();
        table
    })
}
