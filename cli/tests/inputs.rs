//! Inputs that are no recording, or one in other units: every program that reads logs names the
//! fault and the option that helps, in bounded memory and time.

mod common;

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use common::{aplomb, file, path};

/// Most memory of a refusal, KiB. The program and its libraries take a few thousand.
#[cfg(target_os = "linux")]
const MOST_MEMORY_KIB: u64 = 64 * 1024;

/// Commands that read a log, with what follows the input.
fn readers(test: &str) -> Vec<(&'static str, Vec<String>)> {
    let output = |name: &str| path(test, name).to_str().unwrap().to_owned();
    vec![
        ("replay", vec![]),
        ("calibrate", vec![]),
        ("plot", vec!["--output".to_owned(), output("plot.svg")]),
        ("convert", vec![output("out.log")]),
    ]
}

/// Returns the message of a command that has to fail.
fn refusal(command: &str, input: &Path, more: &[String]) -> String {
    ended_with(1, command, input, more)
}

/// Returns the message of a command that ends with this code.
fn ended_with(code: i32, command: &str, input: &Path, more: &[String]) -> String {
    let mut arguments = vec![command.to_owned(), input.to_str().unwrap().to_owned()];
    arguments.extend_from_slice(more);
    let result = aplomb(&arguments);
    assert_eq!(result.status.code(), Some(code), "{arguments:?}");
    String::from_utf8(result.stderr).unwrap()
}

/// Returns 20 s at 100 Hz of a sensor that rests, then turns.
fn turned(time: f64, force: f64, rate: f64) -> String {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    for index in 0..2_000_u32 {
        let now_s = f64::from(index) * 0.01;
        let angle = (now_s - 5.0).max(0.0);
        let turn = if now_s > 5.0 { rate } else { 0.0 };
        let (y, z) = (9.81 * angle.sin() * force, 9.81 * angle.cos() * force);
        writeln!(
            text,
            "{},0,{y:.5},{z:.5},{turn},0,0",
            f64::from(index * 10_000) * time
        )
        .unwrap();
    }
    text
}

#[test]
fn every_reader_names_other_formats_and_what_to_do() {
    let text = turned(1.0, 1.0, 1.0);
    let utf_16 = |mark: &str| -> Vec<u8> {
        let characters = format!("{mark}{text}");
        characters
            .encode_utf16()
            .flat_map(u16::to_le_bytes)
            .collect()
    };
    let zipped = |bytes: &[u8]| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let tail: Vec<u8> = (0..200).collect();
    let cases = [
        ("mark", utf_16("\u{FEFF}"), "UTF-16 text: save it as UTF-8"),
        ("utf16", utf_16(""), "UTF-16 text: save it as UTF-8"),
        ("zip", [b"PK\x03\x04", &tail[..]].concat(), "ZIP archive"),
        ("bz2", [b"BZh91AY&SY", &tail[..]].concat(), "bunzip2"),
        ("png", [b"\x89PNG\r\n\x1A\n", &tail[..]].concat(), "picture"),
        (
            "twice",
            zipped(&zipped(text.as_bytes())),
            "gzip inside gzip",
        ),
        (
            "returns",
            text.replace('\n', "\r").into_bytes(),
            "carriage returns",
        ),
        (
            "short",
            text[..200].replace('\n', "\r").into_bytes(),
            "carriage returns",
        ),
        (
            "latin",
            [b"# \xE4\n", text.as_bytes()].concat(),
            "is not UTF-8 text",
        ),
    ];
    for (name, bytes, expected) in cases {
        let input = file("formats", &format!("{name}.csv"), bytes);
        for (command, more) in readers("formats") {
            let message = refusal(command, &input, &more);
            assert!(message.contains(expected), "{command} {name}: {message}");
        }
    }
}

#[test]
fn columns_are_found_by_name_whatever_their_order() {
    let text = turned(1.0, 1.0, 1.0);
    let expected = path("columns", "expected.csv");
    let found = path("columns", "found.csv");
    let replay = |text: &str, output: &Path| {
        let input = file("columns", "input.csv", text);
        let input = input.to_str().unwrap();
        let result = aplomb(&["replay", input, "--output", output.to_str().unwrap()]);
        let errors = String::from_utf8(result.stderr).unwrap();
        assert!(result.status.success(), "{errors}");
        errors
    };
    assert_eq!(replay(&text, &expected), "");
    let expected = std::fs::read(expected).unwrap();
    let other = |more: [&str; 2]| {
        text.lines()
            .enumerate()
            .fold(String::new(), |mut other, (row, line)| {
                let cells: Vec<&str> = line.split(',').collect();
                let more = more[usize::from(row > 0)];
                let [t, ax, ay, az, gx, gy, gz] = cells[..] else {
                    panic!("{line}")
                };
                writeln!(other, "{gx}, {gy},{gz} ,{t},{az},{ay},{ax}{more}").unwrap();
                other
            })
    };
    for (more, note) in [
        (["", ""], ""),
        ([",", ","], ""),
        ([",temp", ",25.5"], "columns that are not used: temp"),
    ] {
        let errors = replay(&other(more), &found);
        assert!(
            errors.contains(note) && errors.is_empty() == note.is_empty(),
            "{errors}"
        );
        assert_eq!(std::fs::read(&found).unwrap(), expected);
    }
    let spaces = text.replace(',', ", ");
    assert_eq!(replay(&spaces, &found), "");
    assert_eq!(std::fs::read(&found).unwrap(), expected);
    let input = file("columns", "cells.csv", other([",temp", ""]));
    let message = refusal("replay", &input, &[]);
    assert!(
        message.contains("7 columns, but the header has 8"),
        "{message}"
    );
}

#[test]
fn rows_are_left_out_only_where_good_ones_remain() {
    let text = turned(1.0, 1.0, 1.0);
    let (header, rows) = text.split_once('\n').unwrap();
    let offer = "--bad-rows skip";
    for (name, text, is_offered) in [
        (
            "separator",
            format!("{header}\n{}", rows.replace(',', ";")),
            false,
        ),
        (
            "cells",
            format!("{header}\n{}", rows.replace('\n', ",\n")),
            false,
        ),
        (
            "times",
            format!("{header}\n{}", "5,0,0,9.81,0,0,0\n".repeat(300)),
            false,
        ),
        ("last", format!("{text}20000000,0,0"), true),
        ("first", format!("{header}\n# lap\n{rows}"), true),
    ] {
        let input = file("skipped", &format!("{name}.csv"), text);
        let message = refusal("replay", &input, &[]);
        assert_eq!(message.contains(offer), is_offered, "{name}: {message}");
    }
}

#[test]
fn a_time_unit_that_makes_every_row_a_gap_is_reported() {
    let input = file("steps", "steps.csv", turned(1.0, 1.0, 1.0));
    for (unit, expected) in [
        ("us", None),
        ("ms", Some("mostly 10000000 µs")),
        ("ns", Some("mostly 10 µs")),
    ] {
        let result = aplomb(&["replay", input.to_str().unwrap(), "--time-unit", unit]);
        let errors = String::from_utf8(result.stderr).unwrap();
        match expected {
            None => assert_eq!(errors, "", "{unit}"),
            Some(step) => assert!(
                errors.contains(step) && errors.contains("check --time-unit"),
                "{unit}: {errors}"
            ),
        }
    }
}

#[test]
fn every_reader_names_the_wrong_unit_and_takes_the_option_that_converts() {
    for (name, time, force, rate, option) in [
        ("ms", 1e-3, 1.0, 1.0, "--time-unit ms"),
        ("g", 1.0, 0.101_972, 1.0, "--force-unit g"),
        ("degrees", 1.0, 1.0, 57.295_78, "--rate-unit deg/s"),
    ] {
        let text = turned(time, force, rate);
        let input = file("units", &format!("{name}.csv"), text);
        for (command, more) in readers("units") {
            let message = refusal(command, &input, &more);
            let expected = format!("({option})");
            assert!(message.contains("did you mean"), "{command}: {message}");
            assert!(message.contains(&expected), "{command}: {message}");
            // Calibrating needs more poses than these.
            if command != "calibrate" {
                let (flag, unit) = option.split_once(' ').unwrap();
                let mut arguments = vec![command.to_owned(), input.to_str().unwrap().to_owned()];
                arguments.extend(more);
                arguments.extend([flag.to_owned(), unit.to_owned()]);
                let result = aplomb(&arguments);
                let errors = String::from_utf8_lossy(&result.stderr);
                assert!(result.status.success(), "{arguments:?}: {errors}");
            }
        }
    }
}

/// Few rows a second in milliseconds have the numbers of very many in microseconds.
#[test]
fn every_reader_names_milliseconds_at_each_rate() {
    for rate_hz in [4_u32, 5, 10, 20, 32, 50, 100, 333, 1_000] {
        let period_ms = 1_000 / rate_hz;
        for (name, rate) in [("turned", 1.0), ("rest", 0.0)] {
            let rows = |scale: u32| {
                let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
                for index in 0..20 * rate_hz {
                    let t_ms = period_ms * index;
                    let angle = 0.3 + rate * f64::from(t_ms) * 1e-3;
                    let (y, z) = (9.81 * angle.sin(), 9.81 * angle.cos());
                    writeln!(text, "{},0,{y:.5},{z:.5},{rate},0,0", t_ms * scale).unwrap();
                }
                text
            };
            let input = file("slow-ms", &format!("{name}-{rate_hz}.csv"), rows(1));
            for (command, more) in readers("slow-ms") {
                let message = refusal(command, &input, &more);
                assert!(
                    message.contains("did you mean ms (--time-unit ms)"),
                    "{command} {name} {rate_hz}: {message}"
                );
                assert!(message.contains("--time-unit us"), "{message}");
            }
            let known = [("ms", rows(1)), ("us", rows(1_000))];
            for (unit, text) in known {
                let input = file("slow-ms", "known.csv", text);
                let result = aplomb(&["replay", input.to_str().unwrap(), "--time-unit", unit]);
                let errors = String::from_utf8_lossy(&result.stderr);
                assert!(result.status.success(), "{unit} {rate_hz}: {errors}");
            }
        }
    }
}

#[test]
fn every_reader_names_the_unit_of_a_field_and_takes_the_option() {
    let with_field = |unit_ut: f64| {
        let rows = turned(1.0, 1.0, 1.0);
        let mut text = String::new();
        for (index, row) in rows.lines().enumerate() {
            let angle = 0.01 * index as f64;
            let (x, y) = (20.0 * angle.cos() / unit_ut, -20.0 * angle.sin() / unit_ut);
            let field = match index {
                0 => "mx,my,mz".to_owned(),
                _ => format!("{x},{y},{}", -44.0 / unit_ut),
            };
            writeln!(text, "{row},{field}").unwrap();
        }
        text
    };
    let norm_ut = f64::hypot(20.0, 44.0);
    for (name, unit_ut) in [("G", 100.0), ("norm", norm_ut), ("nT", 1e-3), ("T", 1e6)] {
        let input = file("field", &format!("{name}.csv"), with_field(unit_ut));
        for (command, more) in readers("field") {
            let message = refusal(command, &input, &more);
            let expected = format!("(--field-unit {name})");
            assert!(message.contains(&expected), "{command}: {message}");
            if command != "calibrate" {
                let mut arguments = vec![command.to_owned(), input.to_str().unwrap().to_owned()];
                arguments.extend(more);
                arguments.extend(["--field-unit".to_owned(), name.to_owned()]);
                let result = aplomb(&arguments);
                let errors = String::from_utf8_lossy(&result.stderr);
                assert!(result.status.success(), "{arguments:?}: {errors}");
                assert_eq!(errors, "", "{arguments:?}");
            }
        }
    }
    let input = file("field", "mG.csv", with_field(0.1));
    let result = aplomb(&["replay", input.to_str().unwrap()]);
    let warning = String::from_utf8_lossy(&result.stderr);
    assert!(warning.contains("--field-unit mG"), "{warning}");
    let input = file("field", "none.csv", turned(1.0, 1.0, 1.0));
    let message = ended_with(2, "replay", &input, &["--field-unit".into(), "G".into()]);
    assert!(
        message.contains("the recording has no compass"),
        "{message}"
    );
}

/// Times since 1970 do not fit into a flight log.
#[test]
fn a_time_beyond_those_of_a_flight_log_is_refused() {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    for row in 0..50 {
        let t_us = 1_700_000_000_000_000_u64 + 1_000 * row;
        text += &format!("{t_us},0,0,-9.8{},0,0,0\n", row % 7);
    }
    let epoch = file("epoch", "epoch.csv", text);
    let convert = |name: &str| {
        let output = path("epoch", name);
        aplomb(&["convert", epoch.to_str().unwrap(), output.to_str().unwrap()])
    };
    let refused = convert("epoch.log");
    assert!(!refused.status.success());
    let errors = String::from_utf8_lossy(&refused.stderr);
    assert!(errors.contains("subtract the first time"), "{errors}");
    let taken = convert("epoch-bursts.csv");
    let errors = String::from_utf8_lossy(&taken.stderr);
    assert!(taken.status.success(), "{errors}");
}

#[test]
fn a_converted_log_gives_the_attitudes_of_one_in_si_units() {
    let si = file("converted", "si.csv", turned(1.0, 1.0, 1.0));
    let other = file("converted", "other.csv", turned(1e-3, 1.0, 57.295_779_513));
    let output = path("converted", "attitude.csv");
    let last = |arguments: &[&str]| {
        let mut all = vec!["replay", arguments[0], "--output", output.to_str().unwrap()];
        all.extend(&arguments[1..]);
        let result = aplomb(&all);
        let errors = String::from_utf8_lossy(&result.stderr);
        assert!(result.status.success(), "{errors}");
        let text = std::fs::read_to_string(&output).unwrap();
        let cells = text.lines().last().unwrap().split(',').skip(1).take(4);
        cells
            .map(|cell| cell.parse().unwrap())
            .collect::<Vec<f64>>()
    };
    let expected = last(&[si.to_str().unwrap()]);
    let options = ["--time-unit", "ms", "--rate-unit", "deg/s"];
    let found = last(&[&[other.to_str().unwrap()][..], &options].concat());
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");
    }
}

#[test]
fn bad_rows_are_left_out_on_request_and_counted() {
    let mut text = turned(1.0, 1.0, 1.0);
    text = text
        .replacen("\n40000,", "\n30000,", 1)
        .replacen("\n60000,0,", "\n60000,nan,", 1);
    // A logger that lost its supply within a row.
    text.truncate(text.len() - 12);
    text.push_str("\n\n\n");
    let input = file("bad-rows", "input.csv", text);
    let message = refusal("replay", &input, &[]);
    assert!(message.contains("input.csv:6: t_us is 30000"), "{message}");
    assert!(message.contains("--bad-rows skip"), "{message}");
    let result = aplomb(&["replay", input.to_str().unwrap(), "--bad-rows", "skip"]);
    let warning = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{warning}");
    assert!(
        warning.contains("3 bad rows are left out; the first: "),
        "{warning}"
    );
    assert!(warning.contains("input.csv:6: t_us is 30000"), "{warning}");
    let printed = String::from_utf8_lossy(&result.stdout);
    assert!(printed.contains("1997 rows"), "{printed}");
}

/// A file system that crashed leaves NUL bytes where rows were to come.
#[test]
fn a_tail_of_nul_bytes_is_named_and_the_rows_before_are_read() {
    let text = turned(1.0, 1.0, 1.0);
    let short = text
        .lines()
        .take(301)
        .fold(String::new(), |all, line| all + line + "\n");
    for (name, text, nuls, rows) in [
        ("block", short.as_str(), 512, 300),
        ("row", &short[..short.len() - 9], 4_096, 299),
        ("long", text.as_str(), 3_000_000, 2_000),
        ("one", short.as_str(), 1, 300),
    ] {
        let bytes = [text.as_bytes(), &vec![0; nuls]].concat();
        let input = file("nuls", &format!("{name}.csv"), bytes);
        for (command, more) in readers("nuls") {
            let message = refusal(command, &input, &more);
            assert!(
                message.contains("NUL: ") || message.contains("NUL bytes"),
                "{message}"
            );
            assert!(message.contains("crash"), "{command}: {message}");
            assert!(message.contains("--bad-rows skip"), "{command}: {message}");
        }
        let result = aplomb(&["replay", input.to_str().unwrap(), "--bad-rows", "skip"]);
        let warning = String::from_utf8_lossy(&result.stderr);
        assert!(result.status.success(), "{warning}");
        assert!(warning.contains("1 bad rows are left out"), "{warning}");
        let printed = String::from_utf8_lossy(&result.stdout);
        assert!(
            printed.contains(&format!("{rows} rows")),
            "{name}: {printed}"
        );
    }
    let header = "t_us,ax,ay,az,gx,gy,gz";
    for (name, text) in [
        ("all", ""),
        ("header", header),
        ("line", "t_us,ax,ay,az,gx,gy,gz\n"),
    ] {
        for nuls in [100, 100_000] {
            let input = file("nuls", name, [text.as_bytes(), &vec![0; nuls]].concat());
            let message = refusal("replay", &input, &[]);
            assert!(message.contains("NUL"), "{name} {nuls}: {message}");
        }
    }
}

#[test]
fn an_option_that_would_change_nothing_is_refused() {
    let bursts = file("nothing", "bursts.csv", "t_us,bytes,flags\n");
    let message = ended_with(2, "replay", &bursts, &["--time-unit".into(), "ms".into()]);
    assert!(message.contains("--time-unit"), "{message}");
    let log = file("nothing", "log.csv", turned(1.0, 1.0, 1.0));
    let raw = [
        "--raw",
        "--accel-range",
        "2",
        "--gyro-range",
        "250",
        "--force-unit",
        "g",
    ];
    let message = ended_with(2, "replay", &log, &raw.map(str::to_owned));
    assert!(
        message.contains("--raw gives the values their units"),
        "{message}"
    );
}

#[test]
fn a_flight_log_for_calibrate_is_named_with_the_way_out() {
    let csv = file("flight", "log.csv", turned(1.0, 1.0, 1.0));
    let log = path("flight", "flight.log");
    let convert = ["convert", csv.to_str().unwrap(), log.to_str().unwrap()];
    assert!(aplomb(&convert).status.success());
    let message = refusal("calibrate", &log, &[]);
    assert!(message.contains("it is a flight log"), "{message}");
    assert!(message.contains("aplomb convert"), "{message}");
    assert!(!message.contains("standard input"), "{message}");
}

#[test]
fn comments_before_the_header_are_passed_over() {
    let text = format!("# 2026-11-22, a logger\n#\n{}", turned(1.0, 1.0, 1.0));
    let input = file("comments", "input.csv", text);
    let result = aplomb(&["replay", input.to_str().unwrap()]);
    assert!(
        result.status.success(),
        "{}",
        String::from_utf8_lossy(&result.stderr)
    );
}

#[test]
fn a_message_quotes_at_most_80_characters() {
    let header = file("quote", "header.csv", "x".repeat(15_000));
    let escape = file("quote", "escape.csv", "t_us,\u{1b}]0;title\u{7}\n");
    let cell = format!(
        "t_us,ax,ay,az,gx,gy,gz\n0,{},0,0,0,0,0\n",
        "9".repeat(300) + "x"
    );
    let cell = file("quote", "cell.csv", cell);
    for input in [header, escape, cell] {
        for (command, more) in readers("quote") {
            let message = refusal(command, &input, &more);
            let longest = message.split('"').map(|part| part.chars().count()).max();
            // What is not a quotation names the columns.
            assert!(longest.is_some_and(|it| it < 250), "{command}: {message}");
            assert!(message.lines().count() < 4, "{command}: {message}");
            assert!(!message.contains('\u{1b}'), "{command}: {message}");
        }
    }
}

/// Runs a command within a limit of memory.
#[cfg(target_os = "linux")]
fn in_little_memory(arguments: &[&str], memory_kib: u64) -> std::process::Output {
    let quoted: Vec<String> = arguments.iter().map(|word| format!("'{word}'")).collect();
    let program = env!("CARGO_BIN_EXE_aplomb");
    let words = quoted.join(" ");
    let script = format!("ulimit -d {memory_kib}; exec '{program}' {words}");
    let mut shell = Command::new("sh");
    shell
        .args(["-c", &script])
        .output()
        .expect("there is a shell")
}

/// Runs a command that has to fail in little memory, and returns its message.
#[cfg(target_os = "linux")]
fn refusal_in_little_memory(arguments: &[&str]) -> String {
    let result = in_little_memory(arguments, MOST_MEMORY_KIB);
    let message = String::from_utf8_lossy(&result.stderr).into_owned();
    assert_eq!(result.status.code(), Some(1), "{arguments:?}: {message}");
    message
}

#[cfg(target_os = "linux")]
#[test]
fn lines_without_end_are_refused_in_little_memory() {
    let mut zipped = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    for _ in 0..400 {
        zipped.write_all(&[b'a'; 1 << 20]).unwrap();
    }
    let bomb = file("endless", "bomb.csv.gz", zipped.finish().unwrap());
    assert!(bomb.metadata().unwrap().len() < 1 << 20);
    let wide = file("endless", "wide.csv", vec![b'x'; 50 << 20]);
    let inputs = [bomb.to_str().unwrap(), wide.to_str().unwrap(), "/dev/zero"];
    for input in inputs {
        for (command, more) in readers("endless") {
            let mut arguments = vec![command, input];
            arguments.extend(more.iter().map(String::as_str));
            let message = refusal_in_little_memory(&arguments);
            assert!(
                message.contains("more than 16384 bytes"),
                "{command} {input}: {message}"
            );
            assert!(message.len() < 500, "{command} {input}: {message}");
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_long_recording_is_converted_in_little_memory() {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    for index in 0..600_000 {
        text.push_str(&format!("{index}000,0,0,9.8,0,0,0\n"));
    }
    let csv = file("long", "log.csv", text);
    let (bursts, log) = (path("long", "bursts.csv"), path("long", "made.log"));
    let [csv, bursts, log] = [&csv, &bursts, &log].map(|path| path.to_str().unwrap());
    let back = path("long", "back.csv");
    let back = back.to_str().unwrap();
    for (input, output) in [(csv, bursts), (bursts, log), (log, back)] {
        let result = in_little_memory(&["convert", input, output], 12 * 1024);
        let message = String::from_utf8_lossy(&result.stderr);
        assert!(result.status.success(), "{input} {output}: {message}");
    }
    let rows = std::fs::read_to_string(back).unwrap().lines().count();
    // A comment and the header come first.
    assert_eq!(rows, 600_002);
}

#[test]
fn a_hyphen_as_output_is_standard_output_and_nothing_else_is_printed_there() {
    let folder = path("hyphen", "");
    let run = |arguments: &[&str]| {
        let result = Command::new(env!("CARGO_BIN_EXE_aplomb"))
            .args(arguments)
            .current_dir(&folder)
            .output()
            .unwrap();
        assert!(
            result.status.success(),
            "{}",
            String::from_utf8_lossy(&result.stderr)
        );
        result
    };
    let simulated = run(&["simulate", "--seconds", "1", "--output", "-"]);
    let text = String::from_utf8(simulated.stdout).unwrap();
    assert!(
        text.starts_with("# --accelerometer factory\nt_us,ax") && text.lines().count() == 1_002,
        "{text}"
    );
    let mut table = text.lines().skip(1);
    assert!(table.all(|line| line.split(',').count() == 12));
    assert!(String::from_utf8_lossy(&simulated.stderr).contains("1000 rows"));
    let log = file("hyphen", "log.csv", &text);
    let replayed = run(&["replay", log.to_str().unwrap(), "--output", "-"]);
    let text = String::from_utf8(replayed.stdout).unwrap();
    assert!(text.starts_with("t_us,qw") && text.lines().count() == 1_001);
    assert!(!folder.join("-").exists());
}

#[cfg(unix)]
#[test]
fn a_read_only_output_is_kept_by_every_command() {
    use std::os::unix::fs::PermissionsExt as _;
    let log = file("read-only", "log.csv", turned(1.0, 1.0, 1.0));
    for (command, more) in [
        ("replay", ["--output", "kept.csv"]),
        ("plot", ["--output", "kept.svg"]),
        ("convert", ["", "kept.log"]),
        ("simulate", ["--output", "kept.csv"]),
    ] {
        let kept = path("read-only", more[1]);
        std::fs::remove_file(&kept).ok();
        std::fs::write(&kept, "kept").unwrap();
        std::fs::set_permissions(&kept, std::fs::Permissions::from_mode(0o444)).unwrap();
        let mut arguments = vec![command.to_owned()];
        if command != "simulate" {
            arguments.push(log.to_str().unwrap().to_owned());
        }
        if !more[0].is_empty() {
            arguments.push(more[0].to_owned());
        }
        arguments.push(kept.to_str().unwrap().to_owned());
        let result = aplomb(&arguments);
        let message = String::from_utf8_lossy(&result.stderr).into_owned();
        assert_eq!(result.status.code(), Some(1), "{command}: {message}");
        assert!(
            message.contains("the file is read-only"),
            "{command}: {message}"
        );
        assert_eq!(std::fs::read_to_string(&kept).unwrap(), "kept", "{command}");
    }
}

#[test]
fn convert_names_what_the_output_has_no_place_for() {
    let simulated = path("left-out", "simulated.csv");
    let name = |name: &str| path("left-out", name).to_str().unwrap().to_owned();
    let run = |arguments: &[&str]| {
        let result = aplomb(arguments);
        assert!(
            result.status.success(),
            "{}",
            String::from_utf8_lossy(&result.stderr)
        );
        String::from_utf8(result.stdout).unwrap()
    };
    let csv = simulated.to_str().unwrap();
    run(&["simulate", "--seconds", "1", "--output", csv]);
    let bursts = name("made-bursts.csv");
    let printed = run(&["convert", csv, &bursts]);
    assert!(
        printed.contains("no place for it: the truth\n"),
        "{printed}"
    );
    let printed = run(&["convert", &bursts, &name("made.csv")]);
    assert!(
        printed.contains("no place for it: the temperature\n"),
        "{printed}"
    );
    let text = std::fs::read_to_string(&bursts)
        .unwrap()
        .replacen(",\n", ",BUS_FAULT\n", 2);
    let flagged = file("left-out", "flagged-bursts.csv", text);
    let arguments = [
        "convert",
        flagged.to_str().unwrap(),
        &name("flagged.csv"),
        "--json",
    ];
    let summary: serde_json::Value = serde_json::from_str(&run(&arguments)).unwrap();
    let expected = serde_json::json!(["the temperature", "the board's flags"]);
    assert_eq!(summary["left_out"], expected);
    let printed = run(&["convert", &bursts, &name("made.log")]);
    assert!(!printed.contains("left out"), "{printed}");
}

/// An hour's log has twelve times these five minutes; all of them in memory would take 24 MB.
#[cfg(target_os = "linux")]
#[test]
fn a_long_recording_takes_no_more_memory_than_a_short_one() {
    let names = ["long.csv", "long.log"].map(|name| path("long", name));
    let [csv, log] = names.each_ref().map(|path| path.to_str().unwrap());
    let simulate = [
        "simulate",
        "--kind",
        "swing",
        "--seconds",
        "300",
        "--output",
        csv,
    ];
    assert!(aplomb(&simulate).status.success());
    assert!(aplomb(&["convert", csv, log]).status.success());
    for input in [csv, log] {
        let result = in_little_memory(&["replay", input], 20_000);
        let errors = String::from_utf8_lossy(&result.stderr);
        assert!(result.status.success(), "{input}: {errors}");
        let printed = String::from_utf8_lossy(&result.stdout);
        assert!(printed.contains("300000 rows"), "{printed}");
    }
    std::fs::remove_file(csv).ok();
}

/// Returns the attitudes of a recording that begins with these bytes, and the messages.
fn attitudes_of(name: &str, start: &[u8]) -> Result<(Vec<u8>, String), String> {
    let bytes = [start, turned(1.0, 1.0, 1.0).as_bytes()].concat();
    let input = file("comments", name, bytes);
    let output = path("comments", "attitude.csv");
    let arguments = ["replay".as_ref(), input.as_os_str(), "--output".as_ref()];
    let result = aplomb(&[&arguments[..], &[output.as_os_str()]].concat());
    let errors = String::from_utf8(result.stderr).unwrap();
    match result.status.success() {
        true => Ok((std::fs::read(output).unwrap(), errors)),
        false => Err(errors),
    }
}

#[test]
fn a_comment_that_is_meant_as_an_option_counts_or_is_reported() {
    let (unstated, _) = attitudes_of("unstated.csv", b"").unwrap();
    let (expected, errors) = attitudes_of("stated.csv", b"# --accelerometer factory\n").unwrap();
    assert_ne!(unstated, expected);
    assert_eq!(errors, "");
    for comment in [
        &b"\xEF\xBB\xBF# --accelerometer factory\r\n"[..],
        b"#--accelerometer factory\n",
        b"#  --accelerometer=factory\n",
        b"# --Accelerometer factory\n",
        b"\xEF\xBB\xBF\n# made by hand\n# --accelerometer factory\n",
    ] {
        let comment_text = String::from_utf8_lossy(comment);
        let (found, errors) = attitudes_of("near.csv", comment).unwrap();
        assert!(found == expected, "{comment_text}");
        assert_eq!(errors, "", "{comment_text}");
    }
    let refused = attitudes_of("wrong.csv", b"# --accelerometer factori\n").unwrap_err();
    assert!(
        refused.contains("wrong.csv:1: \"factori\" is no knowledge"),
        "{refused}"
    );
    let refused = attitudes_of("wrong.csv", b"#\n# --accel-range 3\n").unwrap_err();
    assert!(refused.contains("wrong.csv:2: \"3\": the acc"), "{refused}");
    let (found, errors) = attitudes_of("unused.csv", b"#--gyroscope calibrated\n").unwrap();
    assert!(found == unstated);
    let expected = "unused.csv:1: the comment \"--gyroscope calibrated\" changes nothing: only";
    assert!(errors.contains(expected), "{errors}");
    assert_eq!(attitudes_of("dashes.csv", b"# -----\n").unwrap().1, "");
    // A table in SI units has no full scale.
    let (found, errors) = attitudes_of("scales.csv", b"# --accel-range 2\n").unwrap();
    assert!(found == unstated);
    let expected = "scales.csv: the full scales in its comments change nothing";
    assert!(errors.contains(expected), "{errors}");
}

/// Returns bursts of a sensor at rest, one a millisecond, at 2 g and 250 °/s.
fn bursts_at_rest(count: u32) -> String {
    let mut text = String::from("t_us,bytes,flags\n");
    for index in 0..count {
        let noise = index * 7 % 11 % 5;
        let t_us = 1_000 * index;
        let rates = format!("{noise:04x}{noise:04x}{noise:04x}");
        writeln!(
            text,
            "{t_us},00{noise:02x}00{noise:02x}400{noise}f0b0{rates},"
        )
        .unwrap();
    }
    text
}

#[test]
fn cut_bursts_are_used_up_to_the_cut_on_request() {
    let whole = bursts_at_rest(3_000);
    let cut = &whole[..whole.len() - 20];
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(whole.as_bytes()).unwrap();
    let zipped = encoder.finish().unwrap();
    let half = &zipped[..zipped.len() / 2];
    let damaged = whole.replacen("\n1000,", "\n1000;", 1);
    for (name, bytes, advice, warning) in [
        (
            "cut-bursts.csv",
            cut.as_bytes(),
            "cut-bursts.csv:3001: expected three fields",
            "1 bad rows are left out",
        ),
        (
            "damaged-bursts.csv",
            damaged.as_bytes(),
            "damaged-bursts.csv:3: expected three fields",
            "1 bad rows are left out",
        ),
        (
            "zipped-bursts.csv",
            half,
            "--bad-rows skip uses the rows before the cut",
            "the rows before the cut are used",
        ),
    ] {
        let input = file("cut-bursts", name, bytes);
        for (command, more) in [
            ("replay", vec![]),
            (
                "convert",
                vec![path("cut-bursts", "out.csv").to_str().unwrap().to_owned()],
            ),
        ] {
            let message = refusal(command, &input, &more);
            assert!(message.contains(advice), "{message}");
            assert!(message.contains("--bad-rows skip"), "{message}");
            let mut arguments = vec![command.to_owned(), input.to_str().unwrap().to_owned()];
            arguments.extend(more);
            arguments.extend(["--bad-rows".to_owned(), "skip".to_owned()]);
            let result = aplomb(&arguments);
            let errors = String::from_utf8(result.stderr).unwrap();
            assert!(result.status.success(), "{arguments:?}: {errors}");
            assert!(errors.contains(warning), "{errors}");
            assert_eq!(errors.lines().count(), 1, "{errors}");
        }
    }
    let input = file("cut-bursts", "whole-bursts.csv", &whole);
    let result = aplomb(&["replay", input.to_str().unwrap(), "--bad-rows", "keep"]);
    assert_eq!(result.status.code(), Some(2));
}

/// Bursts hold counts alone, so their full scales have to come with them.
#[test]
fn bursts_keep_their_full_scales_and_their_knowledge() {
    let stated = "# --accel-range 2\n# --gyro-range 250\n# --accelerometer calibrated\n";
    let bursts = bursts_at_rest(3_000);
    let plain = file("scales", "plain-bursts.csv", &bursts);
    let stating = file("scales", "stating-bursts.csv", format!("{stated}{bursts}"));
    let run = |arguments: &[&str]| {
        let result = aplomb(arguments);
        let errors = String::from_utf8_lossy(&result.stderr);
        assert!(result.status.success(), "{arguments:?}: {errors}");
        String::from_utf8(result.stdout).unwrap()
    };
    let named = |name: &str| path("scales", name).to_str().unwrap().to_owned();
    let (plain, stating) = (plain.to_str().unwrap(), stating.to_str().unwrap());
    let ranges = ["--accel-range", "2", "--gyro-range", "250"];
    let options = [&ranges[..], &["--accelerometer", "calibrated"]].concat();
    let replayed = |input: &str, options: &[&str]| {
        let output = named("attitude.csv");
        run(&[&["replay", input, "--output", &output], options].concat());
        std::fs::read_to_string(output).unwrap()
    };
    let expected = replayed(plain, &options);
    assert!(replayed(stating, &[]) == expected);
    // An option goes before a statement.
    assert!(replayed(stating, &["--accel-range", "4"]) != expected);

    let csv = named("out.csv");
    let json = run(&["convert", stating, &csv, "--json"]);
    let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        summary["replay_options"],
        "--sensor-delay-us 1900 --accelerometer calibrated"
    );
    let table = std::fs::read_to_string(&csv).unwrap();
    let row = "# --accelerometer calibrated\nt_us,ax,ay,az,gx,gy,gz\n0,0,0,9.80665";
    assert!(table.starts_with(row), "{}", &table[..200]);
    run(&[&["convert", plain, &csv][..], &ranges].concat());
    let table = std::fs::read_to_string(&csv).unwrap();
    assert!(table.contains("\n0,0,0,9.80665,"), "{}", &table[..200]);

    // Through a flight log and back, with its knowledge in the filter's states.
    let (log, again) = (named("out.log"), named("again-bursts.csv"));
    run(&["convert", stating, &log]);
    let attitudes = replayed(&log, &[]);
    assert_eq!(attitudes.lines().last(), expected.lines().last());
    run(&["convert", &log, &again]);
    let text = std::fs::read_to_string(&again).unwrap();
    assert_eq!(
        text,
        format!("# --accel-range 2\n# --gyro-range 250\n{bursts}")
    );
    for (input, output) in [(&log, &again), (&csv, &again)] {
        let result = aplomb(&[&["convert", input.as_str(), output][..], &ranges].concat());
        let message = String::from_utf8_lossy(&result.stderr);
        assert_eq!(result.status.code(), Some(2), "{message}");
        assert!(message.contains("--accel-range would change nothing"));
    }
    // A recording in SI units passes its statement on.
    let text = format!("# --accelerometer calibrated\n{}", turned(1.0, 1.0, 1.0));
    let input = file("scales", "stated.csv", text);
    run(&["convert", input.to_str().unwrap(), &again]);
    let text = std::fs::read_to_string(&again).unwrap();
    assert!(text.starts_with("# --accelerometer calibrated\nt_us,bytes,flags\n"));
}

/// Returns each fifth row of a simulated flight of 30 s, which is 200 Hz, with these times.
fn restamped(name: &str, stamp: impl Fn(i64) -> i64) -> PathBuf {
    let flight = path("batches", "flight.csv");
    let simulated = aplomb(&[
        "simulate",
        "--seconds",
        "30",
        "--output",
        flight.to_str().unwrap(),
    ]);
    assert!(simulated.status.success());
    let table = std::fs::read_to_string(&flight).unwrap();
    let is_row = |line: &&str| line.starts_with(|first: char| first.is_ascii_digit());
    let (header, rows): (Vec<&str>, Vec<&str>) = table.lines().partition(|line| !is_row(line));
    let mut text = header.join("\n");
    for (row, line) in (0..).zip(rows.iter().step_by(5)) {
        let (_, values) = line.split_once(',').unwrap();
        text += &format!("\n{},{values}", stamp(row));
    }
    file("batches", name, text + "\n")
}

/// A host stamps ten rows within 1 ms, and then none for 49 ms.
#[test]
fn times_in_batches_are_spread_evenly() {
    let even = restamped("even.csv", |row| 5_000 * (row + 1));
    let (even, attitudes) = (even.to_str().unwrap(), path("batches", "attitude.csv"));
    let picture = path("batches", "picture.svg");
    let (attitudes, picture) = (attitudes.to_str().unwrap(), picture.to_str().unwrap());
    let replay = |input: &str| {
        let result = aplomb(&["replay", input, "--json", "--output", attitudes]);
        let errors = String::from_utf8(result.stderr).unwrap();
        assert!(result.status.success(), "{errors}");
        let mut summary: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
        summary["input"].take();
        (summary, std::fs::read(attitudes).unwrap(), errors)
    };
    let (expected, rows, errors) = replay(even);
    assert_eq!(errors, "");
    let degraded = expected["flags"]["DEGRADED"].as_u64().unwrap_or(0);
    assert!(degraded < 1_000, "{expected}");
    for step_us in [20, 100] {
        let stamp = |row: i64| (row / 10 + 1) * 50_000 + row % 10 * step_us;
        let batches = restamped("batches.csv", stamp);
        let batches = batches.to_str().unwrap();
        let (summary, spread, note) = replay(batches);
        let expected_note = "times come in batches of about 10 rows, as a host stamps them on \
                             arrival: they are spread evenly, mostly 5000 µs apart";
        assert_eq!(note.lines().count(), 1, "{note}");
        assert!(note.contains(expected_note), "{note}");
        assert_eq!(summary, expected);
        assert!(spread == rows, "the attitudes are those of even times");
        // As the truth of these attitudes, its times are spread too.
        let plot = |truth: &str| {
            let plot = ["plot", attitudes, "--truth", truth, "--output", picture];
            String::from_utf8(aplomb(&plot).stdout).unwrap()
        };
        assert!(plot(even).contains("inclination error"));
        assert_eq!(plot(batches), plot(even));
        let kept = aplomb(&["replay", batches, "--time-unit", "us", "--bad-rows", "keep"]);
        assert!(
            !String::from_utf8(kept.stderr)
                .unwrap()
                .contains("batches of")
        );
    }
    // Four pauses are no batches.
    let paused = restamped("paused.csv", |row| {
        5_000 * row + (row / 40).min(4) * 400_000
    });
    let (_, _, errors) = replay(paused.to_str().unwrap());
    assert!(!errors.contains("in batches"), "{errors}");
}
