//! `aplomb view`: the module's attitude and health on a terminal, as they come.

mod detect;
mod dots;
mod horizon;
mod keys;
mod model;
mod picture;
mod player;
mod screen;
mod source;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::error::Error;
use std::fs::File;
use std::io::{self, IsTerminal, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use aplomb::console::command::{self, BAUD_RATES};
use aplomb::settings::OutputFormat;
use ratatui::DefaultTerminal;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{self, Event, KeyEventKind};
use ratatui::layout::Rect;

pub use detect::{Decoder, Format, Item};
use keys::Action;
use model::{Connection, Model, Speaker};
use player::Player;
pub use source::{BAUD, Link, Report, which_port};

use crate::output::OutputFile;

/// Drawn so often at most: 30 times a second.
const FRAME: Duration = Duration::from_millis(33);

/// Drawn so often at least, since times pass even if nothing comes.
const SLOWEST_FRAME: Duration = Duration::from_millis(500);

/// The module is asked for its status so often: 400 bytes every two seconds, 2 % of the line at 115,200 baud.
const STATUS_PERIOD: Duration = Duration::from_secs(2);

/// If bytes come for so long and nothing can be read, the next baud rate is tried.
const BAUD_PATIENCE: Duration = Duration::from_secs(2);

/// Fewer bytes than these may be noise.
const BAUD_BYTES: usize = 100;

/// What the flight log takes.
pub const LOG_BAUD: u32 = 921_600;

/// A recording can be played so many times as fast.
const SPEEDS: RangeInclusive<f64> = 0.01..=1000.0;

/// The picture's size in letters.
const PICTURE: Rect = Rect::new(0, 0, 110, 32);

/// Watch the attitude live: horizon, angles and rates over time, health, messages.
///
/// Shows a module on a serial port, the virtual board, or a recording: a flight log, what the module sent in any format, or an
/// attitude CSV. The format is found out, and the baud rate too. A port that is unplugged is waited for.
///
/// Keys command the module (`?` lists them): calibrate, save, change the format, record to a file. Health and σ are complete in
/// the format `log`; in the others σ and the temperature are asked for every two seconds.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb view --port /dev/ttyUSB0
  aplomb view flight.log --speed 4
  aplomb view target/fly/attitude.csv
  cargo xtask view                        (builds the virtual board and shows it: no hardware needed)")]
pub struct Options {
    /// A recording to play
    #[arg(conflicts_with_all = ["port", "virtual_board"])]
    file: Option<PathBuf>,
    /// The module's serial port; without a port the ports of this computer are listed
    #[arg(long)]
    port: Option<String>,
    /// The module's baud rate. Default: found out, from 115200 on
    #[arg(long, requires = "port")]
    baud: Option<u32>,
    /// Show the firmware on the virtual board, in a simulated flight
    #[arg(long = "virtual", conflicts_with = "port")]
    virtual_board: bool,
    /// The firmware image for the virtual board. Default: the one that `cargo xtask view` builds
    #[arg(long, value_name = "FILE", requires = "virtual_board")]
    elf: Option<PathBuf>,
    /// Play a recording so many times as fast
    #[arg(long, value_name = "TIMES", default_value_t = 1.0, value_parser = parse_speed)]
    speed: f64,
    /// Draw the screen of a recording as a PNG file instead
    #[arg(long, value_name = "FILE", requires = "file")]
    picture: Option<PathBuf>,
    /// The time that the picture shows, in seconds from the recording's beginning
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 10.0,
        requires = "picture",
        allow_negative_numbers = true,
        value_parser = parse_time
    )]
    at: f64,
}

fn parse_speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok();
    let (least, most) = (SPEEDS.start(), SPEEDS.end());
    speed
        .filter(|speed| SPEEDS.contains(speed))
        .ok_or_else(|| format!("it has to be a number from {least} to {most}"))
}

/// A speed after a key: never beyond what can be chosen.
fn changed_speed(speed: f64, factor: f64) -> f64 {
    (speed * factor).clamp(*SPEEDS.start(), *SPEEDS.end())
}

fn parse_time(text: &str) -> Result<f64, &'static str> {
    let time = text.parse().ok();
    time.filter(|time: &f64| time.is_finite() && *time >= 0.0)
        .ok_or("it has to be a number of seconds, 0 or more")
}

/// Set when the program is asked to end: by Ctrl-C, by `kill`, or since its terminal is gone. To be called once.
pub fn end_request() -> Result<Arc<AtomicBool>, ctrlc::Error> {
    let is_asked = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&is_asked);
    ctrlc::set_handler(move || told.store(true, Ordering::Relaxed))?;
    Ok(is_asked)
}

/// Does it.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    if let (Some(file), Some(picture)) = (&options.file, &options.picture) {
        return draw_picture(file, options.at, picture);
    }
    if options.file.is_none() && options.port.is_none() && !options.virtual_board {
        let hint = "Without a board: `cargo xtask view` shows the virtual one";
        return Err(format!("{}\n{hint}", which_port()).into());
    }
    if !io::stdout().is_terminal() || !io::stdin().is_terminal() {
        let instead = match &options.file {
            Some(_) => "`--picture FILE.png` draws its screen of a recording",
            None => "`aplomb record` writes what comes to a file",
        };
        return Err(format!("`view` needs a terminal; {instead}").into());
    }
    let ends = end_request()?;
    let mut app = App::new(options)?;
    // This also restores the terminal before a panic is told.
    let mut terminal = ratatui::try_init()?;
    let result = app.run(&mut terminal, &ends);
    ratatui::restore();
    result
}

/// What comes from the keyboard, by a thread: its library does not return from a terminal that is gone.
fn keyboard() -> Receiver<io::Result<Event>> {
    let (sender, events) = channel();
    std::thread::spawn(move || {
        loop {
            let event = event::read();
            let is_last = event.is_err();
            if sender.send(event).is_err() || is_last {
                return;
            }
        }
    });
    events
}

/// The program while it runs.
struct App {
    input: Input,
    model: Model,
    /// The screen as it was when it was paused.
    held: Option<Model>,
    started: Instant,
    recording: Option<File>,
}

enum Input {
    Live(Live),
    Recorded { player: Player, told: Instant },
}

/// A module that answers.
struct Live {
    link: Link,
    decoder: Decoder,
    /// The line's rate, if there is a line.
    baud: Option<u32>,
    /// The rate that the module had before a key changed it, and is brought back to.
    first_baud: Option<u32>,
    /// The rate that a key has changed it to: after a return of the port it may be either.
    switched_baud: Option<u32>,
    /// What a change of the rate is for, while it is not answered.
    switching: Option<Switching>,
    /// Whether other rates may be tried.
    searches_baud: bool,
    /// When bytes began to come that could not be read, and how many did.
    unread: Option<(Instant, usize)>,
    /// What the module sent at first, to bring it back in the end.
    first_format: Option<OutputFormat>,
    /// Whether the flight log is to be asked for as soon as the module speaks.
    wants_log: bool,
    asked: Instant,
}

/// What the module is to change its rate for.
enum Switching {
    /// The flight log.
    Log,
    /// A person said so.
    Person,
}

impl App {
    fn new(options: &Options) -> Result<Self, String> {
        let (name, connection, input) = if let Some(file) = &options.file {
            let connection = Connection::Playing {
                speed: options.speed,
                is_over: false,
            };
            let player = Player::open(file)?;
            let told = Instant::now();
            (
                file.display().to_string(),
                connection,
                Input::Recorded { player, told },
            )
        } else if options.virtual_board {
            let link = Link::process(virtual_board(options.elf.as_deref())?)?;
            let mut live = Live::new(link, None);
            live.wants_log = true;
            let name = "virtual board".to_owned();
            (name, Connection::Open(None), Input::Live(live))
        } else {
            let port = options.port.clone().unwrap_or_default();
            let baud = options.baud.unwrap_or(BAUD);
            let mut live = Live::new(Link::port(&port, baud)?, Some(baud));
            live.searches_baud = options.baud.is_none();
            (port, Connection::Open(Some(baud)), Input::Live(live))
        };
        Ok(Self {
            input,
            model: Model::new(name, connection),
            held: None,
            started: Instant::now(),
            recording: None,
        })
    }

    fn run(
        &mut self,
        terminal: &mut DefaultTerminal,
        ends: &AtomicBool,
    ) -> Result<(), Box<dyn Error>> {
        let keyboard = keyboard();
        let mut woken = Instant::now();
        let mut drawn: Option<Instant> = None;
        while !ends.load(Ordering::Relaxed) {
            let mut has_changed = false;
            let mut wait = FRAME.saturating_sub(woken.elapsed());
            loop {
                match keyboard.recv_timeout(wait) {
                    Ok(event) => match self.hear(&event?) {
                        Some(Action::Quit) => return Ok(()),
                        Some(action) => self.act(action),
                        None => {}
                    },
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return Ok(()),
                }
                has_changed = true;
                wait = Duration::ZERO;
            }
            woken = Instant::now();
            has_changed |= self.follow();
            if let Connection::Ended(reason) = &self.model.connection
                && self.model.counts.readings == 0
            {
                let reason = reason.trim_start_matches("error: ");
                return Err(format!("no attitude has come: {reason}").into());
            }
            let is_due = drawn.is_none_or(|drawn| drawn.elapsed() >= SLOWEST_FRAME);
            if has_changed || is_due {
                let shown = self.shown();
                terminal.draw(|frame| screen::draw(&shown, frame.area(), frame.buffer_mut()))?;
                drawn = Some(Instant::now());
            }
        }
        Ok(())
    }

    /// What a key asks for.
    fn hear(&self, event: &Event) -> Option<Action> {
        match event {
            Event::Key(key) if key.kind != KeyEventKind::Release => keys::action(*key, &self.model),
            _ => None,
        }
    }

    /// What is on the screen: the present, or what was held.
    fn shown(&self) -> Cow<'_, Model> {
        match &self.held {
            None => Cow::Borrowed(&self.model),
            Some(held) => Cow::Owned(held.held_beside(&self.model)),
        }
    }

    /// Takes in what has come; whether anything has.
    fn follow(&mut self) -> bool {
        let now_s = self.started.elapsed().as_secs_f64();
        match &mut self.input {
            Input::Live(live) => {
                let (model, recording) = (&mut self.model, &mut self.recording);
                let has_changed = live.follow(now_s, model, recording);
                model.tick(now_s, live.decoder.format(), live.decoder.counts());
                has_changed
            }
            Input::Recorded { player, told } => {
                let Connection::Playing { speed, is_over } = &mut self.model.connection else {
                    return false;
                };
                let elapsed_s = told.elapsed().as_secs_f64();
                *told = Instant::now();
                if self.model.is_paused || *is_over {
                    return false;
                }
                let items = player.advance(elapsed_s * *speed);
                *is_over = player.is_over();
                let error = player.take_error();
                for (at_s, item) in items {
                    self.model.take(at_s, item);
                }
                let (position_s, counts) = (player.position_s(), player.counts());
                if let Some(error) = error {
                    self.model.say(position_s, Speaker::Program, error);
                }
                self.model.tick(position_s, player.format(), counts);
                true
            }
        }
    }

    fn act(&mut self, action: Action) {
        let model = &mut self.model;
        match action {
            Action::Pause => match (&self.input, self.held.take()) {
                (Input::Live(_), None) => self.held = Some(model.clone()),
                (Input::Live(_), Some(_)) => {}
                (Input::Recorded { .. }, _) => model.is_paused = !model.is_paused,
            },
            Action::Help => model.shows_help = !model.shows_help,
            Action::Type(typed) => model.typed = typed,
            Action::Faster(factor) => {
                if let Connection::Playing { speed, .. } = &mut model.connection {
                    *speed = changed_speed(*speed, factor);
                }
            }
            Action::Say(line) => {
                model.typed = None;
                if let Input::Live(live) = &mut self.input {
                    live.say(&line, model);
                }
            }
            Action::SetFormat(format) => {
                if let Input::Live(live) = &mut self.input {
                    live.set_format(format, model);
                }
            }
            Action::Record => self.toggle_recording(),
            Action::Quit => {}
        }
    }

    fn toggle_recording(&mut self) {
        let model = &mut self.model;
        let now_s = model.now_s;
        if self.recording.take().is_some() {
            if let Some((name, bytes)) = model.recording.take() {
                let text = format!("recorded {bytes} bytes to {name}");
                model.say(now_s, Speaker::Program, text);
            }
            return;
        }
        let is_log = model.format == Some(Format::Module(OutputFormat::Log));
        match new_file(if is_log { "log" } else { "uart" }) {
            Ok((name, file)) => {
                self.recording = Some(file);
                model.recording = Some((name, 0));
            }
            Err(error) => {
                let text = format!("no file can be made here: {error}");
                model.say(now_s, Speaker::Program, text);
            }
        }
    }
}

impl Drop for App {
    /// Brings the module back to how it was, as far as the line is concerned: however the program ends.
    fn drop(&mut self) {
        if let Some((name, bytes)) = &self.model.recording {
            eprintln!("recorded {bytes} bytes to {name}");
        }
        if let Input::Live(live) = &self.input
            && (live.baud != live.first_baud || live.switching.is_some())
            && let (Some(baud), Some(format)) = (live.first_baud, live.first_format)
            && let Err(error) = live.link.bring_back(format.name(), baud)
        {
            eprintln!("error: {error}");
        }
    }
}

impl Live {
    fn new(link: Link, baud: Option<u32>) -> Self {
        Self {
            link,
            decoder: Decoder::default(),
            baud,
            first_baud: baud,
            switched_baud: None,
            switching: None,
            searches_baud: false,
            unread: None,
            first_format: None,
            wants_log: false,
            asked: Instant::now(),
        }
    }

    fn follow(&mut self, now_s: f64, model: &mut Model, recording: &mut Option<File>) -> bool {
        let mut has_changed = false;
        while let Some(report) = self.link.next(Duration::ZERO) {
            has_changed = true;
            match report {
                Report::Bytes(bytes) => self.take(&bytes, now_s, model, recording),
                Report::Away(reason) => {
                    self.decoder.interrupt();
                    self.switching = None;
                    // The module keeps the rate that it has stored, and starts with that after a loss of power.
                    if let Some(baud) = self.first_baud {
                        self.link.set_baud(baud);
                    }
                    let text = format!("{} is gone ({reason}): waiting for it", model.name);
                    model.say(now_s, Speaker::Program, text);
                    model.connection = Connection::Away(reason);
                    model.quiet_answers = 0;
                }
                Report::Back => {
                    model.say(now_s, Speaker::Program, format!("{} is back", model.name));
                    self.baud = self.first_baud;
                    self.unread = None;
                    model.connection = Connection::Open(self.baud);
                }
                Report::Ended(reason) => {
                    model.say(now_s, Speaker::Program, reason.clone());
                    model.connection = Connection::Ended(reason);
                }
                Report::Switched(result) => self.switched(result, model),
            }
        }
        let is_open = model.takes_commands();
        let is_fresh = model.reading().is_some();
        if is_open && is_fresh {
            if std::mem::take(&mut self.wants_log) {
                self.set_format(OutputFormat::Log, model);
            }
            if self.asked.elapsed() >= STATUS_PERIOD {
                self.asked = Instant::now();
                model.quiet_answers = 1;
                self.link.say("status");
            }
        }
        has_changed
    }

    fn take(&mut self, bytes: &[u8], now_s: f64, model: &mut Model, recording: &mut Option<File>) {
        if let (Some(file), Some((name, count))) = (recording.as_mut(), &mut model.recording) {
            match file.write_all(bytes) {
                Ok(()) => *count += bytes.len() as u64,
                Err(error) => {
                    let text = format!("{name} cannot be written any more: {error}");
                    *recording = None;
                    model.recording = None;
                    model.say(now_s, Speaker::Program, text);
                }
            }
        }
        let mut items = Vec::new();
        self.decoder.push(bytes, &mut items);
        if items.is_empty() {
            self.search_baud(bytes.len(), now_s, model);
        } else {
            self.unread = None;
        }
        for item in items {
            model.take(now_s, item);
        }
        if let Some(Format::Module(format)) = self.decoder.format() {
            self.first_format.get_or_insert(format);
        }
    }

    /// Tries the next rate if too much has come that cannot be read.
    fn search_baud(&mut self, length: usize, now_s: f64, model: &mut Model) {
        let (since, count) = self.unread.get_or_insert((Instant::now(), 0));
        *count += length;
        let Some(baud) = self.baud else { return };
        if since.elapsed() < BAUD_PATIENCE || *count < BAUD_BYTES {
            return;
        }
        self.unread = None;
        let next = match self.switched_baud {
            Some(switched) if switched != baud => switched,
            Some(_) => {
                self.switched_baud = None;
                self.first_baud.unwrap_or(BAUD)
            }
            None if self.searches_baud => {
                let next = next_baud(baud);
                self.first_baud = Some(next);
                next
            }
            None => {
                let text = format!("what comes cannot be read at {baud} baud: is --baud right?");
                return model.say(now_s, Speaker::Program, text);
            }
        };
        self.baud = Some(next);
        model.connection = Connection::Open(Some(next));
        let text = format!("what comes cannot be read at {baud} baud: trying {next}");
        model.say(now_s, Speaker::Program, text);
        self.link.set_baud(next);
    }

    /// The module has changed its rate, or not.
    fn switched(&mut self, result: Result<u32, String>, model: &mut Model) {
        let Some(purpose) = self.switching.take() else {
            return;
        };
        match result {
            Err(reason) => {
                let stays = match self.baud {
                    Some(baud) => format!("it stays at {baud} baud"),
                    None => "it stays as it is".into(),
                };
                model.say(model.now_s, Speaker::Program, format!("{stays}: {reason}"));
            }
            Ok(baud) => {
                if self.baud.is_some() {
                    self.baud = Some(baud);
                    model.connection = Connection::Open(self.baud);
                }
                match purpose {
                    Switching::Log => {
                        self.switched_baud = self.baud;
                        self.say(&format!("format {}", OutputFormat::Log.name()), model);
                    }
                    Switching::Person => {
                        // It is to stay like this.
                        self.first_baud = self.baud;
                        self.switched_baud = None;
                        // The module keeps a rate at which it has understood something.
                        model.quiet_answers = 1;
                        self.link.say("status");
                    }
                }
            }
        }
    }

    fn say(&mut self, line: &str, model: &mut Model) {
        if !model.takes_commands() {
            let text = format!("not said, since nobody is there: {line}");
            return model.say(model.now_s, Speaker::Program, text);
        }
        model.say(model.now_s, Speaker::Person, line.to_owned());
        // The answer to a person's question is shown.
        if line == "status" {
            model.quiet_answers = 0;
        }
        match line.parse() {
            Ok(command::Command::Baud(baud)) => {
                self.switching = Some(Switching::Person);
                self.link.switch_baud(baud);
            }
            _ => self.link.say(line),
        }
    }

    fn set_format(&mut self, format: OutputFormat, model: &mut Model) {
        let is_fast = self.baud == Some(LOG_BAUD);
        if format == OutputFormat::Log && !is_fast && model.takes_commands() {
            model.say(model.now_s, Speaker::Person, format!("baud {LOG_BAUD}"));
            self.switching = Some(Switching::Log);
            self.link.switch_baud(LOG_BAUD);
        } else {
            self.say(&format!("format {}", format.name()), model);
        }
    }
}

/// The rate to try after this one: the usual two first, then down.
fn next_baud(baud: u32) -> u32 {
    if baud == BAUD {
        return LOG_BAUD;
    }
    let slower = BAUD_RATES
        .iter()
        .rev()
        .find(|rate| **rate < baud && **rate != BAUD);
    slower.copied().unwrap_or(BAUD)
}

/// A file that was not there, with a number in its name.
fn new_file(ending: &str) -> io::Result<(String, File)> {
    for number in 1.. {
        let name = format!("aplomb-{number}.{ending}");
        match File::create_new(&name) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            result => return result.map(|file| (name, file)),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// The virtual board beside this program, with the firmware that `cargo xtask view` builds.
fn virtual_board(elf: Option<&Path>) -> Result<Command, String> {
    const ADVICE: &str = "`cargo xtask view` builds what is needed and comes here";
    let own = std::env::current_exe().map_err(|error| format!("{error}: {ADVICE}"))?;
    let folder = own.parent().unwrap_or(Path::new("."));
    let program = folder.join(format!("virtual-board{}", std::env::consts::EXE_SUFFIX));
    let elf = match elf {
        Some(elf) => elf.to_owned(),
        None => folder.join("../firmware/flight-stm32f405-default.elf"),
    };
    for file in [&program, &elf] {
        if !file.is_file() {
            return Err(format!("{} is not there: {ADVICE}", file.display()));
        }
    }
    let mut command = Command::new(program);
    command.args(["fly", "--live", "--elf"]).arg(elf);
    Ok(command)
}

fn draw_picture(file: &Path, at_s: f64, picture: &Path) -> Result<(), Box<dyn Error>> {
    if picture.extension().is_none_or(|ending| ending != "png") {
        let picture = picture.display();
        return Err(
            format!("{picture}: the name has to end with .png, which is what is drawn").into(),
        );
    }
    let mut player = Player::open(file)?;
    let name = file.file_name().unwrap_or_default().display().to_string();
    let connection = Connection::Playing {
        speed: 1.0,
        is_over: false,
    };
    let mut model = Model::new(name, connection);
    // In steps as on the screen, so that rates are counted as there.
    while player.position_s() < at_s && !player.is_over() {
        let step_s = FRAME.as_secs_f64().min(at_s - player.position_s());
        for (at_s, item) in player.advance(step_s) {
            model.take(at_s, item);
        }
        model.tick(player.position_s(), player.format(), player.counts());
        if let Some(error) = player.take_error() {
            eprintln!("{error}");
            model.say(player.position_s(), Speaker::Program, error);
        }
    }
    let mut buffer = Buffer::empty(PICTURE);
    screen::draw(&model, PICTURE, &mut buffer);
    OutputFile::write(picture, &[file], &picture::picture(&buffer).png())?;
    crate::say(&format!(
        "{}: the screen at {:.1} s",
        picture.display(),
        player.position_s()
    ));
    Ok(())
}
