//! Commands: the console's lines and the ground station's requests.
//!
//! `commands_absent.rs` takes the place of this file in a build without the feature `full`.

use aplomb::board::retained;
use aplomb::board::timebase;
use aplomb::board::uart::{Receiver, Reception, Transmitter};
use aplomb::calibration::{Mount, NoiseModel};
use aplomb::compass::{self, Choice, CompassStatus};
use aplomb::console::Console;
use aplomb::console::answer::{ANSWER_CAPACITY, Kind};
use aplomb::console::ground_station::GroundStation;
use aplomb::estimator::Sample;
use aplomb::fault::FaultClass;
use aplomb::settings::storage::Loaded;
use aplomb::settings::{OutputFormat, Preferences, Record};
use aplomb::telemetry::Output;
use aplomb::telemetry::mavlink::Vehicle;
use aplomb::telemetry::message::Severity;
use rtic::Mutex;

use crate::estimation::{Estimation, Latest};
use crate::kept_record;
use crate::module_port::ModulePort;
use crate::requests::Requests;

/// Console and ground station, with the bytes that they receive.
pub struct Commands {
    console: Console,
    station: GroundStation,
    receiver: Receiver,
    /// True if bytes were garbled or lost since the last poll of the console.
    has_reception_error: bool,
}

/// Answer to a command.
pub struct Answer {
    /// Text of the line, without its end.
    pub text: heapless::String<ANSWER_CAPACITY>,
    /// Kind of the answer; `None` if there is no answer.
    pub kind: Option<Kind>,
    /// Number of the first burst after a change of settings: the flight log restarts there.
    pub changed_at: Option<u32>,
}

impl Commands {
    /// Creates a console that reads from this receiver, with the content of the flash at start and
    /// the record that was in use before a reset. It describes a sensor with this noise and rate.
    /// It is armed if the module was armed before a reset.
    pub fn new(
        receiver: Receiver,
        (loaded, kept): (Loaded, Option<Record>),
        noise: NoiseModel,
        sample_rate_hz: f32,
        default_mount: Mount,
        default_compass: Choice,
        is_armed: bool,
    ) -> Self {
        let mut console = Console::new(
            loaded,
            noise,
            sample_rate_hz,
            default_mount,
            default_compass,
            is_armed,
        );
        if let Some(record) = kept {
            console.continue_with(record);
        }
        Self {
            console,
            station: GroundStation::new(),
            receiver,
            has_reception_error: false,
        }
    }

    /// Returns the record in use.
    pub const fn record(&self) -> &Record {
        self.console.working()
    }

    /// Returns the preferences in use.
    pub const fn preferences(&self) -> Preferences {
        self.console.working().preferences
    }

    /// Checks the receiver for bytes that were garbled or lost. The next poll of the console gets
    /// the error.
    pub fn check_reception(&mut self, baud: u32) {
        if self.receiver.poll(baud) != Reception::Sound {
            self.has_reception_error = true;
            retained::count(FaultClass::UartInput);
        }
    }

    /// Executes one line of the console, or one request of the ground station.
    pub fn poll(
        &mut self,
        now_us: u64,
        bursts_failed: u16,
        transmitter: &mut Transmitter,
        estimation: impl Mutex<T = Estimation>,
        requests: impl Mutex<T = Requests>,
    ) -> Answer {
        let mut answer = Answer {
            text: heapless::String::new(),
            kind: None,
            changed_at: None,
        };
        let console = &mut self.console;
        let mut port = ModulePort {
            receiver: &mut self.receiver,
            transmitter,
            estimation,
            requests,
            has_reception_error: core::mem::take(&mut self.has_reception_error),
            is_mavlink: console.working().preferences.format == OutputFormat::Mavlink,
            station: &mut self.station,
            now_us,
            changed_at: None,
            bursts_failed,
        };
        let mut kind = console.poll(timebase::now(), &mut port, &mut answer.text);
        if let Some(kind) = kind {
            port.station.on_answer(kind);
        } else if !console.is_busy()
            && let Some((ticket, command)) = port.station.take_command()
        {
            let answered = console.execute(command, timebase::now(), &mut port, &mut answer.text);
            let (is_working, is_armed) = (console.is_working(), console.is_armed());
            port.station
                .answer(ticket, command, answered, is_working, is_armed);
            kind = Some(answered);
        }
        let has_new_baud = port.station.session.take_has_frame() && console.confirm_baud();
        if port.station.has_pending() && !console.is_working() {
            port.station.cancel_pending();
        }
        if kind.is_some() || has_new_baud {
            // The supervisor cannot run before this, so a job that begins here has this record.
            kept_record::keep(console.working());
        }
        answer.kind = kind;
        answer.changed_at = port.changed_at;
        answer
    }

    /// Writes a line of text as MAVLink.
    pub fn put_text(&mut self, severity: Severity, line: &str, output: &mut Output<'_>) {
        self.station.session.send_text(severity, line, output);
    }

    /// Writes the MAVLink messages that are due. `is_due` is true if those with the latest attitude
    /// are.
    pub fn put_messages(
        &mut self,
        mut estimation: impl Mutex<T = Estimation>,
        is_due: bool,
        now_us: u64,
        bursts_failed: u16,
        output: &mut Output<'_>,
    ) {
        let (mut compass, mut latest) = (CompassStatus::default(), None);
        let (sample, temperature_celsius) = estimation.lock(|estimation| {
            if compass::IS_BUILT_IN {
                compass = estimation.compass.status();
            }
            // Under the lock, so that attitude and sample are of one time.
            latest = Latest::read();
            let pipeline = estimation.pipeline.as_ref();
            pipeline.map_or((Sample::default(), 0.0), |pipeline| {
                (*pipeline.sample(), pipeline.temperature_celsius())
            })
        });
        let latest = latest.as_ref().map(|(latest, _)| latest);
        let vehicle = Vehicle {
            snapshot: latest.map(|latest| &latest.snapshot),
            is_due,
            sample: &sample,
            temperature_celsius,
            heading: latest.and_then(|latest| latest.heading),
            compass,
            record: self.console.working(),
            baud: self.console.baud(),
            is_armed: self.console.is_armed(),
            bursts_failed,
        };
        self.station.session.fill(now_us, &vehicle, output);
    }
}
