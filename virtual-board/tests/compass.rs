//! Boards with a compass: budgets, the field through the whole chain, and what the firmware says
//! of a compass that is not as it was named.
//!
//! The faults of a compass are rows of docs/faults.md, which `recovery.rs` flies.

mod common;

use aplomb::health::Flags;
use aplomb_models::compass::{CompassConfig, EarthField, Magnetism, Part};
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::{Motion, Mount, Quaternion, Truth};
use aplomb_models::sensor::SensorErrors;
use common::pooled_run;
use virtual_board::bus_step::BusStep;
use virtual_board::flight::{Outcome, Run};
use virtual_board::kit::Kit;
use virtual_board::recorder::Sample;
use virtual_board::schedule::Schedule;

/// Fields that `status` has printed: body axes, µT.
fn fields(outcome: &Outcome) -> Vec<[f64; 3]> {
    let field = |text: &str| {
        let (_, rest) = text.split_once("field_ut=")?;
        let numbers = rest.split_whitespace().next()?.split(',');
        let numbers: Vec<f64> = numbers.map(|number| number.parse().unwrap()).collect();
        Some([numbers[0], numbers[1], numbers[2]])
    };
    let lines = outcome.uart_lines.iter();
    lines.filter_map(|line| field(&line.text)).collect()
}

/// A part in Berlin's field without iron, level and heading north, on this mount.
fn at_rest(kit: Kit, part: Part, mount: &str, is_behind_imu: bool) -> Run {
    pooled_run()
        .kit(kit)
        .compass(CompassConfig {
            mount: Mount::parse(mount).unwrap(),
            is_behind_imu,
            magnetism: Magnetism::clean(EarthField::default()),
            ..CompassConfig::new(1, part)
        })
        .motion(Rest::level())
        .without_probe()
}

#[test]
fn a_compass_delays_no_attitude_and_loses_no_sample() {
    for kit in [Kit::Mpu9250, Kit::Gy87] {
        let outcome = pooled_run().kit(kit).seconds(8.0).run().unwrap();
        let summary = &outcome.summary;
        assert!(
            summary
                .edge_to_attitude_us_max
                .is_some_and(|it| it <= 395.0),
            "{summary:?}"
        );
        assert_eq!(summary.missed, 0, "{kit:?}");
        assert_eq!(outcome.issues, Vec::<String>::new());
        let flags = outcome.samples().iter().map(|sample| sample.snapshot.flags);
        let allowed = Flags::VALID | Flags::DEGRADED | Flags::CALIBRATING;
        let all = flags.fold(Flags::empty(), |all, flags| all | flags);
        assert!(allowed.contains(all), "{kit:?} {all}");
        assert!(outcome.reports("configured"), "{kit:?}");
    }
}

/// All five chips, found by themselves, give the field in body axes: 18.6 µT to the north, which
/// is forward, and 46.1 µT down.
#[test]
fn the_field_comes_through_in_body_axes() {
    for (kit, part, name) in [
        (Kit::Mpu9250, Part::Ak8963, "AK8963@0x0c"),
        (Kit::Gy87, Part::Hmc5883l, "HMC5883L@0x1e"),
        (Kit::Gy87, Part::Da5883, "HMC5883L/DA5883@0x1e"),
        (Kit::Gy87, Part::Qmc5883l, "QMC5883L@0x0d"),
        (Kit::Gy87, Part::Qmc5883p, "QMC5883P@0x2c"),
    ] {
        let outcome = at_rest(kit, part, "z-up", true)
            .seconds(1.5)
            .command(1.2, "status")
            .run()
            .unwrap();
        assert!(
            outcome.uart_reports(&format!("compass={name}")),
            "{part:?} {:?}",
            outcome.uart_lines
        );
        let [[x, y, z]] = fields(&outcome)[..] else {
            panic!("{part:?} has a field");
        };
        let is_right = (x - 18.6).abs() < 2.5 && y.abs() < 2.5 && (z - 46.1).abs() < 2.5;
        assert!(is_right, "{part:?}: {x} {y} {z}");
    }
}

/// A person turns the board to and fro about all axes, after a rest of 3 s.
struct HandTurn;

impl HandTurn {
    fn attitude(time_s: f64) -> Quaternion {
        let t = (time_s - 3.0).max(0.0);
        let swing = |amplitude: f64, rate: f64| amplitude * (rate * t).sin() * (t / 2.0).min(1.0);
        Quaternion::from_euler(swing(3.0, 0.9), swing(1.5, 0.53), swing(2.8, 0.31))
    }
}

impl Motion for HandTurn {
    fn at(&mut self, time_s: f64) -> Truth {
        let step_s = 1e-4;
        let attitude = Self::attitude(time_s);
        let next = Self::attitude(time_s + step_s);
        let turn = attitude.conjugate().multiply(next).to_rotation_vector();
        Truth {
            body_rates_rad_s: turn.map(|angle| angle / step_s),
            ..Truth::at_rest(attitude)
        }
    }
}

/// The calibration finds strong hard iron and a mount that nobody named, and the field in body axes
/// is right afterwards: after `save` and a restart too.
#[test]
fn a_calibration_finds_iron_and_mount() {
    let mut magnetism = Magnetism::clean(EarthField::default());
    magnetism.hard_iron_ut = [40.0, -60.0, 25.0];
    magnetism.soft_iron = [[1.1, 0.02, 0.0], [0.0, 0.92, 0.03], [-0.02, 0.0, 0.99]];
    let config = CompassConfig {
        mount: Mount::parse("+y-z").unwrap(),
        magnetism,
        ..CompassConfig::new(1, Part::Qmc5883l)
    };
    let outcome = pooled_run()
        .kit(Kit::Gy87)
        .compass(config.clone())
        .motion(HandTurn)
        .seconds(42.0)
        .command(2.5, "calibrate compass")
        .command(39.0, "save")
        .without_probe()
        .run()
        .unwrap();
    let lines: Vec<&str> = outcome
        .uart_lines
        .iter()
        .map(|line| line.text.as_str())
        .collect();
    let console: Vec<&&str> = lines
        .iter()
        .filter(|line| line.contains("compass"))
        .collect();
    let done = console.iter().find(|line| line.contains("done calibrate"));
    let done = done.unwrap_or_else(|| panic!("{console:?}"));
    assert!(done.contains("mount +y-z, hard iron"), "{done}");
    assert!(
        console.iter().any(|line| line.contains("%, next: ")),
        "{console:?}"
    );
    assert!(outcome.uart_reports("done save: stored"));
    // The next flight has the correction from flash: level and heading north.
    let outcome = pooled_run()
        .kit(Kit::Gy87)
        .compass(config)
        .motion(Rest::level())
        .flash(outcome.flash.bytes.clone())
        .seconds(1.5)
        .command(1.2, "status")
        .without_probe()
        .run()
        .unwrap();
    let [[x, y, z]] = fields(&outcome)[..] else {
        panic!("a field: {:?}", outcome.uart_lines);
    };
    let heading_deg = (-y).atan2(x).to_degrees();
    let dip_deg = z.atan2(x.hypot(y)).to_degrees();
    assert!(
        heading_deg.abs() < 6.0 && (dip_deg - 68.0).abs() < 3.0,
        "{x} {y} {z}"
    );
}

/// A flight with a compass that nobody calibrated shows its hard iron. `compass keep` and `save`
/// give it to the next start, whose heading is known on the table.
#[test]
fn the_hard_iron_of_a_flight_serves_the_next_start() {
    let mut magnetism = Magnetism::clean(EarthField::default());
    magnetism.hard_iron_ut = [40.0, -60.0, 25.0];
    let config = CompassConfig {
        mount: Mount::parse("+y-z").unwrap(),
        magnetism,
        ..CompassConfig::new(1, Part::Qmc5883l)
    };
    let run = pooled_run().kit(Kit::Gy87).seed(4).seconds(30.0);
    let outcome = run
        .compass(config.clone())
        .command(0.8, "compass +y-z")
        .command(1.0, "compass keep")
        .command(27.0, "status")
        .command(28.0, "compass keep")
        .command(28.5, "save")
        .without_probe()
        .run()
        .unwrap();
    assert!(outcome.uart_reports("error compass keep: the hard iron is not certain yet"));
    assert!(outcome.uart_reports("ok compass keep: hard iron "));
    assert!(outcome.uart_reports("done save: stored"));
    let status = outcome.uart_lines.iter().find_map(|line| {
        let (_, rest) = line.text.split_once(" hard_iron_ut=")?;
        let found = rest.split_whitespace().next()?.split(',');
        found.map(|number| number.parse().ok()).collect()
    });
    let found: Vec<f64> = status.unwrap_or_else(|| panic!("{:?}", outcome.uart_lines));
    for (found, iron) in found.iter().zip(config.magnetism.hard_iron_ut) {
        assert!((found - iron).abs() < 3.0, "{found} {iron}");
    }
    let outcome = pooled_run()
        .kit(Kit::Gy87)
        .compass(config)
        .motion(Rest::level())
        .flash(outcome.flash.bytes.clone())
        .seconds(6.0)
        .command(5.0, "status")
        .without_probe()
        .run()
        .unwrap();
    assert!(outcome.uart_reports(" calibrated=hard-iron "));
    assert!(outcome.uart_reports(" heading_valid=no north=magnetic"));
    let heading = outcome.samples().last().unwrap().heading.unwrap();
    let error_deg = f64::from(heading.yaw_offset_rad).to_degrees();
    assert!(error_deg.abs() < 10.0, "{error_deg}");
}

/// A compass in a GPS module: on the main bus, and mounted otherwise than the IMU.
#[test]
fn the_mount_of_the_compass_is_its_own() {
    let outcome = at_rest(Kit::Mpu6050, Part::Hmc5883l, "+y+z", false)
        .seconds(2.2)
        .command(1.0, "status")
        .command(1.2, "compass +y+z")
        .command(1.8, "status")
        .run()
        .unwrap();
    let [before, [x, y, z]] = fields(&outcome)[..] else {
        panic!("two fields: {:?}", outcome.uart_lines);
    };
    assert!((before[0] - 18.6).abs() > 10.0, "{before:?}");
    let is_right = (x - 18.6).abs() < 2.5 && y.abs() < 2.5 && (z - 46.1).abs() < 2.5;
    assert!(is_right, "{x} {y} {z}");
}

/// A reading may still wait for its cycle while a self-test begins. It was then taken for a step of
/// the next configuration: in these four of 40 runs the AK8963's own field stayed on.
#[test]
fn a_self_test_ends_whenever_it_begins() {
    for seed in [12, 19, 29, 31] {
        let outcome = at_rest(Kit::Mpu9250, Part::Ak8963, "z-up", true)
            .seed(seed)
            .seconds(3.6)
            .command(1.5 + seed as f64 * 3.7e-3, "self-test")
            .command(3.4, "status")
            .run()
            .unwrap();
        let [[_, _, z]] = fields(&outcome)[..] else {
            panic!("a field: {:?}", outcome.uart_lines);
        };
        assert!((z - 46.1).abs() < 2.5, "{seed}: {z}");
    }
}

/// Without edges of the INT pin the reader checks the settings after every burst, which takes the
/// bus first. Readings come all the same.
#[test]
fn a_compass_goes_on_without_edges() {
    let no_edges = Schedule::parse("test", "1.5 60 int-missing").unwrap();
    for (kit, part) in [(Kit::Mpu9250, Part::Ak8963), (Kit::Gy87, Part::Hmc5883l)] {
        let outcome = at_rest(kit, part, "z-up", true)
            .seconds(3.2)
            .schedule(&no_edges)
            .command(3.0, "status")
            .run()
            .unwrap();
        let last = outcome.samples().last().expect("samples").snapshot.flags;
        assert!(last.contains(Flags::POLLED), "{part:?}: {last:?}");
        assert!(!last.contains(Flags::COMPASS_FAULT), "{part:?}: {last:?}");
        assert_eq!(
            fields(&outcome).len(),
            1,
            "{part:?} {:?}",
            outcome.uart_lines
        );
    }
}

/// `self-test` tests the compass too, where it has one. Readings come again afterwards.
#[test]
fn the_self_test_includes_the_compass() {
    for (kit, part, is_behind_imu, result) in [
        (Kit::Mpu9250, Part::Ak8963, true, "; compass passed: x "),
        (Kit::Mpu6050, Part::Hmc5883l, false, "; compass passed: x "),
        (
            Kit::Gy87,
            Part::Qmc5883l,
            true,
            "; a QMC5883L has no self-test",
        ),
    ] {
        let outcome = at_rest(kit, part, "+x-z", is_behind_imu)
            .seconds(6.0)
            .command(2.0, "self-test")
            .command(5.5, "status")
            .run()
            .unwrap();
        let lines = outcome.uart_lines.iter();
        let done = lines
            .map(|line| &line.text)
            .find(|text| text.contains(" self-test: "));
        assert!(outcome.uart_reports(result), "{part:?}: {done:?}");
        assert!(
            outcome.uart_reports("done self-test: "),
            "{part:?}: {done:?}"
        );
        let [[x, y, z]] = fields(&outcome)[..] else {
            panic!("a field: {:?}", outcome.uart_lines);
        };
        let is_right = (x - 18.6).abs() < 2.5 && y.abs() < 2.5 && (z - 46.1).abs() < 2.5;
        assert!(is_right, "{part:?}: {x} {y} {z}");
        assert_eq!(outcome.issues, Vec::<String>::new());
    }
}

#[test]
fn a_compass_that_is_not_the_named_one_is_reported() {
    let named = |kit: Kit, command: &str| {
        pooled_run()
            .kit(kit)
            .motion(Rest::level())
            .seconds(1.8)
            .command(0.8, command)
            .without_probe()
            .run()
            .unwrap()
    };
    let has_flag = |outcome: &Outcome| {
        let last = outcome.samples().last().unwrap();
        last.snapshot.flags.contains(Flags::COMPASS_FAULT)
    };
    let outcome = named(Kit::Gy87, "compass hmc5883l");
    let message = "compass: no HMC5883L answers, but a QMC5883L";
    assert!(outcome.uart_reports(message), "{:?}", outcome.uart_lines);
    assert!(has_flag(&outcome));
    let outcome = named(Kit::Mpu6050, "compass ak8963");
    let message = "compass: no AK8963 answers at 0x0c: check its wiring";
    assert!(outcome.uart_reports(message), "{:?}", outcome.uart_lines);
    assert!(has_flag(&outcome));
    // Nobody named one, and there is none: no fault.
    let outcome = named(Kit::Mpu6050, "compass auto");
    assert!(!has_flag(&outcome) && !outcome.uart_reports("compass: "));
    let outcome = named(Kit::Gy87, "compass off");
    assert!(!has_flag(&outcome));
}

/// Each burst of this sensor ends in 0xFF, as if it had released the bus. That loses a
/// burst only if the bus error was in that burst.
#[test]
fn a_bus_error_in_a_compass_read_costs_no_burst() {
    let mut chip = SensorErrors::none();
    chip.gyroscope.offset[2] = -1.0_f64.to_radians() / 16.4;
    chip.accelerometer.noise_density = SensorErrors::typical(1).accelerometer.noise_density;
    // At 400 kHz a byte takes 23 us. The times of the flags move through the sample's period.
    let flags = (0..600).map(|index| {
        format!(
            "{:.6} 0.00004 bus-error:flag\n",
            2.0 + 0.01303 * f64::from(index)
        )
    });
    let run = pooled_run()
        .kit(Kit::Gy87)
        .sensor_errors(chip)
        .motion(Rest::level());
    let schedule = Schedule::parse("flags", &flags.collect::<String>()).unwrap();
    let outcome = run.schedule(&schedule).seconds(10.0).run().unwrap();
    let ends_in_ff = |sample: &Sample| sample.burst.bytes.ends_with(&[0xFF; 2]);
    assert!(outcome.samples().iter().all(ends_in_ff));
    let steps = &outcome.record.steps_at_faults;
    let mut in_compass_reads = 0;
    for (fault, step) in outcome.faults.iter().zip(steps) {
        let from_ns = fault.start_ns;
        let edges = outcome.record.edges.iter().rev();
        let edge = edges
            .map(|edge| edge.time_ns)
            .find(|&time_ns| time_ns <= from_ns)
            .unwrap();
        // A burst has ended by then.
        if from_ns - edge < 450_000 || !matches!(step, BusStep::Read(_)) {
            continue;
        }
        in_compass_reads += 1;
        let soon = from_ns..from_ns + 3_000_000;
        let published = outcome
            .samples()
            .iter()
            .filter(|sample| soon.contains(&sample.published_ns));
        assert_eq!(published.count(), 3, "{from_ns} ns");
    }
    println!("{in_compass_reads} flags in reads of the compass");
    assert!(in_compass_reads >= 3);
}
