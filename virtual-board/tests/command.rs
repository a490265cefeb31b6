//! The command line.

mod common;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Instant;

use common::firmware;
use virtual_board::summary::larger;

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn fly(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_virtual-board"));
    command
        .arg("fly")
        .arg("--elf")
        .arg(firmware())
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn a_malformed_log_is_refused_with_file_line_and_reason_before_anything_runs() {
    let folder = folder("malformed");
    let output = folder.join("output");
    let log = folder.join("bad.csv");
    fs::write(
        &log,
        "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n1000,0,0,oops,0,0,0\n",
    )
    .unwrap();
    let refused = fly(&[
        "--log",
        log.to_str().unwrap(),
        "--output",
        output.to_str().unwrap(),
    ]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success());
    assert!(
        message.contains("bad.csv") && message.contains('3') && message.contains("oops"),
        "{message}"
    );
    assert!(!output.exists());
    assert!(!message.contains("flown"), "{message}");
}

/// Flies a recording of rest with these columns, a row each 5 ms, to its end; gives what was
/// printed and the summary.
fn fly_recording(name: &str, columns: &str, row: &str, rows: u32) -> (String, String) {
    let folder = folder(name);
    let log = folder.join("log.csv");
    let rows: String = (0..rows)
        .map(|index| format!("{},{row}\n", index * 5000))
        .collect();
    fs::write(&log, format!("{columns}\n{rows}")).unwrap();
    let flown = fly(&[
        "--log",
        log.to_str().unwrap(),
        "--output",
        folder.to_str().unwrap(),
    ]);
    assert!(
        flown.status.success(),
        "{}",
        String::from_utf8_lossy(&flown.stderr)
    );
    (
        String::from_utf8_lossy(&flown.stdout).into_owned(),
        fs::read_to_string(folder.join("summary.json")).unwrap(),
    )
}

#[test]
fn a_recording_flies_until_it_ends() {
    let (shown, summary) = fly_recording(
        "recording",
        "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz",
        "0,0,9.80665,0,0,0,1,0,0,0",
        200,
    );
    // Three seconds of rest, one of turning, and 199 intervals of 5 ms.
    assert!(summary.contains("\"virtual_seconds\": 4.995,"), "{summary}");
    assert!(summary.contains("\"missed\": 0,"), "{summary}");
    assert!(
        !summary.contains("\"inclination_rms_deg\": null"),
        "{summary}"
    );
    assert!(
        shown.contains("gyroscope's offset measured, ready"),
        "the log is shown: {shown}"
    );
    assert!(shown.contains("edge to attitude"), "and the table: {shown}");
}

#[test]
fn without_truth_there_are_no_scores() {
    let (_, summary) = fly_recording(
        "no truth",
        "t_us,ax,ay,az,gx,gy,gz",
        "0,0,9.80665,0,0,0",
        50,
    );
    assert!(
        summary.contains("\"inclination_rms_deg\": null,"),
        "{summary}"
    );
    assert!(
        summary.contains("\"inclination_max_deg\": null,"),
        "{summary}"
    );
}

#[test]
fn options_that_make_no_sense_are_refused() {
    for (arguments, reason) in [
        (["--mount", "+x+x"], "no such mount"),
        (["--board", "toaster"], "no such board"),
        (["--seconds", "0"], "above 0"),
    ] {
        let refused = fly(&arguments);
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            !refused.status.success() && message.contains(reason),
            "{arguments:?}: {message}"
        );
    }
}

#[test]
fn a_file_that_is_no_image_is_refused() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_virtual-board"));
    let refused = command
        .args(["fly", "--elf", file!()])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(!refused.status.success());
    assert!(!String::from_utf8_lossy(&refused.stderr).is_empty());
}

/// Flies a recorded rest of 0.6 s that arms from 0.2 s to 0.4 s, with these arguments. Returns the
/// messages, and the times of the armed bursts, s after power-up.
fn fly_armed(name: &str, arguments: &[&str]) -> (String, Vec<f64>) {
    let folder = folder(name);
    let log = folder.join("log.csv");
    let row = |index: u32| {
        let is_armed = u32::from((40..80).contains(&index));
        // A row that repeats is frozen.
        let noise = |factor: u32| f64::from(index * factor % 11) * 0.002 - 0.01;
        let [x, y, z] = [3, 4, 5].map(|factor| 4.0 * noise(factor));
        let [p, q, r] = [6, 7, 8].map(noise);
        let t_us = index * 5_000;
        format!("{t_us},{x},{y},{},{p},{q},{r},{is_armed}\n", 9.806_65 + z)
    };
    let rows: String = (0..=120).map(row).collect();
    fs::write(&log, format!("t_us,ax,ay,az,gx,gy,gz,armed\n{rows}")).unwrap();
    let [log, output] = [&log, &folder].map(|path| path.to_str().unwrap());
    let flown = fly(&[&["--log", log, "--output", output], arguments].concat());
    let messages = String::from_utf8_lossy(&flown.stderr).into_owned();
    assert!(flown.status.success(), "{messages}");
    let bursts = fs::read_to_string(folder.join("bursts.csv")).unwrap();
    let armed = bursts.lines().filter(|line| line.contains("ARMED"));
    let times = armed.map(|line| line.split(',').next().unwrap().parse::<f64>().unwrap() * 1e-6);
    (messages, times.collect())
}

#[test]
fn a_recording_arms_the_module_as_its_column_says() {
    let (messages, armed) = fly_armed("armed", &[]);
    assert!(messages.starts_with("arm at 4.200 s, as recorded\ndisarm at 4.400 s, as recorded\n"));
    assert!(!messages.contains("warning"), "{messages}");
    // The module's clock begins some milliseconds after power-up.
    let (first, last) = (armed[0], armed[armed.len() - 1]);
    assert!((4.17..4.23).contains(&first), "{first}");
    assert!((4.37..4.43).contains(&last), "{last}");
    let gap = armed
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .fold(0.0, larger);
    assert!(gap < 0.0015, "{gap}");
    // A command that the module does not follow is reported.
    let faults = folder("armed-flood").join("faults.txt");
    fs::write(&faults, "4.1 1 uart-flood\n").unwrap();
    let (messages, armed) = fly_armed("armed-flood", &["--faults", faults.to_str().unwrap()]);
    assert!(
        messages.contains("warning: the module ignored `arm` at 4.200 s"),
        "{messages}"
    );
    assert_eq!(armed, [0.0; 0]);
    // The commands of a file replace the column.
    let commands = folder("armed-by-file").join("commands.txt");
    fs::write(&commands, "4.45 arm\n").unwrap();
    let (messages, armed) = fly_armed("armed-by-file", &["--commands", commands.to_str().unwrap()]);
    assert!(messages.contains("the column armed of the recording is ignored: the file of"));
    assert!((4.42..4.48).contains(&armed[0]), "{}", armed[0]);
}

/// Returns the message of `fly` for this `--faults`, which it refuses before anything runs.
fn refusal_of_faults(argument: &str) -> String {
    let output = folder("refused-faults").join("output");
    let refused = fly(&["--faults", argument, "--output", output.to_str().unwrap()]);
    assert!(!refused.status.success());
    assert!(!output.exists());
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!message.contains("flown"), "{message}");
    message
}

#[test]
fn a_schedule_of_faults_that_is_not_understood_is_refused_with_line_and_reason() {
    let file = folder("refused-faults").join("bad.txt");
    fs::write(&file, "1 0.1 frozen\n2 0.1 melted\n").unwrap();
    let message = refusal_of_faults(file.to_str().unwrap());
    assert!(
        message.contains("bad.txt, line 2: there is no fault `melted`; there are address-nack, "),
        "{message}"
    );
    let message = refusal_of_faults("seed:x");
    assert!(message.contains("such as seed:7"), "{message}");
    assert!(refusal_of_faults("/no/such/file").contains("/no/such/file"));
}

#[test]
fn a_campaign_shows_its_table_and_fails_if_a_flight_does() {
    // What is no firmware fails every flight.
    let file = folder("campaign").join("no.elf");
    fs::write(&file, "no firmware").unwrap();
    let campaign = |elf: &Path, runs: &str| {
        Command::new(env!("CARGO_BIN_EXE_virtual-board"))
            .args([
                "faults", "--seed", "21", "--jobs", "2", "--runs", runs, "--elf",
            ])
            .arg(elf)
            .output()
            .unwrap()
    };
    let failed = campaign(&file, "3");
    let text = String::from_utf8_lossy(&failed.stdout).into_owned();
    assert!(!failed.status.success());
    assert!(
        text.contains("3 flights from seed 21 on") && text.contains("3 failed"),
        "{text}"
    );
    assert!(
        text.contains("again: cargo xtask faults --runs 1 --seed 22"),
        "{text}"
    );
    let passed = campaign(&firmware(), "2");
    let text = String::from_utf8_lossy(&passed.stdout).into_owned();
    assert!(passed.status.success(), "{text}");
    assert!(
        text.contains("worst recovery ms") && text.contains(", 0 failed"),
        "{text}"
    );
    assert!(text.contains("flights with a valid heading: 0"), "{text}");
    let rows = text.lines().filter(|line| line.starts_with("uart-"));
    assert_eq!(rows.count(), 2, "{text}");
}

#[test]
fn live_it_keeps_to_real_time_answers_lines_and_ends_with_its_input() {
    let started = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_virtual-board"))
        .args(["fly", "--live", "--elf"])
        .arg(firmware())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = child.stdin.take().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut next = |start: &str| {
        let line = lines.by_ref().map(Result::unwrap);
        line.take_while(|line| !line.starts_with(start)).count()
    };
    next("# MPU-6050 at 0x68 configured");
    writeln!(input, "rate 20").unwrap();
    next("# ok text, 20 a second");
    // Forty attitudes take two seconds.
    writeln!(input, "status").unwrap();
    next("# ok status: ");
    // A flight that has fallen behind while it started catches up first.
    for _ in 0..20 {
        next("roll:");
    }
    let (before, from) = (Instant::now(), started.elapsed());
    for _ in 0..40 {
        next("roll:");
    }
    let seconds = before.elapsed().as_secs_f64();
    assert!(
        (1.8..10.0).contains(&seconds),
        "{seconds} s, after {from:?}"
    );
    drop(input);
    assert!(child.wait().unwrap().success());
}

/// Returns the message of a flight that has to be refused, with a file as the value of an option.
fn refusal(name: &str, option: &str, contents: &str, more: &[&str]) -> String {
    let folder = folder(name);
    let file = folder.join("input");
    fs::write(&file, contents).unwrap();
    let output = folder.join("output");
    let mut arguments = vec![option, file.to_str().unwrap()];
    arguments.extend(["--output", output.to_str().unwrap()]);
    arguments.extend(more);
    let refused = fly(&arguments);
    assert!(!refused.status.success(), "{option} {contents}");
    assert!(!output.exists());
    String::from_utf8_lossy(&refused.stderr).into_owned()
}

#[test]
fn a_recording_in_other_units_is_refused_as_replay_refuses_it() {
    let log = |row: &dyn Fn(u32) -> String| {
        let rows: String = (0..50).map(|index| row(index) + "\n").collect();
        format!("t_us,ax,ay,az,gx,gy,gz\n{rows}")
    };
    let in_g = log(&|index| format!("{},0,0,1.0,0,0,0", index * 5000));
    let message = refusal("units", "--log", &in_g, &[]);
    assert!(
        message.contains("did you mean g (--force-unit g)"),
        "{message}"
    );
    let with_gap = log(&|index| {
        format!(
            "{},0,0,9.8,0,0,0",
            u64::from(index / 49) * 3e15 as u64 + u64::from(index) * 5000
        )
    });
    let message = refusal("gap", "--log", &with_gap, &[]);
    assert!(
        message.contains("95.1 years after the row before"),
        "{message}"
    );
    let message = refusal("keep", "--log", &in_g, &["--bad-rows", "keep"]);
    assert!(message.contains("refuse or skip"), "{message}");
}

#[test]
fn entries_after_the_end_of_the_flight_are_refused() {
    let commands = refusal(
        "late-command",
        "--commands",
        "1 help\n40 status\n",
        &["--seconds", "2"],
    );
    assert!(
        commands.contains("`status` at 40 s comes after the end of the flight, 2 s"),
        "{commands}"
    );
    let faults = refusal(
        "late-fault",
        "--faults",
        "1 0.1 frozen\n3 1 sda-low\n",
        &["--seconds", "2"],
    );
    assert!(
        faults.contains("`sda-low` at 3 s comes after the end"),
        "{faults}"
    );
}

#[test]
fn the_rest_before_a_recording_has_noise_and_a_pipe_gets_an_attitude_a_second() {
    let (shown, summary) = fly_recording("noise", "t_us,ax,ay,az,gx,gy,gz", "0,0,9.80665,0,0,0", 2);
    assert!(!summary.contains("FROZEN"), "{summary}");
    let attitudes = |text: &str| text.lines().filter(|line| line.contains("roll:")).count();
    assert!((3..=5).contains(&attitudes(&shown)), "{shown}");
    let whole = fs::read_to_string(folder("noise").join("firmware.log")).unwrap();
    assert!(attitudes(&whole) > 150, "{whole}");
    for line in shown.lines().filter(|line| line.contains("INFO")) {
        assert!(whole.contains(line), "{line}");
    }
}

#[cfg(unix)]
#[test]
fn a_read_only_file_is_not_replaced() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = folder("read-only");
    let kept = folder.join("uart.log");
    fs::remove_file(&kept).ok();
    fs::write(&kept, "kept").unwrap();
    fs::set_permissions(&kept, fs::Permissions::from_mode(0o444)).unwrap();
    let refused = fly(&["--seconds", "0.5", "--output", folder.to_str().unwrap()]);
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(
        message.contains("uart.log") && message.contains("read-only"),
        "{message}"
    );
    assert_eq!(fs::read_to_string(&kept).unwrap(), "kept");
}
