//! The microcontroller with its pins wired up: rigless's STM32F427, which runs the image of an
//! STM32F401, F405, F411 or F446 unchanged, and what that part's model lacks.
//!
//! | wire | from | to |
//! |---|---|---|
//! | INT | the sensor | PA1, and from there EXTI line 1 and TIM5 channel 2, at the same instant |
//! | SCL, SDA | I2C1 and the sensor | PB8, PB9, pulled up; rigless carries the bytes apart from the pins |
//! | TX, RX | USART2 on PA2 and PA3 | [`Terminal`], which notes every byte and when its stop bit ended, and says what a script tells it to |

use std::collections::VecDeque;

use rigless::chip::Timeline;
use rigless::chip::uart::{self, Rate};
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::mcu::Mcu;
use rigless::snapshot::Store;
use rigless::soc::stm32f427::Stm32f427;
use rigless::soc::stm32f427::generated::gpioa;
use rigless::soc::stm32f427::generated::rcc::{self, cir};
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin};
use rigless::soc::stm32f427::peripherals::tim::Channel;
use rigless::soc::{Bus, Error};
use rigless::time::VirtualNanos;

use crate::crystal::{CrystalAware, HighSpeedInput};
use crate::dma::RefusedDma;
use crate::exti::{self, Exti, Syscfg};
use crate::faults::{FaultKind, ScheduledFault, scheduled};
use crate::fitted::FittedSensor;
use crate::flash::{FlashInterface, SharedCells};
use crate::i2c::{WiredI2c, items_left};
use crate::wires::PortB;

/// Port A's number, as SYSCFG_EXTICR counts them.
const PORT_A: u8 = 0;

/// INT is on PA1.
const INTERRUPT_PIN: u8 = 1;

/// PA1 reaches TIM5 channel 2 through this alternate function (STM32F405 datasheet, table 9).
const TIM5_FUNCTION: u8 = 2;

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
    slots: Slots,
    /// The instant at which the sensor's wire has to be looked at, and for which an event is
    /// scheduled.
    awaited_ns: Option<u64>,
    /// The faults of a schedule.
    faults: Vec<ScheduledFault>,
    /// Whether the crystal has stopped.
    is_crystal_dead: bool,
    /// Whether the crystal stopped with nothing to take over, so that the core has no clock.
    is_clock_lost: bool,
    /// Whether the UART's line garbles what comes in.
    is_noisy: bool,
    /// When the last reset was, ns.
    reset_ns: u64,
}

/// How many of a million bytes come with noise, and with a framing error, while the UART's line
/// garbles.
const NOISE_PER_MILLION: u32 = 200_000;

/// Where on the bus the decorated instances are.
#[derive(Clone, Copy, Debug)]
struct Slots {
    rcc: usize,
    i2c1: usize,
    exti: usize,
    syscfg: usize,
    flash: usize,
    dma1: usize,
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
        sensor: FittedSensor,
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
            dma1: bus.slot("DMA1")?,
            port_a: bus.slot("GPIOA")?,
            port_b: bus.slot("GPIOB")?,
        };
        let mut spare = Stm32f427::new()?;
        std::mem::swap(&mut spare.rcc, &mut part.rcc);
        std::mem::swap(&mut spare.flash, &mut part.flash);
        std::mem::swap(&mut spare.i2c[I2C1], &mut part.i2c[I2C1]);
        std::mem::swap(&mut spare.gpio[PORT_B], &mut part.gpio[PORT_B]);
        std::mem::swap(&mut spare.dma[DMA1], &mut part.dma[DMA1]);
        let [i2c1, ..] = spare.i2c;
        let [_, port_b, ..] = spare.gpio;
        let [dma1, ..] = spare.dma;
        let mut controller = Self {
            part,
            clocks: CrystalAware {
                model: spare.rcc,
                input,
                stopped: None,
            },
            sensor_bus: WiredI2c::new(i2c1, wires.clone(), &all_faults),
            port_b: PortB {
                model: port_b,
                wires,
            },
            dma: RefusedDma::new(dma1, &all_faults),
            exti: Exti::default(),
            syscfg: Syscfg,
            flash: FlashInterface {
                model: spare.flash,
                cells,
            },
            slots,
            awaited_ns: None,
            faults,
            is_crystal_dead: false,
            is_clock_lost: false,
            is_noisy: false,
            reset_ns: 0,
        };
        controller.release_pins(VirtualNanos(0));
        Ok(controller)
    }

    /// The sensor.
    ///
    /// # Panics
    ///
    /// Never: [`Self::new`] has put it there.
    pub fn sensor(&mut self) -> &mut FittedSensor {
        self.sensor_bus
            .model
            .chip_mut(0)
            .expect("the sensor is the one chip on this bus")
    }

    /// When the flash's operation ends that was started last, ns since power-up.
    #[must_use]
    pub fn flash_busy_until_ns(&self) -> u64 {
        self.flash.cells.with(|cells| cells.busy_until_ns())
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

    /// Whether the clock security system has seen the crystal fail, and nobody has cleared that:
    /// the core executes the NMI for as long (RM0090, 7.2.7).
    #[must_use]
    pub fn has_clock_failure(&self) -> bool {
        let registers = self.part.bus().slots()[self.slots.rcc].registers();
        cir::CSSF.is_set(registers.get(rcc::Register::Cir))
    }

    /// Whether the core executes nothing: it is stalled, hangs, or has no clock.
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

    /// Lets the port and the controller look at the lines of the bus.
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

    /// Lets the faults of the microcontroller's own begin and end.
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
        if is_noisy != self.is_noisy {
            self.is_noisy = is_noisy;
            let errors = self.part.usart[USART2].errors_mut();
            let per_million = if is_noisy { NOISE_PER_MILLION } else { 0 };
            errors.noise.per_million = per_million;
            errors.framing.per_million = per_million;
        }
    }

    /// Brings the sensor to `now`, carries what its INT pin did to where the wire goes, and asks to
    /// be called again in time.
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

    /// The INT wire has changed its level. The core hears of it `at` once, which is up to an access
    /// later; the timer captures the instant itself, whatever the core does.
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

    /// Lends the decorated models to the part for as long as it rebuilds itself.
    fn lend_models(&mut self) {
        std::mem::swap(&mut self.clocks.model, &mut self.part.rcc);
        std::mem::swap(&mut self.flash.model, &mut self.part.flash);
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
        self.lend_models();
        self.part.reset(at, cause);
        self.lend_models();
        self.sensor_bus.forget();
        self.exti = Exti::default();
        self.flash.restart();
        self.awaited_ns = None;
        self.is_clock_lost = false;
        self.reset_ns = at.0;
        self.release_pins(at);
    }

    fn poll(&mut self, now: VirtualNanos) {
        self.part.poll(now);
        self.follow_sensor(now);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        if slot == self.slots.rcc {
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
        } else if slot == self.slots.exti {
            (self.part.bus_mut(), Some(&mut self.exti))
        } else if slot == self.slots.syscfg {
            (self.part.bus_mut(), Some(&mut self.syscfg))
        } else {
            self.part.split(slot)
        }
    }
}

/// The far end of the UART: it notes what it hears, and says what it was told to say, or anything
/// while a fault floods the line.
#[derive(Debug, Default)]
pub struct Terminal {
    heard: Vec<HeardByte>,
    /// What is left to say, the first of it first.
    script: VecDeque<SaidByte>,
    /// When it sends without a pause.
    floods: Vec<ScheduledFault>,
    /// How many bytes it has sent.
    sent: u64,
}

/// A byte from the UART.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeardByte {
    /// When its stop bit ended, ns since power-up.
    pub at_ns: u64,
    /// The byte.
    pub byte: u8,
}

/// A byte for the UART.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SaidByte {
    /// When its start bit may begin, ns since power-up. It waits for the bytes before it.
    pub at_ns: u64,
    /// The byte.
    pub byte: u8,
}

impl Terminal {
    /// A terminal that says these bytes.
    #[must_use]
    pub fn new(script: &[SaidByte]) -> Self {
        let mut script = script.to_vec();
        // Those of one instant keep their order.
        script.sort_by_key(|said| said.at_ns);
        Self {
            script: script.into(),
            ..Self::default()
        }
    }

    /// Has it flood the line when these faults say so.
    fn flood(&mut self, faults: &[ScheduledFault]) {
        let floods = |fault: &&ScheduledFault| {
            matches!(fault.kind, FaultKind::UartFlood | FaultKind::UartNoise)
        };
        self.floods = faults.iter().filter(floods).copied().collect();
    }

    /// How many bytes it has sent.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.sent
    }

    /// Has it say these bytes too, from `at_ns` on.
    pub fn say(&mut self, at_ns: u64, bytes: &[u8]) {
        let said = bytes.iter().map(|&byte| SaidByte { at_ns, byte });
        self.script.extend(said);
    }

    /// Takes out what it has heard since the last call.
    pub fn take(&mut self) -> Vec<HeardByte> {
        std::mem::take(&mut self.heard)
    }
}

/// Runs start from reset alone, so nothing keeps a board.
impl Store for Terminal {}

impl uart::Peer for Terminal {
    fn receive(&mut self, word: u16, context: &mut Timeline<'_, '_>) {
        self.heard.push(HeardByte {
            at_ns: context.now().0,
            byte: word.to_le_bytes()[0],
        });
    }

    fn transmit(&mut self, now: VirtualNanos) -> Option<u16> {
        if !self.floods.iter().any(|fault| fault.lasts(now.0)) {
            return self
                .script
                .pop_front_if(|said| said.at_ns <= now.0)
                .map(|said| said.byte.into());
        }
        self.sent += 1;
        // Any byte may come, most of them printable, and a line's end now and then.
        let mixed = self.sent.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
        let byte = match mixed % 40 {
            0 => u64::from(b'\n'),
            1..=4 => mixed >> 8,
            _ => 0x20 + (mixed >> 8) % 95,
        };
        Some(u16::from(byte.to_le_bytes()[0]))
    }
}

#[cfg(test)]
mod fault_tests;

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rigless::emulator::{Error as EmulatorError, Memory};
    use rigless::mcu::Operate;
    use rigless::soc::stm32f427::generated::{DMA1, EXTI, GPIOA, GPIOB, I2C1, RCC, SYSCFG, TIM5};
    use rigless::soc::{Peripheral, Width};

    use super::*;
    use crate::faults::Fault;
    use crate::flash::FlashRecord;
    use aplomb_models::motion::rest::Rest;
    use aplomb_models::sensor::{Sensor, SensorConfig};

    /// Offsets of registers (RM0090).
    const RCC_AHB1ENR: u64 = 0x30;
    const RCC_APB1ENR: u64 = 0x40;
    const RCC_APB2ENR: u64 = 0x44;
    const RCC_CR: u64 = 0x00;
    const EXTI_IMR: u64 = 0x00;
    const EXTI_RTSR: u64 = 0x08;
    const EXTI_FTSR: u64 = 0x0C;
    const EXTI_SWIER: u64 = 0x10;
    const EXTI_PR: u64 = 0x14;
    const SYSCFG_EXTICR1: u64 = 0x08;

    /// The interrupt number of EXTI line 1 (table 62).
    const EXTI1: u16 = 7;

    /// A controller on a bench, driven without a core.
    pub(super) struct Bench {
        pub(super) controller: Microcontroller,
        pub(super) now: VirtualNanos,
        interrupts: BTreeMap<u16, bool>,
        pub(super) ram: Ram,
    }

    /// RAM for the DMA.
    pub(super) struct Ram(BTreeMap<u64, u8>);

    impl Memory for Ram {
        fn read(&mut self, address: u64, width: Width) -> Result<u64, EmulatorError> {
            let bytes = address..address + u64::from(width.bytes());
            Ok(bytes.rev().fold(0, |value, at| {
                value << 8 | u64::from(self.0.get(&at).copied().unwrap_or(0))
            }))
        }

        fn write(&mut self, address: u64, width: Width, value: u64) -> Result<(), EmulatorError> {
            for (at, byte) in (address..address + u64::from(width.bytes())).zip(value.to_le_bytes())
            {
                self.0.insert(at, byte);
            }
            Ok(())
        }
    }

    impl Bench {
        /// A board at rest, its sensor awake and pulsing once a millisecond, all clocks enabled.
        fn new(input: HighSpeedInput) -> Self {
            Self::with_faults(input, vec![])
        }

        /// The same with faults.
        pub(super) fn with_faults(input: HighSpeedInput, faults: Vec<Fault>) -> Self {
            let mut sensor = Sensor::new(SensorConfig::new(1), Box::new(Rest::level()));
            let mut at_ns = 100_000_000;
            // Awake on the gyroscope's clock, 1 kHz, filter 1, interrupt on data ready.
            for [register, value] in [[0x6B, 0x01], [0x19, 0x00], [0x1A, 0x01], [0x38, 0x01]] {
                assert!(sensor.start(at_ns, 0x68, false));
                assert!(sensor.write(at_ns, register));
                assert!(sensor.write(at_ns, value));
                sensor.stop(at_ns);
                at_ns += 1000;
            }
            let mut bench = Self {
                controller: Microcontroller::new(
                    FittedSensor::new(sensor, faults),
                    input,
                    Terminal::default(),
                    SharedCells::new(FlashRecord::blank()),
                )
                .unwrap(),
                now: VirtualNanos(at_ns),
                interrupts: BTreeMap::new(),
                ram: Ram(BTreeMap::new()),
            };
            bench.write(&RCC, RCC_AHB1ENR, 0x0020_0003);
            bench.write(&RCC, RCC_APB1ENR, 0x0020_0008);
            bench.write(&RCC, RCC_APB2ENR, 0x0000_4000);
            bench.settle();
            bench
        }

        pub(super) fn write(&mut self, peripheral: &Peripheral, offset: u64, value: u64) {
            self.controller
                .write(self.now, peripheral.base + offset, Width::W32, value)
                .unwrap();
            self.settle();
        }

        pub(super) fn read(&mut self, peripheral: &Peripheral, offset: u64) -> u64 {
            let value = self
                .controller
                .read(self.now, peripheral.base + offset, Width::W32)
                .unwrap();
            self.settle();
            value
        }

        fn settle(&mut self) {
            let refused = self.controller.settle(&mut self.ram).unwrap();
            assert!(refused.is_empty(), "{refused:?}");
            for change in self.controller.drain_interrupts() {
                self.interrupts
                    .insert(change.interrupt, change.level == Level::High);
            }
        }

        /// Runs until `at_ns` with a stop at every event, as a session does.
        pub(super) fn run_until(&mut self, at_ns: u64) {
            loop {
                let next = self
                    .controller
                    .next_event()
                    .map_or(at_ns, |event| event.0)
                    .min(at_ns);
                self.now = VirtualNanos(next.max(self.now.0));
                self.controller.advance_to(self.now);
                self.controller.poll(self.now);
                self.settle();
                if self.now.0 >= at_ns {
                    return;
                }
            }
        }

        pub(super) fn run_for(&mut self, nanoseconds: u64) {
            self.run_until(self.now.0 + nanoseconds);
        }

        /// The next data-ready edge, once the board has lived through it.
        pub(super) fn next_edge_ns(&mut self) -> u64 {
            self.controller.sensor().take_edges();
            loop {
                self.run_for(1000);
                if let Some(edge) = self.controller.sensor().take_edges().first() {
                    return edge.time_ns;
                }
            }
        }

        pub(super) fn interrupts_on(&self, interrupt: u16) -> bool {
            self.interrupts.get(&interrupt).copied().unwrap_or(false)
        }
    }

    fn bench() -> Bench {
        Bench::new(HighSpeedInput::Crystal(8_000_000))
    }

    #[test]
    fn the_wiring_fits_the_part() {
        bench().controller.check().unwrap();
    }

    #[test]
    fn a_rising_edge_interrupts_until_its_pending_bit_is_cleared_with_a_one() {
        let mut bench = bench();
        bench.write(&EXTI, EXTI_RTSR, 1 << 1);
        bench.write(&EXTI, EXTI_IMR, 1 << 1);
        bench.next_edge_ns();
        assert!(bench.interrupts_on(EXTI1));
        assert_eq!(bench.read(&EXTI, EXTI_PR), 1 << 1);
        bench.write(&EXTI, EXTI_PR, 0);
        assert_eq!(bench.read(&EXTI, EXTI_PR), 1 << 1, "a zero clears nothing");
        bench.write(&EXTI, EXTI_PR, !(1 << 1));
        assert!(
            bench.interrupts_on(EXTI1),
            "ones elsewhere clear nothing here"
        );
        bench.write(&EXTI, EXTI_PR, 1 << 1);
        assert_eq!(bench.read(&EXTI, EXTI_PR), 0);
        assert!(!bench.interrupts_on(EXTI1));
    }

    #[test]
    fn the_falling_edge_comes_with_the_end_of_the_pulse() {
        let mut bench = bench();
        bench.write(&EXTI, EXTI_FTSR, 1 << 1);
        bench.write(&EXTI, EXTI_IMR, 1 << 1);
        let edge_ns = bench.next_edge_ns();
        bench.run_until(edge_ns + 49_999);
        assert!(!bench.interrupts_on(EXTI1));
        bench.run_until(edge_ns + 50_000);
        assert!(bench.interrupts_on(EXTI1));
    }

    #[test]
    fn a_masked_line_is_pending_and_interrupts_once_unmasked() {
        let mut bench = bench();
        bench.write(&EXTI, EXTI_RTSR, 1 << 1);
        bench.next_edge_ns();
        assert_eq!(bench.read(&EXTI, EXTI_PR), 1 << 1);
        assert!(!bench.interrupts_on(EXTI1));
        bench.write(&EXTI, EXTI_IMR, 1 << 1);
        assert!(bench.interrupts_on(EXTI1));
    }

    #[test]
    fn a_line_listens_to_the_port_that_is_routed_to_it() {
        let mut bench = bench();
        bench.write(&EXTI, EXTI_RTSR, 1 << 1);
        // Line 1 listens to port B.
        bench.write(&SYSCFG, SYSCFG_EXTICR1, 1 << 4);
        bench.next_edge_ns();
        assert_eq!(bench.read(&EXTI, EXTI_PR), 0);
        bench.write(&SYSCFG, SYSCFG_EXTICR1, 0);
        bench.next_edge_ns();
        assert_eq!(bench.read(&EXTI, EXTI_PR), 1 << 1);
    }

    #[test]
    fn the_software_trigger_reaches_every_line_s_own_interrupt() {
        let mut bench = bench();
        bench.write(&EXTI, EXTI_IMR, 0xFFFF);
        let expected = |line: u64| match line {
            0..=4 => 6 + line as u16,
            5..=9 => 23,
            _ => 40,
        };
        for line in 0..16 {
            bench.write(&EXTI, EXTI_SWIER, 1 << line);
            let on: Vec<u16> = (0..91)
                .filter(|&interrupt| bench.interrupts_on(interrupt))
                .collect();
            assert_eq!(on, [expected(line)], "line {line}");
            bench.write(&EXTI, EXTI_PR, 1 << line);
            assert_eq!(bench.read(&EXTI, EXTI_SWIER), 0);
            assert!(!bench.interrupts_on(expected(line)));
        }
    }

    /// Starts TIM5 at 1 MHz with channel 2 capturing rising edges, and returns the instant.
    fn start_capture(bench: &mut Bench) -> u64 {
        for (offset, value) in [
            (0x28, 15),
            (0x2C, 0xFFFF_FFFF),
            (0x18, 0x0100),
            (0x20, 0x10),
            (0x14, 1),
            (0x10, 0),
            (0x00, 1),
        ] {
            bench.write(&TIM5, offset, value);
        }
        bench.now.0
    }

    #[test]
    fn the_timer_captures_the_edge_to_the_microsecond() {
        let mut bench = bench();
        // PA1 carries its alternate function 2.
        bench.write(&GPIOA, 0x20, 2 << 4);
        let moder = bench.read(&GPIOA, 0x00);
        bench.write(&GPIOA, 0x00, moder | 2 << 2);
        let started_ns = start_capture(&mut bench);
        for _ in 0..3 {
            let edge_ns = bench.next_edge_ns();
            assert_eq!(bench.read(&TIM5, 0x38), (edge_ns - started_ns) / 1000);
        }
    }

    #[test]
    fn the_timer_captures_nothing_from_a_pin_that_is_a_plain_input() {
        let mut bench = bench();
        start_capture(&mut bench);
        bench.next_edge_ns();
        assert_eq!(bench.read(&TIM5, 0x38), 0);
    }

    #[test]
    fn a_reset_clears_what_it_should_and_the_wires_keep_their_levels() {
        let mut bench = bench();
        bench.write(&EXTI, EXTI_RTSR, 1 << 1);
        bench.write(&EXTI, EXTI_IMR, 1 << 1);
        bench.next_edge_ns();
        bench.controller.reset(bench.now, ResetCause::Core);
        bench.interrupts.clear();
        bench.run_for(100_000);
        bench.write(&RCC, RCC_AHB1ENR, 0x3);
        bench.write(&RCC, RCC_APB2ENR, 0x4000);
        assert_eq!(bench.read(&EXTI, EXTI_PR), 0);
        assert_eq!(
            bench.read(&GPIOB, 0x10) & 0x300,
            0x300,
            "SCL and SDA are pulled up"
        );
        bench.write(&EXTI, EXTI_RTSR, 1 << 1);
        bench.write(&EXTI, EXTI_IMR, 1 << 1);
        bench.next_edge_ns();
        assert!(bench.interrupts_on(EXTI1), "the sensor goes on pulsing");
    }

    /// Whether HSERDY comes within a millisecond of HSEON.
    fn starts(input: HighSpeedInput, bypassed: bool) -> bool {
        let mut bench = Bench::new(input);
        let control = bench.read(&RCC, RCC_CR) | u64::from(bypassed) << 18;
        bench.write(&RCC, RCC_CR, control);
        bench.write(&RCC, RCC_CR, control | 1 << 16);
        bench.run_for(1_000_000);
        bench.read(&RCC, RCC_CR) & 1 << 17 != 0
    }

    #[test]
    fn the_oscillator_starts_only_with_what_the_board_has() {
        assert!(starts(HighSpeedInput::Crystal(8_000_000), false));
        assert!(!starts(HighSpeedInput::Crystal(8_000_000), true));
        assert!(starts(HighSpeedInput::ExternalClock(8_000_000), true));
        assert!(!starts(HighSpeedInput::ExternalClock(8_000_000), false));
        assert!(!starts(HighSpeedInput::Nothing, false));
        assert!(!starts(HighSpeedInput::Nothing, true));
    }

    /// Reads WHO_AM_I and what follows by DMA, `count` bytes, and says whether the controller has
    /// stopped asking the sensor for more without a STOP.
    fn ends_after(count: u64, cr2: u64) -> bool {
        const BUFFER: u64 = 0x2000_0000;
        const SR1: u64 = 0x14;
        const SR2: u64 = 0x18;
        const DR: u64 = 0x10;
        let mut bench = bench();
        // 16 MHz, 400 kHz in fast mode.
        bench.write(&I2C1, 0x04, 16);
        bench.write(&I2C1, 0x1C, 0x8000 | 13);
        bench.write(&I2C1, 0x00, 0x401);
        let byte_ns = 30_000;
        let start = |bench: &mut Bench, address: u64| {
            bench.write(&I2C1, 0x00, 0x501);
            bench.read(&I2C1, SR1);
            bench.write(&I2C1, DR, address);
            bench.run_for(byte_ns);
            assert_eq!(
                bench.read(&I2C1, SR1) & 0x402,
                0x002,
                "address acknowledged"
            );
        };
        start(&mut bench, 0xD0);
        bench.read(&I2C1, SR2);
        bench.write(&I2C1, DR, 0x75);
        bench.run_for(byte_ns);
        start(&mut bench, 0xD1);
        bench.write(&I2C1, 0x04, 16 | cr2);
        for (offset, value) in [
            (0x18, I2C1.base + DR),
            (0x1C, BUFFER),
            (0x14, count),
            (0x10, 1 << 25 | 1 << 10 | 1),
        ] {
            bench.write(&DMA1, offset, value);
        }
        bench.read(&I2C1, SR2);
        bench.run_for((count + 4) * byte_ns);
        assert_eq!(bench.ram.read(BUFFER, Width::W8).unwrap(), 0x68);
        assert_eq!(bench.read(&DMA1, 0x14), 0, "the DMA is done");
        bench.read(&I2C1, SR1) & 0x44 == 0
    }

    #[test]
    fn with_last_set_the_last_byte_of_the_dma_is_not_acknowledged() {
        const DMAEN: u64 = 1 << 11;
        const LAST: u64 = 1 << 12;
        for count in [2, 14] {
            assert!(ends_after(count, DMAEN | LAST), "{count} bytes");
            assert!(
                !ends_after(count, DMAEN),
                "{count} bytes, LAST clear: the sensor goes on sending"
            );
        }
    }
}
