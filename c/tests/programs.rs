//! The programs in C: compiled by each compiler that is there, as C and as C++, and run.
#![cfg(unix)]

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{AccelerometerCounts, Burst, GyroscopeCounts, Part};
use aplomb::mpu6050::{RawSample, TemperatureCounts};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::bursts;

/// Warnings of every compiler, all of them errors.
const WARNINGS: [&str; 5] = ["-Wall", "-Wextra", "-pedantic", "-Werror", "-O1"];

/// Returns the static library that this test was built with.
fn library() -> PathBuf {
    let folder = std::env::current_exe().expect("a test has a path");
    let folder = folder.parent().expect("a test is in a folder");
    let files = std::fs::read_dir(folder).expect("the folder can be read");
    let is_library = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("libaplomb_c") && name.ends_with(".a")
    };
    let libraries = files.flatten().map(|entry| entry.path()).filter(is_library);
    let newest = libraries.max_by_key(|path| path.metadata().and_then(|data| data.modified()).ok());
    newest.expect("cargo builds the static library with the test")
}

/// Compilers with their languages that are on this computer.
fn compilers() -> Vec<(&'static str, &'static [&'static str])> {
    let all: [(&str, &[&str]); 6] = [
        ("gcc", &["-std=c99"]),
        (
            "gcc",
            &[
                "-std=c99",
                "-fsanitize=address,undefined",
                "-fno-sanitize-recover",
            ],
        ),
        (
            "g++",
            &["-x", "c++", "-std=c++11", "-Wno-missing-field-initializers"],
        ),
        ("clang", &["-std=c99"]),
        (
            "clang",
            &[
                "-std=c99",
                "-fsanitize=address,undefined",
                "-fno-sanitize-recover",
            ],
        ),
        (
            "clang++",
            &["-x", "c++", "-std=c++11", "-Wno-missing-field-initializers"],
        ),
    ];
    let is_there = |name: &str| {
        let version = Command::new(name).arg("--version").output();
        version.is_ok_and(|output| output.status.success())
    };
    let (found, absent): (Vec<_>, Vec<_>) = all.into_iter().partition(|(name, _)| is_there(name));
    for (name, options) in absent {
        eprintln!("skipped: {name} {options:?}: the compiler is not installed");
    }
    found
}

/// Compiles these sources with each compiler, and calls `run` for each program.
fn each_program(name: &str, sources: &[&str], run: impl Fn(&Path)) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (index, (compiler, options)) in compilers().into_iter().enumerate() {
        let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{index}"));
        let mut command = Command::new(compiler);
        command.args(WARNINGS).args(options);
        for include in ["include", "examples"] {
            command.arg("-I").arg(folder.join(include));
        }
        command.args(sources.iter().map(|source| folder.join(source)));
        if options.contains(&"-x") {
            command.args(["-x", "none"]);
        }
        command
            .arg(library())
            .args(["-lpthread", "-ldl", "-lm", "-o"])
            .arg(&program);
        let output = command.output().expect("the compiler runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{compiler} {options:?}: {errors}");
        run(&program);
    }
}

fn passes(program: &Path) {
    let output = Command::new(program).output().expect("the program runs");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {errors}", program.display());
}

#[test]
fn the_boundary_holds() {
    each_program("boundary", &["tests/c/boundary.c"], passes);
}

#[test]
fn the_examples_for_firmware_run() {
    let sources = [
        "tests/c/parts.c",
        "examples/cube_loop.c",
        "examples/scheduler_task.c",
    ];
    each_program("parts", &sources, passes);
}

/// Returns bursts of five seconds: rest, then turns about all axes, with lost samples.
fn turning() -> Vec<Burst> {
    let burst = |index: u64| {
        let time_s = index as f32 * 1e-3;
        let swing = |rad_s: f32| {
            if index < 1_500 {
                0.0
            } else {
                (rad_s * time_s).sin()
            }
        };
        let noise = (index * 7_919 % 13) as i16;
        let raw = RawSample {
            accelerometer: AccelerometerCounts([
                (400.0 * swing(3.0)) as i16 + noise,
                (500.0 * swing(2.0)) as i16,
                2_048 - noise,
            ]),
            temperature: TemperatureCounts(-3_920),
            gyroscope: GyroscopeCounts([
                (3_000.0 * swing(5.0)) as i16,
                (2_000.0 * swing(4.0)) as i16 + noise,
                (900.0 * swing(1.0)) as i16 - 20,
            ]),
        };
        Burst {
            bytes: raw.encode(),
            captured_at_us: 1_000 * index + index % 5,
            missed_before: u8::from(index.is_multiple_of(997)),
        }
    };
    (1..5_000).map(burst).collect()
}

#[test]
fn the_same_bursts_give_the_same_bits() {
    let mut table = format!("{}\n", bursts::HEADER);
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut expected = Vec::new();
    for burst in turning() {
        let line = bursts::Line(&burst, BoardFlags::empty());
        writeln!(table, "{line}").expect("memory");
        let snapshot = pipeline.update(&burst, BoardFlags::empty());
        let q = snapshot.attitude;
        let bits = [q.w, q.x, q.y, q.z].map(f32::to_bits);
        expected.push((snapshot.t_us, bits, snapshot.flags.bits()));
    }
    each_program("host", &["examples/host.c"], |program| {
        let mut child = Command::new(program)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program runs");
        let mut input = child.stdin.take().expect("it is piped");
        let text = table.clone();
        let writer = std::thread::spawn(move || input.write_all(text.as_bytes()));
        let output = child.wait_with_output().expect("the program ends");
        writer.join().expect("no panic").expect("all is read");
        let printed = String::from_utf8(output.stdout).expect("text");
        assert_eq!(printed.lines().count(), expected.len());
        for (line, (t_us, bits, flags)) in printed.lines().zip(&expected) {
            let cells: Vec<&str> = line.split(' ').collect();
            let found: Vec<u32> = cells[1..5]
                .iter()
                .map(|cell| cell.parse::<f32>().expect("a number").to_bits())
                .collect();
            assert_eq!(cells[0], t_us.to_string(), "{line}");
            assert_eq!(found, bits, "{line}");
            assert_eq!(cells[5], flags.to_string(), "{line}");
        }
    });
}
