//! The microcontroller with its pins wired up. It is rigless's STM32F427, which runs the image of
//! an STM32F401, F405, F411 or F446 unchanged, with additions to that model.
//!
//! | wire | from | to |
//! |---|---|---|
//! | INT | the sensor | PA1, and from there EXTI line 1 and TIM5 channel 2, at the same instant |
//! | SCL, SDA | I2C1 and the sensor | PB8, PB9, pulled up; the bytes go apart from the pins |
//! | TX, RX | USART2 on PA2 and PA3 | [`Terminal`], which records all bytes and sends a script |

#[cfg(test)]
mod fault_tests;
mod terminal;
#[cfg(test)]
mod tests;

use rigless::chip::uart::Rate;
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::mcu::Mcu;
use rigless::soc::stm32f427::Stm32f427;
use rigless::soc::stm32f427::generated::dbg;
use rigless::soc::stm32f427::generated::flash::{self, acr};
use rigless::soc::stm32f427::generated::gpioa;
use rigless::soc::stm32f427::generated::pwr::{self, cr as pwr_cr};
use rigless::soc::stm32f427::generated::rcc::{self, cir, csr};
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin};
use rigless::soc::stm32f427::peripherals::tim::Channel;
use rigless::soc::{Bus, Error};
use rigless::time::VirtualNanos;

pub use terminal::{ReceivedByte, SentByte, Terminal};

use crate::bus_step::BusStep;
use crate::checks::Checks;
use crate::crystal::{CrystalAware, HighSpeedInput};
use crate::dma::RefusedDma;
use crate::exti::{self, Exti, Syscfg};
use crate::faults::{CORE_MILLIVOLTS, Fault, FaultKind, Sag, ScheduledFault, scheduled, within};
use crate::fitted::BusDevices;
use crate::flash::{FlashInterface, SharedCells};
use crate::i2c::{WiredI2c, items_left};
use crate::regulator::Regulator;
use crate::watchdog::CheckedWatchdog;
use crate::wires::PortB;

/// Port A's number, as SYSCFG_EXTICR counts them.
const PORT_A: u8 = 0;

/// The pin of INT: PA1.
const INTERRUPT_PIN: u8 = 1;

/// PA1 reaches TIM5 channel 2 through this alternate function (STM32F405 datasheet, table 9).
const TIM5_FUNCTION: u8 = 2;

/// TX and RX of USART2: PA2 and PA3, by this alternate function (STM32F405 datasheet, table 9).
const UART_PINS: [u8; 2] = [2, 3];
const USART2_FUNCTION: u8 = 7;

/// Places in rigless's lists of instances.
const PORT_B: usize = 1;
const DMA1: usize = 0;
const I2C1: usize = 0;
const USART2: usize = 1;
const TIM5: usize = 3;

/// The board's supply.
const SUPPLY_MILLIVOLTS: u32 = 3300;

/// The microcontroller and what hangs on its pins.
#[derive(Debug)]
pub struct Microcontroller {
    part: Stm32f427,
    clocks: CrystalAware,
    sensor_bus: WiredI2c,
    port_b: PortB,
    dma: RefusedDma,
    exti: Exti,
    syscfg: Syscfg,
    flash: FlashInterface,
    watchdog: CheckedWatchdog,
    checks: Checks,
    identity: ChipIdentity,
    slots: Slots,
    /// The next change of the sensor's wire, for which an event is scheduled.
    awaited_ns: Option<u64>,
    /// The faults of a schedule.
    faults: Vec<ScheduledFault>,
    sags: Vec<Sag>,
    supply_millivolts: u32,
    /// The steps of the bus in which the faults began, as far as they have.
    steps_at_faults: Vec<BusStep>,
    /// True if the crystal has stopped.
    is_crystal_dead: bool,
    /// True if the crystal stopped without a replacement, so that the core has no clock.
    is_clock_lost: bool,
    /// True if the UART's line garbles received bytes.
    is_noisy: bool,
    /// Time of the last reset, ns.
    reset_ns: u64,
}

/// Bytes of a million that come with noise, and as many with a framing error, while the UART's line
/// garbles.
const NOISE_PER_MILLION: u32 = 200_000;

/// The chip, as DBGMCU_IDCODE has it (RM0090, 38.6.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChipIdentity {
    /// DEV_ID.
    pub device: u16,
    /// REV_ID.
    pub revision: u16,
}

impl ChipIdentity {
    /// An STM32F405 of revision A, which reports the STM32F2's DEV_ID (errata sheet ES0182, "MCU
    /// device ID is incorrect").
    pub const STM32F405_A: Self = Self {
        device: 0x411,
        revision: 0x1000,
    };
    /// An STM32F405 of revision Y.
    pub const STM32F405_Y: Self = Self {
        device: 0x413,
        revision: 0x100F,
    };
}

/// Positions of the decorated instances on the bus.
#[derive(Clone, Copy, Debug)]
struct Slots {
    rcc: usize,
    i2c1: usize,
    exti: usize,
    syscfg: usize,
    flash: usize,
    watchdog: usize,
    debug: usize,
    dma1: usize,
    power: usize,
    usart2: usize,
    port_a: usize,
    port_b: usize,
}

impl Microcontroller {
    /// A part fresh out of reset with a sensor and an oscillator.
    ///
    /// # Errors
    ///
    /// When rigless's description of the part does not have what is decorated here.
    pub fn new(
        sensor: BusDevices,
        input: HighSpeedInput,
        mut terminal: Terminal,
        cells: SharedCells,
    ) -> Result<Self, Error> {
        let mut part = Stm32f427::new()?;
        part.rcc.attach_crystals(input.frequency_hz(), 0);
        part.set_supply(SUPPLY_MILLIVOLTS);
        let faults: Vec<ScheduledFault> = scheduled(sensor.faults()).copied().collect();
        let all_faults = sensor.faults().to_vec();
        let wires = sensor.wires();
        terminal.flood(&faults);
        part.usart[USART2].attach(terminal);
        part.i2c[I2C1].attach(sensor);
        let bus = part.bus();
        let slots = Slots {
            rcc: bus.slot("RCC")?,
            i2c1: bus.slot("I2C1")?,
            exti: bus.slot("EXTI")?,
            syscfg: bus.slot("SYSCFG")?,
            flash: bus.slot("FLASH")?,
            watchdog: bus.slot("IWDG")?,
            debug: bus.slot("DBG")?,
            dma1: bus.slot("DMA1")?,
            power: bus.slot("PWR")?,
            usart2: bus.slot("USART2")?,
            port_a: bus.slot("GPIOA")?,
            port_b: bus.slot("GPIOB")?,
        };
        let mut spare = Stm32f427::new()?;
        std::mem::swap(&mut spare.rcc, &mut part.rcc);
        std::mem::swap(&mut spare.flash, &mut part.flash);
        std::mem::swap(&mut spare.iwdg, &mut part.iwdg);
        std::mem::swap(&mut spare.i2c[I2C1], &mut part.i2c[I2C1]);
        std::mem::swap(&mut spare.gpio[PORT_B], &mut part.gpio[PORT_B]);
        std::mem::swap(&mut spare.dma[DMA1], &mut part.dma[DMA1]);
        let [i2c1, ..] = spare.i2c;
        let [_, port_b, ..] = spare.gpio;
        let [dma1, ..] = spare.dma;
        let checks = Checks::default();
        let mut controller = Self {
            part,
            clocks: CrystalAware::new(spare.rcc, input, checks.clone()),
            sensor_bus: WiredI2c::new(i2c1, wires.clone(), &all_faults, checks.clone()),
            port_b: PortB {
                model: port_b,
                wires,
            },
            dma: RefusedDma::new(dma1, &all_faults, checks.clone()),
            exti: Exti::default(),
            syscfg: Syscfg,
            flash: FlashInterface {
                model: spare.flash,
                cells,
            },
            watchdog: CheckedWatchdog::new(spare.iwdg, checks.clone()),
            checks,
            identity: ChipIdentity::STM32F405_Y,
            slots,
            awaited_ns: None,
            faults,
            sags: all_faults.iter().filter_map(Fault::sag).collect(),
            supply_millivolts: SUPPLY_MILLIVOLTS,
            steps_at_faults: Vec::new(),
            is_crystal_dead: false,
            is_clock_lost: false,
            is_noisy: false,
            reset_ns: 0,
        };
        controller.identify(ChipIdentity::STM32F405_Y);
        controller.reset_regulator(VirtualNanos(0));
        controller.release_pins(VirtualNanos(0));
        Ok(controller)
    }

    /// The sensor.
    ///
    /// # Panics
    ///
    /// Never: [`Self::new`] has put it there.
    pub fn sensor(&mut self) -> &mut BusDevices {
        self.sensor_bus
            .model
            .chip_mut(0)
            .expect("the sensor is the one chip on this bus")
    }

    /// Returns the supply, mV.
    #[must_use]
    pub fn supply_millivolts(&self) -> u32 {
        self.supply_millivolts
    }

    /// The checks of the core's accesses.
    #[must_use]
    pub fn checks(&self) -> &Checks {
        &self.checks
    }

    /// Returns the end of the flash operation that was started last, ns since power-up.
    #[must_use]
    pub fn flash_busy_until_ns(&self) -> u64 {
        self.flash.cells.with(|cells| cells.busy_until_ns())
    }

    /// The steps of the bus in which the scheduled faults began, in the order of the faults, as far
    /// as they have begun.
    #[must_use]
    pub fn steps_at_faults(&self) -> &[BusStep] {
        &self.steps_at_faults
    }

    /// The far end of the UART.
    ///
    /// # Panics
    ///
    /// Never: [`Self::new`] has put it there.
    pub fn terminal(&mut self) -> &mut Terminal {
        self.part.usart[USART2]
            .chip_mut()
            .expect("the terminal is at the end of this line")
    }

    /// Sets the frequency of the watchdog's oscillator, Hz. Call it before the first instruction.
    pub fn calibrate_watchdog(&mut self, hz: u64) {
        self.clocks.model.calibrate_lsi(hz);
    }

    /// Makes the watchdog take long for a new limit.
    pub fn slow_watchdog(&mut self) {
        self.watchdog.is_slow = true;
    }

    /// Sets the contents of DBGMCU_IDCODE. Call it before the first instruction.
    pub fn identify(&mut self, identity: ChipIdentity) {
        self.identity = identity;
        self.show_identity(VirtualNanos(0));
    }

    fn show_identity(&mut self, at: VirtualNanos) {
        let (registers, _) = self.part.bus_mut().drive(at, self.slots.debug);
        let ChipIdentity { device, revision } = self.identity;
        let code = u64::from(revision) << 16 | u64::from(device);
        registers.set(dbg::Register::DbgmcuIdcode, code);
    }

    /// Sets the regulator and the clock of the core. Call it before the first instruction.
    pub fn fit(&mut self, regulator: Regulator, core_hz: u64) {
        self.clocks.regulator = regulator;
        self.clocks.instructions_hz = core_hz;
        self.reset_regulator(VirtualNanos(0));
    }

    fn reset_regulator(&mut self, at: VirtualNanos) {
        let value = self.clocks.regulator.reset;
        let (registers, _) = self.part.bus_mut().drive(at, self.slots.power);
        registers.set(pwr::Register::Cr, value);
    }

    /// Returns true if the flash's prefetch is on.
    #[must_use]
    pub fn prefetches(&self) -> bool {
        let registers = self.part.bus().slots()[self.slots.flash].registers();
        acr::PRFTEN.is_set(registers.get(flash::Register::Acr))
    }

    /// Returns true if the flash's prefetch is on, on a chip that does not support it: an STM32F405
    /// of revision A (errata sheet ES0182).
    #[must_use]
    pub fn prefetches_on_revision_a(&self) -> bool {
        self.prefetches() && self.identity == ChipIdentity::STM32F405_A
    }

    /// Makes a START of the sensor's bus take time.
    pub fn let_starts_take_time(&mut self) {
        self.sensor_bus.start_takes_time = true;
    }

    /// Makes the port of the sensor's bus clock on at once after a byte that it did not
    /// acknowledge.
    pub fn leave_no_time_for_stop(&mut self) {
        self.sensor_bus.waits_for_stop = false;
    }

    /// Garbles what the firmware receives: so many bytes in a million arrive with noise, and so
    /// many with a framing error.
    pub fn garble_reception(
        &mut self,
        seed: u64,
        noise_per_million: u32,
        framing_per_million: u32,
    ) {
        let errors = self.part.usart[USART2].errors_mut();
        errors.seed = seed;
        errors.noise = Rate {
            name: "noise",
            per_million: noise_per_million,
        };
        errors.framing = Rate {
            name: "framing",
            per_million: framing_per_million,
        };
    }

    /// Returns true if the clock security system has detected a failure of the crystal, until the
    /// firmware clears it. The core executes the NMI for as long (RM0090, 7.2.7).
    #[must_use]
    pub fn has_clock_failure(&self) -> bool {
        let registers = self.part.bus().slots()[self.slots.rcc].registers();
        cir::CSSF.is_set(registers.get(rcc::Register::Cir))
    }

    /// Returns true if the core executes nothing: it is stalled, hangs, or has no clock.
    #[must_use]
    pub fn is_core_held(&self, now_ns: u64) -> bool {
        let holds = |fault: &ScheduledFault| match fault.kind {
            FaultKind::CoreStall => fault.lasts(now_ns),
            FaultKind::WatchdogHang => fault.lasts(now_ns) && self.reset_ns < fault.start_ns,
            _ => false,
        };
        self.is_clock_lost || self.faults.iter().any(holds)
    }

    /// The levels that the board's resistors give the pins before anything else drives them.
    fn release_pins(&mut self, at: VirtualNanos) {
        self.follow_bus(at);
        self.drive_pin(at, INTERRUPT_PIN, false);
    }

    /// Updates the port and the controller from the lines of the bus.
    fn follow_bus(&mut self, at: VirtualNanos) {
        let slots = self.slots;
        let (registers, mut context) = self.part.bus_mut().drive(at, slots.port_b);
        self.port_b.follow(at, registers, &mut context);
        self.sensor_bus.is_connected = PortB::is_connected(registers);
        let (registers, mut context) = self.part.bus_mut().drive(at, slots.i2c1);
        self.sensor_bus.follow_lines(registers, &mut context);
    }

    fn drive_pin(&mut self, at: VirtualNanos, pin: u8, high: bool) {
        let Some(pin) = Pin::new(pin) else { return };
        self.part
            .drive_port(at, usize::from(PORT_A), |gpio, registers, context| {
                gpio.drive(pin, Some(Level::from(high)), registers, context);
            });
    }

    /// Notes the step of the bus for each fault that has begun.
    fn note_steps(&mut self, now: VirtualNanos) {
        let begins = |fault: &ScheduledFault| fault.start_ns <= now.0;
        while (self.faults.get(self.steps_at_faults.len())).is_some_and(begins) {
            let registers = self.part.bus().slots()[self.slots.i2c1].registers();
            self.steps_at_faults.push(self.sensor_bus.step(registers));
        }
    }

    /// Begins and ends the faults of the microcontroller itself.
    fn follow_faults(&mut self, now: VirtualNanos) {
        let lasts = |kind: FaultKind| {
            self.faults
                .iter()
                .any(|fault| fault.kind == kind && fault.lasts(now.0))
        };
        let (is_dead, is_noisy) = (lasts(FaultKind::CrystalDies), lasts(FaultKind::UartNoise));
        if is_dead != self.is_crystal_dead {
            self.is_crystal_dead = is_dead;
            self.is_clock_lost = false;
            if is_dead {
                let (registers, mut context) = self.part.bus_mut().drive(now, self.slots.rcc);
                self.is_clock_lost = self.clocks.stop_crystal(registers, &mut context);
            } else {
                self.clocks.restart_crystal();
            }
        }
        let sags = self.sags.iter().filter(|(range, _)| within(now.0, range));
        let lowest = sags.map(|&(_, millivolts)| millivolts).min();
        let millivolts = lowest.unwrap_or(SUPPLY_MILLIVOLTS);
        if millivolts != self.supply_millivolts {
            let was_off = self.supply_millivolts < CORE_MILLIVOLTS;
            let is_off = millivolts < CORE_MILLIVOLTS;
            self.supply_millivolts = millivolts;
            if was_off != is_off {
                let (_, mut context) = self.part.bus_mut().drive(now, self.slots.rcc);
                context.request_power(!is_off);
            }
            self.lend_models();
            self.part.set_supply(millivolts);
            self.lend_models();
            self.flash
                .cells
                .with(|cells| cells.set_supply(now.0, millivolts));
        }
        if is_noisy != self.is_noisy {
            self.is_noisy = is_noisy;
            let errors = self.part.usart[USART2].errors_mut();
            let per_million = if is_noisy { NOISE_PER_MILLION } else { 0 };
            errors.noise.per_million = per_million;
            errors.framing.per_million = per_million;
        }
    }

    /// Advances the sensor to `now`, passes the changes of INT along the wire, and schedules the
    /// next call.
    fn follow_sensor(&mut self, now: VirtualNanos) {
        let registers = self.part.bus().slots()[self.slots.port_a].registers();
        let pulls = registers.get(gpioa::Register::Pupdr) >> (2 * INTERRUPT_PIN) & 3;
        self.sensor().set_pull_up(pulls == 1);
        for (changed_ns, high) in self.sensor().advance_to(now.0) {
            self.interrupt_wire(now, VirtualNanos(changed_ns), high);
        }
        let next_ns = self.sensor().next_event_ns();
        if next_ns != self.awaited_ns {
            self.awaited_ns = next_ns;
            self.follow_bus(now);
            self.follow_faults(now);
            if let Some(next_ns) = next_ns {
                let (_, mut context) = self.part.bus_mut().drive(now, self.slots.exti);
                context.schedule(VirtualNanos(next_ns));
            }
        }
    }

    /// Processes a change of the INT wire. The core sees it `at` the next access; the timer
    /// captures the instant itself, whatever the core does.
    fn interrupt_wire(&mut self, at: VirtualNanos, changed: VirtualNanos, high: bool) {
        self.drive_pin(at, INTERRUPT_PIN, high);
        let slots = self.slots;
        let registers = |slot: usize| self.part.bus().slots()[slot].registers();
        let is_routed = exti::routes(PORT_A, INTERRUPT_PIN, registers(slots.syscfg));
        let function =
            Pin::new(INTERRUPT_PIN).and_then(|pin| Gpio::function(pin, registers(slots.port_a)));
        if is_routed {
            let (registers, mut context) = self.part.bus_mut().drive(at, slots.exti);
            self.exti.edge(INTERRUPT_PIN, high, registers, &mut context);
        }
        if function == Some(TIM5_FUNCTION)
            && let Some(channel) = Channel::new(2)
        {
            self.part
                .drive_timer(changed, TIM5, |timer, registers, context| {
                    timer.drive_input(channel, Level::from(high), registers, context);
                });
        }
    }

    /// Connects the terminal to the pins that have the UART's function.
    fn connect_terminal(&mut self) {
        let registers = self.part.bus().slots()[self.slots.port_a].registers();
        let is_connected = UART_PINS.map(|pin| {
            let function = Pin::new(pin).and_then(|pin| Gpio::function(pin, registers));
            function == Some(USART2_FUNCTION)
        });
        self.terminal().is_connected = is_connected;
    }

    /// Lends the decorated models to the part for as long as it rebuilds itself.
    fn lend_models(&mut self) {
        std::mem::swap(&mut self.clocks.model, &mut self.part.rcc);
        std::mem::swap(&mut self.flash.model, &mut self.part.flash);
        std::mem::swap(&mut self.watchdog.model, &mut self.part.iwdg);
        std::mem::swap(&mut self.sensor_bus.model, &mut self.part.i2c[I2C1]);
        std::mem::swap(&mut self.port_b.model, &mut self.part.gpio[PORT_B]);
        std::mem::swap(&mut self.dma.model, &mut self.part.dma[DMA1]);
    }
}

impl Mcu for Microcontroller {
    fn bus(&self) -> &Bus {
        self.part.bus()
    }

    fn bus_mut(&mut self) -> &mut Bus {
        self.part.bus_mut()
    }

    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        self.sensor().controller_restarts(at.0);
        let is_power_on = cause == ResetCause::PowerOn;
        self.lend_models();
        // rigless has no power-on reset of this part.
        let known = if is_power_on { ResetCause::Pin } else { cause };
        self.part.reset(at, known);
        self.lend_models();
        if is_power_on {
            let (registers, _) = self.part.bus_mut().drive(at, self.slots.rcc);
            let status = registers.get(rcc::Register::Csr);
            let causes = csr::PORRSTF.mask() | csr::BORRSTF.mask() | csr::PADRSTF.mask();
            registers.set(rcc::Register::Csr, status | causes);
        }
        self.show_identity(at);
        self.reset_regulator(at);
        self.clocks.delayed.clear();
        self.sensor_bus.forget();
        self.dma.forget();
        self.watchdog.forget();
        self.exti = Exti::default();
        self.flash.restart(at.0);
        self.awaited_ns = None;
        self.is_clock_lost = false;
        self.reset_ns = at.0;
        self.release_pins(at);
        if is_power_on {
            // Without supply the core makes no access that would ask for the next event.
            self.follow_sensor(at);
        }
    }

    fn poll(&mut self, now: VirtualNanos) {
        self.note_steps(now);
        self.part.poll(now);
        self.follow_sensor(now);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        if slot == self.slots.rcc {
            let power = self.part.bus().slots()[self.slots.power].registers();
            self.clocks.voltage_scale = pwr_cr::VOS.get(power.get(pwr::Register::Cr));
            (self.part.bus_mut(), Some(&mut self.clocks))
        } else if slot == self.slots.i2c1 {
            let bus = self.part.bus_mut();
            self.sensor_bus.items_left = items_left(bus.slots()[self.slots.dma1].registers());
            self.sensor_bus.is_connected =
                PortB::is_connected(bus.slots()[self.slots.port_b].registers());
            (bus, Some(&mut self.sensor_bus))
        } else if slot == self.slots.port_b {
            (self.part.bus_mut(), Some(&mut self.port_b))
        } else if slot == self.slots.dma1 {
            (self.part.bus_mut(), Some(&mut self.dma))
        } else if slot == self.slots.flash {
            (self.part.bus_mut(), Some(&mut self.flash))
        } else if slot == self.slots.watchdog {
            (self.part.bus_mut(), Some(&mut self.watchdog))
        } else if slot == self.slots.exti {
            (self.part.bus_mut(), Some(&mut self.exti))
        } else if slot == self.slots.syscfg {
            (self.part.bus_mut(), Some(&mut self.syscfg))
        } else {
            if slot == self.slots.usart2 {
                self.connect_terminal();
            }
            self.part.split(slot)
        }
    }
}
