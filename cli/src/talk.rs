//! Conversation with a module on a serial port: commands, and the lines that answer them.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::end_request::{ENDED, is_end_asked};
use crate::link::{Link, Report};
use crate::stream::{Decoder, Item};

/// Longest time from a command to its answer.
const ANSWER: Duration = Duration::from_secs(2);

/// Attempts of a command before the module counts as silent. Noise may have spoilt a line.
const ATTEMPTS: u32 = 3;

/// Timeout of a wait for bytes.
const POLL: Duration = Duration::from_millis(50);

/// Conversation with a module.
pub struct Talk {
    link: Link,
    decoder: Decoder,
    items: VecDeque<Item>,
    /// Ctrl-C ends the present wait.
    heeds_end: bool,
}

impl Talk {
    /// Opens a port.
    pub fn open(port: &str, baud: u32) -> Result<Self, String> {
        Ok(Self {
            link: Link::port(port, baud)?,
            decoder: Decoder::default(),
            items: VecDeque::new(),
            heeds_end: true,
        })
    }

    /// Returns the next piece that comes before this time. A port that is gone is waited for. An
    /// error is the link's end, or Ctrl-C.
    pub fn next(&mut self, until: Instant) -> Result<Option<Item>, String> {
        loop {
            if self.heeds_end && is_end_asked() {
                return Err(ENDED.to_owned());
            }
            if let Some(item) = self.items.pop_front() {
                return Ok(Some(item));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            match self.link.next(left.min(POLL)) {
                Some(Report::Bytes(bytes)) => {
                    let mut items = Vec::new();
                    self.decoder.push(&bytes, &mut items);
                    self.items.extend(items);
                }
                Some(Report::Away(_)) => self.decoder.interrupt(),
                Some(Report::Ended(reason)) => return Err(reason),
                Some(Report::Back | Report::Switched(_)) | None => {}
            }
        }
    }

    /// Returns the first message within this time for which `choose` returns something.
    pub fn message<R>(
        &mut self,
        within: Duration,
        mut choose: impl FnMut(&str) -> Option<R>,
    ) -> Result<Option<R>, String> {
        let until = Instant::now() + within;
        while let Some(item) = self.next(until)? {
            if let Item::Message(text) = item
                && let Some(chosen) = choose(&text)
            {
                return Ok(Some(chosen));
            }
        }
        Ok(None)
    }

    /// Sends a command, and returns its answer without `ok`. An error is the module's refusal, or
    /// its silence.
    pub fn ask(&mut self, command: &str) -> Result<String, String> {
        let start = format!("ok {}", command.split(' ').next().unwrap_or(command));
        for _attempt in 0..ATTEMPTS {
            self.items.clear();
            self.link.send_line(command);
            let answer = self.message(ANSWER, |text| {
                if text.starts_with(&start) {
                    return Some(Ok(text["ok ".len()..].to_owned()));
                }
                let reason = text.strip_prefix("error ")?;
                Some(Err(format!("the module refuses `{command}`: {reason}")))
            })?;
            if let Some(answer) = answer {
                return answer;
            }
        }
        Err(format!(
            "the module does not answer `{command}`: check the port, TX and RX, and the baud rate; \
             leave a binary format with `format text`"
        ))
    }

    /// Like [`ask`](Self::ask), but after Ctrl-C too: for commands that restore the module.
    pub fn ask_in_any_case(&mut self, command: &str) -> Result<String, String> {
        let heeds_end = std::mem::replace(&mut self.heeds_end, false);
        let answer = self.ask(command);
        self.heeds_end = heeds_end;
        answer
    }

    /// Passes this time. An error is Ctrl-C, or the link's end.
    pub fn wait(&mut self, duration: Duration) -> Result<(), String> {
        let until = Instant::now() + duration;
        while self.next(until)?.is_some() {}
        Ok(())
    }

    /// Sends a command that takes a while. Returns the text of `done`, or of `failed` as the error.
    /// `show` gets the progress.
    pub fn perform(
        &mut self,
        command: &str,
        within: Duration,
        mut show: impl FnMut(&str),
    ) -> Result<Result<String, String>, String> {
        show(&self.ask(command)?);
        let ending = |text: &str, kind: &str| {
            let text = text
                .strip_prefix(kind)?
                .trim_start()
                .strip_prefix(command)?;
            Some(text.trim_start_matches(':').trim().to_owned())
        };
        let ended = self.message(within, |text| {
            if let Some(progress) = text.strip_prefix("progress ") {
                show(progress);
            }
            let done = ending(text, "done").map(Ok);
            done.or_else(|| ending(text, "failed").map(Err))
        })?;
        let seconds = within.as_secs();
        Ok(ended.unwrap_or_else(|| Err(format!("no end of `{command}` within {seconds} s"))))
    }
}
