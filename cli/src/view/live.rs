//! Live module: its baud rate, its format, commands and answers.

use std::fs::File;
use std::io::Write;
use std::time::{Duration, Instant};

use aplomb::console::command::{self, BAUD_RATES};
use aplomb::settings::OutputFormat;

use super::model::{Connection, Model, Speaker};
use crate::link::{BAUD, LOG_BAUD, Link, Report};
use crate::stream::{Counts, Decoder, Format, Item};

/// Time between two requests for the status: 400 bytes in two seconds are 2 % of the line at
/// 115,200 baud.
const STATUS_PERIOD: Duration = Duration::from_secs(2);

/// Time with unreadable bytes after which the next baud rate is tried.
const BAUD_PATIENCE: Duration = Duration::from_secs(2);

/// Unreadable bytes that are more than noise.
const BAUD_BYTES: usize = 100;

/// Live module on a line.
pub struct Live {
    link: Link,
    decoder: Decoder,
    /// Baud rate, if there is a serial line.
    baud: Option<u32>,
    /// Baud rate before a key changed it, to restore in the end.
    first_baud: Option<u32>,
    /// Baud rate after a key changed it. When the port comes back, the module may have either.
    switched_baud: Option<u32>,
    /// Purpose of a change of the baud rate that is not answered yet.
    switching: Option<Switching>,
    /// The answer to the last `baud` was shown. Later ones answer its repetitions.
    has_baud_answer: bool,
    /// Other baud rates may be tried.
    searches_baud: bool,
    /// Start and number of unreadable bytes.
    unread: Option<(Instant, usize)>,
    /// First format, to restore in the end.
    first_format: Option<OutputFormat>,
    /// The flight log is requested as soon as the module sends.
    wants_log: bool,
    /// Time of the last request for the status.
    asked: Instant,
}

/// Purpose of a change of the baud rate.
enum Switching {
    /// The flight log.
    Log,
    /// A command of the person.
    Person,
}

impl Live {
    /// Creates a module on this link. The baud rate is `None` for the virtual board.
    pub fn new(link: Link, baud: Option<u32>) -> Self {
        Self {
            link,
            decoder: Decoder::default(),
            baud,
            first_baud: baud,
            switched_baud: None,
            switching: None,
            has_baud_answer: false,
            searches_baud: false,
            unread: None,
            first_format: None,
            wants_log: false,
            asked: Instant::now(),
        }
    }

    /// Requests the flight log as soon as the module sends.
    pub fn with_log(mut self) -> Self {
        self.wants_log = true;
        self
    }

    /// Tries other baud rates while nothing can be read.
    pub fn with_baud_search(mut self) -> Self {
        self.searches_baud = true;
        self
    }

    /// Returns the format of the stream.
    pub fn format(&self) -> Option<Format> {
        self.decoder.format()
    }

    /// Returns the counts of the stream.
    pub fn counts(&self) -> Counts {
        self.decoder.counts()
    }

    /// Restores the module's first format and baud rate, if they have changed.
    pub fn restore(&self) -> Result<(), String> {
        match (self.first_baud, self.first_format) {
            (Some(baud), Some(format))
                if self.baud != self.first_baud || self.switching.is_some() =>
            {
                self.link.bring_back(format.name(), baud)
            }
            _ => Ok(()),
        }
    }

    /// Takes the reports of the link, and returns whether there were any.
    pub fn follow(&mut self, now_s: f64, model: &mut Model, recording: &mut Option<File>) -> bool {
        let mut has_changed = false;
        while let Some(report) = self.link.next(Duration::ZERO) {
            has_changed = true;
            match report {
                Report::Bytes(bytes) => self.take(&bytes, now_s, model, recording),
                Report::Away(reason) => {
                    self.decoder.interrupt();
                    self.switching = None;
                    // After a loss of power the module starts at its stored rate.
                    if let Some(baud) = self.first_baud {
                        self.link.set_baud(baud);
                    }
                    let text = format!("{} is gone ({reason}): waiting for it", model.name);
                    model.add_message(now_s, Speaker::Program, text);
                    model.connection = Connection::Away(reason);
                    model.quiet_answers = 0;
                }
                Report::Back => {
                    model.add_message(now_s, Speaker::Program, format!("{} is back", model.name));
                    self.baud = self.first_baud;
                    self.unread = None;
                    model.connection = Connection::Open(self.baud);
                }
                Report::Ended(reason) => {
                    model.add_message(now_s, Speaker::Program, reason.clone());
                    model.connection = Connection::Ended(reason);
                }
                Report::Switched(result) => self.switched(result, model),
            }
        }
        let is_open = model.takes_commands();
        let is_fresh = model.attitude().is_some();
        if is_open && is_fresh {
            if std::mem::take(&mut self.wants_log) {
                self.set_format(OutputFormat::Log, model);
            }
            if self.asked.elapsed() >= STATUS_PERIOD {
                self.asked = Instant::now();
                model.quiet_answers = 1;
                self.link.send_line("status");
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
                    model.add_message(now_s, Speaker::Program, text);
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
            if !self.is_repeated(&item) {
                model.take(now_s, item);
            }
        }
        if let Some(Format::Module(format)) = self.decoder.format() {
            self.first_format.get_or_insert(format);
        }
    }

    /// Returns whether a message answers a repetition of `baud`, which the link sends by itself.
    fn is_repeated(&mut self, item: &Item) -> bool {
        let is_answer = matches!(item, Item::Message(text) if text.starts_with("ok baud "));
        is_answer && std::mem::replace(&mut self.has_baud_answer, true)
    }

    /// Has module and port change to this baud rate.
    fn switch_baud(&mut self, baud: u32, purpose: Switching) {
        self.switching = Some(purpose);
        self.has_baud_answer = false;
        self.link.switch_baud(baud);
    }

    /// Tries the next baud rate after too many unreadable bytes.
    fn search_baud(&mut self, length: usize, now_s: f64, model: &mut Model) {
        let Some(baud) = self.baud else { return };
        if self.switching.is_some() {
            // The link finds the rate at which the module answers.
            self.unread = None;
            return;
        }
        let (since, count) = self.unread.get_or_insert((Instant::now(), 0));
        *count += length;
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
                return model.add_message(now_s, Speaker::Program, text);
            }
        };
        self.baud = Some(next);
        model.connection = Connection::Open(Some(next));
        let text = format!("what comes cannot be read at {baud} baud: trying {next}");
        model.add_message(now_s, Speaker::Program, text);
        self.link.set_baud(next);
    }

    /// Takes the result of a change of the baud rate.
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
                model.add_message(model.now_s, Speaker::Program, format!("{stays}: {reason}"));
            }
            Ok(baud) => {
                if self.baud.is_some() {
                    self.baud = Some(baud);
                    model.connection = Connection::Open(self.baud);
                }
                match purpose {
                    Switching::Log => {
                        self.switched_baud = self.baud;
                        self.send(&format!("format {}", OutputFormat::Log.name()), model);
                    }
                    Switching::Person => {
                        // The new rate stays.
                        self.first_baud = self.baud;
                        self.switched_baud = None;
                    }
                }
            }
        }
    }

    /// Sends a line of the person.
    pub fn send(&mut self, line: &str, model: &mut Model) {
        if !model.takes_commands() {
            let text = format!("not sent, because no module is connected: {line}");
            return model.add_message(model.now_s, Speaker::Program, text);
        }
        model.add_message(model.now_s, Speaker::Person, line.to_owned());
        // The screen shows the answer to a person's question.
        if line == "status" {
            model.quiet_answers = 0;
        }
        match line.parse() {
            Ok(command::Command::Baud(baud)) => self.switch_baud(baud, Switching::Person),
            _ => self.link.send_line(line),
        }
    }

    /// Has the module send this format. The flight log needs a faster baud rate first.
    pub fn set_format(&mut self, format: OutputFormat, model: &mut Model) {
        let is_fast = self.baud == Some(LOG_BAUD);
        if format == OutputFormat::Log && !is_fast && model.takes_commands() {
            model.add_message(model.now_s, Speaker::Person, format!("baud {LOG_BAUD}"));
            self.switch_baud(LOG_BAUD, Switching::Log);
        } else {
            self.send(&format!("format {}", format.name()), model);
        }
    }
}

/// Returns the baud rate to try after this one: the usual two first, then down.
pub fn next_baud(baud: u32) -> u32 {
    if baud == BAUD {
        return LOG_BAUD;
    }
    let slower = BAUD_RATES
        .iter()
        .rev()
        .find(|rate| **rate < baud && **rate != BAUD);
    slower.copied().unwrap_or(BAUD)
}
