//! The C library gives the bits of `aplomb replay`, with and without a compass: on a simulated
//! flight, and on the recordings beside the project where they are there.
#![cfg(unix)]

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use aplomb::units::{degrees, radians};
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_recordings::at_hand;
use aplomb_recordings::log::Log;
use aplomb_recordings::motion::truth_of;
use aplomb_recordings::plateau::Plateaus;
use aplomb_recordings::rate::{ROWS_AHEAD, sample_rate_divider, unsigned};
use aplomb_recordings::simulated::{CONFIG, MOUNT, samples};

mod common;

/// Options of the program `aplomb`, which the C program gets as arguments.
const DELAY_US: u32 = 4_000;
const COMPASS_DELAY_US: u32 = 10_000;
const DECLINATION_DEG: f32 = 3.5;

/// Values of `AplombCompassKnowledge` and their names for the program `aplomb`.
const KNOWLEDGE: [(&str, &str); 2] = [("1", "factory"), ("2", "calibrated")];

/// Builds the program `aplomb`, with the features of all tests: otherwise its dependencies would be
/// built twice.
fn program() -> PathBuf {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args([
        "build",
        "--quiet",
        "--release",
        "--ignore-rust-version",
        "--workspace",
        "--bin",
        "aplomb",
        "--test",
        "qemu",
    ]);
    let status = cargo.status().expect("cargo runs");
    assert!(status.success(), "the program builds");
    let test = std::env::current_exe().expect("a test has a path");
    let target = test
        .ancestors()
        .nth(3)
        .expect("a test is in target/release/deps");
    target.join("release/aplomb")
}

/// Attitude at one row, as bits: time, quaternion, flags, and heading, σ and offset in degrees.
#[derive(Debug, PartialEq)]
struct Point {
    t_us: u64,
    quaternion: [u32; 4],
    flags: String,
    heading_deg: Option<[u32; 3]>,
}

/// Returns the attitudes of the program `aplomb`.
fn expected(program: &Path, log: &Path, knowledge: Option<&str>) -> Vec<Point> {
    let mut replay = Command::new(program);
    replay.arg("replay").arg(log).args(["--output", "-"]);
    replay.args(["--sensor-delay-us", &DELAY_US.to_string()]);
    if let Some(knowledge) = knowledge {
        replay.args(["--compass", knowledge]);
        replay.args(["--compass-delay-us", &COMPASS_DELAY_US.to_string()]);
        replay.args(["--declination", &DECLINATION_DEG.to_string()]);
    }
    let output = replay.output().expect("the program runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {errors}", log.display());
    let table = String::from_utf8(output.stdout).expect("text");
    let (header, rows) = table.split_once('\n').expect("a header");
    let columns: Vec<&str> = header.split(',').collect();
    let place = |name| columns.iter().position(|column| *column == name);
    let places = [
        "t_us",
        "qw",
        "qx",
        "qy",
        "qz",
        "flags",
        "heading_deg",
        "heading_sigma_deg",
        "yaw_offset_deg",
    ]
    .map(|name| place(name).expect("the column is there"));
    let point = |row: &str| {
        let cells: Vec<&str> = row.split(',').collect();
        let [t_us, w, x, y, z, flags, heading, sigma, offset] = places.map(|place| cells[place]);
        Point {
            t_us: unsigned(t_us.parse().expect("a time")),
            quaternion: [w, x, y, z].map(bits),
            flags: flags.to_owned(),
            heading_deg: (!heading.is_empty()).then(|| [heading, sigma, offset].map(bits)),
        }
    };
    rows.lines().map(point).collect()
}

fn bits(cell: &str) -> u32 {
    cell.parse::<f32>().expect("a number").to_bits()
}

/// Returns the recording as lines for the C program, and the divider of its sample rate.
fn table(log: &Log) -> (String, u8) {
    let (mut text, mut plateaus) = (String::new(), Plateaus::default());
    for row in log.rows() {
        let clipped = plateaus.check(row.specific_force_m_s2, row.rates_rad_s);
        let values = row.specific_force_m_s2.into_iter().chain(row.rates_rad_s);
        write!(text, "{}", unsigned(row.time_us)).expect("memory");
        for value in values {
            write!(text, " {}", value as f32).expect("memory");
        }
        let clipped = [clipped.force, clipped.rate].map(u8::from);
        write!(text, " {} {}", clipped[0], clipped[1]).expect("memory");
        if let Some([x, y, z]) = row.field_ut {
            let [x, y, z] = [x, y, z].map(|value| value as f32);
            write!(text, " {x} {y} {z} {COMPASS_DELAY_US}").expect("memory");
        }
        text.push('\n');
    }
    let ahead = log.rows().iter().take(ROWS_AHEAD);
    let times_us: Vec<i64> = ahead.map(|row| row.time_us).collect();
    (text, sample_rate_divider(&times_us))
}

/// Returns the attitudes of the C program.
fn found(program: &Path, log: &Log, knowledge: Option<&str>) -> Vec<Point> {
    let (table, divider) = table(log);
    let mut command = Command::new(program);
    command.args([divider.to_string(), DELAY_US.to_string()]);
    if let Some(knowledge) = knowledge {
        command.args([knowledge, &radians(DECLINATION_DEG).to_string()]);
    }
    command.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().expect("the program runs");
    let mut input = child.stdin.take().expect("it is piped");
    let writer = std::thread::spawn(move || input.write_all(table.as_bytes()));
    let output = child.wait_with_output().expect("the program ends");
    writer.join().expect("no panic").expect("all is read");
    assert!(output.status.success());
    let printed = String::from_utf8(output.stdout).expect("text");
    let point = |line: &str| {
        let cells: Vec<&str> = line.split(' ').collect();
        let angle = |index: usize| cells[index].parse::<f32>().expect("a number");
        let flags = cells[5].parse().expect("flags");
        Point {
            t_us: cells[0].parse().expect("a time"),
            quaternion: [1, 2, 3, 4].map(|index| bits(cells[index])),
            flags: aplomb::health::Flags::from_bits_retain(flags).to_string(),
            heading_deg: angle(7)
                .is_finite()
                .then(|| [6, 7, 8].map(|index| degrees(angle(index)).to_bits())),
        }
    };
    printed.lines().map(point).collect()
}

/// Compares the C program with `aplomb replay` on a recording. Returns the rows with a heading.
fn compare(ours: &Path, program: &Path, path: &Path, log: &Log) -> usize {
    let has_compass = log.rows().iter().any(|row| row.field_ut.is_some());
    let kinds = if has_compass { &KNOWLEDGE[..] } else { &[] };
    let all = kinds.iter().map(|kind| Some(*kind)).chain([None]);
    let mut headings = 0;
    for kind in all.filter(|kind| kind.is_some() || !has_compass) {
        let found = found(ours, log, kind.map(|(value, _)| value));
        let expected = expected(program, path, kind.map(|(_, name)| name));
        assert_eq!(found.len(), expected.len(), "{}", path.display());
        for (found, expected) in found.iter().zip(&expected) {
            assert_eq!(found, expected, "{}", path.display());
        }
        headings += found
            .iter()
            .filter(|point| point.heading_deg.is_some())
            .count();
    }
    headings
}

/// Writes a simulated flight with a compass, which has a hard iron and 100 readings a second.
fn simulated() -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("flight-with-compass.csv");
    let mut text = "t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n".to_owned();
    for (index, sample) in samples(Box::new(Quadrotor::by_seed(3)), 3, 20).enumerate() {
        let force = sample.raw.accelerometer.to_m_s2(CONFIG.accelerometer_range);
        let rates = sample.raw.gyroscope.to_rad_s(CONFIG.gyroscope_range);
        write!(text, "{},{},{},{}", sample.t_us, force.x, force.y, force.z).expect("memory");
        write!(text, ",{},{},{}", rates.x, rates.y, rates.z).expect("memory");
        match sample.truth.attitude.filter(|_| index % 10 == 0) {
            Some(attitude) => {
                let to_earth = truth_of(attitude, MOUNT);
                let [x, y, z] = to_earth.conjugate().rotate([0.0, 20.0, -45.0]);
                writeln!(text, ",{},{},{}", x + 12.5, y - 30.0, z + 7.0).expect("memory");
            }
            None => text.push_str(",,,\n"),
        }
    }
    std::fs::write(&path, text).expect("the flight can be written");
    path
}

/// Returns all recordings beside the project.
fn recordings() -> Vec<PathBuf> {
    let folder = at_hand::folder();
    let Ok(sets) = std::fs::read_dir(&folder) else {
        eprintln!("skipped: there is no {}", folder.display());
        return Vec::new();
    };
    let sets = sets
        .flatten()
        .filter_map(|set| std::fs::read_dir(set.path()).ok());
    let mut files: Vec<PathBuf> = sets.flatten().flatten().map(|file| file.path()).collect();
    files.sort();
    files
}

#[test]
fn a_flight_gives_the_bits_of_replay() {
    let Some(ours) = common::program_of_gcc("samples", "tests/c/samples.c") else {
        return;
    };
    let path = simulated();
    let log = Log::read(&path).expect("it is a log");
    let headings = compare(&ours, &program(), &path, &log);
    assert!(headings > 10_000, "{headings} rows have a heading");
}

#[test]
fn every_recording_at_hand_gives_the_bits_of_replay() {
    let Some(ours) = common::program_of_gcc("recordings", "tests/c/samples.c") else {
        return;
    };
    let program = program();
    let (mut compared, mut headings) = (0, 0);
    let files = recordings();
    for path in &files {
        // Counts, and tables of another kind, are refused.
        if let Ok(log) = Log::read(path) {
            headings += compare(&ours, &program, path, &log);
            compared += 1;
        }
    }
    eprintln!("{compared} recordings, {headings} headings");
    assert!(files.is_empty() || (compared > 0 && headings > 0));
}
