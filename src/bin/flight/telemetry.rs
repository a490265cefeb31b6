//! One telemetry tick: polls the console, and sends its answer, messages and the latest snapshot in one buffer.
//!
//! Deadline: none. The task has the lowest priority of those with interrupts; what does not fit is dropped and counted,
//! never waited for.

use core::fmt::Write;
use core::sync::atomic::Ordering;

use aplomb::board::uart::{self, Receiver, Reception, Transmitter};
use aplomb::board::{burst_reader, publish, retained, timebase, watchdog};
use aplomb::console::answer::{ANSWER_CAPACITY, Kind};
use aplomb::console::ground_station::GroundStation;
use aplomb::console::{Console, State};
use aplomb::estimator::Sample;
use aplomb::fault::FaultClass;
use aplomb::health::FlagReport;
use aplomb::pipeline::Snapshot;
use aplomb::settings::OutputFormat;
use aplomb::telemetry::log::{self, NumberedBurst, Sender};
use aplomb::telemetry::mavlink::Vehicle;
use aplomb::telemetry::message::{self, Message, Severity};
use aplomb::telemetry::{self as formats, FRAME_CAPACITY, Mailbox, Output, Pace};
use heapless::spsc::Consumer;
use rtic::Mutex;

use crate::module_port::ModulePort;
use crate::requests::{BURST_COUNT, Estimation, IS_LOGGING, Requests};

/// Room for a tick's answer, with its mark and line end, beside a frame.
const ANSWER_ROOM: usize = ANSWER_CAPACITY + 16;
const _: () = assert!(ANSWER_ROOM + FRAME_CAPACITY <= uart::CAPACITY);
/// Room for a text of so many letters in any format: the longest is one MAVLink frame for each 50 of them.
const fn room(letters: usize) -> usize {
    letters.div_ceil(50) * 66
}
/// Room for a message.
const MESSAGE_ROOM: usize = room(message::LINE_CAPACITY);
const _: () = assert!(MESSAGE_ROOM <= ANSWER_ROOM && room(ANSWER_CAPACITY) <= uart::CAPACITY);
/// Longest time from a sample to the copy of the pipeline for the log, in µs, so that no attitude waits for the copy.
const COPY_WINDOW_US: u32 = 900;

/// The telemetry task's state.
pub struct Telemetry {
    transmitter: Transmitter,
    receiver: Receiver,
    console: Console,
    logged: Consumer<'static, NumberedBurst>,
    station: GroundStation,
    sender: Sender,
    now_us: u64,
    frames_sent: u8,
    last_published: u32,
    last_failures: u16,
    tick: u16,
    flag_report: FlagReport,
}

impl Telemetry {
    /// Telemetry over this UART. `logged` brings the bursts for the flight log.
    pub fn new(
        transmitter: Transmitter,
        receiver: Receiver,
        console: Console,
        logged: Consumer<'static, NumberedBurst>,
    ) -> Self {
        Self {
            transmitter,
            receiver,
            console,
            logged,
            station: GroundStation::new(),
            sender: Sender::new(0),
            now_us: 0,
            frames_sent: 0,
            last_published: 0,
            last_failures: 0,
            tick: 0,
            flag_report: FlagReport::new(),
        }
    }

    /// Runs one tick.
    pub fn tick(
        &mut self,
        mut estimation: impl Mutex<T = Estimation>,
        mut messages: impl Mutex<T = Mailbox>,
        requests: impl Mutex<T = Requests>,
    ) {
        watchdog::telemetry_goes_on();
        let mut post = |message| messages.lock(|messages| messages.post(message));
        let failures = self.report_failures(&mut post);
        let has_reception_error = self.receiver.look(self.transmitter.baud()) != Reception::Sound;
        if has_reception_error {
            retained::count(FaultClass::UartInput);
        }
        // Ticks come much more often than the count wraps.
        self.now_us += u64::from(timebase::now().wrapping_sub(self.now_us as u32));
        let preferences = self.console.working().preferences;
        let format = preferences.format;
        let snapshot = self.due_snapshot(Pace::new(format, preferences.rate_hz));
        if let Some(snapshot) = &snapshot
            && let Some(flags) = self.flag_report.update(snapshot.flags, self.now_us as u32)
        {
            post(Message::Attitude(flags));
        }
        if !self.transmitter.is_idle() {
            if snapshot.is_some() {
                retained::count(FaultClass::TelemetryLate);
            }
            return;
        }
        self.follow_log_format(format == OutputFormat::Log);
        let mut port = ModulePort {
            receiver: &mut self.receiver,
            transmitter: &mut self.transmitter,
            estimation: &mut estimation,
            requests,
            has_reception_error,
            station: &mut self.station,
            is_mavlink: format == OutputFormat::Mavlink,
            now_us: self.now_us,
            changed_at: None,
            state: State {
                bursts_failed: failures,
                reception_errors: retained::counted(FaultClass::UartInput),
                frames_dropped: retained::counted(FaultClass::TelemetryLate),
                ..State::default()
            },
        };
        let mut answer = heapless::String::<ANSWER_CAPACITY>::new();
        let kind = poll_console(&mut self.console, &mut port, &mut answer);
        if let Some(number) = port.changed_at {
            self.sender.restart(number);
        }
        let Some(buffer) = self.transmitter.idle_buffer() else {
            return;
        };
        let output = &mut Output::new(buffer);
        // The answer to a command that changes the format still comes in the old one.
        if let Some(kind) = kind {
            put_text(format, severity(kind), &answer, &mut self.station, output);
        }
        while output.has_room(MESSAGE_ROOM + FRAME_CAPACITY)
            && let Some(message) = messages.lock(Mailbox::take)
        {
            let mut line = heapless::String::<{ message::LINE_CAPACITY }>::new();
            // A test holds the longest message to its line.
            write!(line, "{message}").ok();
            put_text(format, message.severity(), &line, &mut self.station, output);
        }
        let (now_us, snapshot) = (self.now_us, snapshot.as_ref());
        match format {
            OutputFormat::Mavlink => put_mavlink(
                &mut self.station,
                &self.console,
                &mut estimation,
                snapshot,
                now_us,
                failures,
                output,
            ),
            OutputFormat::Log => put_log(
                &mut self.sender,
                &mut self.logged,
                &mut estimation,
                snapshot,
                now_us,
                output,
            ),
            _ => {
                if let Some(snapshot) = snapshot {
                    put_frame(format, snapshot, self.frames_sent, output);
                    self.frames_sent = self.frames_sent.wrapping_add(1);
                }
            }
        }
        let length = output.length();
        self.transmitter.send(length);
    }

    /// Posts a message about bursts that failed since the last tick. Returns their number since boot.
    fn report_failures(&mut self, post: &mut impl FnMut(Message)) -> u16 {
        let (failures, failure) = burst_reader::failures();
        let count = failures.wrapping_sub(self.last_failures);
        if let (1.., Some(failure)) = (count, failure) {
            self.last_failures = failures;
            post(Message::BurstsFailed { failure, count });
        }
        failures
    }

    /// The latest snapshot, if a frame is due with this tick and the snapshot has not been sent.
    fn due_snapshot(&mut self, pace: Pace) -> Option<Snapshot> {
        timebase::set_telemetry_period_us(pace.period_us);
        self.tick += 1;
        if self.tick < pace.ticks {
            return None;
        }
        self.tick = 0;
        let (snapshot, number) = publish::latest()?;
        let is_new = number != core::mem::replace(&mut self.last_published, number);
        is_new.then_some(snapshot)
    }

    /// Starts or ends the flow of bursts to the log.
    fn follow_log_format(&mut self, is_log: bool) {
        if is_log != IS_LOGGING.swap(is_log, Ordering::Relaxed) {
            while self.logged.dequeue().is_some() {}
            self.sender.restart(BURST_COUNT.load(Ordering::Relaxed));
        }
    }
}

/// Lets the console read one line, or the ground station ask for one command. Returns the kind of the answer.
fn poll_console<E, R>(
    console: &mut Console,
    port: &mut ModulePort<'_, E, R>,
    answer: &mut heapless::String<ANSWER_CAPACITY>,
) -> Option<Kind>
where
    E: Mutex<T = Estimation>,
    R: Mutex<T = Requests>,
{
    if let Some(kind) = console.poll(timebase::now(), port, answer) {
        port.station.on_answer(kind);
        return Some(kind);
    }
    let (ticket, command) = port.station.take_command()?;
    let kind = console.execute(command, timebase::now(), port, answer);
    port.station.answer(ticket, command, kind);
    Some(kind)
}

/// Writes a line of the module in this format, and to the log over RTT.
#[inline(never)]
fn put_text(
    format: OutputFormat,
    severity: Severity,
    line: &str,
    station: &mut GroundStation,
    output: &mut Output<'_>,
) {
    match format {
        OutputFormat::Mavlink => {
            station.session.send_text(severity, line, output);
        }
        OutputFormat::Log => {
            log::put_text(line, output);
        }
        _ => {
            if output.has_room(line.len() + 3) {
                output.put(b"# ");
                output.put(line.as_bytes());
                output.put(b"\n");
            }
        }
    }
    match severity {
        Severity::Information => defmt::info!("{=str}", line),
        Severity::Warning => defmt::warn!("{=str}", line),
        Severity::Error => defmt::error!("{=str}", line),
    }
}

/// Writes the MAVLink messages that are due.
fn put_mavlink(
    station: &mut GroundStation,
    console: &Console,
    estimation: &mut impl Mutex<T = Estimation>,
    snapshot: Option<&Snapshot>,
    now_us: u64,
    bursts_failed: u16,
    output: &mut Output<'_>,
) {
    let (sample, temperature_celsius) = estimation.lock(|estimation| {
        let pipeline = estimation.pipeline.as_ref();
        pipeline.map_or((Sample::default(), 0.0), |pipeline| {
            (*pipeline.sample(), pipeline.temperature_celsius())
        })
    });
    let vehicle = Vehicle {
        snapshot,
        sample: &sample,
        temperature_celsius,
        record: console.working(),
        is_armed: console.is_armed(),
        bursts_failed,
    };
    station.session.fill(now_us, &vehicle, output);
}

/// Writes the flight log's frames, and copies the pipeline for it when a state is due.
fn put_log(
    sender: &mut Sender,
    logged: &mut Consumer<'static, NumberedBurst>,
    estimation: &mut impl Mutex<T = Estimation>,
    snapshot: Option<&Snapshot>,
    now_us: u64,
    output: &mut Output<'_>,
) {
    if sender.wants_state(now_us)
        && let Some((latest, _)) = publish::latest()
        && timebase::now().wrapping_sub(latest.t_us as u32) < COPY_WINDOW_US
    {
        estimation.lock(|estimation| {
            if let Some(pipeline) = &estimation.pipeline {
                sender.copy_state(pipeline, BURST_COUNT.load(Ordering::Relaxed));
            }
        });
        sender.measure_state(now_us);
    }
    if let Some(snapshot) = snapshot {
        log::put_attitude(snapshot, output);
    }
    sender.fill(now_us, output, || logged.dequeue());
}

/// Writes a snapshot in a format of one frame each, and to the log over RTT if it is text.
fn put_frame(format: OutputFormat, snapshot: &Snapshot, counter: u8, output: &mut Output<'_>) {
    let mut frame = [0; FRAME_CAPACITY];
    let frame = formats::encode(format, snapshot, counter, &mut frame);
    output.put(frame);
    let line = frame.strip_suffix(b"\n").unwrap_or(frame);
    if let Ok(line) = core::str::from_utf8(line) {
        defmt::info!("{=str}", line);
    }
}

const fn severity(kind: Kind) -> Severity {
    match kind {
        Kind::Ok | Kind::Progress | Kind::Done => Severity::Information,
        Kind::Error | Kind::Failed => Severity::Warning,
    }
}
