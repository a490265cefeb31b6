//! Model of the screen. It has no port, file or clock, so that tests can draw any state.

use std::collections::VecDeque;

use aplomb::health::Flags;
use aplomb::settings::OutputFormat;
use aplomb::telemetry::heading;

use super::compass::Field;
use crate::stream::{Attitude, Counts, Format, Item, Sensors, field};

/// Length of the strips, s.
pub const STRIP_S: f64 = 20.0;

/// Time over which rates are counted, s.
const RATE_WINDOW_S: f64 = 4.0;

/// Age from which on an attitude is not fresh, s.
const FRESH_S: f64 = 1.0;

/// Messages that are kept.
const MESSAGES: usize = 200;

/// The connection.
#[derive(Debug, Clone, PartialEq)]
pub enum Connection {
    /// Bytes may come; the baud rate, if there is one.
    Open(Option<u32>),
    /// The port is gone, for this reason, and is waited for.
    Away(String),
    /// The source has ended, for this reason.
    Ended(String),
    /// A recording is played.
    Playing {
        /// Multiple of real time.
        speed: f64,
        /// The recording is at its end.
        is_over: bool,
    },
}

/// Origin of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Speaker {
    /// The module.
    Module,
    /// The person at the keyboard, by a key or a command.
    Person,
    /// The program that shows the module.
    Program,
}

/// Line of the messages.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Time, s.
    pub at_s: f64,
    pub speaker: Speaker,
    pub text: String,
}

/// A point of the strips.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    pub at_s: f64,
    pub attitude: Attitude,
}

/// Degree to which the attitude can be trusted.
#[derive(Debug, Clone, PartialEq)]
pub enum Trust {
    /// The module flags it as valid.
    Valid,
    /// The module reports healthy sensors, without flags.
    Healthy,
    /// The attitude is healthy, but the sensors of these names are not.
    Unhealthy(Vec<&'static str>),
    /// Not valid, with the names of flags or sensors.
    NotValid(Vec<&'static str>),
    /// The format has no health.
    Unknown,
    /// No fresh attitude; the age of the last one, s.
    NoData(Option<f64>),
}

/// The state of the screen.
#[derive(Debug, Clone)]
pub struct Model {
    /// The port, the file, or the virtual board.
    pub name: String,
    pub connection: Connection,
    pub format: Option<Format>,
    /// Time since the beginning, s.
    pub now_s: f64,
    pub tilt_sigma_deg: Option<f32>,
    /// The last heading, and its time, s.
    heading: Option<(f64, heading::Line)>,
    /// Field at the compass, by the module's status.
    pub field: Option<Field>,
    pub temperature_c: Option<f32>,
    pub sensors: Option<Sensors>,
    pub counts: Counts,
    /// Frames that the module has dropped, by its status.
    pub frames_dropped: Option<u64>,
    /// Bursts that the module failed to read, by its status.
    pub bursts_failed: Option<u64>,
    pub points: VecDeque<Point>,
    pub messages: VecDeque<Message>,
    /// File of the recording, and its bytes so far.
    pub recording: Option<(String, u64)>,
    pub is_paused: bool,
    pub shows_help: bool,
    /// Command that is being typed.
    pub typed: Option<String>,
    /// Answers to `status` that the program requested for itself.
    pub quiet_answers: u32,
    totals: VecDeque<(f64, u64, u64)>,
}

impl Model {
    /// Creates a model without data.
    pub fn new(name: String, connection: Connection) -> Self {
        Self {
            name,
            connection,
            format: None,
            now_s: 0.0,
            tilt_sigma_deg: None,
            heading: None,
            field: None,
            temperature_c: None,
            sensors: None,
            counts: Counts::default(),
            frames_dropped: None,
            bursts_failed: None,
            points: VecDeque::new(),
            messages: VecDeque::new(),
            recording: None,
            is_paused: false,
            shows_help: false,
            typed: None,
            quiet_answers: 0,
            totals: VecDeque::new(),
        }
    }

    /// Takes an item that was decoded at this time.
    pub fn take(&mut self, at_s: f64, item: Item) {
        match item {
            Item::Attitude(attitude) => {
                self.points.push_back(Point { at_s, attitude });
                while let Some(first) = self.points.front()
                    && first.at_s < at_s - STRIP_S
                {
                    self.points.pop_front();
                }
            }
            Item::TiltSigma(sigma) => self.tilt_sigma_deg = Some(sigma),
            Item::Heading(heading) => self.heading = Some((at_s, heading)),
            Item::Temperature(temperature) => self.temperature_c = Some(temperature),
            Item::Sensors(sensors) => self.sensors = Some(sensors),
            Item::Message(text) => {
                if let Some(status) = text.strip_prefix("ok status:") {
                    self.take_status(status);
                    if self.quiet_answers > 0 {
                        self.quiet_answers -= 1;
                        return;
                    }
                }
                self.add_message(at_s, Speaker::Module, text);
            }
        }
    }

    /// Returns this model's attitudes with the keys, connection and messages of the present model:
    /// the paused screen.
    pub fn held_beside(&self, present: &Self) -> Self {
        Self {
            is_paused: true,
            shows_help: present.shows_help,
            typed: present.typed.clone(),
            recording: present.recording.clone(),
            connection: present.connection.clone(),
            messages: present.messages.clone(),
            ..self.clone()
        }
    }

    /// Returns the heading, if it is fresh.
    pub fn heading(&self) -> Option<heading::Line> {
        let (at_s, heading) = self.heading?;
        (self.now_s - at_s < FRESH_S).then_some(heading)
    }

    /// Sets the time, the format and the counts.
    pub fn tick(&mut self, now_s: f64, format: Option<Format>, counts: Counts) {
        if format != self.format {
            // Another format may not have them.
            self.tilt_sigma_deg = None;
            self.heading = None;
            self.temperature_c = None;
            self.sensors = None;
            self.format = format;
        }
        self.now_s = now_s;
        self.counts = counts;
        let is_due = |last: &(f64, u64, u64)| now_s - last.0 >= RATE_WINDOW_S / 40.0;
        if self.totals.back().is_none_or(is_due) {
            self.totals
                .push_back((now_s, counts.attitudes, counts.bursts));
        }
        while let Some((first_s, ..)) = self.totals.front()
            && *first_s < now_s - RATE_WINDOW_S
        {
            self.totals.pop_front();
        }
    }

    /// Adds a line to the messages.
    pub fn add_message(&mut self, at_s: f64, speaker: Speaker, text: String) {
        if self.messages.len() == MESSAGES {
            self.messages.pop_front();
        }
        self.messages.push_back(Message {
            at_s,
            speaker,
            text,
        });
    }

    /// Returns the newest attitude, if it is fresh.
    pub fn attitude(&self) -> Option<&Attitude> {
        let last = self.points.back()?;
        (self.now_s - last.at_s < FRESH_S).then_some(&last.attitude)
    }

    /// Returns how far the attitude can be trusted.
    pub fn trust(&self) -> Trust {
        let Some(attitude) = self.attitude() else {
            return Trust::NoData(self.points.back().map(|last| self.now_s - last.at_s));
        };
        match (attitude.flags, self.sensors) {
            (Some(flags), _) if flags.contains(Flags::VALID) => Trust::Valid,
            (Some(_), _) => Trust::NotValid(self.flag_names()),
            (None, Some(sensors)) => {
                let names = sensors.unhealthy();
                match sensors.attitude && sensors.gyroscope {
                    _ if names.is_empty() => Trust::Healthy,
                    true => Trust::Unhealthy(names),
                    false => Trust::NotValid(names),
                }
            }
            (None, None) => Trust::Unknown,
        }
    }

    /// Returns the names of the set flags, without `VALID`.
    pub fn flag_names(&self) -> Vec<&'static str> {
        let Some(flags) = self.attitude().and_then(|attitude| attitude.flags) else {
            return Vec::new();
        };
        let others = flags.difference(Flags::VALID);
        others.iter_names().map(|(name, _)| name).collect()
    }

    /// Returns the rates of attitudes and bursts, Hz.
    pub fn rates_hz(&self) -> Option<(f64, f64)> {
        let (first_s, attitudes, bursts) = self.totals.front()?;
        let seconds = self.now_s - first_s;
        let rate = |now: u64, then: u64| now.saturating_sub(then) as f64 / seconds;
        (seconds > 0.2).then(|| {
            (
                rate(self.counts.attitudes, *attitudes),
                rate(self.counts.bursts, *bursts),
            )
        })
    }

    /// Returns whether a module takes commands.
    pub fn takes_commands(&self) -> bool {
        matches!(self.connection, Connection::Open(_))
    }

    /// Returns whether a recording is played.
    pub fn is_playing(&self) -> bool {
        matches!(self.connection, Connection::Playing { .. })
    }

    /// Returns the format after the present one.
    pub fn next_format(&self) -> OutputFormat {
        let formats = OutputFormat::ALL;
        let present = formats
            .iter()
            .position(|format| self.format == Some(Format::Module(*format)));
        formats[present.map_or(0, |present| present + 1) % formats.len()]
    }

    fn take_status(&mut self, status: &str) {
        let number = |name| field(status, name).and_then(|value| value.parse().ok());
        let whole = |name| field(status, name).and_then(|value| value.parse().ok());
        self.tilt_sigma_deg = number("tilt_sigma_deg").or(self.tilt_sigma_deg);
        self.temperature_c = number("temperature_c").or(self.temperature_c);
        self.field = field(status, "field_ut").and_then(|text| {
            let numbers: Result<Vec<f64>, _> = text.split(',').map(str::parse).collect();
            let components = numbers.ok()?.try_into().ok()?;
            let attitude = self.attitude()?;
            let (roll_deg, pitch_deg) = (attitude.roll_deg.into(), attitude.pitch_deg.into());
            Some(Field::new(components, roll_deg, pitch_deg))
        });
        self.frames_dropped = whole("frames_dropped");
        self.bursts_failed = whole("bursts_failed");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Model {
        Model::new("port".into(), Connection::Open(Some(115_200)))
    }

    #[test]
    fn an_attitude_is_fresh_for_a_second_and_trusted_by_its_flags() {
        let mut model = model();
        assert_eq!(model.trust(), Trust::NoData(None));
        let attitude = |flags| {
            Item::Attitude(Attitude {
                flags,
                ..Attitude::default()
            })
        };
        model.take(1.0, attitude(Some(Flags::VALID | Flags::MISSED)));
        model.tick(1.5, None, Counts::default());
        assert_eq!(model.trust(), Trust::Valid);
        assert_eq!(model.flag_names(), ["MISSED"]);
        model.tick(2.5, None, Counts::default());
        assert_eq!(model.trust(), Trust::NoData(Some(1.5)));
        model.take(2.5, attitude(Some(Flags::DEGRADED | Flags::STALE)));
        assert_eq!(model.trust(), Trust::NotValid(vec!["DEGRADED", "STALE"]));
        model.take(2.5, attitude(None));
        assert_eq!(model.trust(), Trust::Unknown);
        let healthy = Sensors {
            gyroscope: true,
            accelerometer: true,
            attitude: true,
            compass: true,
        };
        model.sensors = Some(healthy);
        assert_eq!(model.trust(), Trust::Healthy);
        model.sensors = Some(Sensors {
            attitude: false,
            ..healthy
        });
        assert_eq!(model.trust(), Trust::NotValid(vec!["ATTITUDE"]));
        model.sensors = Some(Sensors {
            accelerometer: false,
            compass: false,
            ..healthy
        });
        let names = vec!["ACCELEROMETER", "COMPASS"];
        assert_eq!(model.trust(), Trust::Unhealthy(names));
        model.sensors = Some(Sensors {
            gyroscope: false,
            ..healthy
        });
        assert_eq!(model.trust(), Trust::NotValid(vec!["GYROSCOPE"]));
    }

    #[test]
    fn a_status_is_read_and_shown_only_if_a_person_asked() {
        let mut model = model();
        let status = "ok status: sensor=MPU-6050@0x68 tilt_sigma_deg=0.58 temperature_c=25.6 \
                      armed=no bursts_failed=2 \
                      frames_dropped=7 doing=\"calibrate gyro\"";
        model.quiet_answers = 1;
        model.take(0.0, Item::Message(status.into()));
        assert_eq!(
            (
                model.tilt_sigma_deg,
                model.temperature_c,
                model.frames_dropped,
                model.bursts_failed
            ),
            (Some(0.58), Some(25.6), Some(7), Some(2))
        );
        assert!(model.messages.is_empty());
        model.take(0.0, Item::Message(status.into()));
        assert_eq!(model.messages.len(), 1);
    }

    #[test]
    fn rates_are_those_of_the_last_seconds() {
        let mut model = model();
        let mut counts = Counts::default();
        for tenth in 0..100 {
            // 50 a second, then 10.
            counts.attitudes += if tenth < 50 { 5 } else { 1 };
            model.tick(f64::from(tenth) * 0.1, None, counts);
        }
        let (hertz, bursts) = model.rates_hz().expect("there were enough");
        assert!((hertz - 10.0).abs() < 0.1, "{hertz}");
        assert_eq!(bursts, 0.0);
    }

    #[test]
    fn the_formats_follow_each_other_in_a_circle() {
        let mut model = model();
        for format in OutputFormat::ALL.into_iter().chain(OutputFormat::ALL) {
            assert_eq!(model.next_format(), format);
            model.format = Some(Format::Module(format));
        }
    }
}
