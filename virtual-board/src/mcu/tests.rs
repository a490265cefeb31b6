//! Tests of the wiring: a controller without a core.

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
        for (at, byte) in (address..address + u64::from(width.bytes())).zip(value.to_le_bytes()) {
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

    /// A board at rest with faults.
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
                BusDevices::new(sensor, faults),
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

/// Returns true if HSERDY comes within a millisecond of HSEON.
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

/// Reads WHO_AM_I and what follows by DMA, `count` bytes. Requests STOP so many ns after the last
/// byte, if at all. Returns the byte that comes after the last one, if any does.
fn byte_after(count: u64, cr2: u64, stop_after_ns: Option<u64>) -> Option<u64> {
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
    while bench.read(&DMA1, 0x14) > 0 {
        bench.run_for(100);
    }
    assert_eq!(bench.ram.read(BUFFER, Width::W8).unwrap(), 0x68);
    if let Some(stop_after_ns) = stop_after_ns {
        bench.run_for(stop_after_ns);
        bench.write(&I2C1, 0x00, 0x601);
    }
    bench.run_for(2 * byte_ns);
    let is_controller = bench.read(&I2C1, SR2) & 1 != 0;
    assert_eq!(is_controller, stop_after_ns.is_none(), "STOP is made");
    let is_there = bench.read(&I2C1, SR1) & 0x40 != 0;
    is_there.then(|| bench.read(&I2C1, DR))
}

const DMAEN: u64 = 1 << 11;
const LAST: u64 = 1 << 12;

#[test]
fn with_last_set_the_last_byte_of_the_dma_is_not_acknowledged() {
    for count in [2, 14] {
        // The sensor lets go of the bus, or sends its next register, a zero.
        assert_eq!(
            byte_after(count, DMAEN | LAST, None),
            Some(0xFF),
            "{count} bytes"
        );
        assert_eq!(
            byte_after(count, DMAEN, None),
            Some(0),
            "{count} bytes, LAST clear"
        );
    }
}

#[test]
fn a_late_stop_lets_the_controller_clock_another_byte() {
    assert_eq!(byte_after(14, DMAEN | LAST, Some(1_000)), None);
    for late_ns in [3_000, 10_000, 20_000] {
        assert_eq!(
            byte_after(14, DMAEN | LAST, Some(late_ns)),
            Some(0xFF),
            "{late_ns} ns"
        );
    }
}
