//! Estimates attitude in an Embassy application, and drives the sensor over an asynchronous bus.
//!
//! ```sh
//! cd examples/embassy
//! cargo run --release --target thumbv7em-none-eabihf
//! ```
//!
//! [`show_attitude`] works with any `embedded-hal-async` bus and pin; `main` is an STM32F405
//! (another chip is another feature of `embassy-stm32`). Pins are those of the README: SCL PB8, SDA
//! PB9, INT PA1. In a project of your own: `aplomb = { git = "…" }` without features. The time of
//! a sample is that of the task's wake-up, so other tasks may delay it.

#![no_std]
#![no_main]

use aplomb::health::BoardFlags;
use aplomb::mpu6050::registers::Register;
use aplomb::mpu6050::{ADDRESSES, BURST_LENGTH, Burst, Check, Config, Part, SettingsState, Step};
use aplomb::pipeline::{Pipeline, Settings};
use embassy_executor::Spawner;
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::gpio::Pull;
use embassy_stm32::i2c::{self, I2c};
use embassy_stm32::{bind_interrupts, dma, interrupt, peripherals};
use embassy_time::{Instant, Timer};
use embedded_hal_async::{digital::Wait, i2c::I2c as Bus};
use {defmt_rtt as _, panic_probe as _};

const ADDRESS: u8 = ADDRESSES[0];

/// Time for a STOP on the bus, µs. Embassy's driver does not wait for its end, and a START that is
/// requested before may never be made (RM0090, 27.6.1).
const STOP_US: u64 = 10;

/// Configures the sensor, then reads a sample at every edge of INT and shows every hundredth
/// attitude. Returns if the bus fails, if the device is no sensor of this family, or if the sensor
/// does not keep its settings.
async fn show_attitude<I: Bus>(mut i2c: I, mut interrupt: impl Wait) -> Result<(), I::Error> {
    let (config, mut byte) = (Config::default(), [0]);
    i2c.write_read(ADDRESS, &[Register::WhoAmI.address()], &mut byte)
        .await?;
    let Some(part) = Part::from_who_am_i(byte[0]) else {
        return Ok(());
    };
    Timer::after_micros(STOP_US).await;
    for step in Step::configuration(&config, part) {
        i2c.write(ADDRESS, &[step.register.address(), step.value])
            .await?;
        Timer::after_micros(STOP_US + 1_000 * u64::from(step.wait_ms)).await;
    }
    for check in Check::all(&config, part) {
        let mut bytes = [0; Check::LONGEST];
        i2c.write_read(
            ADDRESS,
            &[check.first.address()],
            &mut bytes[..check.length],
        )
        .await?;
        if check.evaluate(&bytes) != SettingsState::Intact {
            return Ok(());
        }
        Timer::after_micros(STOP_US).await;
    }
    let mut pipeline = Pipeline::new(&Settings::new(part));
    for number in 1_u32.. {
        interrupt.wait_for_rising_edge().await.ok();
        let captured_at_us = Instant::now().as_micros();
        let mut bytes = [0; BURST_LENGTH];
        i2c.write_read(
            ADDRESS,
            &[Register::AccelerometerXHigh.address()],
            &mut bytes,
        )
        .await?;
        let burst = Burst {
            bytes,
            captured_at_us,
            missed_before: 0,
        };
        let angles = pipeline.update(&burst, BoardFlags::empty()).euler();
        if number.is_multiple_of(100) {
            let (roll, pitch) = (angles.roll_rad.to_degrees(), angles.pitch_rad.to_degrees());
            defmt::info!("roll {} pitch {}", roll, pitch);
        }
    }
    Ok(())
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
        let result = show_attitude(&mut bus, &mut interrupt).await;
        defmt::warn!(
            "no sensor, or not as it was configured: {}",
            result.is_err()
        );
        Timer::after_millis(100).await;
    }
}
