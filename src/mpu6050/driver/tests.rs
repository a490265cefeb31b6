//! The driver on a bus with a sensor made from the datasheet.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_hal::i2c::{ErrorType, NoAcknowledgeSource, Operation as BusOperation};

use super::*;
use crate::mpu6050::{AccelerometerRange, GyroscopeRange, LowPass, PARTS};

/// Event on the bus, or a wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Event {
    Write(u8, u8),
    Read(u8),
    WaitMs(u32),
}
use Event::{Read, WaitMs, Write};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FakeError {
    Nack,
    Arbitration,
    /// EREMOTEIO, by which many of Linux's bus drivers report that no chip acknowledges.
    Other,
}

impl embedded_hal::i2c::Error for FakeError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Nack => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            Self::Arbitration => ErrorKind::ArbitrationLoss,
            Self::Other => ErrorKind::Other,
        }
    }
}

/// Sensor made from the datasheet, independent of the driver's tables.
struct Sensor {
    /// Address and identity of each chip on the bus.
    chips: Vec<(u8, u8)>,
    registers: [u8; 128],
    power_after_reset: u8,
    milliseconds: u32,
    reset_done_at_ms: u32,
    /// Register and its bits that ignore writes.
    stuck: Option<(u8, u8)>,
    /// Error of each transaction, by its number.
    failures: Box<dyn Fn(usize) -> Option<FakeError>>,
    transactions: usize,
    log: Vec<Event>,
}

impl Sensor {
    fn new(address: u8, who_am_i: u8) -> Self {
        let mut sensor = Self {
            chips: vec![(address, who_am_i)],
            registers: [0; 128],
            power_after_reset: if matches!(who_am_i, 0x70 | 0x71 | 0x73) {
                0x01
            } else {
                0x40
            },
            milliseconds: 0,
            reset_done_at_ms: 0,
            stuck: None,
            failures: Box::new(|_| None),
            transactions: 0,
            log: Vec::new(),
        };
        sensor.reset();
        // A state after a crash that only a reset repairs. Reserved bits of the full-scale
        // registers are set after the reset.
        sensor.registers[0x38] = 0x01;
        sensor.registers[0x37] = 0xB0;
        sensor
    }

    fn reset(&mut self) {
        self.registers = [0; 128];
        self.registers[0x1B] = 0xE7;
        self.registers[0x1C] = 0x05;
        self.registers[0x1A] = 0x80;
        self.registers[0x1D] = 0xC8;
        self.registers[0x6B] = self.power_after_reset;
    }

    fn transfer(
        &mut self,
        address: u8,
        operations: &mut [BusOperation<'_>],
    ) -> Result<(), FakeError> {
        let index = self.transactions;
        self.transactions += 1;
        if let Some(error) = (self.failures)(index) {
            return Err(error);
        }
        let Some(&(_, who_am_i)) = self.chips.iter().find(|chip| chip.0 == address) else {
            return Err(FakeError::Nack);
        };
        let mut pointer = 0;
        for operation in operations {
            match operation {
                BusOperation::Write([register, values @ ..]) => {
                    pointer = *register;
                    for value in values.iter().copied() {
                        self.log.push(Write(pointer, value));
                        self.write(pointer, value);
                        pointer += 1;
                    }
                }
                BusOperation::Write([]) => {}
                BusOperation::Read(values) => {
                    self.log.push(Read(pointer));
                    for value in values.iter_mut() {
                        *value = match pointer {
                            0x75 => who_am_i,
                            _ => self.registers[usize::from(pointer)],
                        };
                        pointer += 1;
                    }
                }
            }
        }
        Ok(())
    }

    fn write(&mut self, register: u8, value: u8) {
        let slot = &mut self.registers[usize::from(register)];
        match (register, value) {
            (0x6B, value) if value & 0x80 != 0 => {
                *slot = 0x80;
                self.reset_done_at_ms = self.milliseconds + 100;
            }
            (0x68, _) => *slot = 0,
            _ => {
                let stuck = match self.stuck {
                    Some((stuck_register, bits)) if stuck_register == register => bits,
                    _ => 0,
                };
                *slot = (value & !stuck) | (*slot & stuck);
            }
        }
    }

    fn wait(&mut self, milliseconds: u32) {
        self.log.push(WaitMs(milliseconds));
        self.milliseconds += milliseconds;
        if self.registers[0x6B] & 0x80 != 0 && self.milliseconds >= self.reset_done_at_ms {
            self.reset();
        }
    }
}

#[derive(Clone)]
struct Bench(Rc<RefCell<Sensor>>);

impl Bench {
    fn new(sensor: Sensor) -> Self {
        Self(Rc::new(RefCell::new(sensor)))
    }

    fn probe(&self) -> Result<Mpu6050<Self>, ProbeFailure<Self>> {
        Mpu6050::probe(self.clone(), &mut self.clone())
    }

    fn probe_error(&self) -> Error<FakeError> {
        match self.probe() {
            Ok(_) => panic!("found something"),
            Err(failure) => failure.error,
        }
    }

    fn register(&self, register: usize) -> u8 {
        self.0.borrow().registers[register]
    }
}

impl ErrorType for Bench {
    type Error = FakeError;
}

impl I2c for Bench {
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [BusOperation<'_>],
    ) -> Result<(), FakeError> {
        self.0.borrow_mut().transfer(address, operations)
    }
}

impl DelayNs for Bench {
    fn delay_ns(&mut self, nanoseconds: u32) {
        self.delay_ms(nanoseconds / 1_000_000);
    }

    fn delay_ms(&mut self, milliseconds: u32) {
        self.0.borrow_mut().wait(milliseconds);
    }
}

const UNUSUAL: Config = Config {
    accelerometer_range: AccelerometerRange::G4,
    gyroscope_range: GyroscopeRange::Degrees1000,
    low_pass: LowPass::Hertz20,
    sample_rate_divider: 9,
};

#[test]
fn the_sequence_follows_the_datasheet() {
    let bench = Bench::new(Sensor::new(0x68, 0x68));
    let mut sensor = bench.probe().expect("a sensor");
    assert_eq!(sensor.address(), 0x68);
    assert_eq!(sensor.part().name, "MPU-6050");
    sensor
        .configure(&Config::default(), &mut bench.clone())
        .expect("configured");
    let expected = [
        Read(0x75),
        // Reset, wait, verify.
        Write(0x6B, 0x80),
        WaitMs(100),
        Read(0x6B),
        // Wake, reset the signal paths.
        Write(0x6B, 0x00),
        Read(0x6B),
        Write(0x68, 0x07),
        WaitMs(100),
        // The gyroscope's clock, and its settling.
        Write(0x6B, 0x01),
        Read(0x6B),
        WaitMs(30),
        // Sample rate, filter, ranges; their other bits are kept.
        Write(0x19, 0x00),
        Read(0x19),
        Read(0x1A),
        Write(0x1A, 0x81),
        Read(0x1A),
        Read(0x1B),
        Write(0x1B, 0x1F),
        Read(0x1B),
        Read(0x1C),
        Write(0x1C, 0x1D),
        Read(0x1C),
        // The pin, and the interrupt last.
        Write(0x37, 0x12),
        Read(0x37),
        Write(0x38, 0x01),
        Read(0x38),
    ];
    assert_eq!(bench.0.borrow().log, expected);
}

#[test]
fn settings_reach_their_bits_in_every_part() {
    for part in &PARTS {
        let bench = Bench::new(Sensor::new(0x68, part.who_am_i));
        let mut sensor = bench.probe().expect(part.name);
        assert_eq!(sensor.part(), part);
        sensor
            .configure(&UNUSUAL, &mut bench.clone())
            .expect(part.name);
        assert_eq!(bench.register(0x19), 9);
        assert_eq!(bench.register(0x1A), 0x84);
        assert_eq!(bench.register(0x1C), 0x0D);
        // The MPU-6500 family has FCHOICE_B in 0x1B, and 0x1D, where the others have reserved bits.
        let has_own_filter = matches!(part.who_am_i, 0x70 | 0x71 | 0x73 | 0x98);
        let expected = if has_own_filter {
            [0x14, 0xC4]
        } else {
            [0x17, 0xC8]
        };
        let found = [0x1B, 0x1D].map(|register| bench.register(register));
        assert_eq!(found, expected, "{}", part.name);
        assert_eq!(bench.register(0x37), 0x12);
        assert_eq!(bench.register(0x38), 0x01);
        assert_eq!(bench.register(0x6B), 0x01);
    }
}

#[test]
fn the_second_address_is_found_past_an_unknown_chip() {
    let mut chips = Sensor::new(0x69, 0x68);
    chips.chips.push((0x68, 0x13));
    for sensor in [Sensor::new(0x69, 0x68), chips] {
        let bench = Bench::new(sensor);
        let mut found = bench.probe().expect("a sensor");
        assert_eq!(found.address(), 0x69);
        found
            .configure(&Config::default(), &mut bench.clone())
            .expect("configured");
        assert_eq!(found.release().0.borrow().registers[0x38], 0x01);
    }
}

#[test]
fn an_unknown_identity_is_named_with_its_address() {
    for address in ADDRESSES {
        let bench = Bench::new(Sensor::new(address, 0x13));
        let error = bench.probe_error();
        let expected = Error::UnknownIdentity {
            address,
            who_am_i: 0x13,
        };
        assert_eq!(error, expected);
        let text = error.to_string();
        assert!(text.contains(&format!("0x{address:02x}")), "{text}");
        assert!(text.contains("0x13"), "{text}");
        assert!(text.contains("0x68 0x70 0x71 0x72 0x73 0x98"), "{text}");
    }
}

#[test]
fn an_empty_bus_is_probed_for_the_power_up_time() {
    let bench = Bench::new(Sensor::new(0x42, 0x68));
    let error = bench.probe_error();
    assert_eq!(error, Error::NotFound);
    let text = error.to_string();
    assert!(text.contains("0x68") && text.contains("0x69"), "{text}");
    let sensor = bench.0.borrow();
    assert_eq!(sensor.milliseconds, 100);
    assert_eq!(sensor.transactions, 22);
}

#[test]
fn a_sensor_that_is_still_powering_up_is_found() {
    for failure in [FakeError::Nack, FakeError::Other, FakeError::Arbitration] {
        for searches in [5, 10] {
            let mut sensor = Sensor::new(0x68, 0x68);
            // Each search tries both addresses.
            sensor.failures = Box::new(move |index| (index < 2 * searches).then_some(failure));
            let bench = Bench::new(sensor);
            assert!(bench.probe().is_ok(), "{failure:?}");
            assert_eq!(bench.0.borrow().milliseconds as usize, 10 * searches);
        }
    }
}

#[test]
fn a_garbled_identity_is_read_again() {
    let bench = Bench::new(Sensor::new(0x68, 0x13));
    let mut searching = bench.clone();
    let probe = Mpu6050::probe(bench.clone(), &mut Changing(&mut searching, 0x70));
    assert_eq!(probe.expect("a sensor").part().name, "MPU-6500");
}

/// Delay after which the chip has another identity.
struct Changing<'a>(&'a mut Bench, u8);

impl DelayNs for Changing<'_> {
    fn delay_ns(&mut self, _: u32) {
        self.0.0.borrow_mut().chips[0].1 = self.1;
    }
}

#[test]
fn a_broken_bus_is_not_an_absent_sensor() {
    let mut sensor = Sensor::new(0x68, 0x68);
    // The last search reports another error than those before.
    sensor.failures = Box::new(|index| {
        Some(if index < 20 {
            FakeError::Other
        } else {
            FakeError::Arbitration
        })
    });
    let bench = Bench::new(sensor);
    let expected = Error::Bus {
        operation: Operation::Read,
        register: Register::WhoAmI,
        address: 0x68,
        source: FakeError::Arbitration,
    };
    assert_eq!(bench.probe_error(), expected);
    assert_eq!(
        expected.to_string(),
        "reading WHO_AM_I (0x75) at 0x68 failed: arbitration lost: check the wiring"
    );
    // The failure returns the bus for another try.
    let Err(failure) = bench.probe() else {
        panic!("found something");
    };
    failure.i2c.0.borrow_mut().failures = Box::new(|_| None);
    assert!(bench.probe().is_ok());
}

#[test]
fn one_failure_anywhere_is_reported_and_repaired_by_another_try() {
    for who_am_i in [0x68, 0x70] {
        let good = Bench::new(Sensor::new(0x68, who_am_i));
        let mut sensor = good.probe().expect("a sensor");
        sensor
            .configure(&UNUSUAL, &mut good.clone())
            .expect("configured");
        let transactions = good.0.borrow().transactions;
        assert_eq!(transactions, if who_am_i == 0x68 { 23 } else { 26 });

        for failing in 0..transactions {
            for failure in [FakeError::Nack, FakeError::Arbitration] {
                let mut sensor = Sensor::new(0x68, who_am_i);
                sensor.failures = Box::new(move |index| (index == failing).then_some(failure));
                let bench = Bench::new(sensor);
                let mut sensor = bench.probe().expect("a sensor");
                let first = sensor.configure(&UNUSUAL, &mut bench.clone());
                // A failed identity was retried; any later failure must be reported.
                match first {
                    Ok(()) => assert_eq!(failing, 0),
                    Err(Error::Bus {
                        address, source, ..
                    }) => assert_eq!((address, source), (0x68, failure)),
                    Err(error) => panic!("transaction {failing}: {error}"),
                }
                sensor
                    .configure(&UNUSUAL, &mut bench.clone())
                    .expect("a second try");
                assert_eq!(bench.0.borrow().registers, good.0.borrow().registers);
            }
        }
    }
}

#[test]
fn a_sensor_that_goes_away_at_any_point_is_an_error() {
    for last_good in 0..23 {
        let mut sensor = Sensor::new(0x68, 0x68);
        sensor.failures = Box::new(move |index| (index > last_good).then_some(FakeError::Nack));
        let bench = Bench::new(sensor);
        let mut sensor = bench.probe().expect("a sensor");
        let result = sensor.configure(&UNUSUAL, &mut bench.clone());
        assert_eq!(result.is_ok(), last_good == 22, "{last_good}");
    }
}

#[test]
fn a_bus_error_names_the_transfer() {
    let mut sensor = Sensor::new(0x69, 0x68);
    // Two probes, the reset and its check; then the wake-up fails.
    sensor.failures = Box::new(|index| (index == 4).then_some(FakeError::Nack));
    let bench = Bench::new(sensor);
    let mut sensor = bench.probe().expect("a sensor");
    let error = sensor
        .configure(&UNUSUAL, &mut bench.clone())
        .expect_err("a failure");
    assert_eq!(
        error.to_string(),
        "writing PWR_MGMT_1 (0x6b) at 0x69 failed: not acknowledged: check the wiring"
    );
}

#[test]
fn a_register_that_does_not_keep_its_value_is_named() {
    for (register, bits) in [
        (0x6B, 0x01),
        (0x19, 0x08),
        (0x1A, 0x04),
        (0x1B, 0x10),
        (0x1C, 0x08),
        (0x1D, 0x04),
        (0x38, 0x01),
    ] {
        let mut sensor = Sensor::new(0x68, 0x70);
        sensor.stuck = Some((register, bits));
        // Only the last write of this register then has no effect.
        sensor.power_after_reset = 0x40;
        let bench = Bench::new(sensor);
        let mut sensor = bench.probe().expect("a sensor");
        let error = sensor
            .configure(&UNUSUAL, &mut bench.clone())
            .expect_err("a mismatch");
        let Error::Readback {
            address,
            register: named,
            written,
            read,
        } = error
        else {
            panic!("register 0x{register:02x}: {error}");
        };
        assert_eq!((address, named.address()), (0x68, register));
        assert_eq!(written ^ read, bits, "register 0x{register:02x}");
        let text = error.to_string();
        for part in [
            named.name(),
            &format!("0x{register:02x}"),
            &format!("wrote 0x{written:02x}"),
            &format!("read 0x{read:02x}"),
        ] {
            assert!(text.contains(part), "{text}");
        }
        // The pin has no pulses before all other settings are right.
        if register != 0x38 {
            assert_eq!(bench.register(0x38), 0x00);
        }
    }
}

#[test]
fn a_reset_without_effect_is_an_error() {
    for power in [0x80, 0x00, 0xFF, 0x01] {
        let mut sensor = Sensor::new(0x68, 0x68);
        sensor.power_after_reset = power;
        let bench = Bench::new(sensor);
        let mut sensor = bench.probe().expect("a sensor");
        let result = sensor.configure(&UNUSUAL, &mut bench.clone());
        let expected = Error::ResetFailed {
            address: 0x68,
            read: power,
        };
        assert_eq!(result, Err(expected));
        assert!(expected.to_string().contains(&format!("0x{power:02x}")));
    }
}

#[test]
fn a_sensor_that_lost_its_settings_gets_them_back_without_a_reset() {
    for who_am_i in [0x68, 0x70] {
        let good = Bench::new(Sensor::new(0x68, who_am_i));
        let mut sensor = good.probe().expect("a sensor");
        sensor
            .configure(&UNUSUAL, &mut good.clone())
            .expect("configured");
        assert_eq!(sensor.verify_config(&UNUSUAL), Ok(SettingsState::Intact));
        let of_mpu_6500 = [
            (0x1B, 0x01, SettingsState::Changed),
            (0x1B, 0x02, SettingsState::Changed),
            (0x1D, 0x08, SettingsState::Changed),
        ];
        let own = if who_am_i == 0x70 {
            &of_mpu_6500[..]
        } else {
            &[]
        };
        for &(register, bits, state) in [
            (0x19, 0x01, SettingsState::Changed),
            (0x1A, 0x01, SettingsState::Changed),
            (0x1B, 0x08, SettingsState::Changed),
            (0x1C, 0x10, SettingsState::Changed),
            (0x37, 0x80, SettingsState::Changed),
            (0x38, 0x01, SettingsState::Changed),
            (0x6B, 0x40, SettingsState::Changed),
            (0x6C, 0x04, SettingsState::Changed),
        ]
        .iter()
        .chain(own)
        {
            let bench = Bench::new(Sensor::new(0x68, who_am_i));
            let mut sensor = bench.probe().expect("a sensor");
            sensor
                .configure(&UNUSUAL, &mut bench.clone())
                .expect("configured");
            bench.0.borrow_mut().registers[register] ^= bits;
            assert_eq!(
                sensor.verify_config(&UNUSUAL),
                Ok(state),
                "0x{register:02x}"
            );
            let before = bench.0.borrow().milliseconds;
            sensor
                .reconfigure(&UNUSUAL, &mut bench.clone())
                .expect("configured again");
            assert_eq!(bench.0.borrow().milliseconds - before, 30);
            assert_eq!(sensor.verify_config(&UNUSUAL), Ok(SettingsState::Intact));
            assert_eq!(bench.0.borrow().registers, good.0.borrow().registers);
        }
    }
}

#[test]
fn a_reset_of_any_part_is_told_from_a_changed_setting() {
    for part in &PARTS {
        let bench = Bench::new(Sensor::new(0x68, part.who_am_i));
        let mut sensor = bench.probe().expect("a sensor");
        let configured = sensor.configure(&UNUSUAL, &mut bench.clone());
        configured.expect("configured");
        bench.0.borrow_mut().reset();
        let state = sensor.verify_config(&UNUSUAL);
        assert_eq!(state, Ok(SettingsState::Reset), "{}", part.name);
        let read = sensor.read_back(&UNUSUAL).expect("read");
        assert_eq!(read.settings, SettingsState::Reset, "{}", part.name);
        sensor
            .reconfigure(&UNUSUAL, &mut bench.clone())
            .expect("configured again");
        assert_eq!(sensor.verify_config(&UNUSUAL), Ok(SettingsState::Intact));
    }
}

#[test]
fn a_burst_is_read_in_one_transfer() {
    let bench = Bench::new(Sensor::new(0x68, 0x68));
    let mut sensor = bench.probe().expect("a sensor");
    for (index, register) in (0x3B..=0x48).enumerate() {
        bench.0.borrow_mut().registers[register] = 100 + index as u8;
    }
    let before = bench.0.borrow().transactions;
    let burst = sensor.read_burst(123).expect("a burst");
    assert_eq!(bench.0.borrow().transactions, before + 1);
    let expected: Vec<u8> = (100..114).collect();
    assert_eq!(burst.bytes.to_vec(), expected);
    assert_eq!((burst.captured_at_us, burst.missed_before), (123, 0));
}
