//! The firmware: which interrupt does what, at which priority. What each step does stands in `aplomb::board` and in the library.
//!
//! | task | priority | started by | must end before |
//! |---|---|---|---|
//! | `data_ready`, `bus_event`, `bus_error`, `transfer_complete` | 4 | INT pin, I2C1, DMA1 stream 0 | the next bus event, 22 µs |
//! | `time` | 4 | TIM5: counter wrap, alarms, telemetry pace | the next bus event, 22 µs |
//! | `attitude` | 3 | `transfer_complete` | the end of the next burst, 1 ms |
//! | `telemetry` | 1 | `time`, 50 times a second | nothing: it skips a line rather than wait |
//! | `idle` | 0 | – | nothing: it configures the sensor, at start and after faults |

#![no_std]
#![no_main]

use defmt_rtt as _;
use panic_probe as _;

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true, dispatchers = [SPI2])]
mod app {
    use core::fmt::Write;

    use aplomb::board::boards::BOARD;
    use aplomb::board::burst_reader::{self, BurstReader};
    use aplomb::board::sensor::{self, NotReady, Sensor};
    use aplomb::board::sensor_bus::SensorBus;
    use aplomb::board::timebase::{self, Delay, Timebase};
    use aplomb::board::uart::{self, Uart};
    use aplomb::board::upkeep::Upkeep;
    use aplomb::board::{clocks, pins, publish, retained, watchdog};
    use aplomb::calibration::Mount;
    use aplomb::estimator::kalman::{Kalman, Known};
    use aplomb::fault::{ClockSource, FaultClass, ResetCause};
    use aplomb::health::Flags;
    use aplomb::mpu6050::{self, Config};
    use aplomb::pipeline::{Pipeline, Settings};
    use aplomb::telemetry::message::{self, Mailbox, Message, Severity, TextBuffer};
    use aplomb::telemetry::text;
    use embedded_hal::delay::DelayNs;
    use stm32f4xx_hal::pac::Interrupt;

    /// The crystal has stopped. The burst reader sees it at the next edge and brings the clock back.
    #[cortex_m_rt::exception]
    unsafe fn NonMaskableInt() {
        clocks::acknowledge_failure();
    }

    /// Text lines come at 50 Hz.
    const TELEMETRY_PERIOD_US: u32 = 20_000;
    const BAUD: u32 = 115_200;
    /// How the sensor sits in the vehicle; set at build time.
    const MOUNT: Mount = match option_env!("APLOMB_MOUNT") {
        None => Mount::Z_UP,
        Some(name) => match Mount::parse(name) {
            Some(mount) => mount,
            None => panic!("APLOMB_MOUNT takes forward then down, such as +x-z, or z-up or z-down"),
        },
    };

    #[shared]
    struct Shared {
        #[lock_free]
        reader: BurstReader,
        #[lock_free]
        timebase: Timebase,
        pipeline: Option<Pipeline<Kalman>>,
        messages: Mailbox,
    }

    #[local]
    struct Local {
        sensor: Sensor,
        known: Option<Known>,
        uart: Uart,
    }

    #[init(local = [uart_buffer: [u8; uart::CAPACITY] = [0; uart::CAPACITY]])]
    fn init(context: init::Context) -> (Shared, Local) {
        let device = context.device;
        let start = retained::start(&device.RCC);
        watchdog::start(&device.IWDG, &device.DBGMCU);
        let (_, clock) = clocks::start(device.RCC);
        if clock == ClockSource::Crystal {
            clocks::watch_crystal();
        }
        pins::start(device.GPIOA, device.SYSCFG, device.EXTI);
        let timebase = Timebase::start(device.TIM5, TELEMETRY_PERIOD_US);
        let bus = SensorBus::new(device.I2C1, device.GPIOB);
        let uart = Uart::start(device.USART2, BAUD, context.local.uart_buffer);
        let reader = BurstReader::start();
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
        (
            Shared {
                reader,
                timebase,
                pipeline: None,
                messages,
            },
            Local {
                sensor,
                known: start.known,
                uart,
            },
        )
    }

    #[idle(local = [sensor, known], shared = [pipeline, messages])]
    fn idle(mut context: idle::Context) -> ! {
        let known = context.local.known.take();
        let mut post = |message| {
            context
                .shared
                .messages
                .lock(|messages| messages.post(message))
        };
        let mut last_complaint = None;
        loop {
            watchdog::samples_go_on();
            match context.local.sensor.make_ready() {
                Ok(ready) => {
                    last_complaint = None;
                    // After a fault the filter goes on with what it knows.
                    context.shared.pipeline.lock(|pipeline| {
                        pipeline.get_or_insert_with(|| {
                            let mut settings = Settings::new(ready.part);
                            settings.mount = MOUNT;
                            let mut pipeline = Pipeline::with_filter(&settings, Kalman::new());
                            if let Some(known) = &known {
                                pipeline.resume(known);
                            }
                            pipeline
                        });
                    });
                    burst_reader::enable(&ready, &Config::DEFAULT);
                    post(Message::SensorConfigured {
                        part: ready.part.name,
                        address: ready.address,
                    });
                    timebase::sleep_until(|| !burst_reader::is_enabled());
                    post(Message::Recovering);
                }
                Err(reason) => {
                    // It may have been powered up together with the processor.
                    let is_patient = reason == NotReady::Sensor(mpu6050::Error::NotFound)
                        && context.local.sensor.may_be_starting();
                    // Said once, and tried many times.
                    if !is_patient && last_complaint.replace(reason) != Some(reason) {
                        post(match reason {
                            NotReady::BusHeldLow(held) => Message::BusHeldLow { clock: held.clock },
                            NotReady::Sensor(error) => Message::SensorFailed(error),
                        });
                    }
                    Delay.delay_ms(sensor::RETRY_MS);
                }
            }
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

    #[task(binds = SPI3, priority = 3, shared = [pipeline, messages], local = [upkeep: Upkeep = Upkeep::new()])]
    fn attitude(mut context: attitude::Context) {
        let upkeep = context.local.upkeep;
        let change = context.shared.pipeline.lock(|pipeline| {
            let Some(pipeline) = pipeline.as_mut() else {
                watchdog::attitude_goes_on();
                return None;
            };
            let sampled = burst_reader::with_burst(|burst, flags| {
                let snapshot = pipeline.update_with(burst, flags, publish::publish);
                upkeep.after_sample(pipeline, snapshot.flags)
            });
            if let Some(change) = sampled {
                return change;
            }
            let (t_us, flags) = burst_reader::take_stale()?;
            let snapshot = pipeline.stale(t_us, flags);
            publish::publish(&snapshot, pipeline.tilt_variance_rad2(t_us));
            upkeep.after_silence(&snapshot)
        });
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

    #[task(priority = 1, shared = [messages], local = [uart, last_published: u32 = 0, last_failures: u16 = 0])]
    async fn telemetry(mut context: telemetry::Context) {
        watchdog::telemetry_goes_on();
        let (failures, failure) = burst_reader::failures();
        let count = failures.wrapping_sub(*context.local.last_failures);
        if let (1.., Some(failure)) = (count, failure) {
            *context.local.last_failures = failures;
            context
                .shared
                .messages
                .lock(|messages| messages.post(Message::BurstsFailed { failure, count }));
        }
        let mut line = [0; text::LINE_LENGTH];
        let line = match publish::latest() {
            Some((snapshot, number)) if number != *context.local.last_published => {
                *context.local.last_published = number;
                // The text is ASCII.
                core::str::from_utf8(text::encode(&snapshot, &mut line)).unwrap_or_default()
            }
            _ => "",
        };
        if !line.is_empty() {
            defmt::info!("{=str}", line.trim_end_matches('\n'));
        }
        let Some(buffer) = context.local.uart.idle_buffer() else {
            retained::count(FaultClass::TelemetryLate);
            return;
        };
        let mut output = TextBuffer::new(buffer);
        while output.room() >= message::LINE_CAPACITY + text::LINE_LENGTH
            && let Some(message) = context.shared.messages.lock(Mailbox::take)
        {
            // A test holds the longest message to its line.
            writeln!(output, "# {message}").ok();
            let text = defmt::Display2Format(&message);
            match message.severity() {
                Severity::Information => defmt::info!("{}", text),
                Severity::Warning => defmt::warn!("{}", text),
                Severity::Error => defmt::error!("{}", text),
            }
        }
        output.write_str(line).ok();
        let length = output.length();
        context.local.uart.send(length);
    }
}
