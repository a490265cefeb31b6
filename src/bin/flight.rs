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
    use aplomb::board::sensor_bus::SensorBus;
    use aplomb::board::timebase::{self, Delay, Timebase};
    use aplomb::board::uart::{self, Uart};
    use aplomb::board::{clocks, pins, publish};
    use aplomb::calibration::Mount;
    use aplomb::estimator::kalman::Kalman;
    use aplomb::health::Flags;
    use aplomb::mpu6050::{Config, Mpu6050, Part};
    use aplomb::pipeline::{Pipeline, Settings};
    use aplomb::telemetry::message::{self, Mailbox, Message, Severity, TextBuffer};
    use aplomb::telemetry::text;
    use embedded_hal::delay::DelayNs;
    use stm32f4xx_hal::pac::Interrupt;

    /// Text lines come at 50 Hz.
    const TELEMETRY_PERIOD_US: u32 = 20_000;
    const BAUD: u32 = 115_200;
    /// Pause between two attempts to find the sensor.
    const RETRY_MS: u32 = 500;
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
        bus: SensorBus,
        uart: Uart,
    }

    #[init(local = [uart_buffer: [u8; uart::CAPACITY] = [0; uart::CAPACITY]])]
    fn init(context: init::Context) -> (Shared, Local) {
        let device = context.device;
        let (_, clock) = clocks::start(device.RCC);
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
        (
            Shared {
                reader,
                timebase,
                pipeline: None,
                messages,
            },
            Local { bus, uart },
        )
    }

    #[idle(local = [bus], shared = [pipeline, messages])]
    fn idle(mut context: idle::Context) -> ! {
        let bus = context.local.bus;
        let mut post = |message| {
            context
                .shared
                .messages
                .lock(|messages| messages.post(message))
        };
        loop {
            match set_up(bus) {
                Ok((part, address)) => {
                    // After a fault the filter goes on with what it knows.
                    context.shared.pipeline.lock(|pipeline| {
                        pipeline.get_or_insert_with(|| {
                            let mut settings = Settings::new(part);
                            settings.mount = MOUNT;
                            Pipeline::with_filter(&settings, Kalman::new())
                        });
                    });
                    burst_reader::enable(address);
                    post(Message::SensorConfigured {
                        part: part.name,
                        address,
                    });
                    timebase::sleep_until(|| !burst_reader::is_enabled());
                    post(Message::Recovering);
                }
                Err(message) => {
                    post(message);
                    Delay.delay_ms(RETRY_MS);
                }
            }
        }
    }

    /// Frees the bus and configures the sensor; the error is the message that says what stands in the way.
    fn set_up(bus: &mut SensorBus) -> Result<(&'static Part, u8), Message> {
        bus.recover()
            .map_err(|held| Message::BusHeldLow { clock: held.clock })?;
        let mut sensor = Mpu6050::probe(bus, &mut Delay)
            .map_err(|failure| Message::SensorFailed(failure.error))?;
        sensor
            .configure(&Config::default(), &mut Delay)
            .map_err(Message::SensorFailed)?;
        Ok((sensor.part(), sensor.address()))
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

    #[task(binds = DMA1_STREAM0, priority = 4, shared = [reader])]
    fn transfer_complete(context: transfer_complete::Context) {
        if context.shared.reader.on_transfer_complete() {
            rtic::pend(Interrupt::SPI3);
        }
    }

    #[task(binds = TIM5, priority = 4, shared = [reader, timebase])]
    fn time(context: time::Context) {
        let alarms = context.shared.timebase.on_interrupt();
        if alarms.burst {
            context.shared.reader.on_alarm();
        }
        if alarms.telemetry {
            // A line that is still being written makes this one come later: none waits for it.
            telemetry::spawn().ok();
        }
    }

    #[task(binds = SPI3, priority = 3, shared = [pipeline, messages], local = [last_flags: Flags = Flags::NONE])]
    fn attitude(mut context: attitude::Context) {
        let snapshot = burst_reader::with_burst(|burst| {
            context
                .shared
                .pipeline
                .lock(|pipeline| Some(pipeline.as_mut()?.update(burst)))
        });
        let Some(Some(snapshot)) = snapshot else {
            return;
        };
        publish::publish(&snapshot);
        if snapshot.flags != *context.local.last_flags {
            let last = core::mem::replace(context.local.last_flags, snapshot.flags);
            let message = if snapshot.flags.contains(Flags::MOVED) {
                Message::MovedAtStart
            } else if last.contains(Flags::CALIBRATING)
                && !snapshot.flags.contains(Flags::CALIBRATING)
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
    }

    #[task(priority = 1, shared = [messages], local = [uart, last_published: u32 = 0, last_failures: u16 = 0])]
    async fn telemetry(mut context: telemetry::Context) {
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
