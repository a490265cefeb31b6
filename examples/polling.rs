//! Estimates attitude on any microcontroller with an `embedded-hal` bus, without interrupts, DMA or
//! this project's firmware.
//!
//! ```sh
//! cargo run --profile firmware --target thumbv7em-none-eabihf \
//!     --features board-stm32f405 --example polling
//! ```
//!
//! [`show_attitude`] does all the work on any chip; `main` is for an STM32F4 with `stm32f4xx-hal`.
//! In a project of your own: `aplomb = { git = "…" }` without features, and your chip's HAL. A
//! read blocks for 0.4 ms at 400 kHz. At less than 1000 samples a second, raise
//! `sample_rate_divider` and lower the low-pass filter with it.

#![no_std]
#![no_main]

use core::convert::Infallible;

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Config, Error, Mpu6050};
use aplomb::pipeline::{Pipeline, Settings};
use embedded_hal::{delay::DelayNs, digital::InputPin, i2c::I2c};
use stm32f4xx_hal::{i2c::I2c as Bus, pac, prelude::*, rcc};
use {defmt_rtt as _, panic_probe as _};

/// Failed reads in a row after which the example stops.
const MOST_FAILURES: u8 = 100;

/// Reads a sample at each pulse of the sensor's INT pin, and shows every hundredth attitude.
fn show_attitude<I2C: I2c>(
    i2c: I2C,
    interrupt: &mut impl InputPin<Error = Infallible>,
    delay: &mut impl DelayNs,
    now_us: impl Fn() -> u64,
) -> Result<Infallible, Error<I2C::Error>> {
    let config = Config::default();
    let mut sensor = Mpu6050::probe(i2c, delay).map_err(|failure| failure.error)?;
    sensor.configure(&config, delay)?;
    let mut pipeline = Pipeline::new(&Settings::new(sensor.part()));
    let mut failures = 0_u8;
    for number in 1_u32.. {
        // The pulse lasts for 50 µs, so this loop has to poll more often than that. A pin
        // interrupt would be better.
        while let Ok(false) = interrupt.is_high() {}
        let mut burst = match sensor.read_burst(now_us()) {
            Ok(burst) => burst,
            // One lost sample does no harm. Many in a row mean that the sensor is gone.
            Err(error) if failures == MOST_FAILURES => return Err(error),
            Err(_) => {
                failures += 1;
                continue;
            }
        };
        burst.missed_before = core::mem::take(&mut failures);
        let has_failed = burst.missed_before > 0;
        let board = if has_failed {
            BoardFlags::BUS_FAULT
        } else {
            BoardFlags::empty()
        };
        let snapshot = pipeline.update(&burst, board);
        if number.is_multiple_of(100) {
            let angles = snapshot.euler();
            let (roll, pitch) = (angles.roll_rad.to_degrees(), angles.pitch_rad.to_degrees());
            defmt::info!("roll {} pitch {} {}", roll, pitch, snapshot.flags);
        }
    }
    unreachable!("the numbers end after seven weeks")
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let device = pac::Peripherals::take().unwrap();
    let mut rcc = device.RCC.freeze(rcc::Config::hsi().sysclk(84.MHz()));
    let ports = (device.GPIOA.split(&mut rcc), device.GPIOB.split(&mut rcc));
    let i2c = Bus::new(device.I2C1, (ports.1.pb8, ports.1.pb9), 400.kHz(), &mut rcc);
    let mut interrupt = ports.0.pa1.into_pull_down_input();
    let mut delay = device.TIM2.delay_us(&mut rcc);
    let mut counter = device.TIM5.counter_us(&mut rcc);
    counter.start(u32::MAX.micros()).unwrap();
    // The count wraps to zero after 71 minutes, which the filter handles as a pause.
    // `aplomb::units::CounterExtender` avoids that.
    let now_us = || u64::from(counter.now().ticks());
    let Err(error) = show_attitude(i2c, &mut interrupt, &mut delay, now_us);
    panic!("{}", error);
}
