//! `aplomb record`: what a module sends, byte for byte, in a file.

use std::error::Error;
use std::fs::{File, OpenOptions};
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::view::{BAUD, Decoder, Item, LOG_BAUD, Link, Report, which_port};

/// How long the module may take to answer a command.
const ANSWER: Duration = Duration::from_secs(2);

/// Record what the module sends, byte for byte.
///
/// Every byte is in the file as soon as it has come, so that Ctrl-C loses nothing. A port that is unplugged is waited for,
/// and what comes then is appended. The bytes can be played by `aplomb view`; a flight log also by `aplomb replay`.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb record --port /dev/ttyUSB0 --output flight.log --log
  aplomb record --port /dev/ttyUSB0 --output text.uart --seconds 60

Exit code: 0 if attitudes or bursts were recorded, 1 if not.")]
pub struct Options {
    /// The module's serial port; without one the ports of this computer are listed
    #[arg(long)]
    port: Option<String>,
    /// The module's baud rate
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// The file to write
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// End after so many seconds. Default: with Ctrl-C
    #[arg(long)]
    seconds: Option<f64>,
    /// Have the module send its flight log at 921,600 baud, and what it sent before when the recording ends
    #[arg(long)]
    log: bool,
    /// Replace the file if it is there
    #[arg(long)]
    force: bool,
}

/// Does it.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let Some(port) = &options.port else {
        return Err(which_port().into());
    };
    if options
        .seconds
        .is_some_and(|seconds| seconds.is_nan() || seconds <= 0.0)
    {
        return Err("--seconds has to be above 0".into());
    }
    // Whoever has two files of one name does not want to learn it after the flight.
    if options.output.exists() && !options.force {
        return Err(exists(&options.output).into());
    }
    let ends = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&ends);
    ctrlc::set_handler(move || told.store(true, Ordering::Relaxed))?;
    let link = Link::port(port, options.baud)?;
    let before = if options.log {
        Some(start_log(&link, options.baud)?)
    } else {
        None
    };
    let mut recorder = Recorder {
        file: create(&options.output, options.force)?,
        path: &options.output,
        decoder: Decoder::default(),
        bytes: 0,
        gaps: 0,
        is_away: false,
        started: Instant::now(),
    };
    let result = recorder.run(&link, options.seconds, &ends);
    if let Some(format) = before {
        link.say(&format!("format {format}"));
        link.switch_baud(options.baud);
        // The module keeps a rate at which it has understood something.
        link.say("status");
    }
    drop(link);
    result?;
    eprintln!("{}", recorder.summary());
    let counts = recorder.decoder.counts();
    if counts.readings + counts.bursts == 0 {
        return Err(format!(
            "nothing of it could be read at {} baud: was that the rate? The bytes are in {}",
            options.baud,
            options.output.display()
        )
        .into());
    }
    Ok(())
}

fn exists(path: &Path) -> String {
    format!(
        "{} is there already: choose another name, or --force to replace it",
        path.display()
    )
}

fn create(path: &Path, may_replace: bool) -> Result<File, String> {
    let mut options = OpenOptions::new();
    options.write(true);
    if may_replace {
        options.create(true).truncate(true);
    } else {
        options.create_new(true);
    }
    options.open(path).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => exists(path),
        _ => format!("{}: cannot be written: {error}", path.display()),
    })
}

/// Has the module send its flight log, and says which format it sent before.
fn start_log(link: &Link, baud: u32) -> Result<String, String> {
    let mut decoder = Decoder::default();
    link.say("show");
    let shown = answer(link, &mut decoder, "show:").ok_or_else(|| {
        format!("the module does not answer at {baud} baud: is it aplomb, and is that its rate?")
    })?;
    let format = shown
        .split(' ')
        .find_map(|field| field.strip_prefix("format="))
        .unwrap_or("text")
        .to_owned();
    if baud != LOG_BAUD {
        link.switch_baud(LOG_BAUD);
    }
    link.say("format log");
    match answer(link, &mut decoder, "log") {
        Some(_) => Ok(format),
        None => {
            // The module goes back by itself, since it has understood nothing at the new rate.
            Err(format!(
                "the module did not confirm `format log` at {LOG_BAUD} baud: does the adapter carry that?"
            ))
        }
    }
}

/// The answer that begins so.
fn answer(link: &Link, decoder: &mut Decoder, start: &str) -> Option<String> {
    let asked = Instant::now();
    while asked.elapsed() < ANSWER {
        let Some(Report::Bytes(bytes)) = link.next(Duration::from_millis(50)) else {
            continue;
        };
        let mut items = Vec::new();
        decoder.push(&bytes, &mut items);
        for item in items {
            if let Item::Message(text) = item
                && let Some(answer) = text.strip_prefix("ok ")
                && answer.starts_with(start)
            {
                return Some(answer.to_owned());
            }
        }
    }
    None
}

/// What is written, and what it is.
struct Recorder<'a> {
    file: File,
    path: &'a Path,
    decoder: Decoder,
    bytes: u64,
    gaps: u32,
    is_away: bool,
    started: Instant,
}

impl Recorder<'_> {
    fn run(&mut self, link: &Link, seconds: Option<f64>, ends: &AtomicBool) -> Result<(), String> {
        let is_terminal = io::stderr().is_terminal();
        let period = Duration::from_millis(if is_terminal { 200 } else { 10_000 });
        let mut told = Instant::now();
        let failed = |error: io::Error| format!("cannot be written any more: {error}");
        loop {
            let elapsed_s = self.started.elapsed().as_secs_f64();
            if ends.load(Ordering::Relaxed) || seconds.is_some_and(|seconds| elapsed_s >= seconds) {
                break;
            }
            match link.next(Duration::from_millis(50)) {
                Some(Report::Bytes(bytes)) => {
                    // Without a buffer of our own: what is written survives this program.
                    self.file
                        .write_all(&bytes)
                        .map_err(|error| format!("{}: {}", self.path.display(), failed(error)))?;
                    self.bytes += bytes.len() as u64;
                    self.decoder.push(&bytes, &mut Vec::new());
                }
                Some(Report::Away(reason)) => {
                    self.decoder.interrupt();
                    self.gaps += 1;
                    self.is_away = true;
                    eprintln!("\nthe port is gone ({reason}): waiting for it");
                }
                Some(Report::Back) => {
                    self.is_away = false;
                    eprintln!("the port is back");
                }
                Some(Report::Ended(reason)) => return Err(reason),
                None => {}
            }
            if told.elapsed() >= period && !self.is_away {
                told = Instant::now();
                if is_terminal {
                    eprint!("\r\x1b[K{}", self.summary());
                    io::stderr().flush().ok();
                } else {
                    eprintln!("{}", self.summary());
                }
            }
        }
        if is_terminal {
            eprint!("\r\x1b[K");
        }
        self.file
            .sync_all()
            .map_err(|error| format!("{}: {}", self.path.display(), failed(error)))
    }

    /// What has come.
    fn summary(&self) -> String {
        use std::fmt::Write as _;
        let counts = self.decoder.counts();
        let mut text = format!(
            "{:.1} s, {} bytes",
            self.started.elapsed().as_secs_f64(),
            self.bytes
        );
        if let Some(format) = self.decoder.format() {
            write!(text, " of {}: {} attitudes", format.name(), counts.readings).ok();
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
