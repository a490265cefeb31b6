//! `aplomb convert`: a converted flight, replayed with the printed options, is the flight.

mod common;

use aplomb::attitude::{BodyVector, Vector3};
use aplomb::calibration::{AccelerometerCorrection, Mount, SymmetricMatrix};
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::units::{MagneticField, radians};
use aplomb_models::compass::Magnetism;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_recordings::flight_log::Recorder;
use aplomb_recordings::simulated::{errors, samples_with};
use aplomb_recordings::simulated_compass::{COMPASS_DELAY_US, SimulatedCompass};

use common::{aplomb, file, path};

const SEED: u64 = 77;
/// Age of a sample in the simulation, µs.
const SENSOR_DELAY_US: u32 = 1_900;

/// Writes the flight log of a simulated flight with a compass. The declination is the second one
/// from the middle of the flight on.
fn flight(test: &str, settings: &Settings, seconds: u64, declinations_deg: [f32; 2]) -> String {
    let mut recorder = Recorder::new(Vec::new(), Pipeline::new(settings), 0);
    let mut compass = SimulatedCompass::new(SEED, Magnetism::without_most_hard_iron(SEED));
    let errors = errors(SEED, AccelerometerKnowledge::Factory);
    let motion = Box::new(Quadrotor::by_seed(SEED));
    for (index, sample) in (0..).zip(samples_with(motion, SEED, errors, seconds)) {
        let is_later = index >= 500 * seconds;
        recorder.set_declination(radians(declinations_deg[usize::from(is_later)]));
        recorder.add(&sample.burst(), BoardFlags::empty()).unwrap();
        if let Some(field) = compass.read(sample.t_us, &sample.truth) {
            let [x, y, z] = field.map(|value| value as f32);
            let BodyVector(Vector3 { x, y, z }) = settings.mount().to_body(Vector3::new(x, y, z));
            let measured_us = sample.t_us as u32 - SENSOR_DELAY_US - COMPASS_DELAY_US;
            let field = MagneticField { ut: [x, y, z] };
            recorder
                .add_reading(field, measured_us, CompassKnowledge::HardIron)
                .unwrap();
        }
    }
    let log = file(test, "flight.log", recorder.into_inner());
    log.to_str().unwrap().to_owned()
}

fn run(arguments: &[&str]) -> String {
    let result = aplomb(arguments);
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(result.stdout).unwrap()
}

/// Returns the options that `convert` prints.
fn options(printed: &str) -> Vec<&str> {
    let mut lines = printed.lines();
    let options = lines.find_map(|line| line.strip_prefix("replay it with "));
    options.expect(printed).split(' ').collect()
}

/// Returns these columns of a table; an empty cell is NaN.
fn columns<const N: usize>(table: &str, names: [&str; N]) -> Vec<[f64; N]> {
    let text = std::fs::read_to_string(table).unwrap();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let places = names.map(|name| header.iter().position(|own| *own == name).expect(name));
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        places.map(|place| cells[place].parse().unwrap_or(f64::NAN))
    };
    lines.map(row).collect()
}

/// Returns the largest angles between two replays, degrees: of the tilt, and of the heading where
/// both know it. Counts the known headings.
fn differences(one: &str, other: &str) -> (f64, f64, usize) {
    let names = ["up_x", "up_y", "up_z", "heading_deg"];
    let (one, other) = (columns(one, names), columns(other, names));
    assert_eq!(one.len(), other.len());
    let (mut tilt_deg, mut heading_deg, mut known) = (0.0_f64, 0.0_f64, 0);
    for (one, other) in one.iter().zip(&other) {
        let square: f64 = (0..3).map(|axis| (one[axis] - other[axis]).powi(2)).sum();
        tilt_deg = tilt_deg.max(square.sqrt().to_degrees());
        let turned = (one[3] - other[3] + 180.0).rem_euclid(360.0) - 180.0;
        if !turned.is_nan() {
            heading_deg = heading_deg.max(turned.abs());
            known += 1;
        }
    }
    (tilt_deg, heading_deg, known)
}

fn settings(mount: &str) -> Settings {
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.mount = Mount::parse(mount).unwrap();
    settings
}

#[test]
fn a_converted_flight_replays_as_it_flew_with_exactly_the_printed_options() {
    let test = "printed-options";
    let log = flight(test, &settings("z-up"), 40, [3.5; 2]);
    let [flown, again] =
        ["flown.csv", "again.csv"].map(|name| path(test, name).to_str().unwrap().to_owned());
    let printed = run(&["replay", &log, "--output", &flown]);
    assert!(printed.contains(" 0 differ"), "{printed}");
    for name in ["flight.csv", "flight-bursts.csv"] {
        let converted = path(test, name);
        let converted = converted.to_str().unwrap();
        let printed = run(&["convert", &log, converted]);
        assert!(
            printed.contains("; the flight had no calibration\n"),
            "{printed}"
        );
        let replay = ["replay", converted, "--output", &again];
        run(&[&replay[..], &options(&printed)].concat());
        let (tilt_deg, heading_deg, known) = differences(&flown, &again);
        println!("{name}: tilt {tilt_deg}°, heading {heading_deg}° of {known}");
        assert!(tilt_deg < 0.01, "{name}: {tilt_deg}°");
        assert!(heading_deg < 0.05, "{name}: {heading_deg}°");
        assert_eq!(known > 30_000, name == "flight.csv", "{known} headings");
    }
}

#[test]
fn a_flight_that_was_calibrated_is_converted_without_and_says_so() {
    let test = "printed-calibration";
    let mut settings = settings("-y-z");
    settings.sensor_delay_us = Some(3_000);
    settings.calibration.accelerometer = Some(AccelerometerCorrection {
        offset_m_s2: Vector3::new(0.3, -0.2, 0.1),
        matrix: SymmetricMatrix {
            xx: 1.01,
            yy: 1.0,
            zz: 0.99,
            xy: 0.001,
            xz: 0.0,
            yz: 0.0,
        },
    });
    let log = flight(test, &settings, 4, [0.0; 2]);
    let csv = path(test, "flight.csv").to_str().unwrap().to_owned();
    let printed = run(&["convert", &log, &csv]);
    let expected = [
        "--mount",
        "-y-z",
        "--sensor-delay-us",
        "3000",
        "--accelerometer",
        "factory",
        "--compass",
        "hard-iron",
    ];
    assert_eq!(options(&printed)[..8], expected, "{printed}");
    for text in [
        "its values are the sensor's own; the flight's calibration is not in them: the \
         accelerometer\n",
        "--calibration FILE in place of --accelerometer, without a compass",
    ] {
        assert!(printed.contains(text), "{printed}");
    }
    let table = std::fs::read_to_string(&csv).unwrap();
    assert!(table.starts_with("# --accelerometer factory\nt_us,ax"));
}

#[test]
fn a_declination_that_changes_in_flight_is_reported() {
    let test = "printed-declination";
    let log = flight(test, &settings("z-up"), 4, [-1.25, 3.5]);
    let csv = path(test, "flight.csv").to_str().unwrap().to_owned();
    let printed = run(&["convert", &log, &csv]);
    assert!(
        options(&printed).ends_with(&["--declination", "3.5"]),
        "{printed}"
    );
    assert!(
        printed.contains("changed within the flight, from -1.25 to 3.5 degrees"),
        "{printed}"
    );
}
