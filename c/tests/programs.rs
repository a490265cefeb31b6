//! The programs in C: compiled by each compiler that is there, as C and as C++, and run.
#![cfg(unix)]

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{AccelerometerCounts, Burst, GyroscopeCounts, Part};
use aplomb::mpu6050::{RawSample, TemperatureCounts};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::bursts;

mod common;

use common::{SYSTEM, WARNINGS, library};

/// Returns whether this compiler can make an empty program with these options, as this file.
fn can_link(compiler: &str, options: &[&str], program: &Path) -> bool {
    let empty = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/c/empty.c");
    let mut command = Command::new(compiler);
    command.args(options).arg(empty).arg("-o").arg(program);
    command.output().is_ok_and(|output| output.status.success())
}

/// Compilers with their languages that are on this computer. `probe` is a file to write.
fn compilers(probe: &Path) -> Vec<(&'static str, &'static [&'static str])> {
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
    let (found, absent): (Vec<_>, Vec<_>) = all
        .into_iter()
        .partition(|(name, options)| can_link(name, options, probe));
    for (name, options) in absent {
        eprintln!("skipped: {name} {options:?}: the compiler or its sanitizer is not installed");
    }
    found
}

/// Compiles these sources with each compiler, and calls `run` for each program.
fn each_program(name: &str, sources: &[&str], run: impl Fn(&Path)) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = |suffix: &str| common::file(&format!("{name}-{suffix}"));
    for (index, (compiler, options)) in compilers(&file("probe")).into_iter().enumerate() {
        let program = file(&index.to_string());
        let mut command = Command::new(compiler);
        command.args(WARNINGS).args(options);
        for include in ["include", "examples"] {
            command.arg("-I").arg(folder.join(include));
        }
        command.args(sources.iter().map(|source| folder.join(source)));
        if options.contains(&"-x") {
            command.args(["-x", "none"]);
        }
        command.arg(library()).args(SYSTEM).arg("-o").arg(&program);
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

/// A program that was compiled with the header of another library does not link, and the linker
/// names the header's number.
#[test]
fn the_header_of_another_library_does_not_link() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let header = std::fs::read_to_string(folder.join("include/aplomb.h")).expect("it is there");
    let other = common::file("other");
    std::fs::create_dir_all(&other).expect("the folder can be written");
    let wrong = header.replace("aplomb_header_", "aplomb_header_f");
    std::fs::write(other.join("aplomb.h"), wrong).expect("the header can be written");
    let link = |include: &Path| {
        let mut gcc = Command::new("gcc");
        gcc.args(["-std=c99", "-I"]).arg(include);
        gcc.arg(folder.join("examples/host.c"));
        gcc.arg(library()).args(SYSTEM).arg("-o");
        gcc.arg(common::file("header")).output()
    };
    let (Ok(right), Ok(wrong)) = (link(&folder.join("include")), link(&other)) else {
        eprintln!("skipped: gcc is not installed");
        return;
    };
    let errors = String::from_utf8_lossy(&wrong.stderr);
    assert!(
        right.status.success() && !wrong.status.success(),
        "{errors}"
    );
    assert!(errors.contains("aplomb_header_f"), "{errors}");
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

/// Returns the table of these bursts.
fn table_of(bursts: &[Burst]) -> String {
    let mut table = format!("{}\n", bursts::HEADER);
    for (index, burst) in bursts.iter().enumerate() {
        let row = bursts::Row {
            burst: *burst,
            board: BoardFlags::empty(),
            is_armed: (1_500..3_500).contains(&index),
        };
        writeln!(table, "{row}").expect("memory");
    }
    table
}

#[test]
fn the_same_bursts_give_the_same_bits() {
    gives_the_same_bits(&table_of(&turning()));
}

/// `cargo xtask agree` flies these on the virtual board.
#[test]
fn bursts_of_flights_give_the_same_bits() {
    let flights = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("agree");
    for flight in ["simulated", "recorded"] {
        let path = flights.join(flight).join("bursts.csv");
        match std::fs::read_to_string(&path) {
            Ok(table) => gives_the_same_bits(&table),
            Err(_) => eprintln!("skipped: there is no {}", path.display()),
        }
    }
}

/// Holds the attitudes that the example prints for a table of bursts to those of the library.
fn gives_the_same_bits(table: &str) {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut expected = Vec::new();
    for line in table.lines().skip(1) {
        let row = bursts::decode(line).expect("a burst");
        pipeline.set_armed(row.is_armed);
        let snapshot = pipeline.update(&row.burst, row.board);
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
        let text = table.to_owned();
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

/// Returns the first block of this language on a page.
fn first_block(page: &str, language: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(page);
    let text = std::fs::read_to_string(&path).expect("the page is there");
    let (_, block) = text
        .split_once(&format!("```{language}\n"))
        .expect("it has a block");
    block
        .split_once("```")
        .expect("the block ends")
        .0
        .to_owned()
}

#[test]
fn the_page_shows_an_attitude_in_fifteen_lines() {
    let source = first_block("docs/c.md", "c");
    let lines = source.lines().filter(|line| !line.trim().is_empty());
    assert!(lines.count() <= 15, "{source}");
    let file = common::file("page.c");
    std::fs::write(&file, source).expect("the folder can be written");
    let Some(program) = common::program_of_gcc("page", file.to_str().expect("text")) else {
        return;
    };
    let output = Command::new(&program).output().expect("the program runs");
    let printed = String::from_utf8_lossy(&output.stdout);
    assert_eq!(printed, "roll 30.0 degrees\n");
}
