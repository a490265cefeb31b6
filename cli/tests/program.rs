//! Rules for every command of the program: help, exit codes, completions.

mod common;

use std::io::Write;
use std::process::{Command, Stdio};

use aplomb::calibration::Mount;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Part};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::units::MagneticField;
use aplomb_recordings::flight_log::Recorder;
use common::{aplomb, file, path};

/// Returns the message of a command that has to fail.
fn refusal(arguments: &[&str]) -> String {
    ended_with(1, arguments)
}

/// Returns the message of a command that is used wrongly.
fn wrong_usage(arguments: &[&str]) -> String {
    ended_with(2, arguments)
}

fn ended_with(code: i32, arguments: &[&str]) -> String {
    let result = aplomb(arguments);
    assert_eq!(result.status.code(), Some(code), "{arguments:?}");
    String::from_utf8(result.stderr).unwrap()
}

fn run(arguments: &[&str]) -> String {
    let result = aplomb(arguments);
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(result.stdout).unwrap()
}

/// Returns the text of a path in a folder of the test's own.
fn named(test: &str, name: &str) -> String {
    path(test, name).to_str().unwrap().to_owned()
}

/// Writes a flight log of this many seconds.
fn flight_log(test: &str, name: &str, seconds: &str) -> String {
    let (csv, log) = (named(test, "flight.csv"), named(test, name));
    run(&["simulate", "--seconds", seconds, "--output", &csv]);
    run(&["convert", &csv, &log, "--mount", "z-down"]);
    log
}

/// Writes a flight log of three seconds at rest with a compass: 50 readings a second, 20 µT to the
/// north and 44 µT down. The sensor is mounted with its X axis to the left.
fn flight_log_with_compass(test: &str, name: &str) -> String {
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.mount = Mount::parse("-y-z").unwrap();
    let mut recorder = Recorder::new(Vec::new(), Pipeline::new(&settings), 0);
    // Level and face up: 1 g along z at 2048 counts each. The last bit trembles.
    let mut bytes = [0; 14];
    bytes[4..6].copy_from_slice(&2048_i16.to_be_bytes());
    for index in 0..3_000_u64 {
        bytes[9] = (index * 7 % 5) as u8;
        let burst = Burst {
            bytes,
            captured_at_us: 20_000 + 1_000 * index,
            missed_before: 0,
        };
        recorder.add(&burst, BoardFlags::empty()).unwrap();
        if index % 20 == 7 {
            let field = MagneticField {
                ut: [20.0, 1.0, 44.0],
            };
            let measured_us = burst.captured_at_us as u32 - 10_000;
            let knowledge = CompassKnowledge::Calibrated;
            recorder.add_reading(field, measured_us, knowledge).unwrap();
        }
    }
    let log = file(test, name, recorder.into_inner());
    log.to_str().unwrap().to_owned()
}

#[test]
fn a_flight_log_with_a_compass_replays_its_heading_and_becomes_a_log_with_its_field() {
    let log = flight_log_with_compass("compass", "flight.log");
    let [replayed, csv, again] =
        ["replayed.csv", "flight.csv", "again.csv"].map(|name| named("compass", name));
    let printed = run(&["replay", &log, "--output", &replayed]);
    let told = "compass: 150 readings, 0 lost; 2992 headings exact;";
    assert!(
        printed.contains(told) && printed.contains(" 0 differ"),
        "{printed}"
    );
    let json = run(&["replay", &log, "--json"]);
    let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
    let compass = &summary["log"]["compass"];
    assert_eq!(
        (&compass["readings"], &compass["heading_exact"]),
        (&150.into(), &2992.into())
    );
    assert_eq!(compass["heading_different"], 0);
    let read = |name: &str| std::fs::read_to_string(name).unwrap();
    let last_heading_deg = |table: &str| -> f32 {
        let cells: Vec<&str> = table.lines().last().unwrap().split(',').collect();
        cells[cells.len() - 3].parse().unwrap()
    };
    let expected_deg = -(1.0_f32 / 20.0).atan().to_degrees();
    let heading_deg = last_heading_deg(&read(&replayed));
    assert!((heading_deg - expected_deg).abs() < 0.1, "{heading_deg}");

    let printed = run(&["convert", &log, &csv]);
    let options = "--mount -y-z --sensor-delay-us 1900 --accelerometer factory \
                   --compass calibrated --compass-delay-us 8100 --declination 0";
    assert!(
        printed.contains(&format!("replay it with {options}\n")),
        "{printed}"
    );
    let table = read(&csv);
    let header = "# --accelerometer factory\nt_us,ax,ay,az,gx,gy,gz,mx,my,mz\n";
    assert!(table.starts_with(header));
    let (with, without): (Vec<&str>, Vec<&str>) =
        table.lines().skip(2).partition(|row| !row.ends_with(",,,"));
    assert_eq!((with.len(), without.len()), (150, 2_850));
    // Forward is the sensor's −y, right its −x, down its −z.
    assert!(
        with.iter().all(|row| row.ends_with(",-1,-20,-44")),
        "{}",
        with[0]
    );
    let replay = ["replay", &csv, "--output", &again];
    let options: Vec<&str> = options.split(' ').collect();
    run(&[&replay[..], &options].concat());
    let heading_deg = last_heading_deg(&read(&again));
    assert!((heading_deg - expected_deg).abs() < 0.1, "{heading_deg}");

    let bursts = named("compass", "a-bursts.csv");
    let printed = run(&["convert", &log, &bursts]);
    assert!(
        printed.contains("has no place for it: the compass"),
        "{printed}"
    );
}

#[test]
fn view_takes_the_sensor_board_of_the_virtual_board() {
    let result = aplomb(&["view", "--virtual", "--sensor", "bmp280"]);
    let message = String::from_utf8(result.stderr).unwrap();
    assert!(message.contains("mpu6050, mpu9250, gy87"), "{message}");
}

/// Writes two flights of different lengths into one log.
fn two_flights(test: &str) -> String {
    let [first, second] = [("one.log", "1"), ("two.log", "2")]
        .map(|(name, seconds)| std::fs::read(flight_log(test, name, seconds)).unwrap());
    let both = file(test, "both.log", [first, second].concat());
    both.to_str().unwrap().to_owned()
}

/// Returns the names of the commands in the help.
fn commands() -> Vec<String> {
    let help = String::from_utf8(aplomb(&["--help"]).stdout).unwrap();
    let (_, list) = help.split_once("Commands:\n").expect("a list of commands");
    let lines = list.lines().take_while(|line| !line.is_empty());
    let names = lines.filter_map(|line| line.split_whitespace().next());
    names
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect()
}

#[test]
fn every_command_has_examples_in_its_help() {
    let commands = commands();
    assert!(commands.len() >= 7, "{commands:?}");
    for command in &commands {
        let result = aplomb(&[command.as_str(), "--help"]);
        let help = String::from_utf8(result.stdout).unwrap();
        assert_eq!(result.status.code(), Some(0));
        let (_, examples) = help.split_once("Examples:\n").expect(command);
        let start = format!("  aplomb {command}");
        assert!(examples.starts_with(&start), "{command}: {help}");
        // What prints JSON says what is in it.
        assert_eq!(
            help.contains("--json"),
            help.contains("\nJSON: "),
            "{command}"
        );
    }
}

#[test]
fn wrong_usage_and_failures_have_the_documented_exit_codes() {
    let help = String::from_utf8(aplomb(&["--help"]).stdout).unwrap();
    assert!(help.contains(
        "Exit codes: 0 fine, 1 failed (the reason is on standard error), 2 wrong usage, such as"
    ));
    for (arguments, code) in [
        (&[][..], 2),
        (&["no-such-command"], 2),
        (&["replay"], 2),
        (&["replay", "x.csv", "--filter", "none"], 2),
        (&["calibrate"], 2),
        (&["simulate", "--output", "x.csv", "--seconds", "0"], 2),
        (&["completions", "none"], 2),
        (&["convert", "x.csv", "x.txt"], 2),
        (&["plot", "x.csv", "--output", "x.jpg"], 2),
        (&["view", "x.log", "--picture", "x.jpg"], 2),
        (&["record", "--output", "x.log"], 2),
        (&["record", "--port", "/dev/none", "--output", "-"], 2),
        (&["measure"], 2),
        (&["bring-up"], 2),
        (&["view"], 2),
        (
            &[
                "simulate",
                "--output",
                "x.csv",
                "--compass",
                "factory",
                "--magnet",
                "99",
            ],
            2,
        ),
        (&["calibrate", "--draw-poses", "x.png", "--json"], 2),
        (
            &["calibrate", "--i2c", "/dev/none", "--bad-rows", "skip"],
            2,
        ),
        (&["replay", "/no/such.csv"], 1),
        (&["plot", "/no/such.csv"], 1),
        (&["convert", "/no/such.csv", "x.csv"], 1),
        (&["calibrate", "/no/such.csv"], 1),
        (&["simulate", "--output", "/no/such/x.csv"], 1),
        (&["--version"], 0),
    ] {
        let result = aplomb(arguments);
        assert_eq!(result.status.code(), Some(code), "{arguments:?}");
        assert_eq!(result.stderr.is_empty(), code == 0, "{arguments:?}");
    }
}

#[test]
fn options_of_another_source_are_refused() {
    for line in [
        "calibrate poses.csv --rate-hz 200",
        "calibrate poses.csv --interrupt nonsense",
        "calibrate poses.csv --seconds 20",
        "calibrate poses.csv --calibration c.json",
        "view a.csv --sensor gy87",
        "view a.csv --elf /none",
        "view a.csv --baud 9600",
        "view a.csv --address 0x68",
        "view --port /dev/none --interrupt x",
        "view --port /dev/none --elf /none",
        "view --port /dev/none --picture v.png",
        "view --virtual --baud 9600",
        "view --virtual --rate-hz 200",
        "view --i2c /dev/none --picture v.png",
        "record --port /dev/none --output x.log --sensor-mount +x-z",
    ] {
        let arguments: Vec<&str> = line.split(' ').collect();
        let result = aplomb(&arguments);
        let message = String::from_utf8_lossy(&result.stderr);
        assert_eq!(result.status.code(), Some(2), "{line}: {message}");
        assert!(message.contains("cannot be used with"), "{line}: {message}");
    }
}

#[test]
fn completions_name_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let result = aplomb(&["completions", shell]);
        assert!(result.status.success(), "{shell}");
        let script = String::from_utf8(result.stdout).unwrap();
        for command in commands() {
            assert!(script.contains(&command), "{shell}: {command}");
        }
        assert!(script.contains("sensor-delay-us"), "{shell}");
    }
}

#[test]
fn bash_takes_its_completions() {
    let script = aplomb(&["completions", "bash"]).stdout;
    let Ok(mut bash) = Command::new("bash")
        .arg("-s")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
    else {
        println!("skipped: there is no bash");
        return;
    };
    let mut input = bash.stdin.take().unwrap();
    input.write_all(&script).unwrap();
    input
        .write_all(
            b"COMP_WORDS=(aplomb sim) COMP_CWORD=1; _aplomb aplomb sim aplomb; \
              echo \"${COMPREPLY[@]}\"\n",
        )
        .unwrap();
    drop(input);
    let output = bash.wait_with_output().unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), "simulate");
}

#[test]
fn what_is_converted_is_told_as_json_too() {
    let log = "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n1000,0,0,9.8,0,0,0\n";
    let input = file("program", "log.csv", log);
    let output = path("program", "flight-bursts.csv");
    let arguments = [
        "convert".as_ref(),
        input.as_os_str(),
        output.as_os_str(),
        "--json".as_ref(),
    ];
    let result = aplomb(&arguments);
    let summary: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
    assert_eq!(summary["bursts"], 2);
    assert_eq!(summary["bursts_lost"], 0);
    assert_eq!(summary["damaged_pieces"], 0);
    assert_eq!(summary["output"], output.to_str().unwrap());
    assert_eq!(std::fs::read_to_string(&output).unwrap().lines().count(), 3);
    // An input is not replaced, here bursts that are called a log.
    let named = path("program", "named.csv");
    std::fs::copy(&output, &named).unwrap();
    let same = aplomb(&["convert".as_ref(), named.as_os_str(), named.as_os_str()]);
    assert_eq!(same.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&same.stderr).contains("replace the input"));
    assert_eq!(std::fs::read_to_string(&named).unwrap().lines().count(), 3);
}

#[test]
fn what_the_board_said_survives_a_flight_log() {
    let digits = "0f3effc2e01c0a50ffe900130004";
    let flags = [
        "",
        "MISSED",
        "",
        "BUS_FAULT|SENSOR_RESET",
        "POLLED",
        "INTERNAL_CLOCK",
    ];
    let mut text = String::from("t_us,bytes,flags\n");
    for (index, flags) in flags.iter().enumerate() {
        text += &format!("{},{digits},{flags}\n", 1_000 * (index + 1));
    }
    let input = file("program", "before-bursts.csv", &text);
    let (log, output) = (
        path("program", "flags.log"),
        path("program", "after-bursts.csv"),
    );
    for (from, to) in [(&input, &log), (&log, &output)] {
        let result = aplomb(&["convert".as_ref(), from.as_os_str(), to.as_os_str()]);
        assert!(result.status.success());
    }
    assert_eq!(std::fs::read_to_string(output).unwrap(), text);
}

#[test]
fn a_form_is_not_converted_into_itself() {
    let log = flight_log("same", "flight.log", "1");
    let (csv, bursts) = (named("same", "flight.csv"), named("same", "a-bursts.csv"));
    run(&["convert", &csv, &bursts]);
    for (input, output, form) in [
        (&log, "other.log", "a flight log"),
        (&bursts, "b-bursts.csv", "a table of bursts"),
        (&csv, "other.csv", "a recording in SI units"),
    ] {
        let output = path("same", output);
        let _ = std::fs::remove_file(&output);
        let message = wrong_usage(&["convert", input, output.to_str().unwrap()]);
        let reason = format!("it is {form} already: copy it");
        assert!(message.contains(&reason), "{message}");
        assert!(!output.exists());
    }
    let output = named("same", "other.csv");
    let message = wrong_usage(&["convert", &csv, &output, "--force-unit", "g"]);
    assert!(
        message.contains("take --force-unit themselves"),
        "{message}"
    );
}

#[test]
fn what_a_flight_log_says_and_a_table_does_not_is_told() {
    let log = flight_log("settings", "flight.log", "1");
    let [bursts, csv] = ["a-bursts.csv", "a.csv"].map(|name| named("settings", name));
    let printed = run(&["convert", &log, &bursts]);
    let options = [
        "--mount",
        "+x+z",
        "--accel-range",
        "16",
        "--gyro-range",
        "2000",
        "--sensor-delay-us",
        "1900",
        "--accelerometer",
        "factory",
    ];
    let told = format!("replay it with {}\n", options.join(" "));
    assert!(printed.contains(&told), "{printed}");
    let (of_log, of_bursts) = (named("settings", "1.csv"), named("settings", "2.csv"));
    run(&["replay", &log, "--output", &of_log]);
    let replay = ["replay", &bursts, "--output", &of_bursts];
    run(&[&replay[..], &options].concat());
    let read = |name| std::fs::read_to_string(name).unwrap();
    assert_eq!(read(&of_log), read(&of_bursts));
    let printed = run(&["convert", &log, &csv]);
    assert!(
        printed.contains("replay it with --mount +x+z --sensor-delay-us 1900 --accel"),
        "{printed}"
    );
    let message = wrong_usage(&["convert", &log, &csv, "--mount", "z-up"]);
    assert!(
        message.contains("--mount would change nothing"),
        "{message}"
    );
    for (option, reason) in [(["--flight", "2"], "1 to 1"), (["--flight", "0"], "1 to 1")] {
        let message = refusal(&[&["convert", &log, &csv][..], &option].concat());
        assert!(message.contains(reason), "{message}");
    }
    let message = wrong_usage(&["convert", &bursts, &csv, "--flight", "1"]);
    assert!(
        message.contains("--flight would change nothing"),
        "{message}"
    );
}

#[test]
fn of_several_flights_one_is_chosen() {
    let both = two_flights("flights");
    let output = path("flights", "output.csv");
    let _ = std::fs::remove_file(&output);
    let name = output.to_str().unwrap();
    for arguments in [
        &["convert", &both, name][..],
        &["replay", &both, "--output", name],
        &["replay", &both, "--json"],
    ] {
        let result = aplomb(arguments);
        assert_eq!(result.status.code(), Some(1), "{arguments:?}");
        assert!(result.stdout.is_empty(), "{arguments:?}");
        let message = String::from_utf8(result.stderr).unwrap();
        assert!(
            message
                .contains("started 2 times in it: choose a flight with --flight 1 to --flight 2"),
            "{message}"
        );
        assert!(!output.exists(), "{arguments:?}");
    }
    // Without an output all of them are told of.
    let printed = run(&["replay", &both]);
    assert!(
        printed.contains("1000 rows") && printed.contains("2000 rows"),
        "{printed}"
    );
    for (flight, rows) in [("1", 1_000), ("2", 2_000)] {
        run(&["convert", &both, name, "--flight", flight]);
        let text = std::fs::read_to_string(&output).unwrap();
        assert_eq!(text.lines().count(), 2 + rows);
        let json = run(&["replay", &both, "--json", "--flight", flight]);
        let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(summary["samples"], rows);
        let picture = named("flights", "picture.svg");
        let printed = run(&["plot", &both, "--flight", flight, "--output", &picture]);
        assert!(printed.contains(&format!("{rows} rows")), "{printed}");
    }
}

#[test]
fn a_flight_log_takes_no_options_that_it_answers_itself() {
    let log = flight_log("answered", "flight.log", "1");
    let picture = named("answered", "picture.svg");
    for options in [
        &["--mount", "z-up"][..],
        &["--sensor-delay-us", "1900"],
        &["--raw", "--accel-range", "8", "--gyro-range", "250"],
        &["--accel-range", "8"],
    ] {
        for command in [
            &["replay", log.as_str()][..],
            &["plot", &log, "--output", &picture],
        ] {
            let message = wrong_usage(&[command, options].concat());
            let reason = format!("{} ", options[0]);
            assert!(
                message.contains(&reason) && message.contains("would change nothing"),
                "{message}"
            );
        }
    }
    let refused = aplomb(&["replay", &log, "--filter", "mahony"]);
    assert_eq!(refused.status.code(), Some(2));
    let message = String::from_utf8(refused.stderr).unwrap();
    assert!(
        message.contains("choose one of kalman, axis-kalman, classic"),
        "{message}"
    );
    // Of the filters it takes those of the library, and says which.
    for (options, filter) in [(&[][..], "kalman"), (&["--filter", "classic"], "classic")] {
        let json = run(&[&["replay", &log, "--json"], options].concat());
        let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(summary["filter"], filter);
        assert_eq!(summary["mount"], "+x+z");
        let exact = if filter == "kalman" { 1_000 } else { 0 };
        assert_eq!(summary["log"]["exact"], exact);
    }
    // Nor do attitudes.
    let attitudes = named("answered", "attitude.csv");
    run(&["replay", &log, "--output", &attitudes]);
    let plot = ["plot", &attitudes, "--output", &picture];
    for option in [["--mount", "z-up"], ["--filter", "classic"]] {
        let message = wrong_usage(&[&plot[..], &option].concat());
        assert!(message.contains("would change nothing"), "{message}");
    }
    let truth = named("answered", "flight.csv");
    run(&[&plot[..], &["--truth", &truth, "--mount", "z-up"]].concat());
    let message = wrong_usage(&["replay", &truth, "--flight", "1"]);
    assert!(
        message.contains("--flight would change nothing"),
        "{message}"
    );
}

#[test]
fn of_a_flight_log_that_is_cut_off_what_came_is_used() {
    let log = flight_log("cut-log", "flight.log", "2");
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(&std::fs::read(log).unwrap()).unwrap();
    let zipped = encoder.finish().unwrap();
    // Short enough that the first read already meets the end.
    for length in [zipped.len() - 1, zipped.len() / 2, zipped.len() / 8] {
        let cut = file("cut-log", "cut.log.gz", &zipped[..length]);
        let result = aplomb(&["replay".as_ref(), cut.as_os_str(), "--json".as_ref()]);
        let errors = String::from_utf8_lossy(&result.stderr);
        assert!(result.status.success(), "{length}: {errors}");
        assert!(
            errors.starts_with("warning: ") && errors.contains("cut off"),
            "{errors}"
        );
        let summary: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
        assert_eq!(summary["log"]["cut_off"], true);
        let samples = summary["samples"].as_u64().unwrap();
        let share = samples as f64 / 2_000.0 - length as f64 / zipped.len() as f64;
        assert!(share.abs() < 0.15, "{length}: {samples}");
    }
    let whole = file("cut-log", "whole.log.gz", &zipped);
    let json = run(&["replay", whole.to_str().unwrap(), "--json"]);
    assert!(json.contains("\"cut_off\":false"), "{json}");
}

#[test]
fn values_that_are_no_counts_are_refused_or_told() {
    let row = |index: u32, az: &str, gz: &str| format!("{},0,0,{az},0,0,{gz}\n", index * 1_000);
    let header = "t_us,ax,ay,az,gx,gy,gz\n".to_owned();
    let output = named("clipped", "a-bursts.csv");
    for value in ["nan", "inf"] {
        let text = header.clone() + &row(0, "9.8", "0") + &row(1, "9.8", value);
        let input = file("clipped", "bad.csv", text);
        let message = refusal(&["convert", input.to_str().unwrap(), &output]);
        assert!(message.contains("bad.csv:3: gz is "), "{message}");
    }
    // 16 g are 156.9 m/s².
    let text = header + &row(0, "156", "34") + &row(1, "157", "-35") + &row(2, "-157", "0");
    let input = file("clipped", "input.csv", text);
    let convert = ["convert", input.to_str().unwrap(), &output];
    let printed = run(&convert);
    assert!(printed.contains("3 values are beyond 16 g"), "{printed}");
    let json = run(&[&convert[..], &["--json"]].concat());
    let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(summary["clipped_values"], 3);
}

#[test]
fn a_flight_log_on_standard_input_is_told_what_to_do() {
    let log = flight_log("stdin", "flight.log", "1");
    let line = "roll:2.57\tpitch:-1.01\tyaw:-2.03\n";
    let recorded = [line.repeat(40).into_bytes(), std::fs::read(&log).unwrap()].concat();
    let recorded = file("stdin", "recorded.log", recorded);
    for log in [log.as_ref(), recorded.as_path()] {
        for command in [&["replay", "-"][..], &["plot", "-"], &["calibrate", "-"]] {
            let result = Command::new(env!("CARGO_BIN_EXE_aplomb"))
                .args(command)
                .stdin(std::fs::File::open(log).unwrap())
                .output()
                .unwrap();
            assert_eq!(result.status.code(), Some(1));
            let message = String::from_utf8(result.stderr).unwrap();
            assert!(
                message.contains("A flight log has to be a file, not standard input: give"),
                "{command:?}: {message}"
            );
        }
    }
}

/// The output is a file that may not grow, as on a full disk.
#[cfg(unix)]
#[test]
fn what_cannot_be_said_is_a_failure_but_a_closed_pipe_is_none() {
    let input = file(
        "lost",
        "log.csv",
        "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n",
    );
    let result = Command::new("sh")
        .args([
            "-c",
            "trap '' XFSZ; ulimit -f 0; exec \"$1\" replay --json \"$2\"",
        ])
        .args(["sh", env!("CARGO_BIN_EXE_aplomb")])
        .arg(&input)
        .stdout(std::fs::File::create(path("lost", "output.json")).unwrap())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
        .wait_with_output()
        .unwrap();
    let message = String::from_utf8(result.stderr).unwrap();
    assert_eq!(result.status.code(), Some(1), "{message}");
    assert!(
        message.contains("standard output cannot be written"),
        "{message}"
    );
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let result = Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .args(["replay", "--json"])
        .arg(&input)
        .stdout(writer)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
        .wait_with_output()
        .unwrap();
    assert!(result.status.success());
    assert!(result.stderr.is_empty());
}

#[cfg(target_os = "linux")]
#[test]
fn a_bus_that_cannot_be_used_is_named_with_what_helps() {
    let output = path("bus", "flight.log");
    let output = output.to_str().unwrap();
    let file = file("bus", "no-bus", "");
    let broken = self::file("bus", "calibration.json", "{\"offset_m_s2\": 1}");
    let (file, broken) = (file.to_str().unwrap(), broken.to_str().unwrap());
    for (arguments, reason) in [
        (
            vec!["--i2c", "/dev/i2c-none"],
            "do_i2c 0` enables /dev/i2c-1",
        ),
        (vec!["--i2c", file], "is it an I2C bus?"),
        (
            vec!["--i2c", file, "--calibration", broken],
            "write it with `aplomb calibrate --json`",
        ),
    ] {
        let message = refusal(&[&["record", "--output", output][..], &arguments].concat());
        assert!(message.contains(reason), "{message}");
        if !arguments.contains(&"--calibration") {
            let message = refusal(&[&["calibrate"][..], &arguments].concat());
            assert!(message.contains(reason), "{message}");
        }
    }
    assert!(!std::path::Path::new(output).exists());
}

/// The shell opens the file for standard input before the program could replace it.
#[cfg(unix)]
#[test]
fn no_output_replaces_a_file_that_is_read() {
    let recording = named("inputs", "recording.csv");
    run(&["simulate", "--seconds", "2", "--output", &recording]);
    let identity = "[[1,0,0],[0,1,0],[0,0,1]]";
    let json = format!("{{\"offset_m_s2\":[0,0,0],\"matrix\":{identity}}}");
    let calibration = file("inputs", "calibration.svg", &json);
    let calibration = calibration.to_str().unwrap();
    let before = std::fs::read(&recording).unwrap();
    let replay = ["replay", &recording, "--calibration", calibration];
    let plot = ["plot", &recording, "--calibration", calibration];
    let record = ["record", "--i2c", "/dev/none", "--force"];
    let record = [&record[..], &["--calibration", calibration]].concat();
    for command in [&replay[..], &plot, &record] {
        let message = refusal(&[command, &["--output", calibration]].concat());
        let reason = format!("would replace the input {calibration}: choose another name");
        assert!(message.contains(&reason), "{message}");
        assert_eq!(std::fs::read_to_string(calibration).unwrap(), json);
    }
    let named_as_picture = named("inputs", "recording.svg");
    std::fs::copy(&recording, &named_as_picture).unwrap();
    for (command, input) in [
        (&["replay", "-", "--output"][..], &recording),
        (&["plot", "-", "--output"], &named_as_picture),
        (&["convert", "-"], &named("inputs", "copied-bursts.csv")),
    ] {
        if command[0] == "convert" {
            std::fs::copy(&recording, input).unwrap();
        }
        let result = Command::new(env!("CARGO_BIN_EXE_aplomb"))
            .args(command)
            .arg(input)
            .stdin(std::fs::File::open(input).unwrap())
            .output()
            .unwrap();
        let message = String::from_utf8(result.stderr).unwrap();
        assert_eq!(result.status.code(), Some(1), "{command:?}: {message}");
        let reason = "would replace the input on standard input";
        assert!(message.contains(reason), "{command:?}: {message}");
        assert_eq!(std::fs::read(input).unwrap(), before, "{command:?}");
    }
    // A device may be both.
    let result = Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .args(["replay", "-", "--output", "/dev/null"])
        .stdin(std::fs::File::open("/dev/null").unwrap())
        .output()
        .unwrap();
    let message = String::from_utf8(result.stderr).unwrap();
    assert!(message.contains("the file is empty"), "{message}");
}

#[test]
fn a_recording_without_rows_is_not_converted() {
    for (name, header, output) in [
        ("log.csv", "t_us,ax,ay,az,gx,gy,gz\n", "out.log"),
        ("log.csv", "t_us,ax,ay,az,gx,gy,gz\n", "out-bursts.csv"),
        ("bursts.csv", "t_us,bytes,flags\n", "out.csv"),
    ] {
        let input = file("rowless", name, header);
        let output = path("rowless", output);
        let _ = std::fs::remove_file(&output);
        let arguments = [input.to_str().unwrap(), output.to_str().unwrap()];
        let message = refusal(&[&["convert"][..], &arguments].concat());
        assert!(message.contains("no row after the header"), "{message}");
        assert!(!output.exists());
    }
}
