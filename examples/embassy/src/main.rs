//! Estimates attitude in an Embassy application, and drives the sensor over an asynchronous bus.
//!
//! ```sh
//! cd examples/embassy
//! cargo run --release --target thumbv7em-none-eabihf
//! ```
//!
//! [`show_attitude`] works with any `embedded-hal-async` bus and pin; `main` is an STM32F405
//! (another chip is another feature of `embassy-stm32`). Pins are those of the README: SCL PB8, SDA
//! PB9, INT PA1. In a project of your own: `aplomb = { path = "../aplomb" }` without features. The
//! time of a sample is that of the task's wake-up, so other tasks may delay it.

#![no_std]
#![no_main]

use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::registers::Register;
use aplomb::mpu6050::{ADDRESSES, BURST_LENGTH, Burst, Check, Config, Part, SettingsState, Step};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use embassy_executor::Spawner;
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::gpio::Pull;
use embassy_stm32::i2c::{self, I2c};
use embassy_stm32::{bind_interrupts, dma, interrupt, peripherals};
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_hal_async::{digital::Wait, i2c::I2c as Bus};
use {defmt_rtt as _, panic_probe as _};

/// Longest wait for an edge: three sample periods.
const EDGE_TIMEOUT: Duration = Duration::from_millis(3);
/// Missing samples in a row after which the sensor is configured anew.
const MOST_MISSED: u8 = 20;
/// Samples between two checks of the sensor's settings.
const SAMPLES_TO_CHECK: u32 = 44;

/// Time for a STOP on the bus, µs. Embassy's driver does not wait for its end, and a START that is
/// requested before may never be made (RM0090, 27.6.1).
const STOP_US: u64 = 10;

/// Sensor that was found.
struct Sensor {
    address: u8,
    part: &'static Part,
    config: Config,
}

/// Searches both addresses; `None` if no sensor of this family answers.
async fn find(i2c: &mut impl Bus) -> Option<Sensor> {
    for address in ADDRESSES {
        let (register, mut byte) = ([Register::WhoAmI.address()], [0]);
        let answer = i2c.write_read(address, &register, &mut byte).await;
        Timer::after_micros(STOP_US).await;
        if answer.is_ok()
            && let Some(part) = Part::from_who_am_i(byte[0])
        {
            let config = Config::default();
            return Some(Sensor {
                address,
                part,
                config,
            });
        }
    }
    None
}

impl Sensor {
    /// Configures the sensor.
    async fn configure<I: Bus>(&self, i2c: &mut I) -> Result<(), I::Error> {
        for step in Step::configuration(&self.config, self.part) {
            i2c.write(self.address, &[step.register.address(), step.value])
                .await?;
            Timer::after_micros(STOP_US + 1_000 * u64::from(step.wait_ms)).await;
        }
        Ok(())
    }

    /// Reads the settings back. Returns whether they are as configured.
    async fn is_intact<I: Bus>(&self, i2c: &mut I) -> Result<bool, I::Error> {
        for check in Check::all(&self.config, self.part) {
            let mut bytes = [0; Check::LONGEST];
            let (first, read) = ([check.first.address()], &mut bytes[..check.length]);
            i2c.write_read(self.address, &first, read).await?;
            if check.evaluate(&bytes) != SettingsState::Intact {
                return Ok(false);
            }
            Timer::after_micros(STOP_US).await;
        }
        Ok(true)
    }

    /// Reads the sample of this edge.
    async fn read_burst<I: Bus>(&self, i2c: &mut I, edge: Instant) -> Result<Burst, I::Error> {
        let mut bytes = [0; BURST_LENGTH];
        let first = [Register::AccelerometerXHigh.address()];
        i2c.write_read(self.address, &first, &mut bytes).await?;
        Ok(Burst {
            bytes,
            captured_at_us: edge.as_micros(),
            missed_before: 0,
        })
    }
}

/// Configures the sensor, then reads a sample at every edge of INT and shows every hundredth
/// attitude. Returns if samples stay away, or if the sensor does not keep its settings: it may have
/// reset itself. The next call starts from nothing.
async fn show_attitude<I: Bus>(i2c: &mut I, interrupt: &mut impl Wait) -> Option<()> {
    let sensor = find(i2c).await?;
    sensor.configure(i2c).await.ok()?;
    let mut settings = Settings::for_sensor(sensor.part, &sensor.config);
    settings.verifies_scales = true;
    let mut pipeline = Pipeline::new(&settings);
    // Missing samples, and the flags of the next burst.
    let (mut missed, mut board) = (0, BoardFlags::empty());
    for number in 0_u32.. {
        // After a jump of the rate no attitude is valid before the settings are checked.
        if number.is_multiple_of(SAMPLES_TO_CHECK) || pipeline.awaits_scale_check() {
            if !sensor.is_intact(i2c).await.ok()? {
                return None;
            }
            board |= BoardFlags::SCALES_VERIFIED;
        }
        let edge = with_timeout(EDGE_TIMEOUT, interrupt.wait_for_rising_edge()).await;
        let now = Instant::now();
        let burst = match edge {
            Ok(_) => sensor.read_burst(i2c, now).await.ok(),
            Err(_) => None,
        };
        let Some(mut burst) = burst else {
            missed += 1;
            show(
                number,
                &pipeline.stale(now.as_micros(), BoardFlags::BUS_FAULT),
            );
            if missed == MOST_MISSED {
                return None;
            }
            continue;
        };
        burst.missed_before = core::mem::take(&mut missed);
        board.set(BoardFlags::BUS_FAULT, burst.missed_before > 0);
        show(
            number,
            &pipeline.update(&burst, core::mem::take(&mut board)),
        );
    }
    None
}

/// Shows every hundredth attitude. Rely on it only with `VALID` among its flags.
fn show(number: u32, snapshot: &Snapshot) {
    if number % 100 == 99 {
        let angles = snapshot.euler();
        let (roll, pitch) = (angles.roll_rad.to_degrees(), angles.pitch_rad.to_degrees());
        let is_valid = snapshot.flags.contains(Flags::VALID);
        defmt::info!("valid {} roll {} pitch {}", is_valid, roll, pitch);
    }
}

bind_interrupts!(struct Interrupts {
    EXTI1 => exti::InterruptHandler<interrupt::typelevel::EXTI1>;
    I2C1_EV => i2c::EventInterruptHandler<peripherals::I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<peripherals::I2C1>;
    DMA1_STREAM0 => dma::InterruptHandler<peripherals::DMA1_CH0>;
    DMA1_STREAM6 => dma::InterruptHandler<peripherals::DMA1_CH6>;
});

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let p = embassy_stm32::init(embassy_stm32::Config::default());
    let mut settings = i2c::Config::default();
    settings.frequency = embassy_stm32::time::khz(400);
    let mut bus = I2c::new(
        p.I2C1, p.PB8, p.PB9, p.DMA1_CH6, p.DMA1_CH0, Interrupts, settings,
    );
    let mut interrupt = ExtiInput::new(p.PA1, p.EXTI1, Pull::Down, Interrupts);
    loop {
        show_attitude(&mut bus, &mut interrupt).await;
        defmt::warn!("no sensor, no samples, or not as it was configured");
        Timer::after_millis(100).await;
    }
}
