//! Each fault shows at the pins, in the registers or on the bus, whatever firmware runs.

use rigless::device::ResetCause;
use rigless::emulator::{Access, AccessKind, Memory};
use rigless::soc::Width;
use rigless::soc::stm32f427::generated::{DMA1, EXTI, GPIOA, GPIOB, I2C1, IWDG, PWR, RCC, USART2};

use super::tests::Bench;
use super::*;
use crate::checks::{Reserved, Rule};
use crate::faults::{Axis, Direction, Fault, RestOfByte};

/// Offsets of registers (RM0090).
const CR1: u64 = 0x00;
const CR2: u64 = 0x04;
const DR: u64 = 0x10;
const SR1: u64 = 0x14;
const SR2: u64 = 0x18;
const CCR: u64 = 0x1C;
const TRISE: u64 = 0x20;
const IDR: u64 = 0x10;
const BSRR: u64 = 0x18;

/// Bits of I2C_CR1, I2C_CR2, I2C_SR1 and I2C_SR2 (RM0090, 27.6).
const PE: u64 = 1;
const START: u64 = 1 << 8;
const STOP: u64 = 1 << 9;
const ACK: u64 = 1 << 10;
const SWRST: u64 = 1 << 15;
const ITERREN: u64 = 1 << 8;
const SB: u64 = 1;
const ADDR: u64 = 1 << 1;
const RXNE: u64 = 1 << 6;
const BERR: u64 = 1 << 8;
const ARLO: u64 = 1 << 9;
const AF: u64 = 1 << 10;
const MSL: u64 = 1;
const BUSY: u64 = 1 << 1;

/// The interrupt number of I2C1's errors (RM0090, table 62).
const I2C1_ER: u16 = 32;

const SCL: u64 = 1 << 8;
const SDA: u64 = 1 << 9;
const MILLISECOND: u64 = 1_000_000;

/// The fault begins here, ns.
const BEGIN: u64 = 150 * MILLISECOND;

/// A board with one fault that lasts ten milliseconds, or happens once, shortly before it begins.
fn bench(kind: FaultKind) -> Bench {
    let is_once = matches!(
        kind,
        FaultKind::SdaLow(Some(_)) | FaultKind::RegisterFlip(..)
    );
    let fault = ScheduledFault {
        start_ns: BEGIN,
        duration_ns: if is_once { 0 } else { 10 * MILLISECOND },
        kind,
    };
    let input = HighSpeedInput::Crystal(8_000_000);
    let mut bench = Bench::with_faults(input, vec![Fault::Scheduled(fault)]);
    // PB8 and PB9: alternate function 4, open drain.
    bench.write(&GPIOB, 0x24, 0x44);
    bench.write(&GPIOB, 0x04, 0x300);
    connect(&mut bench);
    program(&mut bench);
    bench.run_until(BEGIN - 2 * MILLISECOND);
    bench
}

/// Gives the pins to the I2C controller.
fn connect(bench: &mut Bench) {
    bench.write(&GPIOB, 0x00, 0xA << 16);
}

/// 400 kHz from 16 MHz.
fn program(bench: &mut Bench) {
    bench.write(&I2C1, CR2, 16);
    bench.write(&I2C1, CCR, 0x8000 | 13);
    bench.write(&I2C1, CR1, PE | ACK);
}

/// A byte and its acknowledge take 22 µs, and a little more here.
const BYTE_NS: u64 = 30_000;

/// START, and the address; the flags in SR1 that came of it.
fn address(bench: &mut Bench, byte: u64) -> u64 {
    bench.write(&I2C1, CR1, PE | ACK | START);
    if bench.read(&I2C1, SR1) & SB == 0 {
        return 0;
    }
    bench.write(&I2C1, DR, byte);
    bench.run_for(BYTE_NS);
    bench.read(&I2C1, SR1)
}

/// Sends a byte; the flags in SR1 that came of it.
fn send(bench: &mut Bench, byte: u64) -> u64 {
    bench.read(&I2C1, SR2);
    bench.write(&I2C1, DR, byte);
    bench.run_for(BYTE_NS);
    bench.read(&I2C1, SR1)
}

/// Reads registers, byte by byte; `None` if something was not acknowledged.
fn read_registers(bench: &mut Bench, register: u64, count: usize) -> Option<Vec<u8>> {
    let mut bytes = None;
    if address(bench, 0xD0) & ADDR != 0
        && send(bench, register) & AF == 0
        && address(bench, 0xD1) & ADDR != 0
    {
        if count == 1 {
            bench.write(&I2C1, CR1, PE);
        }
        bench.read(&I2C1, SR2);
        let read = (1..=count).map(|nth| {
            for _ in 0..30 {
                if bench.read(&I2C1, SR1) & RXNE == 0 {
                    bench.run_for(1_000);
                }
            }
            // The last byte is on the wire, and is not to be acknowledged.
            if nth + 1 == count {
                bench.write(&I2C1, CR1, PE);
            }
            bench.read(&I2C1, DR).to_le_bytes()[0]
        });
        bytes = Some(read.collect());
    }
    bench.write(&I2C1, SR1, 0);
    bench.write(&I2C1, CR1, PE | ACK | STOP);
    bench.run_for(BYTE_NS);
    bytes
}

/// The 14 data registers as seven values.
fn data(bench: &mut Bench) -> [i16; 7] {
    let bytes = read_registers(bench, 0x3B, 14).expect("the sensor answers");
    let mut values = [0; 7];
    for (value, pair) in values.iter_mut().zip(bytes.chunks_exact(2)) {
        *value = i16::from_be_bytes([pair[0], pair[1]]);
    }
    values
}

fn who_am_i(bench: &mut Bench) -> Option<u8> {
    read_registers(bench, 0x75, 1).map(|bytes| bytes[0])
}

fn lines(bench: &mut Bench) -> (bool, bool) {
    let pins = bench.read(&GPIOB, IDR);
    (pins & SCL != 0, pins & SDA != 0)
}

#[test]
fn without_a_fault_the_sensor_answers() {
    let mut bench = bench(FaultKind::SensorSilent);
    assert_eq!(who_am_i(&mut bench), Some(0x68));
    assert_eq!(lines(&mut bench), (true, true));
    assert_eq!(bench.read(&I2C1, SR2) & (BUSY | MSL), 0);
}

#[test]
fn an_address_is_refused_in_the_direction_asked_for() {
    for (direction, write, read) in [
        (None, AF, AF),
        (Some(Direction::Write), AF, ADDR),
        (Some(Direction::Read), ADDR, AF),
    ] {
        let mut bench = bench(FaultKind::AddressNack(direction));
        bench.run_until(BEGIN);
        assert_eq!(address(&mut bench, 0xD0) & (AF | ADDR), write);
        bench.read(&I2C1, SR2);
        bench.write(&I2C1, SR1, 0);
        bench.write(&I2C1, CR1, PE | ACK | STOP);
        bench.run_for(BYTE_NS);
        assert_eq!(address(&mut bench, 0xD1) & (AF | ADDR), read);
    }
}

#[test]
fn the_byte_asked_for_is_refused_and_no_other() {
    for byte in 0..3 {
        let mut bench = bench(FaultKind::DataNack(byte));
        bench.run_until(BEGIN);
        assert_ne!(address(&mut bench, 0xD0) & ADDR, 0);
        for sent in 0..=byte {
            assert_eq!(
                send(&mut bench, 0x19) & AF != 0,
                sent == byte,
                "{byte} {sent}"
            );
        }
    }
}

#[test]
fn a_stretched_clock_holds_the_byte_until_the_end() {
    let mut bench = bench(FaultKind::BurstStall);
    bench.run_until(BEGIN);
    assert_eq!(lines(&mut bench), (true, true), "an idle bus is left alone");
    assert_eq!(address(&mut bench, 0xD0) & (ADDR | AF), 0);
    assert_eq!(lines(&mut bench), (false, true));
    bench.run_until(BEGIN + 10 * MILLISECOND - 1000);
    assert_eq!(bench.read(&I2C1, SR1) & ADDR, 0);
    bench.run_for(5_000);
    assert_ne!(bench.read(&I2C1, SR1) & ADDR, 0, "then it goes on");
    assert_eq!(lines(&mut bench), (true, true));
}

#[test]
fn a_start_waits_for_a_data_line_that_is_low_and_comes_when_it_rises() {
    let mut bench = bench(FaultKind::SdaLow(None));
    bench.run_until(BEGIN + 1000);
    assert_eq!(lines(&mut bench), (true, false));
    assert_ne!(bench.read(&I2C1, SR2) & BUSY, 0);
    bench.write(&I2C1, CR1, PE | ACK | START);
    bench.run_until(BEGIN + 9 * MILLISECOND);
    assert_eq!(bench.read(&I2C1, SR1) & SB, 0);
    assert_ne!(bench.read(&I2C1, CR1) & START, 0, "and reads back set");
    bench.run_until(BEGIN + 10 * MILLISECOND + 1000);
    assert_ne!(bench.read(&I2C1, SR1) & SB, 0);
    assert_eq!(bench.read(&I2C1, CR1) & START, 0);
}

#[test]
fn a_data_line_that_rises_is_a_stop() {
    let mut bench = bench(FaultKind::SdaLow(None));
    bench.run_until(BEGIN + 11 * MILLISECOND);
    assert_eq!(bench.read(&I2C1, SR2) & BUSY, 0);
    assert_eq!(who_am_i(&mut bench), Some(0x68));
}

#[test]
fn a_one_on_a_data_line_that_is_low_loses_the_arbitration() {
    let mut bench = bench(FaultKind::SdaLow(None));
    bench.run_until(BEGIN - 10_000);
    // The address is on the wire when the line falls.
    assert_eq!(address(&mut bench, 0xD0) & (ARLO | ADDR | AF), ARLO);
    assert_eq!(bench.read(&I2C1, SR2) & (MSL | BUSY), BUSY);
}

#[test]
fn a_stop_waits_for_a_data_line_that_is_low() {
    let mut bench = bench(FaultKind::SdaLow(None));
    bench.run_until(BEGIN - 40_000);
    assert_ne!(address(&mut bench, 0xD0) & ADDR, 0);
    bench.run_until(BEGIN + 1000);
    bench.write(&I2C1, CR1, PE | ACK | STOP);
    assert_ne!(bench.read(&I2C1, CR1) & STOP, 0);
    assert_eq!(bench.read(&I2C1, SR2) & (MSL | BUSY), MSL | BUSY);
    bench.run_until(BEGIN + 11 * MILLISECOND);
    assert_eq!(bench.read(&I2C1, CR1) & STOP, 0);
    assert_eq!(bench.read(&I2C1, SR2) & (MSL | BUSY), 0);
}

/// Takes the pins as open-drain outputs, both let go.
fn take_pins(bench: &mut Bench) {
    bench.write(&GPIOB, BSRR, SCL | SDA);
    bench.write(&GPIOB, 0x00, 0x5 << 16);
}

fn clock(bench: &mut Bench) {
    bench.write(&GPIOB, BSRR, SCL << 16);
    bench.run_for(5_000);
    bench.write(&GPIOB, BSRR, SCL);
    bench.run_for(5_000);
}

#[test]
fn a_sensor_that_has_lost_count_lets_go_after_its_clocks_and_no_sooner() {
    for clocks in 1..=9 {
        let mut bench = bench(FaultKind::SdaLow(Some(RestOfByte { clocks, bits: 0 })));
        bench.run_until(BEGIN + 100 * MILLISECOND);
        assert_eq!(
            lines(&mut bench),
            (true, false),
            "it does not let go by itself"
        );
        bench.write(&I2C1, CR1, PE | ACK | START);
        bench.run_for(BYTE_NS);
        assert_eq!(bench.read(&I2C1, SR1) & SB, 0);
        take_pins(&mut bench);
        for made in 1..=clocks {
            assert_eq!(lines(&mut bench), (true, false), "{made} of {clocks}");
            clock(&mut bench);
        }
        assert_eq!(lines(&mut bench), (true, true));
        assert_eq!(
            bench.controller.port_b.wires.lock().falls_made()[0],
            u32::from(clocks)
        );
        connect(&mut bench);
        bench.write(&I2C1, CR1, SWRST);
        bench.write(&I2C1, CR1, 0);
        program(&mut bench);
        assert_eq!(who_am_i(&mut bench), Some(0x68));
    }
}

#[test]
fn a_reset_in_the_middle_of_a_read_leaves_the_sensor_holding_the_line() {
    let mut bench = bench(FaultKind::SensorSilent);
    assert_ne!(address(&mut bench, 0xD1) & ADDR, 0);
    let now = bench.now;
    bench.controller.reset(now, ResetCause::Core);
    bench.write(&RCC, 0x30, 0x0020_0003);
    assert_eq!(lines(&mut bench), (true, false));
    bench.write(&GPIOB, 0x04, 0x300);
    take_pins(&mut bench);
    let mut clocks = 0;
    while clocks < 20 && !lines(&mut bench).1 {
        clock(&mut bench);
        clocks += 1;
    }
    assert!((1..=8).contains(&clocks), "{clocks}");
}

#[test]
fn a_byte_waits_for_a_clock_line_that_is_low_and_busy_stays_until_a_reset() {
    let mut bench = bench(FaultKind::SclLow);
    bench.run_until(BEGIN - 10_000);
    assert_eq!(address(&mut bench, 0xD0) & (ADDR | AF), 0);
    assert_eq!(lines(&mut bench), (false, true));
    bench.run_until(BEGIN + 10 * MILLISECOND + 5_000);
    assert_ne!(bench.read(&I2C1, SR1) & ADDR, 0);

    let mut bench = self::bench(FaultKind::SclLow);
    bench.run_until(BEGIN + 11 * MILLISECOND);
    assert_eq!(lines(&mut bench), (true, true));
    assert_eq!(address(&mut bench, 0xD0), 0, "no STOP has freed the bus");
    assert_ne!(bench.read(&I2C1, SR2) & BUSY, 0);
    bench.write(&I2C1, CR1, SWRST);
    bench.write(&I2C1, CR1, 0);
    program(&mut bench);
    assert_eq!(who_am_i(&mut bench), Some(0x68));
}

#[test]
fn a_stop_within_a_byte_is_a_bus_error_and_the_sensor_is_gone() {
    let mut bench = bench(FaultKind::BusError(false));
    bench.write(&I2C1, CR2, 16 | ITERREN);
    bench.run_until(BEGIN - 40_000);
    assert_eq!(address(&mut bench, 0xD0) & (ADDR | BERR), ADDR);
    bench.run_until(BEGIN);
    assert_eq!(send(&mut bench, 0x75) & (BERR | AF), BERR | AF);
    assert!(bench.interrupts_on(I2C1_ER));
    bench.write(&I2C1, SR1, !BERR & !AF & 0xFFFF);
    assert_eq!(bench.read(&I2C1, SR1) & (BERR | AF), 0, "a zero clears it");
    assert!(!bench.interrupts_on(I2C1_ER));
    bench.write(&I2C1, SR1, 0xFFFF);
    assert_eq!(bench.read(&I2C1, SR1) & BERR, 0, "a one does not set it");
}

#[test]
fn lost_arbitration_ends_the_transfer_and_leaves_the_bus_busy() {
    let mut bench = bench(FaultKind::ArbitrationLost);
    bench.write(&I2C1, CR2, 16 | ITERREN);
    bench.run_until(BEGIN);
    assert_eq!(address(&mut bench, 0xD0) & (ARLO | ADDR | AF), ARLO);
    assert!(bench.interrupts_on(I2C1_ER));
    assert_eq!(bench.read(&I2C1, SR2) & (MSL | BUSY), BUSY);
    bench.write(&I2C1, CR1, PE | ACK | STOP);
    assert_ne!(bench.read(&I2C1, SR2) & BUSY, 0, "its STOP is nobody's");
    bench.write(&I2C1, CR1, 0);
    assert_eq!(bench.read(&I2C1, SR1) & ARLO, 0, "PE = 0 clears it");
}

/// Reads two bytes by DMA; DMA1_LISR and DMA1_S0CR afterwards.
fn read_by_dma(bench: &mut Bench) -> (u64, u64) {
    const BUFFER: u64 = 0x2000_0000;
    assert_ne!(address(bench, 0xD0) & ADDR, 0);
    send(bench, 0x75);
    assert_ne!(address(bench, 0xD1) & ADDR, 0);
    bench.write(&I2C1, CR2, 16 | 1 << 11 | 1 << 12);
    for (offset, value) in [
        (0x08, 0x3F),
        (0x18, I2C1.base + DR),
        (0x1C, BUFFER),
        (0x14, 2),
        (0x10, 1 << 25 | 1 << 10 | 1),
    ] {
        bench.write(&DMA1, offset, value);
    }
    bench.read(&I2C1, SR2);
    bench.run_for(4 * BYTE_NS);
    assert!(bench.ram.read(BUFFER, Width::W8).is_ok());
    (bench.read(&DMA1, 0x00), bench.read(&DMA1, 0x10))
}

#[test]
fn a_refused_access_is_a_transfer_error_and_stops_the_stream() {
    const TEIF0: u64 = 1 << 3;
    const TCIF0: u64 = 1 << 5;
    let mut good = bench(FaultKind::SensorSilent);
    let (flags, control) = read_by_dma(&mut good);
    assert_eq!((flags & (TEIF0 | TCIF0), control & 1), (TCIF0, 0));
    let mut bad = bench(FaultKind::DmaError);
    bad.run_until(BEGIN);
    let (flags, control) = read_by_dma(&mut bad);
    assert_eq!((flags & (TEIF0 | TCIF0), control & 1), (TEIF0, 0));
}

/// Rising edges on PA1 in the fault's ten milliseconds, and the level in the middle of them.
fn edges(kind: FaultKind, pull_up: bool) -> (u32, bool) {
    let mut bench = bench(kind);
    bench.write(&EXTI, 0x08, 1 << 1);
    bench.write(&GPIOA, 0x0C, u64::from(pull_up) << 2);
    let mut count = 0;
    let mut level = false;
    bench.run_until(BEGIN + 1000);
    bench.write(&EXTI, 0x14, 1 << 1);
    while bench.now.0 < BEGIN + 10 * MILLISECOND {
        bench.run_for(700);
        if bench.read(&EXTI, 0x14) & 1 << 1 != 0 {
            count += 1;
            bench.write(&EXTI, 0x14, 1 << 1);
        }
        if bench
            .now
            .0
            .abs_diff(BEGIN + 5 * MILLISECOND + MILLISECOND / 2)
            < 400
        {
            level = bench.read(&GPIOA, IDR) & 1 << 1 != 0;
        }
    }
    (count, level)
}

#[test]
fn the_interrupt_wire_is_open_shorted_or_glitches() {
    let (pulses, _) = edges(FaultKind::SensorSilent, false);
    assert!((9..=11).contains(&pulses), "{pulses}");
    assert_eq!(edges(FaultKind::IntLow, false), (0, false));
    assert_eq!(edges(FaultKind::IntHigh, false), (0, true));
    assert_eq!(edges(FaultKind::IntMissing, false), (0, false));
    assert_eq!(
        edges(FaultKind::IntMissing, true),
        (0, true),
        "the pin is pulled up"
    );
    let (doubled, _) = edges(FaultKind::IntGlitch(8_000), false);
    assert!((80..=95).contains(&doubled), "{doubled}");
}

#[test]
fn a_silent_sensor_acknowledges_nothing_and_remembers_everything() {
    let mut bench = bench(FaultKind::SensorSilent);
    bench.run_until(BEGIN);
    assert_eq!(who_am_i(&mut bench), None);
    bench.run_until(BEGIN + 11 * MILLISECOND);
    assert_eq!(
        read_registers(&mut bench, 0x6B, 1),
        Some(vec![0x01]),
        "still awake"
    );
}

#[test]
fn a_sensor_without_supply_comes_back_asleep() {
    let mut bench = bench(FaultKind::SensorBrownout);
    bench.run_until(BEGIN);
    assert_eq!(who_am_i(&mut bench), None);
    bench.run_until(BEGIN + 11 * MILLISECOND);
    assert_eq!(who_am_i(&mut bench), None, "it is starting");
    let ready_ns = bench.controller.sensor().ready_at_ns().expect("it starts");
    bench.run_until(ready_ns + 1000);
    assert_eq!(read_registers(&mut bench, 0x6B, 1), Some(vec![0x40]));
    assert_eq!(read_registers(&mut bench, 0x38, 1), Some(vec![0x00]));
}

#[test]
fn a_register_changes_by_itself() {
    let mut bench = bench(FaultKind::RegisterFlip(0x1B, 0x18));
    assert_eq!(read_registers(&mut bench, 0x1B, 1), Some(vec![0x00]));
    bench.run_until(BEGIN + 1000);
    assert_eq!(read_registers(&mut bench, 0x1B, 1), Some(vec![0x18]));
    assert_eq!(read_registers(&mut bench, 0x6B, 1), Some(vec![0x01]));
}

#[test]
fn frozen_data_do_not_change_while_the_edges_go_on() {
    let mut bench = bench(FaultKind::Frozen);
    bench.run_until(BEGIN + 2 * MILLISECOND);
    let first = data(&mut bench);
    let edge_ns = bench.next_edge_ns();
    assert!(edge_ns < BEGIN + 5 * MILLISECOND);
    assert_eq!(data(&mut bench), first);
    bench.run_until(BEGIN + 12 * MILLISECOND);
    assert_ne!(data(&mut bench), first);
}

#[test]
fn zeros_ones_full_scale_and_temperature_are_what_the_bus_delivers() {
    let during = |kind| {
        let mut bench = bench(kind);
        bench.run_until(BEGIN + 2 * MILLISECOND);
        let values = data(&mut bench);
        let burst = bench.controller.sensor().take_bursts();
        let noted = burst.last().expect("a burst").bytes;
        let first = i16::from_be_bytes([noted[0], noted[1]]);
        assert_eq!(first, values[0], "what is noted is what was delivered");
        bench.run_until(BEGIN + 12 * MILLISECOND);
        let after = data(&mut bench);
        assert!(after.iter().all(|&value| value != -1 && value != i16::MAX));
        assert!(after[2] > 10_000, "about 1 g: {after:?}");
        values
    };
    assert_eq!(during(FaultKind::Zeros), [0; 7]);
    assert_eq!(during(FaultKind::Ones), [-1; 7]);
    for (nth, (axis, _)) in Axis::NAMES.into_iter().enumerate() {
        let values = during(FaultKind::Saturated(axis));
        let place = if nth < 3 { nth } else { nth + 1 };
        for (value, at) in values.into_iter().zip(0..) {
            assert_eq!(value == i16::MAX, at == place, "{axis:?} {values:?}");
        }
    }
    let [.., temperature, _, _, _] = during(FaultKind::Temperature(100.0));
    // (100 − 36.53) · 340 (register map, section 4.18).
    assert_eq!(temperature, 21_580);
}

#[test]
fn the_core_stands_still_while_it_is_stalled_and_hangs_until_a_reset() {
    for kind in [FaultKind::CoreStall, FaultKind::WatchdogHang] {
        let bench = bench(kind);
        assert!(!bench.controller.is_core_held(BEGIN - 1));
        assert!(bench.controller.is_core_held(BEGIN));
        assert!(!bench.controller.is_core_held(BEGIN + 10 * MILLISECOND));
    }
    for (kind, hangs_on) in [
        (FaultKind::CoreStall, true),
        (FaultKind::WatchdogHang, false),
    ] {
        let mut bench = bench(kind);
        bench.run_until(BEGIN + 1000);
        let now = bench.now;
        bench.controller.reset(now, ResetCause::Core);
        assert_eq!(bench.controller.is_core_held(BEGIN + 2000), hangs_on);
    }
}

#[test]
fn crystal_and_pll_take_as_many_instructions_to_start_as_a_chip() {
    for (enable, ready, instructions) in [(1 << 16, 1 << 17, 32_000), (1 << 24, 1 << 25, 4_800)] {
        let mut bench = bench(FaultKind::SensorSilent);
        bench.write(&RCC, 0x04, 4 << 24 | 168 << 6 | 8);
        bench.write(&RCC, 0x00, enable | 1);
        let startup_ns = instructions * 1_000 / 168;
        bench.run_for(startup_ns * 9 / 10);
        assert_eq!(bench.read(&RCC, 0x00) & ready, 0, "{ready:#x}");
        bench.run_for(startup_ns / 5);
        assert_ne!(bench.read(&RCC, 0x00) & ready, 0, "{ready:#x}");
    }
}

/// The clocks: HSE on, PLL from it, PLL as the system's clock, and the clock security system if
/// asked for.
fn run_from_crystal(bench: &mut Bench, guarded: bool) {
    bench.write(&RCC, 0x00, 1 << 16 | 1);
    bench.run_for(MILLISECOND / 5);
    bench.write(&RCC, 0x04, 1 << 22 | 7 << 24 | 168 << 6 | 4);
    let control = 1 << 16 | 1 | u64::from(guarded) << 19;
    bench.write(&RCC, 0x00, control | 1 << 24);
    bench.run_for(MILLISECOND / 20);
    bench.write(&RCC, 0x08, 2);
    bench.run_for(MILLISECOND / 100);
    assert_eq!(bench.read(&RCC, 0x08) >> 2 & 3, 2, "it runs from the PLL");
}

#[test]
fn a_dead_crystal_is_flagged_and_replaced_if_it_is_guarded() {
    let mut bench = bench(FaultKind::CrystalDies);
    run_from_crystal(&mut bench, true);
    bench.run_until(BEGIN + 1000);
    assert_ne!(bench.read(&RCC, 0x0C) & 1 << 7, 0, "CSSF");
    assert_eq!(bench.read(&RCC, 0x08) >> 2 & 3, 0, "HSI");
    assert_eq!(bench.read(&RCC, 0x00) & (1 << 17 | 1 << 25), 0);
    assert!(!bench.controller.is_core_held(bench.now.0));
    bench.write(&RCC, 0x00, 1 << 16 | 1);
    bench.run_for(MILLISECOND);
    assert_eq!(
        bench.read(&RCC, 0x00) & 1 << 17,
        0,
        "it does not start again"
    );
    bench.run_until(BEGIN + 11 * MILLISECOND);
    bench.write(&RCC, 0x00, 1);
    bench.write(&RCC, 0x00, 1 << 16 | 1);
    bench.run_for(MILLISECOND);
    assert_ne!(bench.read(&RCC, 0x00) & 1 << 17, 0, "after its end it does");
}

#[test]
fn a_dead_crystal_stops_the_core_if_it_is_not_guarded() {
    let mut bench = bench(FaultKind::CrystalDies);
    run_from_crystal(&mut bench, false);
    bench.run_until(BEGIN + 1000);
    assert!(bench.controller.is_core_held(bench.now.0));
    let now = bench.now;
    bench.controller.reset(now, ResetCause::Core);
    assert!(
        !bench.controller.is_core_held(now.0),
        "a reset chooses the HSI"
    );
}

/// Listens on USART2 at 115,200 baud for the fault's ten milliseconds: bytes, and those among them
/// with an error.
fn listen(kind: FaultKind) -> (u32, u32) {
    listen_with(kind, 0x7700)
}

/// Listens with these alternate functions of the pins.
fn listen_with(kind: FaultKind, functions: u64) -> (u32, u32) {
    let mut bench = bench(kind);
    bench.write(&RCC, 0x40, 1 << 21 | 1 << 17);
    bench.write(&GPIOA, 0x20, functions);
    let modes = bench.read(&GPIOA, 0x00) & !0xF0;
    bench.write(&GPIOA, 0x00, modes | 0xA0);
    bench.write(&USART2, 0x08, 0x8B);
    bench.write(&USART2, 0x0C, 1 << 13 | 1 << 2);
    bench.run_until(BEGIN);
    let (mut bytes, mut errors) = (0, 0);
    while bench.now.0 < BEGIN + 12 * MILLISECOND {
        bench.run_for(40_000);
        let status = bench.read(&USART2, 0x00);
        if status & 1 << 5 != 0 {
            bytes += 1;
            errors += u32::from(status & 0x6 != 0);
            bench.read(&USART2, 0x04);
        }
    }
    (bytes, errors)
}

#[test]
fn bytes_come_in_only_by_the_pin_of_the_uart() {
    let [connected, elsewhere] =
        [0x7700, 0x0700].map(|functions| listen_with(FaultKind::UartFlood, functions).0);
    assert!(connected > 0);
    assert_eq!(elsewhere, 0);
}

#[test]
fn bytes_come_in_without_a_pause_and_garbled_if_asked_for() {
    assert_eq!(listen(FaultKind::SensorSilent), (0, 0));
    let (bytes, errors) = listen(FaultKind::UartFlood);
    assert!((105..=118).contains(&bytes), "{bytes} at 11,520 a second");
    assert_eq!(errors, 0);
    let (bytes, errors) = listen(FaultKind::UartNoise);
    assert!((105..=118).contains(&bytes), "{bytes}");
    assert!((15..=70).contains(&errors), "{errors} of {bytes}");
}

#[test]
fn a_stop_takes_a_period_and_a_write_in_the_meantime_makes_it_stick() {
    let mut bench = bench(FaultKind::SensorSilent);
    let stop = |bench: &mut Bench, wait_ns: u64| {
        assert_ne!(address(bench, 0xD0) & ADDR, 0);
        bench.read(&I2C1, SR2);
        bench.write(&I2C1, CR1, PE | ACK | STOP);
        assert_ne!(bench.read(&I2C1, CR1) & STOP, 0, "not yet made");
        bench.run_for(wait_ns);
        bench.write(&I2C1, CR1, PE | ACK);
        bench.run_for(BYTE_NS);
        let is_stuck = bench.read(&I2C1, CR1) & STOP != 0;
        let is_busy = bench.read(&I2C1, SR2) & BUSY != 0;
        (is_stuck, is_busy)
    };
    assert_eq!(stop(&mut bench, 3_000), (false, false));
    assert_eq!(stop(&mut bench, 1_000), (true, true));
    bench.write(&I2C1, CR1, PE | ACK | START);
    assert_eq!(bench.read(&I2C1, SR1) & SB, 0, "no START either");
    bench.write(&I2C1, CR1, 0);
    bench.write(&I2C1, CR1, PE);
    assert_ne!(bench.read(&I2C1, CR1) & STOP, 0, "only SWRST helps");
    bench.write(&I2C1, CR1, SWRST);
    bench.write(&I2C1, CR1, 0);
    program(&mut bench);
    assert_eq!(who_am_i(&mut bench), Some(0x68));
}

#[test]
fn a_sensor_that_has_lost_count_shows_its_bits_and_obeys_start_and_stop() {
    // Zero, one, one, zero; then the sensor waits for the acknowledge.
    let rest = RestOfByte {
        clocks: 4,
        bits: 0x60,
    };
    let lost = || {
        let mut bench = bench(FaultKind::SdaLow(Some(rest)));
        bench.run_until(BEGIN + MILLISECOND);
        take_pins(&mut bench);
        bench
    };
    let mut bench = lost();
    for is_high in [false, true, true, false, true] {
        assert_eq!(lines(&mut bench), (true, is_high));
        clock(&mut bench);
    }
    assert_eq!(
        lines(&mut bench),
        (true, true),
        "not acknowledged: no other byte"
    );

    // A START while a one is on the line.
    let mut bench = lost();
    clock(&mut bench);
    bench.write(&GPIOB, BSRR, SDA << 16);
    bench.write(&GPIOB, BSRR, SDA);
    clock(&mut bench);
    clock(&mut bench);
    assert_eq!(lines(&mut bench), (true, true), "the zero never comes");

    // An acknowledge, and another byte follows.
    let mut bench = lost();
    for _ in 0..3 {
        clock(&mut bench);
    }
    bench.write(&GPIOB, BSRR, SCL << 16);
    bench.write(&GPIOB, BSRR, SDA << 16);
    bench.write(&GPIOB, BSRR, SCL);
    bench.write(&GPIOB, BSRR, SCL << 16);
    bench.write(&GPIOB, BSRR, SDA);
    bench.write(&GPIOB, BSRR, SCL);
    assert_eq!(lines(&mut bench), (true, false), "a zero of another byte");
}

#[test]
fn a_bus_error_that_is_a_flag_alone_disturbs_nothing() {
    let mut bench = bench(FaultKind::BusError(true));
    bench.write(&I2C1, CR2, 16 | ITERREN);
    bench.run_until(BEGIN);
    assert_ne!(address(&mut bench, 0xD0) & BERR, 0);
    assert!(bench.interrupts_on(I2C1_ER));
    bench.write(&I2C1, SR1, 0);
    assert!(!bench.interrupts_on(I2C1_ER));
    bench.write(&I2C1, CR1, PE | ACK | STOP);
    bench.run_for(BYTE_NS);
    assert_eq!(who_am_i(&mut bench), Some(0x68));
}

/// A board without faults whose notes have been taken.
fn strict_bench() -> Bench {
    let mut bench = Bench::with_faults(HighSpeedInput::Crystal(8_000_000), vec![]);
    bench.write(&GPIOB, 0x24, 0x44);
    bench.write(&GPIOB, 0x04, 0x300);
    connect(&mut bench);
    // 381 kHz from 16 MHz: 13 would be 410 kHz.
    let set_up = [(CR2, 16), (CCR, 0x8000 | 14), (TRISE, 5), (CR1, PE | ACK)];
    for (register, value) in set_up {
        bench.write(&I2C1, register, value);
    }
    assert_eq!(bench.controller.checks().take_notes(), []);
    bench
}

/// Returns the rules that `work` breaks.
fn broken_by(bench: &mut Bench, work: impl FnOnce(&mut Bench)) -> Vec<Rule> {
    work(bench);
    bench.controller.checks().take_notes()
}

#[test]
fn a_port_whose_clocks_do_not_fit_is_noted_when_it_is_enabled() {
    let wrong = [(CR2, 15), (CR2, 17), (CCR, 0x8000 | 13), (TRISE, 17)];
    for (register, value) in wrong {
        let mut bench = strict_bench();
        bench.write(&I2C1, CR1, 0);
        let noted = broken_by(&mut bench, |bench| {
            bench.write(&I2C1, register, value);
            bench.write(&I2C1, CR1, PE);
        });
        assert_eq!(noted, [Rule::PortClock], "{register:#x} {value}");
    }
}

#[test]
fn flags_that_are_cleared_before_they_are_seen_are_noted() {
    let mut bench = strict_bench();
    bench.write(&I2C1, CR1, PE | ACK | START);
    let unseen = broken_by(&mut bench, |bench| bench.write(&I2C1, DR, 0xD0));
    assert_eq!(unseen, [Rule::StartSeen]);

    let mut bench = strict_bench();
    let seen = broken_by(&mut bench, |bench| {
        bench.write(&I2C1, CR1, PE | ACK | START);
        bench.read(&I2C1, SR1);
        bench.write(&I2C1, DR, 0xD0);
    });
    assert_eq!(seen, []);
    bench.run_until(bench.now.0 + MILLISECOND);
    let unseen = broken_by(&mut bench, |bench| {
        bench.read(&I2C1, SR2);
    });
    assert_eq!(unseen, [Rule::AddressSeen]);
}

#[test]
fn a_stream_is_set_up_while_it_is_off_and_without_old_flags() {
    /// Stream 0's control, count and memory address, and bits of the first (RM0090, 10.5).
    const S0CR: u64 = 0x10;
    const S0NDTR: u64 = 0x14;
    const S0M0AR: u64 = 0x1C;
    const LIFCR: u64 = 0x08;
    const EN: u64 = 1;
    const CHANNEL_1: u64 = 1 << 25;
    let mut bench = strict_bench();
    let noted = broken_by(&mut bench, |bench| {
        bench.write(&DMA1, S0M0AR, 0x2000_0000);
        bench.write(&DMA1, S0NDTR, 14);
        bench.write(&DMA1, S0CR, CHANNEL_1 | EN);
    });
    assert_eq!(noted, []);
    for (register, value) in [(S0M0AR, 0x2000_0010), (S0CR, EN)] {
        let noted = broken_by(&mut bench, |bench| bench.write(&DMA1, register, value));
        assert_eq!(noted, [Rule::StreamOff], "{register:#x}");
    }
    // A stream that is switched off sets its flag of completion.
    let noted = broken_by(&mut bench, |bench| {
        bench.write(&DMA1, S0CR, 0);
        bench.write(&DMA1, S0CR, CHANNEL_1 | EN);
    });
    assert_eq!(noted, [Rule::StreamFlags]);
    let noted = broken_by(&mut bench, |bench| {
        bench.write(&DMA1, S0CR, 0);
        bench.write(&DMA1, LIFCR, 0x3D);
        bench.write(&DMA1, S0CR, CHANNEL_1 | EN);
    });
    assert_eq!(noted, []);
}

/// Registers of the watchdog, and its keys (RM0090, 21.4).
const KR: u64 = 0x00;
const PR: u64 = 0x04;
const RLR: u64 = 0x08;
const SR: u64 = 0x0C;
const OPEN: u64 = 0x5555;
const FEED: u64 = 0xAAAA;
const RUN: u64 = 0xCCCC;
/// Longer than five cycles of the watchdog's oscillator at 32 kHz.
const CROSSING_NS: u64 = 200_000;

#[test]
fn the_watchdog_takes_a_limit_only_in_the_right_order() {
    let mut bench = strict_bench();
    let noted = broken_by(&mut bench, |bench| {
        bench.write(&IWDG, KR, RUN);
        bench.write(&IWDG, KR, OPEN);
        bench.write(&IWDG, PR, 4);
        bench.write(&IWDG, RLR, 100);
        assert_eq!(bench.read(&IWDG, SR), 0b11, "both are on their way");
        assert_eq!([PR, RLR].map(|at| bench.read(&IWDG, at)), [0, 0xFFF]);
        bench.run_for(CROSSING_NS);
        assert_eq!(bench.read(&IWDG, SR), 0);
        bench.write(&IWDG, KR, FEED);
    });
    assert_eq!(noted, []);
    assert_eq!([PR, RLR].map(|at| bench.read(&IWDG, at)), [4, 100]);
    // Without the key, or after a feed, RUN or any other key, which all close the registers.
    for key in [None, Some(FEED), Some(RUN), Some(0x1234)] {
        for register in [PR, RLR] {
            let noted = broken_by(&mut bench, |bench| {
                if let Some(key) = key {
                    bench.write(&IWDG, KR, OPEN);
                    bench.write(&IWDG, KR, key);
                }
                bench.write(&IWDG, register, 5);
            });
            assert_eq!(noted, [Rule::WatchdogOpen], "{key:?} {register:#x}");
            assert_eq!([PR, RLR].map(|at| bench.read(&IWDG, at)), [4, 100]);
            assert_eq!(bench.read(&IWDG, SR), 0);
        }
    }
    // A second value before the first one has arrived is ignored.
    for (register, first) in [(PR, 3), (RLR, 200)] {
        let noted = broken_by(&mut bench, |bench| {
            bench.write(&IWDG, KR, OPEN);
            bench.write(&IWDG, register, first);
            bench.write(&IWDG, register, 6);
            bench.run_for(CROSSING_NS);
        });
        assert_eq!(noted, [Rule::WatchdogUpdated], "{register:#x}");
        assert_eq!(bench.read(&IWDG, register), first);
    }
}

#[test]
fn the_watchdog_closes_its_registers_at_a_reset() {
    let mut bench = strict_bench();
    bench.write(&IWDG, KR, OPEN);
    bench.controller.reset(bench.now, ResetCause::Pin);
    let noted = broken_by(&mut bench, |bench| bench.write(&IWDG, RLR, 100));
    assert_eq!(noted, [Rule::WatchdogOpen]);
}

#[test]
fn reserved_bits_and_missing_clocks_are_noted_with_their_place() {
    let bench = strict_bench();
    let reserved = Reserved::of(bench.controller.bus());
    let checks = Checks::default();
    let access = |kind, peripheral: &rigless::soc::Peripheral, offset, value| {
        let address = peripheral.base + offset;
        let mut access = Access::new(kind, address, Width::W32, value);
        access.program_counter = Some(0x0800_C000);
        access
    };
    let good = access(AccessKind::Write, &I2C1, CR1, PE);
    checks.complete(&good, &reserved);
    assert_eq!(checks.violations(), []);
    let bad = access(AccessKind::Write, &I2C1, CR1, PE | 1 << 14);
    checks.complete(&bad, &reserved);
    let unclocked = access(AccessKind::Read, &USART2, 0, 0);
    checks.complete(&unclocked, &reserved);
    checks.note_at(Rule::Clocked, unclocked.address);
    let seen: Vec<String> = checks
        .violations()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert_eq!(
        seen,
        [
            "a peripheral without a clock (RM0090, 7.3.10 to 7.3.14): \
             0x40004400 accessed at 0x0800c000",
            "a reserved bit is set (RM0090, 1.1): 0x40005400 accessed at 0x0800c000",
        ]
    );
}

#[test]
fn a_core_that_is_too_fast_for_the_regulators_scale_is_noted() {
    for (selected, noted) in [(None, vec![Rule::VoltageScale]), (Some(0b11), vec![])] {
        let mut bench = strict_bench();
        bench.controller.fit(Regulator::F411, 100_000_000);
        let seen = broken_by(&mut bench, |bench| {
            bench.write(&RCC, 0x40, 1 << 28);
            if let Some(scale) = selected {
                bench.write(&PWR, 0x00, scale << 14);
            }
            // 100 MHz from the internal oscillator: M 8, N 100, P 2, Q 4.
            bench.write(&RCC, 0x04, 4 << 24 | 100 << 6 | 8);
            bench.write(&RCC, 0x00, 1 << 24 | 1);
            bench.run_for(1_000_000);
            bench.write(&RCC, 0x08, 0b10);
        });
        assert_eq!(seen, noted, "{selected:?}");
    }
}

#[test]
fn a_peripheral_that_the_chip_lacks_is_noted() {
    let bench = strict_bench();
    let bus = bench.controller.bus();
    let access = Access::new(AccessKind::Read, USART2.base, Width::W32, 0);
    for (absent, count) in [("USART2", 1), ("USART3", 0)] {
        let checks = Checks::default();
        checks.complete(&access, &Reserved::of(bus));
        checks.note_absent(bus, |name| name == absent);
        assert_eq!(checks.violations().len(), count, "{absent}");
    }
}

#[test]
fn a_pin_that_becomes_an_output_while_its_register_is_low_makes_an_edge() {
    for (is_high_before, edges) in [(false, [1, 1]), (true, [0, 0])] {
        let mut bench = bench(FaultKind::SensorSilent);
        let falls = |bench: &Bench| bench.controller.port_b.wires.lock().falls_made();
        let before = falls(&bench);
        if is_high_before {
            bench.write(&GPIOB, BSRR, SCL | SDA);
        }
        bench.write(&GPIOB, 0x00, 0x5 << 16);
        bench.run_for(BYTE_NS);
        let after = falls(&bench);
        let made = [after[0] - before[0], after[1] - before[1]];
        assert_eq!(made, edges, "{is_high_before}");
    }
}
