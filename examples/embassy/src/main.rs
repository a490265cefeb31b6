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
use embassy_stm32::rcc::{
    self, AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllSource,
    Sysclk,
};
use embassy_stm32::time::{khz, mhz};
use embassy_stm32::{bind_interrupts, dma, interrupt, peripherals};
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_hal_async::{digital::Wait, i2c::I2c as Bus};
use {defmt_rtt as _, panic_probe as _};

/// Longest wait for an edge: three sample periods.
const EDGE_TIMEOUT: Duration = Duration::from_millis(3);
/// Missing samples in a row that are reported.
const MOST_MISSED: u8 = 100;
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

/// Reads registers from this one on.
async fn read<I: Bus>(
    i2c: &mut I,
    address: u8,
    first: Register,
    bytes: &mut [u8],
) -> Result<(), I::Error> {
    let result = i2c.write_read(address, &[first.address()], bytes).await;
    Timer::after_micros(STOP_US).await;
    result
}

/// Searches both addresses; `None` if no sensor of this family answers.
async fn find(i2c: &mut impl Bus) -> Option<Sensor> {
    for address in ADDRESSES {
        let mut byte = [0];
        let answer = read(i2c, address, Register::WhoAmI, &mut byte).await;
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
    /// Writes settings.
    async fn write<I: Bus>(
        &self,
        i2c: &mut I,
        steps: impl IntoIterator<Item = Step>,
    ) -> Result<(), I::Error> {
        for step in steps {
            let bytes = [step.register.address(), step.value];
            let result = i2c.write(self.address, &bytes).await;
            Timer::after_micros(STOP_US + 1_000 * u64::from(step.wait_ms)).await;
            result?;
        }
        Ok(())
    }

    /// Reads the settings back. Returns whether they are as configured.
    async fn is_intact<I: Bus>(&self, i2c: &mut I) -> Result<bool, I::Error> {
        for check in Check::all(&self.config, self.part) {
            let mut bytes = [0; Check::LONGEST];
            let registers = &mut bytes[..check.length];
            read(i2c, self.address, check.first, registers).await?;
            if check.evaluate(&bytes) != SettingsState::Intact {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Reads the settings back, and restores them in 30 ms if the sensor has lost one. Returns the
    /// flags of the next burst. A failed transfer is one of them: the next check follows.
    async fn check(&self, i2c: &mut impl Bus) -> BoardFlags {
        match self.is_intact(i2c).await {
            Ok(true) => BoardFlags::SCALES_VERIFIED,
            Ok(false) => {
                let steps = Step::reconfiguration(&self.config, self.part);
                // If it fails, the next check finds the settings lost again.
                let _ = self.write(i2c, steps).await;
                BoardFlags::SENSOR_RESET
            }
            Err(_) => BoardFlags::BUS_FAULT,
        }
    }

    /// Reads the sample of this edge.
    async fn read_burst<I: Bus>(&self, i2c: &mut I, edge: Instant) -> Result<Burst, I::Error> {
        let mut bytes = [0; BURST_LENGTH];
        let first = Register::AccelerometerXHigh;
        read(i2c, self.address, first, &mut bytes).await?;
        Ok(Burst {
            bytes,
            captured_at_us: edge.as_micros(),
            missed_before: 0,
        })
    }
}

/// Reads a sample at every edge of INT, and shows every hundredth attitude.
///
/// The pipeline outlasts each fault, with attitude and bias: after a new start in flight neither
/// would be known. A failed transfer costs one sample.
async fn show_attitude(i2c: &mut impl Bus, interrupt: &mut impl Wait, sensor: &Sensor) -> ! {
    let mut settings = Settings::for_sensor(sensor.part, &sensor.config);
    settings.verifies_scales = true;
    let mut pipeline = Pipeline::new(&settings);
    // Missing samples in a row, and the flags of the next burst.
    let (mut missed, mut board) = (0_u8, BoardFlags::empty());
    let mut number = 0_u32;
    loop {
        number = number.wrapping_add(1);
        let edge = with_timeout(EDGE_TIMEOUT, interrupt.wait_for_rising_edge()).await;
        let now = Instant::now();
        let burst = match edge {
            Ok(_) => sensor
                .read_burst(i2c, now)
                .await
                .map_err(|_| BoardFlags::BUS_FAULT),
            Err(_) => Err(BoardFlags::empty()),
        };
        let snapshot = match burst {
            Ok(mut burst) => {
                burst.missed_before = core::mem::take(&mut missed);
                pipeline.update(&burst, core::mem::take(&mut board))
            }
            Err(flags) => {
                missed = missed.saturating_add(1);
                board |= flags;
                pipeline.stale(now.as_micros(), board)
            }
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
            board |= sensor.check(i2c).await;
        }
    }
}

/// Shows every hundredth attitude. Rely on it only with `VALID` among its flags.
fn show(number: u32, snapshot: &Snapshot) {
    if number.is_multiple_of(100) {
        let angles = snapshot.euler();
        let (roll, pitch) = (angles.roll_rad.to_degrees(), angles.pitch_rad.to_degrees());
        let is_valid = snapshot.flags.contains(Flags::VALID);
        defmt::info!("valid {} roll {} pitch {}", is_valid, roll, pitch);
    }
}

/// Returns the clocks of a board with a crystal of 8 MHz: 168 MHz for the core, and 42 MHz for the
/// bus's port. Turns measured by the internal oscillator would be wrong by up to 8 %. For a board
/// without a crystal report [`BoardFlags::INTERNAL_CLOCK`] with each burst.
fn clocks() -> rcc::Config {
    let mut clocks = rcc::Config::default();
    clocks.hse = Some(Hse {
        freq: mhz(8),
        mode: HseMode::Oscillator,
    });
    clocks.pll_src = PllSource::HSE;
    clocks.pll = Some(Pll {
        prediv: PllPreDiv::DIV8,
        mul: PllMul::MUL336,
        divp: Some(PllPDiv::DIV2),
        divq: None,
        divr: None,
    });
    clocks.sys = Sysclk::PLL1_P;
    clocks.ahb_pre = AHBPrescaler::DIV1;
    clocks.apb1_pre = APBPrescaler::DIV4;
    clocks.apb2_pre = APBPrescaler::DIV2;
    clocks
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
    let mut config = embassy_stm32::Config::default();
    config.rcc = clocks();
    let p = embassy_stm32::init(config);
    let mut settings = i2c::Config::default();
    settings.frequency = khz(400);
    let mut bus = I2c::new(
        p.I2C1, p.PB8, p.PB9, p.DMA1_CH6, p.DMA1_CH0, Interrupts, settings,
    );
    let mut interrupt = ExtiInput::new(p.PA1, p.EXTI1, Pull::Down, Interrupts);
    let sensor = loop {
        if let Some(sensor) = find(&mut bus).await {
            let steps = Step::configuration(&sensor.config, sensor.part);
            if sensor.write(&mut bus, steps).await.is_ok() {
                break sensor;
            }
        }
        defmt::warn!("no sensor answers");
        Timer::after_millis(100).await;
    };
    show_attitude(&mut bus, &mut interrupt, &sensor).await
}
