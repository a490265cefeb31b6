//! The firmware: which interrupt does what, at which priority. What each step does stands in `aplomb::board` and in the library.
//!
//! | task | priority | started by | must end before |
//! |---|---|---|---|
//! | `data_ready`, `bus_event`, `bus_error`, `transfer_complete` | 4 | INT pin, I2C1, DMA1 stream 0 | the next bus event, 22 µs |
//! | `check_settings` | 4 | `attitude`, every 22 ms | the next bus event, 22 µs |
//! | `time` | 4 | TIM5: counter wrap, alarms, telemetry ticks | the next bus event, 22 µs |
//! | `attitude` | 3 | `transfer_complete` | the end of the next burst, 1 ms |
//! | `telemetry` | 1 | `time`, at least 50 times a second | nothing: it skips a line rather than wait |
//! | `idle` | 0 | – | nothing: it configures the sensor, at start and after faults, and does what needs it to stop |
//!
//! Commands run in `telemetry`. What they do to the pipeline keeps `attitude` waiting for the length of one lock.

#![no_std]
#![no_main]

use defmt_rtt as _;
/// Ends in the hard fault that `aplomb::board::crash` notes. What the panic says is left out, for it would take 4 KiB of flash with all
/// that the compiler knows to say: a debugger that stops at the fault shows file and line.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::asm::udf()
}

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true, dispatchers = [SPI2])]
mod app {
    use core::fmt::Write;
    use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

    use aplomb::board::boards::BOARD;
    use aplomb::board::burst_reader::{self, BurstReader};
    use aplomb::board::flash::CalibrationFlash;
    use aplomb::board::sensor::{self, NotReady, Sensor};
    use aplomb::board::sensor_bus::SensorBus;
    use aplomb::board::timebase::{self, Delay, Timebase};
    use aplomb::board::uart::{self, ReceiveRing, Receiver, Reception, Transmitter};
    use aplomb::board::upkeep::Upkeep;
    use aplomb::board::{clocks, pins, publish, retained, watchdog};
    use aplomb::calibration::{Calibration, Mount, OutputFormat, RestProgress, storage};
    use aplomb::console::answer::{ANSWER_CAPACITY, Kind};
    use aplomb::console::ground_station::GroundStation;
    use aplomb::console::{Console, Module, Outcome, State, Task};
    use aplomb::estimator::Sample;
    use aplomb::estimator::kalman::{Kalman, Known};
    use aplomb::fault::{ClockSource, FaultClass, ResetCause};
    use aplomb::health::{FlagReport, Flags};
    use aplomb::mpu6050::{self, Config, Part};
    use aplomb::pipeline::Snapshot;
    use aplomb::pipeline::{Pipeline, Settings};
    use aplomb::telemetry::log::{self, NumberedBurst, Sender};
    use aplomb::telemetry::mavlink::Vehicle;
    use aplomb::telemetry::message::{self, Mailbox, Message, Severity};
    use aplomb::telemetry::{self as formats, FRAME_CAPACITY, Output, Pace};
    use embedded_hal::delay::DelayNs;
    use heapless::spsc::{Consumer, Producer, Queue};
    use rtic::Mutex;
    use stm32f4xx_hal::pac::Interrupt;

    /// The crystal has stopped. The burst reader, which this calls by its alarm, brings the clock back.
    #[cortex_m_rt::exception]
    unsafe fn NonMaskableInt() {
        clocks::acknowledge_failure();
        timebase::raise_burst_alarm();
    }

    /// So long may a task of the idle task take: to erase a sector of 16 KiB, which stalls the core for half a second
    /// (STM32F405 datasheet, table "Flash memory programming"), and to test the sensor.
    const TASK_LIMIT_MS: u32 = 2_000;
    /// So long no sample comes when the sensor was stopped on purpose, at least: longer than the filter bridges, so that the
    /// attitude says [`Flags::GAP`] and starts again from gravity instead of guessing.
    const PAUSE_US: u32 = 600_000;
    /// A recovery that begins sooner after the last one that was told is not told, so that what is has room, in µs.
    const QUIET_US: u32 = 200_000;
    /// Room that a tick's answer, with its mark and line end, needs beside a frame.
    const ANSWER_ROOM: usize = ANSWER_CAPACITY + 16;
    const _: () = assert!(ANSWER_ROOM + FRAME_CAPACITY <= uart::CAPACITY);
    /// Room for so many letters in any format: a MAVLink frame for each 50 of them is the longest.
    const fn room(letters: usize) -> usize {
        letters.div_ceil(50) * 66
    }
    /// Room for a message.
    const MESSAGE_ROOM: usize = room(message::LINE_CAPACITY);
    const _: () = assert!(MESSAGE_ROOM <= ANSWER_ROOM && room(ANSWER_CAPACITY) <= uart::CAPACITY);
    /// Bursts on their way to the flight log: three ticks' worth.
    const LOG_BURSTS: usize = 32;
    /// The pipeline is copied for the log at most so long after a sample, in µs, so that no attitude waits for the copy.
    const COPY_WINDOW_US: u32 = 900;
    /// How the sensor sits in the vehicle unless a stored mount says otherwise; set at build time.
    const MOUNT: Mount = match option_env!("APLOMB_MOUNT") {
        None => Mount::Z_UP,
        Some(name) => match Mount::parse(name) {
            Some(mount) => mount,
            None => panic!("APLOMB_MOUNT takes forward then down, such as +x-z, or z-up or z-down"),
        },
    };
    /// The pipeline's settings before the sensor is known.
    const SETTINGS: Settings = {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.mount = MOUNT;
        settings
    };

    #[shared]
    struct Shared {
        #[lock_free]
        reader: BurstReader,
        #[lock_free]
        timebase: Timebase,
        pipeline: Option<Pipeline<Kalman>>,
        messages: Mailbox,
        /// What the watch over rest has seen last and nobody has taken yet.
        rest: Option<RestProgress>,
        desk: Desk,
    }

    /// Between the console and the idle task.
    pub struct Desk {
        sensor: Option<(&'static Part, u8)>,
        calibration: Calibration,
        is_armed: bool,
        task: Option<Task>,
        outcome: Option<Outcome>,
    }

    /// The idle task looks at it without a lock.
    static TASK_WAITS: AtomicBool = AtomicBool::new(false);

    /// Whether bursts are wanted for the flight log.
    static LOGS: AtomicBool = AtomicBool::new(false);
    /// Bursts that the pipeline has taken; changes under its lock.
    static BURSTS_TAKEN: AtomicU32 = AtomicU32::new(0);

    #[local]
    struct Local {
        sensor: Sensor,
        known: Option<Known>,
        flash: CalibrationFlash,
        transmitter: Transmitter,
        receiver: Receiver,
        console: Console,
        to_log: Producer<'static, NumberedBurst>,
        logged: Consumer<'static, NumberedBurst>,
        station: GroundStation,
        sender: Sender<Kalman>,
    }

    #[init(local = [
        uart_buffer: [u8; uart::CAPACITY] = [0; uart::CAPACITY],
        log_queue: Queue<NumberedBurst, LOG_BURSTS> = Queue::new(),
    ])]
    fn init(context: init::Context) -> (Shared, Local) {
        static RING: ReceiveRing = [const { AtomicU8::new(0) }; uart::RECEIVE_CAPACITY];
        let device = context.device;
        let start = retained::start(&device.RCC);
        watchdog::start(&device.IWDG, &device.DBGMCU);
        let (_, clock) = clocks::start(device.RCC);
        if clock == ClockSource::Crystal {
            clocks::watch_crystal();
        }
        pins::start(device.GPIOA, device.SYSCFG, device.EXTI);
        let timebase = Timebase::start(device.TIM5);
        let bus = SensorBus::new(device.I2C1, device.GPIOB);
        let mut messages = Mailbox::new();
        messages.post(Message::Started {
            board: BOARD.name,
            core_mhz: (BOARD.core_hz / 1_000_000) as u16,
            clock,
        });
        if start.cause != ResetCause::Power || start.starts > 1 {
            messages.post(Message::Restarted {
                cause: start.cause,
                last_fault: start.last_fault,
                crash_address: start.crash_address,
            });
        }
        // A sensor that the run before has brought up only has to be looked at.
        let sensor = Sensor::new(bus, Config::DEFAULT, start.known.is_some());
        let mut flash = CalibrationFlash::new(device.FLASH);
        let storage::Loaded { record, problem } = storage::load(&mut flash);
        if let Some(problem) = problem {
            messages.post(Message::RecordProblem(problem));
        }
        if record.is_some() {
            messages.post(Message::RecordLoaded);
        }
        let console = Console::new(
            record,
            SETTINGS.rest_scale(),
            SETTINGS.sensor.sample_rate_hz(),
            MOUNT,
        );
        let baud = console.working().preferences.baud;
        let (transmitter, receiver) =
            uart::start(device.USART2, baud, context.local.uart_buffer, &RING);
        let (to_log, logged) = context.local.log_queue.split();
        (
            Shared {
                reader: BurstReader::start(),
                timebase,
                pipeline: None,
                messages,
                rest: None,
                desk: Desk {
                    sensor: None,
                    calibration: console.working().calibration,
                    is_armed: false,
                    task: None,
                    outcome: None,
                },
            },
            Local {
                sensor,
                known: start.known,
                flash,
                transmitter,
                receiver,
                console,
                to_log,
                logged,
                station: GroundStation::new(),
                sender: Sender::new(0),
            },
        )
    }

    #[idle(local = [sensor, known, flash], shared = [pipeline, messages, desk])]
    fn idle(context: idle::Context) -> ! {
        let idle::LocalResources {
            sensor,
            known,
            flash,
            ..
        } = context.local;
        let idle::SharedResources {
            mut pipeline,
            mut messages,
            mut desk,
            ..
        } = context.shared;
        let mut post = |message| messages.lock(|messages| messages.post(message));
        let mut last_complaint = None;
        let mut is_told = true;
        // The first one is told however early it comes.
        let mut told_at = timebase::now().wrapping_sub(QUIET_US);
        loop {
            watchdog::samples_go_on();
            match sensor.make_ready() {
                Ok(ready) => {
                    is_told |= last_complaint.take().is_some();
                    let (calibration, is_armed) = desk.lock(|desk| {
                        desk.sensor = Some((ready.part, ready.address));
                        (desk.calibration, desk.is_armed)
                    });
                    // After a fault the filter goes on with what it knows.
                    pipeline.lock(|pipeline| {
                        if pipeline.is_none() {
                            let known = known.take();
                            start_pipeline(pipeline, ready.part, calibration, is_armed, known);
                        }
                    });
                    burst_reader::enable(&ready, &Config::DEFAULT);
                    if is_told {
                        post(Message::SensorConfigured {
                            part: ready.part.name,
                            address: ready.address,
                        });
                    }
                    timebase::sleep_until(|| {
                        !burst_reader::is_enabled() || TASK_WAITS.load(Ordering::Acquire)
                    });
                    if burst_reader::is_enabled() {
                        burst_reader::pause();
                        is_told = true;
                    } else {
                        // A fault that lasts is recovered from in vain, hundreds of times a second.
                        is_told = timebase::elapsed(told_at, QUIET_US);
                        if is_told {
                            told_at = timebase::now();
                            post(Message::Recovering);
                        }
                    }
                }
                Err(reason) => {
                    // It may have been powered up together with the processor.
                    let is_patient = reason == NotReady::Sensor(mpu6050::Error::NotFound)
                        && sensor.may_be_starting();
                    // Said once, and tried many times.
                    if !is_patient && last_complaint.replace(reason) != Some(reason) {
                        post(complaint(reason));
                    }
                    Delay.delay_ms(sensor::RETRY_MS);
                }
            }
            if TASK_WAITS.swap(false, Ordering::Acquire)
                && let Some(task) = desk.lock(|desk| desk.task.take())
            {
                let since = timebase::now();
                watchdog::allow_ms(TASK_LIMIT_MS);
                let outcome = perform(&task, sensor, flash);
                watchdog::allow_ms(watchdog::LIMIT_MS);
                desk.lock(|desk| desk.outcome = Some(outcome));
                timebase::sleep_until(|| {
                    watchdog::samples_go_on();
                    timebase::elapsed(since, PAUSE_US)
                });
            }
        }
    }

    /// Apart from the idle task, whose frame stays on the stack for ever.
    #[inline(never)]
    fn start_pipeline(
        place: &mut Option<Pipeline<Kalman>>,
        part: &'static Part,
        calibration: Calibration,
        is_armed: bool,
        known: Option<Known>,
    ) {
        let settings = Settings {
            part,
            calibration,
            ..SETTINGS
        };
        let pipeline = place.insert(Pipeline::with_filter(&settings, Kalman::new()));
        pipeline.set_armed(is_armed);
        if let Some(known) = &known {
            pipeline.resume(known);
        }
    }

    /// What stands in the way of samples.
    fn complaint(reason: NotReady) -> Message {
        match reason {
            NotReady::BusHeldLow(held) => Message::BusHeldLow { clock: held.clock },
            NotReady::Sensor(error) => Message::SensorFailed(error),
        }
    }

    /// Does what the sensor was stopped for.
    #[inline(never)]
    fn perform(task: &Task, sensor: &mut Sensor, flash: &mut CalibrationFlash) -> Outcome {
        match task {
            Task::Save(record) => match storage::save(flash, record) {
                Ok(()) => Outcome::new(true, "stored"),
                Err(error) => Outcome::new(false, error),
            },
            Task::SelfTest => match sensor.test() {
                Ok(result) => Outcome::new(result.has_passed() != Some(false), result),
                Err(reason) => Outcome::new(false, complaint(reason)),
            },
        }
    }

    #[task(binds = EXTI1, priority = 4, shared = [reader, timebase])]
    fn data_ready(context: data_ready::Context) {
        context.shared.reader.on_data_ready(context.shared.timebase);
    }

    #[task(binds = I2C1_EV, priority = 4, shared = [reader])]
    fn bus_event(context: bus_event::Context) {
        context.shared.reader.on_bus_event();
    }

    #[task(binds = I2C1_ER, priority = 4, shared = [reader])]
    fn bus_error(context: bus_error::Context) {
        context.shared.reader.on_bus_error();
    }

    #[task(binds = SPI1, priority = 4, shared = [reader])]
    fn check_settings(context: check_settings::Context) {
        context.shared.reader.on_check_request();
    }

    #[task(binds = DMA1_STREAM0, priority = 4, shared = [reader, timebase])]
    fn transfer_complete(context: transfer_complete::Context) {
        if context
            .shared
            .reader
            .on_transfer_complete(context.shared.timebase)
        {
            rtic::pend(Interrupt::SPI3);
        }
    }

    #[task(binds = TIM5, priority = 4, shared = [reader, timebase])]
    fn time(context: time::Context) {
        let alarms = context.shared.timebase.on_interrupt();
        if alarms.burst && context.shared.reader.on_alarm(context.shared.timebase) {
            rtic::pend(Interrupt::SPI3);
        }
        if alarms.telemetry {
            // A line that is still being written makes this one come later: none waits for it.
            telemetry::spawn().ok();
        }
    }

    #[task(binds = SPI3, priority = 3, shared = [pipeline, messages, rest], local = [to_log, upkeep: Upkeep = Upkeep::new()])]
    fn attitude(mut context: attitude::Context) {
        let attitude::LocalResources { to_log, upkeep, .. } = context.local;
        let mut rest = None;
        let change = context.shared.pipeline.lock(|pipeline| {
            let Some(pipeline) = pipeline.as_mut() else {
                watchdog::attitude_goes_on();
                return None;
            };
            let sampled = burst_reader::with_burst(|burst, flags| {
                let aftermath = pipeline.update_and_publish(
                    burst,
                    flags,
                    retained::show_variance,
                    publish::publish,
                );
                // The attitude is out; what follows has time until the next burst.
                let number = BURSTS_TAKEN.load(Ordering::Relaxed);
                BURSTS_TAKEN.store(number.wrapping_add(1), Ordering::Relaxed);
                if LOGS.load(Ordering::Relaxed) {
                    // What finds no room is missing in the log, and its number says so.
                    to_log
                        .enqueue(NumberedBurst {
                            number,
                            flags,
                            burst: *burst,
                        })
                        .ok();
                }
                rest = pipeline.collect(burst);
                upkeep.after_sample(pipeline, aftermath)
            });
            if let Some(change) = sampled {
                return change;
            }
            let (t_us, flags) = burst_reader::take_stale()?;
            let snapshot = pipeline.stale(t_us, flags);
            retained::show_variance(pipeline.tilt_variance_rad2(t_us));
            publish::publish(&snapshot);
            upkeep.after_silence(&snapshot)
        });
        if let Some(seen @ (RestProgress::Moved(_) | RestProgress::Done(_))) = rest {
            context.shared.rest.lock(|rest| *rest = Some(seen));
        }
        let Some((last, flags)) = change else {
            return;
        };
        let message = if flags.contains(Flags::MOVED) {
            Message::MovedAtStart
        } else if last.contains(Flags::CALIBRATING)
            && !flags.intersects(Flags::CALIBRATING | Flags::STALE)
        {
            Message::OffsetMeasured
        } else {
            return;
        };
        context
            .shared
            .messages
            .lock(|messages| messages.post(message));
    }

    #[task(
        priority = 1,
        shared = [pipeline, messages, rest, desk],
        local = [
            transmitter, receiver, console, logged, station, sender,
            now_us: u64 = 0,
            frames_sent: u8 = 0,
            last_published: u32 = 0,
            last_failures: u16 = 0,
            tick: u16 = 0,
            flag_report: FlagReport = FlagReport::new(),
        ],
    )]
    async fn telemetry(context: telemetry::Context) {
        let telemetry::LocalResources {
            transmitter,
            receiver,
            console,
            logged,
            station,
            sender,
            now_us,
            frames_sent,
            last_published,
            last_failures,
            tick,
            flag_report,
            ..
        } = context.local;
        let mut messages = context.shared.messages;

        watchdog::telemetry_goes_on();
        let (failures, failure) = burst_reader::failures();
        let count = failures.wrapping_sub(*last_failures);
        if let (1.., Some(failure)) = (count, failure) {
            *last_failures = failures;
            post(&mut messages, Message::BurstsFailed { failure, count });
        }
        let has_reception_error = receiver.look(transmitter.baud()) != Reception::Sound;
        if has_reception_error {
            retained::count(FaultClass::UartInput);
        }

        // This runs much more often than the count wraps.
        *now_us += u64::from(timebase::now().wrapping_sub(*now_us as u32));
        let now_us = *now_us;
        let preferences = console.working().preferences;
        let format = preferences.format;
        let pace = Pace::of(format, preferences.rate_hz);
        timebase::set_telemetry_period_us(pace.period_us);
        *tick += 1;
        let is_due = *tick >= pace.ticks;
        let snapshot = if is_due {
            *tick = 0;
            next_snapshot(last_published)
        } else {
            None
        };
        if let Some(snapshot) = &snapshot
            && let Some(flags) = flag_report.update(snapshot.flags, now_us as u32)
        {
            post(&mut messages, Message::Attitude(flags));
        }
        if !transmitter.is_idle() {
            if snapshot.is_some() {
                retained::count(FaultClass::TelemetryLate);
            }
            return;
        }
        let logs = format == OutputFormat::Log;
        if logs != LOGS.swap(logs, Ordering::Relaxed) {
            while logged.dequeue().is_some() {}
            sender.restart(BURSTS_TAKEN.load(Ordering::Relaxed));
        }

        let mut hands = Hands {
            receiver,
            transmitter,
            pipeline: context.shared.pipeline,
            rest: context.shared.rest,
            desk: context.shared.desk,
            has_reception_error,
            station,
            is_mavlink: format == OutputFormat::Mavlink,
            now_us,
            changed_at: None,
            state: State {
                bursts_failed: failures,
                reception_errors: retained::counted(FaultClass::UartInput),
                frames_dropped: retained::counted(FaultClass::TelemetryLate),
                ..State::default()
            },
        };
        let mut answer = heapless::String::<ANSWER_CAPACITY>::new();
        let mut kind = console.poll(timebase::now(), &mut hands, &mut answer);
        match kind {
            Some(kind) => hands.station.hear(kind),
            None => {
                if let Some((ticket, command)) = hands.station.take_command() {
                    let said = console.execute(command, timebase::now(), &mut hands, &mut answer);
                    hands.station.answer(ticket, command, said);
                    kind = Some(said);
                }
            }
        }
        if let Some(number) = hands.changed_at {
            sender.restart(number);
        }
        let bursts_failed = hands.state.bursts_failed;
        let mut pipeline = hands.pipeline;
        let Some(buffer) = transmitter.idle_buffer() else {
            return;
        };
        let output = &mut Output::new(buffer);
        // The answer to a command that changes the format still comes in the old one.
        if let Some(kind) = kind {
            // The room was made for it.
            say(format, answer_severity(kind), &answer, station, output);
            log_text(answer_severity(kind), &answer);
        }
        while output.has_room(MESSAGE_ROOM + FRAME_CAPACITY)
            && let Some(message) = messages.lock(Mailbox::take)
        {
            let mut line = heapless::String::<{ message::LINE_CAPACITY }>::new();
            // A test holds the longest message to its line.
            write!(line, "{message}").ok();
            say(format, message.severity(), &line, station, output);
            log_text(message.severity(), &line);
        }
        match format {
            OutputFormat::Mavlink => {
                let (sample, temperature_celsius) = pipeline.lock(|pipeline| {
                    pipeline
                        .as_ref()
                        .map_or((Sample::default(), 0.0), |pipeline| {
                            (*pipeline.sample(), pipeline.temperature_celsius())
                        })
                });
                let vehicle = Vehicle {
                    snapshot: snapshot.as_ref(),
                    sample: &sample,
                    temperature_celsius,
                    record: console.working(),
                    is_armed: console.is_armed(),
                    bursts_failed,
                };
                station.session.fill(now_us, &vehicle, output);
            }
            OutputFormat::Log => {
                if sender.wants_state(now_us)
                    && let Some((latest, _)) = publish::latest()
                    && timebase::now().wrapping_sub(latest.t_us as u32) < COPY_WINDOW_US
                {
                    pipeline.lock(|pipeline| {
                        if let Some(pipeline) = pipeline {
                            let next = BURSTS_TAKEN.load(Ordering::Relaxed);
                            sender.copy_state(pipeline, next);
                        }
                    });
                    sender.measure_state(now_us);
                }
                if let Some(snapshot) = &snapshot {
                    log::put_attitude(snapshot, output);
                }
                sender.fill(now_us, output, || logged.dequeue());
            }
            _ => {
                if let Some(snapshot) = &snapshot {
                    let mut frame = [0; FRAME_CAPACITY];
                    let frame = formats::encode(format, snapshot, *frames_sent, &mut frame);
                    *frames_sent = frames_sent.wrapping_add(1);
                    output.put(frame);
                    let line = frame.strip_suffix(b"\n").unwrap_or(frame);
                    if let Ok(line) = core::str::from_utf8(line) {
                        defmt::info!("{=str}", line);
                    }
                }
            }
        }
        let length = output.length();
        transmitter.send(length);
    }

    #[inline(never)]
    fn post(messages: &mut impl Mutex<T = Mailbox>, message: Message) {
        messages.lock(|messages| messages.post(message));
    }

    /// The latest snapshot, unless it was sent already.
    #[inline(never)]
    fn next_snapshot(last_published: &mut u32) -> Option<Snapshot> {
        let (snapshot, number) = publish::latest()?;
        if number == core::mem::replace(last_published, number) {
            return None;
        }
        Some(snapshot)
    }

    /// A line of the module, as the format has it.
    #[inline(never)]
    fn say(
        format: OutputFormat,
        severity: Severity,
        line: &str,
        station: &mut GroundStation,
        output: &mut Output<'_>,
    ) {
        match format {
            OutputFormat::Mavlink => {
                station.session.say(severity, line, output);
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
    }

    fn log_text(severity: Severity, line: &str) {
        match severity {
            Severity::Information => defmt::info!("{=str}", line),
            Severity::Warning => defmt::warn!("{=str}", line),
            Severity::Error => defmt::error!("{=str}", line),
        }
    }

    fn answer_severity(kind: Kind) -> Severity {
        match kind {
            Kind::Ok | Kind::Progress | Kind::Done => Severity::Information,
            Kind::Error | Kind::Failed => Severity::Warning,
        }
    }

    /// What the console reaches of the rest.
    struct Hands<'a, P, R, D> {
        receiver: &'a mut Receiver,
        transmitter: &'a mut Transmitter,
        pipeline: P,
        rest: R,
        desk: D,
        has_reception_error: bool,
        station: &'a mut GroundStation,
        /// Frames of a ground station are among what is received.
        is_mavlink: bool,
        now_us: u64,
        /// The settings that a log tells have changed, before the burst of this number.
        changed_at: Option<u32>,
        /// The counters; the rest of it is filled in when it is asked for.
        state: State,
    }

    impl<P, R, D> Module for Hands<'_, P, R, D>
    where
        P: Mutex<T = Option<Pipeline<Kalman>>>,
        R: Mutex<T = Option<RestProgress>>,
        D: Mutex<T = Desk>,
    {
        fn receive(&mut self) -> Option<u8> {
            let Self {
                station, receiver, ..
            } = self;
            if self.is_mavlink {
                station.receive(self.now_us, || receiver.receive())
            } else {
                receiver.receive()
            }
        }

        fn take_reception_error(&mut self) -> bool {
            core::mem::take(&mut self.has_reception_error)
        }

        fn state(&mut self) -> State {
            let mut state = self.state;
            state.flags = next_snapshot(&mut 0).map_or(Flags::NONE, |snapshot| snapshot.flags);
            state.sensor = self.desk.lock(|desk| desk.sensor);
            let copied = self.pipeline.lock(|pipeline| {
                let pipeline = pipeline.as_ref()?;
                let filter = pipeline.estimator().kalman()?;
                Some((
                    pipeline.temperature_celsius(),
                    pipeline.rate_offset_rad_s(),
                    filter.largest_bias_sigma_rad_s(),
                    filter.tilt_sigma_rad(),
                ))
            });
            if let Some((temperature_celsius, bias_rad_s, bias_sigma_rad_s, tilt_sigma_rad)) =
                copied
            {
                state.temperature_celsius = temperature_celsius;
                state.bias_rad_s = bias_rad_s;
                state.bias_sigma_rad_s = bias_sigma_rad_s;
                state.tilt_sigma_rad = tilt_sigma_rad;
            }
            state
        }

        fn set_calibration(&mut self, calibration: &Calibration) {
            self.desk.lock(|desk| desk.calibration = *calibration);
            self.changed_at = self.pipeline.lock(|pipeline| {
                pipeline.as_mut()?.set_calibration(calibration);
                Some(BURSTS_TAKEN.load(Ordering::Relaxed))
            });
        }

        fn start_rest(&mut self, samples: u16) {
            self.pipeline.lock(|pipeline| {
                if let Some(pipeline) = pipeline {
                    pipeline.start_rest(samples);
                }
            });
        }

        fn stop_rest(&mut self) {
            self.pipeline.lock(|pipeline| {
                if let Some(pipeline) = pipeline {
                    pipeline.stop_rest();
                }
            });
        }

        fn take_rest(&mut self) -> Option<RestProgress> {
            self.rest.lock(Option::take)
        }

        fn rest_percent(&mut self) -> u8 {
            self.pipeline
                .lock(|pipeline| pipeline.as_ref()?.rest_progress_percent())
                .unwrap_or_default()
        }

        fn set_armed(&mut self, is_armed: bool) {
            self.desk.lock(|desk| desk.is_armed = is_armed);
            self.changed_at = self.pipeline.lock(|pipeline| {
                pipeline.as_mut()?.set_armed(is_armed);
                Some(BURSTS_TAKEN.load(Ordering::Relaxed))
            });
        }

        fn set_baud(&mut self, baud: u32) -> bool {
            self.transmitter.set_baud(baud)
        }

        fn begin(&mut self, task: Task) {
            self.desk.lock(|desk| desk.task = Some(task));
            TASK_WAITS.store(true, Ordering::Release);
        }

        fn take_outcome(&mut self) -> Option<Outcome> {
            self.desk.lock(|desk| desk.outcome.take())
        }
    }
}
