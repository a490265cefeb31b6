//! The session and the driver on a bus with compasses made from the datasheets.

use std::collections::BTreeMap;

use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

use super::*;
use crate::attitude::Vector3;

/// Chip made from its datasheet, independent of the driver's tables.
struct Chip {
    registers: BTreeMap<u8, u8>,
    /// Registers that keep what is written to them.
    writable: &'static [u8],
    /// Bytes of a reading from its first register on, for the n-th reading.
    reading: Box<dyn Fn(u32) -> Vec<u8>>,
    first: u8,
    readings: u32,
    is_silent: bool,
}

impl Chip {
    fn new(
        identity: &[(u8, u8)],
        writable: &'static [u8],
        first: u8,
        reading: impl Fn(u32) -> Vec<u8> + 'static,
    ) -> Self {
        Self {
            registers: identity.iter().copied().collect(),
            writable,
            reading: Box::new(reading),
            first,
            readings: 0,
            is_silent: false,
        }
    }

    /// MS1356-E-02: WIA 0x48; ST1, six bytes, ST2; ASA 0x80 + 0x20 on each axis is 12.5 % more.
    fn ak8963(reading: impl Fn(u32) -> Vec<u8> + 'static) -> (u8, Self) {
        let fixed = [(0x00, 0x48), (0x10, 0xA0), (0x11, 0xA0), (0x12, 0xA0)];
        (0x0C, Self::new(&fixed, &[0x0A, 0x0C], 0x02, reading))
    }

    /// Form 900405: "H43", data from 0x03 on as X Z Y, status 0x09.
    fn hmc5883l(status: u8, reading: impl Fn(u32) -> Vec<u8> + 'static) -> (u8, Self) {
        let fixed = [(0x0A, b'H'), (0x0B, b'4'), (0x0C, b'3'), (0x09, status)];
        (0x1E, Self::new(&fixed, &[0, 1, 2], 0x03, reading))
    }

    /// QMC5883L datasheet 1.0: status 0x06, then the data by roll-over.
    fn qmc5883l(reading: impl Fn(u32) -> Vec<u8> + 'static) -> (u8, Self) {
        let fixed = [(0x0C, 0x01), (0x0D, 0xFF)];
        (0x0D, Self::new(&fixed, &[0x09, 0x0A, 0x0B], 0x06, reading))
    }

    /// 13-52-19: identity 0x80, data from 0x01 on, status 0x09.
    fn qmc5883p(reading: impl Fn(u32) -> Vec<u8> + 'static) -> (u8, Self) {
        let fixed = [(0x00, 0x80)];
        (0x2C, Self::new(&fixed, &[0x0A, 0x0B], 0x01, reading))
    }
}

#[derive(Default)]
struct Bus(BTreeMap<u8, Chip>);

impl Bus {
    fn with<const N: usize>(chips: [(u8, Chip); N]) -> Self {
        Self(chips.into_iter().collect())
    }

    fn chip(&mut self, address: u8) -> &mut Chip {
        self.0.get_mut(&address).expect("it is on the bus")
    }
}

impl ErrorType for Bus {
    type Error = ErrorKind;
}

impl I2c for Bus {
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        let chip = self.0.get_mut(&address).filter(|chip| !chip.is_silent);
        let Some(chip) = chip else {
            return Err(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address));
        };
        let mut pointer = 0;
        for operation in operations {
            match operation {
                Operation::Write([register, values @ ..]) => {
                    pointer = *register;
                    for value in values {
                        if chip.writable.contains(&pointer) {
                            chip.registers.insert(pointer, *value);
                        }
                        pointer += 1;
                    }
                }
                Operation::Write([]) => {}
                Operation::Read(bytes) if pointer == chip.first && bytes.len() > 5 => {
                    chip.readings += 1;
                    let reading = (chip.reading)(chip.readings);
                    assert_eq!(bytes.len(), reading.len(), "the reading's length");
                    bytes.copy_from_slice(&reading);
                }
                Operation::Read(bytes) => {
                    for byte in bytes.iter_mut() {
                        *byte = chip.registers.get(&pointer).copied().unwrap_or(0);
                        pointer += 1;
                    }
                }
            }
        }
        Ok(())
    }
}

struct NoDelay;

impl embedded_hal::delay::DelayNs for NoDelay {
    fn delay_ns(&mut self, _: u32) {}
}

/// Bytes of x = 100 + n, y = −200, z = 300 counts, in the order and with the status of each part.
fn ak8963_bytes(n: u32) -> Vec<u8> {
    let [x, y, z] = [100 + n as i16, -200, 300].map(i16::to_le_bytes);
    [&[0x01], &x[..], &y, &z, &[0x10]].concat()
}
fn hmc5883l_bytes(n: u32) -> Vec<u8> {
    let [x, y, z] = [100 + n as i16, -200, 300].map(i16::to_be_bytes);
    [x, z, y].concat()
}
fn qmc5883l_bytes(n: u32) -> Vec<u8> {
    let [x, y, z] = [100 + n as i16, -200, 300].map(i16::to_le_bytes);
    [&[0x01], &x[..], &y, &z].concat()
}
fn qmc5883p_bytes(n: u32) -> Vec<u8> {
    let [x, y, z] = [100 + n as i16, -200, 300].map(i16::to_le_bytes);
    [&x[..], &y, &z, &[0, 0, 0x01]].concat()
}

fn find(bus: Bus, choice: Choice) -> Option<Compass<Bus>> {
    Compass::find(bus, choice, &mut NoDelay)
}

fn every_part() -> [(PartId, Bus); 4] {
    [
        (PartId::Ak8963, Bus::with([Chip::ak8963(ak8963_bytes)])),
        (
            PartId::Hmc5883l,
            Bus::with([Chip::hmc5883l(1, hmc5883l_bytes)]),
        ),
        (
            PartId::Qmc5883l,
            Bus::with([Chip::qmc5883l(qmc5883l_bytes)]),
        ),
        (
            PartId::Qmc5883p,
            Bus::with([Chip::qmc5883p(qmc5883p_bytes)]),
        ),
    ]
}

#[test]
fn each_part_is_found_and_its_readings_are_microtesla_along_its_axes() {
    for (part, bus) in every_part() {
        let mut compass = find(bus, Choice::Auto).expect("it is there");
        assert_eq!(compass.session().part(), Some(part));
        assert_eq!(compass.session().fault(), None);
        let slots: Vec<Option<Vector3>> = (0..4).map(|_| compass.run_slot()).collect();
        let readings: Vec<Vector3> = slots.iter().copied().flatten().collect();
        assert_eq!(readings.len(), 2, "each second slot: {slots:?}");
        // Counts 101, −200, 300. 0.15 µT a count and 12.5 % more; 660, 3000, 3750 counts a
        // gauss. The HMC5883L's first two readings are dropped.
        let expected = match part {
            PartId::Ak8963 => Vector3::new(-200.0, 101.0, -300.0).scale(0.15 * 1.125),
            PartId::Hmc5883l => Vector3::new(103.0, -200.0, 300.0).scale(100.0 / 660.0),
            PartId::Qmc5883l => Vector3::new(101.0, -200.0, 300.0).scale(100.0 / 3000.0),
            PartId::Qmc5883p => Vector3::new(101.0, -200.0, 300.0).scale(100.0 / 3750.0),
        };
        assert!(
            (readings[0] - expected).norm() < 1e-3,
            "{part:?} {readings:?}"
        );
    }
}

#[test]
fn the_settings_are_those_of_the_datasheets() {
    let expected: [(PartId, &[(u8, u8)]); 4] = [
        // 16 bit, continuous mode 2.
        (PartId::Ak8963, &[(0x0A, 0x16)]),
        // Eight samples, 75 Hz; ±2.5 gauss; continuous.
        (
            PartId::Hmc5883l,
            &[(0x00, 0x78), (0x01, 0x60), (0x02, 0x00)],
        ),
        // 512 samples, 8 gauss, 100 Hz, continuous; roll-over, no interrupt; period.
        (
            PartId::Qmc5883l,
            &[(0x09, 0x19), (0x0A, 0x41), (0x0B, 0x01)],
        ),
        // 8 and 8 samples, 100 Hz, continuous; 8 gauss.
        (PartId::Qmc5883p, &[(0x0A, 0xCB), (0x0B, 0x08)]),
    ];
    for ((part, bus), (same, registers)) in every_part().into_iter().zip(expected) {
        assert_eq!(part, same);
        let mut bus = find(bus, Choice::Named(part))
            .expect("it is there")
            .release();
        for (register, value) in registers {
            assert_eq!(
                bus.chip(part.address()).registers[register],
                *value,
                "{part:?}"
            );
        }
    }
}

#[test]
fn a_board_without_a_compass_is_no_fault_and_a_named_one_is() {
    assert!(find(Bus::default(), Choice::Auto).is_none());
    assert!(find(Bus::with([Chip::ak8963(ak8963_bytes)]), Choice::Off).is_none());
    let absent = find(Bus::default(), Choice::Named(PartId::Hmc5883l)).expect("it goes on");
    let fault = absent.session().fault().expect("it is absent");
    assert_eq!(fault, Fault::Absent(PartId::Hmc5883l));
    assert!(
        fault
            .to_string()
            .contains("no HMC5883L answers at 0x1e: check its wiring")
    );
    // A compass that comes later is taken.
    let mut bus = absent;
    bus = Compass::find(bus.release(), Choice::Named(PartId::Hmc5883l), &mut NoDelay).unwrap();
    bus = {
        let mut compass = bus;
        let (address, chip) = Chip::hmc5883l(1, hmc5883l_bytes);
        compass.bus_mut().0.insert(address, chip);
        compass
    };
    let readings = (0..100).filter_map(|_| bus.run_slot()).count();
    assert!(readings > 10, "{readings}");
    assert_eq!(bus.session().fault(), None);
}

#[test]
fn a_mislabelled_board_is_named() {
    // Sold as HMC5883L, and a QMC5883L (marked DB5883) is on it.
    let bus = Bus::with([Chip::qmc5883l(qmc5883l_bytes)]);
    let compass = find(bus, Choice::Named(PartId::Hmc5883l)).expect("it goes on");
    let fault = compass.session().fault().expect("it is another part");
    assert!(
        fault.to_string().contains("\"compass qmc5883l\" uses it"),
        "{fault}"
    );
    // An early QMC5883L answers at the HMC5883L's address too: it is taken as what it is.
    let bus = Bus::with([
        Chip::qmc5883l(qmc5883l_bytes),
        Chip::hmc5883l(0, |_| vec![0; 6]),
    ]);
    let compass = find(bus, Choice::Auto).expect("it is there");
    assert_eq!(compass.session().part(), Some(PartId::Qmc5883l));
    // The clone marked DA5883 has the HMC5883L's registers and a dead status.
    let bus = Bus::with([Chip::hmc5883l(0, hmc5883l_bytes)]);
    let mut compass = find(bus, Choice::Auto).expect("it is there");
    assert_eq!(compass.session().name(), Some("HMC5883L/DA5883"));
    assert!((0..2).any(|_| compass.run_slot().is_some()), "it works");
}

#[test]
fn an_unknown_chip_is_named_by_its_identity() {
    let fixed = [(0x0A, b'L'), (0x0B, b'S'), (0x0C, b'M')];
    let chip = Chip::new(&fixed, &[], 0x03, hmc5883l_bytes);
    let mut session = Session::new(Choice::Auto);
    let mut compass = Bus::with([(0x1E, chip)]);
    while let Some(transfer) = session.next_transfer() {
        let mut bytes = [0; LONGEST_READ];
        let is_done = driver::perform(&mut compass, transfer, &mut bytes);
        session.finish(&if is_done {
            Outcome::Read(&bytes)
        } else {
            Outcome::NoAnswer
        });
    }
    let identity = *b"LSM";
    let fault = Fault::WrongIdentity {
        address: 0x1E,
        identity,
    };
    assert_eq!(session.fault(), Some(fault));
    assert!(fault.to_string().contains("4c 53 4d"), "{fault}");
}

/// Readings and the fault in the slots after a change of the chip.
fn slots(compass: &mut Compass<Bus>, count: usize) -> (usize, Option<Fault>) {
    let readings = (0..count).filter(|_| compass.run_slot().is_some()).count();
    (readings, compass.session().fault())
}

/// Each fault shows within its deadline in slots, with no reading after that, and ends.
#[test]
fn each_fault_of_the_readings_shows_in_time_and_ends() {
    type Reading = fn(u32) -> Vec<u8>;
    let frozen: Reading = |_| ak8963_bytes(1);
    let zeros: Reading = |_| vec![0; 8];
    let ones: Reading = |_| vec![0xFF; 8];
    let overflow: Reading = |n| {
        let mut bytes = ak8963_bytes(n);
        bytes[7] |= 0x08;
        bytes
    };
    let not_ready: Reading = |n| {
        let mut bytes = ak8963_bytes(n);
        bytes[0] = 0;
        bytes
    };
    let wrong_width: Reading = |n| {
        let mut bytes = ak8963_bytes(n);
        bytes[7] = 0x00;
        bytes
    };
    let cases: [(Reading, Fault, usize); 6] = [
        (frozen, Fault::Frozen, 54),
        (zeros, Fault::Blank, 6),
        (ones, Fault::Blank, 6),
        (overflow, Fault::Overflow, 20),
        (not_ready, Fault::NeverReady, 20),
        (wrong_width, Fault::Garbled, 6),
    ];
    for (reading, fault, deadline_slots) in cases {
        let mut compass = find(Bus::with([Chip::ak8963(ak8963_bytes)]), Choice::Auto).unwrap();
        assert!(slots(&mut compass, 100).0 >= 49);
        compass.bus_mut().chip(0x0C).reading = Box::new(reading);
        let (_, found) = slots(&mut compass, deadline_slots);
        assert_eq!(found, Some(fault));
        assert_eq!(slots(&mut compass, 100), (0, Some(fault)), "it lasts");
        compass.bus_mut().chip(0x0C).reading = Box::new(ak8963_bytes);
        let (readings, found) = slots(&mut compass, 40);
        assert!(readings > 0, "{fault:?}");
        assert_eq!(found, None);
    }
}

/// A fault takes bad outcomes in a row.
#[test]
fn bad_outcomes_apart_are_no_fault() {
    type Reading = fn(u32) -> Vec<u8>;
    let overflow: Reading = |n| {
        let mut bytes = ak8963_bytes(n);
        bytes[7] |= if n.is_multiple_of(10) { 0x08 } else { 0 };
        bytes
    };
    let not_ready: Reading = |n| {
        let mut bytes = ak8963_bytes(n);
        bytes[0] = u8::from(!n.is_multiple_of(10));
        bytes
    };
    let garbled: Reading = |n| {
        let mut bytes = ak8963_bytes(n);
        bytes[7] = if n.is_multiple_of(10) { 0 } else { 0x10 };
        bytes
    };
    for reading in [overflow, not_ready, garbled] {
        let mut compass = find(Bus::with([Chip::ak8963(reading)]), Choice::Auto).unwrap();
        for _ in 0..20 {
            assert_eq!(slots(&mut compass, 20), (9, None));
        }
    }
}

/// Two slots have one reading that is not acknowledged, or one and a check of the settings.
#[test]
fn silent_slots_apart_are_no_fault() {
    for (part, bus) in every_part() {
        let mut compass = find(bus, Choice::Auto).unwrap();
        for _ in 0..50 {
            compass.bus_mut().chip(part.address()).is_silent = true;
            assert_eq!(slots(&mut compass, 2), (0, None), "{part:?}");
            compass.bus_mut().chip(part.address()).is_silent = false;
            let (readings, fault) = slots(&mut compass, 7);
            assert!(readings >= 3, "{part:?} {readings}");
            assert_eq!(fault, None, "{part:?}");
        }
    }
}

/// A strong magnet is no fault of the settings: the session goes on with its readings.
#[test]
fn an_overflow_drops_readings_and_nothing_else() {
    let overflow = |n| {
        let mut bytes = ak8963_bytes(n);
        bytes[7] |= 0x08;
        bytes
    };
    let mut compass = find(Bus::with([Chip::ak8963(ak8963_bytes)]), Choice::Auto).unwrap();
    assert!(slots(&mut compass, 20).0 > 0);
    compass.bus_mut().chip(0x0C).reading = Box::new(overflow);
    for _ in 0..100 {
        assert_eq!(slots(&mut compass, 1).0, 0);
        assert!(compass.session().is_running());
    }
    assert_eq!(compass.session().fault(), Some(Fault::Overflow));
}

#[test]
fn a_compass_that_disappears_is_lost_and_found_again() {
    for (part, bus) in every_part() {
        let mut compass = find(bus, Choice::Auto).unwrap();
        let address = part.address();
        compass.bus_mut().chip(address).is_silent = true;
        assert_eq!(slots(&mut compass, 6), (0, Some(Fault::Lost(part))));
        assert_eq!(slots(&mut compass, 300), (0, Some(Fault::Lost(part))));
        // Its supply comes back, and its settings are gone.
        let chip = compass.bus_mut().chip(address);
        chip.is_silent = false;
        for register in chip.writable {
            chip.registers.insert(*register, 0);
        }
        let (readings, fault) = slots(&mut compass, 60);
        assert!(
            readings > 5 && fault.is_none(),
            "{part:?} {readings} {fault:?}"
        );
        let settings = part.part().facts().setting;
        assert_eq!(
            compass.bus_mut().chip(address).registers[&settings.0],
            settings.1
        );
    }
}

#[test]
fn a_compass_that_stops_the_bus_is_left_alone_for_longer_and_longer() {
    let [_, _, (_, bus), _] = every_part();
    let mut compass = find(bus, Choice::Auto).unwrap();
    let mut session = compass.session().clone();
    let mut transfers = Vec::new();
    for slot in 0..3_000 {
        if session.next_transfer().is_some() {
            transfers.push(slot);
            assert_eq!(session.finish(&Outcome::Hung), None);
            assert_eq!(session.fault(), Some(Fault::HoldsBus));
        }
    }
    let pauses: Vec<i32> = transfers.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(pauses.starts_with(&[11, 21, 41, 81]), "{pauses:?}");
    assert_eq!(pauses.last(), Some(&1_001), "{pauses:?}");
    assert!(slots(&mut compass, 4).1.is_none());
}

#[test]
fn after_good_readings_a_stop_of_the_bus_has_a_short_pause_again() {
    let [(_, mut bus), ..] = every_part();
    let mut session = Session::new(Choice::Auto);
    // Returns whether the slot had a transfer.
    let mut run_slot = |session: &mut Session, hangs: bool| {
        let Some(transfer) = session.next_transfer() else {
            return false;
        };
        let mut bytes = [0; LONGEST_READ];
        let is_done = driver::perform(&mut bus, transfer, &mut bytes);
        session.finish(&match (hangs, is_done, transfer) {
            (true, ..) => Outcome::Hung,
            (_, false, _) => Outcome::NoAnswer,
            (_, true, Transfer::Read { .. }) => Outcome::Read(&bytes),
            (_, true, Transfer::Write { .. }) => Outcome::Written,
        });
        true
    };
    for _ in 0..3 {
        let mut stops = Vec::new();
        for number in 0..100 {
            if run_slot(&mut session, stops.len() < 4) && stops.len() < 4 {
                stops.push(number);
            }
        }
        let pauses: Vec<i32> = stops.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert_eq!(pauses, [11, 21, 41]);
        for _ in 0..200 {
            run_slot(&mut session, false);
        }
        assert_eq!(session.fault(), None);
        assert!(session.is_running());
    }
}

/// A board without a compass is no fault, even if a disturbance has stopped the bus meanwhile.
#[test]
fn a_stop_of_the_bus_without_a_compass_is_forgotten() {
    let mut session = Session::new(Choice::Auto);
    session.next_transfer();
    session.finish(&Outcome::Hung);
    assert_eq!(session.fault(), Some(Fault::HoldsBus));
    for _ in 0..200 {
        if session.next_transfer().is_some() {
            session.finish(&Outcome::NoAnswer);
        }
    }
    assert!(session.is_idle());
    assert_eq!(session.fault(), None);
}

#[test]
fn lost_settings_and_impossible_trims_are_reported() {
    for (part, bus) in every_part() {
        let mut compass = find(bus, Choice::Auto).unwrap();
        let (register, value) = part.part().facts().setting;
        compass
            .bus_mut()
            .chip(part.address())
            .registers
            .insert(register, 0x55);
        let seen = (0..34).any(|_| {
            compass.run_slot();
            matches!(compass.session().fault(), Some(Fault::Settings { .. }))
        });
        assert!(seen, "{part:?}");
        assert_eq!(
            slots(&mut compass, 40).1,
            None,
            "{part:?}: configured again"
        );
        assert_eq!(
            compass.bus_mut().chip(part.address()).registers[&register],
            value
        );
    }
    let (address, mut chip) = Chip::ak8963(ak8963_bytes);
    chip.registers.insert(0x11, 0xFF);
    let compass = find(Bus::with([(address, chip)]), Choice::Auto).unwrap();
    assert_eq!(
        compass.session().fault(),
        Some(Fault::Trim([0xA0, 0xFF, 0xA0]))
    );
}

#[test]
fn a_register_that_does_not_keep_its_value_is_named() {
    let (address, mut chip) = Chip::qmc5883l(qmc5883l_bytes);
    chip.writable = &[0x0A, 0x0B];
    let compass = find(Bus::with([(address, chip)]), Choice::Auto).unwrap();
    let fault = compass.session().fault().expect("0x09 is stuck");
    assert_eq!(
        fault.to_string(),
        "the QMC5883L did not keep register 0x09: wrote 0x19, read 0x00: check its supply"
    );
}

#[test]
fn overflow_and_garbage_are_known_for_each_part() {
    // HMC5883L: −4096 is overflow, and 12 bits hold no 3000.
    let hmc = PartId::Hmc5883l.part();
    let bytes = |bytes: &[u8]| {
        let mut all = [0; LONGEST_READ];
        all[..bytes.len()].copy_from_slice(bytes);
        all
    };
    let status = |part: PartId, given: &[u8]| part.part().status(&bytes(given));
    use super::part::Status;
    assert_eq!(hmc.status(&bytes(&hmc5883l_bytes(1))), Status::Ready);
    let overflow = [0xF0, 0x00, 0, 1, 0, 1];
    assert_eq!(hmc.status(&bytes(&overflow)), Status::Overflow);
    assert_eq!(
        hmc.status(&bytes(&[0x0B, 0xB8, 0, 1, 0, 1])),
        Status::Garbled
    );
    // QMC5883L: bit 1 of the status; bits 7 to 3 are always zero.
    for (byte, expected) in [
        (0x01, Status::Ready),
        (0x05, Status::Ready),
        (0x00, Status::NotReady),
        (0x03, Status::Overflow),
        (0x41, Status::Garbled),
    ] {
        assert_eq!(
            status(PartId::Qmc5883l, &[byte, 1, 2, 3, 4, 5, 6]),
            expected
        );
    }
    for (byte, expected) in [
        (0x01, Status::Ready),
        (0x00, Status::NotReady),
        (0x03, Status::Overflow),
        (0x05, Status::Garbled),
    ] {
        assert_eq!(
            status(PartId::Qmc5883p, &[1, 2, 3, 4, 5, 6, 0, 0, byte]),
            expected
        );
    }
}

#[test]
fn the_self_test_compares_with_the_datasheets_limits() {
    // AK8963: counts within ±200 and −3200 to −800 with the self-field; 12.5 % more by the
    // trim.
    let self_field = |_: u32| {
        let [x, y, z] = [100_i16, -100, -1500].map(i16::to_le_bytes);
        [&[0x01], &x[..], &y, &z, &[0x10]].concat()
    };
    let mut compass = find(Bus::with([Chip::ak8963(ak8963_bytes)]), Choice::Auto).unwrap();
    compass.bus_mut().chip(0x0C).reading = Box::new(self_field);
    let test = compass.self_test(&mut NoDelay).expect("it answers");
    assert_eq!(test.has_passed(), Some(true));
    assert_eq!(
        test.to_string(),
        "compass passed: x 112 in -200..200 y -112 in -200..200 z -1687 in -3200..-800"
    );
    assert_eq!(compass.bus_mut().chip(0x0C).registers[&0x0C], 0x40);
    let mut compass = find(Bus::with([Chip::hmc5883l(1, hmc5883l_bytes)]), Choice::Auto).unwrap();
    let test = compass.self_test(&mut NoDelay).expect("it answers");
    assert_eq!(test.has_passed(), Some(false), "{test}");
    assert_eq!(compass.bus_mut().chip(0x1E).registers[&0x00], 0x79);
    // The next slots configure it again.
    assert!(slots(&mut compass, 20).0 > 0);
    assert_eq!(compass.bus_mut().chip(0x1E).registers[&0x00], 0x78);
    let mut compass = find(Bus::with([Chip::qmc5883l(qmc5883l_bytes)]), Choice::Auto).unwrap();
    assert_eq!(
        compass
            .self_test(&mut NoDelay)
            .expect("it answers")
            .has_passed(),
        None
    );
}

#[test]
fn every_message_of_a_fault_fits_a_line() {
    let part = PartId::Qmc5883l;
    let faults = [
        Fault::Absent(part),
        Fault::WrongIdentity {
            address: 0x1E,
            identity: [0; 3],
        },
        Fault::Other {
            named: part,
            found: PartId::Qmc5883p,
        },
        Fault::Lost(part),
        Fault::Settings {
            part,
            register: 0xFF,
            written: 0xFF,
            read: 0xFF,
        },
        Fault::Trim([0xFF; 3]),
        Fault::NeverReady,
        Fault::Frozen,
        Fault::Blank,
        Fault::Overflow,
        Fault::Garbled,
        Fault::HoldsBus,
    ];
    for fault in faults {
        let text = fault.to_string();
        assert!(text.len() <= 170, "{} bytes: {text}", text.len());
        assert!(!fault.name().contains(' '));
    }
}
