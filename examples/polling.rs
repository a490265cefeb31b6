//! Estimates attitude on any microcontroller with an `embedded-hal` bus, without interrupts, DMA or
//! this project's firmware.
//!
//! ```sh
//! cargo run --profile firmware --target thumbv7em-none-eabihf \
//!     --features board-stm32f405 --example polling
//! ```
//!
//! [`show_attitude`] does all the work on any chip; `main` is for an STM32F4 with `stm32f4xx-hal`.
//! In a project of your own: `aplomb = { path = "../aplomb" }` without features, and your chip's
//! HAL. A read blocks for 0.4 ms at 400 kHz. At less than 1000 samples a second, raise
//! `sample_rate_divider` and lower the low-pass filter with it. The settings are read back in
//! another 0.4 ms, so that a sensor that has lost them is found.

#![no_std]
#![no_main]

use core::convert::Infallible;

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Config, Error, Mpu6050, SettingsState};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::units::CounterExtender;
use embedded_hal::{delay::DelayNs, digital::InputPin, i2c::I2c};
use stm32f4xx_hal::{i2c::I2c as Bus, pac, prelude::*, rcc};
use {defmt_rtt as _, panic_probe as _};

/// Missing samples in a row after which the example stops: 0.3 s.
const MOST_MISSED: u8 = 100;
/// Longest wait for an edge, µs: three sample periods.
const EDGE_TIMEOUT_US: u64 = 3_000;
/// Samples between two checks of the sensor's settings.
const SAMPLES_TO_CHECK: u32 = 44;

/// Reads a sample at each pulse of the sensor's INT pin, and shows every hundredth attitude.
///
/// Returns after [`MOST_MISSED`] missing samples: an error if the sensor is gone, and `Ok` if it
/// answers, but gives no edges.
fn show_attitude<I2C: I2c>(
    i2c: I2C,
    interrupt: &mut impl InputPin<Error = Infallible>,
    delay: &mut impl DelayNs,
    mut now_us: impl FnMut() -> u64,
) -> Result<(), Error<I2C::Error>> {
    let config = Config::default();
    let mut sensor = Mpu6050::probe(i2c, delay).map_err(|failure| failure.error)?;
    sensor.configure(&config, delay)?;
    let mut settings = Settings::for_sensor(sensor.part(), &config);
    settings.verifies_scales = true;
    let mut pipeline = Pipeline::new(&settings);
    // Missing samples in a row, and what the next burst reports of them.
    let (mut missed, mut board) = (0_u8, BoardFlags::empty());
    for number in 1_u32.. {
        let edge = next_edge(interrupt, &mut now_us);
        let burst = edge.map(|edge_us| sensor.read_burst(edge_us));
        if let Some(Ok(mut burst)) = burst {
            burst.missed_before = core::mem::take(&mut missed);
            let snapshot = pipeline.update(&burst, core::mem::take(&mut board));
            show(number, &snapshot);
            // After a jump of the rate no attitude is valid before the settings are checked.
            if number.is_multiple_of(SAMPLES_TO_CHECK) || pipeline.awaits_scale_check() {
                let checked = check_settings(&mut sensor, &config, delay, &mut board);
                board.set(BoardFlags::BUS_FAULT, checked.is_err());
            }
            continue;
        }
        missed += 1;
        if burst.is_some() {
            board |= BoardFlags::BUS_FAULT;
        }
        show(number, &pipeline.stale(now_us(), board));
        // A sensor that has reset itself gives no edges.
        let checked = check_settings(&mut sensor, &config, delay, &mut board);
        if missed == MOST_MISSED {
            return checked;
        }
    }
    Ok(())
}

/// Waits for an edge. Returns its time in µs; `None` if it does not come.
fn next_edge(
    interrupt: &mut impl InputPin<Error = Infallible>,
    now_us: &mut impl FnMut() -> u64,
) -> Option<u64> {
    let start_us = now_us();
    // The pulse lasts for 50 µs, so this loop has to poll more often than that. A pin interrupt
    // would be better.
    loop {
        let t_us = now_us();
        if interrupt.is_high() == Ok(true) {
            return Some(t_us);
        }
        if t_us.wrapping_sub(start_us) > EDGE_TIMEOUT_US {
            return None;
        }
    }
}

/// Reads the sensor's settings back, and restores them in 35 ms if they are wrong. Adds what the
/// next burst reports to `board`.
fn check_settings<I2C: I2c>(
    sensor: &mut Mpu6050<I2C>,
    config: &Config,
    delay: &mut impl DelayNs,
    board: &mut BoardFlags,
) -> Result<(), Error<I2C::Error>> {
    if sensor.verify_config(config)? == SettingsState::Intact {
        *board |= BoardFlags::SCALES_VERIFIED;
        return Ok(());
    }
    *board |= BoardFlags::SENSOR_RESET;
    sensor.reconfigure(config, delay)
}

/// Shows every hundredth attitude.
fn show(number: u32, snapshot: &Snapshot) {
    if number.is_multiple_of(100) {
        let angles = snapshot.euler();
        let (roll, pitch) = (angles.roll_rad.to_degrees(), angles.pitch_rad.to_degrees());
        defmt::info!("roll {} pitch {} {}", roll, pitch, snapshot.flags);
    }
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
    let mut extender = CounterExtender::new(0);
    let now_us = || extender.extend(counter.now().ticks());
    match show_attitude(i2c, &mut interrupt, &mut delay, now_us) {
        Ok(()) => panic!("the sensor answers, but no edge comes: check the wire of INT"),
        Err(error) => panic!("{}", error),
    }
}
