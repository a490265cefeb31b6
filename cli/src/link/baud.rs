//! Change of the baud rate at both ends of a line.
//!
//! The module answers `baud`, sends the frame behind its answer, and changes its rate at a later
//! tick. It drops what it has received until then: at 9600 baud for more than 100 ms. So the
//! command is repeated at the new rate until the module answers it there. The module also keeps a
//! rate only once it has understood a command at it; else its old rate returns after 10 s.

use std::fmt;
use std::io;
use std::time::{Duration, Instant};

use crate::stream::{Decoder, Item};

/// Longest time until the module answers `baud` at the old rate. At 9600 baud two lines and the
/// answer take 300 ms.
const ANSWER: Duration = Duration::from_secs(1);

/// Time between two commands at the new rate. `baud` has the shortest answer of all commands: it
/// takes 27 ms at 9600 baud.
const REPEAT: Duration = Duration::from_millis(100);

/// Longest time from the port's change to the module's answer at the new rate.
const CONFIRMATION: Duration = Duration::from_secs(3);

/// Longest time from the port's change to the module's answer at the old rate, which returns 10 s
/// after the module's own change.
const REVERSION: Duration = Duration::from_secs(12);

/// Longest time of a change, whatever its result.
pub const LONGEST: Duration = Duration::from_secs(15);

/// Line to a module.
pub trait Line {
    /// Sends a text and a line end.
    fn send(&mut self, text: &str) -> io::Result<()>;

    /// Waits a moment for received bytes, and returns them, perhaps none.
    fn receive(&mut self) -> io::Result<Vec<u8>>;

    /// Sends and receives at this baud rate from now on.
    fn set_baud(&mut self, baud: u32) -> io::Result<()>;
}

/// Reason of a failed change of the baud rate. The port stays at its old rate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Failure {
    /// The port is gone.
    Gone,
    /// The module sends no answer.
    Unanswered,
    /// The module refuses the change, with this answer.
    Refused(String),
    /// The module gave no answer at the rate `tried`, and its old rate has returned.
    Reverted {
        /// New rate.
        tried: u32,
        /// Old rate.
        before: u32,
    },
    /// The module confirmed the change, and answers at neither rate.
    Lost {
        /// New rate.
        tried: u32,
        /// Old rate.
        before: u32,
    },
}

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gone => formatter.write_str("the port is gone"),
            Self::Unanswered => formatter.write_str("the module does not answer"),
            Self::Refused(answer) => formatter.write_str(answer),
            Self::Reverted { tried, before } => write!(
                formatter,
                "the module confirmed {tried} baud, but gave no answer there, and is back at \
                 {before}: does the adapter carry {tried} baud?"
            ),
            Self::Lost { tried, before } => write!(
                formatter,
                "the module confirmed {tried} baud, but answers neither there nor at {before}: \
                 switch it off and on, then it has its saved rate and format"
            ),
        }
    }
}

/// Changes module and line from the rate `before` to `baud`, and returns `baud`. After a failure
/// the line is at `before`.
///
/// # Errors
///
/// The outer error is that of the line.
pub fn switch(baud: u32, before: u32, line: &mut dyn Line) -> io::Result<Result<u32, Failure>> {
    line.send(&format!("baud {baud}"))?;
    match first_answer(baud, line)? {
        Err(failure) => return Ok(Err(failure)),
        // The module has this rate already, and changes nothing.
        Ok(answer) if answer.ends_with("as before") => return Ok(Ok(baud)),
        Ok(_) => {}
    }
    line.set_baud(baud)?;
    let changed = Instant::now();
    if is_answered(baud, changed + CONFIRMATION, line)? {
        return Ok(Ok(baud));
    }
    line.set_baud(before)?;
    Ok(Err(if is_answered(before, changed + REVERSION, line)? {
        Failure::Reverted {
            tried: baud,
            before,
        }
    } else {
        Failure::Lost {
            tried: baud,
            before,
        }
    }))
}

/// Returns the module's answer to `baud` at the old rate.
fn first_answer(baud: u32, line: &mut dyn Line) -> io::Result<Result<String, Failure>> {
    let expected = format!("ok baud {baud}");
    let (mut decoder, mut items) = (Decoder::default(), Vec::new());
    let mut failure = Failure::Unanswered;
    let asked = Instant::now();
    while asked.elapsed() < ANSWER {
        decoder.push(&line.receive()?, &mut items);
        for item in items.drain(..) {
            match item {
                Item::Message(text) if text.starts_with(&expected) => return Ok(Ok(text)),
                // It may be the answer to an earlier command.
                Item::Message(text) if text.starts_with("error") => {
                    failure = Failure::Refused(text);
                }
                _ => {}
            }
        }
    }
    Ok(Err(failure))
}

/// Repeats `baud` at the line's rate until the module answers it. Returns false if it has not
/// answered at the time `until`.
fn is_answered(baud: u32, until: Instant, line: &mut dyn Line) -> io::Result<bool> {
    let expected = format!("ok baud {baud}");
    let is_answer = |item| matches!(item, Item::Message(text) if text.starts_with(&expected));
    let (mut decoder, mut items) = (Decoder::default(), Vec::new());
    while Instant::now() < until {
        // The empty line ends what the module may have received of an earlier one.
        line.send(&format!("\nbaud {baud}"))?;
        let asked = Instant::now();
        while asked.elapsed() < REPEAT {
            decoder.push(&line.receive()?, &mut items);
            if items.drain(..).any(is_answer) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}
