//! A corpus by seed: malformed recordings, damaged flight logs, and wrong arguments. Every command
//! ends in bounded time and memory, with a documented exit code and a readable message.

#![cfg(target_os = "linux")]

mod common;

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use aplomb_models::random::Random;
use common::{aplomb, file, path};

const RECORDINGS: u64 = 160;
const FLIGHT_LOGS: u64 = 120;
const ARGUMENT_LINES: u64 = 150;

/// Limits of a run: data in KiB, and seconds of processor time.
const LIMITS: &str = "ulimit -d 200000; ulimit -t 20";
/// Most bytes of a message: the longest lists the choices of an option.
const LONGEST_MESSAGE: usize = 3_000;

/// Runs the program within the limits, and checks how it ends.
fn check(arguments: &[String], context: &str) {
    let mut shell = Command::new("sh");
    let script = format!("{LIMITS}; exec \"$0\" \"$@\"");
    shell
        .args(["-c", &script])
        .arg(env!("CARGO_BIN_EXE_aplomb"));
    let result = shell
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .expect("there is a shell");
    let message = String::from_utf8_lossy(&result.stderr);
    let code = result.status.code();
    let place = format!("{context}: {arguments:?}: {code:?}: {message}");
    assert!(matches!(code, Some(0..=2)), "{place}");
    assert!(!message.contains("panicked"), "{place}");
    assert!(message.len() < LONGEST_MESSAGE, "{place}");
    assert!(code == Some(0) || !message.trim().is_empty(), "{place}");
    let is_plain = |c: char| !c.is_control() || c == '\n';
    assert!(message.chars().all(is_plain), "{place}");
}

fn text(path: &Path) -> String {
    path.to_str().expect("a name that is text").to_owned()
}

/// Returns a whole number below `end`.
fn below(random: &mut Random, end: usize) -> usize {
    random.uniform(0.0, end as f64) as usize
}

fn one_of<T: Copy>(random: &mut Random, choices: &[T]) -> T {
    choices[below(random, choices.len())]
}

/// Returns a good log of a second at 100 Hz.
fn good_log() -> String {
    let mut log = String::from("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov\n");
    for index in 0..100 {
        let rate = 0.01 * f64::from(index % 7);
        let time_us = index * 10_000;
        writeln!(log, "{time_us},0.1,{rate},9.8,{rate},0.02,-0.01,1,0,0,0,1").expect("memory");
    }
    log
}

/// Returns a cell that a logger's fault or an adversary leaves.
fn bad_cell(random: &mut Random) -> String {
    const CELLS: [&str; 22] = [
        "",
        " ",
        "nan",
        "NaN",
        "inf",
        "-inf",
        "1e999",
        "-1e-999",
        "0x10",
        "1,2",
        "--1",
        "1.2.3",
        "é",
        "\u{0}",
        "\u{1b}[2J",
        "9223372036854775807",
        "-9223372036854775808",
        "1e30",
        "1e-30",
        "\"1\"",
        "true",
        "\u{202e}1",
    ];
    match below(random, 10) {
        0 => "9".repeat(1 + below(random, 20_000)),
        1 => format!("{}", random.normal() * 1e6),
        _ => one_of(random, &CELLS).to_owned(),
    }
}

/// Returns a malformed recording.
fn recording(random: &mut Random) -> Vec<u8> {
    let mut lines: Vec<String> = good_log().lines().map(str::to_owned).collect();
    for _ in 0..=below(random, 4) {
        let place = below(random, lines.len());
        match below(random, 9) {
            0 => lines.truncate(place),
            1 => lines[place] = bad_cell(random),
            2 => lines.insert(place, lines[place].clone()),
            3 => {
                let other = below(random, lines.len());
                lines.swap(place, other);
            }
            4 => {
                lines[0] = one_of(
                    random,
                    &[
                        "t_us,ax,ay,az,gx,gy,gz",
                        "t_us,bytes,flags",
                        "t_us,qw,qx,qy,qz,flags",
                        "t_us,roll_deg,pitch_deg,yaw_deg",
                        "# comment",
                        "t_us",
                        "",
                    ],
                )
                .to_owned();
            }
            5 => {
                let scale = one_of(random, &[1e-3, 1e3, 57.3, 0.102, 16_384.0, -1.0, 0.0]);
                for line in &mut lines[1..] {
                    let cells = line.split(',').map(|cell| match cell.parse::<f64>() {
                        Ok(value) => format!("{}", value * scale),
                        Err(_) => cell.to_owned(),
                    });
                    *line = cells.collect::<Vec<_>>().join(",");
                }
            }
            _ => {
                let mut cells: Vec<String> = lines[place].split(',').map(str::to_owned).collect();
                let cell = below(random, cells.len());
                cells[cell] = bad_cell(random);
                lines[place] = cells.join(",");
            }
        }
        if lines.is_empty() {
            lines.push(String::new());
        }
    }
    let end = one_of(random, &["\n", "\r\n", "\n\n", "\r"]);
    damage(random, lines.join(end).into_bytes())
}

/// Zips bytes, cuts them off, or changes some, now and then.
fn damage(random: &mut Random, mut bytes: Vec<u8>) -> Vec<u8> {
    if below(random, 4) == 0 {
        let mut zipped = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        zipped.write_all(&bytes).expect("memory");
        bytes = zipped.finish().expect("memory");
    }
    if below(random, 3) == 0 {
        for _ in 0..=below(random, 8) {
            if !bytes.is_empty() {
                let place = below(random, bytes.len());
                bytes[place] = below(random, 256) as u8;
            }
        }
    }
    if below(random, 4) == 0 {
        bytes.truncate(below(random, bytes.len() + 1));
    }
    bytes
}

/// Runs every command that reads a recording on this file.
fn read_by_all(folder: &str, input: &Path, context: &str) {
    let input = text(input);
    let output = |name: &str| text(&path(folder, name));
    for arguments in [
        vec!["replay", &input],
        vec!["replay", &input, "--json", "--bad-rows", "skip"],
        vec!["calibrate", &input],
        vec!["plot", &input, "--output", &output("plot.svg")],
        vec!["convert", &input, &output("out.log")],
        vec!["convert", &input, &output("out-bursts.csv")],
    ] {
        let arguments: Vec<String> = arguments.into_iter().map(str::to_owned).collect();
        check(&arguments, context);
    }
}

#[test]
fn malformed_recordings_are_read_or_refused() {
    for seed in 0..RECORDINGS {
        let mut random = Random::new(seed, "recordings");
        let input = file("corpus-recordings", "input.csv", recording(&mut random));
        read_by_all("corpus-recordings", &input, &format!("seed {seed}"));
    }
}

#[test]
fn damaged_flight_logs_are_read_or_refused() {
    let good = path("corpus-logs", "good.log");
    let csv = path("corpus-logs", "good.csv");
    for arguments in [
        vec![
            "simulate",
            "--seconds",
            "2",
            "--output",
            csv.to_str().unwrap(),
        ],
        vec!["convert", csv.to_str().unwrap(), good.to_str().unwrap()],
    ] {
        assert!(aplomb(&arguments).status.success());
    }
    let good = std::fs::read(good).expect("it was written");
    for seed in 0..FLIGHT_LOGS {
        let mut random = Random::new(seed, "flight logs");
        let mut bytes = good.clone();
        for _ in 0..=below(&mut random, 5) {
            let place = below(&mut random, bytes.len());
            let end = (place + below(&mut random, 3_000)).min(bytes.len());
            match below(&mut random, 5) {
                0 => drop(bytes.drain(place..end)),
                1 => bytes[place..end].fill(one_of(&mut random, &[0, 1, 0xFF, b'\n'])),
                2 => bytes
                    .splice(place..place, good[..good.len() / 2].to_vec())
                    .for_each(drop),
                3 => bytes[place..end].reverse(),
                _ => bytes.truncate(place.max(10)),
            }
        }
        let input = file("corpus-logs", "input.log", damage(&mut random, bytes));
        read_by_all("corpus-logs", &input, &format!("seed {seed}"));
    }
}

#[test]
fn wrong_argument_lines_end_with_a_message() {
    const WORDS: [&str; 44] = [
        "replay",
        "plot",
        "convert",
        "calibrate",
        "simulate",
        "completions",
        "help",
        "--help",
        "-h",
        "--version",
        "--output",
        "--filter",
        "kalman",
        "vqf",
        "--mount",
        "+x-z",
        "-x",
        "--mount=",
        "--sensor-delay-us",
        "-1",
        "99999999999",
        "1e9",
        "--raw",
        "--accel-range",
        "3",
        "16",
        "--gyro-range",
        "2000",
        "--flight",
        "0",
        "--json",
        "--seconds",
        "--seed",
        "--kind",
        "rest",
        "--time-unit",
        "h",
        "--bad-rows",
        "perhaps",
        "/no/such",
        "",
        "é\u{202e}",
        "bash",
        "--truth",
    ];
    let folder = path("corpus-arguments", "");
    for seed in 0..ARGUMENT_LINES {
        let mut random = Random::new(seed, "arguments");
        // Without `view` and `record`, which wait for a module.
        let count = 1 + below(&mut random, 6);
        let words = (0..count).map(|_| one_of(&mut random, &WORDS).to_owned());
        let mut arguments: Vec<String> = words.collect();
        // No run of minutes, and no file outside the folder.
        if arguments[0] == "simulate" {
            arguments.extend(["--seconds".to_owned(), "1".to_owned()]);
        }
        for index in 1..arguments.len() {
            if arguments[index - 1] == "--output" {
                arguments[index] = text(&folder.join("output.csv"));
            }
        }
        check(&arguments, &format!("seed {seed}"));
    }
}
