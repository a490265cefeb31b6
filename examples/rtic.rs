//! Template of an RTIC application on the burst reader: interrupts and DMA read the sensor, and the
//! application gets one attitude per millisecond. Pins and boards are those of the README.
//!
//! ```sh
//! cargo run --profile firmware --target thumbv7em-none-eabihf \
//!     --features board-stm32f405 --example rtic
//! ```
//!
//! For a project of your own, `docs/porting.md` has the manifest and the linker settings. The
//! interrupts below must share one priority, as they share the reader.

#![no_std]
#![no_main]

use {defmt_rtt as _, panic_probe as _};

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true, dispatchers = [SPI2])]
mod app {
    use aplomb::board::attitude_task::AttitudeTask;
    use aplomb::board::burst_reader::{self, BurstReader};
    use aplomb::board::delay::Delay;
    use aplomb::board::sensor::{RETRY_MS, Sensor};
    use aplomb::board::sensor_bus::SensorBus;
    use aplomb::board::timebase::{self, Timebase};
    use aplomb::board::{attitude_task, clocks, pins, retained};
    use aplomb::mpu6050::{Config, Part};
    use aplomb::pipeline::{Pipeline, Settings};
    use embedded_hal::delay::DelayNs;
    use stm32f4xx_hal::pac::Interrupt;

    #[shared]
    struct Shared {
        #[lock_free]
        reader: BurstReader,
        #[lock_free]
        timebase: Timebase,
    }

    #[local]
    struct Local {
        sensor: Sensor,
        pipeline: Pipeline,
    }

    #[init]
    fn init(context: init::Context) -> (Shared, Local) {
        let device = context.device;
        retained::start(&device.RCC);
        let (_, clock) = clocks::start(device.RCC);
        pins::start(device.GPIOA, device.SYSCFG, device.EXTI);
        let timebase = Timebase::start(device.TIM5);
        let bus = SensorBus::new(device.I2C1, device.GPIOB);
        let sensor = Sensor::new(bus, Config::DEFAULT, false);
        let reader = BurstReader::start(clock);
        // For a clone with another temperature scale: the part that `make_ready` found, in
        // `Ready::part`.
        let pipeline = Pipeline::new(&Settings {
            verifies_scales: true,
            ..Settings::for_sensor(&Part::MPU_6050, &Config::DEFAULT)
        });
        (Shared { reader, timebase }, Local { sensor, pipeline })
    }

    /// Finds and configures the sensor, at start and after every fault.
    #[idle(local = [sensor])]
    fn idle(context: idle::Context) -> ! {
        loop {
            match context.local.sensor.make_ready() {
                Ok(ready) => {
                    burst_reader::enable(&ready, &Config::DEFAULT);
                    timebase::sleep_until(|| !burst_reader::is_enabled());
                }
                Err(_) => Delay.delay_ms(RETRY_MS),
            }
        }
    }

    /// Place for your code that runs for every sample: 0.4 ms after the edge, with 0.6 ms of time.
    /// `run` publishes the attitude.
    #[task(
        binds = SPI3,
        priority = 3,
        local = [pipeline, task: AttitudeTask = AttitudeTask::new()]
    )]
    fn attitude(context: attitude::Context) {
        let attitude::LocalResources { pipeline, task, .. } = context.local;
        task.run(pipeline, None, |_, _| {
            // The attitude is published; your code may use the burst here, for example for a log.
        });
    }

    /// Place for your less urgent code, which may read the latest attitude at any time.
    #[task(priority = 1)]
    async fn show(_: show::Context) {
        if let Some((snapshot, _)) = attitude_task::latest() {
            let angles = snapshot.euler();
            let (roll, pitch) = (angles.roll_rad.to_degrees(), angles.pitch_rad.to_degrees());
            defmt::info!("roll {} pitch {}", roll, pitch);
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

    /// SPI1 is not used as a port. [`AttitudeTask`] uses its interrupt to request a check of the
    /// sensor's settings, or a transfer with a compass.
    #[task(binds = SPI1, priority = 4, shared = [reader])]
    fn transaction_request(context: transaction_request::Context) {
        context.shared.reader.on_transaction_request();
    }

    #[task(binds = DMA1_STREAM0, priority = 4, shared = [reader, timebase])]
    fn transfer_complete(context: transfer_complete::Context) {
        let shared = context.shared;
        if shared.reader.on_transfer_complete(shared.timebase) {
            rtic::pend(Interrupt::SPI3);
        }
    }

    #[task(binds = TIM5, priority = 4, shared = [reader, timebase])]
    fn time(context: time::Context) {
        let shared = context.shared;
        let alarms = shared.timebase.on_interrupt();
        if alarms.burst && shared.reader.on_alarm(shared.timebase) {
            rtic::pend(Interrupt::SPI3);
        }
        if alarms.telemetry {
            show::spawn().ok();
        }
    }
}
