//! Telemetry task: each tick polls the console, and sends its answer, messages and the latest
//! snapshot in one buffer.
//!
//! Deadline: none. The task has the lowest priority of those with interrupts. Output that does not
//! fit is dropped and counted; the task never waits.

use core::fmt::Write;
use core::sync::atomic::Ordering;

use aplomb::board::compass::{set_logging, take_change};
use aplomb::board::uart::{self, Transmitter};
use aplomb::board::{attitude_task, burst_reader, heading, retained, timebase, watchdog};
use aplomb::compass;
use aplomb::console::answer::{ANSWER_CAPACITY, Kind};
use aplomb::fault::FaultClass;
use aplomb::health::FlagReport;
use aplomb::pipeline::{CompassReading, Snapshot};
use aplomb::settings::OutputFormat;
use aplomb::telemetry::heading::LINES_LENGTH as HEADING_LENGTH;
use aplomb::telemetry::log::{self, NumberedBurst, Sender, TimedHeading};
use aplomb::telemetry::message::{self, Message, Severity};
use aplomb::telemetry::{self as formats, FRAME_CAPACITY, Mailbox, Output, Pace, text_room};
use heapless::spsc::Consumer;
use rtic::Mutex;

use crate::after_publication::BURST_COUNT;
use crate::commands::Commands;
use crate::estimation::{Estimation, Latest};
use crate::requests::{AFTER_PUBLICATION, LOG, Requests};

/// True if this build sends the flight log.
const HAS_LOG: bool = cfg!(feature = "full");
/// Room for a tick's answer, with its mark and line end, beside a frame.
const ANSWER_ROOM: usize = ANSWER_CAPACITY + 16;
const _: () = assert!(ANSWER_ROOM + FRAME_CAPACITY <= uart::CAPACITY);
/// Room for a message.
const MESSAGE_ROOM: usize = text_room(message::LINE_CAPACITY);
const _: () = assert!(MESSAGE_ROOM <= ANSWER_ROOM && text_room(ANSWER_CAPACITY) <= uart::CAPACITY);
/// Longest time from a sample to the copy of the pipeline for the log, in µs, so that no attitude
/// waits for the copy.
const COPY_WINDOW_US: u32 = 900;

/// Input of the flight log.
pub struct LogInput {
    /// Bursts.
    pub bursts: Consumer<'static, NumberedBurst>,
    /// Readings of the compass.
    pub readings: Consumer<'static, CompassReading>,
}

/// State of the telemetry task.
pub struct Telemetry {
    transmitter: Transmitter,
    commands: Commands,
    log_input: LogInput,
    sender: Sender,
    now_us: u64,
    frames_sent: u8,
    last_published: u32,
    last_failures: u16,
    tick: u16,
    flag_report: FlagReport,
}

impl Telemetry {
    /// Creates the telemetry over this UART. `log_input` delivers the input of the flight log.
    pub fn new(transmitter: Transmitter, commands: Commands, log_input: LogInput) -> Self {
        Self {
            transmitter,
            commands,
            log_input,
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
        watchdog::report_telemetry();
        let mut post = |message| messages.lock(|messages| messages.post(message));
        let failures = self.report_failures(&mut post);
        self.commands.check_reception(self.transmitter.baud());
        // Ticks come much more often than the count wraps.
        self.now_us += u64::from(timebase::now().wrapping_sub(self.now_us as u32));
        let preferences = self.commands.preferences();
        let format = preferences.format;
        let latest = &self.due_snapshot(Pace::new(format, preferences.rate_hz));
        if let Some(latest) = latest {
            self.report_flags(&latest.snapshot, &mut post);
        }
        if !self.transmitter.is_idle() {
            if latest.is_some() {
                retained::count(FaultClass::TelemetryLate);
            }
            return;
        }
        report_compass(&mut estimation, &mut messages);
        self.follow_log_format(HAS_LOG && format == OutputFormat::Log);
        let answer = self.commands.poll(
            self.now_us,
            failures,
            &mut self.transmitter,
            &mut estimation,
            requests,
        );
        if let Some(number) = answer.changed_at {
            self.sender.restart(number);
        }
        let (rate_hz, baud) = (preferences.rate_hz.into(), self.transmitter.baud());
        let has_room = formats::has_room_for_heading(format, rate_hz, baud);
        let Some(buffer) = self.transmitter.idle_buffer() else {
            return;
        };
        let output = &mut Output::new(buffer);
        // The answer to a command that changes the format still comes in the old one.
        if let Some(kind) = answer.kind {
            put_text(
                format,
                severity(kind),
                &answer.text,
                &mut self.commands,
                output,
            );
        }
        put_posted(format, &mut messages, &mut self.commands, output);
        let (now_us, latest) = (self.now_us, latest.as_ref());
        match format {
            OutputFormat::Mavlink => {
                let (commands, is_due) = (&mut self.commands, latest.is_some());
                commands.put_messages(&mut estimation, is_due, now_us, failures, output);
            }
            OutputFormat::Log if HAS_LOG => put_log(
                &mut self.sender,
                &mut self.log_input,
                &mut estimation,
                latest.map(|latest| &latest.snapshot),
                now_us,
                output,
            ),
            _ => {
                if let Some(latest) = latest {
                    put_frame(format, &latest.snapshot, self.frames_sent, output);
                    self.frames_sent = self.frames_sent.wrapping_add(1);
                    if has_room {
                        put_heading(format, latest, output);
                    }
                }
            }
        }
        let length = output.length();
        self.transmitter.send(length);
    }

    /// Posts a message about bursts that failed since the last tick. Returns their number since
    /// boot.
    fn report_failures(&mut self, post: &mut impl FnMut(Message)) -> u16 {
        let (failures, failure) = burst_reader::failures();
        let count = failures.wrapping_sub(self.last_failures);
        if let (1.., Some(failure)) = (count, failure) {
            self.last_failures = failures;
            post(Message::BurstsFailed { failure, count });
        }
        failures
    }

    /// Posts a message about lasting flags of the attitude.
    fn report_flags(&mut self, snapshot: &Snapshot, post: &mut impl FnMut(Message)) {
        if let Some(flags) = self.flag_report.update(snapshot.flags, self.now_us as u32) {
            post(Message::Attitude(flags));
        }
    }

    /// Returns the latest snapshot with its heading if a frame is due with this tick and the
    /// snapshot has not been sent.
    fn due_snapshot(&mut self, pace: Pace) -> Option<Latest> {
        timebase::set_telemetry_period_us(pace.period_us);
        self.tick += 1;
        if self.tick < pace.ticks {
            return None;
        }
        // While the last output is being sent, the frame waits for the next tick, unless the next
        // frame is due then.
        let is_next_due = self.tick + 1 >= 2 * pace.ticks;
        if !self.transmitter.is_idle() && !is_next_due {
            return None;
        }
        self.tick %= pace.ticks;
        let (latest, number) = Latest::read()?;
        let is_new = number != core::mem::replace(&mut self.last_published, number);
        is_new.then_some(latest)
    }

    /// Starts or ends the flow of bursts to the log.
    fn follow_log_format(&mut self, is_log: bool) {
        if HAS_LOG && is_log != AFTER_PUBLICATION.set(LOG, is_log) {
            while self.log_input.bursts.dequeue().is_some() {}
            if compass::IS_BUILT_IN {
                set_logging(is_log);
                while self.log_input.readings.dequeue().is_some() {}
            }
            self.sender.restart(BURST_COUNT.load(Ordering::Relaxed));
        }
    }
}

/// Posts the message about the compass, if its status has changed.
fn report_compass(
    estimation: &mut impl Mutex<T = Estimation>,
    messages: &mut impl Mutex<T = Mailbox>,
) {
    if !compass::IS_BUILT_IN || !take_change() {
        return;
    }
    let status = estimation.lock(|estimation| estimation.compass.status());
    let message = match (status.fault, status.part) {
        (Some(fault), _) => Message::CompassFailed(fault),
        (None, Some((part, address))) => Message::CompassConfigured { part, address },
        (None, None) => return,
    };
    messages.lock(|messages| messages.post(message));
}

/// Writes the messages in the mailbox, as many as fit beside a frame.
fn put_posted(
    format: OutputFormat,
    messages: &mut impl Mutex<T = Mailbox>,
    commands: &mut Commands,
    output: &mut Output<'_>,
) {
    while output.has_room(MESSAGE_ROOM + FRAME_CAPACITY)
        && let Some(message) = messages.lock(Mailbox::take)
    {
        let mut line = heapless::String::<{ message::LINE_CAPACITY }>::new();
        // A test checks that the longest message fits.
        write!(line, "{message}").ok();
        put_text(format, message.severity(), &line, commands, output);
    }
}

/// Writes a line of the module in this format, and to the log over RTT.
#[inline(never)]
fn put_text(
    format: OutputFormat,
    severity: Severity,
    line: &str,
    commands: &mut Commands,
    output: &mut Output<'_>,
) {
    match format {
        OutputFormat::Mavlink => {
            commands.put_text(severity, line, output);
        }
        OutputFormat::Log if HAS_LOG => {
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

/// Writes the flight log's frames, and copies the pipeline for it when a state is due.
fn put_log(
    sender: &mut Sender,
    log_input: &mut LogInput,
    estimation: &mut impl Mutex<T = Estimation>,
    snapshot: Option<&Snapshot>,
    now_us: u64,
    output: &mut Output<'_>,
) {
    let wants_heading = compass::IS_BUILT_IN && sender.wants_heading();
    if (sender.wants_state(now_us) || wants_heading)
        && let Some((latest, _)) = attitude_task::latest()
        && timebase::now().wrapping_sub(latest.t_us as u32) < COPY_WINDOW_US
    {
        estimation.lock(|estimation| {
            let next_number = BURST_COUNT.load(Ordering::Relaxed);
            if wants_heading {
                let (filter, next_reading) = estimation.compass.heading_filter();
                sender.copy_heading(filter, next_reading, next_number);
            } else if let Some(pipeline) = &estimation.pipeline {
                sender.copy_state(pipeline, next_number);
            }
        });
        sender.measure_state(now_us);
    }
    if let Some(snapshot) = snapshot {
        log::put_attitude(snapshot, output);
        if compass::IS_BUILT_IN
            && let Some((t_us, estimate)) = heading::latest_change()
        {
            sender.put_heading(now_us, TimedHeading { t_us, estimate }, output);
        }
    }
    let LogInput { bursts, readings } = log_input;
    sender.fill(now_us, output, || bursts.dequeue(), || readings.dequeue());
}

/// Writes a snapshot in a format of one frame each, and to the log over RTT if it is text.
fn put_frame(format: OutputFormat, snapshot: &Snapshot, counter: u8, output: &mut Output<'_>) {
    let mut frame = [0; FRAME_CAPACITY];
    let frame = formats::encode(format, snapshot, counter, &mut frame);
    output.put(frame);
    let line = frame.strip_suffix(b"\n").unwrap_or(frame);
    // By chance a Teapot packet is text too.
    if format != OutputFormat::Teapot
        && let Ok(line) = core::str::from_utf8(line)
    {
        defmt::info!("{=str}", line);
    }
}

/// Writes the heading's lines if it is known and there is room, and to the log over RTT.
#[inline(never)]
fn put_heading(format: OutputFormat, latest: &Latest, output: &mut Output<'_>) {
    // Without the feature the firmware has no code of the heading.
    let Some(heading) = latest.heading.filter(|_| compass::IS_BUILT_IN) else {
        return;
    };
    let mut lines = [0; HEADING_LENGTH];
    let lines = formats::encode_heading(format, &latest.snapshot, &heading, &mut lines);
    output.put(lines);
    let line = lines.strip_suffix(b"\n").unwrap_or(lines);
    if let Ok(line) = core::str::from_utf8(line)
        && !line.is_empty()
    {
        defmt::info!("{=str}", line);
    }
}

const fn severity(kind: Kind) -> Severity {
    match kind {
        Kind::Ok | Kind::Progress | Kind::Done => Severity::Information,
        Kind::Error | Kind::Failed => Severity::Warning,
    }
}
