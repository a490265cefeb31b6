//! Firmware: the tasks and their priorities. The work is done in `aplomb::board`, in the library,
//! and in the files beside this one.
//!
//! | task | priority | started by | must end before |
//! |---|---|---|---|
//! | `data_ready` | 4 | INT pin | the next bus event, 22 µs |
//! | `bus_event`, `bus_error` | 4 | I2C1 | the next bus event, 22 µs |
//! | `transfer_complete` | 4 | DMA1 stream 0 | the next bus event, 22 µs |
//! | `transaction_request` | 4 | `attitude`, for the work below | the next bus event, 22 µs |
//! | `time` | 4 | TIM5: counter wrap, alarms, telemetry ticks | the next bus event, 22 µs |
//! | `attitude` | 3 | `transfer_complete`, `time` | the end of the next burst, 1 ms |
//! | `telemetry` | 1 | `time`, at least 50 times a second | nothing: drops lines |
//! | `idle`, the supervisor | 0 | – | nothing |
//!
//! `transaction_request` starts a check of the sensor's settings, or a transfer with the compass.
//! `attitude` requests a check every 22 ms, or every 10 ms with a compass. It requests one after
//! each burst while the bursts are polled, and after a jump of the rate until the full scales are
//! read back.
//!
//! Larger numbers are more urgent in RTIC. Three tasks use vectors of peripherals that the firmware
//! leaves unused: SPI1's serves `transaction_request`, SPI2's `telemetry`, and SPI3's `attitude`.
//!
//! Commands run in `telemetry`. A command that changes the pipeline delays `attitude` for the
//! length of one lock.

#![no_std]
#![no_main]

mod after_publication;
#[cfg_attr(not(feature = "full"), path = "commands_absent.rs")]
mod commands;
mod estimation;
mod kept_record;
#[cfg(feature = "full")]
mod module_port;
mod requests;
mod supervisor;
mod telemetry;

use defmt_rtt as _;

/// Ends in the hard fault that `aplomb::board::crash` records. The panic's text is omitted, because
/// it would take 4 KiB of flash. A debugger that stops at the fault shows file and line.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::asm::udf()
}

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true, dispatchers = [SPI2])]
mod app {
    use core::sync::atomic::AtomicU8;

    use aplomb::board::attitude_task::{AttitudeTask, FlagChange};
    use aplomb::board::boards::BOARD;
    use aplomb::board::burst_reader::BurstReader;
    use aplomb::board::compass::CompassReader;
    use aplomb::board::flash::CalibrationFlash;
    use aplomb::board::sensor::Sensor;
    use aplomb::board::sensor_bus::SensorBus;
    use aplomb::board::timebase::{self, Timebase};
    use aplomb::board::uart::{self, ReceiveRing};
    use aplomb::board::{clocks, pins, retained, stack_guard, watchdog};
    use aplomb::calibration::Mount;
    use aplomb::compass::{self, Choice};
    use aplomb::console::usable_preferences;
    use aplomb::fault::{ClockSource, ResetCause};
    use aplomb::health::Flags;
    use aplomb::mpu6050::{Config, Part};
    use aplomb::pipeline::{CompassReading, Settings};
    use aplomb::settings::{CompassSettings, Record, storage};
    use aplomb::telemetry::Mailbox;
    use aplomb::telemetry::log::NumberedBurst;
    use aplomb::telemetry::message::Message;
    use heapless::spsc::{Producer, Queue};
    use stm32f4xx_hal::pac::Interrupt;

    use crate::after_publication::{StationaryMeasurement, after_publication};
    use crate::commands::Commands;
    use crate::estimation::Estimation;
    use crate::kept_record;
    use crate::requests::Requests;
    use crate::supervisor;
    use crate::telemetry::{LogInput, Telemetry};

    /// Handles a stopped crystal: triggers the alarm of the burst reader, which restores the clock.
    #[allow(
        unsafe_code,
        reason = "cortex-m-rt requires it: an NMI interrupts critical sections; this one sets bits"
    )]
    #[cortex_m_rt::exception]
    unsafe fn NonMaskableInt() {
        clocks::acknowledge_failure();
        timebase::raise_burst_alarm();
    }

    /// Places for bursts in the queue to the flight log, which uses all but one: those of three
    /// telemetry ticks of 10 ms.
    const LOG_BURSTS: usize = 32;
    /// Places for readings of the compass in their queue to the flight log. Seven are in use: the
    /// readings of 140 ms.
    const LOG_READINGS: usize = if compass::IS_BUILT_IN { 8 } else { 2 };
    /// Mount if none is stored; set at build time.
    const MOUNT: Mount = match option_env!("APLOMB_MOUNT") {
        None => Mount::Z_UP,
        Some(name) => match Mount::parse(name) {
            Some(mount) => mount,
            None => panic!("APLOMB_MOUNT takes forward then down, such as +x-z, or z-up or z-down"),
        },
    };
    /// Compass without a stored record; set at build time.
    const COMPASS: Choice = match option_env!("APLOMB_COMPASS") {
        None => Choice::Auto,
        Some(word) => match Choice::parse(word) {
            Some(choice) => choice,
            None => panic!("APLOMB_COMPASS takes auto, off, or the name of a compass"),
        },
    };
    /// Pipeline's settings before the sensor is found.
    const SETTINGS: Settings = {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.mount = MOUNT;
        settings.verifies_scales = true;
        settings
    };

    #[shared]
    struct Shared {
        #[lock_free]
        reader: BurstReader,
        #[lock_free]
        timebase: Timebase,
        estimation: Estimation,
        messages: Mailbox,
        requests: Requests,
    }

    #[local]
    struct Local {
        sensor: Sensor,
        flash: CalibrationFlash,
        to_log: Producer<'static, NumberedBurst>,
        output: Telemetry,
    }

    #[init(local = [
        uart_buffer: [u8; uart::CAPACITY] = [0; uart::CAPACITY],
        log_queue: Queue<NumberedBurst, LOG_BURSTS> = Queue::new(),
        reading_queue: Queue<CompassReading, LOG_READINGS> = Queue::new(),
    ])]
    fn init(context: init::Context) -> (Shared, Local) {
        static RING: ReceiveRing = [const { AtomicU8::new(0) }; uart::RECEIVE_CAPACITY];
        stack_guard::start(&context.core.MPU);
        #[cfg(feature = "full")]
        aplomb::board::measure::fill_stack();
        let device = context.device;
        let start = retained::start(&device.RCC);
        watchdog::start(&device.IWDG, &device.DBGMCU);
        let (_, clock) = clocks::start(device.RCC);
        if clock == ClockSource::Crystal {
            clocks::watch_crystal();
        }
        pins::start(device.GPIOA, device.SYSCFG, device.EXTI);
        let timebase = Timebase::start(device.TIM5);
        watchdog::set_limit_ms(watchdog::LIMIT_MS);
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
        // A sensor that the previous run has configured is only checked.
        let sensor = Sensor::new(bus, Config::DEFAULT, retained::kept().is_some());
        let mut flash = CalibrationFlash::new(device.FLASH);
        let loaded = storage::load(&mut flash);
        if let Some(problem) = loaded.problem {
            messages.post(Message::RecordProblem(problem));
        }
        if loaded.record.is_some() {
            messages.post(Message::RecordLoaded);
        }
        // A warm start restores the record in use, saved or not.
        let kept = kept_record::at_start();
        let in_use = kept.or(loaded.record).unwrap_or_default();
        let baud = usable_preferences(in_use.preferences).baud;
        let (transmitter, receiver) =
            uart::start(device.USART2, baud, context.local.uart_buffer, &RING);
        let commands = Commands::new(
            receiver,
            (loaded, kept),
            SETTINGS.noise_model(),
            SETTINGS.sensor.sample_rate_hz(),
            MOUNT,
            COMPASS,
            retained::is_armed(),
        );
        let (to_log, bursts) = context.local.log_queue.split();
        let (readings_to_log, readings) = context.local.reading_queue.split();
        kept_record::keep(commands.record());
        (
            Shared {
                reader: BurstReader::start(clock),
                timebase,
                estimation: Estimation {
                    pipeline: None,
                    measurement: StationaryMeasurement::new(),
                    compass: compass_of(commands.record(), readings_to_log),
                },
                messages,
                requests: Requests::new(),
            },
            Local {
                sensor,
                flash,
                to_log,
                output: Telemetry::new(transmitter, commands, LogInput { bursts, readings }),
            },
        )
    }

    /// Creates the compass reader of a record. `to_log` takes readings for the flight log.
    fn compass_of(record: &Record, to_log: Producer<'static, CompassReading>) -> CompassReader {
        let imu_mount = record.calibration.mount.unwrap_or(MOUNT);
        // Without the feature the firmware has no code of the settings.
        let compass = if compass::IS_BUILT_IN {
            record.compass
        } else {
            CompassSettings::default()
        };
        let alignment = compass.alignment(imu_mount);
        CompassReader::new(compass.choice, alignment, compass.declination_rad, to_log)
    }

    #[idle(local = [sensor, flash], shared = [estimation, messages, requests])]
    fn idle(context: idle::Context) -> ! {
        let idle::LocalResources { sensor, flash, .. } = context.local;
        let shared = context.shared;
        supervisor::run(
            sensor,
            flash,
            &SETTINGS,
            shared.estimation,
            shared.messages,
            shared.requests,
        )
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
    fn transaction_request(context: transaction_request::Context) {
        context.shared.reader.on_transaction_request();
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
            // A tick that is still running skips this one; no task waits.
            telemetry::spawn().ok();
        }
    }

    #[task(
        binds = SPI3,
        priority = 3,
        shared = [estimation, messages],
        local = [to_log, task: AttitudeTask = AttitudeTask::new()],
    )]
    fn attitude(mut context: attitude::Context) {
        let attitude::LocalResources { to_log, task, .. } = context.local;
        let change = context.shared.estimation.lock(|estimation| {
            let Some(pipeline) = &mut estimation.pipeline else {
                watchdog::report_attitude();
                return None;
            };
            let part = pipeline.settings().part;
            let compass = compass::IS_BUILT_IN.then_some(&mut estimation.compass);
            task.run(pipeline, compass, |received, flags| {
                let measurement = &mut estimation.measurement;
                after_publication(received, flags, part, measurement, to_log);
            })
        });
        if let Some(message) = change.and_then(message_of) {
            let messages = &mut context.shared.messages;
            messages.lock(|messages| messages.post(message));
        }
    }

    /// Returns the message for a change of the flags.
    fn message_of(FlagChange { before, now }: FlagChange) -> Option<Message> {
        let was_calibrating = before.contains(Flags::CALIBRATING);
        if now.contains(Flags::MOVED) {
            Some(Message::MovedAtStart)
        } else if was_calibrating && !now.contains(Flags::CALIBRATING) {
            Some(Message::OffsetMeasured)
        } else if now.contains(Flags::VIBRATION) && !before.contains(Flags::VIBRATION) {
            Some(Message::VibrationTooStrong)
        } else {
            None
        }
    }

    #[task(priority = 1, shared = [estimation, messages, requests], local = [output])]
    async fn telemetry(context: telemetry::Context) {
        let shared = context.shared;
        let output = context.local.output;
        output.tick(shared.estimation, shared.messages, shared.requests);
    }
}
