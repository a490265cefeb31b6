//! The chips against their datasheets, and the field against closed forms.

use super::*;
use crate::motion::geometry::{Quaternion, norm, subtract};

fn still(yaw_rad: f64) -> Truth {
    Truth::at_rest(Quaternion::from_euler(0.0, 0.0, yaw_rad))
}

/// A chip in the clean field of Berlin, level and heading north.
fn clean(part: Part) -> Compass {
    Compass::new(CompassConfig {
        magnetism: Magnetism::clean(EarthField::default()),
        mount: Mount::parse("+x+z").expect("a mount"),
        ..CompassConfig::new(1, part)
    })
}

fn write(compass: &mut Compass, now_ns: u64, address: u8, bytes: &[u8]) {
    assert!(compass.start(now_ns, address, false));
    for byte in bytes {
        assert!(compass.write(now_ns, *byte));
    }
}

fn read(compass: &mut Compass, now_ns: u64, address: u8, register: u8, count: usize) -> Vec<u8> {
    assert!(compass.start(now_ns, address, false));
    assert!(compass.write(now_ns, register));
    assert!(compass.start(now_ns, address, true));
    (0..count).map(|_| compass.read()).collect()
}

#[test]
fn the_field_of_a_place_turns_with_the_body() {
    let field = Magnetism::clean(EarthField::of("berlin").expect("a place"));
    let [north, east, down] = field.at(0.0, &still(0.0));
    assert!((libm::atan2(down, north).to_degrees() - 68.0).abs() < 1e-9);
    assert!((norm([north, east, down]) - 49.7).abs() < 1e-9);
    // Heading east, magnetic north is to the left.
    let [forward, right, _] = field.at(0.0, &still(std::f64::consts::FRAC_PI_2));
    assert!(forward.abs() < 1e-9 && (right + north).abs() < 1e-9);
    assert!(EarthField::of("sydney").expect("a place").magnetic_ned_ut()[2] < 0.0);
}

#[test]
fn iron_motors_and_a_magnet_add_what_they_should() {
    let mut field = Magnetism::clean(EarthField::default());
    let clean = field.at(0.0, &still(0.0));
    field.hard_iron_ut = [1.0, 2.0, 3.0];
    field.motors_ut = [0.0, 10.0, 0.0];
    for (thrust_g, right_ut) in [(0.0, 2.0), (1.0, 12.0), (1.5, 17.0)] {
        let truth = Truth {
            thrust_g,
            ..still(0.0)
        };
        let added = subtract(field.at(0.0, &truth), clean);
        assert!(norm(subtract(added, [1.0, right_ut, 3.0])) < 1e-9);
    }
    // A dipole of 1 A·m² on its axis at 0.1 m: 2·µ₀/4π·m/r³ = 200 µT.
    let magnet = PassingMagnet {
        closest_s: 5.0,
        stands: false,
        closest_m: [0.1, 0.0, 0.0],
        velocity_m_s: [0.0, 1.0, 0.0],
        moment_a_m2: [1.0, 0.0, 0.0],
    };
    assert!((magnet.field_ut(5.0)[0] - 200.0).abs() < 1e-9);
    assert!(norm(magnet.field_ut(15.0)) < 1e-3, "it is gone");
    assert!(norm(magnet.field_ut(-5.0)) < 1e-3, "it is not there yet");
    let stands = PassingMagnet {
        stands: true,
        ..magnet
    };
    assert_eq!(stands.field_ut(-5.0), magnet.field_ut(5.0));
    assert_eq!(stands.field_ut(6.0), magnet.field_ut(6.0));
}

#[test]
fn the_ak8963_follows_its_datasheet() {
    let mut compass = clean(Part::Ak8963);
    compass.power_up(0);
    assert!(
        !compass.start(49_000_000, 0x0C, false),
        "not ready before 50 ms"
    );
    let now = 60_000_000;
    assert_eq!(read(&mut compass, now, 0x0C, 0x00, 1), [0x48]);
    assert_eq!(
        read(&mut compass, now, 0x0C, 0x10, 3),
        [0; 3],
        "fuses are closed"
    );
    write(&mut compass, now, 0x0C, &[0x0A, 0x1F]);
    let trims = read(&mut compass, now, 0x0C, 0x10, 3);
    assert!(
        trims.iter().all(|trim| (160..192).contains(trim)),
        "{trims:?}"
    );
    // From fuse access to a measurement leads through power-down alone.
    write(&mut compass, now, 0x0C, &[0x0A, 0x16]);
    assert_eq!(read(&mut compass, now, 0x0C, 0x0A, 1), [0x1F]);
    write(&mut compass, now, 0x0C, &[0x0A, 0x00]);
    write(&mut compass, now, 0x0C, &[0x0A, 0x16]);
    compass.advance_to(now + 7_000_000, &still(0.0));
    assert_eq!(read(&mut compass, now, 0x0C, 0x02, 1), [0x00]);
    compass.advance_to(now + 8_000_000, &still(0.0));
    let reading = read(&mut compass, now, 0x0C, 0x02, 8);
    assert_eq!((reading[0], reading[7]), (0x01, 0x10));
    let counts = |nth: usize| f64::from(i16::from_le_bytes([reading[nth], reading[nth + 1]]));
    // Chip X is the package's Y, which is east: nothing. Chip Y is north, 18.6 µT; Z is −46.1.
    let factor = |axis: usize| 0.15 * ((f64::from(trims[axis]) - 128.0) / 256.0 + 1.0);
    assert!(counts(1).abs() * 0.15 < 2.0, "{reading:?}");
    assert!((counts(3) * factor(1) - 18.6).abs() < 2.0, "{reading:?}");
    assert!((counts(5) * factor(2) + 46.1).abs() < 2.0, "{reading:?}");
    assert_eq!(
        read(&mut compass, now, 0x0C, 0x02, 1),
        [0x00],
        "ST2 cleared it"
    );
    // Without ST2 the registers stay locked; the overrun shows.
    compass.advance_to(now + 18_000_000, &still(0.0));
    let before = read(&mut compass, now, 0x0C, 0x03, 6);
    compass.advance_to(now + 38_000_000, &still(1.0));
    assert_eq!(read(&mut compass, now, 0x0C, 0x03, 6), before);
    assert_eq!(read(&mut compass, now, 0x0C, 0x02, 1), [0x03]);
    compass.set_faults(vec![CompassFault::Overflow]);
    read(&mut compass, now, 0x0C, 0x09, 1);
    compass.advance_to(now + 60_000_000, &still(0.0));
    assert_eq!(read(&mut compass, now, 0x0C, 0x02, 8)[7], 0x18);
}

#[test]
fn the_hmc5883l_follows_its_datasheet() {
    let mut compass = clean(Part::Hmc5883l);
    let now = 60_000_000;
    assert_eq!(read(&mut compass, now, 0x1E, 0x0A, 3), *b"H43");
    assert_eq!(read(&mut compass, now, 0x1E, 0x00, 3), [0x10, 0x20, 0x01]);
    write(&mut compass, now, 0x1E, &[0x00, 0x78, 0x60, 0x00]);
    for step in 1..=5 {
        compass.advance_to(now + step * 14_000_000, &still(0.0));
    }
    assert_eq!(read(&mut compass, now, 0x1E, 0x09, 1), [0x01]);
    let bytes = read(&mut compass, now, 0x1E, 0x03, 6);
    let counts = |nth: usize| f64::from(i16::from_be_bytes([bytes[nth], bytes[nth + 1]]));
    // X, Z, Y at 660 counts a gauss: 18.6 µT, 46.1 µT, nothing.
    assert!((counts(0) - 0.186 * 660.0).abs() < 5.0, "{bytes:?}");
    assert!((counts(2) - 0.461 * 660.0).abs() < 5.0, "{bytes:?}");
    assert!(counts(4).abs() < 5.0, "{bytes:?}");
    // Half a reading locks the registers.
    read(&mut compass, now, 0x1E, 0x03, 2);
    assert_eq!(read(&mut compass, now, 0x1E, 0x09, 1), [0x03]);
    compass.set_faults(vec![CompassFault::Overflow]);
    read(&mut compass, now, 0x1E, 0x05, 4);
    compass.advance_to(now + 90_000_000, &still(0.0));
    assert_eq!(
        read(&mut compass, now, 0x1E, 0x03, 6),
        [0xF0, 0x00].repeat(3)
    );
    // The clone's status is dead.
    let mut clone = clean(Part::Da5883);
    clone.advance_to(now, &still(0.0));
    assert_eq!(read(&mut clone, now, 0x1E, 0x09, 1), [0x00]);
}

#[test]
fn the_hmc5883l_locks_its_data_when_its_mode_is_read() {
    let ms = 1_000_000;
    let mut compass = clean(Part::Hmc5883l);
    let now = 60 * ms;
    write(&mut compass, now, 0x1E, &[0x00, 0x78, 0x60, 0x00]);
    // The power-on measurement waits. The first in continuous mode takes two periods, 26.7 ms.
    let first = read(&mut compass, now, 0x1E, 0x03, 6);
    compass.advance_to(now + 26 * ms, &still(0.0));
    assert_eq!(read(&mut compass, now, 0x1E, 0x03, 6), first);
    compass.advance_to(now + 27 * ms, &still(0.0));
    let second = read(&mut compass, now, 0x1E, 0x03, 6);
    assert_ne!(second, first);
    // A read of the mode locks the data until all six bytes have been read.
    assert_eq!(read(&mut compass, now, 0x1E, 0x00, 2), [0x78, 0x60]);
    assert_eq!(read(&mut compass, now, 0x1E, 0x09, 1), [0x01]);
    assert_eq!(read(&mut compass, now, 0x1E, 0x01, 2), [0x60, 0x00]);
    assert_eq!(read(&mut compass, now, 0x1E, 0x09, 1), [0x03]);
    compass.advance_to(now + 54 * ms, &still(0.0));
    assert_eq!(read(&mut compass, now, 0x1E, 0x03, 6), second);
    compass.advance_to(now + 67 * ms, &still(0.0));
    let third = read(&mut compass, now, 0x1E, 0x03, 6);
    assert_ne!(third, second);
    // The same mode again does not unlock them. Another configuration does.
    for (value, is_new) in [([0x02, 0x00], false), ([0x00, 0x58], true)] {
        read(&mut compass, now, 0x1E, 0x02, 1);
        write(&mut compass, now + 67 * ms, 0x1E, &value);
        compass.advance_to(now + 94 * ms, &still(0.0));
        let status = read(&mut compass, now, 0x1E, 0x09, 1);
        assert_eq!(status, [if is_new { 0x01 } else { 0x03 }]);
    }
}

#[test]
fn the_qmc5883l_and_its_successor_follow_their_datasheets() {
    let now = 60_000_000;
    let mut compass = clean(Part::Qmc5883l);
    assert_eq!(read(&mut compass, now, 0x0D, 0x0C, 2), [0x00, 0x00]);
    read(&mut compass, now, 0x0D, 0x00, 2);
    assert_eq!(read(&mut compass, now, 0x0D, 0x0C, 2), [0x01, 0xFF]);
    write(&mut compass, now, 0x0D, &[0x0A, 0x41]);
    write(&mut compass, now, 0x0D, &[0x09, 0x19]);
    compass.advance_to(now + 11_000_000, &still(0.0));
    let bytes = read(&mut compass, now, 0x0D, 0x06, 7);
    let counts =
        |bytes: &[u8], nth: usize| f64::from(i16::from_le_bytes([bytes[nth], bytes[nth + 1]]));
    assert_eq!(bytes[0], 0x01);
    assert!(
        (counts(&bytes, 1) - 0.186 * 3000.0).abs() < 20.0,
        "{bytes:?}"
    );
    assert!(
        (counts(&bytes, 5) - 0.461 * 3000.0).abs() < 20.0,
        "{bytes:?}"
    );
    assert_eq!(
        read(&mut compass, now, 0x0D, 0x06, 1),
        [0x00],
        "the data were read"
    );

    let mut compass = clean(Part::Qmc5883p);
    assert_eq!(read(&mut compass, now, 0x2C, 0x00, 1), [0x80]);
    write(&mut compass, now, 0x2C, &[0x0B, 0x08]);
    write(&mut compass, now, 0x2C, &[0x0A, 0xCB]);
    compass.advance_to(now + 11_000_000, &still(0.0));
    let bytes = read(&mut compass, now, 0x2C, 0x01, 9);
    assert_eq!(bytes[8], 0x01);
    assert!(
        (counts(&bytes, 0) - 0.186 * 3750.0).abs() < 25.0,
        "{bytes:?}"
    );
    assert_eq!(
        read(&mut compass, now, 0x2C, 0x09, 1),
        [0x00],
        "the status was read"
    );
}

#[test]
fn a_measurement_shows_the_field_of_before() {
    let mut compass = clean(Part::Qmc5883l);
    write(&mut compass, 0, 0x0D, &[0x09, 0x19]);
    for step in 0..20_u64 {
        let now_ns = step * 1_000_000;
        // Each millisecond turns the body by one radian.
        compass.advance_to(now_ns, &still(step as f64));
    }
    let expected = Magnetism::clean(EarthField::default()).at(0.0, &still(6.0));
    assert!(
        norm(subtract(compass.measured_ut(), expected)) < 1e-9,
        "4 ms before 10 ms"
    );
}
