//! `aplomb record` and `aplomb view` from the outside, with a module at the end of a pseudo-terminal.

#![cfg(unix)]

mod common;
#[path = "common/plug.rs"]
mod plug;

use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use common::{aplomb, file, path};
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
fn wait_for_length(path: &std::path::Path, length: usize) {
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
    let interrupt = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(interrupt.is_ok_and(|status| status.success()));
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
    assert_eq!(plug.hear().as_deref(), Some("format log"));
    plug.send(b"# ok log, 50 a second\n");
    sleep(Duration::from_millis(300));
    plug.send(LINE);
    for command in ["format classic", "baud 115200", "status"] {
        assert_eq!(plug.hear().as_deref(), Some(command));
    }
    let result = child.wait_with_output().expect("it ends");
    assert!(result.status.success(), "{}", errors(&result));
    // What was said before the recording is not in it.
    assert_eq!(std::fs::read(&output).expect("it is there"), LINE);
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
    for (arguments, reason) in [
        (&["record", "--output", "x"][..], "which port?"),
        (
            &["record", "--port", "/dev/none", "--output", name],
            "--force to replace it",
        ),
        (
            &["record", "--port", "/dev/none", "--output", "x"],
            "there is no such port",
        ),
        (&["view"], "which port?"),
        (&["view", "--virtual"], "needs a terminal"),
        (
            &["view", name, "--picture", "x.png"],
            "there is no attitude in it",
        ),
    ] {
        let result = aplomb(arguments);
        assert_eq!(result.status.code(), Some(1), "{arguments:?}");
        assert!(errors(&result).contains(reason), "{}", errors(&result));
    }
    assert_eq!(std::fs::read(&there).expect("it is there"), b"precious");
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
    // As large as 110 × 32 letters with a margin: the width and height of the header.
    assert_eq!(bytes[16..24], [0, 0, 4, 96, 0, 0, 2, 148]);
    assert!(bytes.len() < 300_000, "{}", bytes.len());
}
