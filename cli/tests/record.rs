//! `aplomb record`, `view`, `measure` and `bring-up` from the outside, with a module at the end of
//! a pseudo-terminal.

#![cfg(unix)]

mod common;
#[path = "common/late_module.rs"]
mod late_module;
#[path = "common/plug.rs"]
mod plug;

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use aplomb::health::BoardFlags;
use aplomb::mpu6050::Burst;
use aplomb::telemetry::log::{self, Frame, NumberedBurst};
use common::{aplomb, file, path};
use late_module::{Fault, LateModule, State};
use plug::Plug;

const LINE: &[u8] =
    b"roll:1.00\tpitch:-2.50\tyaw:9.00\troll_rate:0.00\tpitch_rate:0.12\tyaw_rate:-3.00\tvalid:1\n";

fn record(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .arg("record")
        .args(arguments)
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program runs")
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Waits until a file has this length.
fn wait_for_length(path: &Path, length: usize) {
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(10) {
        if std::fs::metadata(path).is_ok_and(|data| data.len() == length as u64) {
            return;
        }
        sleep(Duration::from_millis(20));
    }
    panic!("{} has not {length} bytes", path.display());
}

#[test]
fn every_byte_is_kept_while_the_port_goes_and_comes_and_ctrl_c_loses_none() {
    let mut plug = Plug::new("record");
    let output = path("record", "replugged.uart");
    std::fs::remove_file(&output).ok();
    let name = output.to_str().expect("a name");
    let child = record(&["--port", plug.name(), "--output", name]);
    // Wait for the program to be there: what comes before is the operating system's.
    let start = Instant::now();
    while !output.exists() && start.elapsed() < Duration::from_secs(10) {
        sleep(Duration::from_millis(20));
    }
    let mut expected: Vec<u8> = LINE.repeat(300);
    expected.extend(0..=255);
    let half = LINE.len() * 100;
    plug.send(&expected[..half]);
    wait_for_length(&output, half);
    plug.unplug();
    sleep(Duration::from_millis(600));
    plug.plug_in();
    plug.send(&expected[half..]);
    wait_for_length(&output, expected.len());
    signal(&child, "-INT");
    let result = child.wait_with_output().expect("it ends");
    let errors = errors(&result);
    assert!(result.status.success(), "{errors}");
    assert_eq!(std::fs::read(&output).expect("it is there"), expected);
    let summary = format!("{} bytes of text: 300 attitudes, 0 lost", expected.len());
    assert!(errors.contains(&summary), "{errors}");
    assert!(errors.contains("unplugged 1 times"), "{errors}");
}

#[test]
fn a_log_is_switched_on_and_everything_back_at_the_end() {
    let mut plug = Plug::new("record-log");
    let output = path("record", "switched.log");
    let name = output.to_str().expect("a name");
    let arguments = ["--port", plug.name(), "--output", name];
    let child = record(&[&arguments[..], &["--log", "--force", "--seconds", "1.5"]].concat());
    assert_eq!(plug.hear().as_deref(), Some("show"));
    let shown = b"# ok show: mount=default format=classic rate=50 baud=115200\n";
    plug.send(shown);
    assert_eq!(plug.hear().as_deref(), Some("baud 921600"));
    plug.send(b"# ok baud 921600 from now on; say something at 921600\n");
    plug.confirm_baud(921_600);
    assert_eq!(plug.hear().as_deref(), Some("format log"));
    plug.send(b"# ok log, 50 a second\n");
    sleep(Duration::from_millis(300));
    plug.send(LINE);
    assert_eq!(plug.baud(), 921_600);
    for command in ["format classic", "baud 115200"] {
        assert_eq!(plug.hear().as_deref(), Some(command));
    }
    plug.send(b"# ok baud 115200 from now on; say something at 115200\n");
    plug.confirm_baud(115_200);
    let result = child.wait_with_output().expect("it ends");
    assert!(result.status.success(), "{}", errors(&result));
    // What was said before the recording is not in it.
    assert_eq!(std::fs::read(&output).expect("it is there"), LINE);
}

/// Returns the burst of the flight log with this number.
fn burst(number: u32) -> Vec<u8> {
    let burst = NumberedBurst {
        number,
        flags: BoardFlags::empty(),
        burst: Burst {
            bytes: [0; 14],
            captured_at_us: 1000 * u64::from(number),
            missed_before: 0,
        },
    };
    log::encode(&Frame::Burst(burst), &mut [0; log::FRAME_CAPACITY]).to_vec()
}

/// Starts to record a log of 115,200 baud, and answers up to the recording's beginning.
fn record_log(plug: &mut Plug, output: &Path) -> Child {
    let name = output.to_str().expect("a name");
    let child = record(&["--port", plug.name(), "--output", name, "--log", "--force"]);
    answer_until_log(plug);
    child
}

fn answer_until_log(plug: &mut Plug) {
    assert_eq!(plug.hear().as_deref(), Some("show"));
    plug.send(b"# ok show: mount=default format=text rate=50 baud=115200\n");
    assert_eq!(plug.hear().as_deref(), Some("baud 921600"));
    plug.send(b"# ok baud 921600 from now on; say something at 921600\n");
    plug.confirm_baud(921_600);
    assert_eq!(plug.hear().as_deref(), Some("format log"));
    plug.send(b"# ok log, 50 a second\n");
}

/// Ends it as Ctrl-C does, and answers up to its end.
fn end_log(plug: &mut Plug, child: Child) -> Output {
    signal(&child, "-INT");
    assert_eq!(plug.hear().as_deref(), Some("format text"));
    assert_eq!(plug.hear().as_deref(), Some("baud 115200"));
    plug.send(b"# ok baud 115200 from now on; say something at 115200\n");
    plug.confirm_baud(115_200);
    child.wait_with_output().expect("it ends")
}

fn signal(child: &Child, name: &str) {
    let told = Command::new("kill")
        .args([name, &child.id().to_string()])
        .status();
    assert!(told.is_ok_and(|status| status.success()));
}

/// Standard error is that terminal, as in a window that is closed.
#[test]
fn a_terminal_that_is_closed_ends_no_recording_and_leaves_the_module_as_it_was() {
    let mut plug = Plug::new("record-closed");
    let mut terminal = Plug::new("record-closed-terminal");
    let output = path("record", "closed.log");
    let errors = std::fs::File::options().write(true).open(terminal.name());
    let mut child = Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .args(["record", "--port", plug.name(), "--log", "--force"])
        .arg("--output")
        .arg(&output)
        .stderr(errors.expect("it opens"))
        .spawn()
        .expect("the program runs");
    answer_until_log(&mut plug);
    plug.send(&burst(1));
    wait_for_length(&output, burst(1).len());
    terminal.unplug();
    // It reports its progress five times a second.
    sleep(Duration::from_millis(600));
    plug.send(&burst(2));
    wait_for_length(&output, burst(1).len() + burst(2).len());
    signal(&child, "-HUP");
    assert_eq!(plug.hear().as_deref(), Some("format text"));
    assert_eq!(plug.hear().as_deref(), Some("baud 115200"));
    plug.send(b"# ok baud 115200 from now on; say something at 115200\n");
    plug.confirm_baud(115_200);
    assert_eq!(child.wait().expect("it ends").code(), Some(0));
}

#[test]
fn a_log_goes_on_after_a_replug_with_and_without_a_loss_of_power() {
    let mut plug = Plug::new("record-log-replug");
    let output = path("record", "replugged.log");
    std::fs::remove_file(&output).ok();
    let child = record_log(&mut plug, &output);
    let mut expected = burst(1);
    plug.send(&burst(1));
    wait_for_length(&output, expected.len());
    // The adapter alone was unplugged: the module still sends its log.
    plug.unplug();
    plug.plug_in();
    sleep(Duration::from_millis(600));
    let bursts = (500..520).flat_map(burst).collect::<Vec<u8>>();
    plug.send(&bursts);
    expected.extend(bursts);
    wait_for_length(&output, expected.len());
    assert_eq!(plug.baud(), 921_600);
    // The module has lost its power.
    plug.unplug();
    plug.plug_in();
    sleep(Duration::from_millis(600));
    plug.send(LINE);
    answer_until_log(&mut plug);
    plug.send(&burst(1));
    expected.extend(burst(1));
    wait_for_length(&output, expected.len());
    // The module has started again by itself: what comes cannot be read at the log's rate.
    let noise = [0x55; 150];
    for _ in 0..8 {
        plug.send(&noise);
        expected.extend(noise);
        sleep(Duration::from_millis(500));
    }
    answer_until_log(&mut plug);
    let result = end_log(&mut plug, child);
    let errors = errors(&result);
    assert!(result.status.success(), "{errors}");
    assert!(
        std::fs::read(&output)
            .expect("it is there")
            .starts_with(&expected[..expected.len() - 600])
    );
    assert_eq!(
        errors.matches("the flight log goes on").count(),
        3,
        "{errors}"
    );
}

/// Records a log of half a second from a module with this fault.
fn record_late(test: &str, fault: Fault) -> (Output, State) {
    let plug = Plug::new(test);
    let output = path("record", test);
    let name = output.to_str().expect("a name").to_owned();
    let port = plug.name().to_owned();
    let module = LateModule::start(plug, fault, LINE, burst(1));
    let arguments = ["--port", &port, "--output", &name, "--log", "--force"];
    let child = record(&[&arguments[..], &["--seconds", "0.5"]].concat());
    let result = child.wait_with_output().expect("it ends");
    (result, module.end())
}

/// The firmware drops what it receives between its answer and its change of the rate.
#[test]
fn a_module_that_changes_its_rate_late_is_waited_for_in_both_directions() {
    let (result, state) = record_late("record-late", Fault::None);
    let errors = errors(&result);
    assert!(result.status.success(), "{errors}");
    assert!(!errors.contains("warning"), "{errors}");
    assert_eq!((state.baud, state.format.as_str()), (115_200, "classic"));
    assert!(state.trial.is_none(), "it would go back to 921,600 baud");
}

#[test]
fn a_rate_that_the_adapter_does_not_carry_leaves_the_module_as_it_was() {
    let (result, state) = record_late("record-deaf", Fault::DeafAt(921_600));
    let errors = errors(&result);
    assert_eq!(result.status.code(), Some(1));
    let reason = "the module confirmed 921600 baud, but gave no answer there, and is back at \
                  115200: does the adapter carry 921600 baud?";
    assert!(errors.contains(reason), "{errors}");
    assert!(!errors.contains("warning"), "{errors}");
    assert_eq!((state.baud, state.format.as_str()), (115_200, "classic"));
    assert!(state.trial.is_none());
}

#[test]
fn a_module_that_is_lost_on_the_way_back_is_reported_with_what_to_do() {
    let (result, _) = record_late("record-lost-back", Fault::DiesAt(115_200));
    let errors = errors(&result);
    let warning = "warning: the module could not be brought back to `format classic` at 115200 \
                   baud: the module confirmed 115200 baud, but answers neither there nor at \
                   921600: switch it off and on, then it has its saved rate and format";
    assert!(errors.contains(warning), "{errors}");
    assert!(result.status.success(), "the recording is complete");
}

#[test]
fn a_log_that_does_not_go_on_is_an_error_and_tried_for_until_the_end() {
    let mut plug = Plug::new("record-log-lost");
    let output = path("record", "lost.log");
    let child = record_log(&mut plug, &output);
    plug.send(&burst(1));
    wait_for_length(&output, burst(1).len());
    plug.unplug();
    plug.plug_in();
    for _ in 0..2 {
        assert_eq!(plug.hear().as_deref(), Some("show"));
    }
    let result = end_log(&mut plug, child);
    assert_eq!(result.status.code(), Some(1));
    let errors = errors(&result);
    assert!(
        errors.contains(
            "the flight log did not go on in the end: the module does not answer at 115200 baud"
        ),
        "{errors}"
    );
}

#[test]
fn a_log_that_cannot_be_had_leaves_the_module_and_an_older_file_as_they_were() {
    let mut plug = Plug::new("record-log-refused");
    let old = file("record", "old.log", "precious");
    let [port, name] = [plug.name(), old.to_str().expect("a name")].map(str::to_owned);
    // The folder does not exist: the module is not even asked.
    let result = record(&["--port", &port, "--output", "none/x", "--log"]).wait_with_output();
    let result = result.expect("it ends");
    assert_eq!(result.status.code(), Some(1));
    assert!(
        errors(&result).contains("there is no folder none"),
        "{}",
        errors(&result)
    );
    // The module is armed.
    let child = record(&["--port", &port, "--output", &name, "--log", "--force"]);
    assert_eq!(plug.hear().as_deref(), Some("show"));
    plug.send(b"# ok show: mount=default format=text rate=50 baud=115200\n");
    let refusal = "error refused while armed: \"disarm\" first";
    assert_eq!(plug.hear().as_deref(), Some("baud 921600"));
    plug.send(format!("# {refusal}\n").as_bytes());
    for command in ["format text", "baud 115200"] {
        assert_eq!(plug.hear().as_deref(), Some(command));
        assert_eq!(plug.baud(), 115_200);
    }
    plug.send(b"# ok baud 115200: as before\n");
    let result = child.wait_with_output().expect("it ends");
    assert_eq!(result.status.code(), Some(1));
    assert!(errors(&result).contains(refusal), "{}", errors(&result));
    assert_eq!(std::fs::read(&old).expect("it is there"), b"precious");
}

#[test]
fn a_silent_module_and_one_at_another_rate_are_said_to_be_so() {
    let mut plug = Plug::new("record-silent");
    let output = path("record", "silent.log");
    let name = output.to_str().expect("a name");
    let port = plug.name().to_owned();
    let arguments = ["--port", &port, "--output", name, "--force"];
    let child = record(&[&arguments[..], &["--log"]].concat());
    assert_eq!(plug.hear().as_deref(), Some("show"));
    let result = child.wait_with_output().expect("it ends");
    assert_eq!(result.status.code(), Some(1));
    assert!(errors(&result).contains("does not answer at 115200 baud"));
    let child = record(&[&arguments[..], &["--seconds", "1"]].concat());
    sleep(Duration::from_millis(300));
    plug.send(b"\x13\x80\xFA\n\x00\x55");
    let result = child.wait_with_output().expect("it ends");
    assert_eq!(result.status.code(), Some(1));
    assert!(errors(&result).contains("nothing of it could be read at 115200 baud"));
}

#[test]
fn what_cannot_be_done_is_refused_with_what_to_do() {
    let there = file("record", "there.log", "precious");
    let name = there.to_str().expect("a name");
    for (arguments, code, reason) in [
        (&["record", "--output", "x"][..], 2, "which port?"),
        (
            &["record", "--port", "/dev/none", "--output", name],
            1,
            "--force to replace it",
        ),
        (
            &["record", "--port", "/dev/none", "--output", "x"],
            1,
            "there is no such port",
        ),
        (&["view"], 2, "which port?"),
        (
            &["record", "--port", "/dev/null", "--output", "x"],
            1,
            "/dev/null: it is no serial port. ",
        ),
        (
            &["view", "--virtual"],
            1,
            "needs a terminal; `cargo xtask fly`",
        ),
        (
            &["view", name, "--picture", "x.png"],
            1,
            "there is no attitude in it",
        ),
        (&["view", name], 1, "--picture FILE.png"),
        (&["view", "src", "--picture", "x.png"], 1, "src is a folder"),
        (
            &["view", name, "--picture", name],
            2,
            "has to end with .png",
        ),
    ] {
        let result = aplomb(arguments);
        assert_eq!(result.status.code(), Some(code), "{arguments:?}");
        assert!(errors(&result).contains(reason), "{}", errors(&result));
    }
    for arguments in [
        &["record", "--output", "x", "--seconds", "0"][..],
        &["record", "--output", "x", "--seconds", "nan"],
        &["record", "--output", "x", "--seconds", "-1"],
        &["view", name, "--picture", "x.png", "--at", "nan"],
        &["view", name, "--picture", "x.png", "--at", "-5"],
    ] {
        let result = aplomb(arguments);
        assert_eq!(result.status.code(), Some(2), "{arguments:?}");
        assert!(
            errors(&result).contains("it has to be a number"),
            "{}",
            errors(&result)
        );
    }
    assert_eq!(std::fs::read(&there).expect("it is there"), b"precious");
}

#[test]
fn a_recording_is_never_replaced_by_its_picture() {
    let recording = file("record", "flight.png", LINE);
    let name = recording.to_str().expect("a name");
    let result = aplomb(&["view", name, "--picture", name]);
    assert_eq!(result.status.code(), Some(1));
    assert!(
        errors(&result).contains("would replace the input"),
        "{}",
        errors(&result)
    );
    assert_eq!(std::fs::read(&recording).expect("it is there"), LINE);
}

#[test]
fn a_picture_of_a_recording_is_drawn() {
    let recording = file("record", "flight.uart", LINE.repeat(100));
    let picture = path("record", "view.png");
    let [recording, name] = [&recording, &picture].map(|path| path.to_str().expect("a name"));
    let result = aplomb(&["view", recording, "--picture", name, "--at", "1"]);
    assert!(result.status.success(), "{}", errors(&result));
    let bytes = std::fs::read(&picture).expect("it is there");
    assert_eq!(&bytes[1..4], b"PNG");
    // The header's width and height: 110 × 32 letters with a margin.
    assert_eq!(bytes[16..24], [0, 0, 4, 96, 0, 0, 2, 148]);
    assert!(bytes.len() < 300_000, "{}", bytes.len());
}

const STATUS: &[u8] = b"# ok status: flags=VALID sensor=MPU-6050@0x68 mount=default \
    temperature_c=25.0 unsaved=no\n";

fn start(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program runs")
}

/// Returns the output of a program that ends within five seconds.
fn end(mut child: Child) -> Output {
    let start = Instant::now();
    while child.try_wait().expect("it is ours").is_none() {
        if start.elapsed() > Duration::from_secs(5) {
            child.kill().expect("it is ours");
            panic!("it does not end: {:?}", child.wait_with_output());
        }
        sleep(Duration::from_millis(20));
    }
    child.wait_with_output().expect("it has ended")
}

#[test]
fn ctrl_c_ends_a_measurement_in_the_module_too() {
    let mut plug = Plug::new("measure-ended");
    let child = start(&["measure", "--port", plug.name(), "--seconds", "600"]);
    assert_eq!(plug.hear().as_deref(), Some("status"));
    plug.send(STATUS);
    assert_eq!(plug.hear().as_deref(), Some("measure on"));
    plug.send(b"# ok measure on\n");
    sleep(Duration::from_millis(300));
    signal(&child, "-INT");
    assert_eq!(plug.hear().as_deref(), Some("measure off"));
    plug.send(b"# ok measure off\n");
    let output = end(child);
    assert_eq!(output.status.code(), Some(1), "{}", errors(&output));
    assert!(errors(&output).contains("it was ended with Ctrl-C"));
}

/// Recording the noise catches Ctrl-C, also for the steps after it.
#[test]
fn ctrl_c_ends_a_bring_up_in_each_step_and_keeps_the_report() {
    let skipped = "port bus identity registers edges self-test temperature power";
    let skipped: Vec<&str> = skipped
        .split(' ')
        .flat_map(|step| ["--skip", step])
        .collect();
    let mut plug = Plug::new("bring-up-ended");
    let report = path("record", "ended.md");
    let [port, name] = [plug.name(), report.to_str().expect("a name")].map(str::to_owned);
    let arguments = [
        "bring-up", "--port", &port, "--output", &name, "--rest", "4",
    ];
    let child = start(&[&arguments[..], &skipped].concat());
    answer_until_log(&mut plug);
    assert_eq!(plug.hear().as_deref(), Some("format text"));
    assert_eq!(plug.hear().as_deref(), Some("baud 115200"));
    plug.send(b"# ok baud 115200 from now on; say something at 115200\n");
    plug.confirm_baud(115_200);
    assert_eq!(plug.hear().as_deref(), Some("calibrate accel"));
    plug.send(b"# ok calibrate accel: lay it down\n");
    sleep(Duration::from_millis(300));
    signal(&child, "-INT");
    assert_eq!(plug.hear().as_deref(), Some("calibrate stop"));
    plug.send(b"# ok calibrate stop\n");
    let output = end(child);
    assert_eq!(output.status.code(), Some(1));
    let text = std::fs::read_to_string(report).expect("a report");
    let poses = text.lines().find(|line| line.starts_with("| six poses |"));
    let poses = poses.expect("a row");
    assert!(
        poses.contains("| skipped |") && poses.contains("Ctrl-C"),
        "{text}"
    );
    assert!(!text.contains("turns by hand"), "{text}");
}

#[test]
fn a_report_that_cannot_be_written_is_refused_before_the_first_step() {
    let plug = Plug::new("bring-up-refused");
    for (name, code, reason) in [
        ("none/report.md", 1, "there is no folder none"),
        ("report.log", 2, "choose another ending"),
    ] {
        let arguments = ["bring-up", "--port", plug.name(), "--output", name];
        let output = end(start(&arguments));
        assert_eq!(output.status.code(), Some(code), "{}", errors(&output));
        assert!(errors(&output).contains(reason), "{}", errors(&output));
        assert!(output.stdout.is_empty());
    }
}
