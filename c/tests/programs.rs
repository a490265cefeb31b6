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
#[path = "common/compilers.rs"]
mod compilers;

use common::{SYSTEM, WARNINGS, library};
use compilers::{Compiler, compilers};

/// Returns the compilers that are on this computer. `probe` is a file to write.
fn found_compilers(probe: &Path) -> Vec<Compiler> {
    let empty = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/c/empty.c");
    let (found, absent) = compilers(&empty, probe);
    for (name, options) in absent {
        eprintln!("skipped: {name} {options:?}: the compiler or its sanitizer is not installed");
    }
    found
}

/// Compiles these sources with each compiler, and calls `run` for each program.
fn each_program(name: &str, sources: &[&str], run: impl Fn(&Path)) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = |suffix: &str| common::file(&format!("{name}-{suffix}"));
    for (index, (compiler, options)) in found_compilers(&file("probe")).into_iter().enumerate() {
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

/// Returns the blocks of this language on a page.
fn blocks(page: &str, language: &str) -> Vec<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(page);
    let text = std::fs::read_to_string(&path).expect("the page is there");
    let fence = format!("```{language}\n");
    let starts = text.split(&fence).skip(1);
    let block = |start: &str| {
        start
            .split_once("```")
            .expect("the block ends")
            .0
            .to_owned()
    };
    starts.map(block).collect()
}

/// Compiles and runs a program of a page, and returns what it prints; `None` without a compiler.
fn output_of(name: &str, source: &str) -> Option<String> {
    let file = common::file(&format!("{name}.c"));
    std::fs::write(&file, source).expect("the folder can be written");
    let program = common::program_of_gcc(name, file.to_str().expect("text"))?;
    let output = Command::new(&program).output().expect("the program runs");
    assert!(output.status.success(), "{name}: {}", output.status);
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[test]
fn the_page_shows_an_attitude_in_fifteen_lines_and_a_heading() {
    let [attitude, heading] = &blocks("docs/c.md", "c")[..] else {
        panic!("another block has no test");
    };
    let lines = attitude.lines().filter(|line| !line.trim().is_empty());
    assert!(lines.count() <= 15, "{attitude}");
    if let Some(printed) = output_of("page", attitude) {
        assert_eq!(printed, "roll 30.0 degrees\n");
    }
    // The second block goes on with the sample and the snapshot of the first.
    let (_, sample) = attitude.split_once("    AplombSample").expect("a sample");
    let (sample, _) = sample.split_once('\n').expect("lines");
    let source = format!(
        "#include <stdio.h>\n#include \"aplomb.h\"\n\nint main(void) {{\n\
         AplombSample{sample}\nAplombSnapshot snapshot;\n{heading}\
         printf(\"roll %.1f degrees\\n\", snapshot.roll_rad * 57.29578f);\nreturn 0;\n}}\n"
    );
    if let Some(printed) = output_of("heading-page", &source) {
        assert_eq!(printed, "roll 30.0 degrees\n");
    }
}
