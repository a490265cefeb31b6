//! Tests that the pipeline under RTIC in QEMU agrees with the library on the host, bit for bit.
//!
//! `cargo xtask test` builds the application and names it in `APLOMB_QEMU_ELF`; without that
//! variable the tests report that they are skipped.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use aplomb::health::BoardFlags;
use aplomb::mpu6050::{BURST_LENGTH, Burst, Part, RawSample};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::telemetry::bursts::{self, Row};
use aplomb::telemetry::text;

#[path = "../../xtask/src/limit.rs"]
mod limit;

/// Longest run in QEMU, far beyond that of a whole recorded trial.
const LIMIT: Duration = Duration::from_secs(600);

/// Samples for one line of text, as in `rigs/src/bin/qemu.rs`.
const SAMPLES_PER_LINE: usize = 20;

#[test]
fn qemu_agrees_with_the_host_on_bursts_of_every_kind() {
    let Some(elf) = application() else { return };
    let bursts = bursts_of_every_kind();
    let folder = folder("every-kind");
    let run = run(&elf, &folder, &csv(&bursts));
    assert!(run.succeeded, "QEMU failed: {}", run.errors);
    agree(&run, &bursts);
}

/// Replays bursts of the virtual board's bus: a simulated flight and, if recordings are at hand, a
/// whole recorded trial.
#[test]
fn qemu_agrees_with_the_host_on_whole_flights() {
    let Some(elf) = application() else { return };
    let Some(paths) = std::env::var_os("APLOMB_BURSTS") else {
        println!("skipped: APLOMB_BURSTS names no bursts.csv");
        return;
    };
    for (index, path) in std::env::split_paths(&paths).enumerate() {
        let contents = std::fs::read_to_string(&path).expect("APLOMB_BURSTS can be read");
        let bursts: Vec<Row> = contents
            .lines()
            .skip(1)
            .map(|line| bursts::decode(line).expect("bursts.csv holds bursts"))
            .collect();
        assert!(
            bursts.len() > 1_000,
            "a flight has more than {} bursts",
            bursts.len()
        );
        let folder = folder(&format!("flight-{index}"));
        let run = run(&elf, &folder, &contents);
        assert!(run.succeeded, "QEMU failed: {}", run.errors);
        agree(&run, &bursts);
        println!("{}: {} bursts agree", path.display(), bursts.len());
    }
}

#[test]
fn qemu_reports_the_line_of_an_invalid_burst() {
    let Some(elf) = application() else { return };
    let mut contents = csv(&bursts_of_every_kind()[..3]);
    contents.push_str("4000,00,\n");
    let run = run(&elf, &folder("malformed"), &contents);
    assert!(!run.succeeded);
    assert!(run.errors.contains("line 5"), "{}", run.errors);
}

fn application() -> Option<PathBuf> {
    let elf = std::env::var_os("APLOMB_QEMU_ELF");
    if elf.is_none() {
        println!("skipped: APLOMB_QEMU_ELF is not set; `cargo xtask test` sets it");
    }
    elf.map(PathBuf::from)
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("qemu")
        .join(name);
    std::fs::create_dir_all(&folder).expect("the target folder can be written");
    folder
}

/// Returns bursts with rest, motion, saturation, lost samples, gaps, times that repeat or go back,
/// noise, all flags of a board, and a filter that is armed for a while.
fn bursts_of_every_kind() -> Vec<Row> {
    let mut random = 0x2545_F491_4F6C_DD1D_u64;
    let mut next = move || {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random
    };
    let mut time_us = 1_000_u64;
    (0..4_000_u32)
        .map(|index| {
            let noise = (next() % 9) as i16 - 4;
            let phase = f64::from(index) / 150.0;
            let moving = index > 1_200;
            let swing = |amplitude: f64, offset: f64| {
                if moving {
                    (amplitude * (phase + offset).sin()) as i16
                } else {
                    0
                }
            };
            let counts = match index {
                2_000..2_010 => [i16::MAX, i16::MIN, 5, 0, i16::MAX, i16::MIN, 9],
                2_500..2_520 => [0; 7],
                3_000..3_050 => core::array::from_fn(|_| next() as i16),
                _ => [
                    swing(700.0, 0.3) + noise,
                    swing(500.0, 1.7) - noise,
                    2_048 + noise,
                    -480,
                    swing(900.0, 0.0) + 21 + noise,
                    swing(1_100.0, 2.0) - 13,
                    swing(300.0, 4.0) + noise,
                ],
            };
            time_us = match index {
                1_500 => time_us + 700_000,
                1_600 => time_us,
                1_700 => time_us - 5_000,
                _ => time_us + 998 + next() % 5,
            };
            let mut bytes = [0; BURST_LENGTH];
            for (pair, count) in bytes.chunks_exact_mut(2).zip(counts) {
                pair.copy_from_slice(&count.to_be_bytes());
            }
            assert_eq!(RawSample::decode(&bytes).encode(), bytes);
            let burst = Burst {
                bytes,
                captured_at_us: time_us,
                missed_before: u8::from(index % 500 == 499),
            };
            let board = match index {
                1_800 => BoardFlags::all().difference(BoardFlags::SCALES_VERIFIED),
                2_800 => BoardFlags::SENSOR_RESET,
                3_500..3_600 => BoardFlags::POLLED,
                _ => BoardFlags::empty(),
            };
            Row {
                burst,
                board,
                is_armed: (1_100..3_700).contains(&index),
            }
        })
        .collect()
}

fn csv(bursts: &[Row]) -> String {
    let mut contents = format!("{}\n", bursts::HEADER);
    for row in bursts {
        writeln!(contents, "{row}").expect("a string takes everything");
    }
    contents
}

struct Run {
    succeeded: bool,
    errors: String,
    snapshots: String,
    text: String,
}

fn run(elf: &Path, folder: &Path, contents: &str) -> Run {
    let [input, output, text] =
        ["bursts.csv", "snapshots.csv", "uart.log"].map(|name| folder.join(name));
    std::fs::write(&input, contents).expect("the target folder can be written");
    for old in [&output, &text] {
        let _ = std::fs::remove_file(old);
    }
    let mut qemu = Command::new("qemu-system-arm");
    qemu.args([
        "-M",
        "netduinoplus2",
        "-display",
        "none",
        "-monitor",
        "none",
    ])
    .args(["-icount", "shift=0,sleep=off"])
    .arg("-kernel")
    .arg(elf)
    .arg("-serial")
    .arg(format!("file:{}", text.display()))
    .arg("-semihosting-config")
    .arg(format!(
        "enable=on,target=native,arg=qemu,arg={},arg={}",
        input.display(),
        output.display()
    ));
    let what = format!("{} in QEMU, with {}", elf.display(), input.display());
    let result = limit::output_within(LIMIT, &what, &mut qemu).expect("QEMU ends");
    Run {
        succeeded: result.status.success(),
        errors: String::from_utf8_lossy(&result.stderr).into_owned(),
        snapshots: std::fs::read_to_string(output).unwrap_or_default(),
        text: std::fs::read_to_string(text).unwrap_or_default(),
    }
}

/// Compares QEMU's output with the library on this computer.
fn agree(run: &Run, bursts: &[Row]) {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let expected: Vec<Snapshot> = bursts
        .iter()
        .map(|row| {
            pipeline.set_armed(row.is_armed);
            pipeline.update(&row.burst, row.board)
        })
        .collect();
    let lines: Vec<&str> = run.snapshots.lines().collect();
    assert_eq!(lines.len(), expected.len(), "one snapshot for every burst");
    for (number, (line, snapshot)) in lines.iter().zip(&expected).enumerate() {
        assert_eq!(*line, bits(snapshot), "snapshot {number}");
    }
    // The last line may still have been in the port when QEMU ended.
    let mut buffer = [0; text::LINE_LENGTH];
    let mut texts = String::new();
    for snapshot in expected
        .iter()
        .skip(SAMPLES_PER_LINE - 1)
        .step_by(SAMPLES_PER_LINE)
    {
        let line = text::encode(snapshot, &mut buffer);
        texts.push_str(std::str::from_utf8(line).expect("the text is ASCII"));
    }
    assert!(run.text.lines().count() + 2 >= texts.lines().count());
    assert!(texts.starts_with(&run.text), "the text on the UART differs");
}

fn bits(snapshot: &Snapshot) -> String {
    let (attitude, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
    let mut line = snapshot.t_us.to_string();
    for number in [
        attitude.w, attitude.x, attitude.y, attitude.z, rates.x, rates.y, rates.z,
    ] {
        write!(line, ",{:08x}", number.to_bits()).expect("a string takes everything");
    }
    write!(line, ",{:08x}", snapshot.flags.bits()).expect("a string takes everything");
    line
}
