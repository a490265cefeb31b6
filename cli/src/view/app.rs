//! Program loop of `view`: keys, the source, and the screen.

use std::borrow::Cow;
use std::error::Error;
use std::fs::File;
use std::io;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use aplomb::settings::OutputFormat;
use aplomb_recordings::terminal::print_message;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyEventKind};

use super::keys::{self, Action};
use super::live::Live;
use super::model::{Connection, Model, Speaker};
use super::player::{Player, changed_speed};
use super::screen;
use crate::i2c::I2cOptions;
use crate::link::{BAUD, Link};
use crate::stream::Format;

/// Shortest time between two drawings: 30 a second.
pub const FRAME: Duration = Duration::from_millis(33);

/// Longest time between two drawings, because ages change without input.
const SLOWEST_FRAME: Duration = Duration::from_millis(500);

/// Source of a view.
pub enum Origin {
    /// A recording, at a multiple of its speed.
    File(PathBuf, f64),
    /// A serial port, with a baud rate if it is known.
    Port(String, Option<u32>),
    /// The virtual board, by the command that starts it.
    VirtualBoard(Command),
    /// A sensor on a bus of this computer.
    Sensor(I2cOptions),
}

/// Returns the events of the keyboard. A thread reads them, because the library does not return
/// from a terminal that is gone.
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

/// Running program.
pub struct App {
    input: Input,
    model: Model,
    /// Screen at the pause.
    held: Option<Model>,
    started: Instant,
    recording: Option<File>,
}

enum Input {
    Live(Live),
    Recorded { player: Player, advanced: Instant },
}

impl App {
    /// Opens the source.
    pub fn new(origin: Origin) -> Result<Self, String> {
        let (name, connection, input) = match origin {
            Origin::File(file, speed) => {
                let is_over = false;
                let player = Player::open(&file)?;
                let advanced = Instant::now();
                (
                    file.display().to_string(),
                    Connection::Playing { speed, is_over },
                    Input::Recorded { player, advanced },
                )
            }
            Origin::VirtualBoard(command) => {
                let live = Live::new(Link::process(command)?, None).with_log();
                let name = "virtual board".to_owned();
                (name, Connection::Open(None), Input::Live(live))
            }
            Origin::Sensor(options) => {
                let live = Live::new(Link::sensor(options.open()?.0), None);
                let name = options.i2c.unwrap_or_default().display().to_string();
                (name, Connection::Open(None), Input::Live(live))
            }
            Origin::Port(port, known_baud) => {
                let baud = known_baud.unwrap_or(BAUD);
                let mut live = Live::new(Link::port(&port, baud)?, Some(baud));
                if known_baud.is_none() {
                    live = live.with_baud_search();
                }
                (port, Connection::Open(Some(baud)), Input::Live(live))
            }
        };
        Ok(Self {
            input,
            model: Model::new(name, connection),
            held: None,
            started: Instant::now(),
            recording: None,
        })
    }

    /// Runs until a key or `ends` asks to end.
    pub fn run(
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
                    Ok(event) => match self.on_event(&event?) {
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
                && self.model.counts.attitudes == 0
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

    /// Returns the action of a key.
    fn on_event(&self, event: &Event) -> Option<Action> {
        match event {
            Event::Key(key) if key.kind != KeyEventKind::Release => keys::action(*key, &self.model),
            _ => None,
        }
    }

    /// Returns the model to draw: the present one, or the one at the pause.
    fn shown(&self) -> Cow<'_, Model> {
        match &self.held {
            None => Cow::Borrowed(&self.model),
            Some(held) => Cow::Owned(held.held_beside(&self.model)),
        }
    }

    /// Takes new items, and returns whether the model has changed.
    fn follow(&mut self) -> bool {
        let now_s = self.started.elapsed().as_secs_f64();
        match &mut self.input {
            Input::Live(live) => {
                let (model, recording) = (&mut self.model, &mut self.recording);
                let has_changed = live.follow(now_s, model, recording);
                model.tick(now_s, live.format(), live.counts());
                has_changed
            }
            Input::Recorded { player, advanced } => {
                let Connection::Playing { speed, is_over } = &mut self.model.connection else {
                    return false;
                };
                let elapsed_s = advanced.elapsed().as_secs_f64();
                *advanced = Instant::now();
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
                    self.model.add_message(position_s, Speaker::Program, error);
                }
                self.model.tick(position_s, player.format(), counts);
                true
            }
        }
    }

    /// Does an action.
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
            Action::Send(line) => {
                model.typed = None;
                if let Input::Live(live) = &mut self.input {
                    live.send(&line, model);
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
                model.add_message(now_s, Speaker::Program, text);
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
                model.add_message(now_s, Speaker::Program, text);
            }
        }
    }
}

impl Drop for App {
    /// Restores the module's format and baud rate, however the program ends.
    fn drop(&mut self) {
        if let Some((name, bytes)) = &self.model.recording {
            print_message(&format!("recorded {bytes} bytes to {name}"));
        }
        if let Input::Live(live) = &self.input
            && let Err(error) = live.restore()
        {
            print_message(&format!("error: {error}"));
        }
    }
}

/// Creates a file with a new name: the first free number.
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
