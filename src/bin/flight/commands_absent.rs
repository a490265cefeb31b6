//! Replaces `commands.rs` in a minimal build, which takes no commands.
//!
//! The stored record is in use, except that a format which this build lacks becomes labelled text.

use aplomb::board::uart::{Receiver, Transmitter};
use aplomb::calibration::{Mount, NoiseModel};
use aplomb::compass::Choice;
use aplomb::console::answer::Kind;
use aplomb::console::usable_preferences;
use aplomb::settings::storage::Loaded;
use aplomb::settings::{OutputFormat, Preferences, Record};
use aplomb::telemetry::Output;
use aplomb::telemetry::message::Severity;
use rtic::Mutex;

use crate::estimation::Estimation;
use crate::requests::Requests;

/// The stored record.
pub struct Commands(Record);

/// No answer.
pub struct Answer {
    /// The empty line.
    pub text: heapless::String<1>,
    /// `None`.
    pub kind: Option<Kind>,
    /// `None`.
    pub changed_at: Option<u32>,
}

impl Commands {
    /// Takes the record from flash, and ignores received bytes.
    pub fn new(
        _: Receiver,
        (loaded, kept): (Loaded, Option<Record>),
        _: NoiseModel,
        _: f32,
        _: Mount,
        default_compass: Choice,
        _: bool,
    ) -> Self {
        let stored = kept.or(loaded.record);
        let mut record = stored.unwrap_or(Record::with_compass(default_compass));
        if let OutputFormat::Mavlink | OutputFormat::Log = record.preferences.format {
            record.preferences.format = OutputFormat::Text;
        }
        record.preferences = usable_preferences(record.preferences);
        Self(record)
    }

    /// Returns the record in use.
    pub const fn record(&self) -> &Record {
        &self.0
    }

    /// Returns the preferences in use.
    pub const fn preferences(&self) -> Preferences {
        self.0.preferences
    }

    /// Does nothing: received bytes are not read.
    pub fn check_reception(&mut self, _: u32) {}

    /// Returns no answer.
    pub fn poll(
        &mut self,
        _: u64,
        _: u16,
        _: &mut Transmitter,
        _: impl Mutex<T = Estimation>,
        _: impl Mutex<T = Requests>,
    ) -> Answer {
        Answer {
            text: heapless::String::new(),
            kind: None,
            changed_at: None,
        }
    }

    /// Writes nothing.
    pub fn put_text(&mut self, _: Severity, _: &str, _: &mut Output<'_>) {}

    /// Writes nothing.
    pub fn put_messages(
        &mut self,
        _: impl Mutex<T = Estimation>,
        _: bool,
        _: u64,
        _: u16,
        _: &mut Output<'_>,
    ) {
    }
}
