//! Estimates attitude on any microcontroller with an `embedded-hal` bus, without interrupts, DMA or
//! this project's firmware.
//!
//! ```sh
//! cargo run --profile firmware --target thumbv7em-none-eabihf \
//!     --features board-stm32f405 --example polling
//! ```
//!
//! [`show_attitude`] and its functions work on any chip; `main` is for the boards of this project.
//! In a project of your own: `aplomb = { path = "../aplomb" }` without features, and your chip's
//! HAL, which runs the core by a crystal. A read blocks for 0.4 ms at 400 kHz. At less than 1000
//! samples a second, raise `sample_rate_divider` and lower the low-pass filter with it. The
//! settings are read back in another 0.4 ms, so that a sensor that has lost them is found.

#![no_std]
#![no_main]

use core::convert::Infallible;

use aplomb::board::clocks;
use aplomb::fault::ClockSource;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Config, Error, Mpu6050, SettingsState};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::units::CounterExtender;
use embedded_hal::{delay::DelayNs, digital::InputPin, i2c::I2c};
use stm32f4xx_hal::{i2c::I2c as Bus, pac, prelude::*};
use {defmt_rtt as _, panic_probe as _};

/// Missing samples in a row that are reported: 0.3 s.
const MOST_MISSED: u8 = 100;
/// Longest wait for an edge, µs: three sample periods.
const EDGE_TIMEOUT_US: u64 = 3_000;
/// Samples between two checks of the sensor's settings.
const SAMPLES_TO_CHECK: u32 = 44;

/// Finds and configures the sensor.
fn start<I2C: I2c>(
    i2c: I2C,
    config: &Config,
    delay: &mut impl DelayNs,
) -> Result<Mpu6050<I2C>, Error<I2C::Error>> {
    let mut sensor = Mpu6050::probe(i2c, delay).map_err(|failure| failure.error)?;
    sensor.configure(config, delay)?;
    Ok(sensor)
}

/// Reads a sample at each pulse of the sensor's INT pin, and shows every hundredth attitude.
///
/// `clock` goes with each burst: [`BoardFlags::INTERNAL_CLOCK`] if `now_us` counts by an oscillator
/// without a crystal. It may be wrong by 8 %; the attitude then goes by the sensor's clock.
///
/// The pipeline outlasts each fault, with attitude and bias: after a new start in flight neither
/// would be known. A failed transfer costs one sample.
fn show_attitude<I2C: I2c>(
    mut sensor: Mpu6050<I2C>,
    config: &Config,
    interrupt: &mut impl InputPin<Error = Infallible>,
    delay: &mut impl DelayNs,
    mut now_us: impl FnMut() -> u64,
    clock: BoardFlags,
) -> ! {
    let mut settings = Settings::for_sensor(sensor.part(), config);
    settings.verifies_scales = true;
    let mut pipeline = Pipeline::new(&settings);
    // Missing samples in a row, and the flags of the next burst.
    let (mut missed, mut board) = (0_u8, clock);
    let mut number = 0_u32;
    loop {
        number = number.wrapping_add(1);
        let edge = next_edge(interrupt, &mut now_us);
        let burst = edge.map(|edge_us| sensor.read_burst(edge_us));
        if matches!(burst, Some(Err(_))) {
            board |= BoardFlags::BUS_FAULT;
        }
        let snapshot = if let Some(Ok(mut burst)) = burst {
            burst.missed_before = core::mem::take(&mut missed);
            pipeline.update(&burst, core::mem::replace(&mut board, clock))
        } else {
            missed = missed.saturating_add(1);
            pipeline.stale(now_us(), board)
        };
        show(number, &snapshot);
        if missed == MOST_MISSED {
            defmt::warn!("no samples: check the wires of the sensor");
        }
        // A sensor that has reset itself gives no edges. After a jump of the rate no attitude is
        // valid before the settings are checked.
        let is_due = number.is_multiple_of(SAMPLES_TO_CHECK);
        if is_due || missed > 0 || pipeline.awaits_scale_check() {
            board.remove(BoardFlags::SCALES_VERIFIED);
            board |= check_settings(&mut sensor, config, delay);
        }
    }
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

/// Reads the sensor's settings back, and restores them in 35 ms if they are wrong. Returns the
/// flags of the next burst. A failed transfer is one of them: the next check follows.
fn check_settings<I2C: I2c>(
    sensor: &mut Mpu6050<I2C>,
    config: &Config,
    delay: &mut impl DelayNs,
) -> BoardFlags {
    match sensor.verify_config(config) {
        Ok(SettingsState::Intact) => BoardFlags::SCALES_VERIFIED,
        Ok(SettingsState::Reset | SettingsState::Changed) => {
            // If it fails, the next check finds the settings lost again.
            let _ = sensor.reconfigure(config, delay);
            BoardFlags::SENSOR_RESET
        }
        Err(_) => BoardFlags::BUS_FAULT,
    }
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
    let (mut rcc, source) = clocks::start(device.RCC);
    let clock = match source {
        ClockSource::Crystal => BoardFlags::empty(),
        ClockSource::InternalOscillator => BoardFlags::INTERNAL_CLOCK,
    };
    let ports = (device.GPIOA.split(&mut rcc), device.GPIOB.split(&mut rcc));
    let i2c = Bus::new(device.I2C1, (ports.1.pb8, ports.1.pb9), 400.kHz(), &mut rcc);
    let mut interrupt = ports.0.pa1.into_pull_down_input();
    let mut delay = device.TIM2.delay_us(&mut rcc);
    let mut counter = device.TIM5.counter_us(&mut rcc);
    counter.start(u32::MAX.micros()).unwrap();
    let mut extender = CounterExtender::new(0);
    let now_us = || extender.extend(counter.now().ticks());
    let config = Config::default();
    let sensor = match start(i2c, &config, &mut delay) {
        Ok(sensor) => sensor,
        Err(error) => panic!("{}", error),
    };
    show_attitude(sensor, &config, &mut interrupt, &mut delay, now_us, clock)
}
